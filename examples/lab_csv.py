"""From three CSV files of a lab's own naming to a report page: one import, one search.

    python examples/lab_csv.py --out runs/lab

The three recordings are *synthetic*: swims of the second, independently written robot, with dry friction of 0.12 N m in
its joints that the model does not have, written as a lab's logger would: milliseconds, degrees, millimetres, names of its own.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from fishmj.gap.__main__ import main as gap
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.log.__main__ import main as log

SWIMS = {"Run A": "gait", "Run B": "chirp", "Run C": "steps"}
FRICTION = 0.12  # N m
NAMES = {"cmd": {f"c{i}": (f"servo{i}_goal_deg", 180 / np.pi) for i in (1, 2, 3)}}
NAMES |= {"joint": {f"j{i}": (f"servo{i}_present_deg", 180 / np.pi) for i in (1, 2, 3)}}
NAMES |= {"pose": {"x": ("cam_x_mm", 1e3), "y": ("cam_y_mm", 1e3), "yaw": ("cam_heading_deg", 180 / np.pi)}}
NAMES |= {"power": {"V": ("battery_V", 1.0), "I": ("battery_mA", 1e3)}}


def lab_csv(path: Path, tables: dict) -> Path:
    """All tables of a trial in one file: a row an event, in order of time."""
    columns = [name for table in NAMES.values() for name, _ in table.values()]
    rows = []
    for table, given in NAMES.items():
        for k, t in enumerate(tables[table]["t"]):
            cells = {name: f"{tables[table][column][k] * factor:.4f}" for column, (name, factor) in given.items()}
            rows.append((float(t), cells))
    lines = [",".join(["time_ms", *columns])]
    lines += [",".join([f"{1e3 * t:.3f}", *(cells.get(c, "") for c in columns)]) for t, cells in sorted(rows, key=lambda r: r[0])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/lab"), help="folder for everything (default: %(default)s)")
    parser.add_argument("--null-runs", default="96", help="of the search (default: %(default)s)")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True)
    swims = generate({"coulomb_friction": {"torque": FRICTION}}, list(SWIMS.values()), 0)
    files = [str(lab_csv(args.out / f"{name}.csv", t.tables)) for name, t in zip(SWIMS, swims, strict=True)]
    assert log(["import", *files, "--out", str(args.out / "data"), "--robot", "swift", "--medium", "water", "--yes"]) == 0
    assert gap(["find", str(args.out / "data"), "--out", str(args.out / "report"), "--null-runs", args.null_runs]) == 0

    verdict = json.loads((args.out / "report" / "verdict.json").read_text())
    (effect,) = verdict["effects"]
    assert verdict["answer"] == "NAMED" and effect["name"] == "coulomb_friction", verdict
    assert abs(effect["parameters"]["torque"]["value"] / FRICTION - 1) < 0.15
    assert (args.out / "report" / "report.html").is_file()


if __name__ == "__main__":
    main()
