"""`fishmj deploy print-marks`: the tag and the calibration board as a PDF at true scale, each page with a rule of 100 mm."""

import io
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_bytes
from fishmj.deploy.commands.camera_command import board_size
from fishmj.deploy.loop.wiring import tag_options
from fishmj.deploy.tracker.apriltag import code_of

SHEETS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0), "A0": (841.0, 1189.0)}  # mm
MARGIN, FOOT, RULE = 10.0, 24.0, 100.0  # mm: round the drawing, below it for rule and text, the rule
MM = 1.0 / 25.4  # inches
EXAMPLES = """examples:
  fishmj deploy print-marks --out marks.pdf
  fishmj deploy print-marks --tag-number 3 --tag-size 0.1 --board 8x5 --square 0.03 --out marks.pdf"""


class Page(NamedTuple):
    """One page. sheet: its name; size: (width, height) mm; cells: (n, 2) mm, lower left of each black square; side: mm."""

    sheet: str
    size: tuple[float, float]
    cells: np.ndarray
    side: float
    label: str


def tag_page(family: str, number: int, size: float) -> Page:
    """A page with one tag; size: m, outer side of the black border.

    Raises UnknownName: another family; ConfigError: a number outside the family, or a tag too large for every sheet.
    """
    code = code_of(family, number)
    label = f"AprilTag {family}, number {number}, black border {1e3 * size:g} mm; right edge to the nose (--tag-mount X,Y,0)"
    return _page(~code, 1e3 * size / len(code), label, rim=1)


def board_page(columns: int, rows: int, square: float) -> Page:
    """A page with a chessboard of columns x rows inner corners; square: m.

    Raises ConfigError: a board too large for every sheet.
    """
    black = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 0
    return _page(black, 1e3 * square, f"board of {columns}x{rows} inner corners, squares of {1e3 * square:g} mm")


def _page(black: np.ndarray, side: float, label: str, rim: int = 0) -> Page:
    """A pattern (rows, columns) of cells of `side` mm in the middle of the smallest sheet that holds it, with a white rim."""
    rows, columns = black.shape
    wide, high = side * columns, side * rows
    need = max(wide + 2 * rim * side, RULE) + 2 * MARGIN, high + 2 * rim * side + MARGIN + FOOT
    turned = [(name, size) for name, sheet in SHEETS.items() for size in (sheet, sheet[::-1])]
    fitting = [(name, size) for name, size in turned if need[0] <= size[0] and need[1] <= size[1]]
    if not fitting:
        raise ConfigError(f"print-marks: {label} needs {need[0]:.0f} x {need[1]:.0f} mm; the largest sheet is A0, 841 x 1189 mm")
    sheet, size = fitting[0]
    row, column = np.nonzero(black)
    left, top = (size[0] - wide) / 2, FOOT + (size[1] - FOOT - MARGIN + high) / 2
    return Page(sheet, size, np.c_[left + side * column, top - side * (row + 1)], side, label)


def pdf(pages: list[Page]) -> bytes:
    """The pages as a PDF at true scale. Raises MissingExtra: matplotlib is not installed."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    out = io.BytesIO()
    with PdfPages(out, metadata={"CreationDate": None, "Title": "fishmj marks"}) as file:
        for page in pages:
            width, height = page.size
            figure = Figure(figsize=(width * MM, height * MM))
            FigureCanvasPdf(figure)
            axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
            axes.axis("off")
            square = page.side * np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
            corners = (page.cells[:, None] + square).reshape(-1, 2)
            strokes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY] * len(page.cells)
            axes.add_patch(PathPatch(Outline(corners, strokes), fc="black", lw=0))  # one outline: no seams between cells
            left = (width - RULE) / 2
            axes.plot([left, left + RULE], [15, 15], color="black", lw=0.5)
            for x in np.arange(0, RULE + 1, 10):
                axes.plot([left + x] * 2, [15, 19 if x % 50 == 0 else 17], color="black", lw=0.5)
            text = "print at 100 %, not fitted to the page: this rule is 100 mm"
            axes.text(width / 2, 8, f"{page.label}\n{text}", ha="center", va="center", fontsize=8)
            file.savefig(figure)
    return out.getvalue()


def options() -> console.Parser:
    """The arguments."""
    made = console.parser("deploy print-marks", "Tag and calibration board as a PDF at true scale.", examples=EXAMPLES)
    tag_options(made)
    add = made.add_argument
    add("--board", type=board_size, default=(9, 6), metavar="COLUMNSxROWS", help="inner corners of the chessboard (default 9x6)")
    add("--square", type=console.number(0.001, 1), default=0.025, help="side of a square, m")
    add("--out", type=console.out_file, required=True, metavar="FILE", help="PDF to write")
    return made


def main(argv: list[str]) -> int:
    """The command. Raises UnknownName, MissingExtra; ConfigError: an impossible tag or board, or one that fits on no sheet."""
    args = options().parse_args(argv)
    if args.out.suffix.lower() != ".pdf":
        raise ConfigError(f"--out {args.out}: print-marks writes a PDF; name it FILE.pdf")
    columns, rows = args.board
    pages = [tag_page(args.tag_family, args.tag_number, args.tag_size), board_page(columns, rows, args.square)]
    write_bytes(args.out, pdf(pages))
    console.say(*(f"page {k}: {page.label}, {page.sheet}" for k, page in enumerate(pages, 1)), f"written to {args.out}")
    console.say("print at 100 %, then measure the rule of 100 mm on each page")
    if args.json:
        console.emit_json({"out": args.out, "pages": [{"label": page.label, "sheet": page.sheet} for page in pages]})
    return console.OK
