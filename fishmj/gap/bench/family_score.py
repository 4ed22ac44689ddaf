"""Score of the rows of several families: by family and pooled, each share with its 95 % bounds, and the aims.

    detectable      mean square of the hidden effect, over the noise and the scatter of healthy robots of that family, above 5
    precision       of detectable singles that are NAMED: the hidden effect and nothing beside it; a phantom counts as wrong
    phantoms        names beside the hidden ones, of all NAMED rows with something hidden, whatever its size
    or twins        `CLASS` counts, too, if it lists only the hidden effect and those that are the same by construction
    old definition  over the noise alone (`noise_only`), the figure of the benchmark on the second robot

A refused search counts as a silent one. A robot that left the finite numbers is left out, and counted; so is a case that was not
searched because its effect is too small (`drawn_robots.searched`).
"""

from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.gap.bench.score import figure_line, inside, middle, names, relative_errors, same, share, share_cells, share_of, twin
from fishmj.gap.laboratory.generators.detectability import BOUND


class Aim(NamedTuple):
    """A share of `scored`, its range, and the requested number of cases in sum."""

    key: str
    low: float
    high: float
    asked: int

    def met(self, found: dict) -> bool | None:
        """Returns True if the point estimate lies in the range; None without a case."""
        return self.low <= found["value"] <= self.high if found["n"] else None

    def row(self, pooled: dict) -> dict:
        """The aim beside the number of its cases in `pooled`, and whether it is met."""
        found = pooled[self.key]
        return {"aim": self.key, "low": self.low, "high": self.high, "asked": self.asked, "n": found["n"], "met": self.met(found)}


AIMS = (
    Aim("false_alarms", 0.0, 0.02, 200),
    Aim("agrees", 0.80, 1.0, 200),
    Aim("precision", 0.97, 1.0, 1),
    Aim("coverage", 0.80, 1.0, 200),
    Aim("misnamed_off_catalogue", 0.0, 0.05, 80),
    Aim("pairs_both_found", 0.50, 1.0, 60),
    Aim("intervals_hold", 0.80, 0.97, 1),
)
FEWEST = 25  # cases of a family and kind
KINDS = {"false_alarms": "none", "coverage": "detectable singles", "misnamed_off_catalogue": "off", "pairs_both_found": "pairs"}


def score(rows: list[dict]) -> dict:
    """{"pooled": figures, "families": {name: figures}, "models": {"drawn", "fish"}, "aims": [..]}, figures as of `figures`."""
    apart = lambda key: {name: figures([r for r in rows if r[key] == name]) for name in sorted({r[key] for r in rows})}
    pooled = figures(rows)
    return {"pooled": pooled, "families": apart("family"), "models": apart("model"), "aims": [aim.row(pooled) for aim in AIMS]}


def figures(every: list[dict]) -> dict:
    """All shares of some rows."""
    rows = [r for r in every if r["answer"] not in ("DIVERGED", "NOT_SEARCHED")]
    kind = {k: [r for r in rows if r["kind"] == k] for k in ("single", "pair", "none", "off")}
    singles = [r for r in kind["single"] if r.get("detectable", 0.0) > BOUND]
    old = [r for r in kind["single"] if r.get("noise_only", 0.0) > BOUND]
    named = [r for r in singles if r["answer"] == "NAMED"]
    whole = [r for r in named if names(r) == set(r["truth"])]
    right = [r for r in old if r["answer"] == "NAMED" and names(r) == set(r["truth"])]
    alike = [r for r in named if len(names(r)) == 1 and same(next(iter(names(r))), next(iter(r["truth"])))]
    hiding = [r for k in ("single", "pair") for r in kind[k] if r["answer"] == "NAMED"]
    twins = [r for r in singles if r["answer"] == "CLASS" and twin(r)]
    pairs = [r for r in kind["pair"] if min(r.get("each_detectable", {"": 0.0}).values()) > BOUND]
    either = [r for r in kind["pair"] if r.get("detectable", 0.0) > BOUND]
    said = [r for r in singles if r["said"]]
    errors = [e for r in whole for e in relative_errors(r)]
    seconds = [r["seconds"] for r in rows if "seconds" in r]
    speed_errors = [e for r in rows if (e := (r.get("calibrated") or {}).get("value")) is not None]
    count = lambda given, *answers: sum(r["answer"] in answers for r in given)
    return {
        "n": len(rows),
        "robots": len({r["robot"] for r in rows}),
        "false_alarms": share(count(kind["none"], "NAMED", "CLASS"), len(kind["none"])),
        "agrees": share(count(kind["none"], "AGREES"), len(kind["none"])),
        "precision": share(len(whole), len(named)),
        "precision_of_class": share(len(alike), len(named)),
        "coverage": share(len(whole), len(singles)),
        "coverage_or_twins": share(len(whole) + len(twins), len(singles)),
        "first_is_right": share_of(said, lambda r: same(r["said"][0]["name"], next(iter(r["truth"])))),
        "agrees_though_detectable": share(count(singles, "AGREES"), len(singles)),
        "coverage_old_definition": share(len(right), len(old)),
        "phantoms": share_of(hiding, lambda r: not names(r) <= set(r["truth"])),
        "misnamed_off_catalogue": share(count(kind["off"], "NAMED"), len(kind["off"])),
        "pairs_both_found": share_of(pairs, lambda r: r["answer"] == "NAMED" and set(r["truth"]) <= names(r)),
        "pairs_one_found": share_of(either, lambda r: r["answer"] == "NAMED" and bool(set(r["truth"]) & names(r))),
        "intervals_hold": share(sum(held := [c for r in whole for c in inside(r)]), len(held)),
        "value_error_median": middle(errors),
        "value_error_p90": middle(errors, 0.9),
        "refused": count(rows, "REFUSED"),
        "diverged": count(every, "DIVERGED"),
        "not_searched": count(every, "NOT_SEARCHED"),
        "redraws": sum({r["robot"]: r.get("redraws", 0) for r in rows}.values()),
        "speed_error_mean": float(np.mean(speed_errors)) if speed_errors else None,
        "seconds_median": middle(seconds),
    }


def report_lines(result: dict) -> list[str]:
    """Score as lines of text: the pooled figures with their aims, then a table of the families and of the two kinds of model."""
    aims = {aim["aim"]: aim for aim in result["aims"]}
    lines = ["all families", *(figure_line(key, value, aims.get(key)) for key, value in result["pooled"].items())]
    parts = {**result["families"], **{f"model {name}": found for name, found in result["models"].items()}}
    keys = [aim.key for aim in AIMS]
    lines += ["", console.table([{"": name} | share_cells(found, keys) for name, found in parts.items()])]
    few = [(aim["n"], aim["asked"], KINDS[aim["aim"]]) for aim in result["aims"] if aim["aim"] in KINDS]
    less = ", ".join(f"{n} of {asked} {what}" for n, asked, what in few if n < asked)
    thin = ", ".join(
        f"{name} {found[key]['n']} {what}"
        for name, found in result["families"].items()
        for key, what in KINDS.items()
        if found[key]["n"] < FEWEST
    )
    lines += [f"fewer than asked in sum: {less}"] if less else []
    return lines + ([f"fewer than {FEWEST} in a family: {thin}"] if thin else [])
