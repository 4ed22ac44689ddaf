"""A synthetic trial for the tests of physical checks: a fish that swims ahead and turns left."""

from dataclasses import replace

import numpy as np

from fishmj.log import Trial, numbered, physical_checks


def changed(trial: Trial, table: str, **columns) -> Trial:
    """A trial with some columns computed from the old ones."""
    old = trial.tables[table]
    return replace(trial, tables={**trial.tables, table: {**old, **{c: f(old[c]) for c, f in columns.items()}}})


def turning(seconds: float = 12.0, rate: float = 0.15) -> Trial:
    """A fish that swims ahead and turns left: commands, joints that follow, and the camera's poses."""
    t = np.arange(0, seconds, 0.02)
    phase = 2 * np.pi * t[:, None] - np.arange(3)
    yaw = 2.0 + rate * t - 0.05 * np.sin(2 * np.pi * t - 1)
    course = 2.0 + rate * t
    x, y = 0.004 * np.cumsum(np.cos(course)), 0.004 * np.cumsum(np.sin(course))
    tables = {
        "cmd": {"t": t, **numbered("c#", 0.4 * np.sin(phase))},
        "joint": {"t": t, **numbered("j#", 0.38 * np.sin(phase - 0.5))},
        "pose": {"t": t, "x": x, "y": y, "yaw": yaw},
    }
    return Trial({"origin": "synthetic", "robot": "swift"}, tables, name="turning")


def names(trial: Trial) -> dict[str, str]:
    """Text of each finding of the physical checks, by its check."""
    return {finding.check: finding.text for finding in physical_checks.examine(trial)}
