"""Runs a survey by Snakemake on one machine and on Slurm, with the commands of docs/how-to/cluster.md.

    target/venv/bin/python tests/python/check_cluster.py target/release/wavex

Compares all products with those of `wavex run`, kills and drains, and measures the overhead of Snakemake. Needs
requirements-cluster.txt. Slurm is installed, started and ended here; without it, those checks are skipped. Prints a
line per check; exit code 1 if one fails.
"""

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from checks import Checks
from cluster_survey import DAMAGED, STRIPS, AlignedSurvey, Survey, commands, wait_until
from slurm import Slurm, obstacle

# Options for a cluster without accounting whose tasks take a second.
QUICK = ("--slurm-no-account --slurm-status-command squeue --slurm-init-seconds-before-status-checks 1"
         " --seconds-between-status-checks 1 --latency-wait 10 --retries 1")

# Products of a strip: points, table, line statistics, cells, density; of the survey: page, numbers, five rasters.
PER_STRIP, OF_SURVEY = 5, 7

# Calls wavex; the first call for some strips exceeds memory or time.
FAULTY = """#!/bin/sh
case "$*" in
*tasks/strip03.toml*) mkdir faults/memory 2> /dev/null && exec python3 -c '
import time
memory = bytearray(700_000_000)
memory[::4096] = bytes(len(memory[::4096]))
time.sleep(60)' ;;
*tasks/strip05.toml*) mkdir faults/time 2> /dev/null && exec sleep 120 ;;
esac
exec WAVEX "$@"
"""


def reference(survey, checks):
    """Products and results of one run."""
    survey.wavex("run", "survey.toml", "--archive", "archives/run", expected=1)
    products = survey.products()
    checks.equal("products of one run", len(products), PER_STRIP * (len(STRIPS) - 1) + OF_SURVEY)
    survey.remove("out")
    return products, survey.results("run")


def check_results(survey, checks, expected):
    """Compares products and results with those of one run; only the damaged strip is incomplete."""
    products, results = expected
    found = survey.products()
    different = sorted(name for name in found | products if found.get(name) != products.get(name))
    checks.equal("products whose bytes differ", different, [])
    checks.that("the damaged strip is named", survey.log().count(f"\n  {DAMAGED}: stage read_arrow: ") == 1
                and "error: incomplete: 1 of 12 tasks\n" in survey.log(), survey.log()[-3000:])
    checks.that("no archive yet", not (survey.folder / "archives" / "survey").exists())
    checks.equal("exit status of collect", survey.run("collect"), [1])
    checks.equal("results of the archive", survey.results("survey"), results)
    survey.wavex("verify", "archives/survey")


def check_local(survey, checks, expected):
    checks.subject = "one machine"
    checks.equal("plan", survey.run("plan"), [0])
    started = time.monotonic()
    checks.equal("exit status", survey.run("local", "--retries 0"), [1])
    seconds = time.monotonic() - started
    print(f"      {len(STRIPS)} tasks in {seconds:.1f} s")
    check_results(survey, checks, expected)
    survey.remove("out", "plan", "archives/survey", ".snakemake", "commands.log")


def check_restart(survey, checks):
    """Kills Snakemake with its tasks, starts it again, repairs the damaged strip."""
    checks.subject = "restart"
    checks.equal("plan", survey.run("plan"), [0])
    snakemake = survey.start(commands("local")[0], "--retries 0")
    wait_until("complete task", lambda: len(survey.marks()) >= 3)
    os.killpg(snakemake.pid, signal.SIGKILL)
    snakemake.wait()
    before = survey.times()
    checks.that("killed in mid-run", 3 * PER_STRIP <= len(before) < PER_STRIP * (len(STRIPS) - 1), len(before))
    checks.equal("exit status", survey.run("restart", "--retries 0"), [0, 1])
    after = survey.times()
    checks.that("what was complete is not made again", all(after[name] == before[name] for name in before))
    checks.equal("complete tasks", len(survey.marks()), len(STRIPS) - 1)
    survey.repair()
    checks.equal("exit status after the repair", survey.run("local"), [0])
    repaired = survey.times()
    checks.that("only the repaired strip is run", all(repaired[name] == after[name] for name in after))
    checks.that("the repaired strip is complete", f"{DAMAGED}.laz" in survey.products())


