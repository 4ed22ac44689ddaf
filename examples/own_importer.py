"""An importer of your own: a tracker's CSV becomes a data set that every command reads.

    python examples/own_importer.py [FOLDER]

An importer is a function from a path to one `Trial`. Stamps stay as they are, nothing is resampled, and what it gives is held to
the log schema: SI units, radians, one table a sensor. On the command line:

    fishmj log import swim.csv --out data --format examples/own_importer.py:read
"""

import sys
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log import Trial, read_dataset
from fishmj.log.__main__ import main as log


def read(path):
    """A tracker's CSV with columns time [ms], x [mm], y [mm], heading [deg]."""
    try:
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise LogError(f"{path}: {error}; expected four numbers in a row: time [ms], x [mm], y [mm], heading [deg]") from error
    t, x, y, heading = rows.T
    pose = {"t": t / 1e3, "x": x / 1e3, "y": y / 1e3, "yaw": np.unwrap(np.radians(heading))}
    return Trial({"origin": "measured", "robot": "swift", "medium": "water", "clock": {"pose": "tracker"}}, {"pose": pose})


if __name__ == "__main__":
    folder = Path(sys.argv[1] if sys.argv[1:] else "runs/own_importer")
    folder.mkdir(parents=True, exist_ok=True)  # log import refuses a data set that is there
    t = np.arange(0, 4000, 20.0)  # ms; a made-up swim: 0.25 m/s ahead, the head yaws by 10 deg at 1 Hz
    made = np.stack([t, 0.25 * t, 0 * t, 10 * np.sin(2 * np.pi * t / 1e3)], -1)
    np.savetxt(folder / "swim.csv", made, delimiter=",", header="time,x,y,heading", comments="")
    code = log(["import", str(folder / "swim.csv"), "--out", str(folder / "data"), "--format", f"{__file__}:read"])
    pose = read_dataset(folder / "data")["swim"].table("pose")
    speed = (pose["x"][-1] - pose["x"][0]) / (pose["t"][-1] - pose["t"][0])
    print(f"{len(pose['t'])} rows, {speed:.3f} m/s, yaw up to {np.degrees(np.max(pose['yaw'])):.1f} deg")
    assert not code and abs(speed - 0.25) < 1e-9
