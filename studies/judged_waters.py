"""Judgement of controllers in every water and with every robot of the pages: `python -m studies.judged_waters`.

    python -m studies.judged_waters                            `station-family`: each condition, 24 trials
    python -m studies.judged_waters --shard 0/2                every second condition, on the first of two GPUs
    python -m studies.judged_waters runs/new/best.safetensors  a policy in place of `station-family`
    python -m studies.judged_waters dob pd --only reference    other controllers, in one condition
    python -m studies.judged_waters --list                     names, commands and seconds of one H200
    python -m studies.judged_waters --write                    what is done, as rows in place of the same trials

A condition is one `fishmj evaluate CONTROLLER --water lbm ..`; its rows go from runs/judged_waters to studies/*/rows. *synthetic*
"""

import argparse
import csv
import re
import shlex
from pathlib import Path
from typing import NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.evaluate.__main__ import main as evaluate

HERE = Path(__file__).resolve().parent
FISH = HERE.parent / "data" / "calib" / "fish.toml"
OUT = Path("runs") / "judged_waters"
NAME = "station-family"
TRIALS = ("--water", "lbm", "--tanks", "24", "--device", "cuda")
OTHERS, REFERENCE, PLAIN, STILL = (
    HERE / folder / "rows" / f"{name}.csv"
    for folder, name in (
        ("training", "judged_station_family"),
        ("solver", "judged_reference"),
        ("solver", "judged_trials"),
        ("training", "still_at_target"),
    )
)


class Condition(NamedTuple):
    """One judgement: its water in the rows, options of `fishmj evaluate`, seconds of one H200, changes of fish.toml, tables."""

    water: str
    options: str
    seconds: int
    changes: tuple[tuple[str, str], ...] = ()
    tables: tuple[Path, ...] = (OTHERS,)
    seed: int = 9
    repeats: int = 1


def mass(kg: float) -> tuple[tuple[str, str], ...]:
    """Change of fish.toml: so much mass more (kg), spread over the body."""
    return ((r"\Z", f'\n[[effect]]\nname = "body_mass"\nparameters = {{ mass = {kg} }}\n'),)


SHORTER = (  # the tail's length, and what is measured from its front
    (r'(name = "tail"\nlength = )0\.18', r"\g<1>0.162"),
    (r"com = \[0\.07193,", "com = [0.064737,"),
    (r"fin_from = 0\.054", "fin_from = 0.0486"),
    (
        r"\[0\.054, (.*)\], \[0\.060, (.*)\], \[0\.096, (.*)\], \[0\.148, (.*)\], \[0\.18, 0\.120, 0\.001\]",
        r"[0.0486, \1], [0.054, \2], [0.0864, \3], [0.1332, \4], [0.162, 0.120, 0.001]",
    ),
)
REST = "--speeds 0,0.02,0.04"
CONDITIONS = {
    "reference": Condition("reference-2", "--reference", 104, tables=(REFERENCE,)),
    "rest": Condition("reference-2, 0 to 0.04 m/s", f"--reference {REST}", 124),
    "slip-1": Condition("paper slip 1", "--slip 1", 61, tables=(OTHERS, PLAIN)),
    "slip-1-rest": Condition("paper slip 1, 0 to 0.04 m/s", f"--slip 1 {REST}", 65),
    "slip-0.97": Condition("paper slip 0.97", "--slip 0.97", 61),
    "slip-0.97-10": Condition("paper slip 0.97", "--slip 0.97", 61, seed=10),
    "cells-1.5": Condition("paper 1.5 cm slip 0.985", "--dx 0.015 --slip 0.985", 162),
    "window-0.995": Condition("window slip 0.995", "--domain window --slip 0.995", 100),
    "window-0.985": Condition("window slip 0.985", "--domain window --slip 0.985", 100),
    "late": Condition(
        "reference-2, commands 85 ms later", "--reference", 110, ((r"command_latency = 0\.060", "command_latency = 0.145"),)
    ),
    "gusts": Condition("reference-2, gusts of 25 %", "--reference --turbulence gust --intensity 0.25", 110),
    "turbulence": Condition("reference-2, turbulence of 25 %", "--reference --intensity 0.25", 110),
    "heavy": Condition("reference-2, mass 20 % more", "--reference", 105, mass(0.22)),
    "light": Condition("reference-2, mass 20 % less", "--reference", 105, mass(-0.22)),
    "weak": Condition("reference-2, servo gains 20 % less", "--reference", 105, ((r"\nkp = 8\.0", "\nkp = 6.4"),)),
    "tail": Condition("reference-2, tail 10 % shorter", "--reference", 105, SHORTER),
    "fast": Condition("reference-2, 0.35 and 0.4 m/s", "--reference --speeds 0.35,0.4", 90),
    "reference-10": Condition("reference-2", "--reference", 104, seed=10),
    "reference-11": Condition("reference-2", "--reference", 104, seed=11),
    "at-target": Condition(
        "reference-2", "--reference --task angle_of_attack --speeds 0", 60, tables=(STILL,), repeats=2
    ),
    "reference-3": Condition("reference-3", "--reference reference-3", 111, tables=(REFERENCE,)),
    "low-reynolds": Condition("low-reynolds", "--reference low-reynolds", 600, tables=(REFERENCE,)),
}  # fmt: skip


