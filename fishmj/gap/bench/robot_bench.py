"""`gap bench --generator robots`: makes data sets of articulated robots, searches them, and scores the answers."""

import json
from functools import partial
from pathlib import Path

from fishmj.base import console, cost
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.gap.bench import robot_cases, robot_score
from fishmj.gap.bench.bench_rows import judge_cases, read_rows, same
from fishmj.gap.bench.robot_rows import judge_set
from fishmj.gap.laboratory.articulated import robot_session

ALL = "robots"
GENERATORS = (ALL, *robot_session.NAMES)
CASES, FEW = 520, 24  # by default; of a small benchmark
SETS = "sets"  # folder of data sets, in that of the rows
A_CASE = {1: 60.0, 2: 120.0, 6: 1500.0, 12: 6000.0}  # s of a core for a robot of so many joints


class DataSet:
    """A data set to be judged, by its row."""

    def __init__(self, row: dict):
        self.row, self.id = row, row["id"]


def selected(generators: list[str]) -> tuple[str, ...]:
    """The requested generators of articulated robots; none for others."""
    wanted = [name for one in generators for name in (robot_session.NAMES if one == ALL else (one,))]
    return tuple(name for name in robot_session.NAMES if name in wanted)


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
        robot_cases.check_same(row, case, folder)
    console.say(f"{len(made)} data sets in {folder}")
    if args.only_sets:
        return console.OK
    sets = [DataSet(row) for row in sorted(made, key=lambda row: -row.get("joints", 0))]  # the longest searches first
    done = {row["id"] for row in read_rows(args.out / "rows.jsonl")}
    seconds = sum(A_CASE.get(one.row.get("joints", 1), 60.0) for one in sets if one.id not in done)
    less = "take fewer --cases, smaller --robots, more --jobs, or --shard I/N for several machines"
    cost.time("gap bench", seconds / min(jobs, usable_cores()), f"{len(sets)} cases", instead=less, flag="--yes", agreed=args.yes)
    rows = judge_cases(sets, args.out, partial(judge_row, folder), jobs)
    for one, row in zip(sets, rows, strict=True):
        if not same(one.row.get("truth"), row.get("truth")):
            raise ConfigError(f"gap bench: {args.out}: row {one.id} is of other data sets than {folder}; take another --out")
    whole = not (args.small or shards > 1 or args.cases)
    return print_score(rows, args, args.strict or whole)


def together(folders: list[Path], args) -> int:
    """Scores the rows of several folders. Raises ConfigError for rows of two benchmarks under one id."""
    rows: dict[str, dict] = {}
    for folder in folders:
        for row in read_rows(folder / "rows.jsonl"):
            other = rows.setdefault(row["id"], row)
            if not all(same(other.get(key), row.get(key)) for key in ("truth", "seed")):
                raise ConfigError(
                    f"gap bench: --score {folder}: row {row['id']} is another case elsewhere; score one benchmark alone"
                )
    return print_score(list(rows.values()), args, args.strict)


def has_rows(folder: Path) -> bool:
    """Returns True if a folder holds rows on articulated robots."""
    return any(row.get("generator") in robot_session.NAMES for row in read_rows(folder / "rows.jsonl")[:1])


def judge_row(folder: Path, one: DataSet) -> dict:
    """Row of a data set."""
    return judge_set(folder, one.row)


def print_score(rows: list[dict], args, strict: bool) -> int:
    """Prints a score. Returns the exit code: 1 if `strict` and an aim is missed."""
    result = robot_score.score(rows)
    if args.out:
        write_text(args.out / "score.json", json.dumps(console.plain(result), indent=1))
    console.say(*robot_score.report_lines(result))
    if args.json:
        console.emit_json(result)
    return console.FAILED_CHECK if strict and any(aim["met"] is False for aim in result["aims"]) else console.OK
