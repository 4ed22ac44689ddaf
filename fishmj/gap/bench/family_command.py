"""`gap bench --generator` over families: draws, calibrates and searches robots; scores rows of several machines together."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.base.workers import ask_all
from fishmj.gap import progress
from fishmj.gap.bench import families, family_rows, family_score, power, solver_sets
from fishmj.gap.bench.bench_rows import agree_to_time, finished_rows, read_rows, refuse_other, rows_of_folders, words
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.bench.drawn_robots import BenchRobot, robots
from fishmj.gap.bench.score import print_score, show_score
from fishmj.gap.workflow import compile_kernel

ALL = "families"
CASES, FEW = 1140, 84  # by default; a small benchmark's: of some 60 there is a search
LOGS, SHORT = 6, 4  # of a case; a small benchmark's
DECIDED = ("truth", "seed", "experiments", "weighed", "as_described")  # of a row, before anything is asked
A_CASE = 80.0  # s of a core, those included that are not searched


def selected_families(generators: list[str]) -> tuple[str, ...]:
    """The requested families; none for the generators with a benchmark of their own."""
    return tuple(name for name in families.NAMES if ALL in generators or name in generators)


def bench(args, names: tuple[str, ...]) -> int:
    """Runs the requested benchmark and scores it. Returns the exit code."""
    return rows_and_score(draw_cases(args, names), args)


def solver(args) -> int:
    """Runs the benchmark on robots of the flow solver, whose data sets exist (`--sets`). Returns the exit code."""
    todo = solver_sets.robots(args.sets, args.kinds, args.cases)[args.shard[0] :: args.shard[1]]
    if args.effects:
        todo = hiding_any(todo, args.effects)
    if not todo:
        raise ConfigError(f"gap bench: --sets {args.sets}: no case is left; take other --kinds, --effects or --shard")
    return rows_and_score(todo, args, partial(solver_sets.rows, folder=args.sets))


def rows_and_score(todo: list[BenchRobot], args, ask: Callable[..., list[dict]] | None = None) -> int:
    """Makes the rows of robots and scores them. ask: as in `judge_robots`. Returns the exit code."""
    jobs = args.jobs or usable_cores()
    found = finished_rows(args.out)
    left = sum(case.id not in found for robot in todo for case in robot.cases)
    agree_to_time(left * A_CASE, left, jobs, args.yes)
    rows = judge_robots(todo, args, found, jobs, ask)
    strict = args.strict or not (args.small or args.effects or args.shard[1] > 1)
    return print_rows(rows, args, strict)


def draw_cases(args, names: tuple[str, ...]) -> list[BenchRobot]:
    """Robots of this machine's share, each with all of its requested cases. Raises ConfigError: there are none."""
    (index, shards), logs = args.shard, args.logs or (SHORT if args.small else LOGS)
    many = args.cases or (FEW if args.small else power.CASES if args.power else CASES)
    if args.power:
        todo = power.robots(many, args.seed, names, args.effects, logs)[index::shards]
    else:
        todo = robots(many, args.seed, names, args.kinds, logs)[index::shards]
    if args.effects and not args.power:
        todo = hiding_any(todo, args.effects)
    if not todo:
        raise ConfigError(f"gap bench: no robot is left of {many} cases, every {shards}th from {index}; take more --cases")
    return todo


def print_rows(rows: list[dict], args, strict: bool) -> int:
    """Prints a score or the table of power. Returns the exit code: 1 if `strict` and an aim is missed."""
    if not any(row.get("times") for row in rows):
        return print_score(family_score, rows, args, strict)
    result = power.score(rows)
    show_score(result, power.report_lines(result), args)
    return console.FAILED_CHECK if strict and False in result["met"].values() else console.OK


def together(folders: list[Path], args) -> int:
    """Scores the rows of several folders. Raises ConfigError: a folder without rows, or rows of two benchmarks under one id."""
    for folder in folders:
        mine = read_rows(folder / "rows.jsonl")
        if not mine:
            raise ConfigError(f"gap bench: --score {folder}: no rows.jsonl with rows in it; name folders of --out")
        if others := [row for row in mine if "family" not in row or "generator" in row]:
            what = f"row {others[0].get('id')} is of another benchmark"
            raise ConfigError(f"gap bench: --score {folder}: {what}; expected --generator families")
    return print_rows(rows_of_folders(folders, DECIDED), args, not args.small or args.strict)


def hiding_any(todo: list[BenchRobot], effects: tuple[str, ...]) -> list[BenchRobot]:
    """The robots with only those of their cases in which one of `effects` is hidden; none without such a case."""
    kept = (one._replace(cases=tuple(case for case in one.cases if set(effects) & set(case.effects))) for one in todo)
    return [robot for robot in kept if robot.cases]


def is_finished(row: dict | None, case: BenchCase, one: family_rows.RobotQuery) -> bool:
    """Returns True if a case is done. Raises ConfigError if its row is of another benchmark."""
    if row is None:
        return False
    begun = console.plain(family_rows.case_facts(case, one))
    keys = DECIDED if not case.times else (*DECIDED[1:], "times", "drawn")  # its size was scaled since
    refuse_other(row, {key: begun[key] for key in keys}, one.out, "--out")
    return True


def judge_robots(
    todo: list[BenchRobot], args, found: dict[str, dict], jobs: int, ask: Callable[..., list[dict]] | None = None
) -> list[dict]:
    """Rows of all cases, from disk or made now.

    Each process writes its own rows, so that an interrupted one loses only its present case. ask: makes the rows of one robot, by
    default `family_rows.rows`.
    """
    waiting = []
    for robot in todo:
        one = family_rows.RobotQuery(robot, not args.uncalibrated, args.weighed, args.out)
        left = tuple(case for case in robot.cases if not is_finished(found.get(case.id), case, one))
        waiting += [one._replace(robot=robot._replace(cases=left))] if left else []
    ids = [case.id for robot in todo for case in robot.cases]
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
    if waiting:
        precompile({one.robot.family for one in waiting})

    kept = lambda: len(set(ids) & set(finished_rows(args.out)))
    with interrupt.keeping(lambda: words(args.out, kept(), len(ids))), progress.terminal_bar(len(ids), "bench", "cases") as bar:
        with call_repeatedly(lambda: bar.update(len(set(ids) & set(finished_rows(args.out) or found)))):
            for made in ask_all(waiting, ask or family_rows.rows, jobs):
                found |= {row["id"]: row for row in made}
        bar.update(len(ids))
    return [found[i] for i in ids]


@contextmanager
def call_repeatedly(look: Callable[[], None], every: float = 10.0) -> Iterator[None]:
    """Context that calls `look` every `every` s, since other processes write rows one after another."""
    stop = threading.Event()

    def watch_rows() -> None:
        while not stop.wait(every):
            look()

    thread = threading.Thread(target=watch_rows, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def precompile(names: set[str]) -> None:
    """Compiles the shared code once before the processes start, so that they read it from disk."""
    from fishmj.gap.calibrate.water_plant import WaterPlant
    from fishmj.gap.models.swimming_fish import SwimmingFish
    from fishmj.gap.records.records import record_of
    from fishmj.mjcf.reading import load_robot

    robot = load_robot("fish")
    for plant in (SwimmingFish(robot), WaterPlant(robot)):
        compile_kernel(plant, console.say)
    for name in sorted({*names, families.SECOND} & set(families.NAMES)):
        swum = families.trials(name, {}, ["idle"], 0, robot)
    plant.predict([record_of(trial, plant.dt) for trial in swum], plant.null)
