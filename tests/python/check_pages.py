"""Checks the HTML pages of a run, a survey, a recording and alignments in headless Chromium.

    python check_pages.py WAVEX

For each page, in light, dark, narrow (390 px) and print: no horizontal scroll, no overlapping or
broken texts, no clipped table, contrast AA, keyboard access, and less than 4 MB. The printed sheets
are checked by `pdftotext` (poppler-utils), if it is there: no overlapping words, none outside of the
margins, no heading at the end of a sheet. With WAVEX_DATA, also the page of a recording. Skipped with
a message if there is no Chromium.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

BROWSERS = ["chromium", "chromium-browser", "google-chrome"]
MOST_BYTES = 4_000_000
# Width of a page of A4 without margins of 12 mm, CSS pixels.
PRINT_PX = 703

SIMULATE = """type = "simulate"
seed = {seed}
scene_seed = 7
landscape = "country"
relief_m = 8.0
wood_ratio = 0.2
water_ratio = 0.0
flying_height_m = 200.0
scan_angle_deg = [-25.0, 25.0]
shots_per_line = 200
pulse_rate_hz = 20000.0
lines = {lines}
"""
STAGES = """[[stage]]
type = "calibrate"
waveforms = 2000
[[stage]]
type = "decompose"
[[stage]]
type = "georeference"
[[stage]]
type = "write_las"
"""

# Defects of the shown page, as a list of texts.
MEASURE = r"""(print) => {
  const found = [];
  const channels = (colour) => (colour.match(/[\d.]+/g) || []).map(Number);
  const luminance = (colour) => {
    const linear = channels(colour).slice(0, 3).map((c) => c / 255)
      .map((c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
  };
  const contrast = (a, b) => {
    const [light, dark] = [luminance(a), luminance(b)].sort((x, y) => y - x);
    return (light + 0.05) / (dark + 0.05);
  };
  const background = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = getComputedStyle(at).backgroundColor;
      const alpha = channels(colour)[3];
      if (alpha === undefined || alpha > 0) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const drawn = (element) => element.namespaceURI.endsWith("svg");
  if (document.documentElement.scrollWidth > innerWidth) {
    found.push(`the page is ${document.documentElement.scrollWidth} px wide`);
  }
  const texts = [];
  for (const element of document.body.querySelectorAll("*")) {
    for (const node of element.childNodes) {
      if (node.nodeType !== 3 || !node.data.trim() || element.tagName === "title") continue;
      const range = document.createRange();
      range.selectNodeContents(node);
      const style = getComputedStyle(element);
      const text = node.data.trim().slice(0, 50);
      const ratio = contrast(drawn(element) ? style.fill : style.color, background(element));
      if (!(ratio >= 4.5)) found.push(`contrast ${ratio.toFixed(2)}: ${text}`);
      const matrix = drawn(element) ? element.getScreenCTM() : null;
      const size = parseFloat(style.fontSize) * (matrix ? Math.hypot(matrix.a, matrix.b) : 1);
      if (size < (print ? 8 : 9.5)) found.push(`${size.toFixed(1)} px: ${text}`);
      const scroll = element.closest(".scroll");
      for (const box of range.getClientRects()) {
        texts.push({ text, box, node, scroll, svg: element.closest("svg") });
        if (print && (box.right > innerWidth + 1 || box.left < -1)) found.push(`clipped in print: ${text}`);
      }
      // A word is on one line, unless it is a path or a list of keys.
      const may = element.closest("td:not(.wide td), .text, h1, .notes, li, p, a, figcaption, .wide td:first-child");
      if (!drawn(element) && !may) {
        for (const word of node.data.matchAll(/\S+/g)) {
          range.setStart(node, word.index);
          range.setEnd(node, word.index + word[0].length);
          const lines = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
          if (lines.size > 1) found.push(`broken word: ${word[0]}`);
        }
      }
    }
  }
  const groups = new Map();
  for (const text of texts) {
    const key = text.svg || text.scroll || document.body;
    groups.set(key, [...(groups.get(key) || []), text]);
  }
  for (const [group, members] of groups) {
    const around = group.getBoundingClientRect();
    members.sort((a, b) => a.box.top - b.box.top);
    members.forEach((a, i) => {
      if (a.svg && (a.box.left < around.left - 1 || a.box.right > around.right + 1
                    || a.box.top < around.top - 1 || a.box.bottom > around.bottom + 1)) {
        found.push(`outside of its picture: ${a.text}`);
      }
      for (let j = i + 1; j < members.length && members[j].box.top < a.box.bottom; j += 1) {
        const b = members[j];
        const wide = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const high = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        if (a.node !== b.node && wide > 1 && high > 4) found.push(`overlapping: ${a.text} | ${b.text}`);
      }
    });
    if (group.tagName !== "svg") continue;
    const frames = [...group.querySelectorAll("rect.frame")].map((frame) => frame.getBoundingClientRect());
    // Labels of one axis differ: those in a row below a frame, or in a column left of it.
    for (const [side, along] of [["top", "left"], ["right", "top"]]) {
      const rows = new Map();
      for (const { text, box } of members.filter(({ text }) => /^[−\d]/.test(text))) {
        const middle = (box.top + box.bottom) / 2;
        const frame = frames.findIndex(({ top, bottom }) => top - 5 < middle && middle < bottom + 5);
        const place = box[side] + (side === "right" ? 1e5 * frame : 0);
        const key = [...rows.keys()].find((at) => Math.abs(at - place) < 2) ?? place;
        rows.set(key, [...(rows.get(key) || []), [text, box[along]]]);
      }
      for (const row of rows.values()) {
        const sorted = row.sort((a, b) => a[1] - b[1]).map(([text]) => text);
        sorted.slice(1).forEach((text, i) => text === sorted[i] && found.push(`repeated label: ${text} in ${group.getAttribute("aria-label")}`));
      }
    }
  }
  for (const table of document.querySelectorAll("table")) {
    const scroll = table.closest(".scroll");
    const limit = print || !scroll ? innerWidth : Infinity;
    if (table.getBoundingClientRect().right > limit + 1) found.push(`clipped table: ${table.innerText.slice(0, 40)}`);
  }
  return [...new Set(found)];
}"""

# Whether all that scrolls or folds can be reached and left by the keyboard.
KEYBOARD = """() => {
  const wanted = [...document.querySelectorAll("a[href], summary, .scroll")].length;
  const broken = [...document.querySelectorAll('a[href^="#"]')]
    .map((link) => link.getAttribute("href")).filter((href) => !document.getElementById(href.slice(1)));
  return [wanted, broken];
}"""


WORD = re.compile(r'<word xMin="([\d.]+)" yMin="([\d.]+)" xMax="([\d.]+)" yMax="([\d.]+)">(.*?)</word>')
SHEET = re.compile(r'<page width="([\d.]+)" height="([\d.]+)">(.*?)</page>', re.DOTALL)
# Margin of a sheet, points (12 mm), and the tolerance of boxes of words.
MARGIN_PT, TOLERANCE_PT = 34.0, 3.0


def sheets(pdf):
    """Width, height and words (box and text) of each sheet of a PDF."""
    boxes = subprocess.run(["pdftotext", "-bbox", pdf, "-"], check=True, capture_output=True, text=True).stdout
    return [(float(width), float(height), [([float(at) for at in word[:4]], word[4]) for word in WORD.findall(text)])
            for width, height, text in SHEET.findall(boxes)]


def sheet_defects(pdf, headings):
    """Words that overlap or lie in the margins, and headings at the end of a sheet."""
    defects = []
    of_pdf = sheets(pdf)
    for number, (width, _, words) in enumerate(of_pdf, 1):
        words.sort(key=lambda word: word[0][1])
        for i, ((left, top, right, bottom), text) in enumerate(words):
            if left < MARGIN_PT - TOLERANCE_PT or right > width - MARGIN_PT + TOLERANCE_PT:
                defects.append(f"sheet {number}: in the margin: {text}")
            for (other_left, other_top, other_right, other_bottom), other in words[i + 1:]:
                if other_top >= bottom:
                    break
                wide = min(right, other_right) - max(left, other_left)
                high = min(bottom, other_bottom) - max(top, other_top)
                # Boxes of lines are as high as their font and overlap by less than this.
                is_halo = text == other and abs(left - other_left) < 1
                if not is_halo and wide > 1 and high > 0.4 * min(bottom - top, other_bottom - other_top):
                    defects.append(f"sheet {number}: overlapping: {text} | {other}")
        if words and number < len(of_pdf):
            lowest = max(box[3] for box, _ in words)
            last = " ".join(text for box, text in sorted(words) if lowest - box[3] < 3)
            if any(last.startswith(heading) and len(last) < len(heading) + 15 for heading in headings):
                defects.append(f"sheet {number}: ends with a heading: {last}")
    return defects


def browser_path():
    """Path of an installed Chromium; None if there is none."""
    return next((path for path in map(shutil.which, BROWSERS) if path), None)


def run(wavex, folder, name, text, expected=0):
    """Runs a job."""
    job = folder / f"{name}.toml"
    job.write_text(text)
    ended = subprocess.run([wavex, "--quiet", "run", job], capture_output=True, text=True)
    assert ended.returncode == expected, f"{name}: {ended.stderr}"


ALIGNED = """[job.geometry]
trajectory = "*.out"
calibration = {{ boresight_deg = [{roll_deg}, 0.0, 0.0] }}
[[stage]]
type = "read_arrow"
path = "?_strip.arrow"
[[stage]]
type = "calibrate"
waveforms = 2000
response = "gaussian"
[[stage]]
type = "decompose"
mode = "fastest"
[[stage]]
type = "georeference"
"""


def make_alignments(wavex, folder):
    """Makes the pages of a good, a doubtful and a bad alignment of four strips, of which one is elsewhere."""
    strips = [("a", 0.0, [0.0, 0.0], 160), ("b", 180.0, [-30.0, 100.0], 160), ("c", 90.0, [-40.0, 50.0], 160),
              ("d", 0.0, [3000.0, 0.0], 40)]
    off = "report = ''\nstat_log = ''\nlog = ''\n"
    for number, (stem, course_deg, offset_m, lines) in enumerate(strips):
        run(wavex, folder, f"to_align_{stem}", f"[job]\noutput_dir = 'align'\n{off}" + f"""[[stage]]
type = "simulate"
stem = "{stem}_strip"
seed = {number}
scene_seed = 1
lines = {lines}
shots_per_line = 120
landscape = "country"
wood_ratio = 0.1
water_ratio = 0.0
wire_height_m = 0.0
house_ratio = 0.3
flying_height_m = 120.0
speed_mps = 25.0
pulse_rate_hz = 7000.0
roll_deg = 2.0
pitch_deg = 2.0
motion_period_s = 3.0
track_direction_deg = {course_deg}
track_offset_m = {offset_m}
start_time_s = {208800.0 + 100 * number}
boresight_deg = [0.2, -0.3, 0.4]
noise_sd_dn = 0.5
noise_autocorrelation = []
response = "gaussian"
sbet = "*.out"
[[stage]]
type = "write_arrow"
""")
    whole = (folder / "align/c_strip.arrow").read_bytes()
    (folder / "align/e_strip.arrow").write_bytes(whole[: len(whole) // 2])
    pages = []
    for name, roll_deg, more, expected in [
        ("good", 0.0, ["--trajectory", "0.5"], 0),
        ("doubtful", -7.0, [], 0),
        ("bad", 0.0, ["--set", "job.geometry.mount=[0,0,180]"], 1),
    ]:
        job = folder / "align" / f"{name}.toml"
        job.write_text(f"[job]\noutput_dir = 'out'\n{off}" + ALIGNED.format(roll_deg=roll_deg))
        output = folder / "align" / name
        ended = subprocess.run([wavex, "--quiet", "align", job, "-o", output, *more], capture_output=True, text=True)
        assert ended.returncode == expected, f"{name}: {ended.stderr}"
        page = folder / f"out/align_{name}.html"
        page.write_text((output / "align.html").read_text())
        assert f">{name}</span>" in page.read_text(), name
        pages.append(page)
    return pages


def make_pages(wavex, folder):
    """Makes the pages of a run, a flight, a survey with a damaged strip, a recording, and alignments."""
    off = "report = ''\nstat_log = ''\nlog = ''\n"
    simulate = "[[stage]]\n" + SIMULATE
    run(wavex, folder, "run", "[job]\noutput_dir = 'out'\nreport_page = true\n"
        + simulate.format(seed=1, lines=60) + "stem = 'strip'\n" + STAGES)
    flight = simulate.format(seed=2, lines=60) + "stem = 'flight'\nsbet = '*.out'\nroll_deg = 5.0\npitch_deg = 2.0\n"
    run(wavex, folder, "recording", f"[job]\noutput_dir = 'in'\n{off}{flight}[[stage]]\ntype = 'write_arrow'\n")
    read = "[[stage]]\ntype = 'read_arrow'\npath = '{}'\n"
    run(wavex, folder, "flight", "[job]\ninput_dir = 'in'\noutput_dir = 'out'\nreport_page = true\n"
        "[job.geometry]\ntrajectory = '*.out'\ncrs = 'utm'\n" + read.format("flight.arrow")
        + STAGES.replace("[[stage]]\ntype = \"write_las\"", "[[stage]]\ntype = \"classify\"\n[[stage]]\ntype = \"write_las\""))
    for seed, stem in enumerate("ab", 1):
        strip = simulate.format(seed=seed, lines=60) + f"stem = '{stem}'\ntrack_offset_m = [{60 * seed}.0, 0.0]\n"
        run(wavex, folder, f"strip_{stem}",
            f"[job]\noutput_dir = 'strips'\n{off}{strip}[[stage]]\ntype = 'write_arrow'\n")
    whole = (folder / "strips/b.arrow").read_bytes()
    (folder / "strips/c.arrow").write_bytes(whole[: len(whole) // 2])
    run(wavex, folder, "strips", "[job]\ninput_dir = 'strips'\noutput_dir = 'out'\nreport_page = true\n"
        "survey_page = true\non_error = 'continue'\n" + read.format("?.arrow") + STAGES, expected=1)
    scan = [wavex, "--quiet", "scan", folder / "in/flight.arrow", "--name", folder / "out/flight"]
    subprocess.run(scan, check=True, capture_output=True)
    names = ["run_report", "flight_report", "strips_report", "strips_survey", "flight_scan"]
    data = os.environ.get("WAVEX_DATA")
    if data is None:
        print("skipped: the page of a real recording, because WAVEX_DATA is not set")
    else:
        pulses = Path(data).resolve() / "riegl_q680i_dev/riegl_q680i_dev.pls"
        run(wavex, folder, "real", f"[job]\noutput_dir = 'out'\nreport_page = true\n"
            f"[[stage]]\ntype = 'read_pulsewaves'\npath = '{pulses}'\n" + STAGES)
        names.append("real_report")
    return [folder / f"out/{name}.html" for name in names] + make_alignments(wavex, folder)


def check_keyboard(tab, name):
    """Every link, fold and table is reached by Tab, in order, and left again."""
    wanted, broken = tab.evaluate(KEYBOARD)
    assert not broken, f"{name}: links without target: {broken}"
    tab.evaluate("document.activeElement.blur()")
    reached = "() => { const at = document.activeElement; at.dataset.reached = 1; return at === document.body; }"
    for _ in range(wanted + 1):
        tab.keyboard.press("Tab")
        if tab.evaluate(reached):
            break
    missed = tab.evaluate("""() => [...document.querySelectorAll("a[href], summary, .scroll")]
        .filter((element) => !element.dataset.reached).map((element) => element.outerHTML.slice(0, 60))""")
    assert not missed, f"{name}: not reached by the keyboard: {missed}"


def check_page(browser, page):
    """Checks a page in all its appearances; returns its defects."""
    defects = []
    if page.stat().st_size >= MOST_BYTES:
        defects.append(f"{page.name}: {page.stat().st_size} bytes")
    looks = [("light", 1280), ("dark", 1280), ("light", 390), ("dark", 390), ("print", PRINT_PX)]
    for look, width in looks:
        scheme = "dark" if look == "dark" else "light"
        context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": 1000})
        tab = context.new_page()
        errors = []
        tab.on("console", lambda message: errors.append(message.text))
        tab.on("request", lambda request: errors.append(request.url) if request.url.startswith("http") else None)
        if look == "print":
            tab.emulate_media(media="print")
        tab.goto(page.resolve().as_uri())
        found = tab.evaluate(MEASURE, look == "print") + errors
        defects += [f"{page.name}, {look}, {width} px: {text}" for text in found]
        if look == "print" and shutil.which("pdftotext"):
            pdf = page.with_suffix(".pdf")
            tab.pdf(path=pdf, prefer_css_page_size=True, format="A4")
            headings = [text.strip() for text in tab.locator("h1, h2, h3, summary").all_inner_texts() if text.strip()]
            defects += [f"{page.name}, {text}" for text in sheet_defects(pdf, headings)]
        if (look, width) == ("light", 1280):
            check_keyboard(tab, page.name)
        context.close()
    return defects


# Each defect that the measurement must notice, in the words of its message.
BAD = """<!DOCTYPE html><body style="background:#fff;width:900px"><p style="color:#aaa">faint</p>
<div class="scroll"><table class="wide"><tr><td>a</td>
<td style="width:20px;max-width:20px;overflow-wrap:anywhere">1000000000</td></tr></table></div>
<table style="width:2000px"><tr><td>wide</td></tr></table>
<svg width="100" height="100"><text x="9" y="50">one</text><text x="12" y="52">two</text>
<text x="5" y="90">7</text><text x="50" y="90">7</text><text x="95" y="20">three</text></svg></body>"""


def check_measure(browser, folder):
    """The measurement notices what is wrong."""
    (folder / "bad.html").write_text(BAD)
    tab = browser.new_page(viewport={"width": 390, "height": 800})
    tab.goto((folder / "bad.html").as_uri())
    found = tab.evaluate(MEASURE, False)
    words = ["px wide", "contrast", "broken word", "clipped table", "overlapping", "repeated label", "outside of"]
    for word in words:
        assert any(word in text for text in found), f"not noticed: {word}: {json.dumps(found)}"
    tab.close()


def main(wavex):
    """Checks all pages."""
    if shutil.which("pdftotext") is None:
        print("SKIPPED: the printed sheets, because there is no pdftotext (poppler-utils)")
    path = browser_path()
    if path is None:
        print("SKIPPED: the pages, because there is no Chromium")
        return
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        folder = Path(folder)
        pages = make_pages(Path(wavex).resolve(), folder)
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        check_measure(browser, folder)
        defects = [defect for page in pages for defect in check_page(browser, page)]
        browser.close()
    assert not defects, "\n".join(defects)
    print(f"{len(pages)} pages: light, dark, narrow and print")


if __name__ == "__main__":
    main(sys.argv[1])
