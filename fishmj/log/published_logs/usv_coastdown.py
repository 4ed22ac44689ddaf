"""A 13 to 15 kg twin-hull boat coasting down outdoors: semicolon rows without a header, in two layouts.

6 columns: speed [m/s], yaw rate [rad/s], northing, easting [m], bearing [rad], unix time [ms].
12 columns: speed, yaw rate, x, y [m], bearing, gps latitude, longitude [deg], imu ax, ay [m/s^2], imu yaw rate [deg/s],
imu bearing [deg], unix time [ms].

Tank frame: x east, y north, yaw = pi/2 - bearing (bearings count clockwise from north). Positions start at zero.

Before a fit, note that `speed` is no sensor. The source's filter takes position over time at each GPS fix and
between fixes adds accelerometer readings that still hold gravity, so speed climbs by metres a second and falls back at the
next fix. Its rows right after a fix are the measurement; `surge` holds the whole column as recorded. Northing is printed with
six digits (steps of 10 m). The local x, y of the 12-column file come from a polar angle to which 360 was added in radians
whenever it was negative, so they are turned against the bearing.

Source: github.com/EduPonz/awsp_collection, catkin_packages/cartesian_pose/log, MIT.
"""

import math
import re
from pathlib import Path

import numpy as np

from fishmj.log.importers.registry import renamed, trial_of
from fishmj.log.published_logs.number_rows import NumberRows, read_rows, without_strays
from fishmj.log.trial import Trial

SIX = ("speed", "yaw_rate", "northing", "easting", "bearing", "unix_ms")
TWELVE = (
    *("speed", "yaw_rate", "north", "east", "bearing", "latitude", "longitude"),
    *("imu_ax", "imu_ay", "imu_yaw_rate", "imu_bearing", "unix_ms"),
)
RESET = 1.0  # m/s between two rows: more than any push on a boat of 13 kg in 50 ms
_ROW = re.compile(rb"[^;\n]+(;[^;\n]+){5}((;[^;\n]+){6})?\r?\n")


def sniff(path: Path) -> bool:
    """Returns True for a csv file (or a folder with some) whose first row has 6 or 12 numbers between semicolons.

    The last number must be a unix time in ms.
    """
    return any(_looks_right(file) for file in _files(path))


def _files(path: Path) -> list[Path]:
    return [path] if path.is_file() else sorted(path.glob("*.csv")) if path.is_dir() else []


def _looks_right(path: Path) -> bool:
    if path.suffix != ".csv":
        return False
    with open(path, "rb") as file:
        line = file.readline(4000)
    stamp = re.fullmatch(rb"\s*\d{12,14}(\.\d*)?\s*", line.rsplit(b";", 1)[-1])  # unix time [ms]
    return bool(_ROW.fullmatch(line) and stamp) and not re.search(rb"[a-df-zA-DF-Z]", line)


def read(path: Path) -> dict[str, Trial]:
    """Trials by name, the file's stem."""
    return {file.stem: _trial(file) for file in _files(path)}


def _trial(path: Path) -> Trial:
    rows, notes = without_strays(read_rows(path, SIX, TWELVE, separator=";"), "unix_ms")
    whole = len(rows.names) == len(TWELVE)
    north, east = (rows.column(name) for name in (("north", "east") if whole else ("northing", "easting")))
    start = float(rows.column("unix_ms")[0])
    t = (rows.column("unix_ms") - start) / 1e3
    bearing = rows.column("bearing")
    tables = {
        "pose": (
            {"t": t, "x": east - east[0], "y": north - north[0], "yaw": math.pi / 2 - bearing},
            renamed(rows.place, {"t": "unix_ms", "x": rows.names[3], "y": rows.names[2], "yaw": "bearing"}),
        ),
        "velocity": (
            {"t": t, "surge": rows.column("speed"), "yaw_rate": rows.column("yaw_rate")},
            renamed(rows.place, {"t": "unix_ms", "surge": "speed"}),
        ),
    }
    if whole:
        tables["imu"] = (
            {"t": t, "ax": rows.column("imu_ax"), "ay": rows.column("imu_ay"), "wz": np.radians(rows.column("imu_yaw_rate"))},
            renamed(rows.place, {"t": "unix_ms", "ax": "imu_ax", "ay": "imu_ay", "wz": "imu_yaw_rate"}),
        )
    meta = {
        "robot": "awsp catamaran",
        "medium": "water",
        "excitation": "coast-down",
        "clock": {name: f"boat computer, unix time; t = 0 is {start:.0f} ms" for name in tables},
        "origin_offset": {"east": float(east[0]), "north": float(north[0])},
        "licence": "MIT",
        "source": "github.com/EduPonz/awsp_collection catkin_packages/cartesian_pose/log",
    }
    return trial_of(path.stem, meta, tables, [*notes, *_remarks(rows, north, east)])


def _remarks(rows: NumberRows, north: np.ndarray, east: np.ndarray) -> list[str]:
    """Notes on the faults named above, from the numbers themselves."""
    speed = rows.column("speed")
    out = []
    if count := int(np.sum(np.abs(np.diff(speed)) > RESET)):
        out.append(
            f"velocity: surge jumps by more than {RESET:g} m/s between rows {count} times: integrated acceleration that a "
            "GPS fix resets; only the rows right after a fix measure speed"
        )
    for name, values in (("y", north), ("x", east)):
        steps = np.abs(np.diff(values))
        step = float(steps[steps > 0].min()) if np.any(steps > 0) else 0.0
        if step >= 0.5 or not step:
            remark = f"steps of {step:g} m" if step else "one value throughout"
            out.append(f"pose: {name} was printed with six digits: {remark}")
    return out
