"""Bad logs as labs really have them; `hostile_logs.py` has the files that an attacker would make.

Written by someone who knew the README, the docs and the commands of fishmj, and had never seen its code or its tests: what is
expected here is what the documentation promises and what a user would want, not what the code happens to do.

BAD: id -> (make, argv, expectation). `make(folder)` writes the files into an empty folder; `argv` is the command to run there,
without `fishmj`, with paths relative to the folder. Expectations:

    refused   exit 2 or 3, one line that says where, got, expected and the fix, and nothing written
    noted     exit 0 or 1, and what was odd is said (one bad file of three is left out, a bad trial is one line of `log check`)

Of every case: no traceback, no hang, less than 2 GB of memory, no source changed, nothing written outside --out.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

ROWS = 200
T = np.arange(ROWS) * 0.02  # s
ANGLES = np.array([30.0 * np.sin(2 * np.pi * T - np.pi / 3 * joint) for joint in range(3)]).T  # deg, of three servos
X = 1.2 + 0.08 * T + 0.003 * np.sin(6 * T)  # m
Y = 0.6 + 0.004 * np.cos(6 * T)
YAW = 0.1 * np.sin(2 * np.pi * T)  # rad

Make = Callable[[Path], None]


def lines(path: Path, header: str, columns) -> None:
    """A text table: `columns` are arrays, or lists of cells that are text already."""
    cells = [[cell if isinstance(cell, str) else f"{cell:.6g}" for cell in column] for column in columns]
    rows = [",".join(row) for row in zip(*cells, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


def servos(path: Path, scale: float = 1e3) -> None:
    """A good log of commands; `scale` is the unit of its stamps, 1000 for what the heading says."""
    lines(path, "time_ms,servo1_deg,servo2_deg,servo3_deg", [T * scale, *ANGLES.T])


def trial(folder: Path, meta: str = "", **tables: tuple) -> None:
    """A trial folder of fishmj.log/1: `cmd=("t,c1,c2,c3", columns)`."""
    folder.mkdir(parents=True, exist_ok=True)
    start = 'schema = "fishmj.log/1"\norigin = "measured"\nmedium = "water"\n'
    (folder / "meta.toml").write_text(start + (meta or 'robot = "swift"\njoints = 3\n'), encoding="utf-8")
    for name, (header, columns) in tables.items():
        lines(folder / f"{name}.csv", header, columns)


def good_tables() -> dict:
    """cmd and pose of a short swim, SI units."""
    return {"cmd": ("t,c1,c2,c3", [T, *np.radians(ANGLES).T]), "pose": ("t,x,y,yaw", [T, X, Y, YAW])}


def edit(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    """The lines of a text file, changed."""
    path.write_text("\n".join(change(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")


IMPORT = ["log", "import", "run.csv", "--out", "data", "--yes"]
LAB = ["log", "import", "lab", "--out", "data", "--yes"]
NPZ = ["log", "import", "run.npz", "--out", "data", "--yes"]
CHECK = ["log", "check", "trial"]

# ---------------------------------------------------------------------------------------------------------------- bad logs


def twin_column(folder: Path) -> None:
    """Somebody dragged a column in the spreadsheet: servo2 is there twice, with different numbers."""
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo2_deg,servo3_deg", [T * 1e3, *ANGLES.T, ANGLES[:, 0]])


def ten_of_one_name(folder: Path) -> None:
    """A logger that calls every channel `value`."""
    lines(folder / "run.csv", "time_ms," + ",".join(["value"] * 10), [T * 1e3] + [ANGLES[:, k % 3] for k in range(10)])


def unit_in_cells(folder: Path) -> None:
    """Centimetres and metres written into the cells of one column."""
    x = [f"{100 * v:.1f} cm" if k % 2 else f"{v:.3f} m" for k, v in enumerate(X)]
    lines(folder / "run.csv", "t,x,y,yaw", [T, x, Y, YAW])


def metres_then_centimetres(folder: Path) -> None:
    """The camera program was updated in the middle of the session: x and y go from m to cm, 130 m within 20 ms."""
    scale = np.where(T < 2, 1.0, 100.0)
    lines(folder / "run.csv", "t,x [m],y [m],yaw [rad]", [T, scale * X, scale * Y, YAW])


def degrees_then_radians(folder: Path) -> None:
    """The same of the servos' driver: 30 deg before, 0.5 rad after."""
    columns = [np.where(T < 2, angle, np.radians(angle)) for angle in ANGLES.T]
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo3_deg", [T * 1e3, *columns])


