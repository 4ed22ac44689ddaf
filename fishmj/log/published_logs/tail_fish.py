"""Tail-actuated robotic fish of Mamakoukas et al.: `Amp<A>Bias<B>/STATES<k>.txt` with `control<A><B><k>.txt`.

STATES: video time [s], surge, sway [m/s], yaw rate [rad/s], yaw [rad], x, y [m]. control: time on the computer that steers [s],
tail amplitude [deg], tail bias [deg]. The commanded beat is 1 Hz.

The two clocks disagree. The stamps of STATES are a frame count over 30 Hz. The control file has as many rows as the video has
frames, on a real clock, every 62 or 78 ms. Neither is changed here. `clock_ratio` in the meta data is the factor by which the
video's clock runs too fast if one frame was taken a control cycle.

ASTATES files (five columns: the first four of STATES at other scales, and an angle) are not read: their processing is not
documented, and the authors' own scripts read STATES only.

Source: github.com/giorgosmamakoukas/DerivativeBasedKoopman, Koopman_RoboticFish/AllData.zip, MIT.
"""

import re
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.registry import renamed, trial_of
from fishmj.log.published_logs.number_rows import read_rows, without_strays
from fishmj.log.trial import Trial

STATES = ("t", "surge", "sway", "yaw_rate", "yaw", "x", "y")
CONTROL = ("t", "amplitude_deg", "bias_deg")
BEAT_HZ = 1.0  # the authors' scripts: omega = 2 pi rad/s
VIDEO_HZ = 30.0
_FOLDER = re.compile(r"Amp(\d+)Bias(-?\d+)")
_STATES_FILE = re.compile(r"STATES(\d+)\.txt")


def sniff(path: Path) -> bool:
    """Returns True for a STATES file, a folder with some, or a folder of such folders."""
    return bool(_STATES_FILE.fullmatch(path.name)) if path.is_file() else bool(_files(path))


def read(path: Path) -> dict[str, Trial]:
    """Trials by name: `amp15_bias-20_1`. A trial whose control file is absent has no gait table, and a note."""
    files = [path] if path.is_file() else _files(path)
    return dict(_trial(file) for file in files)


def _files(folder: Path) -> list[Path]:
    found = [p for pattern in ("*.txt", "*/*.txt", "*/*/*.txt") for p in folder.glob(pattern) if _STATES_FILE.fullmatch(p.name)]
    return sorted(found)


def _trial(path: Path) -> tuple[str, Trial]:
    condition = _FOLDER.fullmatch(path.resolve().parent.name)
    number = _STATES_FILE.fullmatch(path.name)
    if not condition or not number:
        raise LogError(
            f"{path}: expected .../Amp<deg>Bias<deg>/STATES<k>.txt: the folder's name tells the command; keep both names"
        )
    (amplitude, bias), k = condition.groups(), number[1]
    rows, notes = without_strays(read_rows(path, STATES), "t")
    t = rows.column("t")
    pose = {"t": t, **{c: rows.column(c) for c in ("x", "y", "yaw")}}
    velocity = {"t": t, **{c: rows.column(c) for c in ("surge", "sway", "yaw_rate")}}
    ratio = 0.0
    tables = {"pose": (pose, rows.place), "velocity": (velocity, rows.place)}
    control = path.with_name(f"control{amplitude}{bias}{k}.txt")
    if control.is_file():
        table, told = _gait(control, amplitude, bias)
        tables["gait"] = table
        ratio, said = _clocks(t, table[0]["t"])
        notes += [*told, *said]
    else:
        notes.append(f"{control.name}: missing; the gait is known from the folder's name only")
    clock_ratio = {"pose": ratio, "velocity": ratio} if ratio else None
    condition_name = f"amp{amplitude}_bias{bias}"
    meta = {
        "robot": "tail_fish",
        "medium": "water",
        "flow": {"speed": 0.0, "known": True},
        "excitation": condition_name,
        "controller": f"tail beat {BEAT_HZ:g} Hz, amplitude {amplitude} deg, bias {bias} deg, open loop",
        "clock": {"pose": "video, frame / 30 Hz", "velocity": "video, frame / 30 Hz", "gait": "steering computer"},
        "clock_ratio": clock_ratio,
        "licence": "MIT",
        "source": "github.com/giorgosmamakoukas/DerivativeBasedKoopman Koopman_RoboticFish/AllData.zip",
    }
    return f"{condition_name}_{k}", trial_of(f"{condition_name}_{k}", meta, tables, notes)


def _gait(path: Path, amplitude: str, bias: str):
    rows, notes = without_strays(read_rows(path, CONTROL), "t")
    for column, expected in (("amplitude_deg", float(amplitude)), ("bias_deg", float(bias))):
        wrong = np.flatnonzero(rows.column(column) != expected)
        if len(wrong):
            got = rows.column(column)[wrong[0]]
            raise LogError(
                f"{rows.place(int(wrong[0]), column)}: {column} = {got:g}, but the folder says {expected:g}; "
                "put the file into the folder of its own command"
            )
    table = {
        "t": rows.column("t"),
        "amplitude": np.radians(rows.column("amplitude_deg")),
        "bias": np.radians(rows.column("bias_deg")),
        "frequency": np.full(len(rows.values), BEAT_HZ),
    }
    return (table, renamed(rows.place, {"amplitude": "amplitude_deg", "bias": "bias_deg"})), notes


def _clocks(video: np.ndarray, control: np.ndarray) -> tuple[float, list[str]]:
    """Ratio of frames a second to control rows a second, and a note on its meaning; 0 if control has no rate."""
    rate = (len(control) - 1) / (control[-1] - control[0]) if len(control) > 1 else 0.0
    if not rate:
        return 0.0, []
    note = (
        f"clocks: the video counts {VIDEO_HZ:g} frames/s, control has {rate:.2f} rows/s "
        f"({len(control)} rows, {round(video[-1] * VIDEO_HZ)} frames): video time may run {VIDEO_HZ / rate:.2f} times too fast"
    )
    return float(VIDEO_HZ / rate), [note]
