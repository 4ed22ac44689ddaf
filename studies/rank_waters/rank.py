"""Comparison of two waters' rankings: gaps of one figure, and Kendall's tau over the pairs that both waters separate.

    gap        mean over trials of (surrogate - solver), same trials, with its bootstrap interval; for a trial that was repeated
               in a water, the mean over its runs there: a fish that overshoots and turns back is chaotic
    allowed    0.02 m, or twice the change of the solver's own mean when the trials are repeated in it
    told apart in a water: the interval of two controllers' paired difference excludes 0 (`metrics.PairedDifference.apart`)
    tau-b      sum s_a s_b / sqrt(sum s_a^2 sum s_b^2),  s = sign of a pair's mean difference in each water (Kendall 1945)

Only pairs that differ significantly in both waters count, because the order of other pairs is unknown.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from fishmj.evaluate.metrics import difference, estimate

GAP, TAU = 0.02, 0.8  # m; the least rank correlation
UNRANKED = ("drift",)  # shown beside the others

ByController = Mapping[str, np.ndarray]  # (n,) one figure a trial, m, NaN where a trial has none


def judged(key: str, solver: Sequence[ByController], surrogate: Sequence[ByController]) -> dict:
    """Comparison of two waters in one figure.

    Args:
        key: name of the figure. solver, surrogate: runs of the same trials in each water, the trials as drawn first.
    Returns:
        controllers, pairs (rows), tau, counted, of, tau_all_pairs, gap_max, tolerances, passed by figure (None: undecided).
    """
    waters = [{name: np.array([run[name] for run in runs], float) for name in solver[0]} for runs in (solver, surrogate)]
    rows = [controller(key, name, *(water[name] for water in waters)) for name in solver[0]]
    ranked = [row["controller"] for row in rows if row["ranked"]]
    means = [{name: typical(runs) for name, runs in water.items()} for water in waters]
    pairs = [pair(key, a, b, *means) for a, b in combinations(ranked, 2)]
    counted = [row for row in pairs if row["counted"]]
    within = [row["within"] for row in rows if row["ranked"]]
    tau = kendall(counted)
    return {
        "key": key,
        "controllers": rows,
        "pairs": pairs,
        "tau": tau,
        "counted": len(counted),
        "of": len(pairs),
        "told_apart": {water: sum(row[f"{water}_told"] for row in pairs) for water in ("solver", "surrogate")},
        "tau_all_pairs": kendall(pairs),
        "gap_max": max((abs(row["gap"]["value"]) for row in rows if row["ranked"] and row["n"]), default=np.nan),
        "tolerances": {"gap_max": GAP, "tau": TAU},
        "passed": {"gap_max": all_of(within), "tau": bool(tau >= TAU) if counted else None},
    }


def controller(key: str, name: str, solver: np.ndarray, surrogate: np.ndarray) -> dict:
    """Figure and gap of one controller in both waters, (runs, n) each, over the trials that have it in both."""
    means = typical(solver), typical(surrogate)
    both = np.isfinite(np.stack(means)).all(0)
    a, b = (mean[both] for mean in means)
    gap, repeats = difference(key, a, b), [repeated(solver[0], other) for other in solver[1:]]
    allowed = max([GAP, *(2 * abs(value) for value in repeats if np.isfinite(value))])
    return {
        "controller": name,
        "ranked": name not in UNRANKED,
        "n": gap.n,
        "lost": int(len(both) - gap.n),
        "solver": estimate(key, a)._asdict(),
        "surrogate": estimate(key, b)._asdict(),
        "gap": {key: getattr(gap, key) for key in ("value", "low", "high", "why")},
        "repeats": repeats,
        "runs": [len(solver), len(surrogate)],
        "allowed": allowed,
        "within": bool(abs(gap.value) <= allowed) if gap.n else None,
    }


def typical(runs: np.ndarray) -> np.ndarray:
    """Mean of every trial over the runs that have it, (runs, n) -> (n,)."""
    known = np.isfinite(runs)
    with np.errstate(invalid="ignore"):
        return np.where(known, runs, 0.0).sum(0) / known.sum(0)


def repeated(first: np.ndarray, again: np.ndarray) -> float:
    """Mean over trials of the change of a water's own figure when a trial is repeated, m."""
    moved = again - first
    known = moved[np.isfinite(moved)]
    return float(known.mean()) if len(known) else np.nan


def all_of(passed: list[bool | None]) -> bool | None:
    """Returns False if one fails, else None if one is undecided or the list is empty, else True."""
    return False if False in passed else True if passed and None not in passed else None


def pair(key: str, a: str, b: str, solver: ByController, surrogate: ByController) -> dict:
    """Difference b minus a in both waters, over the trials that all four have."""
    four = [np.asarray(water[name], float) for water in (solver, surrogate) for name in (a, b)]
    all_four = np.isfinite(four).all(0)
    first, second = (difference(key, *(x[all_four] for x in two)) for two in (four[:2], four[2:]))
    apart = [first.apart, second.apart]
    return {
        "a": a,
        "b": b,
        "n": first.n,
        "solver": {"value": first.value, "low": first.low, "high": first.high},
        "surrogate": {"value": second.value, "low": second.low, "high": second.high},
        "why": first.why,
        "solver_told": apart[0],
        "surrogate_told": apart[1],
        "counted": all(apart),
        "agree": bool(first.value * second.value > 0),
    }


def kendall(pairs: list[dict]) -> float:
    """Kendall's tau-b over pairs of controllers; a tie in one water shortens it; NaN if no pair differs in both."""
    signs = np.sign([[row["solver"]["value"], row["surrogate"]["value"]] for row in pairs]).reshape(-1, 2)
    signs = signs[np.isfinite(signs).all(1)]
    both = np.prod(np.sum(signs**2, 0))
    return float(np.sum(signs[:, 0] * signs[:, 1]) / np.sqrt(both)) if both > 0 else np.nan