def degrees_and_radians(folder: Path) -> None:
    """One servo's driver answers in degrees, those of the other two in radians; no unit is named."""
    lines(folder / "run.csv", "time_ms,servo1,servo2,servo3", [T * 1e3, ANGLES[:, 0], *np.radians(ANGLES[:, 1:]).T])


def clock_jumps_ahead(folder: Path) -> None:
    """The network's time arrived in the middle of the log: an hour is missing."""
    lines(folder / "run.csv", "t,c1,c2,c3", [T + 3600.0 * (T >= 2), *np.radians(ANGLES).T])


def jumped(folder: Path, seconds: float) -> None:
    """A trial folder whose clock jumps ahead in the middle."""
    t = [f"{v:.2f}" for v in T + seconds * (T >= 2)]
    angles = np.radians(ANGLES).T
    trial(
        folder / "trial", cmd=("t,c1,c2,c3", [t, *angles]), joint=("t,j1,j2,j3", [t, *angles]), pose=("t,x,y,yaw", [t, X, Y, YAW])
    )


def next_day(folder: Path) -> None:
    """The logger slept over night and went on in the same file: a pause of a day."""
    jumped(folder, 86400.0)


def clock_of_1970(folder: Path) -> None:
    """A computer without a battery for its clock: 1970 until the network told the time."""
    jumped(folder, 1.76e9)


def clock_set_back(folder: Path) -> None:
    """The same, but the clock was 1.7 s fast: time goes back once, in the middle, and 85 rows overlap."""
    lines(folder / "run.csv", "t,c1,c2,c3", [T - 1.7 * (T >= 2), *np.radians(ANGLES).T])


def newest_first(folder: Path) -> None:
    """An export from a data base, sorted the wrong way round."""
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo3_deg", [T[::-1] * 1e3, *ANGLES[::-1].T])


def named_ms_holds_s(folder: Path) -> None:
    """The heading says ms, the numbers are s."""
    servos(folder / "run.csv", scale=1.0)


def end_of_summer_time(folder: Path) -> None:
    """ISO stamps with their zone, over the end of summer time: 02:59:59.98+02:00, then 02:00:00+01:00. Nothing jumps in truth."""
    stamps = [f"2025-10-26T02:59:{58 + s:06.3f}+02:00" if s < 2 else f"2025-10-26T02:00:{s - 2:06.3f}+01:00" for s in T]
    lines(folder / "run.csv", "stamp,servo1_deg,servo2_deg,servo3_deg", [stamps, *ANGLES.T])


def date_and_time_apart(folder: Path) -> None:
    """A German logger: date and time of day in two columns, day first."""
    clock = [f"14:03:{s:06.3f}" for s in T]
    lines(folder / "run.csv", "Datum,Uhrzeit,servo1_deg,servo2_deg,servo3_deg", [["03.11.2025"] * ROWS, clock, *ANGLES.T])


def every_row_twice(folder: Path) -> None:
    """A logger that writes each packet on sending and on its acknowledgement, with the same stamp."""
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo3_deg", [np.repeat(T, 2) * 1e3, *np.repeat(ANGLES, 2, 0).T])


def merged_header(folder: Path) -> None:
    """Merged cells: one heading over three columns."""
    lines(folder / "run.csv", "time_ms,servo angles [deg]", [T * 1e3, *ANGLES.T])


