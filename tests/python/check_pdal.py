"""Compares the number of points and the dimensions that PDAL sees with those of laspy."""

import json
import shutil
import subprocess

# Attributes of the standard layout that are in PDAL's registry (pdal/Dimension.json), in lower case.
REGISTERED = {"amplitude", "reflectance", "pulsewidth", "deviation"}


def check_pdal(checks, path, las):
    """`las` is the same file as read by laspy."""
    if shutil.which("pdal") is None:
        print("skipped: PDAL is not installed")
        return
    done = subprocess.run(["pdal", "info", "--summary", path], capture_output=True, check=True)
    summary = json.loads(done.stdout)["summary"]
    checks.equal("PDAL counts the points", summary["num_points"], len(las.points))
    dimensions = {name.strip().lower() for name in summary["dimensions"].split(",")}
    checks.that("PDAL knows the attributes by its own names", REGISTERED <= dimensions, summary["dimensions"])
