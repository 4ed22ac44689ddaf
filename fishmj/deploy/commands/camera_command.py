"""`fishmj deploy calibrate-camera`: the camera calibration from pictures of a board and marks of the tank."""

from argparse import ArgumentTypeError
from math import isfinite
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.camera.cameras import cv2
from fishmj.deploy.loop.wiring import numbers
from fishmj.deploy.tracker import Board, Mark, calibrate_intrinsics, homography_from_marks
from fishmj.deploy.tracker.calibration import PAIRS, camera_of

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
ROUGH = 5e-3  # m, rms of the marks beyond which the calibration is worse than a tracker needs
FEWEST = 4  # marks that any homography meets
OFF = 0.2  # of its height, m/m, that a camera may be from where the marks put it
WRONG = 0.5  # of the rms that is left without a mark: then it is that one
EXAMPLES = """marks, four at least and better six, each in the picture and in the tank:
  [[mark]]
  name = "corner"
  pixel = [212.5, 88.0]      # column and row from the picture's upper left, as an image viewer shows them under its pointer
  point = [-1.5, 1.0]        # m, tank frame: on the water's surface, x, y and up right-handed, origin in the middle of the tank

board and marks are photographed at the size at which the fish swims, 1280 x 720: fishmj deploy capture

examples:
  fishmj deploy calibrate-camera --pictures board --board 9x6 --square 0.025 --marks marks.toml --out tank.toml
  fishmj deploy calibrate-camera --pictures board --board 8x11 --square 0.03 --marker 0.022 --marks marks.toml --out tank.toml"""


def options() -> console.Parser:
    """The arguments."""
    summary = "Pixels to metres: the lens from pictures of a board, the tank from its marks."
    made = console.parser("deploy calibrate-camera", summary, examples=EXAMPLES)
    add = made.add_argument
    add("--pictures", type=console.path, required=True, metavar="FOLDER", help="pictures of the board, at least 5, tilted")
    add("--board", type=board_size, required=True, metavar="COLUMNSxROWS", help="inner corners; of a ChArUco board its squares")
    add("--square", type=console.number(0.001, 1), required=True, help="side of a square, m")
    add("--marker", type=console.number(0, 1), default=0.0, help="side of a marker, m: a ChArUco board (DICT_5X5_100)")
    add("--marks", type=console.path, required=True, metavar="FILE", help="TOML of marks of the tank, four at least")
    add("--camera", type=numbers, metavar="X,Y,HEIGHT", help="where a ruler says that the camera is, m (default: as fitted)")
    add("--lag", type=console.number(0, 5), default=0.0, help="s from the middle of an exposure to the stamp of its frame")
    add("--out", type=console.out_file, required=True, metavar="FILE", help="TOML of the calibration")
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: the marks fit to 5 mm; 1: they do not, but the file is written."""
    args = options().parse_args(argv)
    columns, rows = args.board
    lens = calibrate_intrinsics(pictures(args.pictures), Board(columns, rows, args.square, args.marker))
    if args.camera is not None and len(args.camera) != 3:
        raise ConfigError(f"--camera: {len(args.camera)} numbers; expected X,Y,HEIGHT")
    named = marks(args.marks)
    fit = homography_from_marks(
        named, lens.size, lens.matrix, lens.distortion, camera=args.camera, lag=args.lag, notes=f"marks {args.marks}"
    )
    fit.calibration.write(args.out)
    x, y, high = fit.calibration.camera
    worst, k = float(fit.residual.max()), int(fit.residual.argmax())
    if fit.without is not None and fit.rms > ROUGH and fit.without.min() < WRONG * fit.rms:
        k = int(fit.without.argmin())
        console.warn(f"mark {named[k].name}: without it the rms is {1e3 * fit.without[k]:.1f} mm")
    if len(named) == FEWEST:
        console.warn(f"{FEWEST} marks always fit: a wrong one shows with five or more, and is named with six")
    if args.camera is not None:
        off = np.abs(camera_of(fit.calibration.homography, lens.matrix) - args.camera).max()
        if off > OFF * high:
            console.warn(f"--camera lies {off:.2f} m from where the marks put the camera; measure again which of them is right")
    console.say(
        f"lens: {len(lens.used)} pictures, rms {lens.rms:.2f} px, focal length {lens.matrix[0, 0]:.1f} px"
        f" +- {lens.focal_sigma:.1f}",
        f"tank: {len(fit.residual)} marks, rms {1e3 * fit.rms:.1f} mm, worst {1e3 * worst:.1f} mm",
        f"camera {high:.2f} m over the water at ({x:.2f}, {y:.2f}) m; {1e3 * fit.calibration.metres_per_pixel():.2f} mm/px",
        f"written to {args.out}",
    )
    if args.json:
        result = {"pictures": len(lens.used), "lens_rms_px": lens.rms, "marks_rms_m": fit.rms, "worst_m": worst}
        console.emit_json({**result, "camera": fit.calibration.camera, "out": args.out})
    if fit.rms <= ROUGH:
        return console.OK
    console.warn(
        f"the marks fit to {1e3 * fit.rms:.1f} mm rms, a tracker needs {1e3 * ROUGH:g} mm: measure mark"
        f" {named[k].name} and its pixel again; {args.out} is written all the same"
    )
    return console.FAILED_CHECK


def pictures(folder: Path) -> list:
    """Every picture of a folder as (H, W, 3) uint8, by name.

    Raises StoreError: no such folder, no picture in it, or one that does not read.
    """
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)
    if not files:
        raise StoreError(f"{folder}: no picture there; expected {', '.join(SUFFIXES)}")
    opencv, found = cv2(), []
    for file in files:
        image = opencv.imread(str(file))
        if image is None:
            raise StoreError(f"{file}: OpenCV does not read it as a picture; take it out or save it as PNG")
        found.append(image)
    return found


def marks(path: Path) -> list[Mark]:
    """The marks of a TOML file. Raises ConfigError: no such file, or an entry that is no mark."""
    table, found = read_toml(path), []
    rows = table.get("mark", [])
    if set(table) - {"mark"} or not isinstance(rows, list):
        raise ConfigError(f"{path}: got {', '.join(sorted(table))[:80]}, expected blocks [[mark]] and nothing else")
    for k, row in enumerate(rows):
        try:
            pixel, point = (tuple(float(value) for value in row[name]) for name in PAIRS)
            known = len(pixel) == len(point) == 2 and all(map(isfinite, (*pixel, *point))) and not set(row) - {"name", *PAIRS}
        except (KeyError, TypeError, ValueError):
            known = False
        if not known:
            expected = "expected pixel = [u, v] and point = [x, y], finite numbers, and perhaps name"
            raise ConfigError(f"{path}: [[mark]] {k + 1}: {expected}; got {str(row)[:120]}")
        (u, v), (x, y) = pixel, point
        found.append(Mark(str(row.get("name", k + 1))[:40], (u, v), (x, y)))
    return found


def board_size(text: str) -> tuple[int, int]:
    """Parses the inner corners of a board, such as `9x6`. Raises ArgumentTypeError."""
    columns, cross, rows = text.partition("x")
    if not cross:
        raise ArgumentTypeError(f"got {text[:40]!r}, expected COLUMNSxROWS such as 9x6")
    return console.whole(3, 100)(columns), console.whole(3, 100)(rows)
