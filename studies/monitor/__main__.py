"""False alarms of the monitor and its delay in finding an effect: the loopback robot under a policy, faster than real time.

    python -m studies.monitor --out runs/monitor                     10 h healthy, and the effects
    python -m studies.monitor --robots 1 --swims 1 --out runs/look   a quick look

A robot is a draw of the second robot's unmeasured constants; it swims through the host, in lockstep. Each has one healthy swim
for learning, others to watch, and one for every effect, which sets in at 60 s with the middle of its catalogue's range. Finished
swims
are kept: the same command continues. A watched swim no longer needs its tables: NAME.json and reference_ROBOT.npz are enough to
continue on another machine. Robots of other seeds (`--first`) are other robots.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from math import exp, pi
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from fishmj.base import console, cores, interrupt
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json, read_npz, write_json, write_npz
from fishmj.deploy.monitor.monitor import BLOCK, RATE
from fishmj.deploy.monitor.prediction import channels
from fishmj.deploy.monitor.statistics import learn
from fishmj.gap.laboratory.virtual_robot.trials import EFFECTS
from fishmj.mjcf.reading import load_robot
from studies.monitor import results
from studies.monitor.loopback_swims import swim
from studies.monitor.results import Watched
from studies.monitor.side_by_side import Blocks, blocks_of
from studies.monitor.swims import HEALTHY, Effects, Tables

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
    """File of a job."""
    robot, number, effect = job
    return f"{robot}_{number}{'_' + effect if effect else ''}.npz"


def result_of(job: Job) -> str:
    """File of the monitor's result for a job."""
    return str(Path(name_of(job)).with_suffix(".json"))


def made(folder: Path, job: Job) -> None:
    """Swims one job, unless its file exists."""
    robot, number, effect = job
    file = folder / name_of(job)
    if not file.is_file():
        seconds = AT + AFTER if effect else 60 * MINUTES
        tables = swim(robot, 1000 * robot + number, seconds, middle(effect) if effect else HEALTHY, AT, speed_of(robot))
        write_npz(file, {f"{name}.{column}": values for name, table in tables.items() for column, values in table.items()})


