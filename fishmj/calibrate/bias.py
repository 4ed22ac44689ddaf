"""What a calibration is off by although its fit is good; it widens every interval (`data/calib/calibrate.toml`)."""

from math import hypot

from fishmj.calib import read_toml, resolve
from fishmj.calibrate.least_squares import NORMAL, ParameterEstimate


def table() -> dict:
    """The whole of `calibrate.toml`."""
    return read_toml(resolve("calibrate"))


def widened(estimate: ParameterEstimate) -> ParameterEstimate:
    """The estimate with the systematic part of its name in sd and interval, added in squares."""
    entry = table()["systematic"].get(estimate.name)
    if entry is None:
        return estimate
    more = entry["value"] * (abs(estimate.value) if entry["of"] == "value" else 1.0)
    low, high = (hypot(end - estimate.value, NORMAL * more) for end in (estimate.low, estimate.high))
    widest = "model" if NORMAL * more > max(estimate.value - estimate.low, estimate.high - estimate.value) else estimate.widest
    bottom = max(estimate.value - low, 0.0)
    return estimate._replace(low=bottom, high=estimate.value + high, sd=hypot(estimate.sd, more), widest=widest)
