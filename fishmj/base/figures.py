"""Figures of reports: drawn without a display, saved in one step; Matplotlib is imported when the first one is drawn.

    with style(LOOK):                       rc parameters inside; also a decorator: @style(LOOK)
        figure, axes = canvas(1, 2, (8, 3))    axes (rows, columns)
        save(figure, path)                  a PNG on disk;  png(figure) its bytes;  svg(figure, label) an element of a page

Colours are those of Okabe and Ito (2008), told apart by all common kinds of colour vision.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from markupsafe import Markup

from fishmj.base.pages import escaped
from fishmj.base.store import write_bytes

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
GREY = "#5B5B5B"
OPEN: dict[str, Any] = {"axes.spines.top": False, "axes.spines.right": False}  # rc parameters: a frame of two sides
DPI = 130
TEXT = {"svg.fonttype": "none", "svg.hashsalt": "fishmj"}  # text stays text, names of parts do not change
_numbers = count()


@contextmanager
def style(look: Any = OPEN) -> Iterator[None]:
    """Inside, figures have these rc parameters; restored afterwards."""
    import matplotlib

    with matplotlib.rc_context(look):
        yield


def canvas(rows: int, columns: int, size: tuple[float, float], *, layout: Any = "constrained", **options):
    """A figure of `size` (width, height) inches and its axes (rows, columns). options: of `Figure.subplots`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout=layout)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def png(figure, **options) -> bytes:
    """The figure as a PNG. options: of `Figure.savefig`."""
    out = io.BytesIO()
    figure.savefig(out, format="png", **{"dpi": DPI, **options})
    return out.getvalue()


def save(figure, path: Path, **options) -> Path:
    """Write a PNG atomically; parent folders are made. Raises StoreError."""
    return write_bytes(path, png(figure, **options))


def svg(figure, label: str) -> Markup:
    """The figure as an SVG element that fills its column, its text as text; `label` is read aloud."""
    out = io.StringIO()
    with style(TEXT):
        figure.savefig(out, format="svg", bbox_inches="tight", pad_inches=0.04, metadata={"Date": None, "Creator": None})
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
