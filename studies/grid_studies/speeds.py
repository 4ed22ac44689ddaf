"""`fishmj lbm_oracle speeds`: how fast the free fish swims, over the gait, slip ratio and depth.

fishmj lbm_oracle speeds --device cuda --out runs/speeds
fishmj lbm_oracle speeds --frequencies 0.5 1 1.5 2 2.5 --amplitudes 10 20 30 40 50 --lags 0 30 60 90 --slips 0.97 --tanks 24
fishmj lbm_oracle speeds --preset window --frequencies 1 --slips 1 --depths 0.25 --out runs/shallow
fishmj lbm_oracle speeds --preset laptop --frequencies 1 2 --slips 0.99 1 --beats 3 --device cpu --out runs/a

Still water, from rest, servo-driven: every frequency with every amplitude and lag (the paper's gait: 30 deg, lag 60 deg); the
last two beats count. `aside_deg` is the direction of the path from the first heading. Each finished swim is a row of
`speeds.csv`. The same command does the missing swims; another set-up in the same folder is refused. With `--robot` another
fish swims these gaits, with its own number of joints.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from math import radians
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.figures import canvas, save, style
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.immersed.markers import Sharpness
from fishmj.lbm_oracle.output.slice_plots import COLOURS, STYLE
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, Domain, preset
from fishmj.lbm_oracle.run.finished_rows import OK, FinishedRows, keep_rows
from fishmj.lbm_oracle.run.run import Run, TankRun
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, robot_entry, study_slips, swim_entries, swim_options
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, side_by_side
from fishmj.lbm_oracle.run.swim import figures
from fishmj.mjcf import load_robot

FREQUENCIES, SLIPS = (0.5, 1.0, 1.5, 2.0), (0.0, 0.95, 0.98, 0.99, 0.995, 1.0)
KEYS = ("frequency", "amplitude_deg", "lag_deg", "slip", "depth")
AMPLITUDE, LAG = 30.0, 60.0  # deg, of the paper's gait
COLUMNS = (*KEYS, "speed_m_s", "aside_deg", "yaw_amplitude_deg", "power_W", "refined_ticks", "status")


def start_swim(key: tuple, box: Domain, beats: float, device: str, robot: str, sharpness: Sharpness) -> TankRun:
    """One free swim of a gait in still water, from rest; its result is key and row.

    Args:
        key: frequency Hz, amplitude deg, lag from joint to joint deg, slip ratio, depth m.

    Returns:
        a row of speed m/s, path from the first heading deg, swing of the heading deg, servo power W, early end.
    """
    frequency, amplitude, lag, slip, depth = key
    joints = load_robot(robot).n_joints
    gait = Gait(joints=joints, frequency=frequency, amplitude=radians(amplitude), lag=radians(lag))
    run = SwimSetup(domain=box.changed(depth=depth), robot=robot, slip=slip, device=device, sharpness=sharpness).run()

    def row(run: Run) -> tuple[tuple, dict]:
        status = " ".join(run.stopped.split()) or OK
        if not run.rows:
            return key, dict.fromkeys(COLUMNS[len(KEYS) : -1], np.nan) | {"status": status}
        found = figures(run, frequency)
        kept = {name: found[name] for name in ("speed_m_s", "yaw_amplitude_deg", "power_W", "refined_ticks")}
        return key, kept | {"aside_deg": found["course_deg"], "status": status}

    return TankRun(run, round(beats / frequency / run.robot.timing.bus_dt), row, lambda: gait(run.time))


def on_device(waiting: Waiting, device: str, go_on: GoOn, *, tanks: int, **setup) -> Iterator[tuple[tuple, dict]]:
    """Yields key and row of swims, `tanks` at a time on one device (`spread`)."""
    return side_by_side(waiting, partial(start_swim, device=device, **setup), tanks=tanks, go_on=go_on)


def swim_keys(
    frequencies: Sequence[float],
    amplitudes: Sequence[float],
    lags: Sequence[float],
    slips: Sequence[float],
    depths: Sequence[float],
) -> list[tuple]:
    """Keys (frequency Hz, amplitude deg, lag deg, slip ratio, depth m) of all swims, the short ones first.

    Raises ConfigError: a frequency or depth that is not positive, an amplitude outside 0 to 90, a slip ratio outside 0 to 1.
    """
    wrong = min(frequencies) <= 0 or min(depths) <= 0 or min(slips) < 0 or max(slips) > 1
    if wrong or min(amplitudes) <= 0 or max(amplitudes) > 90:
        given = f"{list(frequencies)} Hz, {list(amplitudes)} deg, slip {list(slips)}, depth {list(depths)} m"
        raise ConfigError(f"speeds: {given}; expected positive frequencies and depths, amplitudes to 90 deg, slip ratios in 0..1")
    return sorted(product(frequencies, amplitudes, lags, slips, depths), key=lambda key: -key[0])


def main(argv: list[str]) -> int:
    """Runs the verb `speeds`; returns its exit code."""
    args = _parser().parse_args(argv)
    args.slips = study_slips("lbm_oracle speeds", args.slips, args.boundary, SLIPS)
    box, robot, edge = preset(args.preset).changed(nu=args.nu), load_robot(args.robot), BOUNDARIES[args.boundary]
    depths = args.depths or [round(box.shape[2] * box.dx, 6)]
    keys = swim_keys(args.frequencies, args.amplitudes, args.lags, args.slips, depths)
    setup = {"domain": box.name, "dx": box.dx, "dt": box.dt, "beats": args.beats} | swim_entries(edge, robot, args.nu)
    book = FinishedRows(Path(args.out) / "speeds.csv", COLUMNS, len(KEYS), setup, "speeds")
    left = [key for key in keys if key not in book.rows]
    swims = [(box.changed(depth=depth), args.beats / frequency) for frequency, *_, depth in left]
    less = "take a coarser --preset, fewer --beats, --frequencies or --slips; --preset laptop is a preview"
    solver_cost.agree("lbm_oracle speeds", args.device, swims, instead=less, tanks=args.tanks)
    devices = devices_of(args.device)
    console.say(f"{len(keys)} swims, {len(keys) - len(left)} of them done before, in {book.path.parent}")
    if robot_entry(robot):
        console.say(f"{robot.name} swims the gait of the shipped fish; published speeds are those of the shipped fish")
    water = sum(seconds for _, seconds in swims)
    work = partial(on_device, tanks=args.tanks, box=box, beats=args.beats, robot=args.robot, sharpness=edge)
    keep_rows(book, work, left, devices, water, lambda key: args.beats / key[0], "speeds", args.json)
    rows = [book.rows[key] for key in keys]
    title = f"{''.join(f'{name}, ' for name in robot_entry(robot).values())}{box.name}, {100 * box.dx:g} cm"
    picture = draw_speeds(rows, book.path.with_name("speeds.png"), title)
    speed = lambda row: np.nan_to_num(row["speed_m_s"])
    fastest = [max((row for row in rows if row["slip"] == slip), key=speed) for slip in args.slips]
    console.say(console.table(rows, COLUMNS), "fastest gait at each slip ratio", console.table(fastest, COLUMNS))
    console.say(f"wrote {book.path} and {picture}")
    lost = [row for row in rows if row["status"] != OK]
    if args.json:
        console.emit_json({"rows": rows, "fastest": fastest, "stopped": len(lost), "out": book.path})
    return console.FAILED_CHECK if lost else console.OK


def _parser() -> console.Parser:
    p = console.parser("lbm_oracle speeds", "Speed of the free fish over the gait, slip ratio and depth.")
    add = p.add_argument
    several: dict[str, Any] = {"nargs": "+", "action": console.Distinct}
    add("--preset", choices=EVERY, default="window_coarse", help="box of water; laptop is a preview")
    beat = console.number(0.05, 10)
    add("--frequencies", type=beat, **several, default=list(FREQUENCIES), metavar="HZ", help="of the beat")
    angle = console.number(0, 90, above=True)
    add("--amplitudes", type=angle, **several, default=[AMPLITUDE], metavar="DEG", help="of all joints")
    lag = console.number(-180, 180)
    add("--lags", type=lag, **several, default=[LAG], metavar="DEG", help="from joint to joint")
    add("--depths", type=console.number(0.05, 10), **several, metavar="M", help="of the water; the domain's own by default")
    swim_options(add, SLIPS)
    add("--tanks", type=console.whole(1, 256), default=1, help="swims side by side on each device; 12 or more keep a GPU busy")
    out = "speeds.csv and speeds.png; continues what is there"
    add("--out", type=console.out_folder, default="runs/speeds", metavar="FOLDER", help=out)
    return p


@style(STYLE)
def draw_speeds(rows: Sequence[dict], path: Path, title: str) -> Path:
    """Draws speed of free swims against the slip ratio, a line for each frequency and depth: the fastest amplitude and lag.

    The slip axis is stretched towards 1.
    """
    figure, ((axis,),) = canvas(1, 1, (6, 4))
    lines = sorted({(row["frequency"], row["depth"]) for row in rows})
    slips = sorted({row["slip"] for row in rows})
    for i, line in enumerate(lines):
        here = [row for row in rows if (row["frequency"], row["depth"]) == line]
        label = f"{line[0]:g} Hz" + (f", {line[1]:g} m deep" if len({depth for _, depth in lines}) > 1 else "")
        places = sorted({slips.index(row["slip"]) for row in here})
        speeds = [max(np.nan_to_num(row["speed_m_s"]) for row in here if row["slip"] == slips[place]) for place in places]
        axis.plot(places, speeds, marker="o", ms=4, lw=1.4, color=COLOURS[i % len(COLOURS)], label=label)
    axis.set_xticks(range(len(slips)), [f"{slip:g}" for slip in slips])
    axis.set(xlabel="slip ratio, at the paper's grid", ylabel="speed [m/s]", ylim=(0, None))
    axis.set_title(title, loc="left")
    axis.legend(frameon=False, fontsize=8)
    return save(figure, path)
