"""Score of the rows of a benchmark, each share with its 95 % bounds (Clopper & Pearson 1934)."""

import json
from types import ModuleType

import numpy as np

from fishmj.base import console
from fishmj.base.store import write_text

DETECTABLE = 5.0  # true gap from which naming is expected


def show_score(result: dict, lines: list[str], args) -> None:
    """Keeps a score in `args.out`, and prints it."""
    if args.out:
        write_text(args.out / "score.json", json.dumps(console.plain(result), indent=1))
    console.say(*lines)
    if args.json:
        console.emit_json(result)


def print_score(scoring: ModuleType, rows: list[dict], args, strict: bool) -> int:
    """Prints the score by a module with `score` and `report_lines`. Returns the exit code: 1 if `strict` and an aim is missed."""
    result = scoring.score(rows)
    show_score(result, scoring.report_lines(result), args)
    return console.FAILED_CHECK if strict and any(aim["met"] is False for aim in result["aims"]) else console.OK


def bounds(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Exact binomial interval of a share."""
    from scipy.stats import beta

    if n == 0:
        return 0.0, 1.0
    tail = (1 - level) / 2
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(1 - tail, hits + 1, n - hits))
    return low, high


def share(hits: int, n: int) -> dict:
    """{"value", "hits", "n", "low", "high"}; the value is None for n = 0."""
    low, high = bounds(hits, n)
    return {"value": hits / n if n else None, "hits": int(hits), "n": int(n), "low": low, "high": high}


def names(row: dict) -> set[str]:
    """Names of the effects in a row's answer."""
    return {e["name"] for e in row.get("said", ())}


def same(a: str, b: str) -> bool:
    """Returns True for equal names, or for two of one class that no experiment of the standard session separates."""
    from fishmj.effects.ambiguity import CLASSES

    return a == b or any({a, b} <= set(c.effects) for c in CLASSES)


def twin(row: dict) -> bool:
    """Returns True if a CLASS lists only the hidden effect and those that are the same by construction."""
    hidden = next(iter(row["truth"]))
    listed = names(row) | set(row["rivals"])
    return hidden in listed and all(same(name, hidden) for name in listed)


def score(rows: list[dict]) -> dict:
    """All figures of a benchmark."""
    rows = [r for r in rows if r["answer"] != "DIVERGED"]
    kind = {k: [r for r in rows if r["kind"] == k] for k in ("single", "pair", "none", "off")}
    singles = [r for r in kind["single"] if r["true_gap"] > DETECTABLE]
    named = [r for r in singles if r["answer"] == "NAMED"]
    right = [r for r in named if names(r) == set(r["truth"])]
    alike = [r for r in named if len(names(r)) == 1 and same(next(iter(names(r))), next(iter(r["truth"])))]
    everything = [r for r in kind["single"] if r["answer"] == "NAMED" and names(r) == set(r["truth"])]
    beyond = [r for r in kind["single"] if r["beyond_gap"] > DETECTABLE]
    listed = [r for r in beyond if r["answer"] in ("NAMED", "CLASS") and set(r["truth"]) <= names(r) | set(r["rivals"])]
    twins = [r for r in singles if r["answer"] == "CLASS" and twin(r)]
    said = [r for r in singles if r["answer"] != "AGREES" and r["said"]]
    top = [r for r in said if same(r["said"][0]["name"], next(iter(r["truth"])))]
    pairs = [r for r in kind["pair"] if min(r["each_gap"].values()) > DETECTABLE]  # of either alone
    both = [r for r in pairs if set(r["truth"]) <= names(r)]
    apart = [r for r in kind["pair"] if min(r.get("each_beyond", r["each_gap"]).values()) > DETECTABLE]
    alike_both = [r for r in apart if all(any(same(n, t) for n in names(r)) for t in r["truth"])]
    errors = [e for r in right for e in relative_errors(r)]
    closed = [
        1 - (r["gap_unseen"] - 1) / (r["gap_before"] - 1) for r in right if r["gap_unseen"] is not None and r["gap_before"] > 1.5
    ]
    covered = [c for r in right for c in inside(r)]
    return {
        "n": len(rows),
        "precision": share(len(right), len(named)),
        "precision_of_class": share(len(alike), len(named)),
        "coverage": share(len(right), len(singles)),
        "coverage_or_twins": share(len(right) + len(twins), len(singles)),
        "agrees_though_detectable": share(sum(r["answer"] == "AGREES" for r in singles), len(singles)),
        "coverage_all_magnitudes": share(len(everything), len(kind["single"])),
        "coverage_beyond_tolerance": share(
            sum(r["answer"] == "NAMED" and names(r) == set(r["truth"]) for r in beyond), len(beyond)
        ),
        "coverage_beyond_tolerance_or_class": share(len(listed), len(beyond)),
        "class_top1": share(len(top), len(said)),
        "false_alarm_rate": share(sum(r["answer"] in ("NAMED", "CLASS") for r in kind["none"]), len(kind["none"])),
        "misnamed_off_catalogue": share(sum(r["answer"] == "NAMED" for r in kind["off"]), len(kind["off"])),
        "pairs_both_found": share(len(both), len(pairs)),
        "pairs_beyond_tolerance_or_twins": share(len(alike_both), len(apart)),
        "interval_coverage": share(sum(covered), len(covered)),
        "parameter_error_median": float(np.median(errors)) if errors else None,
        "parameter_error_p90": float(np.percentile(errors, 90)) if errors else None,
        "excess_gap_closed_median": float(np.median(closed)) if closed else None,
        "seconds_median": float(np.median([r["seconds"] for r in rows])) if rows else None,
    }


def has_values(effect: dict) -> bool:
    """Returns True if a name has values; a correlation has none."""
    return all(v is not None for values in effect["values"].values() for v in values)


def relative_errors(row: dict) -> list[float]:
    """|found - true| / |true - null| of the first parameter of each effect; vectors by their length."""
    from fishmj import effects

    out = []
    for e in filter(has_values, row["said"]):
        truth = row["truth"][e["name"]]
        spec = {p.name: p for p in effects.get(e["name"]).parameters}
        shared = [k for k in truth if k in e["values"] and spec[k].unit == effects.get(e["name"]).parameters[0].unit]
        size = np.linalg.norm([truth[k] - spec[k].null for k in shared])
        if size > 0:
            out.append(float(np.linalg.norm([e["values"][k][0] - truth[k] for k in shared]) / size))
    return out


def inside(row: dict) -> list[bool]:
    """Returns True for each first parameter that lies in its 90 % interval."""
    from fishmj import effects

    out = []
    for e in filter(has_values, row["said"]):
        first = effects.get(e["name"]).parameters[0].name
        if first in row["truth"][e["name"]]:
            _, low, high = e["values"][first]
            out.append(low <= row["truth"][e["name"]][first] <= high)
    return out
