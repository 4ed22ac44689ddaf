"""`fishmj lbm_oracle swim`: a gait in the flow solver, free or tethered; writes a trial folder.

python -m fishmj.lbm_oracle swim --preset laptop --beats 5
python -m fishmj.lbm_oracle swim --tethered --prescribed --speed 0.3 --direction 180 --seconds 4 --out thrust
python -m fishmj.lbm_oracle swim --preset laptop --out runs/a --fields runs/a_fields

Ctrl-C ends the run after the tick that is under way; trial, state and fields up to then are kept.
"""

import shlex
import time
from collections.abc import Callable
from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, OracleUnstable, SimDiverged, StoreError
from fishmj.lbm_oracle.immersed import snapshot
from fishmj.lbm_oracle.output.slices import STRONG, add_fields
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS, preset
from fishmj.lbm_oracle.run.run import LeftDomain, Run
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, boundary_option, cell_option
from fishmj.lbm_oracle.run.time_refinement import TickState, checkpoint, restore
from fishmj.log import write_trial
from fishmj.mjcf import load_robot
from fishmj.water.flow import PRESETS, Flow

INTERRUPTED = "interrupted"  # of `Run.stopped`


def main(argv: list[str]) -> int:
    """Runs the verb `swim`; returns its exit code."""
    args = _parser().parse_args(argv)
    if args.volume and args.fields is None:
        raise ConfigError("lbm_oracle swim: --volume is of --fields; add --fields FOLDER, or leave it out")
    robot, gait = load_robot(args.robot), _gait(args)
    if robot.effects:
        names = ", ".join(fitted.name for fitted in robot.effects)
        console.warn(f"lbm_oracle swim: {robot.name} swims without its effects {names}; evaluate --water lbm has them")
    seconds, tick = args.seconds if args.seconds is not None else args.beats / gait.frequency, robot.timing.bus_dt
    if round(seconds / tick) < 1:
        raise ConfigError(
            f"lbm_oracle swim: {seconds:g} s is shorter than a bus tick of {robot.name}, {tick:g} s; take that or more"
        )
    if not args.prescribed and gait.frequency > (most := 1 / (2 * tick)):
        raise ConfigError(
            f"lbm_oracle swim: --frequency {gait.frequency:g} Hz, but commands of {robot.name} leave every {tick:g} s, which"
            f" shows a servo {most:g} Hz at most; take less, or --prescribed, whose joints follow every step"
        )
    if args.out and args.out.exists() and not args.overwrite:
        raise StoreError(f"{args.out}: exists; choose another --out, or add --overwrite to replace the trial in it")
    stage = _stage(args)
    less = "take a coarser --preset or fewer --seconds; --preset laptop is a preview"
    solver_cost.agree("lbm_oracle swim", args.device, [(stage.domain, seconds)], instead=less)
    beat = lambda t: gait(run.start + t)  # after --start in the phase of the swim before
    run = stage.run(tethered=args.tethered, prescribed=beat if args.prescribed else None, latency=args.latency)
    if args.start is not None:
        snapshot.load(args.start, run.coupled)
        run.begin()
    if args.preset in PREVIEWS:
        console.say(f"{args.preset} is a preview: dx = {run.coupled.fluid.lattice.dx} m is too coarse for a judgement")
    recorder, kept = _recorder(args, run), LastGood() if args.out or args.save else None
    with interrupt.finishing(lambda: _interrupt_message(args, run)):
        wall = drive(run, beat, seconds, quiet=args.json, recorder=recorder, kept=kept)
    if run.stopped == INTERRUPTED:
        kept_in = f"the trial until then is in {args.out}" if args.out else "no trial is kept without --out FOLDER"
        again = f"go on with --start {shlex.quote(str(args.save))}" if args.save else "with --save FILE, --start FILE goes on"
        console.warn(f"{INTERRUPTED} after {run.time:.2f} s; {kept_in}; {again}")
    found = figures(run, gait.frequency) | {"wall_s": wall, "real_time": run.time / wall, "stopped": run.stopped}
    if args.out:
        found["out"] = str(write_trial(args.out, run.trial(), overwrite=args.overwrite))
    if recorder:
        found |= {"fields": str(recorder.folder), "frames": recorder.frames}
    lost = run.stopped.startswith("diverged")
    if lost and kept:
        found["last_good"] = kept.save(args.save or f"{args.out}.last_good.safetensors", run)
    elif args.save and not lost:
        found["state"] = str(snapshot.save(args.save, run.coupled, robot=robot.name))
    console.say(console.table([{"figure": name, "value": value} for name, value in found.items()]))
    if args.json:
        console.emit_json(found)
    if run.stopped == INTERRUPTED:
        return console.INTERRUPTED
    return console.FAILED_CHECK if lost or run.stopped.startswith("fields") else console.OK


