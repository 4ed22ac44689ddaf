"""How wrong the formulas of what was found are, but for the few paths on which they are most wrong.

Small errors add up along a path: where it bends away in one record, a right formula looks wrong there. Transfer lets some
records get worse; the paths of as many are spared here, if what was found gains on records unseen. Joints are held by their
servos, where nothing adds up, and never spared: what stands in for something else in a servo is wrong in them.
"""

import numpy as np

from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.model_error import ModelError
from fishmj.gap.thresholds import Gates

STRAIN = 30.0, 3e-4  # drop of the loss, and its share of the gain, from which a larger form error is not chance
PATH = ("position", "heading")  # channels


def excessive(strain: float, gain: float) -> bool:
    """Whether the records ask for a larger form error than a formula may have."""
    return strain > max(STRAIN[0], STRAIN[1] * gain)


def misformed(checks: dict) -> bool:
    """Whether the formula is too wrong, by the gates of a verdict; not where that was never asked, nor of what is pinned."""
    return excessive(checks.get("strain", 0.0), checks.get("gain", 0.0)) and not checks.get("pinned", False)


def believable(error: ModelError, gain: float, gates: Gates) -> bool:
    """Whether a right formula may be as wrong."""
    return not excessive(error.strain, gain) and error.resized <= gates.size


def error(near: Likelihood, row: np.ndarray, gain: float, gates: Gates) -> tuple[ModelError, tuple[str, ...]]:
    """(error of the formulas of a row around which `near` is, names of the records whose path is spared). gain: on records
    unseen."""
    whole = near.error(row, gates.form)
    few = int((1.0 - gates.transfer) * len(near.records) + 1e-9)
    if not few or gain < gates.gain or believable(whole, gain, gates):
        return whole, ()
    alone = [near.error(row, gates.form, without_paths_of(near, [i])) for i in range(len(near.records))]
    worst = np.argsort([max(e.strain / max(STRAIN[0], STRAIN[1] * gain), e.resized / gates.size) for e in alone])[:few]
    less = near.error(row, gates.form, without_paths_of(near, worst))
    return (less, tuple(near.records[i].name for i in worst)) if believable(less, gain, gates) else (whole, ())


def without_paths_of(near: Likelihood, spared) -> np.ndarray:
    """(m,) bool: all samples but the paths of those records."""
    return ~(np.isin(near.layout.record, list(spared)) & np.isin(near.layout.channel, PATH))
