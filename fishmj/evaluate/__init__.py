"""Evaluation: the standard 72 trials, metrics of each trial, intervals, paired comparisons, plots.

    result = evaluate.run("dob", trials=evaluate.trials(turbulence="gust", intensity=0.10))
    evaluate.summary(result)["overall"]["rmse_last20"]

The protocol is in `protocol`, the loop in `run_trials`, definitions and intervals in `metrics`.
"""

from fishmj.evaluate.metrics import UNITS, IntervalEstimate, PairedDifference, Result, compare, figures, summary
from fishmj.evaluate.protocol import Trials, trials
from fishmj.evaluate.run_trials import run

__all__ = ["UNITS", "PairedDifference", "IntervalEstimate", "Result", "Trials", "compare", "figures", "run", "summary", "trials"]
