"""Answers of finished searches under other thresholds, and thresholds chosen on some rows.

A row keeps what the gates measured, so an answer can be given again without a search:

    gain        of the first round, below which the search found nothing (only a larger one can be replayed)
    closure, residual, size, transfer     as in decide/decide.py
    excess      gain by a larger form error than allowed
    p_best      share of bootstrap draws that the best must win
    allowed     torque that no effect explains, over the stated tolerance;  share: of its mean square that an effect may leave
    floors      of the residual that may be left

Other gates stay as they were: a row whose recorded answer is not that of the replay under the shipped thresholds keeps it, unless
a larger `gain` takes it away. An effect that the search stopped before cannot be added.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from fishmj import effects
from fishmj.gap.thresholds import frozen, residual_allowed, thresholds


class RobotLimits(NamedTuple):
    """Thresholds that a replay may change."""

    gain: float
    closure: float
    residual: float
    excess: float
    size: float
    transfer: float
    p_best: float
    allowed: float
    share: float
    floors: float


def shipped() -> RobotLimits:
    """The thresholds of data/calib/gap.toml."""
    gates, own, excess = frozen(), thresholds().torques, thresholds().model_error.excess
    kept = (gates.closure, gates.residual, excess, gates.size, gates.transfer, gates.p_best)
    return RobotLimits(own.gain, *kept, own.allowed, own.share, own.floors)


SHIPPED = shipped()
GRID = {  # tried values of each threshold, one after the other
    "gain": (100.0, 200.0, 400.0, 800.0, 1600.0),
    "closure": (0.4, 0.6, 0.75, 0.9),
    "residual": (1.0, 1.15, 1.4, 2.0, 3.0),
    "excess": (10.0, 30.0, 100.0, 300.0, 1000.0, 10000.0),
    "size": (0.2, 0.35, 0.5),
    "transfer": (0.5, 0.8, 1.0),
    "p_best": (0.7, 0.8, 0.9, 0.97),
    "allowed": (2.0, 3.0, 5.0, 8.0),
    "share": (0.1, 0.2, 0.35, 0.5, 0.7, 0.9),
    "floors": (1.0, 1.25, 1.5, 2.0, 3.0),
}
PASSES = 3


def replayed(row: dict, limits: RobotLimits) -> dict:
    """The row with the answer and the names that other thresholds give."""
    if limits == SHIPPED or not row.get("gates"):
        return row
    now, kept = _again(row, limits)
    as_it_was, _ = _again(row, SHIPPED)
    if as_it_was != row["answer"] and now != "AGREES":
        return row
    mine = [e for e in _all(row) if e["name"] in kept]
    return row | {"answer": now, "said": mine}


def _all(row: dict) -> list[dict]:
    return [*row["said"], *(e for e in row.get("tentative", ()) if e["name"] not in {s["name"] for s in row["said"]})]


def _again(row: dict, limits: RobotLimits) -> tuple[str, set[str]]:
    """(answer, names) of a row under other thresholds."""
    gates, steps = row["gates"], row["steps"]
    found = {e["name"] for e in row["said"]}
    quiet = gates["adequacy"] <= frozen().adequacy
    ratio = _torques(row)
    loud = [joint for joint, (_, after) in ratio.items() if after > limits.allowed]
    if not steps or not steps[0]["accepted"] or steps[0]["gain"] < limits.gain:
        return ("AGREES" if quiet and not loud else "UNEXPLAINED"), found
    if "closure" not in gates:
        return row["answer"], found
    answer = _by_gates(row, limits)
    if answer == "UNEXPLAINED" or gates.get("floors", 0.0) > limits.floors:
        return "UNEXPLAINED", found
    if not loud:
        return answer, found
    everywhere = sum(a**2 for _, a in ratio.values()) / max(sum(b**2 for b, _ in ratio.values()), 1e-12)
    least = {
        name: ((ratio[site][1] / max(ratio[site][0], 1e-12)) ** 2 if site in loud else 0.0) if site in ratio else everywhere
        for name in (e["name"] for e in _all(row))
        for site in (effects.site_of(name),)
    }
    kept = {name for name in least if least[name] <= limits.share and (name in found or least[name] > SHIPPED.share)}
    return (answer, kept) if kept else ("UNEXPLAINED", found)


def _torques(row: dict) -> dict[str, tuple[float, float]]:
    """Joint -> torque that nothing explains before and after, over the stated tolerance."""
    told = row["gates"].get("torques", {})
    return {
        joint: (before / size, after / size)
        for (joint, (before, after)), size in zip(told.items(), row.get("torque_tolerance", ()), strict=False)
        if size > 0
    }


def _by_gates(row: dict, limits: RobotLimits) -> str:
    """Answer of the gates of decide/decide.py."""
    checks = row["gates"]
    gates = replace(frozen(), residual=limits.residual)
    number = lambda key, otherwise: checks[key] if checks.get(key) is not None else otherwise
    if number("closure", 0.0) < limits.closure and number("rest", 1e9) > (1.0 + gates.adequacy) / 2:
        return "UNEXPLAINED"
    if number("rest", 1e9) > residual_allowed({k: v for k, v in checks.items() if v is not None}, gates):
        return "UNEXPLAINED"
    most = max(limits.excess, thresholds().model_error.excess_fraction * number("gain", 0.0))
    if not checks.get("pinned") and number("strain", 0.0) > most:
        return "UNEXPLAINED"
    if number("size", 1e9) > limits.size or number("transfer", 0.0) < limits.transfer:
        return "UNEXPLAINED"
    close = [r for r in row.get("standing", ()) if r["behind"] < frozen().margin or r["p_best"] > 1.0 - limits.p_best]
    if close or any(e["p_best"] < limits.p_best for e in row["said"]):
        return "CLASS"
    doubts = [w for w in row["warnings"] if not w.startswith("torques of")]
    return "CLASS" if doubts else "NAMED"


def chosen(rows: list[dict], figures: Callable[[list[dict]], dict]) -> RobotLimits:
    """Thresholds with the best coverage of these rows among those that name nothing wrong, one threshold at a time."""
    best, worth = SHIPPED, _worth(rows, figures, SHIPPED)
    for _ in range(PASSES):
        before = best
        for key, values in GRID.items():
            for value in values:
                tried = best._replace(**{key: value})
                if key == "gain" and value < SHIPPED.gain:
                    continue
                if (now := _worth(rows, figures, tried)) > worth + 1e-9:
                    best, worth = tried, now
        if best == before:
            break
    return best


def _worth(rows: list[dict], figures: Callable[[list[dict]], dict], limits: RobotLimits) -> float:
    """Coverage, and half of AGREES, less what is named wrong beyond half of what the aims allow."""
    found = figures([replayed(row, limits) for row in rows])
    get = lambda key, otherwise: found[key]["value"] if found[key]["n"] else otherwise
    wrong = 10.0 * max(0.0, 0.98 - get("precision", 1.0)) + 10.0 * max(0.0, get("nulls_named", 0.0) - 0.01)
    wrong += 5.0 * max(0.0, get("misnamed_outside", 0.0) - 0.025)
    return get("coverage", 0.0) + 0.5 * get("agrees", 1.0) - wrong
