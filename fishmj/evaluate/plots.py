"""Plots of evaluated trials, like the paper's: distance curves, radar over directions, headings, tracks.

Upstream is up; LOS is measured counter-clockwise from upstream. Lines differ in colour and dash, and are labelled.
"""

from itertools import cycle
from pathlib import Path

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import BLUE, GREEN, GREY, OPEN, ORANGE, PURPLE, SKY, VERMILION, canvas, save, style
from fishmj.base.pages import drawn
from fishmj.base.units import wrap
from fishmj.evaluate.metrics import Result, beat_mean, figures, mean_of_known
from fishmj.evaluate.protocol import ANGLE, EIGHT, HOLD
from fishmj.tasks.reference import eight, path_length

PICTURES = ("distance.png", "radar.png", "heading.png", "tracks.png", "path.png")  # files of `pictures`
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY, "#8C564B")
DASHES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (3, 2)), (0, (2, 3)))
INK, FAINT = "#222222", "#C9CED6"
RADAR = (("approach_time", "approach time [s]"), ("rmse_after_arrival", "RMSE after arrival [m], log"), ("power", "power [W]"))
LOGARITHMIC = {"rmse_after_arrival": 0.02}  # key -> radius at the centre
STYLE = OPEN | {
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#777777",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
AROUND = {"bbox_inches": "tight", "pad_inches": 0.15}  # of a saved picture


@style(STYLE)
def pictures(results: list[Result], folder: Path) -> list[tuple[Path, str]]:
    """Draws all pictures into `folder`: (file, caption)."""
    distances = (distance, "Distance to the target: median and the middle half of the trials, by flow speed.")
    seen = (tracks, "Tracks seen from the target (cross, with the 0.1 m circle); the water flows down the page.")
    panels = (
        distances,
        (radar, "Means over repeats, by direction of the target; upstream is up."),
        (headings, "Share of time of beat-averaged headings, 30 to 60 s; upstream is up."),
        seen,
        (paths, "Path of the target (grey) and tracks of all trials; the water flows down the page."),
    )
    of_task = {HOLD: panels[:4], ANGLE: (distances, seen), EIGHT: (panels[4],)}[results[0].trials.task]
    files = dict(zip(panels, PICTURES, strict=True))
    return [(panel[0](results, folder / files[panel]), panel[1]) for panel in of_task]


def looks(results: list[Result]):
    """Yields (result, colour, dash) for each controller."""
    return [(r, c, d) for r, c, d in zip(results, cycle(COLOURS), cycle(DASHES), strict=False)]


def legend(figure, results: list[Result], **options) -> None:
    """Draws one legend for the whole figure, under the panels."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=c, linestyle=d, linewidth=2.2, label=drawn(r.controller)) for r, c, d in looks(results)]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 8), frameon=False, **options)


def speeds_of(results: list[Result]) -> list[float]:
    """Speeds of the trials, m/s, rising."""
    return sorted(set(results[0].trials.speed))


def distance(results: list[Result], path: Path) -> Path:
    """Draws distance over time, one panel for each speed."""
    speeds = speeds_of(results)
    figure, axes = canvas(1, len(speeds), (4.4 * len(speeds), 4.0), sharey=True)
    radius = constant("protocol", "arrival_radius")
    for axis, speed in zip(axes[0], speeds, strict=True):
        for r, colour, dash in looks(results):
            d = r.distance[r.trials.speed == speed]
            low, middle, high = np.quantile(d, [0.25, 0.5, 0.75], axis=0)
            axis.fill_between(r.t, low, high, color=colour, alpha=0.13, linewidth=0)
            axis.plot(r.t, middle, color=colour, linestyle=dash, linewidth=2)
        axis.axhline(radius, color="#888888", linewidth=0.9, linestyle=":")
        axis.set(title=f"flow {speed:g} m/s", xlabel="time [s]", xlim=(0, r.t[-1]), ylim=(0.01, 4), yscale="log")
        axis.grid(axis="y", color="#E6E8EC", linewidth=0.8)
        axis.set_yticks([0.01, 0.03, 0.1, 0.3, 1, 3], labels=["0.01", "0.03", "0.1", "0.3", "1", "3"])
        axis.minorticks_off()
    axes[0, -1].text(results[0].t[-1], radius, f" {radius:g} m", va="center", color="#666666", fontsize=9)
    axes[0, 0].set_ylabel("distance to target [m]")
    legend(figure, results)
    return save(figure, path, **AROUND)


def radar(results: list[Result], path: Path) -> Path:
    """Draws `radar_figure` into a file."""
    return save(radar_figure(results), path, **AROUND)


def radar_figure(results: list[Result]):
    """Figure of approach time, RMSE and power over the directions: rows speeds, columns figures, lines controllers."""
    speeds = speeds_of(results)
    figure, axes = canvas(len(speeds), 3, (12, 3.9 * len(speeds) + 0.5), subplot_kw={"projection": "polar"})
    found = [(figures(r), r, c, d) for r, c, d in looks(results)]
    for column, (key, title) in enumerate(RADAR):
        for row, speed in enumerate(speeds):
            axis, nothing = polar(axes[row, column]), 0
            for f, r, colour, dash in found:
                los, mean = np.unique(r.trials.los), _means(f[key], r, speed)
                axis.plot(np.append(los, los[0]), np.append(mean, mean[0]), color=colour, linestyle=dash, linewidth=2)
                there = np.isfinite(mean)
                axis.scatter(los[there], mean[there], color=colour, s=16, zorder=3)
                nothing += not there.any()
            if nothing == len(found):
                axis.text(0.5, 0.5, "no trial\nhas it", ha="center", va="center", color="#777777", transform=axis.transAxes)
            if key in LOGARITHMIC:
                axis.set_rscale("log")
                axis.set_rticks([0.03, 0.1, 0.3, 1, 3], labels=["0.03", "0.1", "0.3", "1", "3"])
                axis.minorticks_off()
            axis.set_rlim(LOGARITHMIC.get(key, 0.0), _ceiling(found, key, results))
            axis.set_title(f"{title}\nflow {speed:g} m/s", pad=14)
    legend(figure, results, fontsize=11)
    return figure


def _means(values, r: Result, speed: float) -> np.ndarray:
    """Means of a figure (n,) over the trials that have it, at one speed, in each direction; NaN if there are none."""
    some = [values[(r.trials.speed == speed) & (r.trials.los == b)] for b in np.unique(r.trials.los)]
    return np.array([mean_of_known(x) for x in some])


def _ceiling(found, key: str, results) -> float:
    """Radius of a radar column: the largest mean of any condition."""
    tops = np.concatenate([_means(f[key], r, speed) for f, r, *_ in found for speed in speeds_of(results)])
    return 1.08 * float(np.nanmax(tops)) if np.isfinite(tops).any() else 1.0


def plain_ticks(axis) -> None:
    """Labels a logarithmic axis (`axes.xaxis`, `axes.yaxis`) with decimal numbers at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_locator(NullLocator())


def polar(axis):
    """Sets the axis: upstream up, angles as LOS."""
    axis.set_theta_zero_location("N")
    axis.set_thetagrids(range(0, 360, 45), ["upstream", *(f"{b}°" for b in range(45, 360, 45))], fontsize=9)
    axis.tick_params(axis="x", pad=2)
    axis.tick_params(axis="y", labelsize=8)
    axis.set_rlabel_position(67)
    axis.grid(color="#DDE1E7", linewidth=0.8)
    axis.spines["polar"].set_color(FAINT)
    return axis


def headings(results: list[Result], path: Path) -> Path:
    """Draws histograms of the heading in the hold phase, for targets upstream and downstream of the start."""
    sides = (("target upstream", 1), ("target downstream", -1))
    figure, axes = canvas(2, len(results), (3.3 * len(results) + 0.4, 7.8), subplot_kw={"projection": "polar"})
    start, end = constant("protocol", "rheotaxis_window")
    edges = np.radians(np.arange(-180, 181, 10))
    for column, (r, colour, _) in enumerate(looks(results)):
        heading = wrap(np, beat_mean(r.pose[:, :, 2], r.robot.timing.bus_dt) - r.trials.upstream)
        inside = (r.t >= start) & (r.t <= end) & (np.arange(len(r.t)) < r.left[:, None])
        for row, (title, sign) in enumerate(sides):
            some = sign * np.cos(r.trials.los) > 1e-6
            values = heading[some][inside[some]]
            axis = polar(axes[row, column])
            axis.set_title(f"{drawn(r.controller)}, {title}", pad=14)
            if not len(values):
                lasted = r.trials.duration > start
                why = "no trial\nstayed in\nthe tank" if lasted else f"trials end\nbefore {start:g} s"
                axis.text(0, 0, why, ha="center", va="center", color="#777777")
                axis.set_yticks([])
                continue
            share = np.histogram(values, edges)[0] / len(values)
            axis.bar(edges[:-1] + np.radians(5), np.sqrt(share), width=np.radians(9), color=colour, alpha=0.85, linewidth=0)
            axis.set_yticks(np.sqrt([0.1, 0.4, 0.9]), labels=["10 %", "40 %", "90 %"])
            axis.set_ylim(0, 1)
            spread = np.degrees(np.sqrt(max(-2 * np.log(max(abs(np.mean(np.exp(1j * values))), 1e-9)), 0)))
            axis.set_title(f"{drawn(r.controller)}, {title}\nspread {spread:.0f}°", pad=14)
    return save(figure, path, **AROUND)


def tracks(results: list[Result], path: Path) -> Path:
    """Draws tracks relative to the target: rows controllers, columns speeds, colour by direction."""
    from matplotlib.patches import Circle

    speeds = speeds_of(results)
    figure, axes = canvas(len(results), len(speeds), (3.6 * len(speeds), 3.6 * len(results)), sharex=True, sharey=True)
    los = np.unique(results[0].trials.los)
    for row, r in enumerate(results):
        c, s = np.cos(r.trials.upstream), np.sin(r.trials.upstream)
        rel = r.pose[:, :, :2] - r.target[:, None]
        up, left = c * rel[..., 0] + s * rel[..., 1], c * rel[..., 1] - s * rel[..., 0]
        for column, speed in enumerate(speeds):
            axis = axes[row, column]
            for i in np.flatnonzero(r.trials.speed == speed):
                stop = min(r.left[i] + 1, len(r.t))
                hue = COLOURS[np.searchsorted(los, r.trials.los[i]) % len(COLOURS)]
                axis.plot(-left[i, :stop], up[i, :stop], color=hue, linewidth=0.8, alpha=0.8)
                axis.plot(-left[i, 0], up[i, 0], "o", color=hue, markersize=4)
            axis.add_patch(Circle((0, 0), constant("protocol", "arrival_radius"), fill=False, color=INK, linewidth=1, zorder=4))
            axis.plot(0, 0, "+", color=INK, markersize=9, zorder=4)
            axis.annotate("", (1.75, 1.2), (1.75, 1.8), arrowprops={"arrowstyle": "->", "color": BLUE, "linewidth": 1.6})
            axis.text(1.66, 1.5, "flow", ha="right", va="center", color=BLUE, fontsize=9)
            axis.set(xlim=(-2, 2), ylim=(-2, 2), aspect="equal", title=f"{drawn(r.controller)}, {speed:g} m/s")
        axes[row, 0].set_ylabel("upstream of the target [m]")
    for axis in axes[-1]:
        axis.set_xlabel("to the right, facing upstream [m]")
    return save(figure, path, **AROUND)


def paths(results: list[Result], path: Path) -> Path:
    """Draws tracks on the figure eight: rows controllers, columns speeds."""
    speeds = speeds_of(results)
    figure, axes = canvas(len(results), len(speeds), (3.4 * len(speeds), 3.0 * len(results)), sharex=True, sharey=True)
    looked = zip(axes, looks(results), strict=True)
    for row, (r, colour, _) in looked:
        for axis, speed in zip(row, speeds, strict=True):
            some = np.flatnonzero(r.trials.speed == speed)
            eight_panel(axis, [r.pose[i, : min(r.left[i] + 1, len(r.t)), :2] for i in some], colour)
            axis.set_title(f"{drawn(r.controller)}, {speed:g} m/s")
        row[0].set_ylabel("upstream [m]")
    for axis in axes[-1]:
        axis.set_xlabel("to the right, facing upstream [m]")
    return save(figure, path, **AROUND)


def eight_panel(axis, tracks, colour: str) -> None:
    """Draws tracks, each (T, 2) m in the tank, over the path; upstream is up, as in `tracks`."""
    points, _ = eight(np, np.linspace(0, path_length(), 400))
    axis.plot(points[:, 1], -points[:, 0], color=FAINT, linewidth=5, zorder=1)
    for track in tracks:
        axis.plot(track[:, 1], -track[:, 0], color=colour, linewidth=0.8, alpha=0.8)
    axis.set(xlim=(-1.5, 1.5), ylim=(-1.3, 1), aspect="equal")
