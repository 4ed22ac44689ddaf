"""Cost of `gap find` on robots in MJCF, over that on the shipped fish, in one run.

    python -m studies.robot_cost --out runs/robot_cost

Ten logs of ten seconds of a drawn arm of two joints and of one of six, dry friction hidden at a joint, and the twelve swims of
the tutorial (`gap plant coulomb_friction=0.1`), all *synthetic*. Each search is a process of its own. The first round compiles;
in the second another number of null runs keeps the fish from the runs of the first. CPU seconds are those of the second.
"""

import argparse
import resource
import subprocess
import sys
from pathlib import Path

from fishmj.base import console
from fishmj.gap.bench import robot_cases

LOGS, SECONDS = 10, 10.0
ARMS = {"two joints": "two_link", "six joints": "arm"}


def cpu_seconds(words: list[str]) -> float:
    """CPU seconds of a command of fishmj, all its threads. Raises CalledProcessError."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "fishmj", *words], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(argv: list[str]) -> int:
    """Prints a row for each robot. Returns the exit code."""
    parser = console.parser("robot_cost", __doc__ or "")
    parser.add_argument("--out", type=console.out_folder, required=True, metavar="DIR", help="folder of the logs and reports")
    parser.add_argument("--seed", type=console.whole(0), default=1, help="of the arms")
    args = parser.parse_args(argv)
    asked = finds(args)
    spent: dict[str, float] = {}
    for runs in (95, 96):
        for name, words in asked.items():
            spent[name] = cpu_seconds([*words, "--null-runs", str(runs), "--out", str(args.out / f"{name} {runs}")])
    fish = spent["fish"]
    rows = [{"robot": name, "cpu_s": round(s, 1), "times_the_fish": round(s / fish, 2)} for name, s in spent.items()]
    console.say(console.table(rows))
    if args.json:
        console.emit_json({"rows": rows})
    return console.OK


def finds(args: argparse.Namespace) -> dict[str, list[str]]:
    """Writes the logs; returns the words of each search."""
    robot_cases.LOGS, robot_cases.SECONDS = LOGS, SECONDS
    swims = args.out / "swims"
    cpu_seconds(["gap", "plant", "coulomb_friction=0.1", "--out", str(swims), "--truth", str(args.out / "truth.json")])
    out = {"fish": ["gap", "find", str(swims)]}
    for name, family in ARMS.items():
        case = robot_cases.RobotCase(family, "single", "mujoco", family, ("coulomb_friction",), args.seed)
        robot_cases.make_set(args.out, case)
        place: Path = args.out / family
        out[name] = ["gap", "find", str(place / "logs"), "--model", str(place / "robot.xml"), "--yes"]
    return out


if __name__ == "__main__":
    raise SystemExit(console.run(main))
