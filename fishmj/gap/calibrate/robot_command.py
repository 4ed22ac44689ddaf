"""`calibrate model LOGS --model robot.xml`: the numbers that a robot's description leaves open, from its own logs.

Friction, damping and armature of each joint, gains of each actuator, the delay of the commands, and mass, inertia and centre of
each body within their tolerance, each with a 90 % interval. --out writes the identified ones into the text of the MJCF and
keeps its comments and layout. The others keep their stated value, and the table says why. gap find no longer sees an effect that
was fitted here: use --only to exclude the parameters that it should search.

    fishmj calibrate model LOGS --model robot.xml --out robot.calibrated.xml
    fishmj calibrate model LOGS --model robot.xml --only gain,delay,bodies
    fishmj gap check robot.calibrated.xml --parent robot.xml --data OTHER_LOGS
"""

import mujoco

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, LogError
from fishmj.base.store import write_bytes
from fishmj.gap import progress
from fishmj.gap.calibrate.robot_fit import FittedNumber, RobotFit, described, fit_robot
from fishmj.gap.commands import gap_options
from fishmj.gap.commands.admit_robot import refuse_mistakes
from fishmj.gap.commands.find_robot import read_logs
from fishmj.gap.models.robot_patch import next_mjcf
from fishmj.gap.records.shooting import robot_records
from fishmj.gap.search.free_numbers import KINDS
from fishmj.gap.wording import level, number, percent, title

FEWEST = 2  # logs


def main(argv: list[str]) -> int:
    """The command `calibrate model`. Returns the exit code."""
    parser = console.parser("calibrate model", __doc__ or "")
    add = parser.add_argument
    add("data", type=console.path, metavar="LOGS", help="a folder of CSV, Parquet, .npz, MCAP or rosbag2; a LeRobot data set")
    add("--model", type=console.text, required=True, metavar="ROBOT.xml", help="MJCF or URDF, or menagerie:NAME (needed)")
    only = f"kinds to fit: some of {','.join(KINDS)} (default all)"
    add("--only", type=console.Listed(console.text, len(KINDS)), default=tuple(KINDS), metavar="KIND,..", help=only)
    gap_options.of_columns(add)
    add("--out", type=console.out_file, metavar="NEW.xml", help="MJCF to write, not there yet (default none)")
    args = parser.parse_args(argv)
    gap_options.there(args.data, args.columns)
    if unknown := [kind for kind in args.only if kind not in KINDS]:
        raise ConfigError(f"calibrate model: --only {unknown[0][:40]}: no such kind; known: {', '.join(KINDS)}")
    if args.out and (args.out.suffix != ".xml" or args.out.exists()):
        raise ConfigError(f"{args.out}: exists, or does not end in .xml; choose another name with --out")
    robot, _, trials, broken = read_logs(args)
    if len(trials) < FEWEST:
        raise LogError(f"{args.data}: {len(trials)} log can be read; at least {FEWEST} are needed, for intervals")
    records = robot_records(trials, robot.dt, robot.channels)
    robot.check_contact(records)
    refuse_mistakes(robot, records, anyway=True)
    again = interrupt.again("start again")
    with interrupt.keeping(lambda: f"nothing was kept; a run takes seconds to minutes: {again}"):
        found = fit_robot(robot, records, args.only, progress.terminal_bar)
        console.say(console.table([_row(n) for n in found.numbers]), "", console.table(_errors(found)))
        before, after, whole = found.misfit
        console.say(f"|z|^2 / m: {level(before)} as described, {level(after)} with the written numbers, {level(whole)} with all")
        if args.out:
            write(found, robot, args)
    if args.json:
        numbers = [n._asdict() for n in found.numbers]
        console.emit_json({"numbers": numbers, "errors": found.errors, "misfit": found.misfit, "skipped": broken})
    return console.OK


def write(found: RobotFit, robot, args) -> None:
    """Writes the MJCF, its numbers and intervals in a comment. Raises LogError if it would explain the logs no better."""
    identified = [n for n in found.numbers if n.is_told]
    if not identified or not found.misfit[1] < found.misfit[0]:
        why = "the logs identify none of the numbers" if not identified else "the identified numbers alone explain them no better"
        raise LogError(f"{args.data}: {why}; nothing is written. Record motions that separate them: fishmj gap next --help")
    rows = [f"  {title(n.name)} {number(n.value)} ({number(n.low)} to {number(n.high)}) {n.unit}" for n in identified]
    head = f"calibrated by fishmj calibrate model, MuJoCo {mujoco.__version__}; parent {robot.path.name}; 90 % intervals:"
    written = next_mjcf(robot, found.model, found.delay, args.out, "\n".join([head, *rows]))
    write_bytes(args.out, written.data)
    console.say(f"written: {args.out}; {written.how}")


def _row(n: FittedNumber) -> dict:
    values = {"stated": n.stated, "value": n.value, "low": n.low, "high": n.high, "unit": n.unit}
    return {"number": title(n.name), **values, "told": percent(n.told), "": described(n)}


def _errors(found: RobotFit) -> list[dict]:
    return [
        {"joint": name, "RMS error as described": a, "with what is written": b, "with all": c}
        for name, (a, b, c) in found.errors.items()
    ]
