"""`fishmj deploy swim`: a policy or a sine gait on a robot, or on the loopback robot; leaves a trial folder."""

import gc
import sys
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UsageError
from fishmj.base.source import made_by
from fishmj.control.learned import LearnedController
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.graceful_stop import steering
from fishmj.deploy.loop.open_loop_experiment import SineGait
from fishmj.deploy.loop.pilot import Pilot, PlayedPilot, PolicyPilot
from fishmj.deploy.loop.status import StatusLine
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimOutcome, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog, refuse_taken
from fishmj.deploy.monitor.live import LiveMonitor, Watched, monitor_options, watched_of
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import identity
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow_map.flow_map import FlowMap

SWITCH = 5e-4  # s that another thread may keep the loop waiting where it holds the interpreter; Python's own 5 ms are too long
HERE = (0.0, 0.0)  # m, the target where none is said
BOUND = constant("task", "bound")  # m
APART = 0.01  # m between a place and where its pixel is: farther apart, the lens was not calibrated there
EXAMPLES = """examples:
  fishmj deploy swim --policy station --link loopback --camera loopback --seconds 30
  fishmj deploy swim --policy station --link udp://192.168.1.40 --camera 0 --calibration tank.toml --out runs/swim_01
  fishmj deploy swim --gait 1,20,60 --link udp://192.168.1.40 --camera 0 --calibration tank.toml --out runs/gait_01
  fishmj deploy swim --policy station --link serial:/dev/ttyUSB0 --camera 0 --calibration tank.toml --i-am-at-the-tank"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser(
        "deploy swim", "A policy or a sine gait swims the robot: camera, 50 Hz bus, supervisor, trial folder.", examples=EXAMPLES
    )
    pilots = made.add_mutually_exclusive_group()
    policy_option(pilots)
    beat = "in place of --policy: joint k beats with A sin(2 pi f t - k lag) + bias, a negative bias turns left (default: none)"
    pilots.add_argument("--gait", type=gait, metavar="HZ,AMPLITUDE_DEG,LAG_DEG[,BIAS_DEG]", help=beat)
    swim_options(made)
    add = made.add_argument
    add("--target", type=place, default=HERE, metavar="X,Y", help="where to hold station, m in the tank (default 0,0)")
    add("--seconds", type=console.number(1, 36000), default=30.0, help="how long policy or gait steers")
    add("--out", type=console.out_folder, metavar="FOLDER", help="trial folder, must not exist (default runs/swim-DATE-TIME)")
    stream = "the stream, m/s and deg, or MAP@SETTING of a flow map and its pump (default: not known)"
    add("--flow", type=flow, metavar="M/S,DEG", help=stream)
    add("--mcap", action="store_true", help="also write the trial as MCAP beside its folder, for Foxglove")
    add("--ros", type=wiring.address(9090), metavar="HOST[:PORT]", help="publish to a rosbridge while it swims (default: not)")
    return made


def policy_option(parser: Any, **how: bool) -> None:
    """Adds the option --policy to a parser or to a group of one."""
    about = "shipped policy, policy file, or folder of a training" + ("" if how else " (default: none)")
    parser.add_argument("--policy", type=console.text, metavar="NAME", help=about, **how)


def swim_options(parser: console.Parser) -> None:
    """Adds the options of every swim: of one (`deploy swim`) and of many (`deploy trials`)."""
    add = parser.add_argument
    add("--robot", type=console.text, default="fish", help="description: shipped name or TOML file")
    about = f"m; a fish with |x| or |y| beyond it is stopped, a trial then failed (default {BOUND:g}, as far as it was trained)"
    add("--bound", type=console.number(0.1, 100), default=BOUND, metavar="M", help=about)
    add("--wait", type=console.number(0.5, 3600), default=10.0, metavar="S", help="to wait for robot and camera")
    at_the_tank = "arm a robot without a watchdog: a person stands there, a hand on its switch (default: ask)"
    add("--i-am-at-the-tank", action="store_true", help=at_the_tank)
    add("--anyway", action="store_true", help="let the policy steer on another command path than it was trained on")
    add("--notes", type=console.text, metavar="TEXT", help="a sentence for meta.toml (default none)")
    monitor_options(parser)
    wiring.link_options(parser)
    wiring.camera_options(parser)
    wiring.loopback_options(parser)


def main(argv: list[str], wire: Callable[..., wiring.Wired] | None = None) -> int:
    """The command. Exit code 0: swam to the end; 1: a condition ended it; 2: not armed, or bad input.

    wire: opens the devices that the options name, like `wiring.wire` (the default); another one may swim in lockstep.
    """
    args = wiring.parsed(options(), argv)
    robot = load_robot(args.robot)
    controller, pilot = pilot_of(args, robot)
    out = args.out or Path("runs") / f"swim-{datetime.now():%Y%m%d-%H%M%S}"
    refuse_taken(out)
    watched = watched_of(args, robot, args.flow, args.seconds)
    with undisturbed():
        outcome = _swum(args, robot, controller, pilot, out, wire or wiring.wire, watched)
    if stopped := interrupt.asked():
        kept = f"what was swum is in {out}" if outcome.cause else "nothing was swum"
        console.warn(f"interrupted; {kept}; another swim needs another --out")
    elif not outcome.cause and outcome.refused:
        raise ConfigError(f"swim: {outcome.words}")
    mcap = write_mcap(out, robot) if args.mcap and outcome.cause else None
    console.say(f"{outcome.words}; log in {out}" + (f", {mcap}" if mcap else "") if outcome.cause else outcome.words)
    if args.json:
        result: dict[str, Any] = {
            "complete": outcome.complete,
            "torque_off": outcome.released,
            "swum_s": round(outcome.swim_seconds, 3),
            "ended_by": outcome.words,
            "out": out,
        }
        console.emit_json({**result, "mcap": mcap, "figures": outcome.figures})
    if stopped:
        return console.INTERRUPTED
    return console.OK if outcome.complete and outcome.released is not False else console.FAILED_CHECK


@contextmanager
def undisturbed() -> Iterator[None]:
    """Context in which neither another thread nor garbage collection delays the loop for long."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()  # what is loaded now stays: looking through it again would cost a tick 10 ms
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