def drive(
    run: Run,
    gait: Callable[[float], np.ndarray],
    seconds: float,
    *,
    quiet: bool = False,
    recorder=None,
    kept: "LastGood | None" = None,
) -> float:
    """Swims with a progress line; returns the wall time in s. A run that stops early has the reason in `run.stopped`.

    Args:
        recorder: writes fields between ticks (see `record_fields`).
        kept: keeps the last sound state.
    """
    start, ticks = time.perf_counter(), round(seconds / run.robot.timing.bus_dt)
    bar = console.Progress(seconds, "swim", unit="s", every=1e9 if quiet else None)
    with bar, interrupt.stop_requests(once=True) as asked:
        for n in range(ticks + 1):
            try:
                if recorder:
                    recorder.record(run)
                if n < ticks:
                    run.tick(gait(run.time))
                    if kept:
                        kept.update(run)
            except LeftDomain as error:
                run.stopped = f"{error}"
            except (SimDiverged, OracleUnstable) as error:
                run.stopped = f"diverged: {error}"
            except StoreError as error:
                run.stopped = f"fields: {error}"
            if asked and not run.stopped:
                run.stopped = INTERRUPTED
            if run.stopped and run.stopped != INTERRUPTED:  # which the caller tells, with what is kept
                console.warn(f"stopped after {run.time:.2f} s, everything before is kept: {run.stopped}")
            if run.stopped:
                break
            if n < ticks:
                bar.update(run.time, speed=float(np.hypot(*run.pose[3:5])))
    return time.perf_counter() - start


def _interrupt_message(args, run: Run) -> str:
    """Text for an interrupt during a long tick; writes the trial of the ticks before it, in another thread."""
    if not args.out or not run.rows:
        return "nothing was kept" + ("" if args.out else ": with --out FOLDER the trial is")
    return f"the trial up to then is in {write_trial(args.out, run.trial(), overwrite=args.overwrite)}"


def _recorder(args, run: Run):
    """Recorder of the fields, or None."""
    if args.fields is None:
        return None
    from fishmj.lbm_oracle.output.record_fields import FieldRecorder

    options = {"every": args.every, "z": args.slice, "whole": args.volume, "overwrite": args.overwrite}
    return FieldRecorder(args.fields, run, strong=args.strong, **options)


def figures(run: Run, frequency: float) -> dict:
    """Speed over ground, direction, yaw and power over the last two beats (or all there is), and the mean force on the fish.

    `course` is the direction of the path; `thrust` the mean force along the heading, of interest for a tethered fish.
    """
    table = run.trial().tables
    truth, wrench, power = table["truth"], table["wrench"], table.get("power")
    beats = 2 / frequency
    last = truth["t"] > truth["t"][-1] - min(beats, truth["t"][-1] / 2) - 1e-9
    x, y, t = truth["x"][last], truth["y"][last], truth["t"][last]
    yaw, span = truth["yaw"][last], max(t[-1] - t[0], 1e-9)
    mean_yaw = float(np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean()))
    fx, fy = (sum(wrench[name][last] for name in wrench if name[0] == "f" and name.endswith(axis)) for axis in "xy")
    return {
        "seconds": float(truth["t"][-1]),
        "speed_m_s": float(np.hypot(x[-1] - x[0], y[-1] - y[0]) / span),
        "course_deg": degrees(float(np.arctan2(y[-1] - y[0], x[-1] - x[0]))),
        "heading_deg": degrees(mean_yaw),
        "yaw_amplitude_deg": degrees(float(np.ptp(yaw)) / 2),
        "yaw_rate_deg_s": degrees(float((yaw[-1] - yaw[0]) / span)),
        "thrust_N": float((fx * np.cos(mean_yaw) + fy * np.sin(mean_yaw)).mean()),
        "power_W": float((power["V"] * power["I"])[last].mean()) if power else None,
        "refined_ticks": run.refined,
        "fastest_water_m_s": run.watch.fastest,
    }


def _gait(args) -> Gait:
    one = lambda values: tuple(radians(v) for v in values) if len(values) > 1 else radians(values[0])
    wave: dict[str, Any] = {"amplitude": one(args.amplitude), "lag": radians(args.lag), "bias": one(args.bias), "ramp": args.ramp}
    return Gait(joints=load_robot(args.robot).n_joints, frequency=args.frequency, **wave)


def _stage(args) -> SwimSetup:
    domain = preset(args.preset).changed(depth=args.depth, dx=args.dx, dt=args.dt, bottom=args.bottom)
    flow = Flow(
        speed=args.speed, direction=radians(args.direction), turbulence=args.turbulence, intensity=args.intensity, seed=args.seed
    )
    x, y, yaw = args.pose
    fish = console.settings_of(args, SwimSetup) | {"pose": (x, y, radians(yaw)), "sharpness": BOUNDARIES[args.boundary]}
    return SwimSetup(domain=domain, flow=flow, device=args.device, **fish)


