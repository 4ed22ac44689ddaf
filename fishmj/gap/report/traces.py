"""Measured, model before and after, with the floor, for the records that tell most."""

import math
from typing import NamedTuple

import numpy as np

from fishmj.gap.localise import Comparison
from fishmj.gap.records.records import ChannelBlock
from fishmj.gap.report.svg import AFTER, BAND, BEFORE, INK, MEASURED, QUIET, canvas, svg
from fishmj.pages import drawn

HALF = 1.645  # of a 90 % band
ZOOM = {"joint": 4.0, "heading": 8.0}  # s shown: a beat must be seen
MOST = 3
UNITS = {"joint": (math.degrees(1), "deg"), "heading": (math.degrees(1), "deg"), "position": (1e3, "mm"), "power": (1.0, "W")}


class Chosen(NamedTuple):
    """One panel: a column of a record, and the stretch shown."""

    block: ChannelBlock
    start: float
    stop: float


def chosen(c: Comparison) -> list[Chosen]:
    """The block of each channel in which most of the gap lies, biggest first; one record twice only when there is no other."""
    weights = c.weights()
    best: dict[str, tuple[float, ChannelBlock]] = {}
    for b in (b for b in c.layout.blocks if b.channel in UNITS):  # where the fish was put is no trace
        excess = float(np.sum((weights * (c.ratio[0] - 1.0))[b.where]))
        if b.channel not in best or excess > best[b.channel][0]:
            best[b.channel] = (excess, b)
    order = sorted(best.values(), key=lambda found: -found[0])[:MOST]
    return [Chosen(b, *stretch(c, b)) for _, b in order]


def stretch(c: Comparison, b: ChannelBlock) -> tuple[float, float]:
    """Where a channel is shown: all of it, or the seconds that differ most."""
    length = ZOOM.get(b.channel, math.inf)
    end = float(b.t[-1])
    if end <= length:
        return 0.0, end
    starts = np.arange(0.0, end - length + 1e-9, 0.5)
    ratio = c.ratio[0][b.where]
    level = [float(np.mean(ratio[(b.t >= s) & (b.t < s + length)])) for s in starts]
    return float(starts[int(np.argmax(level))]), float(starts[int(np.argmax(level))] + length)


def traces(c: Comparison, use: list[str]) -> str:
    """One column a chosen block: above what was measured and predicted, below what is left. use: part of each record."""
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
        lower.fill_between(b.t[shown], -floor, floor, color=BAND, linewidth=0, label="floor, nine of ten null runs")
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
