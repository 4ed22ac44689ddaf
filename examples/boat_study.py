"""A boat of one's own: tables of a lab, a study in TOML, what the boat's model is missing, and a page.

    python examples/boat_study.py

The logs are *synthetic*: a boat of 14 kg with one propeller and a rudder, by the equations below, on a lake that drifts by
0.08 m/s along x and -0.05 m/s along y. The study's model has no current. It is the command's own template, four lines changed.
"""

import json
from pathlib import Path

import numpy as np

from fishmj.gap.__main__ import main as gap

OUT, CURRENT = Path("boat"), np.array([0.08, -0.05])  # m/s
CHANGED = {
    'names = "{day}_{setting}_{run}"': 'names = "{day}_{setting}"',
    'origin = "measured" ': 'origin = "synthetic"',
    'yaw = { column = "heading", unit = "deg" }': 'yaw = { column = "heading", unit = "deg", sign = -1, zero = 90 }',
    "horizon = 2.0 ": "horizon = 3.0 ",
}


def sail(rng, throttle: float, seconds: float = 24.0, h: float = 0.01) -> list[str]:
    """Rows of a log at 10 Hz: time [s], place [m], compass [deg], throttle and rudder as they were commanded."""
    place, speed, yaw, turning, rows = np.zeros(2), np.zeros(2), rng.uniform(-3, 3), 0.0, []
    hz, phase = rng.uniform(0.1, 0.25), rng.uniform(0, 6)  # of the rudder
    for k in range(int(seconds / h)):
        if k % 10 == 0:
            rudder = 0.6 * np.sin(2 * np.pi * hz * k * h + phase)
            x, y, seen = *(place + rng.normal(0, 0.01, 2)), yaw + rng.normal(0, 0.01)
            rows.append(f"{k * h:.2f},{x:.3f},{y:.3f},{90 - np.degrees(seen):.2f},{throttle},{rudder:.4f}")
        ahead, through = np.array([np.cos(yaw), np.sin(yaw)]), speed - CURRENT
        force = 20.0 * throttle**2 * ahead - 6.0 * np.hypot(*through) * through
        turning += h * (1.2 * throttle**2 * rudder - 1.5 * abs(turning) * turning) / 1.5
        speed = speed + h * force / 14.0
        place, yaw = place + h * speed, yaw + h * turning
    return rows


def main() -> None:
    rng = np.random.default_rng(0)
    (OUT / "logs").mkdir(parents=True)  # of two days, three settings each
    for day in ("mon", "tue"):
        for setting in (0.4, 0.7, 1.0):
            rows = ["time,x,y,heading,throttle,rudder", *sail(rng, setting)]
            (OUT / "logs" / f"{day}_{setting}.csv").write_text("\n".join(rows) + "\n")
    study = OUT / "boat.toml"
    gap(["measured", "--new", str(study), "--plant", "body"])
    for old, new in CHANGED.items():
        study.write_text(study.read_text().replace(old, new))
    gap(["measured", "--study", str(study), "--out", str(OUT / "report")])
    found = json.loads((OUT / "report" / "report.json").read_text())["verdict"]["effects"]
    assert [e["name"] for e in found] == ["steady_current"], found


if __name__ == "__main__":
    main()
