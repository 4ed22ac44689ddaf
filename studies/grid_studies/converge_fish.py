"""`fishmj lbm_oracle converge fish`: what grid, time step and slip ratio do to the fish itself.

fishmj lbm_oracle converge fish --device cuda --out runs/converge
fishmj lbm_oracle converge fish --grids 0.04 0.02 --parts 1 --slips 0.98 --what cruise --beats 2 --domain laptop

    cruise      speed of the free fish at 1 Hz and 30 deg over the last two beats, m/s
    drag        of the straight fish held in 0.3 m/s, N
    broadside   lateral force on it across that stream, N
    yaw         moment about the reference point of a fish held with all joints at 20 deg in that stream from ahead, N m

The box keeps its size in metres on every grid. A time step is a part of the paper's Courant number, dt = dx / (5 m/s) / part.
Each finished run is a row of `converge.csv`. The same command does the missing runs; another set-up in the same folder is
refused. To repeat a run, delete its line.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.force_maps.force_points import AveragingTimes, Point, measure_points
from fishmj.lbm_oracle.force_maps.forcemap import stage
from fishmj.lbm_oracle.immersed.markers import Sharpness
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, Domain, preset
from fishmj.lbm_oracle.run.finished_rows import OK, FinishedRows, keep_rows
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, robot_entry, study_slips, swim_entries, swim_options
from fishmj.lbm_oracle.run.spread import GoOn, Waiting
from fishmj.lbm_oracle.run.swim import drive, figures
from fishmj.mjcf import load_robot

WHAT = ("cruise", "drag", "broadside", "yaw")
GRIDS, PARTS, SLIPS = (0.02, 0.01, 1 / 150), (1, 2), (0.0, 0.95, 0.98, 0.99, 1.0)
SPEED = 0.3  # m/s
BENT = 20.0  # deg, joints at which the moment is greatest (studies/solver/NOTES.md)
HELD = {"drag": (Point("aoa", 0.0, 0.0, SPEED), "drag_N"), "broadside": (Point("aoa", 0.0, 90.0, SPEED), "lateral_N")}
HELD |= {"yaw": (Point("joint", BENT, 0.0, SPEED), "yaw_Nm")}  # posture, and the column of a force map
TICK: float = constant("timing", "bus_dt")  # s
DIGITS = 7  # of a cell or time step in a key, m or s
COLUMNS = ("what", "dx", "dt", "slip", "value", "sem", "seconds", "wall_s", "status")


class Key(NamedTuple):
    """One run: quantity, cell m, time step s, slip ratio at the paper's grid."""

    what: str
    dx: float
    dt: float
    slip: float


class ConvergenceResult(NamedTuple):
    """Value and standard error in the quantity's unit (NaN: none), seconds of the average, and the reason of an early end."""

    value: float
    sem: float
    seconds: float
    status: str


def study(what: Iterable[str], grids: Iterable[float], parts: Iterable[int], slips: Iterable[float]) -> list[Key]:
    """All runs, the cheap ones first.

    Raises ConfigError: an invalid cell, part or slip, or a time step that does not divide the bus tick.
    """
    courant, tick = constant("oracle", "dt") / constant("oracle", "dx"), TICK
    keys = []
    for dx in sorted(grids, reverse=True):
        for part in sorted(parts):
            if not (dx > 0 and part >= 1):
                raise ConfigError(f"converge: dx = {dx} m, part = {part}; expected a positive cell and parts of 1 or more")
            dt = courant * dx / part
            steps = tick / dt
            if abs(steps - round(steps)) > 1e-6:
                near = f"nearest: dx = {tick / max(1, round(steps)) * part / courant:.6g} m"
                raise ConfigError(f"converge: dx = {dx} m gives dt = {dt:g} s, no whole part of the tick of {tick} s; {near}")
            keys += [Key(name, round(dx, DIGITS), round(tick / round(steps), DIGITS), slip) for slip in slips for name in what]
    return keys


