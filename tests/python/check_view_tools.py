"""Checks of the tools of the viewer, on files of points whose content is known.

`check_view.py` calls `check_tools`. Points are a grid of 1 m with two strips, several classes and returns, and
with deviation ratios; one file has in addition a withheld return far below the ground.
"""

import os
import re
from pathlib import Path

import laspy
import numpy as np

from view_page import opened, pixels, select, served, wait

COLUMNS, ROWS, STEP_M = 120, 100, 1.0
ORIGIN = np.array([500_000.0, 5_300_000.0, 400.0])
CLASSES = {2: "2 ground", 6: "6 building", 5: "5 high vegetation"}
POOR = 70
LOW_M = -1500.0


def write_points(path, has_outlier, poor):
    """Writes the grid with `poor` fits above a deviation ratio of 3; returns its positions."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = ORIGIN, [0.001] * 3
    header.add_extra_dims([
        laspy.ExtraBytesParams(name="Deviation", type=np.int16, scales=[0.1], offsets=[0.0]),
        laspy.ExtraBytesParams(name="Total uncertainty", type=np.float32),
    ])
    las = laspy.LasData(header)
    column, row = (axis.ravel() for axis in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)))
    # A hill with a house of 8 m.
    height = 6.0 * np.sin(column / 24.0) * np.cos(row / 30.0)
    is_house = (abs(column - 60) < 12) & (abs(row - 50) < 10)
    height[is_house] = 14.0
    places = ORIGIN + np.column_stack([column * STEP_M, row * STEP_M, height])
    number = np.arange(len(places))
    if has_outlier:
        places = np.vstack([places, places[1000] + [0.3, 0.3, LOW_M]])
        number = np.append(number, len(number))
    n = len(places)
    las.x, las.y, las.z = places.T
    las.intensity = 100 + number % 900
    las.return_number = 1 + number % 2
    las.number_of_returns = np.full(n, 2)
    las.point_source_id = np.where(number < n // 2, 7, 12)
    classes = np.full(n, 2)
    classes[: len(is_house)][is_house] = 6
    classes[: COLUMNS] = 5
    las.withheld = np.zeros(n, dtype=bool)
    if has_outlier:
        classes[-1] = 7
        las.withheld[-1] = 1
    las.classification = classes
    deviation = (number % 20) / 10.0
    deviation[:poor] = 3.0 + np.arange(poor) / 10.0
    las["Deviation"] = deviation
    las["Total uncertainty"] = 0.01 + number * 1e-5
    las.write(path)
    return places


def position_of(tab, index):
    """Position of a point by its index on the page."""
    return tab.evaluate(f"fetch(`point?generation=${{wavexView.generation()}}&index={index}`)"
                        ".then((answer) => answer.json()).then((point) => point.position)")


def place(tab, x, y):
    """Window position of a part of the stage."""
    box = tab.locator("#stage").bounding_box()
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def settle(tab):
    """Waits until the view rests and is complete."""
    tab.wait_for_timeout(300)
    wait(tab, "wavexView.isComplete()")


def show_all(tab):
    tab.locator("#fit").click()
    settle(tab)


def check_outlier(checks, tab):
    """A withheld return far below the ground does not set the range of the perspective view."""
    tab.keyboard.press("2")
    settle(tab)
    drawn = pixels(tab)["drawn"]
    checks.that("points fill the perspective view", drawn > 0.04, f"{100 * drawn:.2f} % of the pixels")
    tab.keyboard.press("1")
    settle(tab)


def check_measure(checks, tab):
    """Two clicks measure horizontal, vertical and 3-D distance."""
    # Beside all that lies over the map, also on narrow windows.
    first, second = 40 * COLUMNS + 68, 70 * COLUMNS + 20
    for view in ("1", "2"):
        tab.keyboard.press(view)
        show_all(tab)
        tab.keyboard.press("d")
        checks.equal("the button is pressed", tab.locator("#measure").get_attribute("aria-pressed"), "true")
        for index in (first, second):
            tab.mouse.click(*tab.evaluate(f"wavexView.screenOf({index})"))
        result = tab.evaluate("wavexView.measured()")
        a, b = np.array(result["from"]), np.array(result["to"])
        # From the side, a nearer point may be in front.
        if view == "1":
            checks.within("measured points", [a, b], [position_of(tab, first), position_of(tab, second)], 0.001)
        horizontal, height = np.hypot(*(b - a)[:2]), (b - a)[2]
        checks.that("the points differ", horizontal > 1.0, str(result))
        checks.within("distances", [result["horizontal"], result["height"], result["distance"]],
                      [horizontal, height, np.linalg.norm(b - a)], 1e-6)
        sign = "−" if height < 0 else "+"
        text = (f"distance {np.linalg.norm(b - a):.3f} m · horizontal {horizontal:.3f} m · "
                f"height {sign}{abs(height):.3f} m")
        checks.equal("distances are shown", tab.locator("#hint").inner_text(), text)
        tab.keyboard.press("Escape")
        checks.equal("Esc ends the measurement", tab.evaluate("wavexView.measured()"), None)
    tab.keyboard.press("1")
    show_all(tab)
    # Beside all points.
    tab.keyboard.press("d")
    tab.mouse.click(*place(tab, 0.5, 0.02))
    checks.that("a click beside the points says so", "no point here" in tab.locator("#message").inner_text())
    tab.keyboard.press("Escape")
    # By the keyboard: a search moves the map to a point, the space bar clicks in its middle.
    tab.keyboard.press("f")
    tab.fill("#find-where", "intensity = 500")
    tab.keyboard.press("Enter")
    wait(tab, "wavexView.found().length > 0")
    tab.keyboard.press("Escape")
    settle(tab)
    tab.locator("#stage").focus()
    tab.keyboard.press("d")
    tab.keyboard.press("Space")
    checks.equal("the space bar clicks", tab.locator("#hint").inner_text(), "Click the second point.")
    for _ in range(2):
        tab.keyboard.press("ArrowLeft")
    settle(tab)
    tab.keyboard.press("Space")
    result = tab.evaluate("wavexView.measured()")
    checks.that("arrows move to the second point", result is not None and result["horizontal"] > 1.0, str(result))
    tab.keyboard.press("Escape")
    tab.get_by_role("button", name="Clear", exact=True).click()
    show_all(tab)


def inside(polygon, places):
    """Whether places are in a polygon, by its winding."""
    x, y = places[:, 0], places[:, 1]
    result = np.zeros(len(places), dtype=bool)
    for (xi, yi), (xj, yj) in zip(polygon, np.roll(polygon, 1, axis=0)):
        crosses = (yi > y) != (yj > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            result ^= crosses & (x < (xj - xi) * (y - yi) / (yj - yi) + xi)
    return result


def check_clip(checks, tab, places):
    """A box or polygon hides the points outside of it; the button shows them again."""
    show_all(tab)
    all_shown = tab.evaluate("wavexView.pointsShown()")
    checks.equal("all points are shown", all_shown, len(places))
    origin = np.array(tab.evaluate("fetch('info').then((answer) => answer.json()).then((info) => info.origin)"))

    def check(what):
        settle(tab)
        corners = np.array(tab.evaluate("wavexView.clip()")["corners"]) + origin[:2]
        expected = int(inside(corners, places).sum())
        checks.that(f"{what}: is within the points", 20 < expected < len(places) // 2, str(expected))
        checks.equal(f"{what}: points shown", tab.evaluate("wavexView.pointsShown()"), expected)
        hidden = next(i for i in range(0, len(places), 7)
                      if not inside(corners, np.array([position_of(tab, i)]))[0])
        checks.equal(f"{what}: a hidden point has no place", tab.evaluate(f"wavexView.screenOf({hidden})"), None)
        tab.keyboard.press("2")
        settle(tab)
        checks.equal(f"{what}: points shown in perspective", tab.evaluate("wavexView.pointsShown()"), expected)
        tab.keyboard.press("1")
        settle(tab)

    tab.keyboard.press("x")
    tab.mouse.move(*place(tab, 0.4, 0.4))
    tab.mouse.down()
    tab.mouse.move(*place(tab, 0.6, 0.55), steps=4)
    tab.mouse.up()
    check("box")
    checks.equal("the button clears", tab.locator("#clip").inner_text(), "Clear clip")
    tab.locator("#clip").click()
    settle(tab)
    checks.equal("all points are shown again", tab.evaluate("wavexView.pointsShown()"), all_shown)
    corners = [(0.35, 0.35), (0.65, 0.4), (0.5, 0.7)]
    for what, close in [
        ("polygon, closed at its first corner", lambda: tab.mouse.click(*place(tab, *corners[0]))),
        ("polygon, closed by Enter", lambda: tab.keyboard.press("Enter")),
        ("polygon, closed by a double click", lambda: tab.mouse.dblclick(*place(tab, 0.4, 0.6))),
    ]:
        show_all(tab)
        tab.keyboard.press("x")
        for corner in corners:
            tab.mouse.click(*place(tab, *corner), delay=30)
            # Two clicks in a row are a double click.
            tab.wait_for_timeout(600)
        close()
        check(what)
        tab.keyboard.press("x")
        settle(tab)
        checks.equal(f"{what}: cleared", tab.evaluate("wavexView.clip()"), None)


def check_profile(checks, tab, places):
    """Two clicks draw the line of a profile; its points are those beside the line."""
    show_all(tab)
    tab.keyboard.press("l")
    tab.mouse.click(*place(tab, 0.3, 0.45))
    tab.mouse.move(*place(tab, 0.5, 0.5))
    checks.equal("no profile after one click", tab.evaluate("wavexView.profile()"), None)
    tab.wait_for_timeout(600)
    tab.mouse.click(*place(tab, 0.7, 0.55))
    wait(tab, "/[1-9]\\d* points/.test(document.getElementById('dock-title').textContent)")
    line = tab.evaluate("wavexView.profile()")
    origin = np.array(tab.evaluate("fetch('info').then((answer) => answer.json()).then((info) => info.origin)"))
    start, end = (np.array(line[name][:2]) + origin[:2] for name in ("from", "to"))
    along = (end - start) / np.linalg.norm(end - start)
    offset = places[:, :2] - start
    t, across = offset @ along, offset @ np.array([-along[1], along[0]])
    expected = int(((t >= 0) & (t <= np.linalg.norm(end - start)) & (abs(across) <= line["width_m"] / 2)).sum())
    title = tab.locator("#dock-title").inner_text()
    shown = int(re.search(r"([\d\u202f]+) points", title)[1].replace("\u202f", ""))
    checks.that("points of the profile", expected > 10 and abs(shown - expected) <= 1, f"{title}, {expected} expected")
    ground = tab.evaluate("wavexView.ground()")
    checks.that("the house interrupts the ground", len(ground) == 2, f"{len(ground)} parts")
    checks.that("the title explains the line", title.endswith("; line: median of the ground"), title)
    places = [(start - ORIGIN[:2] + along * at, height - ORIGIN[2]) for part in ground for at, height in part]
    errors = [abs(height - 6.0 * np.sin(x / 24.0) * np.cos(y / 30.0)) for (x, y), height in places]
    checks.that("heights of the ground", len(errors) > 10 and max(errors) < 0.5, f"{len(errors)}, {max(errors, default=0):.2f} m")
    tab.keyboard.press("Escape")


def check_colours(checks, tab):
    """Class, intensity, return number, standard deviation and strip colour the points."""
    show_all(tab)
    options = tab.evaluate("[...document.querySelectorAll('#attribute option')].map((one) => one.value)")
    wanted = ["class", "intensity", "return_number", "total_sd_m", "input"]
    checks.that("attributes are offered", set(wanted) <= set(options), str(options))
    seen = set()
    for name in wanted:
        tab.select_option("#attribute", name)
        settle(tab)
        found = pixels(tab)
        seen.add(found["checksum"])
        labels = tab.locator("#legend-body button").all_inner_texts()
        expected = {"class": sorted(CLASSES.values()), "return_number": ["1", "2"],
                    "input": ["strip 12", "strip 7"]}.get(name, [])
        checks.equal(f"{name}: legend", sorted(labels), expected)
        least = 50 if not expected else len(expected)
        checks.that(f"{name}: colours", found["colours"] >= least, f"{found['colours']} colours")
    checks.equal("each attribute colours differently", len(seen), len(wanted))
    tab.select_option("#attribute", "class")
    tab.locator("#legend-body button", has_text="6 building").click()
    settle(tab)
    shown = tab.evaluate("wavexView.pointsShown()")
    checks.that("a class is hidden", 0 < shown < COLUMNS * ROWS, str(shown))
    tab.locator("#legend-body button", has_text="6 building").click()
    tab.select_option("#attribute", "height_m")
    settle(tab)


def check_columns(checks, tab, places):
    """The columns are listed with their ranges, and complete a condition."""
    tab.keyboard.press("f")
    tab.keyboard.press("Escape")
    tab.locator("#columns summary").click()
    rows = tab.evaluate("[...document.querySelectorAll('#columns tbody tr')]"
                        ".map((row) => [...row.children].map((cell) => cell.textContent))")
    columns = {name: text for name, _, text in rows}
    digits = lambda value: f"{float(f'{value:.4g}'):g}"  # noqa: E731
    low, high = places[:, 2].min(), places[:, 2].max()
    checks.equal("range of heights", columns.get("height_m"), f"{digits(low)} to {digits(high)}\u202fm")
    checks.equal("range of intensities", columns.get("intensity"), "100 to 999")
    checks.equal("values of return numbers", columns.get("return_number"), "1, 2")
    tab.fill("#find-where", "return_number = 2")
    tab.locator("#columns button", has_text="intensity").click()
    checks.equal("a column is added", tab.input_value("#find-where"), "return_number = 2, intensity ")
    tab.fill("#find-where", "")
    tab.keyboard.press("Escape")


def check_worst(checks, tab):
    """The worst fits end at a deviation ratio of 3, and after 50 shots."""
    tab.keyboard.press("f")
    tab.keyboard.press("Escape")
    tab.get_by_role("button", name="Worst fits").click()
    wait(tab, "wavexView.found().length > 0")
    values = [each["value"] for each in tab.evaluate("wavexView.found()")]
    checks.that("worst fits in order", values == sorted(values, reverse=True))
    checks.equal("number of worst fits", len(values), 50)
    checks.that("worst fits are poor", min(values) >= 3.0, str(min(values)))
    text = tab.locator("#found-count").inner_text()
    checks.equal("count of worst fits", text, f"{POOR} returns; first 50 shots listed")


def check_no_worst(checks, tab):
    """Without poor fits, the list says so."""
    tab.keyboard.press("f")
    tab.keyboard.press("Escape")
    tab.get_by_role("button", name="Worst fits").click()
    tab.locator("#found-none").wait_for()
    text = tab.locator("#found-none").inner_text()
    checks.equal("no worst fits", text, "No fit has a deviation ratio of 3 or more; the largest is 1.9.")


def check_point(checks, tab, path):
    """A file without waveforms says why, and shows the values of a point."""
    tab.get_by_role("tab", name="Point").click()
    reason = tab.locator("#without-waveforms").inner_text()
    checks.that("says why there are no waveforms", "points without waveforms" in reason and path.name in reason, reason)
    checks.equal("nothing to decompose", tab.locator("#tab-what-if").is_visible(), False)
    checks.equal("no scan lines", tab.locator("#show-line").is_visible(), False)
    show_all(tab)
    before, expected = tab.evaluate("String(wavexView.point()?.position)"), position_of(tab, 7260)
    tab.mouse.click(*tab.evaluate("wavexView.screenOf(7260)"))
    wait(tab, f"String(wavexView.point()?.position) !== '{before}'")
    point = tab.evaluate("wavexView.point()")
    checks.equal("the clicked point", point["position"], expected)
    table = tab.locator("#point").inner_text()
    checks.that("its values are shown", f"{point['position'][2]:.3f}" in table and "intensity" in table, table)


def check_shading(checks, tab):
    """Shapes are shaded in perspective only; a key switches it."""
    show_all(tab)
    for view, differs in (("1", False), ("2", True)):
        tab.keyboard.press(view)
        settle(tab)
        shaded = pixels(tab)
        tab.keyboard.press("v")
        settle(tab)
        flat = pixels(tab)
        tab.keyboard.press("v")
        settle(tab)
        ratio = shaded["brightness"] / flat["brightness"]
        checks.that(f"view {view}: shading darkens", (0.4 < ratio < 0.98) == differs, f"{ratio:.3f}")
        checks.equal(f"view {view}: the same points", round(shaded["drawn"], 4), round(flat["drawn"], 4))
    tab.keyboard.press("1")
    settle(tab)


def check_help(checks, tab):
    """The help lists the keys of the tools."""
    tab.keyboard.press("?")
    keys = tab.locator("#help kbd").all_inner_texts()
    checks.that("keys of the tools", {"d", "x", "l", "v", "Space", "Enter"} <= set(keys), str(keys))
    tab.keyboard.press("Escape")


def check_tools(checks, browser, wavex, folder):
    """Checks the tools on two files of points, in a folder."""
    scene, clean = Path(folder) / "scene.laz", Path(folder) / "clean.las"
    places = write_points(scene, False, POOR)
    write_points(clean, True, 0)
    with served(wavex, scene) as (address, _):
        with opened(browser, address) as (tab, errors):
            for subject, check, more in [
                ("distance", check_measure, ()),
                ("clip", check_clip, (places,)),
                ("profile", check_profile, (places,)),
                ("colours", check_colours, ()),
                ("columns", check_columns, (places,)),
                ("worst fits", check_worst, ()),
                ("points", check_point, (scene,)),
                ("shading", check_shading, ()),
                ("help", check_help, ()),
            ]:
                with checks.of(subject):
                    check(checks, tab, *more)
            checks.equal("no error", errors, [])
        with checks.of("WebGL"), opened(browser, address + "#webgl") as (tab, errors):
            checks.equal("painter", tab.evaluate("wavexView.painter()"), "WebGL")
            check_shading(checks, tab)
            check_clip(checks, tab, places)
            checks.equal("no error", errors, [])
        with checks.of("390 px"), opened(browser, address, width=390, height=844) as (tab, errors):
            for button in ("measure", "clip", "draw-profile"):
                box = tab.locator(f"#{button}").bounding_box()
                checks.that(f"{button} is within the window", box["x"] >= 0 and box["x"] + box["width"] <= 390, str(box))
            check_measure(checks, tab)
    with served(wavex, clean) as (address, _), opened(browser, address) as (tab, errors):
        with checks.of("an outlier"):
            check_outlier(checks, tab)
        with checks.of("no poor fit"):
            check_no_worst(checks, tab)
        checks.equal("no error", errors, [])
    data = os.environ.get("WAVEX_DATA")
    if data is None:
        print("skipped: the perspective view of a real recording, because WAVEX_DATA is not set")
        return
    # One of its 84 726 returns is 245 m below the ground, and withheld.
    with served(wavex, Path(data) / "pulsewaves/riegl_example4.pls") as (address, _):
        with checks.of("a real outlier"), opened(browser, address) as (tab, errors):
            check_outlier(checks, tab)
            checks.equal("no error", errors, [])
