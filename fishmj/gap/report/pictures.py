"""Pictures of the whole: gap by part of the records, growth curves, heat map, localisation details, confusion map."""

import math

import numpy as np

from fishmj.gap.localise import Localisation
from fishmj.gap.localise.error_growth import GrowthCurve
from fishmj.gap.report.report_data import ReportPart, Round
from fishmj.gap.report.svg import ACCENT, AFTER, BAND, BEFORE, INK, QUIET, canvas, svg
from fishmj.gap.report.words import LETTERS
from fishmj.gap.wording import level, number

ANGLE = {"rad": (math.degrees(1.0), "deg"), "m": (1e3, "mm")}


def gaps(parts: tuple[ReportPart, ...], changed: bool) -> str:
    """Before and after on every part of the records, with the floor."""
    figure, axes = canvas(1, 1, (6.2, 0.72 * len(parts) + 0.85))
    axis = axes[0, 0]
    lows = [p.low for p in parts if np.isfinite(p.low)]
    if lows:
        high = max(p.high for p in parts if np.isfinite(p.high))
        axis.axvspan(min(lows), high, color=BAND, zorder=0)
    axis.axvline(1.0, color=QUIET, linewidth=1, linestyle=(0, (2, 2)))
    most = max([p.before for p in parts] + [p.after for p in parts] + [4.0])
    least = min([p.after for p in parts] + lows + [0.6])
    for y, p in enumerate(parts):
        if changed:
            axis.annotate("", (p.after, y), (p.before, y), arrowprops={"arrowstyle": "-", "color": "#9AA5B1", "linewidth": 1.6})
            axis.plot(p.after, y, "o", color=AFTER, markersize=9, zorder=3)
            axis.text(p.after, y + 0.17, level(p.after), ha="center", va="top", color=AFTER, fontsize=9.5, fontweight="bold")
        axis.plot(p.before, y, "s", color=BEFORE, markersize=8, zorder=3)
        axis.text(p.before, y - 0.17, level(p.before), ha="center", va="bottom", color=BEFORE, fontsize=9.5, fontweight="bold")
    axis.set_yticks(range(len(parts)), [f"{p.name} ({p.records})" for p in parts], fontsize=10, color=INK)
    axis.set(ylim=(len(parts) - 0.4, -0.6), xscale="log", xlim=(0.7 * least, 1.6 * most))
    axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.xaxis.set_minor_formatter("")
    axis.grid(axis="y", visible=False)
    axis.spines["left"].set_visible(False)
    axis.tick_params(axis="y", length=0)
    axis.set_xlabel("gap (1 = agreement)")
    return svg(figure, "Gap before and after on every part of the records")


def growth(found: tuple[GrowthCurve, ...], changed: bool) -> str:
    """Error after a restart against the time since it."""
    figure, axes = canvas(1, len(found), (10.9, 2.75))
    for axis, c in zip(axes[0], found, strict=True):
        factor, unit = ANGLE[c.unit]
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
        slope = (
            f"slope {_tenth(c.slope)} ({_tenth(c.low)} to {_tenth(c.high)}): {c.kind}" if told else "no slope above the start's"
        )
        axis.set_title(f"{c.channel} [{unit}]", pad=20)
        axis.text(0, 1.035, slope, transform=axis.transAxes, color=QUIET, fontsize=9.2)
        axis.set_xlabel("time since the restart [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    handles.append(figure.axes[0].collections[0])
    figure.legend(handles, [*labels, "uncertainty of the start"], loc="outside lower center", ncols=3)
    return svg(figure, "Growth of the error after a restart")


def heat(p: Localisation) -> str:
    """Share of the gap by channel and regime; below it how much of the time each regime takes."""
    from matplotlib.colors import LinearSegmentedColormap

    seen = [k for k in range(len(p.kinds)) if np.isfinite(p.level[:, k]).any()]
    share = 100 * p.share[:, seen]
    figure, axes = canvas(1, 1, (10.9, 0.44 * len(p.channels) + 1.25))
    axis = axes[0, 0]
    colours = LinearSegmentedColormap.from_list("share", ["#F7F9FB", "#9CC9E3", "#0072B2", "#003B5C"])
    top = max(30.0, float(share.max()))
    axis.imshow(share, cmap=colours, vmin=0, vmax=top, aspect="auto")
    for i in range(len(p.channels)):
        for j, k in enumerate(seen):
            dark = share[i, j] > 0.45 * top
            text = f"{share[i, j]:.0f} %" if share[i, j] >= 0.5 else "0" if np.isfinite(p.level[i, k]) else "no data"
            axis.text(j, i - 0.08, text, ha="center", va="center", color="white" if dark else INK, fontsize=10)
            if np.isfinite(p.level[i, k]):
                quiet = "#E6EEF5" if dark else QUIET
                axis.text(j, i + 0.27, f"{_short(p.level[i, k])} × floor", ha="center", va="center", color=quiet, fontsize=7.6)
    time = np.nanmax(p.time[:, seen], 0)
    axis.set_xticks(
        range(len(seen)), [f"{_wrapped(p.kinds[k])}\n{100 * t:.0f} % of time" for k, t in zip(seen, time, strict=True)]
    )
    axis.set_yticks(range(len(p.channels)), p.channels, color=INK, fontsize=10)
    axis.tick_params(length=0, labelsize=8.6)
    axis.grid(visible=False)
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set_xticks(np.arange(-0.5, len(seen)), minor=True)
    axis.set_yticks(np.arange(-0.5, len(p.channels)), minor=True)
    axis.grid(which="minor", color="white", linewidth=2.5)
    axis.tick_params(which="minor", length=0)
    return svg(figure, "Share of the gap by channel and regime")


def details(p: Localisation, changed: bool) -> str:
    """Lags, heading, speed of the command: as many panels as there is something to show."""
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


def confusion(r: Round) -> str:
    """Cosine between what each pair of finalists changes."""
    from matplotlib.colors import LinearSegmentedColormap

    n = len(r.table)
    figure, axes = canvas(1, 1, (0.72 * n + 0.3, 0.46 * n + 0.3))
    axis = axes[0, 0]
    colours = LinearSegmentedColormap.from_list("alike", ["#F7F9FB", "#F3C9A8", "#D55E00", "#7A3200"])
    size = np.abs(r.alike)
    axis.imshow(size, cmap=colours, vmin=0, vmax=1, aspect="auto")
    for i in range(n):
        for j in range(n):
            text = f"{r.alike[i, j]:.2f}"
            axis.text(j, i, text, ha="center", va="center", fontsize=9.5, color="white" if size[i, j] > 0.6 else INK)
    axis.set_xticks(range(n), LETTERS[:n], color=INK)
    axis.xaxis.tick_top()
    axis.set_yticks(range(n), LETTERS[:n], color=INK)
    axis.tick_params(length=0, labelsize=9)
    axis.grid(visible=False)
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set_xticks(np.arange(-0.5, n), minor=True)
    axis.set_yticks(np.arange(-0.5, n), minor=True)
    axis.grid(which="minor", color="white", linewidth=2.5)
    axis.tick_params(which="minor", length=0)
    return svg(figure, "Confusion map of the finalists")


def _tenth(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}"


def _short(value: float) -> str:
    return number(value) if value >= 10 else f"{value:.1f}"


def _wrapped(text: str, width: int = 14) -> str:
    """Words on lines of about `width`."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)
