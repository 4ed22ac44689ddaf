"""One picture of a ranking: RMSE in the solver against RMSE in the surrogate, a dot a controller."""

from itertools import cycle
from pathlib import Path

import numpy as np

from fishmj.base.figures import canvas, save, style
from fishmj.base.pages import drawn
from fishmj.evaluate.plots import AROUND, COLOURS, FAINT, INK, STYLE, plain_ticks
from fishmj.evaluate.rank_waters.rank import GAP

WORDS = {"rmse_after_arrival": "RMSE after arrival", "rmse_holding": "RMSE while holding"}


@style(STYLE)
def picture(found: dict, path: Path, title: str) -> Path:
    """Draws one figure's ranking. found: of `rank.judged`. title: the condition, shown above."""
    figure, axes = canvas(1, 1, (6.4, 6.0))
    ax = axes[0, 0]
    ax.set_title(drawn(title), fontsize=9, fontweight="normal", loc="left", color=INK)
    rows = [row for row in found["controllers"] if row["n"]]
    spans = [row[water][end] for row in rows for water in ("solver", "surrogate") for end in ("low", "high", "value")]
    ends = [end for end in spans if np.isfinite(end)]
    low, high = max(min(ends, default=0.05) / 1.4, 5e-3), max(ends, default=1.0) * 1.4
    line = np.geomspace(low, high, 200)
    ax.fill_between(line, np.maximum(line - GAP, low / 10), line + GAP, color=FAINT, alpha=0.5, lw=0, label=f"within {GAP:g} m")
    ax.plot(line, line, color=FAINT, lw=1)
    for row, colour in zip(rows, cycle(COLOURS), strict=False):
        x, y = ([row[w][key] for key in ("value", "low", "high")] for w in ("solver", "surrogate"))
        error = [[[a[0] - a[1]], [a[2] - a[0]]] for a in (x, y)]
        face = colour if row["ranked"] else "white"
        ax.errorbar(x[0], y[0], xerr=error[0], yerr=error[1], fmt="o", ms=6, mfc=face, mec=colour, color=colour, lw=1.2)
        name = drawn(row["controller"]) + ("" if row["ranked"] else " (not ranked)")
        side = {"xytext": (7, -12)} if x[0] ** 2 < low * high else {"xytext": (-7, 6), "ha": "right"}
        ax.annotate(name, (x[0], y[0]), textcoords="offset points", color=colour, fontsize=9, **side)
    ax.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high), aspect="equal")
    word = WORDS.get(found["key"], found["key"])
    ax.set(xlabel=f"{word} in the solver [m]", ylabel=f"{word} in the surrogate [m]")
    for axis in (ax.xaxis, ax.yaxis):
        plain_ticks(axis)
    ax.legend(loc="upper left", frameon=False)
    return save(figure, path, **AROUND)
