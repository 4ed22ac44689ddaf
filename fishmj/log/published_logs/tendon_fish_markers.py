"""Tendon-driven surface fish of Michelis et al.: nine markers tracked from above, one file a motor frequency.

`markers_f<Hz>.csv`: a row a frame, X0, Y0 .. X8, Y8 in pixels, y down; markers 0 and 1 sit on the rigid head. Pixels become
metres as in the source's script: the head's two markers are 0.142 m apart on the robot. y is turned up, so that angles count
counter-clockwise from above.
`rotatedMarkers_f<Hz>.csv`: a marker a row, nine rows a frame, metres; the script made it from the other file, so it is only
read to check it, or when it is alone (then the heading is gone and there is no pose table).

The files have no stamps: t = frame / 60 Hz, the rate that the script says. The beat in the tracks is 0.75 of the motor
frequency in the name: a gear, or a camera that ran at 80 Hz (then every speed is 4/3 higher).

Source: github.com/srl-ethz/fishsim, Data/Markers, MIT.
"""

import re
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.registry import renamed, trial_of
from fishmj.log.published_logs.number_rows import NumberRows, read_rows
from fishmj.log.trial import Trial, numbered

MARKERS = 9
HEAD = 0.142  # m between markers 0 and 1, measured on the robot (the source's process_tailTracking.py)
FRAME_HZ = 60.0
AGREE = 1e-6  # m between the two files
_FILE = re.compile(r"(rotatedMarkers|markers)_f(\d+)_(\d+)\.csv")
_PIXELS = tuple(f"{axis}{i}" for i in range(MARKERS) for axis in "XY")


def sniff(path: Path) -> bool:
    """Returns True for a marker file, or a folder with some."""
    return bool(_FILE.fullmatch(path.name)) if path.is_file() else any(_FILE.fullmatch(p.name) for p in path.glob("*.csv"))


def read(path: Path) -> dict[str, Trial]:
    """Trials by name: `f1_00`. Both files of a frequency make one trial."""
    files = [path] if path.is_file() else sorted(p for p in path.glob("*.csv") if _FILE.fullmatch(p.name))
    pairs: dict[str, dict[str, Path]] = {}
    for file in files:
        kind, whole, part = _parts(file)
        pairs.setdefault(f"f{whole}_{part}", {})[kind] = file
    return {name: _trial(name, pair) for name, pair in sorted(pairs.items())}


def _parts(path: Path) -> tuple[str, str, str]:
    found = _FILE.fullmatch(path.name)
    if not found:
        raise LogError(
            f"{path}: expected markers_f<Hz>.csv or rotatedMarkers_f<Hz>.csv, such as markers_f1_00.csv; keep its name"
        )
    return found[1], found[2], found[3]


def _trial(name: str, pair: dict[str, Path]) -> Trial:
    whole, part = name[1:].split("_")
    hertz = float(f"{whole}.{part}")
    notes = [
        f"no stamps in the file: t = frame / {FRAME_HZ:g} Hz, the rate that the source's script assumes",
        f"motor frequency {hertz:g} Hz; the tail beats at 0.75 of it in these tracks (a gear, or a faster camera)",
    ]
    if "markers" in pair:
        rows = read_rows(pair["markers"], _PIXELS, separator=",")
        points, pixel = metres(rows)
        tables = {"markers": _markers(points, rows), "pose": _pose(points, rows)}
        notes.append(
            f"{1e3 * pixel:.4f} mm a pixel, from {HEAD} m between the head's markers; pose is marker 0, heading from 1 to 0"
        )
        if "rotatedMarkers" in pair:
            _compare(points, pair["rotatedMarkers"])
            notes.append(f"{pair['rotatedMarkers'].name} says the same")
    else:
        rows, points = _rotated(pair["rotatedMarkers"])
        tables = {"markers": _markers(points * [1.0, -1.0], rows)}
        notes.append("head-aligned markers only: the heading is not in the file, so there is no pose")
    meta = {
        "robot": "tendon_fish",
        "medium": "water",
        "flow": {"speed": 0.0, "known": True},
        "excitation": f"motor {hertz:g} Hz",
        "controller": f"constant motor frequency {hertz:g} Hz",
        "motor": {"frequency": hertz},
        "clock": dict.fromkeys(tables, "frame / 60 Hz"),
        "licence": "MIT",
        "source": "github.com/srl-ethz/fishsim Data/Markers",
    }
    return trial_of(name, meta, tables, notes)


def metres(rows: NumberRows) -> tuple[np.ndarray, float]:
    """(T, 9, 2) marker positions [m], y up, and metres a pixel."""
    pixels = rows.values.reshape(-1, MARKERS, 2)
    apart = np.hypot(*(pixels[:, 1] - pixels[:, 0]).T)
    if np.any(apart < 1.0):
        row = int(np.argmin(apart))
        raise LogError(
            f"{rows.place(row, 'X1')}: markers 0 and 1 coincide; they give the scale. Leave the frame out at an end of the file"
        )
    scale = HEAD / float(apart.mean())
    return pixels * [scale, -scale], scale


def _markers(points: np.ndarray, rows: NumberRows):
    table = {"t": np.arange(len(points)) / FRAME_HZ}
    table |= {**numbered("p#x", points[..., 0]), **numbered("p#y", points[..., 1])}
    names = {f"p{i + 1}{axis}": f"{axis.upper()}{i}" for i in range(MARKERS) for axis in "xy"}
    return table, renamed(rows.place, names)


def _pose(points: np.ndarray, rows: NumberRows):
    forward = points[:, 0] - points[:, 1]
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    table = {"t": np.arange(len(points)) / FRAME_HZ, "x": points[:, 0, 0], "y": points[:, 0, 1], "yaw": yaw}
    return table, renamed(rows.place, {"x": "X0", "y": "Y0", "yaw": "X1"})


def _rotated(path: Path) -> tuple[NumberRows, np.ndarray]:
    rows = read_rows(path, ("X", "Y"), separator=",")
    if len(rows.values) % MARKERS:
        raise LogError(
            f"{rows.place(len(rows.values) - 1, 'X')}: {len(rows.values)} rows are no whole number of frames "
            f"of {MARKERS} markers; is the file cut off?"
        )
    return rows.keep(np.arange(0, len(rows.values), MARKERS)), rows.values.reshape(-1, MARKERS, 2)


def _compare(points: np.ndarray, path: Path) -> None:
    """Checks that the head-aligned file matches the pixels: same frames, same shape about marker 0."""
    rows, rotated = _rotated(path)
    if len(rotated) != len(points):
        raise LogError(f"{path}:1:1: {len(rotated)} frames, but the pixel file has {len(points)}; are they of one recording?")
    shape = (points - points[:, :1]) * [1.0, -1.0]
    axis = shape[:, 1] / np.hypot(*shape[:, 1].T)[:, None]
    along = shape[..., 0] * axis[:, None, 0] + shape[..., 1] * axis[:, None, 1]
    across = shape[..., 1] * axis[:, None, 0] - shape[..., 0] * axis[:, None, 1]
    error = np.abs(np.stack([along, across], -1) - (rotated - rotated[:, :1])).max(axis=(1, 2))
    if error.max() > AGREE:
        row = int(np.argmax(error > AGREE))
        raise LogError(
            f"{rows.place(row, 'X')}: frame {row + 1} differs from the pixel file by {error[row]:.3g} m; "
            f"expected at most {AGREE:g} m. Keep one of the two files"
        )
