"""The switches that `swim` and `forcemap` share for fields."""

import argparse

from fishmj import console

STRONG = 8.0  # 1/s, ends of the pictures' colour scale: eddies shed at 1 Hz reach it, the swirl beside them does not


def height(text: str) -> float | None:
    """`mid` or a height in m.

    Raises:
        ArgumentTypeError: neither.
    """
    if text == "mid":
        return None
    try:
        return console.number(-10, 10)(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}, or mid: a height in m (0 is mid-depth, up positive)") from error


def add_fields(parser: argparse.ArgumentParser, *, folder: bool = True) -> None:
    """--fields (with a folder or without), --slice, --volume."""
    if folder:
        fields = "vorticity slices (npz, PNG) while it runs, for `fishmj replay`; by default none"
        parser.add_argument("--fields", type=console.out_folder, metavar="FOLDER", help=fields)
    parser.add_argument("--slice", type=height, default=None, metavar="mid|Z", help="height of the slice, m (default: mid-depth)")
    parser.add_argument("--volume", action="store_true", help="with --fields: the whole box, too, as VTK files for ParaView")
