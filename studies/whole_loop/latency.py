"""Delay of a loopback robot's joints behind its commands, for latencies that are hidden in it: the delay alone, fitted.

    python -m studies.whole_loop.latency --out runs/latency                            seeds 0 to 2; 0, 30, 50, 150 ms
    python -m studies.whole_loop.latency --seeds 1 --hidden 0 150 --out runs/latency   one robot, two latencies

    miss(d)   mean square of (predicted - measured) joint angle over samples and joints of one `gait`, with command_latency d
    fitted    d at the minimum of the parabola through miss(hidden - 4 ms .. hidden + 8 ms)

A robot with its own radio, servos and friction is a little late even if nothing is hidden; this is equal in every column.
"""

from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import FishmjError
from fishmj.base.store import write_json
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import Record, record_of
from fishmj.log import read_trial
from studies.whole_loop import steps
from studies.whole_loop.steps import Loop

HIDDEN = (0.0, 30.0, 50.0, 150.0)  # ms
ROUND = np.linspace(-0.004, 0.008, 7)  # s, that are tried about the hidden one


def swim_once(out: Path, seed: int, hidden: float, dt: float) -> Record:
    """A `gait` of the robot of this seed with `hidden` s more command latency; an existing record is not swum again."""
    folder = out / f"hidden_{1e3 * hidden:g}ms"
    loop = Loop(out=folder, healthy=("gait",))
    steps.played(loop, seed, loop.healthy, loop.folder(seed) / "rig", f"--effect command_latency={hidden:g}" if hidden else "")
    return record_of(read_trial(loop.folder(seed) / "rig/trials/gait_1"), dt)


def fitted(model: SwimmingFish, record: Record, hidden: float) -> float:
    """Delay [s] at which the model's joints come nearest to the record's; the search is about `hidden` s."""
    delays = hidden + ROUND  # less than none is a robot that is quicker than its description
    rows = np.tile(model.null, (len(delays), 1))
    rows[:, model.index("command_latency", "delay")] = delays
    if record.joint is None:
        raise FishmjError(f"{record.name}: no joint angles were logged; a latency is fitted to them")
    miss = np.mean((model.predict([record], rows)[0]["joint"] - record.joint.values) ** 2, (1, 2))
    second, first, _ = np.polyfit(delays - hidden, miss, 2)
    return hidden - first / (2 * second)


def main(argv: list[str]) -> int:
    """Runs the study. Exit code 0: every robot swam."""
    parser = console.parser("studies.whole_loop.latency", __doc__ or "")
    add = parser.add_argument
    add("--seeds", type=console.whole(1, 1000), default=3, metavar="N", help="robots, of seeds 0 to N - 1 (default 3)")
    latency = f"hidden latencies, ms (default {' '.join(f'{value:g}' for value in HIDDEN)})"
    add("--hidden", type=console.number(0, 500), nargs="+", default=list(HIDDEN), metavar="MS", help=latency)
    add("--out", type=console.out_folder, required=True, help="folder; the same command goes on where it stopped")
    args = parser.parse_args(argv)
    model, rows = SwimmingFish("fish"), []  # of each robot: {hidden in ms: fitted in ms}
    with console.Progress(args.seeds * len(args.hidden), "latency", "swims") as bar:
        for seed in range(args.seeds):
            found = {}
            for hidden in args.hidden:
                found[f"{hidden:g}"] = 1e3 * fitted(model, swim_once(args.out, seed, hidden / 1e3, model.dt), hidden / 1e3)
                bar.update(len(rows) * len(args.hidden) + len(found), robot=seed)
            rows.append(found)
    told = {"fitted_ms": rows}
    write_json(args.out / "latency.json", told)
    console.say(
        console.table([{"seed": seed} | {f"{k} ms": f"{v:.1f}" for k, v in row.items()} for seed, row in enumerate(rows)])
    )
    if args.json:
        console.emit_json(told)
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
