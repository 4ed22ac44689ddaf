"""Comparison with all baselines over the 72 trials: arrival, RMSE, power, directions, attitude, and the tests of the paper."""

from typing import Any

import numpy as np

from fishmj import control
from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.base.pages import drawn
from fishmj.base.units import wrap
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.experiment_figures import compared, counted, error_bars, figures_row, read, rounded, series_row
from fishmj.evaluate.experiments.paper_experiment import (
    ExperimentFindings,
    ExperimentPart,
    ExperimentSetup,
    PaperExperiment,
    PaperFinding,
    Row,
)
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import AROUND, COLOURS, FAINT, INK, LOGARITHMIC, RADAR, STYLE, plain_ticks, polar, radar_figure
from fishmj.evaluate.run_trials import OF_A_TRIAL

KEYS = {"rmse_after_arrival": "m", "rmse_last20": "m", "approach_time": "s", "power": "W"}  # tested metrics; less is better
DECIDING = {"rmse_after_arrival": "RMSE after arrival", "rmse_last20": "RMSE of the last 20 s"}  # of "better": the first decides
PAPER = {"koopman": "arrival_koopman", "mpc": "arrival_mpc", "rl": "arrival_rl"}  # name -> key of the paper's count
BOUND, PASSIVE = "privileged", "drift"  # upper bound with the true flow; joints at zero; neither is a rival
ON_RADAR = ("adrc-c1", "koopman", "mpc")  # the paper's controllers in the radar plots
SIGNIFICANT = 0.05
SAMPLE, UNTIL, SECTOR = 0.5, 30.0, 10  # s between samples of a curve, s of it, deg of a histogram
SIDES = {"target upstream": 1, "target downstream": -1}


def controllers(setup: ExperimentSetup) -> list[str]:
    """Policy and every baseline, as the user names them; the passive fish last."""
    names = [name for name in control.NAMES if name not in (PASSIVE, setup.policy)]
    return [setup.policy, *names, PASSIVE]


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


def paper_count(name: str, ours: bool = False) -> str:
    """Arrivals in the paper of a controller, or of its policy, as text; empty if the paper does not have it."""
    if ours:
        return f"{constant('results', 'arrival_ours')} of 72"
    if name.startswith("adrc-c"):
        return f"{constant('results', 'arrival_adrc')[int(name[-1]) - 1]} of 72"
    return f"{constant('results', PAPER[name])} of 72" if name in PAPER else ""


def rivals_of(rows: dict[str, Row]) -> list[str]:
    """Names of the controllers with the same observations as the first, which is compared with them."""
    return [name for name in list(rows)[1:] if name not in (BOUND, PASSIVE)]


