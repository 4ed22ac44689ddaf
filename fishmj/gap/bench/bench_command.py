"""`gap bench`: blind benchmark of the search; counts right, wrong and missing answers.

fishmj gap bench --cases 40 --small --jobs 0 --out bench

With --generator families, or some of them, robots are drawn: half of them the shipped fish, half a chain of 2 to 6 links. Each is
calibrated to its own free swims, then something is hidden in it. The null leaves its family out. The command exits with 1 below
its aims, except with --small.

fishmj gap bench --generator families --jobs 0 --shard 0/4 --out bench0        a quarter of it, one of four machines
fishmj gap bench --score bench0 bench1 bench2 bench3                            all of it
fishmj gap bench --generator families --power --effects quadratic_drag --out power     how often it is found, by its strength

With --generator robots, or some of mujoco, pinocchio (extra `bench`) and bam, pendulums, arms and legs are drawn in MJCF, and
`gap find --model` searches their logs. The data sets are made first; another machine may judge them.

fishmj gap bench --generator robots --robots pendulum,two_link --small --jobs 0 --out robots
fishmj gap bench --generator robots --only-sets pinocchio --sets sets --out robots
fishmj gap bench --generator robots --sets sets --jobs 64 --out robots
"""

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from fishmj.base import console
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.gap.bench import cases, families, family_command, logs, power, robot_bench, robot_cases, solver
from fishmj.gap.bench.bench_rows import agree_to_time, finished_rows, judge_cases
from fishmj.gap.bench.run_case import fish, run
from fishmj.gap.bench.score import figure_line, score
from fishmj.gap.commands import admission, gap_options
from fishmj.gap.laboratory.articulated import robot_session
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.thresholds import frozen
from fishmj.gap.workflow import compile_kernel
from fishmj.mjcf.reading import load_robot

ALONE = ("second", "lbm", "log")  # benchmarks of their own
SOLVER = "solver"  # a family whose robots are swum beforehand
GENERATORS = (*ALONE, *families.NAMES, family_command.ALL, SOLVER, *robot_bench.GENERATORS)
GENERATED = (
    "second: the second robot, model as described; lbm: shipped sets of the flow solver; log: measured sets (FISHMJ_MEASURED), a"
    f" term deleted; or, with drawn and calibrated models, some of {', '.join(families.NAMES)}; families: all four;"
    f" {SOLVER}: robots of the flow solver, calibrated, data sets of --sets; {robot_bench.ALL}: arms and legs in MJCF, by all of"
    f" {', '.join(robot_session.NAMES)}"
)
CASES = 400
SECOND_TOO = f"the second robot with drawn and calibrated models is {families.SECOND}"
MOST, MOST_JOBS = 100_000, 1024
A_LOG = 3.3  # s of a core: 720 cases of 9 logs on average take one 30 s each (docs/search/results.md)
ALLOWED = 1  # wrong names, and false alarms, that a quick run may have


