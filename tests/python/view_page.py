"""The page of `wavex view` in a browser: its server, waiting, selecting, saving, pixels."""

import re
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SECONDS = 30
# Time in which a server has found the points of a recording.
SECONDS_OF_SERVER = 180


@contextmanager
def served(wavex, place):
    """Address of the page of a place, while it is served; also the process."""
    server = subprocess.Popen([wavex, "view", place, "--no-open"], stdout=subprocess.PIPE, text=True)
    try:
        address = next((found[0] for line in server.stdout if (found := re.search(r"http://\S+", line))), None)
        assert address, "wavex view prints no address"
        yield address, server
    finally:
        server.terminate()
        server.wait()


def wait(tab, expression, seconds=SECONDS):
    """Waits until an expression holds; the page's policy forbids `wait_for_function`."""
    end = time.monotonic() + seconds
    while not tab.evaluate(expression):
        assert time.monotonic() < end, f"not within {seconds} s: {expression}"
        tab.wait_for_timeout(20)


@contextmanager
def opened(browser, address, scheme="light", width=1280, height=800):
    """The page, with its points drawn; and the list of its errors."""
    context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": height})
    tab = context.new_page()
    errors = []
    tab.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(address)
    wait(tab, "Boolean(window.wavexView && wavexView.isComplete())", SECONDS_OF_SERVER)
    wait(tab, "document.getElementById('progress').hidden", SECONDS_OF_SERVER)
    wait(tab, "wavexView.isComplete()")
    # 410: points were ordered anew while they were loaded, and the page asked again. Later it is an error.
    errors[:] = [error for error in errors if "410" not in error]
    yield tab, errors
    context.close()


def select(tab, press):
    """Does what selects another shot; waits for it."""
    before = tab.evaluate("wavexView.shot()?.shot ?? null")
    press()
    wait(tab, f"wavexView.shot() && wavexView.shot().shot !== {'null' if before is None else before}")
    return tab.evaluate("wavexView.shot()")


def saved(tab, press):
    """Name and bytes of the download that something starts."""
    with tab.expect_download() as download:
        press()
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def pixels(tab):
    """Of the picture of the points: the part that they cover, number of colours, mean brightness, and a checksum."""
    return tab.evaluate("""() => {
        const points = document.getElementById("points");
        const copy = Object.assign(document.createElement("canvas"), { width: points.width, height: points.height });
        const context = copy.getContext("2d", { willReadFrequently: true });
        context.drawImage(points, 0, 0);
        const packed = new Uint32Array(context.getImageData(0, 0, copy.width, copy.height).data.buffer);
        const stage = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
        const value = parseInt(stage.slice(1), 16);
        const empty = ((255 << 24) | ((value & 255) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
        let [drawn, brightness, checksum] = [0, 0, 0];
        const colours = new Set();
        for (const pixel of packed) {
            if (pixel === empty) continue;
            drawn += 1;
            colours.add(pixel);
            checksum = (Math.imul(checksum, 31) + pixel) | 0;
            brightness += (pixel & 255) + ((pixel >> 8) & 255) + ((pixel >> 16) & 255);
        }
        brightness /= 3 * Math.max(1, drawn);
        return { drawn: drawn / packed.length, colours: colours.size, brightness, checksum };
    }""")
