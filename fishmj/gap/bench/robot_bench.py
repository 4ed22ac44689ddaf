"""`gap bench --generator robots`: makes data sets of articulated robots, searches them, and scores the answers.

The search is that of `gap find LOGS --model robot.xml`. A log that it refuses, and a fault of the search itself, are answers, too
(REFUSED, FAULT): they name nothing, and are counted. A set in which a hidden effect does not show is not searched.
"""

import argparse
import contextlib
import io
import time
import traceback
from functools import partial
from pathlib import Path

from fishmj.base import console
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.gap.bench import robot_cases, robot_score
from fishmj.gap.bench.bench_rows import agree_to_time, finished_rows, judge_cases, read_rows, refuse_other, rows_of_folders, same
from fishmj.gap.bench.run_case import answered_by, effect_row
from fishmj.gap.bench.score import print_score
from fishmj.gap.commands import find_robot
from fishmj.gap.laboratory.articulated import robot_session
from fishmj.gap.laboratory.articulated.robot_session import SEEN
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.null.null_runs import RUNS
from fishmj.gap.records.robot_logs import guess_columns, log_files, read_robot_logs, read_sheet

ALL = "robots"
GENERATORS = (ALL, *robot_session.NAMES)
CASES, FEW = 520, 24  # by default; of a small benchmark
SETS = "sets"  # folder of data sets, in that of the rows
A_CASE = {1: 60.0, 2: 120.0, 6: 1500.0, 12: 6000.0}  # s of a core for a robot of so many joints
# options of `gap find`; a hidden effect may look like a mistake in the logs
AS_SHIPPED = {"null_runs": RUNS, "noise": 1.0, "seed": 0, "most": None, "anyway": True}


class DataSet:
    """A data set to be judged, by its row."""

    def __init__(self, row: dict):
        self.row, self.id = row, row["id"]


def selected(generators: list[str]) -> tuple[str, ...]:
    """The requested generators of articulated robots; none for others."""
    return tuple(name for name in robot_session.NAMES if ALL in generators or name in generators)


def bench(args, generators: tuple[str, ...]) -> int:
    """Makes missing data sets, judges them, and prints the score. Returns the exit code: 1 below an aim of a whole benchmark."""
    if not args.out:
        raise ConfigError(f"gap bench: --generator {','.join(generators)} needs --out DIR: its data sets are kept there")
    index, shards = args.shard
    count = args.cases or (FEW if args.small else CASES)
    todo = robot_cases.draw_cases(count, args.seed, generators, tuple(args.robots), tuple(args.kinds))[index::shards]
    if not todo:
        raise ConfigError(f"gap bench: no case is left of {count}, every {shards}th from {index}; take more --cases")
    jobs, folder = args.jobs or usable_cores(), args.sets or args.out / SETS
    if args.only_sets:
        todo = [case for case in todo if case.generator in selected(args.only_sets)]
    made = judge_cases(todo, folder, partial(robot_cases.make_set, folder), jobs, "data sets")
    for row, case in zip(made, todo, strict=True):
        refuse_other(row, robot_cases.facts(case), folder, "folder")
    console.say(f"{len(made)} data sets in {folder}")
    if args.only_sets:
        return console.OK
    sets = [DataSet(row) for row in sorted(made, key=lambda row: -row.get("joints", 0))]  # the longest searches first
    done = finished_rows(args.out)
    seconds = sum(A_CASE.get(one.row.get("joints", 1), 60.0) for one in sets if one.id not in done)
    agree_to_time(seconds, len(sets), jobs, args.yes, "smaller --robots")
    rows = judge_cases(sets, args.out, partial(judge_set, folder), jobs)
    for one, row in zip(sets, rows, strict=True):
        if not same(one.row.get("truth"), row.get("truth")):
            raise ConfigError(f"gap bench: {args.out}: row {one.id} is of other data sets than {folder}; take another --out")
    whole = not (args.small or shards > 1 or args.cases)
    return print_score(robot_score, rows, args, args.strict or whole)


def together(folders: list[Path], args) -> int:
    """Scores the rows of several folders. Raises ConfigError for rows of two benchmarks under one id."""
    return print_score(robot_score, rows_of_folders(folders, ("truth", "seed")), args, args.strict)


def has_rows(folder: Path) -> bool:
    """Returns True if a folder holds rows on articulated robots."""
    return any(row.get("generator") in robot_session.NAMES for row in read_rows(folder / "rows.jsonl")[:1])


def judge_set(folder: Path, one: DataSet) -> dict:
    """Row of one data set with the search's answer. folder: of all sets."""
    row = one.row
    begin, start = time.process_time(), time.monotonic()
    about = dict(row)
    if "answer" not in row:
        small = row["kind"] in ("single", "pair") and min(row["visible"].values()) <= SEEN
        about |= {"answer": "NOT_SEARCHED"} if small else answer_of(folder / row["id"])
    return about | {"cpu_seconds": time.process_time() - begin, "seconds": time.monotonic() - start}


def answer_of(place: Path) -> dict:
    """Entries of a row on one data set."""
    nothing: dict = {"said": [], "rivals": [], "by_effect": {}}
    try:
        robot = read_robot(place / "robot.xml")
        files = log_files(place / "logs")
        columns = guess_columns(
            list(read_sheet(files[0]).columns), robot.sites("joint"), robot.actuators, False, free=robot.base is not None
        )
        trials, broken = read_robot_logs(files, columns)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            inquiry = find_robot.search(robot, trials, argparse.Namespace(**AS_SHIPPED))
    except FishmjError as error:
        return nothing | {"answer": "REFUSED", "reason": str(error).replace(f"{place.parent}/", "")}  # rows are shared
    except Exception as error:  # noqa: BLE001  one fault of the search must not end a benchmark of hundreds; it is counted
        told = traceback.format_exc().splitlines()[-8:]
        return nothing | {"answer": "FAULT", "reason": f"{type(error).__name__}: {error}", "traceback": told}
    verdict = inquiry.verdict
    out = answered_by(verdict) | {"reason": verdict.reason, "tentative": [effect_row(e) for e in verdict.tentative]}
    out |= {"standing": list(verdict.rivals), "torque_tolerance": inquiry.evidence.model.torque_tolerance}
    return out | {"by_effect": find_robot.by_effect(verdict), "broken": broken}