def two_headers(folder: Path) -> None:
    """Two sessions in one file (`cat *.csv`): header and time begin anew in the middle."""
    servos(folder / "run.csv")
    edit(folder / "run.csv", lambda rows: rows + rows)


def titles_above(folder: Path) -> None:
    """A spreadsheet's export: four rows of titles, then the header."""
    servos(folder / "run.csv")
    titles = ["Tank 2 - Monday,,,", "Operator:,J. Doe,,", "Fish no.,3,,", ",,,"]
    edit(folder / "run.csv", lambda rows: titles + rows)


def decimal_comma_and_comma(folder: Path) -> None:
    """Decimal commas in a file whose columns are separated by commas: 0,02,12,53."""
    comma = [[f"{v:.2f}".replace(".", ",") for v in column] for column in (T, *np.radians(ANGLES).T)]
    lines(folder / "run.csv", "t,c1,c2,c3", comma)


def mark_and_semicolons(folder: Path) -> None:
    """A trial folder whose table went through a spreadsheet: byte order mark, semicolons, decimal commas."""
    trial(folder / "trial", **good_tables())
    text = (folder / "trial" / "cmd.csv").read_text(encoding="utf-8").replace(",", ";").replace(".", ",")
    (folder / "trial" / "cmd.csv").write_text(text, encoding="utf-8-sig")


def messages_in_the_middle(folder: Path) -> None:
    """The driver's warnings went into the same file: one row in 40."""
    servos(folder / "run.csv")
    edit(folder / "run.csv", lambda rows: [row + "\nWARN bus, retry, 2" * (k % 40 == 39) for k, row in enumerate(rows)])


def cut_off(folder: Path) -> None:
    """The battery was pulled: the last row is half, and the block of the card behind it was never written."""
    servos(folder / "run.csv")
    with (folder / "run.csv").open("ab") as file:
        file.write(b"4000,12.5,-" + b"\0" * 700)


