"""Checks the page of `wavex view` in headless Chromium.

    python check_view.py WAVEX

Opens a simulated recording: clicks a point and compares its returns with `wavex explain`, raises the
detection threshold until returns go, steps through the worst fits, draws a profile, saves pictures,
marks and job, and checks layout and contrast, light and dark, wide and narrow. Skipped with a message
if there is no Chromium.
"""

import csv
import io
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from playwright.sync_api import sync_playwright

from check_pages import MEASURE, SIMULATE, browser_path, run
from check_view_tools import check_tools
from checks import Checks
from view_page import FLAGS, opened, pixels, saved, select, served, wait

THRESHOLD = 30
# Rows of the page's table of returns and columns of the table of `explain`.
QUANTITIES = ["time of flight", "range", "amplitude", "width ratio", "thickness"]
RETURN = re.compile(r"^\d+ +\S+ +" + r" +".join([r"(-?[\d.]+ ± [\d.]+)"] * len(QUANTITIES)))
def explained(wavex, recording, shot, *sets):
    """Returns of a shot by `wavex explain`, as rows of texts."""
    options = [part for one in sets for part in ("--set", one)]
    command = [wavex, "explain", recording, "--shot", str(shot), "--out", recording.with_suffix(".svg"), *options]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [found.groups() for line in text.splitlines() if (found := RETURN.match(line))]


def shown(tab, changes=("same", "new", "moved")):
    """Returns in the page's table, as rows of texts, of columns with these changes."""
    columns = tab.evaluate("""() => [...document.querySelectorAll("#returns tbody tr")].map((row) =>
        [row.querySelector("th").firstChild.data, ...[...row.querySelectorAll("td")].map((cell) => [cell.className, cell.textContent])])""")
    rows = {label: [text for change, text in cells if change in changes] for label, *cells in columns}
    return list(zip(*(rows[quantity] for quantity in QUANTITIES)))


def check_shot(checks, tab, wavex, recording):
    """A clicked point shows the returns of its shot."""
    colours = pixels(tab)["colours"]
    checks.that("draws points in colours", colours > 50, f"{colours} colours")
    at = tab.evaluate("wavexView.screenOf(1234)")
    shot = select(tab, lambda: tab.mouse.click(*at))
    returns = explained(wavex, recording, shot["shot"])
    checks.that("explain has returns", len(returns) > 0)
    checks.equal("returns of the clicked point", shown(tab), returns)
    picture = tab.evaluate("document.getElementById('waveform').shadowRoot.querySelectorAll('circle').length")
    checks.that("shows the samples", picture > 20, f"{picture} circles")
    after = select(tab, lambda: tab.keyboard.press("]"))
    checks.equal("next shot", after["shot"], shot["next"])
    before = select(tab, lambda: tab.keyboard.press("["))
    checks.equal("previous shot", before["shot"], shot["shot"])


