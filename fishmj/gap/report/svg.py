"""How pictures look: SVG that carries its text as text, colours of Okabe and Ito (2008), and never colour alone."""

import io
import re
from contextlib import contextmanager
from itertools import count
from typing import Any

from markupsafe import Markup

from fishmj.errors import MissingExtra
from fishmj.pages import escaped

INK, QUIET, FAINT, BAND = "#1F2933", "#5B6570", "#D9DEE5", "#E6EAF0"
MEASURED, BEFORE, AFTER, ACCENT = "#1F2933", "#D55E00", "#0072B2", "#009E73"
FONTS = ["Helvetica Neue", "Arial", "Liberation Sans", "DejaVu Sans"]
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "fishmj",
    "font.family": "sans-serif",
    "font.sans-serif": FONTS[::-1],  # measured with a wide face, shown with what the reader has
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": QUIET,
    "axes.edgecolor": "#9AA5B1",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
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
_numbers = count()


@contextmanager
def style():
    """Inside, figures look like this; restored afterwards."""
    try:
        import matplotlib
    except ModuleNotFoundError as error:
        raise MissingExtra("matplotlib", "dev", "the report of gap find") from error
    matplotlib.use("Agg")
    with matplotlib.rc_context(STYLE):
        yield


def canvas(rows: int, columns: int, size: tuple[float, float], **options):
    """A figure and its axes (rows, columns)."""
    from matplotlib import pyplot

    return pyplot.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained", **options)


def svg(figure, label: str) -> Markup:
    """The figure as an SVG element that fills its column; `label` is read aloud. The figure is closed."""
    from matplotlib import pyplot

    out = io.StringIO()
    figure.savefig(out, format="svg", bbox_inches="tight", pad_inches=0.04, metadata={"Date": None, "Creator": None})
    pyplot.close(figure)
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    mark = f"f{next(_numbers)}_"
    text = re.sub(r'\bid="', f'id="{mark}', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{mark}", text)
    width = re.search(r'width="([\d.]+)pt"', text)
    wide = f"{float(width[1]) * 4 / 3:.0f}" if width else "1000"
    text = re.sub(r'(<svg[^>]*?) width="[\d.]+pt"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[\d.]+pt"', r"\1", text, count=1)
    text = re.sub(r"(\d+\.\d{2})\d+", r"\1", text)
    head = f'<svg role="img" aria-label="{escaped(label)}" style="--wide:{wide}px"'
    return Markup(text.replace("<svg", head, 1).strip())
