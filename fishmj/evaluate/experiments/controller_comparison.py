"""Comparison with all baselines over the 72 trials: arrival, RMSE, power, directions, attitude, and the tests of the paper."""

from typing import Any

import numpy as np

from fishmj import control
from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.base.pages import drawn
from fishmj.base.units import wrap
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.paper_experiment import (
    ExperimentFindings,
    ExperimentPart,
    ExperimentSetup,
    PaperExperiment,
    PaperFinding,
    Row,
    compared,
    counted,
    figures_row,
    read,
    rounded,
    series_row,
)
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import AROUND, COLOURS, FAINT, INK, STYLE, polar, radar_figure
from fishmj.evaluate.run_trials import OF_A_TRIAL

KEYS = {"rmse_after_arrival": "m", "rmse_last20": "m", "approach_time": "s", "power": "W"}  # that are tested
PAPER = {"koopman": "arrival_koopman", "mpc": "arrival_mpc", "rl": "arrival_rl"}  # name -> key of the paper's count
BOUND = "privileged"  # a controller that is told the flow: a bound, no rival
SAMPLE, UNTIL, SECTOR = 0.5, 30.0, 10  # s between samples of a curve, s of it, deg of a histogram
SIDES = {"target upstream": 1, "target downstream": -1}


def controllers(setup: ExperimentSetup) -> list[str]:
    """Policy and every baseline, as the user names them; the passive fish last."""
    names = [name for name in control.NAMES if name not in ("drift", setup.policy)]
    return [setup.policy, *names, "drift"]


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """One part for each controller, over the same trials."""
    trials = setup.trials(**setup.of({}, {"repeats": 1}))
    return [setup.part(name, name, trials, comparison_row) for name in controllers(setup)]


def comparison_row(result: Result) -> Row:
    """Figures, distances (n, T) m of the first 30 s, and shares of headings in the hold phase by side of the target."""
    ticks = np.arange(0, round(UNTIL / result.robot.timing.bus_dt) + 1, round(SAMPLE / result.robot.timing.bus_dt))
    ticks = ticks[ticks < len(result.t)]
    row = figures_row(result) | {"t": rounded(result.t[ticks], 2), "distance": rounded(result.distance[:, ticks], 3)}
    seen = series_row(result, UNTIL)
    some = (result.trials.speed == constant("experiments", "transfer_speed")) & (np.sin(2 * result.trials.los) ** 2 > 0.99)
    diagonal = [i for i in np.flatnonzero(some) if result.trials.items[i].repeat == 0]
    row["tracks"] = [[seen["side"][i], seen["upstream"][i]] for i in diagonal]
    start, end = constant("protocol", "rheotaxis_window")
    off = np.degrees(wrap(np, metrics.beat_mean(result.pose[:, :, 2], result.robot.timing.bus_dt) - result.trials.upstream))
    inside = (result.t >= start) & (result.t <= end) & (np.arange(len(result.t)) < result.left[:, None])
    row["headings"], row["spread"] = {}, {}
    for side, sign in SIDES.items():
        some = sign * np.cos(result.trials.los) > 1e-6
        values = off[some][inside[some]]
        share = np.histogram(values, np.arange(-180, 181, SECTOR))[0] / max(len(values), 1)
        row["headings"][side] = rounded(share, 4)
        long = abs(np.mean(np.exp(1j * np.radians(values)))) if len(values) else np.nan
        row["spread"][side] = rounded(np.degrees(np.sqrt(-2 * np.log(np.clip(long, 1e-9, 1)))), 1)
    return row


