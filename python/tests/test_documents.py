"""The code of `docs/how-to/python.md`, in the order of the page."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import wavex

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "python.md"
NEON = Path(os.environ.get("WAVEX_DATA", "/nowhere")) / "neon"


def neon_tables(folder: Path) -> None:
    """Waveforms and positions in NEON's layout, without NEON's data: echoes of 15 ns, rows filled with zeros."""
    random = np.random.default_rng(1)
    k, peak = np.arange(208), random.uniform(30, 50, 300)
    pulse = np.exp(-4 * np.log(2) * ((k - peak[:, None]) / 15) ** 2)
    samples = np.round(220 + 400 * pulse + random.normal(0, 1, pulse.shape)).astype(int)
    samples[k >= random.integers(80, 120, 300)[:, None]] = 0
    head = ",".join(f"V{n + 1}" for n in range(208))
    np.savetxt(folder / "return_1_250.csv", samples, "%d", ",", header=head, comments="")
    first = [731126.6, 4712693.0, 339.0889, 0.000218527, 0.02021472, -0.1484873]
    peaks = np.array(first[:3]) + peak[:, None] * np.array(first[3:])
    rows = np.hstack([np.arange(1, 301)[:, None], peaks, np.tile([*first[3:], 18.5, 23.1, *first, 25, 0], (300, 1))])
    head = "index,x,y,z,dx,dy,dz,or,fr," + ",".join(f"V{n}" for n in range(9, 17))
    np.savetxt(folder / "geo_1_250.csv", rows, "%.9g", ",", header=head, comments="")


def blocks() -> list[str]:
    """Python code of the page; the recording is a container here."""
    text = PAGE.read_text().replace("flight7.pls", "flight.arrow").replace("read_pulsewaves", "read_arrow")
    return re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("is_real", [False, True], ids=["simulated", "neon"])
def test_the_page_runs(flight, folder, monkeypatch, is_real):
    for library in ["duckdb", "pandas", "polars"]:
        pytest.importorskip(library, reason=f"SKIPPED: {library} is not installed")
    if is_real and not NEON.is_dir():
        pytest.skip("SKIPPED: WAVEX_DATA has no folder neon")
    monkeypatch.chdir(folder)
    waveforms = flight.waveforms(lines=[0, 1])
    rows = [row[:length].tolist() for row, length in zip(waveforms.samples, waveforms.lengths)]
    Path("waveforms.csv").write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    if is_real:
        for name in ["return_1_250.csv", "geo_1_250.csv"]:
            shutil.copy(NEON / name, name)
    else:
        neon_tables(folder)
    seen: dict = {}
    codes = blocks()
    assert len(codes) >= 8
    for code in codes:
        exec(compile(code, str(PAGE), "exec"), seen)
        if "waveforms.csv" in code:
            assert seen["found"]["waveform"].nunique() > 0.95 * len(rows)
        if "geo_1_250.csv" in code:
            check_neon(seen)
    assert (folder / "out2" / "flight.laz").exists()


def check_neon(seen: dict) -> None:
    """First returns are near the instrument's own, whose reference is the leading edge."""
    first = seen["found"]["return_number"] == 1
    assert first.mean() > 0.5 and first.sum() > 0.9 * len(seen["samples"])
    for name in "xyz":
        difference = (seen[name] - seen["geo"][name])[first]
        assert abs(np.median(difference)) < 1.0, name
        assert np.percentile(np.abs(difference), 90) < 2.0, name