def check_what_if(checks, tab, wavex, recording, errors):
    """A higher threshold removes returns, as `explain` does; a wrong key is refused with its reason."""
    tab.keyboard.press("f")
    tab.fill("#find-where", "number_of_returns >= 3")
    tab.select_option("#find-sort", "amplitude_dn")
    shot = select(tab, lambda: tab.keyboard.press("Enter"))
    tab.keyboard.press("Escape")
    tab.get_by_role("tab", name="What if").click()
    tab.fill("#key-decompose-detection_sigma", str(THRESHOLD))
    wait(tab, "Boolean(wavexView.changedShot())")
    tab.get_by_role("tab", name="Shot").click()
    returns = explained(wavex, recording, shot["shot"], f"decompose.detection_sigma={THRESHOLD}")
    gone = shown(tab, ("gone",))
    checks.equal("returns with the changed key", shown(tab), returns)
    checks.that("returns that are gone are marked", 0 < len(gone) == tab.locator("#returns .badge.gone").count())
    checks.that(
        "returns that are gone are those of the job", set(gone) <= set(explained(wavex, recording, shot["shot"]))
    )
    tab.get_by_role("tab", name="What if").click()
    tab.get_by_role("button", name="Compare line").click()
    wait(tab, "document.querySelectorAll('#comparison tr').length === 3")
    numbers = tab.evaluate(
        "[...document.querySelectorAll('#comparison td:nth-child(2)')].map((cell) => Number(cell.textContent.replace(/\\D/g, '')))"
    )
    checks.that("returns of the line are gone", numbers[1] > len(gone), f"new, gone, moved: {numbers}")
    legend = tab.evaluate("""[...document.querySelectorAll("#symbols li")].map((item) =>
        [item.dataset.kind, Number(item.querySelector("span").textContent.replace(/\\D/g, ""))])""")
    kinds = ["new", "gone", "moved"]
    checks.equal("legend of the map", [pair for pair in legend if pair[0] in kinds], list(map(list, zip(kinds, numbers))))
    name, job = saved(tab, lambda: tab.get_by_role("button", name="Save job").click())
    checks.that(
        "the job has the key",
        re.search(rf"detection_sigma *= *{THRESHOLD}(\.0)?\n", job.decode()) is not None,
        job.decode(),
    )
    tab.fill("#key-decompose-split_evidence", "0")
    tab.locator("#difference", has_text="at least 4 and at most 1000000").wait_for()
    checks.equal("another key clears the comparison", tab.locator("#comparison tr").count(), 0)
    checks.equal("and its legend", tab.locator("#symbols li[data-kind=gone]").count(), 0)
    refused = [errors.pop() for _ in list(errors)]
    checks.that("only the wrong key is refused", refused and all("400" in error for error in refused), str(refused))
    tab.get_by_role("button", name="Reset").click()
    wait(tab, "wavexView.changedShot() === null")
    checks.equal("no return is gone after a reset", tab.locator("#returns .badge").count(), 0)


def check_find(checks, tab):
    """The worst fits are listed in order and stepped through; marked shots are saved."""
    tab.keyboard.press("f")
    tab.keyboard.press("Escape")
    select(tab, lambda: tab.get_by_role("button", name="Worst fits").click())
    found = tab.evaluate("wavexView.found()")
    values = [each["value"] for each in found]
    checks.that("worst fits in order", len(values) > 20 and values == sorted(values, reverse=True))
    stepped = [tab.evaluate("wavexView.shot().shot")]
    tab.keyboard.press("m")
    for _ in range(3):
        stepped.append(select(tab, lambda: tab.keyboard.press("n"))["shot"])
    checks.equal("steps through the list", stepped, [each["shot"] for each in found[:4]])
    tab.keyboard.press("m")
    marked = tab.evaluate("wavexView.shot()")
    tab.get_by_role("tab", name="Marks").click()
    name, text = saved(tab, lambda: tab.locator("#save-csv").click())
    rows = list(csv.DictReader(io.StringIO(text.decode())))
    checks.equal(
        "marked shots", [row for row in dict.fromkeys(int(row["shot"]) for row in rows)], [stepped[0], stepped[3]]
    )
    last = [row for row in rows if int(row["shot"]) == stepped[3]]
    checks.equal(
        "ranges in the CSV file",
        [float(row["range_m"]) for row in last],
        [each["range_m"] for each in marked["returns"]],
    )
    checks.equal(
        "positions in the CSV file",
        [[float(row[axis]) for axis in "xyz"] for row in last],
        [each["position"] for each in marked["returns"]],
    )


def check_saved(checks, tab):
    """Pictures of shot and map are saved."""
    tab.get_by_role("tab", name="Shot").click()
    name, svg = saved(tab, lambda: tab.get_by_role("button", name="Save SVG").click())
    shot = tab.evaluate("wavexView.shot().shot")
    checks.that("name of the picture", name.endswith(f"_shot_{shot}.svg"), name)
    checks.that("the picture is SVG", ElementTree.fromstring(svg).tag == "{http://www.w3.org/2000/svg}svg")
    for what, press in [
        ("picture", lambda: tab.get_by_role("button", name="Save PNG").click()),
        ("map", lambda: tab.locator("#save-map").click()),
    ]:
        _, png = saved(tab, press)
        size = [int.from_bytes(png[at : at + 4], "big") for at in (16, 20)]
        checks.that(
            f"the {what} is PNG",
            png.startswith(b"\x89PNG") and min(size) > 300 and len(png) > 10_000,
            f"{size}, {len(png)} bytes",
        )


