"""How far off a calibration is where the truth is known: the systematic part of every interval comes from here."""

from collections.abc import Iterable

import numpy as np

from fishmj.calibrate import latency, servo
from fishmj.calibrate.logs import Logs
from fishmj.calibrate.systematic import widened
from fishmj.gap.plants.bench import Bench


def check(robots: Iterable[tuple[dict[str, float], Logs]]) -> list[dict]:
    """Calibrate servo and latencies of robots whose numbers are given: mean and RMS error, share inside the 90 % interval."""
    plant, off = Bench(), {}
    for true, logs in robots:
        found = servo.calibrate(logs, plant, alone=False)
        fitted = found.estimates | {"camera_latency": latency.calibrate(logs, found).estimates["camera_latency"]}
        for name, e in fitted.items():
            wide = widened(e)
            off.setdefault(name, []).append((e.value - true[name], true[name], wide.low <= true[name] <= wide.high))
    return [
        {
            "number": name,
            "robots": len(cases),
            "mean error": float(np.mean([a for a, _, _ in cases])),
            "RMS error": float(np.sqrt(np.mean([a * a for a, _, _ in cases]))),
            "RMS error %": float(100 * np.sqrt(np.mean([(a / b) ** 2 for a, b, _ in cases]))),
            "inside": float(np.mean([c for _, _, c in cases])),
        }
        for name, cases in off.items()
    ]