def paper_count(name: str) -> str:
    """Arrivals of a controller in the paper, as text; empty for one that it does not have."""
    if name.startswith("adrc-c"):
        return f"{constant('results', 'arrival_adrc')[int(name[-1]) - 1]} of 72"
    return f"{constant('results', PAPER[name])} of 72" if name in PAPER else ""


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Arrivals, RMSE, power, and the tests of the policy against every other controller."""
    (leader, first), *others = rows.items()
    paper = lambda key: f"{constant('results', key)} {'m' if key.startswith('rmse') else 'of 72'}"
    rmse = {"adrc-c1": paper("rmse_adrc"), "rl": paper("rmse_rl"), leader: paper("rmse_ours")}
    found = []
    for name, row in rows.items():
        mine = row["figures"]
        found.append(counted(f"arrival, {name}", paper("arrival_ours") if row is first else paper_count(name), mine["arrival"]))
        found.append(compared(f"RMSE after arrival, {name}", rmse.get(name, ""), mine["rmse_after_arrival"], "m"))
        found.append(compared(f"power, {name}", "", mine["power"], "W", digits=2))
    tests = tested(rows)
    for name, _ in others:
        if said := {"adrc-c3": "p_adrc_c3", "koopman": "p_koopman"}.get(name):
            p = next(row["Holm p"] for row in tests["power"] if row["controller"] == name)
            found.append(PaperFinding(f"power against {name}, p", f"{constant('power', said)}", f"{p}", n=len(first["los"])))
    apart = [row["Holm p"] < 0.001 for row in tests["rmse_after_arrival"] if row["Holm p"] is not None]
    worse = f"{sum(apart)} of {len(apart)}"
    found.append(PaperFinding("controllers that differ in RMSE with p < 0.001", "all", worse, n=len(first["los"])))
    if BOUND in rows:
        found.append(gap_closed(rows))
    lacks = [name for name in PAPER if name not in rows]
    notes = [f"No controller of this name here, so not compared: {', '.join(lacks)}."] if lacks else []
    title = f"minus {leader}, paired bootstrap (95 %), Welch's p and Holm's over the controllers; * = excludes 0"
    tables = [(f"{key} [{KEYS[key]}] {title}", table) for key, table in tests.items()]
    spread = lambda row: {f"{side}, spread [deg]": row["spread"][side] for side in SIDES}
    attitude = [{"controller": name} | spread(row) for name, row in rows.items()]
    tables.append(("Spread of the heading, 30 to 60 s", attitude))
    shown = [
        (curves(rows), "Distance to the target: all trials, and the median."),
        (tracks(rows), "Tracks at 0.2 m/s from four diagonals, seen from the target; the water flows down the page."),
        (bars(rows), "Arrival, RMSE after arrival and power with 95 % intervals."),
        (radars(setup, rows), "Means over repeats, by direction of the target and flow speed; upstream is up."),
        (attitudes(rows), "Share of time of beat-averaged headings, 30 to 60 s; upstream is up."),
    ]
    return ExperimentFindings(found, shown, tables, notes)


def gap_closed(rows: dict[str, Row]) -> PaperFinding:
    """Share of the gap between the best rival and the bound that the policy closes, by RMSE after arrival; paired bootstrap.

    None where the rival cannot be told from the bound: a share of a gap of about zero means nothing.
    """
    leader = next(iter(rows))
    errors = {name: read(row["figures"]["rmse_after_arrival"]) for name, row in rows.items()}
    best = min((name for name in rows if name not in (leader, BOUND)), key=lambda name: errors[name].mean())
    share = lambda rival, ours, bound, axis=-1: (rival.mean(axis) - ours.mean(axis)) / (rival.mean(axis) - bound.mean(axis))
    three, n = (errors[best], errors[leader], errors[BOUND]), len(errors[leader])
    draws = np.random.default_rng(metrics.SEED).integers(n, size=(metrics.RESAMPLES, n))
    what = f"share of the gap from the best rival ({best}) to {BOUND} that is closed"
    if np.quantile(errors[best][draws].mean(-1) - errors[BOUND][draws].mean(-1), 0.025) <= 0:
        return PaperFinding(what, "", f"no gap: {best} and {BOUND} differ by less than their scatter", n=n)
    low, high = np.quantile(share(*(x[draws] for x in three)), [0.025, 0.975])
    return PaperFinding(what, "", f"{share(*three):.2f} ({low:.2f} {high:.2f})", float(share(*three)), float(low), float(high), n)


def tested(rows: dict[str, Row]) -> dict[str, list[dict[str, Any]]]:
    """Rows of tests for each figure: every controller against the first, p values adjusted over the controllers."""
    (_, first), *every = rows.items()
    others = [(name, row) for name, row in every if name != BOUND]
    tables = {}
    for key in KEYS:
        each = [metrics.difference(key, read(first["figures"][key]), read(row["figures"][key])) for _, row in others]
        adjusted = metrics.holm([d.welch_p for d in each])
        tables[key] = [
            {
                "controller": name,
                "difference": d.text(),
                "pairs": d.n,
                "Welch p": float(f"{d.welch_p:.2g}") if np.isfinite(d.welch_p) else None,
                "Holm p": float(f"{p:.2g}") if np.isfinite(p) else None,
            }
            for (name, _), d, p in zip(others, each, adjusted, strict=True)
        ]
    return tables


@style(STYLE)
def curves(rows: dict[str, Row]) -> bytes:
    """Distance over time, one panel for each controller."""
    wide = 4
    figure, axes = canvas(-(-len(rows) // wide), wide, (14, 2.6 * -(-len(rows) // wide)), sharex=True, sharey=True)
    for axis in axes.ravel()[len(rows) :]:
        axis.set_axis_off()
    for axis, (name, row), colour in zip(axes.ravel(), rows.items(), COLOURS * 3, strict=False):
        t, distance = read(row["t"]), read(row["distance"])
        axis.plot(t, distance.T, color=colour, linewidth=0.4, alpha=0.4)
        axis.plot(t, np.median(distance, 0), color=colour, linewidth=2.2)
        axis.axhline(constant("protocol", "arrival_radius"), color=FAINT, linewidth=1)
        axis.set(title=drawn(name), ylim=(0, 2.5), xlabel="time [s]")
    axes[0, 0].set_ylabel("distance [m]")
    return png(figure)


@style(STYLE)
def tracks(rows: dict[str, Row]) -> bytes:
    """Tracks to the target, one panel for each controller."""
    wide = 4
    figure, axes = canvas(-(-len(rows) // wide), wide, (12, 3.2 * -(-len(rows) // wide)), sharex=True, sharey=True)
    for axis in axes.ravel()[len(rows) :]:
        axis.set_axis_off()
    for axis, (name, row), colour in zip(axes.ravel(), rows.items(), COLOURS * 3, strict=False):
        for side, upstream in row["tracks"]:
            axis.plot(-read(side), read(upstream), color=colour, linewidth=1)
        axis.plot(0, 0, "+", color=INK, markersize=10)
        axis.set(title=drawn(name), xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal")
    figure.supxlabel("right of the target, facing upstream [m]")
    figure.supylabel("upstream of it [m]")
    return png(figure)


@style(STYLE)
def bars(rows: dict[str, Row]) -> bytes:
    """Arrival, RMSE after arrival and power of every controller."""
    keys = ("arrival", "rmse_after_arrival", "power")
    figure, axes = canvas(1, len(keys), (13, 0.34 * len(rows) + 1.2), sharey=True)
    place = -np.arange(len(rows))
    for axis, key in zip(axes[0], keys, strict=True):
        some = [metrics.estimate("", read(row["figures"][key])) for row in rows.values()]
        middle = np.array([e.value for e in some])
        ends = np.nan_to_num(np.abs(np.array([[e.low, e.high] for e in some]).T - middle))
        axis.errorbar(middle, place, xerr=ends, fmt="o", color=COLOURS[0], capsize=3)
        axis.set(xlabel=f"{key.replace('_', ' ')} [{metrics.UNITS[key]}]", xscale="log" if KEYS.get(key) == "m" else "linear")
        axis.set_yticks(place, labels=[drawn(name) for name in rows])
        axis.grid(axis="x", color=FAINT, linewidth=0.6)
    return png(figure)


def known_result(setup: ExperimentSetup, name: str, row: Row) -> Result:
    """Result with the figures of a kept row and no time series."""
    nothing: Any = np.zeros((len(row["los"]), 0))
    figures = {key: read(values) for key, values in row["figures"].items()}
    trials = setup.trials(**setup.of({}, {"repeats": 1}))
    empty = dict.fromkeys(("t", "target", *OF_A_TRIAL), nothing)
    made: Any = Result(controller=name, policy_sha256="", robot=setup.robot, trials=trials, engine="", **empty)
    return made._replace(known=figures)


@style(STYLE)
def radars(setup: ExperimentSetup, rows: dict[str, Row]) -> bytes:
    """Radar plots of `fishmj evaluate --plots`."""
    return png(radar_figure([known_result(setup, name, row) for name, row in rows.items()]), **AROUND)


@style(STYLE)
def attitudes(rows: dict[str, Row]) -> bytes:
    """Polar histograms of headings: rows sides of the target, columns controllers."""
    figure, axes = canvas(len(SIDES), len(rows), (2.6 * len(rows), 6.4), subplot_kw={"projection": "polar"})
    angle = np.radians(np.arange(-180, 180, SECTOR) + SECTOR / 2)
    for column, ((name, row), colour) in enumerate(zip(rows.items(), COLOURS * 3, strict=False)):
        for line, side in enumerate(SIDES):
            axis = polar(axes[line, column])
            axis.bar(angle, np.sqrt(read(row["headings"][side])), width=np.radians(SECTOR - 1), color=colour, linewidth=0)
            axis.set(ylim=(0, 1))
            axis.set_yticks(np.sqrt([0.1, 0.4, 0.9]), labels=["10 %", "40 %", "90 %"])
            spread = "-" if row["spread"][side] is None else f"{row['spread'][side]:.0f}"
            axis.set_title(f"{drawn(name)}\n{side}\nspread {spread} deg", fontsize=9)
            axis.set_xticklabels([])
    return png(figure)


EXPERIMENT = PaperExperiment(
    "comparison",
    "comparison_sota, comparison_qualitative, comparison_quantitative",
    "the 72 trials for the policy and every baseline: arrival, RMSE, power, directions, attitude, tests",
    "arrival, RMSE and measured power of every controller in the tank",
    parts,
    findings,
)
