"""How often the monitor alarms without a reason, and how soon with one: the second robot under a policy, faster than real time.

    python -m fishmj.studies.monitor --out runs/monitor                     10 h healthy, and the effects
    python -m fishmj.studies.monitor --robots 1 --swims 1 --out runs/look   a quick look

A robot is a draw of the second robot's unmeasured constants. Each has one healthy swim to learn from, others to watch, and one
for every effect, of the middle of its catalogue's range, that comes at 90 s. Finished swims are kept: the same command goes on.
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
from fishmj.mjcf.description import load_robot
from fishmj.store import read_npz, write_json, write_npz
from fishmj.studies.monitor.side_by_side import Blocks, blocks_of
from fishmj.studies.monitor.swims import HEALTHY, Effects, swim
from fishmj.virtual_robot.trials import EFFECTS

SPEEDS = (0.1, 0.15, 0.2)  # m/s of the stream, robot by robot in turn
FIRST = 200  # seed of the first robot; 100 to 105 were looked at while the statistics were chosen
MINUTES, AT, AFTER = 10.0, 90.0, 240.0  # of a healthy swim; s when an effect comes, and s that it is watched
PLANTED = (
    *("command_latency", "servo_gain", "torque_saturation", "body_mass", "steady_current", "marker_offset"),
    *("quadratic_drag", "heading_marker_offset"),
)
TOGETHER = 60  # swims that are predicted side by side


def middle(effect: str) -> Effects:
    """An effect at the middle of its catalogue's range."""
    return {effect: {p.name: (p.typical[0] + p.typical[1]) / 2 for p in EFFECTS[effect].parameters}}


def made(folder: Path, job: tuple[int, int, str]) -> str:
    """Swim one job (robot, number, effect or ""), unless it is there; the file's name."""
    robot, number, effect = job
    file = folder / f"{robot}_{number}{'_' + effect if effect else ''}.npz"
    if not file.is_file():
        seconds = AT + AFTER if effect else 60 * MINUTES
        tables = swim(
            FIRST + robot, 1000 * robot + number, seconds, middle(effect) if effect else HEALTHY, AT, SPEEDS[robot % len(SPEEDS)]
        )
        write_npz(file, {f"{name}.{column}": values for name, table in tables.items() for column, values in table.items()})
    return file.name


def tables_of(file: Path) -> dict[str, dict[str, np.ndarray]]:
    """Tables of a kept swim."""
    tables: dict[str, dict[str, np.ndarray]] = {}
    for key, values in read_npz(file).items():
        name, _, column = key.partition(".")
        tables.setdefault(name, {})[column] = values
    return tables


def predicted(folder: Path, jobs: list[tuple[int, int, str]], names: list[str]) -> dict[tuple[int, int, str], Blocks]:
    """Blocks of every job."""
    robot, out = load_robot("fish"), {}
    for begin in range(0, len(jobs), TOGETHER):
        part = slice(begin, begin + TOGETHER)
        flows = [(SPEEDS[number % len(SPEEDS)], pi) for number, _, _ in jobs[part]]
        out |= dict(zip(jobs[part], blocks_of(robot, [tables_of(folder / n) for n in names[part]], flows), strict=True))
    return out


def alarms(reference: Reference, blocks: Blocks, rate: float) -> list[tuple[float, str, str]]:
    """(s, channel, probe) of every alarm; the tests begin afresh after each."""
    cusums, found = Cusums(reference, rate, BLOCK), []
    for t, block in blocks:
        cusums.take(block)
        if channel := cusums.parted():
            found.append((t, channel, cusums.highest(channel)[0]))
            cusums = Cusums(reference, rate, BLOCK)
    return found


def main(argv: list[str]) -> int:
    """Exit code 0: no alarm without a reason; 1: there were some."""
    parser = console.parser("studies.monitor", __doc__ or "")
    parser.add_argument("--robots", type=console.whole(1, 1000), default=6)
    parser.add_argument("--swims", type=console.whole(1, 1000), default=10, help="healthy swims of 10 min watched of each robot")
    parser.add_argument("--rate", type=console.number(1e-6, 60), default=RATE, help="false alarms an hour that are asked for")
    parser.add_argument("--out", type=console.out_folder, required=True)
    args = parser.parse_args(argv)
    robots = range(args.robots)
    learnt = [(r, 0, "") for r in robots]
    healthy = [(r, n, "") for r in robots for n in range(1, args.swims + 1)]
    struck = [(r, 500, effect) for r in robots for effect in PLANTED]
    args.out.mkdir(parents=True, exist_ok=True)
    everything, files = [*learnt, *healthy, *struck], []
    with ProcessPoolExecutor(cores.usable_cores()) as pool, console.Progress(len(everything), "swims", "swims") as bar:
        for name in pool.map(partial(made, args.out), everything):
            files.append(name)
            bar.update(len(files))
    file_of = dict(zip(everything, files, strict=True))
    blocks: dict[tuple[int, int, str], Blocks] = {}
    for jobs in (learnt, healthy, struck):  # of one length each
        blocks |= predicted(args.out, jobs, [file_of[job] for job in jobs])
    references = {r: learn([b for _, b in blocks[r, 0, ""]], channels(3)) for r in robots}
    hours = sum(len(blocks[job]) for job in healthy) * BLOCK / 3600
    false = {f"{r}_{n}": found for r, n, _ in healthy if (found := alarms(references[r], blocks[r, n, ""], args.rate))}
    count = sum(map(len, false.values()))
    expected = args.rate * hours
    console.say(f"healthy: {count} alarms in {hours:.2f} h of {args.robots} robots, asked for at most {args.rate:g} an hour")
    console.say(f"that is {expected:.2g} at most; none has then a probability of {exp(-expected):.2g} or more")
    rows = []
    for effect in PLANTED:
        first = [next((a for a in alarms(references[r], blocks[r, 500, effect], args.rate) if a[0] > AT), None) for r in robots]
        delays = sorted(a[0] - AT for a in first if a)
        row = {"effect": effect, **{f"{k}": v for k, v in next(iter(middle(effect).values())).items()}}
        told = {"effect": effect, "size": ", ".join(f"{k} {v:.3g}" for k, v in row.items() if k != "effect")}
        timed = {"found": f"{len(delays)}/{len(first)}", "median_s": float(np.median(delays)) if delays else None}
        said = [f"{a[1]} {a[2]}" for a in first if a]
        rows.append(
            {
                **told,
                **timed,
                "worst_s": delays[-1] if delays else None,
                "first in": max(set(said), key=said.count) if said else "",
            }
        )
    console.say(console.table(rows))
    write_json(args.out / "result.json", {"hours": hours, "rate": args.rate, "false": false, "effects": rows})
    if args.json:
        console.emit_json({"hours": hours, "rate": args.rate, "false": false, "effects": rows})
    return console.FAILED_CHECK if count else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
