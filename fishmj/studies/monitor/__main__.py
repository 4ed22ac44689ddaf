"""How often the monitor alarms without a reason, and how soon with one: the loopback robot under a policy, faster than real time.

    python -m fishmj.studies.monitor --out runs/monitor                     10 h healthy, and the effects
    python -m fishmj.studies.monitor --robots 1 --swims 1 --out runs/look   a quick look

A robot is a draw of the second robot's unmeasured constants; it swims through the host, in lockstep. Each has one healthy swim to
learn from, others to watch, and one for every effect, of the middle of its catalogue's range, that comes at 60 s. Finished swims
are kept: the same command goes on. Robots of other seeds (`--first`) are other robots.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from math import exp, pi
from pathlib import Path

import numpy as np

from fishmj import console, cores
from fishmj.deploy.monitor import BLOCK, RATE
from fishmj.deploy.monitor_prediction import channels
from fishmj.deploy.monitor_statistics import Cusums, Reference, learn
from fishmj.errors import ConfigError
from fishmj.mjcf.description import load_robot
from fishmj.store import read_npz, write_json, write_npz
from fishmj.studies.monitor.loopback_swims import swim
from fishmj.studies.monitor.side_by_side import Blocks, blocks_of
from fishmj.studies.monitor.swims import HEALTHY, Effects, Tables
from fishmj.virtual_robot.trials import EFFECTS

SPEEDS = (0.1, 0.15, 0.2)  # m/s of the stream, robot by robot in turn
FIRST = 200  # seed of the first robot; below 200 some were looked at while the statistics were chosen
MINUTES, AT, AFTER = 10.0, 60.0, 180.0  # of a healthy swim; s when an effect comes, and s that it is watched
PLANTED = ("command_latency", "servo_gain", "torque_saturation", "body_mass", "steady_current", "marker_offset")
TOGETHER = 60  # swims at most that are predicted side by side
Job = tuple[int, int, str]  # seed of the robot, number of its swim, effect or ""


def middle(effect: str) -> Effects:
    """An effect at the middle of its catalogue's range."""
    return {effect: {p.name: (p.typical[0] + p.typical[1]) / 2 for p in EFFECTS[effect].parameters}}


def name_of(job: Job) -> str:
    """The file of a job."""
    robot, number, effect = job
    return f"{robot}_{number}{'_' + effect if effect else ''}.npz"


def made(folder: Path, job: Job) -> None:
    """Swim one job, unless it is there."""
    robot, number, effect = job
    file = folder / name_of(job)
    if not file.is_file():
        seconds = AT + AFTER if effect else 60 * MINUTES
        tables = swim(robot, 1000 * robot + number, seconds, middle(effect) if effect else HEALTHY, AT, speed_of(robot))
        write_npz(file, {f"{name}.{column}": values for name, table in tables.items() for column, values in table.items()})


def speed_of(robot: int) -> float:
    """m/s of the stream that a robot swims in."""
    return SPEEDS[robot % len(SPEEDS)]


def tables_of(file: Path) -> Tables:
    """Tables of a kept swim."""
    tables: Tables = {}
    for key, values in read_npz(file).items():
        name, _, column = key.partition(".")
        tables.setdefault(name, {})[column] = values
    return tables


def predicted(folder: Path, jobs: list[Job]) -> dict[Job, Blocks]:
    """Blocks of jobs of one length."""
    flows = [(speed_of(robot), pi) for robot, _, _ in jobs]
    return dict(zip(jobs, blocks_of(load_robot("fish"), [tables_of(folder / name_of(job)) for job in jobs], flows), strict=True))


