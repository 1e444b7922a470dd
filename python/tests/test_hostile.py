"""Signals, threads, processes, memory, files that vanish."""

import gc
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import wavex


def rss_mb() -> float:
    """Memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_a_file_deleted_while_open(flight, tmp_path):
    copy = tmp_path / "copy.arrow"
    shutil.copy(flight.path, copy)
    recording = wavex.open(copy)
    assert recording.shot(7).number == 7
    copy.unlink()
    try:
        assert recording.shot(3000).number == 3000
    except wavex.Error as error:
        assert "copy.arrow" in str(error)
    with pytest.raises(wavex.ReadError):
        wavex.decompose(recording).read_all()
    with pytest.raises(wavex.ReadError):
        recording.shots().read_all()


def test_a_file_truncated_while_open(flight, tmp_path):
    copy = tmp_path / "copy.arrow"
    shutil.copy(flight.path, copy)
    recording = wavex.open(copy)
    len(recording.lines)
    os.truncate(copy, 10_000)
    with pytest.raises(wavex.Error):
        recording.shot(3999)


def test_four_threads(flight, model):
    found, expected = [], wavex.decompose(flight, model).read_all()["range_m"]

    def work():
        for number in range(0, 4000, 500):
            assert flight.shot(number).number == number
        found.append(wavex.decompose(flight, model).read_all()["range_m"])
        samples = np.stack([flight.shot(0).samples["low"]] * 100)
        wavex.decompose_samples(samples, 0, model)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    for ranges in found:
        np.testing.assert_array_equal(ranges, expected)


def test_runs_in_threads_wait_for_each_other(folder):
    reports = []

    def work(name):
        reports.append(wavex.run(folder / "job.toml", set={"job.output_dir": name}))

    threads = [threading.Thread(target=work, args=(f"out{n}",)) for n in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(reports) == 3
    assert len({(folder / f"out{n}" / "flight.laz").read_bytes() for n in range(3)}) == 1


def script(text: str, *arguments: object) -> subprocess.CompletedProcess:
    """Runs Python code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_fork(flight):
    done = script(
        """
        import os, sys, wavex
        recording = wavex.open(sys.argv[1])
        reader = wavex.decompose(recording)
        next(iter(wavex.decompose(recording)))
        child = os.fork()
        if child == 0:
            try:
                reader.read_all()
            except wavex.RunError as error:
                assert "started by another process" in str(error)
            else:
                os._exit(3)
            del reader
            assert recording.shot(5).number == 5
            assert len(wavex.decompose(recording).read_all()) > 4000
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        assert len(reader.read_all()) > 4000
        """,
        flight.path,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "call",
    [
        "wavex.run(sys.argv[1])",
        "sum(1 for _ in wavex.decompose(wavex.open(sys.argv[2])))",
        "wavex.decompose(wavex.open(sys.argv[2])).to_arrow().read_all()",
        "wavex.simulate(lines=100_000, shots_per_line=1000)",
    ],
)
def test_control_c(call, tmp_path):
    recording = wavex.simulate(tmp_path / "long.arrow", lines=100, shots_per_line=1000)
    # The job simulates for minutes.
    (tmp_path / "job.toml").write_text(
        "[[stage]]\ntype='simulate'\nlines=100000\nshots_per_line=1000\n[[stage]]\ntype='write_arrow'\npath='a.arrow'\n"
    )
    code = f"""
        import os, signal, sys, threading, time, pyarrow, wavex
        def interrupt():
            time.sleep(0.3)
            os.kill(os.getpid(), signal.SIGINT)
        threading.Thread(target=interrupt).start()
        try:
            {call}
            time.sleep(5)
        except KeyboardInterrupt:
            sys.exit(42)
        except Exception as error:
            # The signal follows the error of the other library.
            try:
                time.sleep(5)
            except KeyboardInterrupt:
                sys.exit(42)
            raise
    """
    done = script(code, tmp_path / "job.toml", recording.path)
    assert done.returncode == 42, (done.returncode, done.stderr)
    assert not list(tmp_path.glob("*.partial"))


def test_dropping_a_reader_ends_its_run(flight, model):
    before = threading.active_count()
    for _ in range(20):
        reader = wavex.decompose(flight, model)
        del reader
    tasks = len(list(Path("/proc/self/task").iterdir()))
    assert tasks < 40 and threading.active_count() == before


def test_a_thousand_opens_do_not_leak(flight):
    def some(n):
        for _ in range(n):
            recording = wavex.open(flight.path)
            recording.shot(1)
        gc.collect()

    some(200)
    tracemalloc.start()
    before, (python_before, _) = rss_mb(), tracemalloc.get_traced_memory()
    some(1000)
    grown, (python_after, _) = rss_mb() - before, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 10, f"{grown} MB"
    assert python_after - python_before < 200_000


def test_streaming_stays_flat(tmp_path):
    # About 700 MB of samples in memory, ten times `memory_mb`.
    recording = wavex.simulate(tmp_path / "large.arrow", lines=800, shots_per_line=2000)
    done = script(
        """
        import os, sys, wavex
        from pathlib import Path
        def rss_mb():
            return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
        recording = wavex.open(sys.argv[1])
        reader = recording.shots(memory_mb=64)
        rows, most, total = 0, 0, 0
        for number, batch in enumerate(reader):
            rows += len(batch)
            total += 4 * 2000 * 60
            if number == 100:
                start = rss_mb()
            if number > 100:
                most = max(most, rss_mb())
        assert rows == 1_600_000
        print(start, most)
        assert most - start < 64, (start, most)
        """,
        recording.path,
    )
    assert done.returncode == 0, done.stderr
    print(done.stdout)


def test_import_is_quick():
    code = "import time; start = time.perf_counter(); import wavex; print(time.perf_counter() - start)"
    times = sorted(float(script(code).stdout) for _ in range(5))
    print(f"import wavex: median {times[2]:.3f} s")
    libraries = {"duckdb", "numpy", "pandas", "polars", "pyarrow", "xarray"}
    loaded = script("import sys, wavex; print(*sys.modules)").stdout.split()
    assert "wavex" in loaded and not libraries & set(loaded)


def test_signals_are_those_of_python_after_a_run(folder):
    # A shell starts programs in the background without SIGINT.
    before = signal.getsignal(signal.SIGINT)
    wavex.run(folder / "job.toml")
    assert signal.getsignal(signal.SIGINT) is before
