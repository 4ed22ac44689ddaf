"""Power of the search: by effect and generator, how often it is found at given multiples of the scatter of healthy robots.

    strength    mean square of the effect's change in the logs, over the noise and the scatter of healthy robots of the family
                (`laboratory/generators/detectability.py`): `TIMES`. Its direction is drawn, its size scaled to the strength
    found       `NAMED`, or a `CLASS` that lists it;  missed: `AGREES`

A robot carries one case with nothing hidden, and `EFFECTS` effects at every strength. A strength that no value within the
effect's bounds reaches, or at which the robot no longer swims, is counted as such and not searched.
"""

import numpy as np

from fishmj import effects as catalogue
from fishmj.base import console
from fishmj.base.errors import SimDiverged
from fishmj.gap.bench import families
from fishmj.gap.bench.cases import BenchCase, draw_card
from fishmj.gap.bench.drawn_robots import BenchRobot, every
from fishmj.gap.bench.score import names, share
from fishmj.mjcf.description import Robot

TIMES = (5.0, 10.0, 20.0, 40.0)
LARGE = 20.0  # strength from which an effect must not be missed
MISSED, HEALTHY = 0.05, 0.80  # share of these that may agree; of robots with nothing hidden that should
EFFECTS = 3  # of a robot
CASES = 900
TRIES = 8  # scalings of one effect
NEAR = 1.15  # ratio of strengths that counts as the same
NOT_REACHED = "NOT_REACHED"


def robots(many: int, seed: int, able: tuple[str, ...], effects: tuple[str, ...] | None, logs: int) -> list[BenchRobot]:
    """Robots with `many` cases in sum, each effect before one comes up twice. effects: only these; None: all of the family."""
    out: list[BenchRobot] = []
    decks: dict[str, list[str]] = {name: [] for name in able}
    for robot in every(seed, able, logs):
        source = families.pool(robot.family).catalogued
        pool = [name for name in source if effects is None or name in effects]
        rng = np.random.default_rng([robot.seed, 17])
        chosen = list(dict.fromkeys(draw_card(decks[robot.family], pool, rng) for _ in range(min(EFFECTS, len(pool)))))
        healthy = robot.cases[0]._replace(kind="none", effects={})
        cases = [healthy]
        for name in chosen:
            drawn = source[name].draw(rng, 1.0)
            cases += [healthy._replace(kind="single", effects={name: drawn}, times=t) for t in TIMES]
        cases = [case._replace(id=f"{robot.id}-{k}") for k, case in enumerate(cases)]  # `drawn_robots.number_of` reads it
        left = many - sum(len(one.cases) for one in out)
        out.append(robot._replace(cases=tuple(cases[:left])))
        if left <= len(cases):
            break
    return out


def effect_at_strength(family: str, case: BenchCase, robot: Robot) -> tuple[dict, float]:
    """The effect of a case at its strength: (values, reached strength). The nearest if none reaches it.

    Raises SimDiverged: the robot does not swim at any tried size.
    """
    ((name, drawn),) = case.effects.items()
    spec = {p.name: p for p in catalogue.get(name).parameters}

    def grown(k: float) -> dict[str, float]:
        away = {key: spec[key].null + k * (value - spec[key].null) for key, value in drawn.items()}
        return {
            key: drawn[key] if spec[key].shape else float(np.clip(v, spec[key].low, spec[key].high)) for key, v in away.items()
        }

    known: dict[float, float] = {}  # strength by size
    size, last = 1.0, None
    for _ in range(TRIES):
        try:
            there = families.detectable(family, {name: grown(size)}, case.logs, case.seed, robot)["all"]
        except SimDiverged as error:
            last, size = error, size / 2.0
            continue
        known[size] = there
        if max(there, case.times) < NEAR * min(there, case.times) or (there < case.times and grown(4.0 * size) == grown(size)):
            break
        below, above = (sorted(k for k, d in known.items() if (d < case.times) == side) for side in (True, False))
        if below and above:  # straight in the logarithms between the two that enclose it
            (a, da), (b, db) = (below[-1], known[below[-1]]), (above[0], known[above[0]])
            part = np.log(case.times / max(da, 1e-9)) / np.log(db / max(da, 1e-9))
            size = float(np.exp(np.log(a) + np.clip(part, 0.1, 0.9) * np.log(b / a)))
        else:
            size *= float(np.clip(np.sqrt(case.times / max(there, 1e-9)), 0.1, 10.0))
    if not known:
        raise last or SimDiverged(f"{name}: no size was tried")
    best = min(known, key=lambda k: abs(np.log(max(known[k], 1e-9) / case.times)))
    return {name: grown(best)}, known[best]


