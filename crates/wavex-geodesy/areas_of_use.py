"""Writes areas_of_use.txt: boxes of the areas of use of EPSG codes, from the database of PROJ.

    python crates/wavex-geodesy/areas_of_use.py

A line has west, south, east and north in whole degrees, rounded outwards, and the codes with this box. West exceeds
east if the box crosses the meridian of 180 degrees. Codes without an area, and with the whole earth, are left out.
"""

from math import ceil, floor
from pathlib import Path

from pyproj.database import get_database_metadata, query_crs_info
from pyproj.enums import PJType

MOST_CODE = 65535  # larger codes are not of EPSG
WORLD = (-180, -90, 180, 90)


def union(boxes):
    """Smallest box around boxes; several areas of a code."""
    west, east = boxes[0][0], boxes[0][2]
    if len(boxes) > 1:
        if any(box[0] > box[2] for box in boxes):
            raise ValueError(f"several areas that cross the meridian of 180 degrees: {boxes}")
        west, east = min(box[0] for box in boxes), max(box[2] for box in boxes)
    return west, min(box[1] for box in boxes), east, max(box[3] for box in boxes)


areas = {}
for system in query_crs_info(auth_name="EPSG", allow_deprecated=True):
    area = system.area_of_use
    if area and system.type != PJType.VERTICAL_CRS and int(system.code) <= MOST_CODE:
        box = floor(area.west), floor(area.south), ceil(area.east), ceil(area.north)
        areas.setdefault(int(system.code), []).append(box)

codes = {}
for code, boxes in sorted(areas.items()):
    codes.setdefault(union(boxes), []).append(code)
codes.pop(WORLD)
lines = [f"{' '.join(map(str, box))}: {' '.join(map(str, of_box))}\n" for box, of_box in codes.items()]
Path(__file__).with_suffix(".txt").write_text("".join(lines))
print(f"EPSG {get_database_metadata('EPSG.VERSION')}: {sum(map(len, codes.values()))} codes, {len(lines)} boxes")
