"""Four usual methods for a disagreement of logs and simulator, on the same cases as the search; one file each.

everything_free        free every parameter at once, name the one that moved most
delta_bic              forward selection while BIC falls by more than 10
e_sindy                sparse regression of the accelerations that the model lacks (pysindy)
residual_correlation   the input with the largest correlation to the residual

answer(plant, records) -> BaselineAnswer    each; none of them sees null runs, as in their usual use
"""

from fishmj.gap.bench.baselines.baseline_answer import BaselineAnswer
from fishmj.gap.bench.baselines.baseline_scores import NAMES, beside, compared, reason_absent, rows_of

__all__ = ["NAMES", "BaselineAnswer", "beside", "compared", "reason_absent", "rows_of"]
