"""Pictures: gap by part of the records, growth curves, heat map, localisation details, confusion map, most informative traces.

Lines and marks never differ by colour alone.
"""

import math
import textwrap
from typing import NamedTuple

import numpy as np

from fishmj.base.figures import BLUE, GREEN, OPEN, VERMILION, canvas, svg
from fishmj.base.pages import drawn
from fishmj.gap.localise import Comparison, Localisation
from fishmj.gap.localise.error_growth import GrowthCurve
from fishmj.gap.records.records import ChannelBlock
from fishmj.gap.report.report_data import RoundFinalists
from fishmj.gap.wording import SCALES, level, number

LINE = 14  # characters of a label before it is wrapped
MAPPED = 16  # finalists in a confusion map; more would be illegible
INK, QUIET, BAND = "#1F2933", "#5B6570", "#E6EAF0"
MEASURED, BEFORE, AFTER, ACCENT = INK, VERMILION, BLUE, GREEN
STYLE = OPEN | {
    "font.family": "sans-serif",
    # Measured with a wide typeface, shown with the reader's own.
    "font.sans-serif": ["DejaVu Sans", "Liberation Sans", "Arial", "Helvetica Neue"],
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": QUIET,
    "axes.edgecolor": "#9AA5B1",
    "axes.linewidth": 0.8,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E9EDF2",
    "grid.linewidth": 0.8,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def gaps(rows: dict[str, tuple[float, float]], changed: bool, allowed: float) -> str:
    """Bar chart of the gap (before, after) of all records and of each channel, by name. allowed: largest gap that agrees."""
    figure, axes = canvas(1, 1, (6.2, 0.72 * len(rows) + 0.85))
    axis = axes[0, 0]
    axis.axvspan(0.01, allowed, color=BAND, zorder=0)
    axis.axvline(allowed, color=QUIET, linewidth=1, linestyle=(0, (2, 2)))
    most, least = max([4.0, *map(max, rows.values())]), min([0.6, *map(min, rows.values())])
    for y, (before, after) in enumerate(rows.values()):
        if changed:
            axis.annotate("", (after, y), (before, y), arrowprops={"arrowstyle": "-", "color": "#9AA5B1", "linewidth": 1.6})
            axis.plot(after, y, "o", color=AFTER, markersize=9, zorder=3)
            axis.text(after, y + 0.17, level(after), ha="center", va="top", color=AFTER, fontsize=9.5, fontweight="bold")
        axis.plot(before, y, "s", color=BEFORE, markersize=8, zorder=3)
        axis.text(before, y - 0.17, level(before), ha="center", va="bottom", color=BEFORE, fontsize=9.5, fontweight="bold")
    axis.set_yticks(range(len(rows)), list(rows), fontsize=10, color=INK)
    axis.set(ylim=(len(rows) - 0.4, -0.6), xscale="log", xlim=(0.7 * least, 1.6 * most))
    axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.xaxis.set_minor_formatter("")
    axis.grid(axis="y", visible=False)
    axis.spines["left"].set_visible(False)
    axis.tick_params(axis="y", length=0)
    axis.set_xlabel("gap, |z|² / m (grey: agreement)")
    return svg(figure, "Gap before and after, of all records and by channel")


def growth(found: tuple[GrowthCurve, ...], changed: bool) -> str:
    """Chart of the error after a restart against the time since it."""
    figure, axes = canvas(1, len(found), (10.9, 2.75))
    for axis, c in zip(axes[0], found, strict=True):
        factor, unit = SCALES[c.unit]
        h = np.array(c.horizons)
        axis.fill_between(h, 1e-9, factor * c.start, color=BAND, linewidth=0)
        axis.plot(h, factor * c.before, "s--", color=BEFORE, linewidth=1.8, markersize=6, label="model as it was")
        if changed:
            axis.plot(h, factor * c.after, "o-", color=AFTER, linewidth=2, markersize=6, label="with what was found")
        seen = factor * np.concatenate([c.before, c.after, c.start])
        seen = seen[np.isfinite(seen) & (seen > 0)]
        axis.set(xscale="log", yscale="log", ylim=(0.6 * seen.min(), 2.2 * seen.max()))
        axis.set_xticks(h, [f"{x:g}" for x in h])
        axis.minorticks_off()
        axis.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
        told = c.kind != "not told"
        slope = f"slope {_tenth(c.slope)} ({_tenth(c.low)} to {_tenth(c.high)}): {c.kind}"
        axis.set_title(f"{c.channel} [{unit}]", pad=20)
        axis.text(
            0, 1.035, slope if told else "no growth above the start's error", transform=axis.transAxes, color=QUIET, fontsize=9.2
        )
        axis.set_xlabel("time since the restart [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    handles.append(figure.axes[0].collections[0])
    figure.legend(handles, [*labels, "uncertainty of the start"], loc="outside lower center", ncols=3)
    return svg(figure, "Growth of the error after a restart")


def heat(p: Localisation) -> str:
    """Heat map of the gap's share by channel and regime; below it each regime's share of the time."""
    from matplotlib.colors import LinearSegmentedColormap

    seen = [k for k in range(len(p.kinds)) if np.isfinite(p.level[:, k]).any()]
    share = 100 * p.share[:, seen]
    figure, axes = canvas(1, 1, (10.9, 0.44 * len(p.channels) + 1.25))
    axis = axes[0, 0]
    colours = LinearSegmentedColormap.from_list("share", ["#F7F9FB", "#9CC9E3", BLUE, "#003B5C"])
    top = max(30.0, float(share.max()))
    axis.imshow(share, cmap=colours, vmin=0, vmax=top, aspect="auto")
    for i in range(len(p.channels)):
        for j, k in enumerate(seen):
            dark = share[i, j] > 0.45 * top
            text = f"{share[i, j]:.0f} %" if share[i, j] >= 0.5 else "0" if np.isfinite(p.level[i, k]) else "no data"
            axis.text(j, i - 0.08, text, ha="center", va="center", color="white" if dark else INK, fontsize=10)
            if np.isfinite(p.level[i, k]):
                quiet = "#E6EEF5" if dark else QUIET
                axis.text(j, i + 0.27, f"z² {_short(p.level[i, k])}", ha="center", va="center", color=quiet, fontsize=7.6)
    time = np.nanmax(p.time[:, seen], 0)
    wrapped = lambda text: textwrap.fill(text, LINE, break_long_words=False, break_on_hyphens=False)
    regimes = [f"{wrapped(p.kinds[k])}\n{100 * t:.0f} % of time" for k, t in zip(seen, time, strict=True)]
    axis.set_xticks(range(len(seen)), regimes)
    axis.set_yticks(range(len(p.channels)), p.channels, color=INK, fontsize=10)
    _tiles(axis, len(seen), len(p.channels), 8.6)
    return svg(figure, "Share of the gap by channel and regime")


def details(p: Localisation, changed: bool) -> str:
    """Panels of lags, heading, speed of the command: only those with data."""
    panels = [draw for draw, there in ((_lags, p.lags.joint or p.lags.heading), (_octants, p.frame), (_rates, p.rates)) if there]
    if not panels:
        return ""
    figure, axes = canvas(1, len(panels), (3.63 * len(panels), 2.75))
    for axis, draw in zip(axes[0], panels, strict=True):
        draw(axis, p, changed)
    return svg(figure, "Lag, heading and speed of the command")


def _lags(axis, p: Localisation, changed: bool) -> None:
    rows = [("joints", p.lags.joint, p.lags.joint_after), ("heading", p.lags.heading, p.lags.heading_after)]
    axis.axvspan(-6, 6, color=BAND)
    axis.axvline(0, color=QUIET, linewidth=1, linestyle=(0, (2, 2)))
    for y, (_, before, after) in enumerate(rows):
        for lag, colour, mark, up in ((before, BEFORE, "s", -0.12), (after if changed else None, AFTER, "o", 0.12)):
            if lag is not None:
                low, at, high = 1e3 * lag.low, 1e3 * lag.lag, 1e3 * lag.high
                axis.plot([low, high], [y + up] * 2, color=colour, linewidth=2.5)
                axis.plot(at, y + up, mark, color=colour, markersize=7)
                away, va = (0.11, "top") if up > 0 else (-0.11, "bottom")
                axis.text(at, y + up + away, f"{at:.0f} ms", color=colour, fontsize=9, ha="center", va=va)
            elif colour == BEFORE:
                axis.text(0, y + up, "not told", color=QUIET, fontsize=9, ha="center", va="bottom")
    axis.set_yticks([0, 1], [r[0] for r in rows], color=INK, fontsize=10)
    axis.set(ylim=(1.6, -0.6), xlabel="measured behind the model [ms]", title="Lag, 90 % interval")
    left, right = axis.get_xlim()
    axis.set_xlim(min(left, -12) - 4, max(right, 12) + 4)
    axis.grid(axis="y", visible=False)


def _octants(axis, p: Localisation, changed: bool) -> None:
    f = p.frame
    if f is None:
        return
    at = 45.0 * np.arange(-4, 5)
    index = np.arange(-4, 5) % 8
    fine = np.radians(np.linspace(-180, 180, 181))
    ahead = f.world[0] * np.cos(fine) + f.world[1] * np.sin(fine) + f.body[0]
    left = -f.world[0] * np.sin(fine) + f.world[1] * np.cos(fine) + f.body[1]
    for k, (curve, colour, mark, name) in enumerate(((ahead, AFTER, "o", "ahead"), (left, ACCENT, "D", "left"))):
        axis.plot(at, 1e3 * f.octant[index, k], mark, color=colour, markersize=6.5, label=name)
        axis.plot(np.degrees(fine), 1e3 * curve, "-" if k == 0 else "--", color=colour, linewidth=1.4, alpha=0.75)
    axis.axhline(0, color=QUIET, linewidth=0.8)
    axis.set_xticks([-180, -90, 0, 90, 180])
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -5.0), max(high, 5.0))
    what = {"world": "fixed in the tank", "body": "fixed on the robot", "neither": "no clear frame"}
    axis.set_title("Drift of the position [mm/s]", pad=20)
    axis.text(0, 1.035, what[f.points], transform=axis.transAxes, color=QUIET, fontsize=9.2)
    axis.set_xlabel("heading [deg]")
    axis.legend(loc="lower right", bbox_to_anchor=(1.02, 0.99), ncols=2, handletextpad=0.1, columnspacing=0.8)