def reaches(strength: float, times: float) -> bool:
    """Returns True if a strength counts as `times`."""
    return times / NEAR**2 < strength < times * NEAR**2


def found(row: dict) -> str:
    """Outcome for the effect of a row: named, class, agrees or other."""
    hidden = set(row["truth"])
    if row["answer"] == "NAMED" and hidden <= names(row):
        return "named"
    if row["answer"] == "CLASS" and hidden <= names(row) | set(row["rivals"]):
        return "class"
    return "agrees" if row["answer"] == "AGREES" else "other"


def score(rows: list[dict]) -> dict:
    """{"table": [{effect, family, times, n, named, class, agrees}], "times": {times: shares}, "healthy": share, "aims"}."""
    singles = [r for r in rows if r.get("times") and r["answer"] not in ("DIVERGED", NOT_REACHED)]
    groups: dict[tuple, list[dict]] = {}
    for row in singles:
        groups.setdefault((next(iter(row["truth"])), row["family"], row["times"]), []).append(row)
    counted = lambda mine: {what: sum(found(r) == what for r in mine) for what in ("named", "class", "agrees", "other")}
    table = [
        {"effect": effect, "family": family, "times": times, "n": len(mine)} | counted(mine)
        for (effect, family, times), mine in sorted(groups.items())
    ]
    by_times = {}
    for times in TIMES:
        mine = [r for r in singles if r["times"] == times]
        counts = counted(mine)
        by_times[f"{times:g}"] = {
            "named": share(counts["named"], len(mine)),
            "named_or_class": share(counts["named"] + counts["class"], len(mine)),
            "agrees": share(counts["agrees"], len(mine)),
        }
    large = [r for r in singles if r["times"] >= LARGE]
    none = [r for r in rows if r["kind"] == "none" and r["answer"] != "DIVERGED"]
    missed = share(sum(found(r) == "agrees" for r in large), len(large))
    healthy = share(sum(r["answer"] == "AGREES" for r in none), len(none))
    false = share(sum(r["answer"] in ("NAMED", "CLASS") for r in none), len(none))
    met = {"missed": missed["value"] <= MISSED if large else None, "healthy": healthy["value"] >= HEALTHY if none else None}
    lost = {
        "not_reached": sum(r["answer"] == NOT_REACHED for r in rows),
        "diverged": sum(r["answer"] == "DIVERGED" for r in rows),
    }
    return {"table": table, "times": by_times, "missed": missed, "healthy": healthy, "false_alarms": false, "met": met} | lost


def report_lines(result: dict) -> list[str]:
    """Score as lines of text: a row for each effect and generator, named + class + agrees of n at each strength; the shares."""
    cells: dict[tuple, dict] = {}
    for one in result["table"]:
        line = cells.setdefault((one["effect"], one["family"]), {"effect": one["effect"], "generator": one["family"]})
        line[f"{one['times']:g} times"] = f"{one['named']} + {one['class']} + {one['agrees']} of {one['n']}"
    columns = {f"{times:g} times": "-" for times in TIMES}
    lines = ["named + in its class + agrees, of n, by strength"]
    lines += [console.table([{**{k: line[k] for k in ("effect", "generator")}, **columns, **line} for line in cells.values()])]
    for times, one in result["times"].items():
        lines.append(f"{times:>3s} times: " + "; ".join(f"{what.replace('_', ' ')} {share_text(s)}" for what, s in one.items()))
    aim = {True: "met", False: "MISSED", None: "not asked"}
    met = {key: aim[value] for key, value in result["met"].items()}
    lines.append(f"{LARGE:g} times or more, AGREES: {share_text(result['missed'])}; aim <= {MISSED:.0%}: {met['missed']}")
    lines.append(f"nothing hidden, AGREES: {share_text(result['healthy'])}; aim >= {HEALTHY:.0%}: {met['healthy']}")
    lines.append(f"nothing hidden, NAMED or CLASS: {share_text(result['false_alarms'])}")
    return [*lines, f"strength out of reach: {result['not_reached']}; did not swim: {result['diverged']}"]


def share_text(s: dict) -> str:
    if not s["n"]:
        return "- (none)"
    return f"{s['value']:.0%} ({s['hits']} of {s['n']}; 95 %: {s['low']:.0%} to {s['high']:.0%})"
