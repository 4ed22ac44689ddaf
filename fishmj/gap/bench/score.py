"""Score of the rows of a benchmark, each share with its 95 % bounds (Clopper & Pearson 1934)."""

import json
from collections.abc import Callable, Iterable
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


def share(hits: int, n: int) -> dict:
    """{"value", "hits", "n", "low", "high"}; for n = 0 the value is None and the bounds are 0 and 1."""
    from scipy.stats import binomtest

    low, high = map(float, binomtest(hits, n).proportion_ci(method="exact")) if n else (0.0, 1.0)
    return {"value": hits / n if n else None, "hits": int(hits), "n": int(n), "low": low, "high": high}


def share_of(rows: list[dict], is_so: Callable[[dict], bool]) -> dict:
    """Share of the rows for which something is so, as of `share`."""
    return share(sum(map(is_so, rows)), len(rows))


def middle(values: list[float], quantile: float = 0.5) -> float | None:
    """Median, or another quantile, of values; None without any."""
    return float(np.quantile(values, quantile)) if values else None


def figure_line(key: str, value, aim: dict | None = None, width: int = 28, digits: int = 3) -> str:
    """A figure as a line of text: a number, or a share with its bounds, its aim and whether it is met."""
    if not isinstance(value, dict):
        return f"  {key:{width}s} {value if value is None or isinstance(value, int) else round(value, digits)}"
    if not value["n"]:
        return f"  {key:{width}s}      -  (none)"
    within = f"95 %: {value['low']:.1%} to {value['high']:.1%}"
    text = f"  {key:{width}s} {value['value']:6.1%}  ({value['hits']} of {value['n']}; {within})"
    if aim is None:
        return text
    low, high = aim["low"], aim["high"]
    ends = f"<= {high:.0%}" if low == 0.0 else f">= {low:.0%}" if high == 1.0 else f"{low:.0%} to {high:.0%}"
    return f"{text}  aim {ends}: {'met' if aim['met'] else 'MISSED'}"


def share_cells(found: dict, keys: Iterable[str]) -> dict[str, str]:
    """Cells of a table {key in words: hits and cases} of some shares."""
    return {key.replace("_", " "): f"{found[key]['hits']} of {found[key]['n']}" for key in keys}


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
        "agrees_though_detectable": share_of(singles, lambda r: r["answer"] == "AGREES"),
        "coverage_all_magnitudes": share(len(everything), len(kind["single"])),
        "coverage_beyond_tolerance": share_of(beyond, lambda r: r["answer"] == "NAMED" and names(r) == set(r["truth"])),
        "coverage_beyond_tolerance_or_class": share(len(listed), len(beyond)),
        "class_top1": share(len(top), len(said)),
        "false_alarm_rate": share_of(kind["none"], lambda r: r["answer"] in ("NAMED", "CLASS")),
        "misnamed_off_catalogue": share_of(kind["off"], lambda r: r["answer"] == "NAMED"),
        "pairs_both_found": share(len(both), len(pairs)),
        "pairs_beyond_tolerance_or_twins": share(len(alike_both), len(apart)),
        "interval_coverage": share(sum(covered), len(covered)),
        "parameter_error_median": middle(errors),
        "parameter_error_p90": middle(errors, 0.9),
        "excess_gap_closed_median": middle(closed),
        "seconds_median": middle([r["seconds"] for r in rows]),
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