def check_views(checks, tab):
    """Profile, scan line and perspective."""
    box = tab.locator("#stage").bounding_box()
    place = lambda x, y: (box["x"] + x * box["width"], box["y"] + y * box["height"])  # noqa: E731
    tab.locator("#fit").click()
    wait(tab, "wavexView.isComplete()")
    tab.keyboard.press("l")
    tab.mouse.move(*place(0.25, 0.5))
    tab.mouse.down()
    tab.mouse.move(*place(0.75, 0.52), steps=4)
    tab.mouse.up()
    wait(tab, "/[1-9]\\d* points/.test(document.getElementById('dock-title').textContent)")
    checks.that("the profile is drawn", tab.locator("#dock-canvas").is_visible())
    tab.keyboard.press("t")
    wait(tab, "/Scan line \\d/.test(document.getElementById('dock-title').textContent)")
    line = tab.locator("#dock-canvas").bounding_box()
    select(tab, lambda: tab.mouse.click(line["x"] + 0.6 * line["width"], line["y"] + 0.4 * line["height"]))
    tab.keyboard.press("Escape")
    tab.keyboard.press("2")
    wait(tab, "wavexView.isComplete()")
    shot = tab.evaluate("wavexView.shot().shot")
    index = next(
        i
        for i in range(0, 10_000, 7)
        if (at := tab.evaluate(f"wavexView.screenOf({i})")) and place(0.3, 0.3) < tuple(at) < place(0.7, 0.7)
    )
    tab.mouse.click(*tab.evaluate(f"wavexView.screenOf({index})"))
    wait(tab, f"wavexView.shot().shot !== {shot}")
    tab.keyboard.press("1")


def check_looks(checks, browser, address):
    """Light and dark, wide and narrow: no horizontal scroll, contrast, no error."""
    for scheme, width, height in [("light", 1280, 800), ("dark", 1280, 800), ("light", 390, 844), ("dark", 390, 844)]:
        with checks.of(f"{scheme}, {width} px"), opened(browser, address, scheme, width, height) as (tab, errors):
            tab.keyboard.press("f")
            tab.keyboard.press("Escape")
            select(tab, lambda: tab.get_by_role("button", name="Worst fits").click())
            for page in ["Shot", "What if", "Find", "Marks"]:
                tab.get_by_role("tab", name=page).click()
                # What scrolls inside of the page may be wider or covered.
                defects = [
                    text for text in tab.evaluate(MEASURE, False) if re.match(r"the page is|contrast|[\d.]+ px:", text)
                ]
                checks.equal(f"{page}: layout and contrast", defects, [])
            background = tab.evaluate("getComputedStyle(document.body).backgroundColor")
            checks.that(
                "background", (max(map(int, re.findall(r"\d+", background)[:3])) < 60) == (scheme == "dark"), background
            )
            checks.equal("no error", errors, [])


def main(wavex):
    """Checks the page."""
    path = browser_path()
    if path is None:
        print("SKIPPED: the page of wavex view, because there is no Chromium")
        return 0
    checks = Checks()
    wavex = str(Path(wavex).resolve())
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        folder = Path(folder)
        run(
            wavex,
            folder,
            "recording",
            "[job]\noutput_dir = '.'\nreport = ''\nstat_log = ''\nlog = ''\n[[stage]]\n"
            + SIMULATE.format(seed=3, lines=40).replace("wood_ratio = 0.2", "wood_ratio = 0.5")
            + "stem = 'flight'\n[[stage]]\ntype = 'write_arrow'\n",
        )
        recording = folder / "flight.arrow"
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        with served(wavex, recording) as (address, server):
            with opened(browser, address) as (tab, errors):
                parts = [
                    ("shot", check_shot, (wavex, recording)),
                    ("what if", check_what_if, (wavex, recording, errors)),
                    ("find", check_find, ()),
                    ("export", check_saved, ()),
                    ("views", check_views, ()),
                ]
                for subject, check, more in parts:
                    with checks.of(subject):
                        check(checks, tab, *more)
                checks.equal("no error", errors, [])
                check_looks(checks, browser, address)
                check_tools(checks, browser, wavex, folder)
                with checks.of("server"):
                    server.terminate()
                    server.wait()
                    tab.keyboard.press("]")
                    tab.locator("#lost").wait_for(state="visible")
                    checks.that("the page says that the server has gone", True)
        browser.close()
    return checks.end()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