def best_rival(rows: dict[str, Row], key: str = "rmse_after_arrival") -> str:
    """Name of the rival with the least mean of a figure."""
    return min(rivals_of(rows), key=lambda name: np.nan_to_num(read(rows[name]["figures"][key]).mean(), nan=np.inf))


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Figures of the paper, controllers that the policy is better than, and the tests of both."""
    leader, first = next(iter(rows.items()))
    tests, found = tested(rows), []
    for key, what in DECIDING.items():
        better, worse = (sum(row["policy is"] == said for row in tests[key]) for said in ("better", "worse"))
        text = f"better {better}, worse {worse}, of {len(tests[key])}"
        found.append(PaperFinding(f"{what}: rivals", "better than all", text, better, n=len(first["los"])))
    if BOUND in rows:
        found += [gap_closed(rows, key) for key in DECIDING]
    for name, row in rows.items():
        if said := paper_count(name, row is first):
            found.append(counted(f"arrival, {name}", said, row["figures"]["arrival"]))
    errors = lambda name: rows[name]["figures"]["rmse_after_arrival"]
    for name, key in ((leader, "rmse_ours"), ("adrc-c1", "rmse_adrc"), ("rl", "rmse_rl")):
        if name in rows:
            found.append(compared(f"RMSE after arrival, {name}", f"{constant('results', key)} m", errors(name), "m"))
    for name, key in (("adrc-c3", "p_adrc_c3"), ("koopman", "p_koopman")):
        for p in [row["Welch p, Holm"] for row in tests["power"] if row["controller"] == name]:
            found.append(
                PaperFinding(f"power against {name}, Welch's p", f"{constant('power', key)}", f"{p}", n=len(first["los"]))
            )
    apart = [row["Welch p, Holm"] < 0.001 for row in tests["rmse_after_arrival"] if row["Welch p, Holm"] is not None]
    worse = f"{sum(apart)} of {len(apart)}"
    found.append(PaperFinding("rivals that differ in RMSE, Welch's p < 0.001", "all", worse, n=len(first["los"])))
    lacks = [name for name in PAPER if name not in rows]
    notes = [f"No controller of this name here, so not compared: {', '.join(lacks)}."] if lacks else []
    notes.append(
        f"{leader} is better than a rival if its value is less and the difference is significant: paired bootstrap, p below "
        f"{SIGNIFICANT:g} after Holm over the {len(rivals_of(rows))} rivals. RMSE after arrival decides. Rivals have the same "
        f"observations; {BOUND} has the true flow, {PASSIVE} does nothing."
    )
    tables = [("Controllers", listed(rows)), *((f"{key} [{KEYS[key]}], controller minus {leader}", tests[key]) for key in KEYS)]
    shown = [
        (bars(rows), "Arrival, both RMSE and power with 95 % intervals."),
        (curves(rows), "Distance to the target: all trials, and the median."),
        (tracks(rows), "Tracks at 0.2 m/s from four diagonals, seen from the target; the water flows down the page."),
        (radars(setup, rows), "Means over repeats, by direction of the target and flow speed; upstream is up."),
        (maps(rows), "The same of every controller: a column is a direction of the target, counted from upstream."),
        (attitudes(rows), "Share of time of beat-averaged headings, 30 to 60 s, and their spread; upstream is up."),
    ]
    return ExperimentFindings(found, shown, tables, notes)


def listed(rows: dict[str, Row]) -> list[dict[str, Any]]:
    """Figures of every controller with their intervals, arrivals of the paper, and spread of the heading by side."""
    table = []
    for k, (name, row) in enumerate(rows.items()):
        mine, digits = row["figures"], {"approach_time": 1, "power": 2}
        line = {"controller": name, "arrival": counted("", "", mine["arrival"]).measured, "paper": paper_count(name, k == 0)}
        for key, unit in KEYS.items():
            one = compared("", "", mine[key], digits=digits.get(key, 3), median=key == "approach_time")
            line[f"{DECIDING.get(key, key.replace('_', ' '))} [{unit}]"] = one.measured
        table.append(line | {f"heading's spread, {side} [deg]": row["spread"][side] for side in SIDES})
    return table


def gap_closed(rows: dict[str, Row], key: str) -> PaperFinding:
    """Share of the gap between the best rival and the bound that the policy closes, by one figure; paired bootstrap.

    No share is given if rival and bound do not differ significantly, because a share of a gap near zero means nothing.
    """
    leader, best = next(iter(rows)), best_rival(rows, key)
    three = [read(rows[name]["figures"][key]) for name in (best, leader, BOUND)]
    both = np.isfinite(three).all(0)
    three, n = [x[both] for x in three], int(both.sum())
    what = f"{DECIDING[key]}: share of the gap from {best} to {BOUND} that is closed"
    if why := metrics.too_few(n):
        return PaperFinding(what, "", why, n=n)
    share = lambda rival, ours, bound: (rival - ours) / (rival - bound)
    means, drawn_means = [x.mean() for x in three], [metrics.resampled(x).mean(-1) for x in three]
    if np.quantile(drawn_means[0] - drawn_means[2], 0.025) <= 0:
        message = f"{means[0]:.3f} and {means[2]:.3f} m, {leader} {means[1]:.3f} m"
        return PaperFinding(what, "", f"no gap within the scatter: {message}", n=n)
    low, high = np.quantile(share(*drawn_means), [0.025, 0.975])
    return PaperFinding(what, "", f"{share(*means):.2f} ({low:.2f} {high:.2f})", float(share(*means)), float(low), float(high), n)


def tested(rows: dict[str, Row]) -> dict[str, list[dict[str, Any]]]:
    """Rows of tests for each figure: every rival against the first, p values adjusted over the rivals."""
    first, others = next(iter(rows.values())), rivals_of(rows)
    shown = lambda p: float(f"{p:.2g}") if np.isfinite(p) else None
    tables = {}
    for key in KEYS:
        pairs = [(read(first["figures"][key]), read(rows[name]["figures"][key])) for name in others]
        each = [metrics.difference(key, *pair) for pair in pairs]
        paired = metrics.holm([metrics.paired_p(*pair) for pair in pairs])
        welch = metrics.holm([d.welch_p for d in each])
        sides = lambda d, p: "not told apart" if not p < SIGNIFICANT else "better" if d.value > 0 else "worse"
        tables[key] = [
            {
                "controller": name,
                "difference (95 %)": d.text(),
                "pairs": d.n,
                "paired p, Holm": shown(p),
                "Welch p, Holm": shown(w),
                "policy is": sides(d, p),
            }
            for name, d, p, w in zip(others, each, paired, welch, strict=True)
        ]
    return tables


def panels(rows: dict[str, Row], wide: float, high: float):
    """Figure `wide` inches wide with a panel, `high` inches high, for each controller; and (axis, row, colour) of each panel."""
    lines = -(-len(rows) // 4)
    figure, axes = canvas(lines, 4, (wide, high * lines), sharex=True, sharey=True)
    for axis in axes.ravel()[len(rows) :]:
        axis.set_axis_off()
    for axis, name in zip(axes.ravel(), rows, strict=False):
        axis.set(title=drawn(name))
    return figure, zip(axes.ravel(), rows.values(), COLOURS * 3, strict=False)


@style(STYLE)
def curves(rows: dict[str, Row]) -> bytes:
    """Distance over time, one panel for each controller."""
    figure, each = panels(rows, 14, 2.6)
    for axis, row, colour in each:
        t, distance = read(row["t"]), read(row["distance"])
        axis.plot(t, distance.T, color=colour, linewidth=0.4, alpha=0.4)
        axis.plot(t, np.median(distance, 0), color=colour, linewidth=2.2)
        axis.axhline(constant("protocol", "arrival_radius"), color=FAINT, linewidth=1)
        axis.set(ylim=(0, 2.5))
    figure.supxlabel("time [s]")
    figure.supylabel("distance [m]")
    return png(figure)


@style(STYLE)
def tracks(rows: dict[str, Row]) -> bytes:
    """Tracks to the target, one panel for each controller."""
    figure, each = panels(rows, 12, 3.2)
    for axis, row, colour in each:
        for side, upstream in row["tracks"]:
            axis.plot(-read(side), read(upstream), color=colour, linewidth=1)
        axis.plot(0, 0, "+", color=INK, markersize=10)
        axis.set(xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal")
    figure.supxlabel("right of the target, facing upstream [m]")
    figure.supylabel("upstream of it [m]")
    return png(figure)


@style(STYLE)
def bars(rows: dict[str, Row]) -> bytes:
    """Arrival, RMSE and power of every controller."""
    keys = ("arrival", *DECIDING, "power")
    figure, axes = canvas(1, len(keys), (14, 0.34 * len(rows) + 1.2), sharey=True)
    place = -np.arange(len(rows))
    for axis, key in zip(axes[0], keys, strict=True):
        middle, ends = error_bars([row["figures"][key] for row in rows.values()])
        axis.errorbar(middle[1:], place[1:], xerr=ends[:, 1:], fmt="o", color=COLOURS[0], capsize=3)
        axis.errorbar(middle[:1], place[:1], xerr=ends[:, :1], fmt="o", color=COLOURS[1], capsize=3)
        axis.set(xlabel=f"{DECIDING.get(key, key)} [{'share' if key == 'arrival' else metrics.UNITS[key]}]")
        if key in DECIDING:
            axis.set_xscale("log")
            plain_ticks(axis.xaxis)
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
    """Radar plots of `fishmj evaluate --plots`, of the policy, the best rival and three of the paper."""
    names = [name for name in dict.fromkeys((next(iter(rows)), best_rival(rows), *ON_RADAR)) if name in rows]
    return png(radar_figure([known_result(setup, name, rows[name]) for name in names]), **AROUND)


@style(STYLE)
def maps(rows: dict[str, Row]) -> bytes:
    """Means over repeats of the figures of the radar: rows controllers, columns directions at each speed."""
    from matplotlib.colors import LogNorm, Normalize

    first = next(iter(rows.values()))
    speed, los = read(first["speed"]), np.array(first["los"]) % 360
    cells = [(u, b) for u in np.unique(speed) for b in np.unique(los)]
    figure, axes = canvas(1, len(RADAR), (15, 0.3 * len(rows) + 1.8), sharey=True)
    for axis, (key, title) in zip(axes[0], RADAR, strict=True):
        given = [read(row["figures"][key]) for row in rows.values()]
        values = np.array([[metrics.mean_of_known(x[(speed == u) & (los == b)]) for u, b in cells] for x in given])
        some = values[np.isfinite(values)]
        norm = (LogNorm if key in LOGARITHMIC else Normalize)(*((some.min(), some.max()) if len(some) else (0.1, 1.0)))
        seen = axis.imshow(values, aspect="auto", cmap="viridis", norm=norm)
        bar = figure.colorbar(seen, ax=axis, location="top", label=title)
        if key in LOGARITHMIC:
            plain_ticks(bar.ax.xaxis)
        axis.set_facecolor(FAINT)
        axis.set_yticks(range(len(rows)), labels=[drawn(name) for name in rows])
        every, wide = np.unique(speed), len(np.unique(los))
        axis.set_xticks((np.arange(len(every)) + 0.5) * wide - 0.5, labels=[f"{u:g} m/s\n0 to 315°" for u in every])
        for k in range(1, len(every)):
            axis.axvline(k * wide - 0.5, color="white", linewidth=2)
    return png(figure)


@style(STYLE)
def attitudes(rows: dict[str, Row]) -> bytes:
    """Polar histograms of headings, one panel for each controller; filled and outlined: sides of the target."""
    wide = 5
    high = -(-len(rows) // wide)
    figure, axes = canvas(high, wide, (14, 3.1 * high + 0.4), subplot_kw={"projection": "polar"})
    for axis in axes.ravel()[len(rows) :]:
        axis.set_axis_off()
    angle, width = np.radians(np.arange(-180, 180, SECTOR) + SECTOR / 2), np.radians(SECTOR)
    above, below = SIDES
    for axis, (name, row) in zip(axes.ravel(), rows.items(), strict=False):
        polar(axis)
        share = {side: np.sqrt(np.nan_to_num(read(row["headings"][side]))) for side in SIDES}
        axis.bar(angle, share[above], width=width, color=COLOURS[0], alpha=0.6, linewidth=0, label=above)
        edge = np.append(np.repeat(share[below], 2), share[below][0])
        axis.plot(np.radians(np.repeat(np.arange(-180, 181, SECTOR), 2)[1:]), edge, color=COLOURS[1], linewidth=1.4, label=below)
        axis.set(ylim=(0, 1), xticklabels=["up", *[""] * 7])
        axis.set_yticks(np.sqrt([0.1, 0.4, 0.9]), labels=["10 %", "40 %", "90 %"])
        spread = ", ".join("-" if x is None else f"{x:.0f}°" for x in row["spread"].values())
        axis.set_title(f"{drawn(name)}\nspread {spread}", fontsize=10)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return png(figure)


EXPERIMENT = PaperExperiment(
    "comparison",
    "11 to 13, comparison of controllers",
    "the 72 trials for the policy and every baseline: arrival, RMSE, power, directions, attitude, tests",
    "arrival, RMSE and measured power of every controller in the tank",
    parts,
    findings,
)
