// Shading by depth on a graphics processor: points are drawn into textures, which are shaded onto the canvas.

import { DARKEST, STRENGTH } from "./shade_software.js";

const VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;
// Depths are of the form a + b / w, so that the inverse depth is linear in them.
const FRAGMENT = `#version 300 es
precision highp float;
uniform highp sampler2D colours;
uniform highp sampler2D depths;
uniform vec2 inverse;
uniform int reach;
uniform bool isShaded;
out vec4 pixel;
float nearness(ivec2 at) {
  float depth = texelFetch(depths, clamp(at, ivec2(0), textureSize(depths, 0) - 1), 0).r;
  return depth == 1.0 ? 0.0 : (2.0 * depth - 1.0 - inverse.x) / inverse.y;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  pixel = vec4(texelFetch(colours, at, 0).rgb, 1.0);
  float own = nearness(at);
  if (!isShaded || own == 0.0) return;
  float sum = max(0.0, nearness(at + ivec2(reach, 0)) - own) + max(0.0, nearness(at - ivec2(reach, 0)) - own)
    + max(0.0, nearness(at + ivec2(0, reach)) - own) + max(0.0, nearness(at - ivec2(0, reach)) - own);
  pixel.rgb *= max(${DARKEST.toFixed(3)}, exp(${(-STRENGTH / 4).toFixed(3)} * sum / own));
}`;

/** Program of two shaders. */
export function linked(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

/** Textures of colour and depth, into which the points are drawn. */
export class ShadedTarget {
  constructor(gl) {
    this.gl = gl;
    this.program = linked(gl, VERTEX, FRAGMENT);
    this.places = Object.fromEntries(
      ["colours", "depths", "inverse", "reach", "isShaded"].map((name) => [
        name,
        gl.getUniformLocation(this.program, name),
      ]),
    );
    this.empty = gl.createVertexArray();
    this.frame = gl.createFramebuffer();
    this.textures = [];
  }

  resize(width, height) {
    const { gl } = this;
    for (const texture of this.textures) gl.deleteTexture(texture);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    this.textures = [
      [gl.COLOR_ATTACHMENT0, gl.RGBA8],
      [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24],
    ].map(([attachment, format]) => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
        gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, texture, 0);
      return texture;
    });
  }

  /** Following drawing goes into the textures. */
  begin() {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.enable(gl.DEPTH_TEST);
  }

  /** Shows the textures on the canvas; shaded if `inverse` has the coefficients of depths. */
  present(inverse, reach) {
    const { gl, places } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.useProgram(this.program);
    this.textures.forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(places.colours, 0);
    gl.uniform1i(places.depths, 1);
    gl.uniform2fv(places.inverse, inverse ?? [0, 1]);
    gl.uniform1i(places.reach, reach);
    gl.uniform1i(places.isShaded, inverse ? 1 : 0);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.flush();
  }
}
