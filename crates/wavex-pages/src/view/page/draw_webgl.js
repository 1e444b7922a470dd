// Draws points by WebGL 2.

import { nodeColours } from "./cloud.js";
import { linked, ShadedTarget } from "./shade_webgl.js";
import { state } from "./state.js";

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec4 colour;
uniform vec3 target;
uniform mat4 projection;
uniform float size;
out vec3 shade;
void main() {
  gl_Position = projection * vec4(position - target, 1.0);
  if (colour.a == 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = size;
  shade = colour.rgb;
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
in vec3 shade;
out vec4 pixel;
void main() { pixel = vec4(shade, 1.0); }`;

/** Depths in perspective that are drawn, in units of the distance to the target: nearest and farthest. */
const DEPTHS = [0.02, 50];
/** End of the page's address that accepts an emulated graphics processor. */
const ACCEPTS_EMULATED = "#webgl";

/** Context of a canvas on a graphics processor; null if there is none or it is emulated. */
function hardwareContext(canvas) {
  const acceptsEmulated = location.hash === ACCEPTS_EMULATED;
  const context = canvas.getContext("webgl2", {
    antialias: false,
    alpha: false,
    preserveDrawingBuffer: true,
    failIfMajorPerformanceCaveat: !acceptsEmulated,
  });
  if (!context || acceptsEmulated) return context;
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = info ? context.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name) ? null : context;
}

export class WebglPainter {
  /** Painter of a canvas; null if the computer has no graphics processor. */
  static on(canvas) {
    const gl = hardwareContext(canvas);
    return gl && new WebglPainter(canvas, gl);
  }

  constructor(canvas, gl) {
    this.canvas = canvas;
    this.gl = gl;
    this.ratio = Math.min(2, devicePixelRatio);
    this.program = linked(gl, VERTEX, FRAGMENT);
    this.places = Object.fromEntries(
      ["target", "projection", "size"].map((name) => [name, gl.getUniformLocation(this.program, name)]),
    );
    this.target = new ShadedTarget(gl);
  }

  resize(width, height) {
    Object.assign(this.canvas, { width, height });
    this.gl.viewport(0, 0, width, height);
    this.target.resize(width, height);
  }

  begin(camera, background, size) {
    const { gl } = this;
    this.isOrbit = camera.isOrbit;
    this.size = Math.max(1, size * this.ratio);
    this.target.begin();
    gl.useProgram(this.program);
    gl.clearColor(
      (background & 255) / 255,
      ((background >> 8) & 255) / 255,
      ((background >> 16) & 255) / 255,
      1,
    );
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform3fv(this.places.target, camera.target);
    gl.uniform1f(this.places.size, this.size);
    gl.uniformMatrix4fv(this.places.projection, false, clipMatrix(camera));
  }

  draw(node) {
    const { gl } = this;
    node.buffers ??= this.upload(node);
    const colours = nodeColours(node);
    this.target.begin();
    gl.useProgram(this.program);
    gl.bindVertexArray(node.buffers.array);
    if (node.buffers.coloured !== node.coloured) {
      gl.bindBuffer(gl.ARRAY_BUFFER, node.buffers.colours);
      gl.bufferData(gl.ARRAY_BUFFER, colours, gl.STATIC_DRAW);
      node.buffers.coloured = node.coloured;
    }
    gl.drawArrays(gl.POINTS, 0, node.count);
  }

  upload(node) {
    const { gl } = this;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const positions = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, positions);
    gl.bufferData(gl.ARRAY_BUFFER, node.xyz, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    const colours = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, colours);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    node.released = () => {
      gl.deleteVertexArray(array);
      gl.deleteBuffer(positions);
      gl.deleteBuffer(colours);
      node.buffers = undefined;
    };
    return { array, colours, coloured: -1 };
  }

  /** Shows what is drawn; in perspective shaded. */
  present() {
    this.target.present(
      state.isShaded && this.isOrbit ? depthCoefficients() : null,
      Math.max(1, Math.round(this.size)),
    );
  }
}

/** Coefficients a and b of depths a + b / w in clip coordinates. */
function depthCoefficients() {
  const [near, far] = DEPTHS;
  return [(far + near) / (far - near), (-2 * far * near) / (far - near)];
}

/** Matrix from `p - target` to clip coordinates, column by column. */
function clipMatrix(camera) {
  const [right, up, forward] = camera.axes;
  const [sx, sy] = [2 / (camera.scale * camera.width), 2 / (camera.scale * camera.height)];
  const x = [...right.map((c) => c * sx), 0];
  const y = [...up.map((c) => c * sy), 0];
  let z;
  let w;
  if (camera.isOrbit) {
    const depth = [...forward.map((c) => c / camera.distance), 1];
    const [a, b] = depthCoefficients();
    w = depth;
    z = depth.map((c, i) => a * c + (i === 3 ? b : 0));
  } else {
    const reach = 10_000;
    z = [0, 0, -1 / reach, 0];
    w = [0, 0, 0, 1];
  }
  return [0, 1, 2, 3].flatMap((i) => [x[i], y[i], z[i], w[i]]);
}
