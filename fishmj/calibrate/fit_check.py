"""How far off a calibration is where the truth is known: the systematic part of every interval comes from here."""

import numpy as np

from fishmj.calibrate import latency, servo_fit
from fishmj.calibrate.bias import widened
from fishmj.calibrate.calibration_logs import Logs
from fishmj.gap.models.swimming_fish import ServoStand

Off = dict[str, list]  # number -> [error, true value, whether the 90 % interval holds it]


def one(true: dict[str, float], logs: Logs, plant: ServoStand) -> Off:
    """Calibrate servo and latencies of a robot whose numbers are given."""
    found = servo_fit.calibrate(logs, plant, alone=False)
    fitted = found.estimates | {"camera_latency": latency.calibrate(logs, found).estimates["camera_latency"]}
    wide = {name: widened(e) for name, e in fitted.items()}
    return {
        name: [e.value - true[name], true[name], bool(wide[name].low <= true[name] <= wide[name].high)]
        for name, e in fitted.items()
    }


def gathered(robots: list[Off]) -> list[dict]:
    """Of all robots: mean and RMS error, share inside the 90 % interval."""
    off = {name: [robot[name] for robot in robots] for name in robots[0]}
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
