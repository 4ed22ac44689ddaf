"""The ablation as a table, a CSV and a picture."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from fishmj.base import console
from fishmj.base.figures import canvas, png
from fishmj.base.pages import drawn
from fishmj.base.store import write_bytes, write_json, write_text
from fishmj.hydro_fit.free_swims import STATED

SHOWN = {  # figure -> (heading, factor, format)
    "speed_error_mean": ("speed", 100.0, "{:.1f} %"),
    "speed_error_max": ("worst", 100.0, "{:.1f} %"),
    "yaw_rate_error_mean": ("yaw rate", 100.0, "{:.1f} %"),
    "power_error_mean": ("power", 100.0, "{:.1f} %"),
    "thrust_error": ("thrust / tow drag", 100.0, "{:.1f} %"),
    "freerun_position_error": ("place", 1.0, "{:.3f} m"),
}
CLOUD, ASKED = "#20639b", "#c0502e"
ROOM = 2.0  # beside the outermost dots, a factor


def grouped(rows: Sequence[dict]) -> dict[str, list[dict]]:
    """Rows by name, one for each seed, in their original order."""
    out: dict[str, list[dict]] = {}
    for row in rows:
        out.setdefault(row["row"], []).append(row)
    return out


def cells(rows: Sequence[dict]) -> list[dict]:
    """Lines, one for each row name: figures as text, mean and range over seeds.

    Last the required values and numbers of records.
    """
    lines = []
    for some in grouped(rows).values():
        line: dict = {"water": some[0]["title"] + (f" ({len(some)} seeds)" if len(some) > 1 else "")}
        for key, (heading, factor, text) in SHOWN.items():
            line[heading] = _text([row["figures"][key] for row in some], factor, text)
        line["validation"] = _text([row["validation"]["judged"] for row in some], 1.0, "{:.2f}")
        line["fit, CPU s"] = _text([row["seconds"] for row in some if row["seconds"]], 1.0, "{:.0f}")
        lines.append(line)
    first = rows[0]
    blank = {"validation": "", "fit, CPU s": ""}
    asked = {heading: _text([STATED[key]], factor, text) for key, (heading, factor, text) in SHOWN.items()}
    count = {heading: str(first["n"][key]) for key, (heading, _, _) in SHOWN.items()}
    return [*lines, {"water": "asked for"} | asked | blank, {"water": "held-out records, n"} | count | blank]


def _text(values: Sequence[float | None], factor: float, text: str) -> str:
    known = [factor * value for value in values if value is not None and value == value]
    if not known:
        return "-"
    mean = text.format(sum(known) / len(known))
    if len(known) == 1:
        return mean
    number = text.partition("}")[0] + "}"
    return f"{mean} ({number.format(min(known))} to {number.format(max(known))})"


def write(folder: Path, rows: Sequence[dict], about: dict) -> list[Path]:
    """Writes ablation.json, ablation.csv (one line for each row and seed), ablation.md and ablation.png in `folder`."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["row", "seed", *SHOWN, "guard_rate", *(f"n_{key}" for key in SHOWN), "freerun_s", "fit_s", "notes"])
    for row in rows:
        figures, n = row["figures"], row["n"]
        numbers = [figures[key] for key in SHOWN] + [figures.get("guard_rate", "")]
        out.writerow(
            [row["row"], row["seed"], *numbers, *(n[key] for key in SHOWN), row["freerun_s"], row["seconds"], row["notes"]]
        )
    return [
        write_json(folder / "ablation.json", {"about": about, "rows": rows}),
        write_text(folder / "ablation.csv", text.getvalue()),
        write_text(folder / "ablation.md", console.table(cells(rows)) + "\n"),
        write_bytes(folder / "ablation.png", picture(rows)),
    ]


def picture(rows: Sequence[dict]) -> bytes:
    """PNG: one panel for each known figure, one line for each water, one dot for each seed; the required value as a line."""
    from matplotlib.ticker import LogLocator, NullFormatter

    waters = grouped(rows)
    known = [key for key in SHOWN if any(row["figures"][key] is not None for row in rows)]
    size = (3.5 + 1.9 * len(known), 0.9 + 0.28 * len(waters))
    figure, axes = canvas(1, len(known), size, sharey=True)
    for axis, key in zip(axes[0], known, strict=True):
        heading, factor, text = SHOWN[key]
        shown = [STATED[key], *(row["figures"][key] for row in rows if row["figures"][key])]
        for place, some in enumerate(waters.values()):
            values = [factor * row["figures"][key] for row in some if row["figures"][key] is not None]
            axis.plot(values, [place] * len(values), "o", ms=4.5, color=CLOUD, alpha=0.7)
        axis.axvline(factor * STATED[key], lw=0.9, color=ASKED)
        axis.set_xscale("log")
        axis.set_xlim(factor * min(shown) / ROOM, factor * max(shown) * ROOM)
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0), numticks=9))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.xaxis.set_major_formatter("{x:g}")
        axis.tick_params(labelsize=8)
        axis.grid(lw=0.3)
        axis.set_title(f"{heading} [{text.rpartition(' ')[2]}]", fontsize=9)
    axes[0, 0].set_yticks(range(len(waters)), [drawn(some[0]["title"]) for some in waters.values()], fontsize=8)
    axes[0, 0].set_ylim(len(waters) - 0.5, -0.5)
    return png(figure, dpi=110)