def check_slurm(survey, checks, expected, slurm):
    """A task exceeds its memory, one its time, the node is drained, a strip is damaged."""
    checks.subject = "Slurm"
    (survey.folder / "faults").mkdir()
    wavex = (survey.programs / "wavex").resolve()
    (survey.programs / "wavex").unlink()
    survey.write("bin/wavex", FAULTY.replace("WAVEX", str(wavex)))
    (survey.programs / "wavex").chmod(0o755)
    checks.equal("plan", survey.run("plan"), [0])
    started = time.monotonic()
    snakemake = survey.start(commands("slurm")[0], QUICK)
    wait_until("job that sleeps", (survey.folder / "faults" / "time").exists)
    sleeping = [job for job in slurm.jobs("strip05") if job["JobState"] == "RUNNING"]
    slurm.ask("scontrol", "update", f"JobId={sleeping[0]['JobId']}", "EndTime=now+1")
    slurm.drain(True)
    wait_until("drained node", lambda: not any(job["JobState"] == "RUNNING" for job in slurm.jobs()))
    waiting = sum(job["JobState"] == "PENDING" for job in slurm.jobs())
    slurm.drain(False)
    checks.equal("exit status", snakemake.wait(timeout=300), 1)
    print(f"      {len(STRIPS)} tasks with faults in {time.monotonic() - started:.1f} s; {waiting} waited for the node")
    for strip, state in [("strip03", "FAILED"), ("strip05", "TIMEOUT")]:
        first, *others = slurm.jobs(strip)
        checks.equal(f"first attempt of {strip}", (first["JobState"], first["MinMemoryNode"]), (state, "564M"))
        found = [(job["JobState"], job["MinMemoryNode"], job["TimeLimit"]) for job in others]
        checks.equal(f"second attempt of {strip}", found, [("COMPLETED", "1128M", "00:04:00")])
    check_results(survey, checks, expected)
    (survey.programs / "wavex").unlink()
    (survey.programs / "wavex").symlink_to(wavex)
    survey.remove("out", "plan", "archives/survey", ".snakemake", "commands.log")


def check_slurm_restart(survey, checks, slurm):
    """Kills Snakemake; its jobs go on; what they complete is not made again."""
    checks.subject = "Slurm, restart"
    survey.remove("out", "plan", ".snakemake", "commands.log")
    checks.equal("plan", survey.run("plan"), [0])
    snakemake = survey.start(commands("batch")[0], QUICK)
    wait_until("report", lambda: list((survey.folder / "plan" / "reports").glob("*_report.json")))
    os.killpg(snakemake.pid, signal.SIGKILL)
    snakemake.wait()
    wait_until("end of the jobs", slurm.is_idle)
    before = survey.times()
    checks.that("jobs go on without Snakemake", len(before) >= 4 * PER_STRIP, len(before))
    survey.start(commands("batch")[0], "--unlock").wait()
    checks.equal("exit status", survey.run("batch", QUICK), [0])
    after = survey.times()
    checks.that("what was complete is not made again", all(after[name] == before[name] for name in before))
    checks.equal("products", len(survey.products()), PER_STRIP * len(STRIPS) + OF_SURVEY)
    checks.equal("marks of the batches", len(survey.marks()), 3)


def check_array(survey, checks, expected):
    """An array job, without Snakemake."""
    checks.subject = "array job"
    checks.equal("plan", survey.run("plan"), [0])
    checks.equal("exit status", survey.run("array"), [0, 1, 1])
    checks.equal("bytes of all products", survey.products(), expected[0])
    checks.equal("results of the archive", survey.results("survey"), expected[1])


def check_slurm_align(survey, checks):
    """Tasks write patches, and `collect` aligns them with the options of the plan: the bytes of `wavex align`."""
    checks.subject = "Slurm, alignment"
    options = "--trajectory 5 --estimate e2 --reference b"
    [plan] = commands("plan")
    plan = plan.replace("--archive archives/survey", f"--align aligned {options}")
    checks.equal("plan", survey.start(plan).wait(), 0)
    started = time.monotonic()
    checks.equal("exit status", survey.run("slurm", QUICK), [0])
    print(f"      three tasks and the alignment in {time.monotonic() - started:.1f} s")
    survey.wavex("align", "survey.toml", "-o", "expected", *options.split())
    for name in ["calibration.toml", "corrections.toml", "align.json", "residuals.arrow"]:
        found, expected = [(survey.folder / folder / name).read_bytes() for folder in ["aligned", "expected"]]
        checks.that(f"bytes of {name}", found == expected, survey.log()[-2000:])


def check_slurm_ground(survey, checks):
    """One job classifies the points of all tasks: the bytes of `wavex classify` with other threads."""
    checks.subject = "Slurm, ground"
    checks.equal("exit status", survey.run("ground"), [0])
    survey.wavex("classify", "out", "-o", "expected_ground", "--dem", "expected_ground/terrain.tif", "--threads", "2")
    for name in ["a.laz", "b.laz", "c.laz", "terrain.tif"]:
        found, expected = [survey.folder / folder / name for folder in ["classified", "expected_ground"]]
        checks.that(f"bytes of {name}", found.exists() and found.read_bytes() == expected.read_bytes())


def main(wavex):
    checks = Checks()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        survey = Survey(folder / "survey", wavex)
        by_input = Survey(folder / "by_input", wavex, model="input")
        aligned = AlignedSurvey(folder / "aligned", wavex)
        checks.subject = "wavex run"
        expected = reference(survey, checks)
        with checks.of("one machine"):
            check_local(survey, checks, expected)
            check_restart(by_input, checks)
        why = obstacle()
        if why:
            print(f"skipped: Slurm: {why}")
        else:
            with checks.of("Slurm"), Slurm(folder / "slurm") as slurm:
                check_slurm(survey, checks, expected, slurm)
                check_slurm_restart(by_input, checks, slurm)
                check_array(survey, checks, expected)
                check_slurm_align(aligned, checks)
                check_slurm_ground(aligned, checks)
        if checks.failed:
            print(survey.log()[-5000:], by_input.log()[-5000:], aligned.log()[-5000:], sep="\n")
    return checks.end()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve()))
