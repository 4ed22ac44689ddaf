"""Score of the rows on articulated robots: pooled and by generator, with the shipped thresholds and with those of the others.

    shows         a single whose mean square over noise and healthy robots is above 5 (`robot_session.SEEN`)
    outside       what is hidden is in no catalogue, or not in that of robots at present
    named right   the hidden effect at its site and nothing beside it. An effect that is the same on this robot in any motion, and
                  is listed as that, stands for it (decide/indistinguishable.py)
    precision     of singles that show and are NAMED: right;  alone: right, and nothing is listed as the same
    listed        NAMED right, or a CLASS that lists the hidden effect at its site
    kind          as precision, whatever the site

Leave one generator out: thresholds are chosen on the rows of the others (robot_thresholds.py), and score the one left out.
"""

from collections.abc import Iterator

import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.gap.bench.family_score import Aim
from fishmj.gap.bench.robot_thresholds import SHIPPED, chosen, replayed
from fishmj.gap.bench.score import figure_line, names, share, share_cells, share_of
from fishmj.gap.laboratory.articulated.robot_session import SEEN

AIMS = (
    Aim("precision", 0.96, 1.0, 1),
    Aim("coverage", 0.70, 1.0, 200),
    Aim("nulls_named", 0.0, 0.02, 150),
    Aim("agrees", 0.80, 1.0, 150),
    Aim("misnamed_outside", 0.0, 0.05, 60),
    Aim("intervals_hold", 0.80, 0.97, 1),
)
ERROR = 0.08  # aim for the median error of values
NULLS = {"clock_drift": 1.0}  # values without effect, where they are not 0


def score(rows: list[dict]) -> dict:
    """{"pooled", "generators", "families": figures, "left_out": {generator: figures, thresholds}, "left_out_pooled", "aims"}."""
    of = lambda key: {name: figures([r for r in rows if r.get(key) == name]) for name in sorted({str(r.get(key)) for r in rows})}
    pooled = figures(rows)
    apart, left = leave_one_out(rows)
    return {
        "pooled": pooled,
        "generators": of("generator"),
        "families": of("family"),
        "left_out": apart,
        "left_out_pooled": figures(left) if left else None,
        "aims": [aim.row(pooled) for aim in AIMS],
    }


def leave_one_out(rows: list[dict]) -> tuple[dict, list[dict]]:
    """({generator: its figures and thresholds}, all rows), each with thresholds that never saw its generator."""
    found, left = {}, []
    generators = sorted({r["generator"] for r in rows})
    for name in generators if len(generators) > 1 else ():
        limits = chosen([r for r in rows if r["generator"] != name], figures)
        mine = [replayed(r, limits) for r in rows if r["generator"] == name]
        found[name] = {"thresholds": limits._asdict(), "figures": figures(mine)}
        left += mine
    return found, left


def kind_of(row: dict) -> str:
    """Kind of a case by the present catalogue: a single effect that it does not list is outside it."""
    if row["kind"] == "none" or "truth" not in row:
        return row["kind"]
    known = [effects.kind_of(name) in effects.robot_catalogue() for name in row["truth"]]
    return row["kind"] if all(known) or row["kind"] == "off" else "off" if not any(known) else "mixed"


def figures(every: list[dict]) -> dict:
    """All shares of some rows."""
    rows = [r for r in every if r["answer"] not in ("DIVERGED", "NOT_SEARCHED")]
    kind: dict[str, list[dict]] = {k: [r for r in rows if kind_of(r) == k] for k in ("single", "pair", "none", "off")}
    shows = lambda r: min(r["visible"].values()) > SEEN
    singles = [r for r in kind["single"] if shows(r)]
    outside = [r for r in kind["off"] if shows(r)]
    named = [r for r in singles if r["answer"] == "NAMED"]
    right = [r for r in named if is_right(r)]
    alone = [r for r in right if not any(e.get("same") for e in r["said"])]
    alike = [r for r in named if is_right(r) or {*map(effects.kind_of, names(r))} == {*map(effects.kind_of, r["truth"])}]
    classes = [r for r in singles if r["answer"] == "CLASS"]
    listed = [r for r in classes if set(r["truth"]) <= set().union(*meant(r)) | set(r["rivals"])]
    pairs = [r for r in kind["pair"] if shows(r)]
    count = lambda given, *answers: sum(r["answer"] in answers for r in given)
    errors = [e for r in right for e in relative_errors(r)]
    held = [c for r in right for c in inside(r)]
    cpu = [r["cpu_seconds"] for r in rows if "cpu_seconds" in r]
    return {
        "n": len(rows),
        "precision": share(len(right), len(named)),
        "precision_of_kind": share(len(alike), len(named)),
        "coverage": share(len(right), len(singles)),
        "coverage_alone": share(len(alone), len(singles)),
        "listed": share(len(right) + len(listed), len(singles)),
        "class": share(len(classes), len(singles)),
        "unexplained": share(count(singles, "UNEXPLAINED"), len(singles)),
        "agrees_though_shown": share(count(singles, "AGREES"), len(singles)),
        "nulls_named": share(count(kind["none"], "NAMED"), len(kind["none"])),
        "nulls_class": share(count(kind["none"], "CLASS"), len(kind["none"])),
        "agrees": share(count(kind["none"], "AGREES"), len(kind["none"])),
        "misnamed_outside": share(count(outside, "NAMED"), len(outside)),
        "outside_agrees": share(count(outside, "AGREES"), len(outside)),
        "pairs_both_found": share_of(pairs, lambda r: r["answer"] == "NAMED" and all_found(r)),
        "pairs_phantom": share_of(pairs, lambda r: r["answer"] == "NAMED" and not none_besides(r)),
        "intervals_hold": share(sum(held), len(held)),
        "value_error_median": median_with_bounds(errors),
        "refused": count(rows, "REFUSED"),
        "faults": count(rows, "FAULT"),
        "not_searched": count(every, "NOT_SEARCHED"),
        "diverged": count(every, "DIVERGED"),
        "cpu_seconds_mean": float(np.mean(cpu)) if cpu else None,
    }


