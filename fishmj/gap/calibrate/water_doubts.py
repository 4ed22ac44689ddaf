"""Warnings at the end of `calibrate water`: unidentified parameters, and parameters assumed as described."""

import shlex
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fishmj.base.calib import read_toml, resolve
from fishmj.gap.calibrate.servo_fit import OPEN
from fishmj.gap.calibrate.water_fit import SLOW, WaterFit, loose_servo
from fishmj.log import Trial

# mean relative speed error on unseen swims; robots whose truth is known: 0.04 to 0.06 (docs/search/calibrated_water.md)
POOR = 0.1


def unnamed(trials: Iterable[Trial]) -> list[str]:
    """Note on swims without a named experiment: each counts as its own kind, so that a repeat is predicted from its twin."""
    listed = list(trials)
    if not (count := sum(not trial.value("excitation") for trial in listed)):
        return []
    todo = "so repeats make the result look too good; name them: log import --excitation TRIAL=NAME"
    return [f"excitation not stated by {count} of {len(listed)} swims: each such trial counts as its own kind, {todo}"]


def unmeasured(model: str, out: Path | None = None) -> list[str]:
    """Warning about parameters that the fit relied on but no calibration of the model states; [] if all are stated.

    out: existing fish file, which may state them although the fit did not use it.
    """
    lacking = _unstated(model)
    if not lacking:
        return []
    line = f"relied on {', '.join(lacking)} as described: no calibration block of {model} states them"
    if out and out.is_file() and len(_unstated(out)) < len(lacking):
        return [f"{line}, but {out} does: fit again with --model {shlex.quote(str(out))}"]
    return [f"{line}; run calibrate servo and latency first, and give their file as --model"]


def doubts(found: WaterFit) -> list[str]:
    """Lines on parameters at a bound, numbers that the swims do not tell, and servos that move otherwise than described."""
    held = [f"{e.name} ({e.bound})" for e in found.coefficients.values() if e.bound]
    open_ended = [
        f"{e.name} ({e.low:.3g} to {e.high:.3g} {e.unit})"
        for e in found.physical.values()
        if e.high - e.low > OPEN * abs(e.value)
    ]
    slow = [] if np.isfinite(found.speed_error.value) else [f"no swim is faster than {SLOW:g} m/s, so the speed error is unknown"]
    servo = loose_servo(found.plant, found.records, found.theta)
    return [
        *([f"{len(held)} of {len(found.coefficients)} parameters at a bound: {', '.join(held)}"] if held else []),
        *([f"not identified by these swims (90 % interval wider than the value): {', '.join(open_ended)}"] if open_ended else []),
        *slow,
        *([servo] if servo else []),
    ]


def too_poor(found: WaterFit) -> str:
    """Warning if the mean speed error on unseen swims is above `POOR`; else ""."""
    off = found.speed_error.value
    words = f"too poor to search with: {100 * off:.1f} % mean speed error on unseen swims, above {100 * POOR:g} %"
    return words if off > POOR else ""


def _unstated(model: "str | Path") -> list[str]:
    """Numbers that no block [calibration.*] of a description states."""
    blocks = read_toml(resolve(model)).get("calibration", {})
    stated = {"servo"} if "servo" in blocks else set()
    stated |= {name for verb in ("servo", "latency") for name in blocks.get(verb, {})}
    return [name for name in ("servo", "command_latency", "camera_latency") if name not in stated]