def parts(jobs: list[Job], count: int) -> list[list[Job]]:
    """The jobs in `count` parts or more, none longer than TOGETHER."""
    size = max(min(TOGETHER, -(-len(jobs) // count)), 1)
    return [jobs[begin : begin + size] for begin in range(0, len(jobs), size)]


def watched(reference: Reference, blocks: Blocks, rate: float) -> tuple[list[tuple[float, str, str]], float]:
    """(s, channel, probe) of every alarm, the tests beginning afresh after each; the highest CUSUM, over its limit."""
    cusums, found, highest = Cusums(reference, rate, BLOCK), [], 0.0
    for t, block in blocks:
        cusums.take(block)
        highest = max(highest, *cusums.share().values())
        if channel := cusums.parted():
            found.append((t, channel, cusums.highest(channel)[0]))
            cusums = Cusums(reference, rate, BLOCK)
    return found, highest


def main(argv: list[str]) -> int:
    """Exit code 0: no alarm without a reason; 1: there were some."""
    parser = console.parser("studies.monitor", __doc__ or "")
    parser.add_argument("--robots", type=console.whole(1, 1000), default=6, help="draws of the unmeasured constants (default 6)")
    parser.add_argument("--first", type=console.whole(0, 10**6), default=FIRST, help=f"seed of the first robot (default {FIRST})")
    parser.add_argument("--jobs", type=console.whole(1, 1000), help="processes (default: as many as cores)")
    parser.add_argument(
        "--swims", type=console.whole(1, 1000), default=11, help="healthy swims of 10 min watched of each robot (default 11)"
    )
    parser.add_argument(
        "--rate", type=console.number(1e-6, 60), default=RATE, help=f"false alarms an hour that are asked for (default {RATE:g})"
    )
    parser.add_argument(
        "--score", action="store_true", help="swim nothing more: score what is there (default: swim what is missing)"
    )
    parser.add_argument("--out", type=console.out_folder, required=True)
    args = parser.parse_args(argv)
    robots = list(range(args.first, args.first + args.robots))
    learnt = [(r, 0, "") for r in robots]
    healthy = [(r, n, "") for r in robots for n in range(1, args.swims + 1)]
    struck = [(r, 500, effect) for r in robots for effect in PLANTED]
    args.out.mkdir(parents=True, exist_ok=True)
    everything = [*learnt, *healthy, *struck]
    if args.score:
        there = lambda job: (args.out / name_of(job)).is_file()
        learnt, struck = [job for job in learnt if there(job)], [job for job in struck if there(job) and there((job[0], 0, ""))]
        healthy = [job for job in healthy if there(job) and there((job[0], 0, ""))]
        robots, everything = [robot for robot, _, _ in learnt], []
        if not healthy:
            raise ConfigError(f"{args.out}: no healthy swim of a robot that was learnt is there; leave --score out")
    jobs_at_once = args.jobs or cores.usable_cores()
    blocks: dict[Job, Blocks] = {}
    with ProcessPoolExecutor(jobs_at_once) as pool:
        with console.Progress(max(len(everything), 1), "swims", "swims") as bar:
            for number, _ in enumerate(pool.map(partial(made, args.out), everything)):
                bar.update(number + 1)
        groups = [part for jobs in ([*learnt, *healthy], struck) for part in parts(jobs, jobs_at_once)]
        with console.Progress(len(groups), "predictions", "predictions") as bar:
            for number, some in enumerate(pool.map(partial(predicted, args.out), groups)):
                blocks |= some
                bar.update(number + 1)
    references = {r: learn([b for _, b in blocks[r, 0, ""]], channels(3)) for r in robots}
    hours = sum(len(blocks[job]) for job in healthy) * BLOCK / 3600
    seen = {f"{r}_{n}": watched(references[r], blocks[r, n, ""], args.rate) for r, n, _ in healthy}
    false = {name: alarms for name, (alarms, _) in seen.items() if alarms}
    count = sum(map(len, false.values()))
    highest = max(most for _, most in seen.values())
    expected = args.rate * hours
    console.say(f"healthy: {count} alarms in {hours:.2f} h of {len(robots)} robots, asked for at most {args.rate:g} an hour")
    console.say(f"that is {expected:.2g} at most; none has then a probability of {exp(-expected):.2g} or more")
    console.say(f"highest CUSUM of a healthy swim: {highest:.2f} of its limit")
    rows = []
    for effect in PLANTED:
        found = [watched(references[r], blocks[r, n, e], args.rate)[0] for r, n, e in struck if e == effect]
        before = sum(a[0] <= AT for alarms in found for a in alarms)
        first = [next((a for a in alarms if a[0] > AT), None) for alarms in found]
        delays = sorted(a[0] - AT for a in first if a)
        row = {"effect": effect, **{f"{k}": v for k, v in next(iter(middle(effect).values())).items()}}
        named = {"effect": effect, "size": ", ".join(f"{k} {v:.3g}" for k, v in row.items() if k != "effect")}
        timed = {
            "found": f"{len(delays)}/{len(first)}",
            "before": before,
            "median_s": float(np.median(delays)) if delays else None,
        }
        said = [f"{a[1]} {a[2]}" for a in first if a]
        rows.append(
            {
                **named,
                **timed,
                "worst_s": delays[-1] if delays else None,
                "first in": max(set(said), key=said.count) if said else "",
            }
        )
    console.say(console.table(rows))
    told = {"hours": hours, "rate": args.rate, "robots": robots, "false": false, "effects": rows}
    told |= {"highest": {name: round(most, 3) for name, (_, most) in seen.items()}}
    write_json(args.out / "result.json", told)
    if args.json:
        console.emit_json(told)
    return console.FAILED_CHECK if count else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
