"""The robot's own healthy swims: how much of a gap is usual for it in its water, and how far it may still be off.

    level = ratio |z|^2 / m of the healthy swims        ratio: null/structural_error.py, `Widths.beyond_own`

Robots of other waters tell how far off a calibrated water may be, and a water unlike all of them may be further off. The swims
that it was calibrated to show how far: a model that leaves 1.5 of those, nothing missing, leaves no less of new experiments. Of
new ones it leaves more, since it was not fitted to them; how much more was measured on robots of other waters.

They also tell what other waters' robots cannot: how much each number of this robot's water differs from swim to swim
(`structural_error.own_widths`), and what of all that its records share is left open (`Likelihood.given`). So an effect that set
in after them stands out against what this robot may do, and not against what any robot may.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from fishmj.base.errors import LogError
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.structural_error import Widths, applies
from fishmj.gap.progress import Bars, silent
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search.likelihood import Likelihood, likelihood_of
from fishmj.log import Trial


class Healthy(NamedTuple):
    """left: |z|^2 / m that the model leaves of the swims by the widths of other waters. swims: with the robot's own widths."""

    left: float
    swims: Likelihood


def known(model, trials: Sequence[Trial], null: SimulatedNull, bars: Bars = silent) -> Healthy | None:
    """What healthy swims tell; None of a model without a structural error, where nobody asks.

    Raises:
        LogError: none of them can be compared.
    """
    if not applies(model):
        return None
    if not trials:
        raise LogError("gap find: got no healthy swim; expected the logs that the water was calibrated to")
    # Where an experiment is done again, its noise is another: what both have in common is the fish.
    e = likelihood_of(model, [record_of(trial, model.dt) for trial in trials], replace(null, session=1), bars)
    return Healthy(e.gap(model.null)[0], e.with_own_widths())


def left_by(model, trials: Sequence[Trial], null: SimulatedNull, tables: dict[str, Widths]) -> dict[str, float]:
    """|z|^2 / m that the model leaves of healthy swims with each of several widths, by name."""
    records = [record_of(trial, model.dt) for trial in trials]
    runs = null.residuals(model, records, ResidualLayout(records))
    return {name: Likelihood(model, records, runs, widths=given).gap(model.null)[0] for name, given in tables.items()}