def _rates(axis, p: Localisation, changed: bool) -> None:
    r = p.rates
    if r is None:
        return
    places = np.arange(len(r.middle))
    axis.bar(places, r.level, color=BEFORE, width=0.72, alpha=0.88)
    for x, height in zip(places, r.level, strict=True):
        axis.text(x, height, f"{_short(height)}\n", ha="center", va="center", fontsize=8.8, color=INK)
    axis.axhline(1.0, color=QUIET, linewidth=1, linestyle=(0, (2, 2)))
    axis.set_xticks(places, [f"{math.degrees(m):.0f}" for m in r.middle])
    axis.set(ylim=(0, 1.2 * float(np.nanmax(r.level, initial=1.5))), xlabel="speed of the command [deg/s], fifths of the time")
    axis.set_title("Joint residual [× floor]")
    axis.grid(axis="x", visible=False)


def letter(place: int) -> str:
    """Letters of a candidate in tables and maps: A to Z, AA, AB and so on. place: from 0."""
    return (letter(place // 26 - 1) if place >= 26 else "") + chr(ord("A") + place % 26)


def confusion(r: RoundFinalists) -> str:
    """Map of the cosine between the changes of each pair of the first `MAPPED` finalists."""
    from matplotlib.colors import LinearSegmentedColormap

    n = min(len(r.table), MAPPED)
    letters = [letter(i) for i in range(n)]
    figure, axes = canvas(1, 1, (0.72 * n + 0.3, 0.46 * n + 0.3))
    axis = axes[0, 0]
    colours = LinearSegmentedColormap.from_list("alike", ["#F7F9FB", "#F3C9A8", VERMILION, "#7A3200"])
    size = np.abs(r.alike[:n, :n])
    axis.imshow(size, cmap=colours, vmin=0, vmax=1, aspect="auto")
    for i in range(n):
        for j in range(n):
            text = f"{r.alike[i, j]:.2f}"
            axis.text(j, i, text, ha="center", va="center", fontsize=9.5, color="white" if size[i, j] > 0.6 else INK)
    axis.set_xticks(range(n), letters, color=INK)
    axis.xaxis.tick_top()
    axis.set_yticks(range(n), letters, color=INK)
    _tiles(axis, n, n, 9)
    return svg(figure, "Confusion map of the finalists")


def _tiles(axis, columns: int, rows: int, labelsize: float) -> None:
    """Draws white lines between the cells of a matrix, in place of ticks and frame."""
    axis.tick_params(length=0, labelsize=labelsize)
    axis.grid(visible=False)
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set_xticks(np.arange(-0.5, columns), minor=True)
    axis.set_yticks(np.arange(-0.5, rows), minor=True)
    axis.grid(which="minor", color="white", linewidth=2.5)
    axis.tick_params(which="minor", length=0)


def _tenth(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}"


def _short(value: float) -> str:
    return number(value) if value >= 10 else f"{value:.1f}"


HALF = 1.645  # of a 90 % band
ZOOM = {"joint": 4.0, "heading": 8.0}  # s shown, so that single beats are visible
MOST = 3
UNITS = {"joint": (math.degrees(1), "deg"), "heading": (math.degrees(1), "deg"), "position": (1e3, "mm"), "power": (1.0, "W")}


class TracePanel(NamedTuple):
    """One panel: a column of a record, and the stretch shown."""

    block: ChannelBlock
    start: float
    stop: float


def chosen(c: Comparison) -> list[TracePanel]:
    """The block of each channel with the largest share of the gap, largest first; no record twice if there is another."""
    best: dict[str, tuple[float, ChannelBlock]] = {}
    for b in (b for b in c.layout.blocks if b.channel in UNITS):  # a start pose is no trace
        excess = float(np.sum(c.ratio[0][b.where] - 1.0))
        if b.channel not in best or excess > best[b.channel][0]:
            best[b.channel] = (excess, b)
    order = sorted(best.values(), key=lambda found: -found[0])[:MOST]
    return [TracePanel(b, *stretch(c, b)) for _, b in order]


def stretch(c: Comparison, b: ChannelBlock) -> tuple[float, float]:
    """Shown time span of a channel: all of it, or the seconds with the largest difference."""
    length = ZOOM.get(b.channel, math.inf)
    end = float(b.t[-1])
    if end <= length:
        return 0.0, end
    starts = np.arange(0.0, end - length + 1e-9, 0.5)
    ratio = c.ratio[0][b.where]
    level = [float(np.sum(ratio[(b.t >= s) & (b.t < s + length)])) for s in starts]  # of a pause: 0
    worst = starts[int(np.argmax(level))]
    return float(worst), float(worst + length)


def traces(c: Comparison, use: list[str]) -> str:
    """Traces with one column a chosen block: above measured and predicted, below the residual. use: part of each record."""
    panels = chosen(c)
    figure, axes = canvas(2, len(panels), (3.63 * len(panels), 3.9), sharex="col", height_ratios=(1.5, 1))
    for column, (b, start, stop) in enumerate(panels):
        record = c.records[b.record]
        sensor = getattr(record, b.sensor)
        factor, unit = UNITS[b.channel]
        some = (sensor.t >= start) & (sensor.t <= stop)
        t, predicted = sensor.t[some], c.predictions[b.record][b.sensor][:, some, b.column]
        measured = sensor.values[some, b.column]
        upper, lower = axes[:, column]
        upper.plot(t, factor * measured, color=MEASURED, alpha=0.4, linewidth=3.2, label="measured")
        upper.plot(t, factor * predicted[0], "--", color=BEFORE, linewidth=1.6, label="model as it was")
        if c.changed:
            upper.plot(t, factor * predicted[1], color=AFTER, linewidth=1.5, label="with what was found")
        shown = (b.t >= start) & (b.t <= stop)
        floor = factor * HALF * c.scale[b.where][shown]
        lower.fill_between(b.t[shown], -floor, floor, color=BAND, linewidth=0, label="90 % of the null runs")
        lower.plot(b.t[shown], factor * c.residuals[0][b.where][shown], "--", color=BEFORE, linewidth=1.5)
        if c.changed:
            lower.plot(b.t[shown], factor * c.residuals[1][b.where][shown], color=AFTER, linewidth=1.6)
        lower.axhline(0, color=QUIET, linewidth=0.6)
        which = f"joint {b.column + 1}" if b.channel == "joint" else "xy"[b.column] if b.channel == "position" else b.channel
        upper.set_title(f"{which} [{unit}]", pad=20)
        about = f"{drawn(record.excitation or record.name)}, {use[b.record]}"
        upper.text(0, 1.04, about, transform=upper.transAxes, color=QUIET, fontsize=9.2)
        lower.set_xlabel("time [s]")
        lower.set_xlim(start, stop)
        if column == 0:
            lower.set_ylabel("what is left", color=INK)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    more, names = axes[1, 0].get_legend_handles_labels()
    figure.legend([*handles, *more], [*labels, *names], loc="outside lower center", ncols=4)
    return svg(figure, "Measured, model before and after")
