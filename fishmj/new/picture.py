"""A picture of a description: side and top view with links, joints, centre of mass and of buoyancy, fins and a scale bar."""

import io

import numpy as np

from fishmj.errors import MissingExtra
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of, drawn_sections
from fishmj.mjcf.geometry import Geometry, geometry_of

BARS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # m


def picture(robot: Robot) -> bytes:
    """A PNG, about 1000 x 560 pixels. Raises MissingExtra without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("matplotlib", "all", "the picture of a description") from error
    g, length = geometry_of(robot), robot.length
    fronts = np.cumsum([0.0, *(link.length for link in robot.links)])
    tall = max(row[1] for link in robot.links for row in link.sections)
    wide = max(row[2] for link in robot.links for row in link.sections) * g.width_scale + 2 * sum(fin.span for fin in robot.fins)
    figure = Figure(figsize=(10, 2.2 + 8.5 * (tall + max(wide, 0.12 * length)) / length), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    ratios = [tall + 0.1 * length, max(wide, 0.12 * length) + 0.1 * length]
    side, top = figure.subplots(2, 1, sharex=True, height_ratios=ratios)
    for axes, column, scale in ((side, 1, 1.0), (top, 2, g.width_scale)):
        for i, link in enumerate(robot.links):
            rows = drawn_sections(robot, i)
            half = np.maximum(rows[:, column] * scale / 2, 0.002 * length)
            x = fronts[i] + rows[:, 0]
            axes.fill(np.r_[x, x[::-1]], np.r_[half, -half[::-1]], color=colour_of(robot, i), ec="#333333", lw=0.8, zorder=2)
            if column == 1 and link.fin_from is not None and link.fin_from < link.length:
                behind = x >= fronts[i] + link.fin_from - 1e-9
                axes.fill(
                    np.r_[x[behind], x[behind][::-1]],
                    np.r_[half[behind], -half[behind][::-1]],
                    fill=False,
                    hatch="///",
                    ec="#55555588",
                    lw=0,
                    zorder=3,
                )
        reach = (tall if column == 1 else wide) / 2
        for x in fronts[1:-1]:
            axes.plot([x, x], [-reach, reach], ":", color="#222222", lw=1, zorder=4)
            axes.plot(x, 0, "o", color="white", mec="#222222", ms=7, zorder=5)
    _fins(top, robot, g, fronts)
    _centres(side, robot, g, fronts)
    _words(side, top, robot, g, fronts, tall)
    data = io.BytesIO()
    figure.savefig(data, format="png")
    return data.getvalue()


def _fins(axes, robot: Robot, g: Geometry, fronts) -> None:
    names = [link.name for link in robot.links]
    for fin in robot.fins:
        i = names.index(fin.link)
        rows = np.array(robot.links[i].sections)
        root = np.interp(np.mean(fin.station), rows[:, 0], rows[:, 2]) * g.width_scale / 2
        front, rear = (fronts[i] + s for s in fin.station)
        for sign in (1.0, -1.0)[: fin.count]:
            corners = [(front, sign * 0.7 * root), (rear, sign * (root + fin.span)), (rear, sign * 0.7 * root)]
            axes.fill(*zip(*corners, strict=True), color=0.7 * np.array(colour_of(robot, i)), ec="#333333", lw=0.8, zorder=1)


def _centres(axes, robot: Robot, g: Geometry, fronts) -> None:
    """Of mass, of every link and of the fish; and of buoyancy."""
    for i in range(len(robot.links)):
        lead = g.reference if i == 0 else 0.0
        axes.plot(fronts[i] + lead - g.com[i, 0], g.com[i, 2], "+", color="black", ms=7, zorder=6)
    depth = float(np.sum(g.mass * g.com[:, 2]) / robot.mass)
    float_x = g.reference - float(np.sum(g.displaced * (g.origin + g.buoyancy)) / robot.mass)
    axes.plot(float_x, 0, "^", color="#1f77b4", mec="white", ms=10, zorder=7, label="centre of buoyancy")
    axes.plot(g.reference, depth, "X", color="black", mec="white", ms=11, zorder=7, label="centre of mass (+ of a link)")
    axes.plot([], [], "o", color="white", mec="#222222", ms=7, label="joint")
    axes.legend(loc="lower right", fontsize=8, ncols=3, frameon=False, bbox_to_anchor=(1.0, 0.98))


def _words(side, top, robot: Robot, g: Geometry, fronts, tall: float) -> None:
    length = robot.length
    side.set_title(f"{robot.name}: {length:.3g} m, {robot.mass:.3g} kg, {len(robot.links)} links", loc="left", fontsize=11)
    for i, link in enumerate(robot.links):
        middle = (fronts[i] + fronts[i + 1]) / 2
        high = max(row[1] for row in link.sections) / 2
        words = f"{link.name}\n{1000 * link.mass:.3g} g"
        side.annotate(words, (middle, -high), (0, -6), textcoords="offset points", ha="center", va="top", fontsize=8)
    bar = max((b for b in BARS if b <= 0.25 * length), default=BARS[0])
    low = -tall / 2 - 0.02 * length
    top.plot([0.0, bar], [top.get_ylim()[0]] * 2, "k-", lw=3, solid_capstyle="butt", clip_on=False)
    top.annotate(f"{1000 * bar:g} mm", (bar, top.get_ylim()[0]), (6, 0), textcoords="offset points", va="center", fontsize=9)
    top.set_title(f"from above, widths times {g.width_scale:.3g} so that it floats", loc="left", fontsize=9)
    side.set_ylim(low - 0.07 * length, tall / 2 + 0.02 * length)
    for axes in (side, top):
        axes.set_aspect("equal")
        axes.set_xlim(-0.03 * length, 1.03 * length)
        axes.axis("off")


__all__ = ["picture"]