def warn_of_training(controller: LearnedController, robot: Robot) -> None:
    """Prints the differences between the policy's training and this robot."""
    for what, (there, here) in controller.trained(robot, in_tank=True)["differs"].items():
        console.warn(f"policy {controller.name}: trained with another {what} ({there}, here {here})")


def pilot_of(args: Any, robot: Robot) -> tuple[LearnedController | None, Pilot]:
    """The policy that the options name and its pilot; (None, pilot) for a gait.

    Raises UsageError: neither; ConfigError: no such policy, one for another robot, or a gait that this robot cannot follow.
    """
    if args.gait is None and args.policy is None:
        raise UsageError("deploy swim: one of --policy NAME and --gait HZ,AMPLITUDE_DEG,LAG_DEG[,BIAS_DEG] is needed")
    if args.gait is None:
        controller = LearnedController(robot, args.policy, args.anyway)
        warn_of_training(controller, robot)
        return controller, PolicyPilot(controller)
    if args.anyway or args.target != HERE:
        raise ConfigError(f"--gait: {'--anyway' if args.anyway else '--target'} is for --policy; a gait steers to nowhere")
    return None, PlayedPilot(args.gait.commands(robot, args.seconds))


def _swum(
    args: Any, robot: Robot, controller: LearnedController | None, pilot: Pilot, out: Path,
    wire: Callable[..., wiring.Wired], watched: Watched | None,
) -> SwimOutcome:  # fmt: skip
    """Opens all devices, swims, and closes them in every case."""
    with ExitStack() as stack:
        wired = wire(args, robot, stack)
        rig = Rig.of(wired, robot, controller, args.i_am_at_the_tank, console.confirmed)
        log = stack.enter_context(TrialLog(out, meta_of(args, robot, controller, wired), robot.n_joints))
        if args.ros:
            from fishmj.deploy.link.ros import RosPublisher

            stack.enter_context(RosPublisher(args.ros, log))
        for warning in target_warnings(args.target, args.bound, wired.calibration):
            console.warn(warning)
        stop = Event()
        plan = SwimPlan(target=args.target, seconds=args.seconds, wait=args.wait, bound=args.bound)
        status = StatusLine(args.seconds)
        swim = SwimLoop(rig, pilot, plan, log, stop=stop.is_set, status=status)
        if watched is not None:
            stack.enter_context(LiveMonitor(watched, log, say=status.warn, stopped=stop.is_set))

        def kept() -> str:
            log.close("interrupted")
            return f"what was swum is in {out}"

        with steering(wired.link, wired.clock, stop, kept) as first:
            log.meta["host"]["first_in_line"] = first
            return swim.run()


