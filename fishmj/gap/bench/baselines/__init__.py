"""What is done today when logs and simulator disagree, on the same cases as the search: four baselines, one file each.

everything_free        free every parameter at once, name the one that moved most
delta_bic              forward selection while BIC falls by more than 10
e_sindy                sparse regression of the accelerations that the model lacks (pysindy)
residual_correlation   the input that the residual goes with most

answer(plant, records) -> Answer        each; none of them sees null runs, which is how they are used
"""

from fishmj.gap.bench.baselines.answer import Answer
from fishmj.gap.bench.baselines.judged import NAMES, beside, compared, reason_absent, rows_of

__all__ = ["NAMES", "Answer", "beside", "compared", "reason_absent", "rows_of"]