def _parser() -> console.Parser:
    p = console.parser("lbm_oracle swim", "A gait in the flow solver; writes a trial folder.")
    add, angle = p.add_argument, console.number(-360, 360)
    box = "box of water; laptop is a preview, _refined has finer cells round the fish"
    add("--preset", choices=EVERY, default="window", help=box)
    console.add_settings(p, SwimSetup, "robot")
    add("--device", type=console.device, default="auto", help=console.DEVICE_HELP)
    add("--frequency", type=console.number(0.01, 20), default=1.0, metavar="HZ", help="of the beat")
    bend = console.number(-180, 180)
    add("--amplitude", type=bend, nargs="+", default=[30.0], metavar="DEG", help="of the joints: one, or one a joint")
    add("--lag", type=angle, default=60.0, metavar="DEG", help="from joint to joint")
    add("--bias", type=bend, nargs="+", default=[0.0], metavar="DEG", help="mean of the joints: one, or one a joint")
    add("--ramp", type=console.number(0, 100), default=1.0, metavar="S", help="smooth start")
    add("--beats", type=console.number(0, 10_000, above=True), default=5.0, help="of the swim")
    seconds = "of the swim; by default so many as --beats take"
    add("--seconds", type=console.number(0, 10_000, above=True), metavar="S", help=seconds)
    add("--prescribed", action="store_true", help="joints follow the gait to the letter, without servos")
    add("--tethered", action="store_true", help="the root does not move")
    console.add_settings(p, SwimSetup, "root", "slip")
    boundary_option(add)
    add("--speed", type=console.number(0, 4), default=0.0, help="of the current, m/s")
    add("--direction", type=angle, default=180.0, metavar="DEG", help="where the water moves to")
    add("--turbulence", choices=PRESETS, default="none", help="of the current")
    add("--intensity", type=console.number(0, 0.99), default=0.05, help="of the turbulence: u_rms / max(speed, 0.1 m/s)")
    add("--seed", type=console.SEED, default=0, help="of the turbulence")
    place = console.number(-360, 360)
    add("--pose", type=place, nargs=3, default=[0.0, 0.0, 0.0], metavar=("X", "Y", "DEG"), help="start of the fish: m, m, deg")
    add("--depth", type=console.number(0.05, 10), metavar="M", help="of the water; by default the domain's")
    add("--bottom", choices=("slip", "wall"), default="slip", help="of the water")
    cell_option(add)
    add("--dt", type=console.number(1e-5, 0.1), metavar="S", help="another time step; by default the domain's")
    add("--latency", type=console.number(0, 10), metavar="S", help="of commands; the robot's by default")
    console.add_settings(p, SwimSetup, "width", "passes", "hydro_offset")
    add("--start", type=console.path, metavar="FILE", help="continue from a saved state; by default from rest")
    add("--save", type=console.out_file, metavar="FILE", help="save the state at the end, in place of an old one; by default not")
    out = "trial folder to write; by default none; one that is there is refused without --overwrite"
    add("--out", type=console.out_folder, metavar="FOLDER", help=out)
    add("--overwrite", action="store_true", help="trial and fields of another run are replaced")
    add_fields(p)
    add("--every", type=console.number(0, 1000, above=True), default=0.1, metavar="S", help="between two frames of the fields")
    strong = "vorticity at the ends of the colour scale"
    add("--strong", type=console.number(0, 1e6, above=True), default=STRONG, metavar="1/S", help=strong)
    return p


class LastGood:
    """Keeps the last sound state of a run, at most two surveys of the watch old: for a look at a failure, or a restart with
    a smaller step.

    A state is sound if the watch found the water well *after* it. The newest state since the last survey is a candidate; the next
    survey makes it the last good one. Both stay on the device until they are needed: 164 bytes a cell of every level.
    """

    def __init__(self) -> None:
        self.good: TickState | None = None
        self.candidate: TickState | None = None
        self.looks = 0

    def update(self, run: Run) -> None:
        """Updates the states; call it after every tick."""
        if run.watch.looks > self.looks or self.candidate is None:
            self.looks, self.good = run.watch.looks, self.candidate
            self.candidate = checkpoint(run.coupled)

    def save(self, path: str | Path, run: Run) -> str:
        """Puts the run back to its last good state and writes it; returns "" if there is none: the water failed at once."""
        if self.good is None:
            return ""
        restore(run.coupled, self.good)
        notes = {"robot": run.robot.name, "stopped": run.stopped, "last_good": True}
        return str(snapshot.save(path, run.coupled, **notes))