def target_warnings(target: tuple[float, float], bound: float, calibration: Calibration | None) -> list[str]:
    """Warnings about a target (x, y) m: beyond the bound, m, or outside the camera's view."""
    warnings, place = [], "{:g}, {:g} m".format(*target)
    if max(map(abs, target)) > bound:
        warnings.append(f"--target {place}: beyond --bound {bound:g}; the fish is stopped before it gets there")
    if calibration is not None:
        pixel = calibration.to_pixel([target])
        back = calibration.to_tank(pixel)[0]
        inside = bool(np.all((pixel[0] >= 0) & (pixel[0] <= np.array(calibration.size) - 1)))
        if not inside or np.hypot(*(back - target)) > APART:
            warnings.append(f"--target {place}: outside of the camera's picture; the pose is lost before the fish gets there")
    return warnings


def meta_of(args: Any, robot: Robot, controller: LearnedController | None, wired: wiring.Wired) -> dict:
    """Meta data of the trial that are known before the swim."""
    speed, direction = args.flow or (0.0, 0.0)
    meta = {
        "origin": "synthetic" if wired.loopback else "measured",
        **identity(robot),
        "medium": "water",
        "water": "loopback" if wired.loopback else "tank",
        "flow": {"speed": speed, "direction": direction, "known": args.flow is not None},
        "excitation": "policy" if controller else args.gait.name,
        "replicate_of": "",
        "controller": controller.name if controller else "open loop",
        "policy_sha256": controller.sha256 if controller else "",
        "target": list(args.target),
        "seed": 0,
        "notes": args.notes or "",
        "licence": "",
        "source": "fishmj deploy swim",
        **made_by("numpy"),
        "host": {
            "opened": {"link": args.link, "camera": args.camera or "", "loopback": args.loopback or ""},
            "protocol": wired.link.name,
            "lacks": list(wired.link.lacks),
        },
    }
    return meta if controller else {**meta, "gait": args.gait._asdict()}


def write_mcap(folder: Path, robot: Robot) -> Path:
    """Writes FOLDER.mcap beside a trial folder, for Foxglove, with the links of its robot.

    Raises MissingExtra: mcap is not installed; StoreError: the file is there, or the disk refuses.
    """
    from fishmj.log.export import export
    from fishmj.mjcf.drawing import solids

    out = folder.with_name(f"{folder.name}.mcap")
    export(folder, "mcap", out, shape=lambda trial: solids(robot))
    return out


def place(text: str) -> tuple[float, float]:
    """Parses `0.3,-0.2`: x and y in the tank, m. Raises ArgumentTypeError."""
    x, y = console.numbers("X,Y such as 0.3,-0.2 (m)", (-100, 100), (-100, 100))(text)
    return x, y


def flow(text: str) -> tuple[float, float]:
    """Speed, m/s, and direction, rad, of a stream: `0.2,180` (m/s, deg), or `tank_flow.toml@22.5`, a flow map at a pump setting.

    Raises ArgumentTypeError: neither; ConfigError: a map that cannot be read, or a setting outside of it.
    """
    path, mark, setting = text.rpartition("@")
    if mark:
        water = FlowMap.read(console.path(path)).at(console.number(-1e6, 1e6)(setting))
        return water.speed, water.direction
    speed, direction = console.flow(2)(text)
    return speed, direction


def gait(text: str) -> SineGait:
    """Parses `1,20,60` or `1,20,60,-10`: Hz, amplitude, lag and bias in deg. Raises ArgumentTypeError."""
    parts = text.split(",")
    if len(parts) not in (3, 4):
        raise ArgumentTypeError(f"got {text[:40]!r}, expected HZ,AMPLITUDE_DEG,LAG_DEG[,BIAS_DEG] such as 1,20,60")
    return SineGait(*(console.number(-360, 360)(part) for part in parts))
