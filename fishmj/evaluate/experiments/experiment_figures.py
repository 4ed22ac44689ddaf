"""Figures and time series of trials as rows of a paper experiment, and findings from them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.paper_experiment import PaperFinding, Row
from fishmj.evaluate.metrics import Result, figures

EVERY = 0.2  # s between two saved samples of a time series


def figures_row(result: Result) -> Row:
    """Figures of every trial by key, and the trials' conditions."""
    found = {key: rounded(values, 6) for key, values in figures(result).items()}
    degrees = [round(float(np.degrees(t.los))) for t in result.trials.items]
    left = int(np.sum(result.left < len(result.t)))
    return {"figures": found, "speed": rounded(result.trials.speed, 3), "los": degrees, "left": left}


def series_row(result: Result, until: float = np.inf) -> Row:
    """Time series of every trial seen from its target: t (T,) s; upstream, side (to the left), distance m, heading deg (n, T).

    The heading is measured from upstream, not wrapped. A trial that left the domain has no values from then on.
    """
    step = round(EVERY / result.robot.timing.bus_dt)
    ticks = np.arange(0, np.sum(result.t <= until + 1e-9), step)
    away = result.pose[:, ticks, :2] - result.trials.targets(result.t[ticks])
    c, s = np.cos(result.trials.upstream), np.sin(result.trials.upstream)
    rows = {
        "upstream": c * away[..., 0] + s * away[..., 1],
        "side": c * away[..., 1] - s * away[..., 0],
        "heading": np.degrees(result.pose[:, ticks, 2] - result.trials.upstream),
        "distance": np.linalg.norm(away, axis=-1),
    }
    inside = ticks < result.left[:, None]
    digits = {"heading": 1}
    return {"t": rounded(result.t[ticks], 2)} | {
        k: rounded(np.where(inside, x, np.nan), digits.get(k, 3)) for k, x in rows.items()
    }


def rounded(values: Any, digits: int) -> Any:
    """Rounded numbers as lists; None for NaN."""
    if np.ndim(values):
        return [rounded(x, digits) for x in values]
    return round(float(values), digits) if np.isfinite(values) else None


def read(values: Any) -> np.ndarray:
    """Inverse of `rounded`: an array with NaN for None."""
    return np.array(values, float)


def compared(what: str, paper: str, values: Any, unit: str = "", *, digits: int = 3, median: bool = False) -> PaperFinding:
    """Finding from values of single trials: mean, or median, with its interval, and the number of values if some are missing."""
    given = read(values).ravel()
    found = metrics.estimate("approach_time" if median else "", given)
    if not found.n:
        return PaperFinding(what, paper, f"none of {len(given)} trials" if len(given) else "none", *found[:4])
    text = f"{found.value:.{digits}f}" + ("" if found.why else f" ({found.low:.{digits}f} {found.high:.{digits}f})")
    some = f", {found.n} of {len(given)} trials" if found.n < len(given) else ""
    return PaperFinding(what, paper, f"{text} {unit}".strip() + some, *found[:4])


def error_bars(samples: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Means (n,) of n samples, and how far their intervals reach below and above (2, n); 0 where there is none."""
    some = [metrics.estimate("", read(values)) for values in samples]
    middle = np.array([e.value for e in some])
    return middle, np.nan_to_num(np.abs(np.array([[e.low, e.high] for e in some]).T - middle))


def counted(what: str, paper: str, flags: Sequence[Any] | np.ndarray) -> PaperFinding:
    """Finding of the number of trials with a true flag, with Wilson's interval of their share."""
    from scipy.stats import binomtest

    some = read(flags).ravel()
    hits, n = int(np.nansum(some)), len(some)
    low, high = binomtest(hits, n).proportion_ci(method="wilson") if n else (np.nan, np.nan)
    return PaperFinding(what, paper, f"{hits} of {n}", hits / max(n, 1), float(low), float(high), n)