def box(name: str, key: Key, nu: float) -> Domain:
    """Box of that domain on the grid of a key, with the time step as a whole part of the bus tick; nu: viscosity, m2/s."""
    return preset(name).changed(dx=key.dx, dt=TICK / round(TICK / key.dt), nu=nu)


def cruise(domain: Domain, beats: float, options: dict[str, Any]) -> ConvergenceResult:
    """Servo-driven swim from rest; options: those of `SwimSetup`."""
    run = SwimSetup(domain=domain, pose=(0.0, 0.0, 0.0), **options).run()
    gait = Gait.of_the_paper(joints=run.robot.n_joints)
    drive(run, gait, beats / gait.frequency, quiet=True)
    if not run.rows:
        return ConvergenceResult(np.nan, np.nan, 0.0, " ".join(run.stopped.split()))
    last = figures(run, gait.frequency)
    return ConvergenceResult(
        last["speed_m_s"], np.nan, min(2 / gait.frequency, last["seconds"] / 2), " ".join(run.stopped.split()) or OK
    )


def force_when_held(what: str, domain: Domain, plan: AveragingTimes, options: dict[str, Any]) -> ConvergenceResult:
    """Force or moment of the held fish: straight along the stream, straight across it, or bent; options as of `cruise`."""
    point, column = HELD[what]
    robot = load_robot(options["robot"])

    def make(point: Point):
        joints = point.joints(robot.n_joints)
        made = stage(domain, point, **options)
        return made.run(tethered=True, prescribed=lambda t: joints)

    ((_, row, _),) = measure_points(deque([point]), make, plan, tick=robot.timing.bus_dt)
    name, unit = column.split("_")
    return ConvergenceResult(row[column], row[f"{name}_sem_{unit}"], row["seconds"], row["status"])


def on_device(
    waiting: Waiting,
    device: str,
    go_on: GoOn,
    *,
    domain: Callable[[Key], Domain],
    beats: float,
    plan: AveragingTimes,
    edge: Sharpness,
    robot: str,
) -> Iterator[tuple[Key, dict]]:
    """Runs one after another on one device (`spread`): key and row of each."""
    while waiting:
        key, start = waiting.popleft(), time.perf_counter()
        grid = domain(key)
        options = {"robot": robot, "slip": key.slip, "device": device, "sharpness": edge}
        found = cruise(grid, beats, options) if key.what == "cruise" else force_when_held(key.what, grid, plan, options)
        yield key, found._asdict() | {"wall_s": round(time.perf_counter() - start, 1)}


def biases(rows: Iterable[dict]) -> list[dict]:
    """Value on the coarsest grid, its bias relative to the finest, and that of its time step, for every quantity and slip ratio.

    Values are taken at the longest time step of each grid; runs that stopped early are left out.
    """
    sound = [row for row in rows if row["status"] == OK]
    table = []
    for what, slip in sorted({(row["what"], row["slip"]) for row in sound}, key=lambda pair: (WHAT.index(pair[0]), pair[1])):
        mine = {(row["dx"], row["dt"]): row["value"] for row in sound if (row["what"], row["slip"]) == (what, slip)}
        coarse, fine = max(dx for dx, _ in mine), min(dx for dx, _ in mine)
        steps = sorted((dt for dx, dt in mine if dx == coarse), reverse=True)
        longest = {dx: mine[dx, max(dt for other, dt in mine if other == dx)] for dx in (coarse, fine)}
        row = {"what": what, "slip": slip, "dx": coarse, "value": longest[coarse], "finest_dx": fine, "finest": longest[fine]}
        row["bias"] = longest[coarse] / longest[fine] - 1 if fine < coarse else None
        table.append(row | {"dt_effect": mine[coarse, steps[-1]] / mine[coarse, steps[0]] - 1 if len(steps) > 1 else None})
    return table