def meant(row: dict) -> list[set[str]]:
    """Names that each effect of an answer stands for: its own, and those listed as the same on this robot."""
    return [{e["name"], *e.get("same", ())} for e in row["said"]]


def all_found(row: dict) -> bool:
    """Returns True if each hidden effect is among those of an answer."""
    return set(row["truth"]) <= set().union(*meant(row))


def none_besides(row: dict) -> bool:
    """Returns True if each effect of an answer stands for a hidden one."""
    return all(group & set(row["truth"]) for group in meant(row))


def is_right(row: dict) -> bool:
    """Returns True if the effects of an answer stand for the hidden ones, one for each."""
    return len(row["said"]) == len(row["truth"]) and all_found(row) and none_besides(row)


def values_of(row: dict) -> Iterator[tuple[str, dict[str, list[float]], dict[str, float]]]:
    """(effect, found values [value, low, high], true values) of the names that are right, by the parameters that both have."""
    for e in row["said"]:
        truth = row["truth"].get(e["name"], {})
        shared = {k: v for k, v in e["values"].items() if k in truth and all(x is not None for x in v)}
        if shared:
            yield effects.kind_of(e["name"]), shared, truth


def relative_errors(row: dict) -> list[float]:
    """|found - true| / |true - null| of the size of each effect; vectors by their length."""
    out = []
    for effect, found, truth in values_of(row):
        keys = size_keys(effect, found)
        null = NULLS.get(effect, 0.0)
        size = float(np.linalg.norm([truth[k] - null for k in keys]))
        if size > 0:
            out.append(float(np.linalg.norm([found[k][0] - truth[k] for k in keys]) / size))
    return out


def size_keys(effect: str, found) -> list[str]:
    """Parameters that set the size of an effect: those of the unit of the first one that is no shape."""
    form = effects.robot_catalogue()[effect].robot
    parameters = [p for p in form.parameters if p.name in found and not p.shape] if form else []
    return [p.name for p in parameters if p.unit == parameters[0].unit] or list(found)[:1]


def inside(row: dict) -> list[bool]:
    """Returns True for each size that lies in its 90 % interval."""
    return [f[k][1] <= t[k] <= f[k][2] for effect, f, t in values_of(row) for k in size_keys(effect, f)]


def median_with_bounds(values: list[float]) -> dict | None:
    """{"value", "low", "high", "n"}: median with its 95 % bounds by order statistics; None without values."""
    if not values:
        return None
    from scipy.stats import binom

    ordered = sorted(values)
    n = len(ordered)
    k = int(binom.ppf(0.025, n, 0.5))
    return {"value": float(np.median(ordered)), "low": ordered[max(k - 1, 0)], "high": ordered[min(n - k, n - 1)], "n": n}


def report_lines(result: dict) -> list[str]:
    """Score as lines of text."""
    aims = {aim["aim"]: aim for aim in result["aims"]}
    lines = ["all robots, thresholds as shipped", *(_line(k, v, aims.get(k)) for k, v in result["pooled"].items())]
    tables = {**result["generators"], **{f"robot {k}": v for k, v in result["families"].items()}}
    tables |= {f"{name}, left out": one["figures"] for name, one in result["left_out"].items()}
    if result["left_out_pooled"]:
        tables["all, left out"] = result["left_out_pooled"]
    lines += ["", console.table([{"": name} | _cells(found) for name, found in tables.items()])]
    for name, one in result["left_out"].items():
        moved = [f"{k} {v:g}" for k, v in one["thresholds"].items() if v != getattr(SHIPPED, k)]
        lines.append(f"thresholds chosen without {name}: {', '.join(moved) or 'as shipped'}")
    return lines


def _cells(found: dict) -> dict:
    """Table cells of one group of rows."""
    keys = ("precision", "coverage", "coverage_alone", "nulls_named", "agrees", "misnamed_outside", "intervals_hold")
    error = found["value_error_median"]
    return share_cells(found, keys) | {"value error": f"{100 * error['value']:.1f} %" if error else "-"}


def _line(key: str, value, aim: dict | None) -> str:
    if key == "value_error_median" and value:
        within = f"95 %: {value['low']:.1%} to {value['high']:.1%}"
        return f"  {key:24s} {value['value']:6.1%}  ({value['n']} values; {within})  aim <= {ERROR:.0%}"
    return figure_line(key, value, aim, 24, 1)
