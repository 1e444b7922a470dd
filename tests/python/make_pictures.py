"""Makes the pictures of the README and of the documents, with headless Chromium.

    python make_pictures.py WAVEX FOLDER [--job JOB] [--set KEY=VALUE]... [--images IMAGES]

Runs a job that simulates its recording (by default `jobs/demo.toml`), and takes pictures of the viewer
(map with a waveform, 3-D), the page of the run and the page of a survey over the same scene: light and
dark, and at a width of 390 px. Runs `check`, `run`, `scan` and `explain` in a terminal of 80 and of 140
columns, and takes pictures of it. All are PNG files in FOLDER. With --images, the pictures for documents
are also written to IMAGES as WebP of at most 150 kB. Needs `requirements-pictures.txt`.
"""

import argparse
import base64
import fcntl
import html
import json
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
import tomllib
from contextlib import contextmanager
from pathlib import Path

import pyte
from playwright.sync_api import sync_playwright

from check_pages import browser_path
from view_page import FLAGS, served, wait

MOST_BYTES = 150_000
# Pictures for documents.
IMAGES = ["viewer_map", "viewer_3d", "survey_page", "run_page"]
LOOKS = [("light", 1280, 800), ("dark", 1280, 800), ("light", 390, 844), ("dark", 390, 844)]
# Distance of the tracks of a survey, relative to the flying height.
TRACKS = [-0.3, 0.0, 0.3]
ROWS = 400
# Colours of a terminal, light and dark; pyte calls yellow brown.
ANSI = {
    "light": ["#fff", "#222", "black=222 red=b3261e green=1b6e35 brown=7a5900 blue=1558a8 magenta=8a2a80 cyan=00697a white=555"],
    "dark": ["#14171a", "#ddd", "black=666 red=f28b82 green=81c995 brown=fdd663 blue=8ab4f8 magenta=d7aefb cyan=78d9ec white=eee"],
}


def stage_text(stage):
    """A stage as TOML."""
    return "[[stage]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in stage.items())


