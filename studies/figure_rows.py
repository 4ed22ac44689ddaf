"""Figures of the results pages from stored rows: each function returns the numbers of one row of a table, in its units and order.

`studies.figures` gives it the row's first cell without Markdown, and compares the numbers with those on the page.
"""

import csv
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from fishmj.base.calib import constant
from fishmj.evaluate.experiments.controller_comparison import BOUND, gap_closed
from fishmj.evaluate.metrics import difference, estimate, holm, paired_p
from fishmj.gap.bench import family_score, power

HERE = Path(__file__).resolve().parent
SOLVED, FITTED, SEARCHED = HERE / "solver" / "rows", HERE / "fitted_water" / "rows", HERE / "gap_benchmark" / "rows"
JUDGED = HERE / "training" / "rows" / "judged"
FILMED = {"flow observer": "dob", "vector PI": "pi", "PD": "pd", "PNL + ADRC-C1": "adrc-c1"}  # names of a page -> of the rows
ABLATION = {
    "MuJoCo's ellipsoids, fitted, inertia added": "ellipsoid-inertia",
    "strips: forces, swims": "base",
    "strips and residual": "whole",
    "the same, no wake": "memoryless",
    "the same, residual taught by forces alone": "forces-only",
}
SCORES = {  # row of a page -> key of a benchmark's score
    "precision": "precision",
    "coverage": "coverage",
    "the same, or a CLASS of the effect and its twins": "coverage_or_twins",
    "false alarms": "false_alarm_rate",
    "misnamed outside the catalogue": "misnamed_off_catalogue",
    "pairs, both found": "pairs_both_found",
    "intervals that hold": "interval_coverage",
}
OF_FAMILIES = {  # row of a page -> key of the families' score
    "false alarms": "false_alarms",
    "healthy: AGREES": "agrees",
    "precision": "precision",
    "coverage": "coverage",
    "the same, with twins": "coverage_or_twins",
    "misnamed": "misnamed_off_catalogue",
    "pairs, both found": "pairs_both_found",
    "intervals that hold": "intervals_hold",
}
FAMILIES = ("ellipsoid", "foil", "morison", "second_robot")
NAME = "station-family"
OTHER_WATERS = {  # row of a page -> water and seed of the stored trials, one or two of them; else the row is the water
    "reference, seeds 10; 11": [("reference-2", "10"), ("reference-2", "11")],
    "2 cm, slip 1": [("paper slip 1", "9")],
    "1.5 cm, slip 0.985": [("paper 1.5 cm slip 0.985", "9")],
    "1 cm, slip 0.995; 0.985": [("window slip 0.995", "9"), ("window slip 0.985", "9")],
    "reference, mass 20 % more; less": [(f"reference-2, mass 20 % {off}", "9") for off in ("more", "less")],
    "2 cm, slip 0.97, seeds 9; 10": [("paper slip 0.97", "9"), ("paper slip 0.97", "10")],
    "reference, at 0.35 and 0.4 m/s": [("reference-2, 0.35 and 0.4 m/s", "9")],
    "2 cm, slip 1, at 0, 0.02 and 0.04 m/s": [("paper slip 1, 0 to 0.04 m/s", "9")],
}
FORCES = {"drag, N": "drag_N", "lateral, N": "lateral_N", "yaw, N m": "yaw_Nm"}


