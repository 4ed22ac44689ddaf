"""What a model leaves of the robot's own healthy swims: how much of a gap is usual for this robot in its water.

    level = ratio |z|^2 / m of the healthy swims        ratio: null/structural_error.py, `Widths.beyond_own`

Robots of other waters tell how far off a calibrated water may be, and a water unlike all of them may be further off. The swims
that it was calibrated to show how far: a model that leaves 1.5 of those, nothing missing, leaves no less of new experiments. Of
new ones it leaves more, since it was not fitted to them; how much more was measured on robots of other waters.
"""

from collections.abc import Sequence

from fishmj.errors import LogError
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.structural_error import Widths, applies
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search.likelihood import Likelihood, likelihood_of
from fishmj.gap.watch import Bars, silent
from fishmj.log import Trial


def left_of(model, trials: Sequence[Trial], null: SimulatedNull, bars: Bars = silent) -> float:
    """|z|^2 / m that the model leaves of healthy swims; 0 of a model without a structural error, where nobody asks.

    Raises:
        LogError: none of them can be compared.
    """
    if not applies(model):
        return 0.0
    if not trials:
        raise LogError("gap find: got no healthy swim; expected the logs that the water was calibrated to")
    records = [record_of(trial, model.dt) for trial in trials]
    return likelihood_of(model, records, null, bars).gap(model.null)[0]


def left_by(model, trials: Sequence[Trial], null: SimulatedNull, tables: dict[str, Widths]) -> dict[str, float]:
    """The same with each of several widths, by name."""
    records = [record_of(trial, model.dt) for trial in trials]
    runs = null.residuals(model, records, ResidualLayout(records))
    return {name: Likelihood(model, records, runs, widths=given).gap(model.null)[0] for name, given in tables.items()}