def value_of(text):
    """Value of an override, as `--set` reads it."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def run(wavex, *arguments):
    """Runs a command, which must succeed."""
    subprocess.run([wavex, "--quiet", *map(str, arguments)], check=True)


def make_survey(wavex, folder, simulate, stages):
    """Page of a survey of several flights over the scene of a `simulate` stage."""
    common = {key: value for key, value in simulate.items() if key != "truth"}
    common |= {"scene_seed": simulate.get("scene_seed", simulate.get("seed", 1))}
    strips = folder / "strips"
    for number, track in enumerate(TRACKS, 1):
        offset = [track * simulate.get("flying_height_m", 600.0), 0.0]
        strip = common | {"seed": 10 * number, "stem": f"strip_{number}", "track_offset_m": offset}
        job = folder / f"strip_{number}.toml"
        job.write_text(f"[job]\noutput_dir = '{strips}'\n" + stage_text(strip) + stage_text({"type": "write_arrow"}))
        run(wavex, "run", job)
    kept = [stage for stage in stages if stage["type"] in ("calibrate", "decompose", "georeference")]
    read = {"type": "read_arrow", "path": str(strips / "strip_?.arrow")}
    chain = [read, *kept, {"type": "write_las", "path": "*.laz"}]
    job = folder / "survey.toml"
    job.write_text(f"[job]\noutput_dir = '{folder / 'survey'}'\nsurvey_page = true\n" + "".join(map(stage_text, chain)))
    run(wavex, "run", job)
    return next((folder / "survey").glob("*survey.html"))


@contextmanager
def shown(browser, address, scheme, width, height):
    context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": height})
    tab = context.new_page()
    tab.goto(address)
    yield tab
    context.close()


def name_of(what, scheme, width):
    return f"{what}_{scheme}" + ("_390" if width == 390 else "")


def show_viewer(browser, address, folder):
    """Pictures of the viewer: the map with the waveform of a shot with several returns, and 3-D."""
    for scheme, width, height in LOOKS:
        with shown(browser, address, scheme, width, height) as tab:
            wait(tab, "Boolean(window.wavexView && wavexView.isComplete())")
            wait(tab, "document.getElementById('progress').hidden")
            tab.keyboard.press("f")
            tab.fill("#find-where", "number_of_returns >= 3, return_number = 1")
            tab.select_option("#find-sort", "amplitude_dn")
            tab.keyboard.press("Enter")
            wait(tab, "Boolean(wavexView.shot()) && !document.querySelector('#picture.loading')")
            tab.keyboard.press("Escape")
            tab.get_by_role("button", name="Clear", exact=True).click()
            tab.get_by_role("tab", name="Shot").click()
            for what, key in [("viewer_map", "1"), ("viewer_3d", "2")]:
                tab.keyboard.press(key)
                tab.locator("#fit").click()
                tab.mouse.move(0, 0)
                tab.wait_for_timeout(500)
                wait(tab, "wavexView.isComplete()")
                tab.screenshot(path=folder / f"{name_of(what, scheme, width)}.png")


def show_page(browser, page, what, folder):
    """Pictures of the start of a report page."""
    for scheme, width, height in LOOKS:
        with shown(browser, page.resolve().as_uri(), scheme, width, height) as tab:
            tab.screenshot(path=folder / f"{name_of(what, scheme, width)}.png")


def typed(command, columns, cwd, stream):
    """Runs a command line in a pseudo-terminal and feeds what it writes to a screen."""
    stream.feed(f"$ {command}\r\n")
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(cwd)
        os.environ |= {"TERM": "xterm-256color", "COLUMNS": str(columns)}
        os.execvp("sh", ["sh", "-c", command])
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    while True:
        try:
            written = os.read(terminal, 65536)
        except OSError:  # The end, on Linux.
            written = b""
        if not written:
            break
        stream.feed(written.decode(errors="replace"))
    os.close(terminal)
    os.waitpid(child, 0)


def screen_html(screen, scheme):
    """Used lines of a screen as a page."""
    background, text, named = ANSI[scheme]
    colours = dict(pair.split("=") for pair in named.split())
    rows = []
    for line in range(screen.cursor.y + 1):
        spans = []
        for column in range(screen.columns):
            cell = screen.buffer[line][column]
            colour = colours.get(cell.fg.removeprefix("bright"), None if cell.fg == "default" else cell.fg)
            style = (f"color:#{colour};" if colour else "") + ("font-weight:700;" if cell.bold else "")
            if spans and spans[-1][0] == style:
                spans[-1][1] += cell.data
            else:
                spans.append([style, cell.data])
        rows.append("".join(f'<span style="{style}">{html.escape(data)}</span>' for style, data in spans))
    look = f"margin:0;padding:14px;display:inline-block;background:{background};color:{text};"
    font = "font:14px/1.3 'DejaVu Sans Mono',monospace"
    return f'<body style="margin:0;background:{background}"><pre style="{look}{font}">' + "\n".join(rows) + "</pre>"


def show_terminal(browser, commands, cwd, folder):
    """Pictures of commands in terminals of 80 and 140 columns."""
    for columns in (80, 140):
        screen = pyte.Screen(columns, ROWS)
        stream = pyte.Stream(screen)
        for command in commands:
            typed(command, columns, cwd, stream)
        lines = [line.rstrip() for line in screen.display[: screen.cursor.y + 1]]
        (folder / f"terminal_{columns}.txt").write_text("\n".join(lines) + "\n")
        for scheme in ("light", "dark"):
            tab = browser.new_page(viewport={"width": 1280, "height": 800})
            tab.set_content(screen_html(screen, scheme))
            tab.locator("pre").screenshot(path=folder / f"terminal_{columns}_{scheme}.png")
            tab.close()


def as_webp(tab, png):
    """A picture as WebP, in the best quality that is small enough."""
    source = "data:image/png;base64," + base64.b64encode(png.read_bytes()).decode()
    for quality in (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3):
        encoded = tab.evaluate("""async ([source, quality]) => {
            const picture = new Image();
            picture.src = source;
            await picture.decode();
            const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
            canvas.getContext("2d").drawImage(picture, 0, 0);
            return canvas.toDataURL("image/webp", quality).split(",")[1];
        }""", [source, quality])
        webp = base64.b64decode(encoded)
        if len(webp) <= MOST_BYTES:
            return webp
    raise AssertionError(f"{png}: larger than {MOST_BYTES} bytes in every quality")


def main():
    """Makes all pictures."""
    repository = Path(__file__).resolve().parents[2]
    parser = argparse.ArgumentParser()
    parser.add_argument("wavex", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--job", type=Path, default=repository / "jobs/demo.toml")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--images", type=Path)
    chosen = parser.parse_args()
    wavex, folder = str(chosen.wavex.resolve()), chosen.folder.resolve()
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    job = tomllib.loads(chosen.job.read_text())
    simulate = job["stage"][0]
    assert simulate["type"] == "simulate", f"{chosen.job}: its first stage is not `simulate`"
    for key, value in (one.split("=", 1) for one in chosen.set if one.startswith("simulate.")):
        simulate[key.removeprefix("simulate.")] = value_of(value)
    # The job is shown as the tutorial has it, with its outputs in this folder.
    text = re.sub(r'(?m)^output_dir = .*$', 'output_dir = "out/demo"', chosen.job.read_text())
    (work / "demo.toml").write_text(text)
    quiet = "[job]\nreport = ''\nlog = ''\nstat_log = ''\n"
    record = stage_text(simulate) + stage_text({"type": "write_arrow", "path": "recording.arrow"})
    (work / "record.toml").write_text(quiet + record)
    run(wavex, "run", work / "record.toml")
    sets = ["job.report_page=true", *chosen.set]
    options = "".join(f" --set '{one}'" for one in chosen.set)
    run(wavex, "run", work / "demo.toml", *(part for one in sets for part in ("--set", one)))
    run_page = next((work / "out/demo").glob("*report.html"))
    survey_page = make_survey(wavex, work, simulate, job["stage"])
    # The commands are shown as `wavex`; the options of the pictures are in the job.
    (work / "bin").mkdir()
    (work / "bin/wavex").symlink_to(wavex)
    os.environ["PATH"] = f"{work / 'bin'}:{os.environ['PATH']}"
    commands = ["wavex check demo.toml", f"wavex run demo.toml{options}", "wavex scan recording.arrow",
                "wavex explain recording.arrow --shot 500"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path(), args=FLAGS)
        show_terminal(browser, commands, work, folder)
        with served(wavex, work / "out/demo") as (address, _):
            show_viewer(browser, address, folder)
        show_page(browser, run_page, "run_page", folder)
        show_page(browser, survey_page, "survey_page", folder)
        if chosen.images:
            chosen.images.mkdir(parents=True, exist_ok=True)
            tab = browser.new_page()
            for what in (f"{image}_{scheme}" for image in IMAGES for scheme in ("light", "dark")):
                (chosen.images / f"{what}.webp").write_bytes(as_webp(tab, folder / f"{what}.png"))
        browser.close()


if __name__ == "__main__":
    sys.exit(main())