def robot_of(name: str) -> list[str]:
    """Options that name the robot of a condition, whose file is written.

    Raises:
        ConfigError: fish.toml no longer has what the condition changes.
    """
    if not CONDITIONS[name].changes:
        return []
    text = FISH.read_text(encoding="utf-8")
    for pattern, new in CONDITIONS[name].changes:
        text, count = re.subn(pattern, new, text)
        if count != 1:
            raise ConfigError(f"{FISH.name}: {pattern!r} found {count} times, expected once; adapt condition {name!r}")
    return ["--robot", str(write_text(OUT / f"{name}.toml", text))]


def label(controller: str) -> str:
    """Name of a controller in the rows: a policy's file is that of `NAME` in the making."""
    return NAME if "/" in controller or controller.endswith(".safetensors") else controller


def options_of(name: str) -> list[str]:
    """Options of `fishmj evaluate` for the water of a condition, without its robot."""
    return [*TRIALS, "--seed", str(CONDITIONS[name].seed), *shlex.split(CONDITIONS[name].options)]


def command(controller: str, name: str) -> list[str]:
    """Arguments of `fishmj evaluate` for a condition."""
    options = [*options_of(name), "--repeats", str(CONDITIONS[name].repeats), *robot_of(name)]
    return [controller, *options, "--out", str(OUT / label(controller) / name)]


def stored_rows(name: str) -> list[dict[str, str]]:
    """Trials of `NAME` in a condition, from its table."""
    made = CONDITIONS[name]
    with made.tables[0].open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["controller"] == NAME]
    return [row for row in rows if (row["water"], row["seed"]) == (made.water, str(made.seed))]


def is_done(controller: str, name: str) -> bool:
    """Returns True where all trials of a controller in a condition are judged."""
    return (OUT / label(controller) / name / "results.json").exists()


def rows_of(controller: str, name: str) -> list[dict[str, str]]:
    """Trials of a controller in a condition as rows of the tables."""
    with (OUT / controller / name / "trials.csv").open(encoding="utf-8") as file:
        return [row | {"water": CONDITIONS[name].water, "controller": controller} for row in csv.DictReader(file)]


def write() -> list[str]:
    """Replaces the rows of what is done, by controller, water and seed; returns the conditions that `NAME` has not done."""
    done = [(folder.name, name) for folder in sorted(OUT.glob("*/")) for name in CONDITIONS if is_done(folder.name, name)]
    for table in (OTHERS, REFERENCE, PLAIN, STILL):
        lines = table.read_text(encoding="utf-8").splitlines()
        keys = lines[0].split(",")
        which = lambda row: tuple(row.get(key, "") for key in ("controller", "water", "seed") if key in keys)  # noqa: B023
        new = [row for controller, name in done if table in CONDITIONS[name].tables for row in rows_of(controller, name)]
        again = {which(row) for row in new}
        kept = [line for line in lines[1:] if which(dict(zip(keys, next(csv.reader([line])), strict=True))) not in again]
        text = lambda value: f'"{value}"' if "," in value else value
        made = [",".join(text(row[key]) for key in keys) for row in new]
        write_text(table, "\n".join([lines[0], *kept, *made]) + "\n")
        console.say(f"{table.relative_to(HERE.parent)}: {len(made)} rows")
    return [name for name in CONDITIONS if (NAME, name) not in done]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("controllers", nargs="*", metavar="CONTROLLER", help=f"names, or files of policies (default: {NAME})")
    add("--only", nargs="+", choices=CONDITIONS, metavar="NAME", help="these conditions (default: all)")
    add("--shard", default="0/1", metavar="K/N", help="every Nth condition, beginning with number K (default: 0/1)")
    add("--list", action="store_true", help="print conditions and commands, and judge none (default: judge)")
    add("--write", action="store_true", help="write rows of what is done, and judge none (default: judge)")
    given = parser.parse_args(argv)
    k, n = (int(number) for number in given.shard.split("/"))
    mine = [(one, name) for one in given.controllers or [NAME] for name in given.only or CONDITIONS][k::n]
    if given.list:
        rows = [{"name": x, "seconds": CONDITIONS[x].seconds, "command": shlex.join(command(one, x))} for one, x in mine]
        console.say(console.table(rows))
        return console.OK
    if given.write:
        missing = write()
        console.say(f"{NAME} is not judged in: {' '.join(missing)}" if missing else f"{NAME} is judged in all")
        return console.OK
    for one, name in mine:
        if not is_done(one, name) and (code := evaluate(command(one, name))):
            return code
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