def main(argv: list[str]) -> int:
    """Runs the verb `converge fish`; returns its exit code."""
    args = _parser().parse_args(argv)
    args.slips = study_slips("lbm_oracle converge fish", args.slips, args.boundary, SLIPS)
    keys = study(args.what, args.grids, args.parts, args.slips)
    robot = load_robot(args.robot)
    plan = AveragingTimes(settle=args.settle, seconds=args.seconds, length=robot.length)
    if "yaw" in args.what and radians(BENT) > robot.servo.range:
        raise ConfigError(
            f"converge: yaw is of joints at {BENT:g} deg, those of {robot.name} turn by less; leave it out of --what"
        )
    held_s = sum(plan.ticks(SPEED, TICK)) * TICK  # refuses what is too short
    setup = {"domain": args.domain, "beats": args.beats, "settle": args.settle, "seconds": args.seconds}
    edge = BOUNDARIES[args.boundary]
    setup |= swim_entries(edge, robot, args.nu)
    book = FinishedRows(Path(args.out) / "converge.csv", COLUMNS, 4, setup, "converge fish")
    left = [key for key in keys if key not in book.rows]
    cruise_s = args.beats / Gait.of_the_paper().frequency
    seconds = lambda key: cruise_s if key.what == "cruise" else held_s
    domain = partial(box, args.domain, nu=args.nu)
    runs = [(domain(key), seconds(key)) for key in left]
    less = "take coarser --grids, fewer --parts and --slips; --domain laptop is a preview"
    solver_cost.agree("lbm_oracle converge fish", args.device, runs, instead=less)
    devices = devices_of(args.device)
    console.say(f"{len(keys)} runs, {len(keys) - len(left)} of them done before, in {args.out}")
    if robot_entry(robot):
        console.say(f"{robot.name}: yaw is taken at {BENT:g} deg, where that of the shipped fish is greatest")
    work = partial(on_device, domain=domain, beats=args.beats, plan=plan, edge=edge, robot=args.robot)
    keep_rows(book, work, left, devices, sum(map(seconds, left)), seconds, "converge", args.json)
    rows = [book.rows[key] for key in keys]
    table, lost = biases(rows), [row for row in rows if row["status"] != OK]
    console.say(console.table(rows, COLUMNS), "", console.table(table))
    for row in lost:
        console.warn(f"{row['what']}, dx {row['dx']:g} m, dt {row['dt']:g} s, slip {row['slip']:g}: {row['status']}")
    if args.json:
        console.emit_json({"rows": rows, "biases": table, "stopped": len(lost), "csv": book.path})
    return console.FAILED_CHECK if lost else console.OK


def _parser() -> console.Parser:
    about = "Cruise speed, drag, broadside force and yaw moment over grid, time step and slip ratio."
    p = console.parser("lbm_oracle converge fish", about)
    add = p.add_argument
    several: dict[str, Any] = {"nargs": "+", "action": console.Distinct}
    add("--what", **several, choices=WHAT, default=list(WHAT), help="quantities")
    grids = "cells; the paper's is 0.02"
    add("--grids", type=console.number(0.001, 0.2), **several, default=list(GRIDS), metavar="M", help=grids)
    parts = "time steps, as parts of the paper's Courant number"
    add("--parts", type=console.whole(1, 100), **several, default=list(PARTS), metavar="N", help=parts)
    swim_options(add, SLIPS)
    add("--domain", choices=EVERY, default="window", help="whose box in metres; _refined: half the cell round the fish")
    settle = "before a force is averaged; by default 5 body lengths of water flow past"
    add("--settle", type=console.number(0, 10_000), metavar="S", help=settle)
    seconds = "averaged over; by default 6 m of water flow past"
    add("--seconds", type=console.number(0, 10_000, above=True), metavar="S", help=seconds)
    add("--out", type=console.out_folder, default="runs/converge", metavar="FOLDER", help="CSV; continues what is there")
    return p