def main(argv: list[str]) -> int:
    """Runs and scores the benchmark. Returns the exit code."""
    parser = console.parser("gap bench", __doc__)
    add = parser.add_argument
    many = f"how many, 1 to {MOST} (default {CASES}; of families {family_command.CASES}, {family_command.FEW} with --small)"
    add("--cases", type=console.whole(1, MOST), metavar="N", help=many)
    gap_options.of_seed(add, "seed of all random choices: effects, sizes, fish, noise")
    kinds = f"only {', '.join(cases.KINDS)} (default all, in their shares)"
    add("--kinds", type=_kinds, default=dict(cases.KINDS), metavar="KIND,..", help=kinds)
    hiding = "only the drawn cases in which one of these effects is hidden (default all)"
    add("--effects", type=_effects, default=None, metavar="NAME,..", help=hiding)
    listed = console.Listed(console.OneOf(GENERATORS))
    add("--generator", type=listed, default=["second"], metavar="NAME,..", help=f"{GENERATED} (default second)")
    add("--model", type=console.text, default="fish", help="--generator second: the robot, name or TOML file (default fish)")
    add("--small", action="store_true", help="half a session with usual noise, seconds per case; for families 4 logs per case")
    session = f"for families: logs per case, 4 to 12 (default {family_command.LOGS}, {family_command.SHORT} with --small)"
    add("--logs", type=console.whole(4, 12), metavar="N", help=session)
    times = ", ".join(f"{t:g}" for t in power.TIMES)
    strengths = f"of families: each effect (or --effects) at {times} times what healthy robots differ by, as a table of power"
    add("--power", action="store_true", help=f"{strengths} ({power.CASES} cases by default)")
    add("--uncalibrated", action="store_true", help="for families: search the uncalibrated description")
    add("--strict", action="store_true", help="for families: exit 1 below the aims also with --small, --shard or --effects")
    sets = "of --generator solver: folder that python -m studies.solver_family made; of robots: folder of data sets"
    add("--sets", type=console.path, metavar="DIR", help=f"{sets} (default OUT/sets)")
    making = f"of --generator robots: make the data sets of {robot_bench.ALL}, or of some, and stop (default: judge them, too)"
    only = console.Listed(console.OneOf(robot_bench.GENERATORS))
    add("--only-sets", type=only, default=[], metavar="NAME,..", help=making)
    robots = console.Listed(console.OneOf((*robot_cases.FAMILIES, *robot_cases.MORE)))
    more = ", ".join(robot_cases.MORE)
    shares = f"of --generator robots: only {', '.join(robot_cases.FAMILIES)} (default all, in their shares), or {more}"
    add("--robots", type=robots, default=list(robot_cases.FAMILIES), metavar="NAME,..", help=shares)
    scoring = "only score the rows that runs of --generator families or robots wrote into these folders (default none)"
    add("--score", nargs="+", type=console.path, metavar="DIR", help=scoring)
    add("--weighed", action="store_true", help="give every set measurements.toml with mass, balance point and yaw inertia")
    shard = "run every N-th case from the I-th, I from 0, to use several machines (default 0/1)"
    add("--shard", type=shard_of, default=(0, 1), metavar="I/N", help=shard)
    many = f"processes side by side, a core each, to {MOST_JOBS}; 0: one for every core (default 1)"
    add("--jobs", type=console.whole(0, MOST_JOBS), default=1, metavar="N", help=many)
    out = "folder for rows.jsonl and score.json; the same command continues where it stopped (default none)"
    add("--out", type=console.out_folder, help=out)
    add("--baselines", action="store_true", help="also run four usual methods on the same cases, in one table")
    add("--yes", action="store_true", help="accept runs of more than a week")
    args = parser.parse_args(argv)
    if args.score:
        in_mjcf = all(robot_bench.has_rows(folder) for folder in args.score)
        return (robot_bench if in_mjcf else family_command).together(args.score, args)
    if articulated := robot_bench.selected(args.generator):
        refuse_articulated(args, articulated)
        return robot_bench.bench(args, articulated)
    if SOLVER in args.generator or args.sets:
        refuse_solver(args)
        return family_command.solver(args)
    if names := family_command.selected_families(args.generator):
        refuse(args, names)
        return family_command.bench(args, names)
    if len(args.generator) > 1:
        raise ConfigError(f"gap bench: --generator {','.join(args.generator)}: {', '.join(ALONE)} are scored alone")
    for option in ("logs", "uncalibrated", "strict", "power"):
        if getattr(args, option):
            raise ConfigError(f"gap bench: --{option} goes with --generator {', '.join(families.NAMES)} or {family_command.ALL}")
    args.generator, args.cases = args.generator[0], args.cases or CASES
    if args.effects and args.generator == "log":
        raise ConfigError("gap bench: --effects goes with --generator second or lbm; from measured sets a term is deleted")
    if args.baselines and args.generator != "second":
        raise ConfigError("gap bench: --baselines are judged on --generator second only")
    if args.model != "fish" and args.generator != "second":
        raise ConfigError(f"gap bench: --model is for --generator second; {args.generator} has a robot of its own")
    if args.model != "fish" and args.baselines:
        raise ConfigError("gap bench: --baselines are judged on the shipped fish; leave --model out")
    admission.searchable(load_robot(args.model), args.model)
    index, shards = args.shard
    jobs = args.jobs or usable_cores()
    agree(args, len(range(index, args.cases, shards)), jobs)
    todo, ask = cases_and_query(args)
    todo = hiding_any(todo[: args.cases], args.effects)[index::shards]
    if not todo:
        dealt = f"{args.cases} cases of these kinds{' and effects' if args.effects else ''}"
        raise ConfigError(f"gap bench: no case is left: {dealt}, every {shards}th from {index}; take more --cases")
    if args.generator != "log":
        # once, before the processes start
        compile_kernel(fish(args.model) if args.generator == "second" else solver.plant(), console.say)
    rows = judge_cases(todo, args.out, ask, jobs)
    result = score(list(rows))
    if args.out:
        write_text(args.out / "score.json", json.dumps(console.plain(result), indent=1))
    console.say(*report_lines(result))
    if args.baselines:
        from fishmj.gap.bench.baselines import beside, compared

        console.say(compared(rows, beside([one.case for one in todo], rows, args.out, jobs)))
    if args.json:
        flat = {k: v["value"] if isinstance(v, dict) else v for k, v in result.items()}
        console.emit_json(flat | {"detail": result})
    wrong = result["precision"]["n"] - result["precision"]["hits"]
    fails = wrong > ALLOWED or result["false_alarm_rate"]["hits"] > ALLOWED
    return console.FAILED_CHECK if args.small and fails else console.OK