@cache
def table(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(rows: Sequence[dict[str, str]], key: str) -> np.ndarray:
    """One column of rows; NaN where a cell is empty."""
    return np.array([float(row[key] or "nan") for row in rows])


def summary(rows: Sequence[dict[str, str]]) -> dict[str, float]:
    """Arrivals, trials, RMSE after arrival with its interval and its worst trial [m], RMSE of the last 20 s [m], power [W]."""
    arrival, after = column(rows, "arrival"), column(rows, "rmse_after_arrival")
    found = estimate("rmse_after_arrival", after)
    last, power = (float(np.nanmean(column(rows, key))) for key in ("rmse_last20", "power"))
    counts = {"arrivals": float(arrival.sum()), "trials": len(rows)}
    rmse = {"rmse": found.value, "low": found.low, "high": found.high, "worst": float(np.nanmax(after))}
    return counts | rmse | {"last": last, "power": power}


def judged(label: str) -> list[float]:
    """`station, plain` -> arrivals, trials, RMSE after arrival with its interval, RMSE of the last 20 s, power."""
    name, _, water = label.partition(", ")
    rows = [row for row in table(SOLVED / "judged_reference.csv") if (row["water"], row["controller"]) == (water, name)]
    if water == "plain":
        rows = [row for row in table(SOLVED / "judged_trials.csv") if row["controller"] == name]
    own = summary(rows)
    return [own[key] for key in ("arrivals", "trials", "rmse", "low", "high", "last", "power")]


def ranked(label: str) -> list[float]:
    """`PPO (station)` -> RMSE after arrival in the solver and in the fitted water, their difference with its interval."""
    name = FILMED.get(label.partition(" (")[0]) or label.partition("(")[2].rstrip(")")
    rows = [row for row in table(FITTED / "ranked_trials.csv") if row["controller"] == name]
    solver, fitted = (column(rows, f"rmse_after_arrival_{water}") for water in ("solver", "surrogate"))
    apart = difference("rmse_after_arrival", solver, fitted)
    both = np.isfinite(solver) & np.isfinite(fitted)
    return [float(solver[both].mean()), float(fitted[both].mean()), apart.value, apart.low, apart.high]


def ablation(label: str) -> list[float]:
    """Errors of speed, yaw rate and power [%] and of the place [m], means over seeds."""
    rows = [row for row in table(FITTED / "ablation.csv") if row["row"] == ABLATION[label]]
    shares = [100 * float(column(rows, f"{key}_error_mean").mean()) for key in ("speed", "yaw_rate", "power")]
    return [*shares, float(column(rows, "freerun_position_error").mean())]


def converged(label: str) -> list[float]:
    """`2 cm, 4 ms` -> cruise, drag and broadside force at slips 0, 0.98, 0.99, 1; `2 cm off 6.7 mm, %` -> their differences."""
    if label.endswith("%"):
        coarse, fine = (np.array(converged(grid)) for grid in ("2 cm, 4 ms", "6.7 mm, 1.33 ms"))
        return (100 * (coarse / fine - 1)).tolist()
    cell, step = (float(part.split()[0]) for part in label.split(", "))
    size = {"dx": cell / (100 if "cm" in label else 1000), "dt": step / 1000}
    rows = [row for row in table(SOLVED / "converge.csv") if all(abs(float(row[k]) / size[k] - 1) < 0.01 for k in size)]
    value = lambda what, slip: next(float(row["value"]) for row in rows if row["what"] == what and float(row["slip"]) == slip)
    return [value(what, slip) for what in ("cruise", "drag", "broadside") for slip in (0.0, 0.98, 0.99, 1.0)]


def force_map(label: str) -> list[float]:
    """Force or moment at 0.3 m/s and angle of attack 0 over the joint angles 0, 10 .. 60 deg."""
    rows = [row for row in table(SOLVED / "forcemap.csv") if row["what"] == "joint" and float(row["speed"]) == 0.3]
    return [float(row[FORCES[label]]) for row in sorted(rows, key=lambda row: float(row["joint_deg"]))]


def hybrid(label: str) -> list[float]:
    """`nothing (none)` -> RMSE minus the solver's, alone and corrected, each with its interval [m]; share that is left [%]."""
    (name,) = re.findall(r"\((\w+)\)", label)
    found = json.loads((FITTED / "hybrid" / f"{name}.json").read_text(encoding="utf-8"))
    (rmse,) = [row for row in found["off"] if row["figure"] == "rmse"]
    pair = [rmse[which][key] for which in ("alone", "hybrid") for key in ("value", "low", "high")]
    return [*pair, 100 * rmse["left"]]


def shares(file: str, label: str) -> list[float]:
    """Share with hits, number and bounds [%] of one row of a benchmark's score."""
    score = json.loads((SEARCHED / file).read_text(encoding="utf-8"))["score"]
    if label.startswith("error of the value"):
        return [100 * score["parameter_error_median"], 100 * score["parameter_error_p90"]]
    row = score[SCORES[label]]
    return [100 * row["value"], row["hits"], row["n"], 100 * row["low"], 100 * row["high"]]


def second_robot(label: str) -> list[float]:
    """A row of the second robot's benchmark, weighed and not weighed."""
    return [*shares("bench_2011_weighed.json", label), *shares("bench_2011.json", label)]


def flow_solver(label: str) -> list[float]:
    """A row of the benchmark in the flow solver."""
    return shares("bench_lbm.json", label)


@cache
def searches(file: str) -> list[dict]:
    """Rows of a benchmark, one a search."""
    return [json.loads(line) for line in (SEARCHED / file).read_text(encoding="utf-8").splitlines()]


def families(label: str) -> list[float]:
    """Share over all families with its bounds [%], then hits and number of each family in alphabetical order."""
    key, rows = OF_FAMILIES[label], searches("families_611.jsonl")
    pooled = family_score.figures(rows)[key]
    apart = [family_score.figures([row for row in rows if row["family"] == name])[key] for name in FAMILIES]
    return [*(100 * pooled[k] for k in ("value", "low", "high")), *(one[k] for one in apart for k in ("hits", "n"))]


def strengths(label: str) -> list[float]:
    """`5 times` or `nothing` -> searches, those named, in a class, agreed and others; strengths that were not reached."""
    rows = searches("power_741.jsonl")
    if label == "nothing":
        answers = [row["answer"] for row in rows if row["kind"] == "none" and row["answer"] != "DIVERGED"]
        counts = [answers.count(answer) for answer in ("NAMED", "CLASS", "AGREES")]
        return [len(answers), *counts, len(answers) - sum(counts)]
    some = [row for row in rows if row.get("times") == float(label.split()[0])]
    swum = [power.found(row) for row in some if row["answer"] not in ("DIVERGED", power.NOT_REACHED)]
    return [len(swum), *(swum.count(what) for what in ("named", "class", "agrees", "other")), len(some) - len(swum)]


def front_page(label: str) -> list[float]:
    """Figures of the README on `station-family`, then on `station` and on the search.

    RMSE in the reference water [m]; arrivals, trials and RMSE when trained without its fits; arrivals and trials at slip 0.97,
    least and greatest RMSE in other waters and of other robots, RMSE at slip 0.97; arrivals, trials, trials that hold and RMSE in
    almost still water, RMSE at slip 1 there; arrivals of 360, least and greatest RMSE in four fits and that in the structured
    water; RMSE of `station` in the reference water and at slip 1; right names.
    """
    tables = {file.stem: json.loads(file.read_text(encoding="utf-8"))["results"] for file in JUDGED.glob("*.json")}
    mine = {water: row["overall"] for water, rows in tables.items() for row in rows if row["controller"] == NAME}
    arrived = sum(figures["arrival"]["value"] * figures["arrival"]["n"] for figures in mine.values())
    fits = {water: figures["rmse_after_arrival"]["value"] for water, figures in mine.items()}
    structured = fits.pop("structured")
    every = table(HERE / "training" / "rows" / "judged_station_family.csv")
    rows = [row for row in every if row["controller"] == NAME]
    swims = [row for row in rows if not any(word in row["water"] for word in ("0.97", "0 to 0.04"))]
    drawn = {(row["water"], row["seed"]) for row in swims}
    other = [summary([row for row in swims if (row["water"], row["seed"]) == one])["rmse"] for one in drawn]
    without = summary([row for row in every if row["controller"] == "trained without the reference's fits"])
    slip = summary([row for row in rows if "0.97" in row["water"]])
    rest = [row for row in rows if row["water"] == "reference-2, 0 to 0.04 m/s"]
    still, held = summary(rest), int((column(rest, "rmse_after_arrival") <= constant("protocol", "arrival_radius")).sum())
    family = [judged("station-family, reference-2")[2], *(without[key] for key in ("arrivals", "trials", "rmse"))]
    family += [slip["arrivals"], slip["trials"], min(other), max(other), slip["rmse"]]
    plain = summary([row for row in rows if row["water"] == "paper slip 1, 0 to 0.04 m/s"])
    family += [still["arrivals"], still["trials"], held, still["rmse"], plain["rmse"]]
    family += [round(arrived), min(fits.values()), max(fits.values()), structured]
    station = [judged(f"station, {water}")[2] for water in ("reference-2", "plain")]
    return [*family, *station, *second_robot("precision")[:3]]


def rivals(label: str) -> list[float]:
    """Controllers that `station-family` beats by both keys, all, and the largest p after Holm: reference, seed 9, paired.

    Then the share [%], with its interval, of the gap in RMSE after arrival from the best rival to `privileged` that it closes.
    The gap is that to `privileged` of earlier gains, which holds better in the reference than that of today's.
    """
    trials: dict[str, dict] = {}
    earlier: dict[tuple[str, str], dict] = {}
    for row in table(SOLVED / "judged_reference.csv"):
        trial = row["speed"], row["los_deg"]
        if row["water"] == "reference-2" and row["seed"] == "9":
            trials.setdefault(row["controller"], {})[trial] = row
        elif (row["water"], row["controller"]) == ("reference-2, earlier gains", BOUND):
            earlier[trial] = row
    mine, better, p = trials.pop(NAME), [], []
    for key in ("rmse_after_arrival", "rmse_last20"):
        ours, *theirs = (np.array([float(swum[one][key] or "nan") for one in mine]) for swum in (mine, *trials.values()))
        better.append([difference(key, ours, x).low > 0 for x in theirs])
        p += list(holm([paired_p(ours, x) for x in theirs]))
    key, swims = "rmse_after_arrival", {NAME: mine} | trials | {BOUND: earlier}
    figures = {name: {"figures": {key: column([swum[one] for one in mine], key)}} for name, swum in swims.items()}
    closed = gap_closed(figures, key)
    return [int(np.all(better, 0).sum()), len(trials), max(p), *(100 * x for x in (closed.value, closed.low, closed.high))]


def other_waters(label: str) -> list[float]:
    """`2 cm, slip 1` -> arrivals, trials, RMSE after arrival (one set: its interval), of the last 20 s, by speed, worst."""
    wanted = OTHER_WATERS.get(label, [(label.replace("reference", "reference-2"), "9")])
    rows = [row for row in table(HERE / "training" / "rows" / "judged_station_family.csv") if row["controller"] == NAME]
    sets = [[r for r in rows if (r["water"], r["seed"]) == one] for one in wanted]
    found = [summary(some) for some in sets]
    arrived = [(own["arrivals"], own["trials"]) for own in found]
    if all(count == n for count, n in arrived):
        arrived = [(sum(count for count, _ in arrived), sum(n for _, n in arrived))]
    rmse = [own["rmse"] for own in found] if len(found) > 1 else [found[0][key] for key in ("rmse", "low", "high")]
    speeds = [
        float(np.nanmean(column([r for r in some if r["speed"] == speed], "rmse_after_arrival")))
        for some in sets
        for speed in sorted({r["speed"] for r in some})
    ]
    last, worst = ([own[key] for own in found] for key in ("last", "worst"))
    return [*(number for pair in arrived for number in pair), *rmse, *last, *speeds, *worst]


def seeds(label: str) -> list[float]:
    """`1` -> in the reference: arrivals, trials, RMSE after arrival with its interval, of the last 20 s, worst [m].

    Then RMSE after arrival at 0 to 0.04 m/s and in cells of 1.5 cm [m], and arrivals and trials at slip 0.97.
    """
    name = NAME if "ships" in label else f"seed {label}"
    files = SOLVED / "judged_reference.csv", HERE / "training" / "rows" / "judged_station_family.csv"
    rows = [row for file in files for row in table(file) if (row["controller"], row["seed"]) == (name, "9")]
    waters = ("reference-2", "reference-2, 0 to 0.04 m/s", "paper 1.5 cm slip 0.985", "paper slip 0.97")
    own, slow, cells, slippery = (summary([row for row in rows if row["water"] == water]) for water in waters)
    figures = [own[key] for key in ("arrivals", "trials", "rmse", "low", "high", "last", "worst")]
    return [*figures, slow["rmse"], cells["rmse"], slippery["arrivals"], slippery["trials"]]


def shapes(label: str) -> list[float]:
    """Swims of the shapes whose speeds agree within a factor of 1.5, and their number, at the slip ratios 0.99 and 1."""
    rows = [row for row in table(FITTED / "new_shapes_laptop.csv") if row["ratio"] and not row["measured_m_s"]]
    ratios = [[float(row["ratio"]) for row in rows if float(row["slip"]) == slip] for slip in (0.99, 1.0)]
    return [count for some in ratios for count in (sum(1 / 1.5 <= ratio <= 1.5 for ratio in some), len(some))]


def monitored(label: str) -> list[float]:
    """Hours of twelve healthy robots under the monitor."""
    return [json.loads((HERE / "monitor" / "rows" / "loopback.json").read_text(encoding="utf-8"))["hours"]]
