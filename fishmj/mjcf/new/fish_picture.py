"""A picture of a description: side and top view with links, joints, centre of mass and of buoyancy, fins and a scale bar."""

from typing import Any

import numpy as np

from fishmj.base.figures import canvas, png
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of, drawn_sections, fin_root
from fishmj.mjcf.geometry import Geometry, geometry_of

BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # m
INCHES = 10.0  # of the picture's width
EDGE = {"ec": "#333333", "lw": 0.8}


def picture(robot: Robot) -> bytes:
    """A PNG, 1000 pixels wide."""
    g, length = geometry_of(robot), robot.length
    tall = max(row[1] for link in robot.links for row in link.sections)
    wide = max(row[2] for link in robot.links for row in link.sections) * g.width_scale
    wide += 2 * max((fin.span for fin in robot.fins), default=0.0)
    above = -tall / 2 - wide / 2 - 0.17 * length  # height of the top view's axis on the page, m
    high, low = tall / 2 + 0.10 * length, above - wide / 2 - 0.06 * length
    size = (INCHES, INCHES * (high - low) / (1.06 * length))
    figure, ((axes,),) = canvas(1, 1, size, layout=None, gridspec_kw={"left": 0, "right": 1, "bottom": 0, "top": 1})
    axes.set(xlim=(-0.03 * length, 1.03 * length), ylim=(low, high), aspect="equal")
    axes.axis("off")
    fronts = np.cumsum([0.0, *(link.length for link in robot.links)])
    _fins(axes, robot, g, fronts, above)
    for column, scale, level, reach in ((1, 1.0, 0.0, tall / 2), (2, g.width_scale, above, wide / 2)):
        for i in range(len(robot.links)):
            _link(axes, robot, i, fronts[i], column, scale, level)
        for x in fronts[1:-1]:
            axes.plot([x, x], [level - reach, level + reach], ":", color="#222222", lw=1, zorder=4)
            axes.plot(x, level, "o", color="white", mec="#222222", ms=7, zorder=5)
    _centres(axes, robot, g, fronts)
    for i, link in enumerate(robot.links):
        bottom = -max(row[1] for row in link.sections) / 2
        grams = 1000 * link.mass
        words = f"{link.name}\n{grams:.0f} g" if grams >= 100 else f"{link.name}\n{grams:.3g} g"
        place = ((fronts[i] + fronts[i + 1]) / 2, bottom)
        axes.annotate(words, place, (0, -5), textcoords="offset points", ha="center", va="top", fontsize=8)
    title = f"{robot.name}: {length:.3g} m, {robot.mass:.3g} kg, {len(robot.links)} links"
    axes.text(0.0, high - 0.03 * length, title, fontsize=12, va="top")
    axes.text(
        length, low + 0.02 * length, f"from above, widths times {g.width_scale:.3g} so that it floats", fontsize=8, ha="right"
    )
    bar = max((b for b in BARS if b <= 0.25 * length), default=BARS[0])
    axes.plot([0.0, bar], [low + 0.025 * length] * 2, "k-", lw=3, solid_capstyle="butt")
    axes.text(bar + 0.01 * length, low + 0.02 * length, f"{1000 * bar:g} mm", fontsize=9)
    return png(figure, dpi=100)


def _link(axes: Any, robot: Robot, i: int, front: float, column: int, scale: float, level: float) -> None:
    """Link i from the side (column 1, heights) or from above (column 2, widths); its plate is hatched."""
    rows, link = drawn_sections(robot, i), robot.links[i]
    least = 0.002 * robot.length  # a plate is seen from above, too
    around = lambda x, half: (np.r_[x, x[::-1]], np.r_[level + half, level - half[::-1]])
    x, half = front + rows[:, 0], np.maximum(rows[:, column] * scale / 2, least)
    axes.fill(*around(x, half), color=colour_of(robot, i), zorder=2, **EDGE)
    if column == 1 and link.fin_from is not None and link.fin_from < link.length:
        behind = np.unique(np.r_[front + link.fin_from, x[x > front + link.fin_from]])
        axes.fill(*around(behind, np.interp(behind, x, half)), fill=False, hatch="//", ec="#FFFFFF66", lw=0, zorder=3)


def _fins(axes: Any, robot: Robot, g: Geometry, fronts: np.ndarray, level: float) -> None:
    for fin in robot.fins:
        i, root = fin_root(robot, g, fin)
        front, rear = (fronts[i] + s for s in fin.station)
        for side in (1.0, -1.0)[: fin.count]:
            x = [front, 0.35 * front + 0.65 * rear, rear, rear]
            y = [level + side * part for part in (0.6 * root, root + fin.span, root + fin.span, 0.6 * root)]
            axes.fill(x, y, color=0.7 * np.array(colour_of(robot, i)), zorder=1, **EDGE)


def _centres(axes: Any, robot: Robot, g: Geometry, fronts: np.ndarray) -> None:
    """Draws the centres of mass, of every link and of the fish, and the centre of buoyancy."""
    for i in range(len(robot.links)):
        lead = g.reference if i == 0 else 0.0
        axes.plot(fronts[i] + lead - g.com[i, 0], g.com[i, 2], "+", color="black", ms=7, zorder=6)
    depth = float(np.sum(g.mass * g.com[:, 2]) / robot.mass)
    floats = g.reference - float(np.sum(g.displaced * (g.origin + g.buoyancy)) / robot.mass)
    axes.plot(floats, 0, "^", color="#1f77b4", mec="white", ms=10, zorder=7, label="centre of buoyancy")
    axes.plot(g.reference, depth, "X", color="black", mec="white", ms=11, zorder=7, label="centre of mass (+ of a link)")
    axes.plot([], [], "o", color="white", mec="#222222", ms=7, label="joint")
    axes.legend(loc="upper right", fontsize=8, ncols=3, frameon=False)