def refuse(args, names: tuple[str, ...]) -> None:
    """Raises ConfigError for an option that does not go with families."""
    mixed = [name for name in args.generator if name in ALONE]
    if mixed:
        raise ConfigError(f"gap bench: --generator {','.join(args.generator)}: {', '.join(mixed)} is scored alone; {SECOND_TOO}")
    if args.model != "fish" or args.baselines:
        option = "--baselines" if args.baselines else "--model"
        raise ConfigError(f"gap bench: {option} is for --generator second; families ({', '.join(names)}) draw their models")


def refuse_articulated(args, names: tuple[str, ...]) -> None:
    """Raises ConfigError for an option or a generator that does not go with articulated robots."""
    known = (robot_bench.ALL, *names)
    given = [f"--generator {name}" for name in args.generator if name not in known] + of_drawn_fish(args)
    given += [option for option, value in {"--effects": args.effects, "--uncalibrated": args.uncalibrated}.items() if value]
    if given:
        raise ConfigError(f"gap bench: {given[0]} does not go with --generator {','.join(names)}: robots in MJCF are drawn")


def refuse_solver(args) -> None:
    """Raises ConfigError for an option that does not go with the family of the flow solver."""
    if args.generator != [SOLVER] or not args.sets:
        together = f"its rows and those of other families are scored together by --score (got {','.join(args.generator)})"
        raise ConfigError(f"gap bench: --generator {SOLVER} and --sets DIR go together, alone; {together}")
    if given := of_drawn_fish(args):
        raise ConfigError(f"gap bench: {given[0]} does not go with --generator {SOLVER}: its data sets are made")


def of_drawn_fish(args) -> list[str]:
    """The named options for robots that are fish and whose sessions are drawn."""
    asked = {"--model": args.model != "fish", "--logs": args.logs, "--weighed": args.weighed, "--baselines": args.baselines}
    return [option for option, value in (asked | {"--power": args.power}).items() if value]


def agree(args, many: int, jobs: int) -> None:
    """Asks for agreement to weeks of work before a case is drawn; the flow solver has only the shipped cases.

    Raises TooMuch: not agreed.
    """
    if args.generator == "lbm":
        return
    left = many - len(finished_rows(args.out))
    logs = cases.SMALL if args.small else sum(a * b for a, b in zip(cases.BUDGETS, cases.SHARES, strict=True))
    agree_to_time(left * logs * A_LOG, left, jobs, args.yes)


def _kinds(text: str) -> dict[str, float]:
    """The `type=` of --kinds: kinds of cases with their shares."""
    return {name: cases.KINDS[name] for name in console.Listed(console.OneOf(tuple(cases.KINDS)))(text)}


def _effects(text: str) -> tuple[str, ...]:
    """The `type=` of --effects: effects that any generator can hide."""
    known = {name: None for family in families.NAMES for source in families.pool(family) for name in source}
    from fishmj.gap.laboratory.virtual_robot import EFFECTS

    return tuple(console.Listed(console.OneOf(tuple(EFFECTS | known)))(text))


def hiding_any(dealt: list, effects: tuple[str, ...] | None) -> list:
    """Cases in which one of `effects` is hidden; all of them for None.

    They are chosen after all cases were drawn, so that a case is the same with and without the option.
    """
    return [one for one in dealt if effects is None or set(effects) & set(one.case.effects)]


def shard_of(text: str) -> tuple[int, int]:
    """The `type=` of --shard: (index, number of shards)."""
    index, _, count = text.partition("/")
    if not (index.isdecimal() and count.isdecimal() and int(index) < int(count) <= MOST):
        raise argparse.ArgumentTypeError(f"got {text[:40]!r}, expected I/N with I from 0 to N - 1, such as 0/4")
    return int(index), int(count)


def cases_and_query(args) -> tuple[list, Callable]:
    """(cases of the generator, function that makes the row of one)."""
    kinds = args.kinds
    if args.generator == "log":
        return [one for one in logs.draw(args.cases, args.seed) if one.kind in kinds], logs.run
    if args.generator == "lbm":
        return [one for one in solver.draw() if one.case.kind in kinds], partial(case_row, solver.plant, args.weighed)
    drawn = cases.draw(args.cases, args.seed, kinds, small=args.small)
    if args.model != "fish":  # rows of several models may lie in one folder
        drawn = [case._replace(id=f"{Path(args.model).stem}-{case.id}") for case in drawn]
    given = [solver.SolverCase(case, None, SimulatedNull(noise=case.noise)) for case in drawn]
    return given, partial(case_row, partial(fish, args.model), args.weighed)


def case_row(plant: Callable, weighed: bool, one: solver.SolverCase) -> dict:
    """Row of a case. plant: gives the questioned model, when it is needed."""
    return run(plant(), one.case, frozen(), one.null, one.trials, weighed)


def report_lines(result: dict) -> list[str]:
    """Score as lines of text."""
    return [figure_line(key, value, width=34) for key, value in result.items()]
