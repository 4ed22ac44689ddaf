"""Do two waters rank controllers alike? Gaps of one figure, and Kendall's tau over the pairs that both waters tell apart.

    gap        mean over trials of (surrogate - solver), same trials, with its bootstrap interval
    allowed    0.02 m, or twice what the solver's own mean moves by when the trials are repeated in it
    told apart in a water: the interval of the paired difference of two controllers excludes 0; at least `LEAST` trials
    tau-b      sum s_a s_b / sqrt(sum s_a^2 sum s_b^2),  s = sign of a pair's mean difference in each water (Kendall 1945)

Only pairs that are told apart in both waters count for the verdict: of a pair that lies within its interval nobody knows which
is better. Of fewer than `LEAST` trials even equal controllers would all have the same sign in more than 5 % of the draws,
2^(1 - n), so that no 95 % interval can be had from them.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from fishmj.evaluate.statistics import Difference, difference, estimate

GAP, TAU = 0.02, 0.8  # m; the least rank correlation
LEAST = 6  # trials
UNRANKED = ("drift",)  # shown beside the others

ByController = Mapping[str, np.ndarray]  # (n,) one figure a trial, m, NaN where a trial has none


def judged(key: str, solver: ByController, surrogate: ByController, again: Sequence[ByController] = ()) -> dict:
    """Everything that one figure says about two waters.

    Args:
        key: name of the figure. again: the solver's repeats of the same trials.
    Returns:
        controllers, pairs (rows), tau, counted, of, tau_all_pairs, gap_max, tolerances, passed by figure (None: cannot be told).
    """
    rows = [controller(key, name, solver[name], surrogate[name], [repeat[name] for repeat in again]) for name in solver]
    ranked = [row["controller"] for row in rows if row["ranked"]]
    pairs = [pair(key, a, b, solver, surrogate) for a, b in combinations(ranked, 2)]
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


def controller(key: str, name: str, solver, surrogate, again: Sequence = ()) -> dict:
    """One controller in both waters: its figure and the gap, over the trials that have it in both."""
    both = np.isfinite(solver) & np.isfinite(surrogate)
    a, b = np.asarray(solver, float)[both], np.asarray(surrogate, float)[both]
    gap, repeats = difference(key, a, b), [repeated(solver, other) for other in again]
    allowed = max([GAP, *(2 * abs(value) for value in repeats if np.isfinite(value))])
    return {
        "controller": name,
        "ranked": name not in UNRANKED,
        "n": gap.n,
        "lost": int(len(both) - gap.n),
        "solver": estimate(key, a)._asdict(),
        "surrogate": estimate(key, b)._asdict(),
        "gap": {"value": gap.value, "low": gap.low, "high": gap.high},
        "repeats": repeats,
        "allowed": allowed,
        "within": bool(abs(gap.value) <= allowed) if gap.n else None,
    }


def repeated(solver, again) -> float:
    """Mean over trials of what the solver's own figure moves by when a trial is repeated, m."""
    moved = np.asarray(again, float) - np.asarray(solver, float)
    known = moved[np.isfinite(moved)]
    return float(known.mean()) if len(known) else np.nan


def all_of(passed: list[bool | None]) -> bool | None:
    """False where one fails, else None where one cannot be told or there is none, else True."""
    return False if False in passed else True if passed and None not in passed else None


def pair(key: str, a: str, b: str, solver: ByController, surrogate: ByController) -> dict:
    """b minus a in both waters, over the trials that all four have."""
    four = [np.asarray(water[name], float) for water in (solver, surrogate) for name in (a, b)]
    all_four = np.isfinite(four).all(0)
    first, second = (difference(key, *(x[all_four] for x in two)) for two in (four[:2], four[2:]))
    told = [apart(first), apart(second)]
    return {
        "a": a,
        "b": b,
        "n": first.n,
        "solver": {"value": first.value, "low": first.low, "high": first.high},
        "surrogate": {"value": second.value, "low": second.low, "high": second.high},
        "solver_told": told[0],
        "surrogate_told": told[1],
        "counted": all(told),
        "agree": bool(first.value * second.value > 0),
    }


def apart(d: Difference) -> bool:
    """Whether a paired difference is one: its interval excludes 0, from `LEAST` trials or more."""
    return bool(d.n >= LEAST and (d.low > 0 or d.high < 0))


def kendall(pairs: list[dict]) -> float:
    """tau-b over pairs of controllers; a tie in one water shortens it; NaN where no pair differs in both."""
    signs = np.sign([[row["solver"]["value"], row["surrogate"]["value"]] for row in pairs]).reshape(-1, 2)
    signs = signs[np.isfinite(signs).all(1)]
    both = np.prod(np.sum(signs**2, 0))
    return float(np.sum(signs[:, 0] * signs[:, 1]) / np.sqrt(both)) if both > 0 else np.nan
