"""Thresholds of the search, from `data/calib/gap.toml`."""

from dataclasses import dataclass

import numpy as np

from fishmj.calib import read_toml, resolve


@dataclass(frozen=True)
class Gates:
    """Thresholds.

    adequacy: |z|^2 / m that null runs do not reach. gain: drop of twice the negative log likelihood, every record predicted
    without its fold, below which nothing is added; joint: what does instead for a first effect, on all records at once and each
    fold given the others. A further effect must also take away `again` times the length of z, or the share `clear` of that where
    no other comes near it; and in all `beside` of the gain so far, or `enough`. closure, rest, form, size, transfer: gates of
    decide.py. margin, ahead: share of the gain, and |z|^2, that a candidate must be behind the best by to be no rival; p_best:
    as in evidence.py. shortlist, finalists: candidates fitted, and judged by the evidence around themselves.
    """

    adequacy: float
    gain: float
    joint: float
    again: float
    beside: float
    enough: float
    clear: float
    closure: float
    margin: float
    ahead: float
    p_best: float
    rest: float
    form: float
    size: float
    transfer: float
    most: int
    shortlist: int
    finalists: int


def rest_allowed(checks: dict, gates: Gates) -> float:
    """The |z|^2 / m, unseen, that may be left, by the gates of a verdict.

        rest <= R,   or, where form <= F,   rest - 1 <= F^2 (adequacy - 1)

    S holds the form error in steps of 1.4, and in a gap of a thousand times the floor a fiftieth of it shows. A formula that was
    found right to within F, what a formula may be wrong by, may leave F of what it explains.
    """
    if checks.get("form", np.inf) > gates.form:
        return gates.rest
    return max(gates.rest, 1.0 + gates.form**2 * (checks.get("adequacy", 1.0) - 1.0))


def frozen() -> Gates:
    """The thresholds as shipped: docs/results/gap_benchmark.md says how they were set."""
    return Gates(**read_toml(resolve("gap"))["gates"])
