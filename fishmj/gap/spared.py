"""How wrong the formulas of what was found are, but for the few records in which they are most wrong.

In one record a path bends away or a joint slips at another moment, and a right formula looks wrong there. Transfer lets some
records get worse; as many are spared here, if what was found gains on records unseen. What stands in for something else is
wrong wherever that is seen.
"""

import numpy as np

from fishmj.gap.evidence import Evidence
from fishmj.gap.form import Error
from fishmj.gap.gates import Gates

STRAIN = 30.0, 3e-4  # drop of the loss, and its share of the gain, from which a larger form error is not chance


def strained(strain: float, gain: float) -> bool:
    """Whether the records ask for a larger form error than a formula may have."""
    return strain > max(STRAIN[0], STRAIN[1] * gain)


def believable(error: Error, gain: float, gates: Gates) -> bool:
    """Whether a right formula may be as wrong."""
    return not strained(error.strain, gain) and error.resized <= gates.size


def error(near: Evidence, row: np.ndarray, gain: float, gates: Gates) -> tuple[Error, tuple[str, ...]]:
    """(error of the formulas of a row around which `near` is, names of the records that are spared). gain: on records unseen."""
    whole = near.error(row, gates.form)
    few = int((1.0 - gates.transfer) * len(near.records) + 1e-9)
    if not few or gain < gates.gain or believable(whole, gain, gates):
        return whole, ()
    alone = [near.error(row, gates.form, but(near, [i])) for i in range(len(near.records))]
    worst = np.argsort([max(e.strain / max(STRAIN[0], STRAIN[1] * gain), e.resized / gates.size) for e in alone])[:few]
    less = near.error(row, gates.form, but(near, worst))
    return (less, tuple(near.records[i].name for i in worst)) if believable(less, gain, gates) else (whole, ())


def but(near: Evidence, left_out) -> np.ndarray:
    """(L,) bool: all records but those."""
    keep = near.everything
    keep[list(left_out)] = False
    return keep