def not_available(folder: Path) -> None:
    """A spreadsheet's errors among the numbers: #N/A, #DIV/0!, ---."""
    words = ["#N/A", "#DIV/0!", "---", "NaN", "null"]
    angle = [words[k // 9 % 5] if k % 9 == 4 else f"{v:.3f}" for k, v in enumerate(ANGLES[:, 1])]
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo3_deg", [T * 1e3, ANGLES[:, 0], angle, ANGLES[:, 2]])


def dead_servo(folder: Path) -> None:
    """The third encoder was unplugged: its column is nan in every row. A robot of two joints is not what swam."""
    lines(folder / "run.csv", "t,j1,j2,j3", [T, *np.radians(ANGLES[:, :2]).T, ["nan"] * ROWS])


def missing_joint(folder: Path) -> None:
    """A trial folder without its second joint."""
    tables = {**good_tables(), "joint": ("t,j1,j3", [T, *np.radians(ANGLES[:, ::2]).T])}
    trial(folder / "trial", **tables)


def joints_as_text(folder: Path) -> None:
    """Angles with the degree sign in the cell, and the side as a word: 12.5° left."""
    text = [[f'"{abs(v):.1f}° {"left" if v > 0 else "right"}"' for v in column] for column in ANGLES.T]
    lines(folder / "run.csv", "time_ms,servo1,servo2,servo3", [T * 1e3, *text])


def nothing_moves(folder: Path) -> None:
    """The robot was off: every channel is the same number in every row."""
    still = [np.full(ROWS, v) for v in (0.0, 0.0, 0.0, 1.2, 0.6, 0.1)]
    lines(folder / "run.csv", "t,c1,c2,c3,x,y,yaw", [T, *still])


def one_row(folder: Path) -> None:
    """The logger stopped after its first row, which has no rate and moves nothing."""
    lines(folder / "run.csv", "time_ms,servo1_deg,servo2_deg,servo3_deg", [[v] for v in (20.0, 1.0, 2.0, 3.0)])


def one_of_three(folder: Path) -> None:
    """Three swims, one of which is somebody's picture with a wrong ending."""
    servos(folder / "lab" / "swim1.csv")
    servos(folder / "lab" / "swim2.csv")
    (folder / "lab" / "swim3.csv").write_bytes(b"\xff\xd8\xff\xe0\x00\x10JFIF\x00" + bytes(range(256)) * 20)


def weighed_in_grams(folder: Path) -> None:
    """A page of weighings in grams."""
    (folder / "weigh").mkdir()
    page = "[scales]\nhead = [765, 766, 765]\nbody1 = [168]\nbody2 = [102]\ntail = [86]\n"
    page += "[balance]\nat = [0.1838, 0.1851, 0.1849]\nerror = 0.001\n"
    page += "[pendulum]\nthread = 1.2\napart = 0.3\nperiod = [1.7005, 1.7049, 1.7071]\n"
    (folder / "weigh" / "measurements.toml").write_text(page, encoding="utf-8")


def unequal_arrays(folder: Path) -> None:
    """Columns of an .npz that are not equally long: the camera's beside the servos'."""
    angles = np.radians(ANGLES)
    np.savez(folder / "run.npz", t=T, c1=angles[:, 0], c2=angles[:-7, 1], c3=angles[:, 2])


MASS = ["calibrate", "mass", "--data", "weigh"]

BAD: dict[str, tuple[Make, list[str], str]] = {
    "twin_column": (twin_column, IMPORT, "refused"),
    "ten_of_one_name": (ten_of_one_name, IMPORT, "refused"),
    "unit_in_cells": (unit_in_cells, IMPORT, "refused"),
    "metres_then_centimetres": (metres_then_centimetres, IMPORT, "refused"),
    "degrees_then_radians": (degrees_then_radians, IMPORT, "refused"),
    "degrees_and_radians": (degrees_and_radians, IMPORT, "refused"),
    "clock_jumps_ahead": (clock_jumps_ahead, IMPORT, "noted"),
    "next_day": (next_day, CHECK, "noted"),
    "clock_of_1970": (clock_of_1970, CHECK, "noted"),
    "clock_set_back": (clock_set_back, IMPORT, "refused"),
    "newest_first": (newest_first, IMPORT, "refused"),
    "named_ms_holds_s": (named_ms_holds_s, IMPORT, "refused"),
    "end_of_summer_time": (end_of_summer_time, IMPORT, "noted"),
    "date_and_time_apart": (date_and_time_apart, IMPORT, "noted"),
    "every_row_twice": (every_row_twice, IMPORT, "noted"),
    "merged_header": (merged_header, IMPORT, "refused"),
    "two_headers": (two_headers, IMPORT, "refused"),
    "titles_above": (titles_above, IMPORT, "noted"),
    "decimal_comma_and_comma": (decimal_comma_and_comma, IMPORT, "refused"),
    "mark_and_semicolons": (mark_and_semicolons, CHECK, "noted"),
    "messages_in_the_middle": (messages_in_the_middle, IMPORT, "refused"),
    "cut_off": (cut_off, IMPORT, "refused"),
    "not_available": (not_available, IMPORT, "noted"),
    "dead_servo": (dead_servo, IMPORT, "refused"),
    "missing_joint": (missing_joint, CHECK, "noted"),
    "joints_as_text": (joints_as_text, IMPORT, "refused"),
    "nothing_moves": (nothing_moves, IMPORT, "noted"),
    "one_row": (one_row, IMPORT, "refused"),
    "one_of_three": (one_of_three, [*LAB, "--skip-bad"], "noted"),
    "weighed_in_grams": (weighed_in_grams, [*MASS, "--out", "fish.toml", "--report", "page"], "refused"),
    "unequal_arrays": (unequal_arrays, NPZ, "refused"),
}
