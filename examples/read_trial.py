"""A trial folder: written by everything that moves a fish, read with three lines.

    python examples/read_trial.py [FOLDER]

A trial is `meta.toml` (who, where, which clock) and one table a sensor, each with its own stamps: what was commanded, what the
encoders and the tracker reported, and in simulation the truth. A recording of your robot, once imported, reads the same.
"""

import sys
from pathlib import Path

import numpy as np

from fishmj.evaluate.__main__ import main as evaluate
from fishmj.log import read_trial, stacked

out = Path(sys.argv[1] if sys.argv[1:] else "runs/read_trial")
assert (
    evaluate(["station", "--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "20", "--out", str(out), "--log"]) == 0
)
(folder,) = (path.parent for path in out.rglob("meta.toml"))

trial = read_trial(folder)
print(f"{folder.name}: {trial.value('origin')}, {trial.span[1] - trial.span[0]:.1f} s; tables {', '.join(trial.tables)}")

pose, target, power = trial.table("pose"), trial.table("target"), trial.table("power")
off = np.hypot(pose["x"] - target["x"], pose["y"] - target["y"])
held = pose["t"] > 10.0
print(f"camera, {len(off)} rows: {off[held].mean():.3f} m from the target after 10 s; {np.mean(power['V'] * power['I']):.2f} W")

joints = stacked(trial.table("joint"), "j#")  # (T, 3) rad
t = trial.table("joint")["t"]
swing = np.fft.rfft(joints[t > 10.0, 2] - joints[t > 10.0, 2].mean())
beat = np.fft.rfftfreq(int((t > 10.0).sum()), float(np.median(np.diff(t))))[np.abs(swing).argmax()]
print(f"the tail beats at {beat:.2f} Hz, +-{np.degrees(np.ptp(joints[:, 2]) / 2):.0f} deg")
assert off[held].mean() < 0.1 and 0.3 < beat < 5