def speed_of(robot: int) -> float:
    """Speed of the stream in which a robot swims, m/s."""
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
    """Jobs in `count` parts or more, none longer than TOGETHER."""
    size = max(min(TOGETHER, -(-len(jobs) // count)), 1)
    return [jobs[begin : begin + size] for begin in range(0, len(jobs), size)]


def learnt_from(folder: Path, jobs: list[Job]) -> None:
    """Learns and keeps the reference of each robot's first swim."""
    for job, blocks in predicted(folder, jobs).items():
        results.write_reference(folder / results.reference_name(job[0]), learn([b for _, b in blocks], channels(3)))


def watched_in(folder: Path, rate: float, jobs: list[Job]) -> None:
    """Watches each of these swims and keeps the monitor's result."""
    references = {robot: results.read_reference(folder / results.reference_name(robot)) for robot in {job[0] for job in jobs}}
    for job, blocks in predicted(folder, jobs).items():
        write_json(folder / result_of(job), results.watched(references[job[0]], blocks, rate)._asdict())


def read_watched(folder: Path, job: Job, rate: float) -> Watched | None:
    """Kept result of the monitor for a swim; None if it was not watched, or at another rate."""
    file = folder / result_of(job)
    found = Watched(**read_json(file)) if file.is_file() else None
    return found if found and found.rate == rate else None


def walked(folder: Path, robots: list[int], swims: int, rate: float, jobs_at_once: int, swim_more: bool) -> None:
    """Swims the missing jobs, learns every robot, watches its swims; finished parts are kept."""
    todo = [job for job in watched_jobs(robots, swims) if read_watched(folder, job, rate) is None]
    unknown = [(r, 0, "") for r in robots if not (folder / results.reference_name(r)).is_file() and any(j[0] == r for j in todo)]
    with ProcessPoolExecutor(jobs_at_once) as pool:
        if swim_more:
            missing = [*unknown, *todo]
            with console.Progress(max(len(missing), 1), "swims", "swims") as bar:
                for number, _ in enumerate(pool.map(partial(made, folder), missing)):
                    bar.update(number + 1)
        swum = lambda jobs: [job for job in jobs if (folder / name_of(job)).is_file()]
        first = parts(swum(unknown), jobs_at_once)
        with console.Progress(max(len(first), 1), "references", "parts") as bar:
            for number, _ in enumerate(pool.map(partial(learnt_from, folder), first)):
                bar.update(number + 1)
        known = [job for job in swum(todo) if (folder / results.reference_name(job[0])).is_file()]
        lengths = ([job for job in known if not job[2]], [job for job in known if job[2]])
        groups = [part for jobs in lengths for part in parts(jobs, jobs_at_once)]
        with console.Progress(max(len(groups), 1), "predictions", "parts") as bar:
            for number, _ in enumerate(pool.map(partial(watched_in, folder, rate), groups)):
                bar.update(number + 1)


def watched_jobs(robots: list[int], swims: int) -> list[Job]:
    """Swims to be watched, one of each robot in turn, so that an interrupted run has some of each."""
    healthy = [(r, n, "") for n in range(1, swims + 1) for r in robots]
    return [*healthy[: len(robots)], *((r, 500, effect) for r in robots for effect in PLANTED), *healthy[len(robots) :]]


def main(argv: list[str]) -> int:
    """Runs the study. Exit code 0: no false alarm; 1: some."""
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
    args.out.mkdir(parents=True, exist_ok=True)
    with interrupt.keeping(lambda: f"finished swims are in {args.out}; {interrupt.again()}"):
        walked(args.out, robots, args.swims, args.rate, args.jobs or cores.usable_cores(), not args.score)
    found = {job: read_watched(args.out, job, args.rate) for job in watched_jobs(robots, args.swims)}
    seen = {job: result for job, result in found.items() if result is not None}
    if not any(not job[2] for job in seen):
        raise ConfigError(f"{args.out}: no healthy swim of a robot that was learnt is there; leave --score out")
    told = summary(seen, args.rate)
    for line in summary_lines(told):
        console.say(line)
    console.say(console.table(told["effects"]))
    write_json(args.out / "result.json", told)
    if args.json:
        console.emit_json(told)
    return console.FAILED_CHECK if told["alarms"] else console.OK


def summary(seen: dict[Job, Watched], rate: float) -> dict:
    """False alarms of the healthy swims, and the delay of each effect."""
    healthy = {f"{r}_{n}": result for (r, n, effect), result in seen.items() if not effect}
    false = {name: result.alarms for name, result in healthy.items() if result.alarms}
    hours = sum(result.blocks for result in healthy.values()) * BLOCK / 3600
    return {
        "hours": hours,
        "rate": rate,
        "rate_below_95": highest_rate(sum(map(len, false.values())), hours),
        "robots": sorted({r for r, _, effect in seen if not effect}),
        "swims": len(healthy),
        "alarms": sum(map(len, false.values())),
        "false": false,
        "highest": {name: round(result.highest, 3) for name, result in sorted(healthy.items())},
        "effects": [row_of(effect, [s for (_, _, e), s in seen.items() if e == effect]) for effect in PLANTED],
    }


def highest_rate(alarms: int, hours: float) -> float:
    """Upper end of the one-sided 95 % interval of a Poisson rate, 1/h (Garwood 1936, doi 10.1093/biomet/28.3-4.437)."""
    return float(chi2.ppf(0.95, 2 * alarms + 2)) / (2 * hours)


def row_of(effect: str, swims: list[Watched]) -> dict:
    """Row of an effect: its delays, s after its start."""
    first = [alarm for alarm in (next((a for a in s.alarms if a[0] > AT), None) for s in swims) if alarm]
    delays, names = sorted(t - AT for t, _, _ in first), [f"{channel} {probe}" for _, channel, probe in first]
    return {
        "effect": effect,
        "size": ", ".join(f"{name} {value:.3g}" for name, value in middle(effect)[effect].items()),
        "found": f"{len(first)}/{len(swims)}",
        "before": sum(a[0] <= AT for s in swims for a in s.alarms),
        "median_s": float(np.median(delays)) if delays else None,
        "worst_s": delays[-1] if delays else None,
        "first in": max(sorted(set(names)), key=names.count, default=""),
    }


def summary_lines(told: dict) -> list[str]:
    """Lines of a summary for people."""
    expected, alarms = told["rate"] * told["hours"], f"{told['alarms']} alarms in {told['hours']:.2f} h"
    return [
        f"healthy: {alarms} of {len(told['robots'])} robots, asked for at most {told['rate']:g} an hour",
        f"that is {expected:.2g} at most; none has then a probability of {exp(-expected):.2g} or more",
        f"by these hours alone the rate is below {told['rate_below_95']:.2g} an hour, with 95 %",
        f"highest CUSUM of a healthy swim: {max(told['highest'].values()):.2f} of its limit",
    ]


if __name__ == "__main__":
    raise SystemExit(console.run(main))
