"""Healthy swims of the robot: they give its usual gap in its water and the remaining uncertainty of its model.

    level = ratio |z|^2 / m of the healthy swims        ratio: null/structural_error.py, `StructuralErrorScales.beyond_own`

Robots in other waters give the usual error of a calibrated water, but a water unlike all of them may have a larger one. The
calibration swims show it: a model with |z|^2 / m = 1.5 on them has at least as much on new experiments without any effect. On new
experiments it has more, since it was not fitted to them; that ratio was measured on robots in other waters.

They also give the variation of each parameter of this robot's water from swim to swim (`structural_error.own_widths`), and the
remaining uncertainty of the parameters that its records share (`Likelihood.given`). So a later effect is compared with the
variation of this robot, not of any robot.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from fishmj.base.errors import LogError
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.structural_error import applies
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.search.likelihood import Likelihood, likelihood_of
from fishmj.log import Trial


class HealthySwims(NamedTuple):
    """left: |z|^2 / m of the swims, with the scales of other waters. swims: their likelihood with the robot's own scales."""

    calibration_residual: float
    swims: Likelihood


def read_healthy_swims(model, trials: Sequence[Trial], null: SimulatedNull, bars: Bars = silent_bar) -> HealthySwims | None:
    """Result of healthy swims; None for a model without a structural error.

    Raises:
        LogError: no swim can be compared.
    """
    if not applies(model):
        return None
    if not trials:
        raise LogError("gap find: no healthy swim found; give the logs that the water was calibrated to")
    # A repeated experiment has other noise: only the fish is common to both.
    e = likelihood_of(model, model.records(trials), replace(null, session=1), bars)
    return HealthySwims(e.gap(model.null)[0], e.with_own_widths())
