"""`fishmj deploy trials`: guides a person and a robot through the 72 trials of the protocol; writes the tables of `evaluate`."""

import shlex
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from threading import Event
from typing import Any
from zlib import crc32

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.deploy.commands.swim_command import (
    meta_of,
    policy_option,
    swim_options,
    target_warnings,
    undisturbed,
    warn_of_training,
)
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.graceful_stop import steering
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.deploy.loop.status import StatusLine
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimOutcome, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.monitor.live import LiveMonitor, MonitorProcess, watched_of
from fishmj.deploy.rig.rig_experiment import free_name
from fishmj.deploy.rig.rig_prompt import Person
from fishmj.deploy.trials import trials_tables
from fishmj.deploy.trials.schedule import HOST, KEPT, Place, Session, condition_of, counts, order, stream_direction, waters_of
from fishmj.evaluate import protocol
from fishmj.evaluate.protocol import MeasuredTrials
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import robot_sha256
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow_map.flow_map import FlowMap, TankWater

Wire = Callable[[Any, Robot, ExitStack], wiring.Wired]
TRIES = 3  # of a trial that --yes repeats before it is skipped
SETTLE = 60.0  # s that the water takes to settle behind a new setting of the pump, said to the person
BESIDE = "beside"  # folder of a session that evaluations are looked for in
EXAMPLES = """examples:
  fishmj deploy trials --policy station --link udp://HOST --camera 0 --calibration tank.toml --flow-map map.toml --out data/trials
  fishmj deploy trials --policy station --speeds 0.2 --los 0,180 --repeats 1 --link loopback --yes --out runs/trials
  fishmj deploy trials --policy station --out data/trials --tables --beside runs/fitted runs/solver --plots
the same command goes on where it was; other waters: fishmj evaluate station --flow-map tank_flow.toml --out runs/fitted"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser(
        "deploy trials", "The 72 trials of the protocol on the robot, into the tables of evaluate.", examples=EXAMPLES
    )
    policy_option(made, required=True)
    swim_options(made)
    add = made.add_argument
    about = "of the session: its logs, trials and tables; the same command goes on with it"
    add("--out", type=console.out_folder, required=True, metavar="FOLDER", help=about)
    mapped = "of fishmj deploy flow-map: the pump's setting for each speed, TI and length scale (default: not known)"
    add("--flow-map", type=console.path, metavar="FILE", help=mapped)
    moves = "where the water moves to in the tank (default: as the flow map says, else 0, along x)"
    add("--direction", type=console.angle, metavar="DEG", help=moves)
    add("--speeds", type=console.Listed(console.number(0, 1)), metavar="M/S,..", help="of the water; default 0.1,0.2,0.3")
    los = console.Listed(console.number(-360, 360), 360, same=lambda degrees: degrees % 360)
    add("--los", type=los, metavar="DEG,..", help="lines of sight at the start: 0 straight upstream; default 0,45,..,315")
    add("--repeats", type=console.whole(1, protocol.MOST), metavar="N", help="trials of every speed and direction; default 3")
    add("--duration", type=console.number(1, 600), metavar="S", help="of a trial; default 60")
    add("--seed", type=console.SEED, default=0, help="of the trials, as of evaluate")
    add("--yes", action="store_true", help="ask nobody, and swim in lockstep, faster than real time: only with --link loopback")
    add("--retry", action="store_true", help="ask again for trials that were skipped")
    add("--tables", action="store_true", help="swim nothing: write the tables of what is there")
    other = f"folders of fishmj evaluate --out with the same trials in other waters (default those in OUT/{BESIDE})"
    add("--beside", nargs="+", type=console.path, metavar="FOLDER", help=other)
    add("--plots", action="store_true", help="pictures of the robot's trials in the report, with Matplotlib")
    return made


def main(argv: list[str], in_step: Wire | None = None) -> int:
    """The command. Exit code 0: every trial is there; 1: some were skipped, or are still to do.

    in_step: opens the loopback robot in lockstep, for --yes.
    """
    args = wiring.parsed(options(), argv)
    if args.yes and args.link != "loopback":
        raise ConfigError("trials: --yes is for --link loopback; a robot in water is put in place by a person")
    for option, ours in (("--flow", "--speeds and --direction"), ("--start", "--los")):
        if option in [word.partition("=")[0] for word in (args.loopback or "").split()]:
            raise ConfigError(f"trials: --loopback with {option}, which every trial sets by {ours}; leave {option} out")
    robot = load_robot(args.robot)
    controller = LearnedController(robot, args.policy, args.anyway)
    flow_map = None if args.flow_map is None else FlowMap.read(args.flow_map)
    made = partial(
        protocol.trials, speeds=args.speeds, los_deg=args.los, repeats=args.repeats, seed=args.seed, duration=args.duration
    )
    waters = waters_of(flow_map, made().speed.tolist())
    trials = made(direction=stream_direction(waters) if args.direction is None else args.direction)
    if flow_map is None:
        console.warn("trials: no --flow-map: the speeds are what the person says, and the turbulence is not known")
    what = {"policy_sha256": controller.sha256, "robot_sha256": robot_sha256(robot), "duration": trials.duration}
    what |= {"seed": args.seed, "direction": round(trials.direction, 6)}
    what |= {} if args.tables else {"simulated": args.link == "loopback"}  # tables take it from the session
    session, places = Session(args.out, what), order(trials)
    if args.retry and session.skipped:
        session.again()
    if not args.tables:
        session.save()
        warn_of_training(controller, robot)
        walk = Walk(args, robot, controller, waters, session, places, in_step)
        walk.through()
        if walk.stop.is_set():
            console.warn(f"interrupted; {walk.kept_words()}")
            return console.INTERRUPTED
    return tables(args, robot, controller, trials_tables.measured_trials(trials, waters), session, places)


class Walk:
    """Runs the remaining trials.

    Attributes:
        stop: set by a signal while a robot swims. monitor: the monitor's process, which learns from the healthy swims once.
    """

    def __init__(
        self, args: Namespace, robot: Robot, controller: LearnedController, waters: Mapping[float, TankWater], session: Session,
        places: Sequence[Place], in_step: Wire | None,
    ):  # fmt: skip
        self.args, self.robot, self.controller, self.waters = args, robot, controller, waters
        self.session, self.places, self.person = session, places, Person()
        self.wire: Wire = in_step if args.yes and in_step is not None else wiring.wire
        self.watched = watched_of(args, robot, (0.0, 0.0), args.duration or constant("protocol", "duration"))
        self.stop, self.at_the_tank = Event(), cache(console.confirmed)  # a person is asked once a session
        self.monitor = MonitorProcess()
        self._speed: float | None = None

    def through(self) -> None:
        """Swims every trial that is neither accepted nor skipped; a person may stop at every question."""
        left = self.session.left(self.places)
        if len(left) < len(self.places):
            console.say(f"{len(self.places) - len(left)} of {len(self.places)} are there already: going on")
        with self.monitor, console.Progress(max(len(left), 1), "trials", "trials") as bar:
            for number, place in enumerate(left):
                if self.stop.is_set():
                    return
                with interrupt.keeping(self.kept_words):
                    bar.update(number, next=place.name)
                    self._one(place)

    def kept_words(self) -> str:
        """Text of what is kept, and the command that goes on."""
        return f"{len(self.session.accepted)} trials are in {self.session.folder / KEPT}; {interrupt.again('go on')}"

    def _one(self, place: Place) -> None:
        """Repeats one trial until it is accepted or skipped."""
        spec, tries = place.spec, 0
        console.say(f"{place.name}: {spec.speed:g} m/s, target {np.degrees(spec.los):.0f} deg from upstream")
        while not self.stop.is_set():
            tries += 1
            folder = free_name(self.session.folder / HOST, place.name)
            if not self.args.yes:
                self._pump(spec.speed)
                self._put(place)
            outcome = self._swum(place, folder)
            if self.stop.is_set():
                return
            if self.args.yes and not outcome.cause and outcome.refused:
                raise ConfigError(f"trials: {outcome.words}")
            console.say(outcome.words)  # whether the torque is off, before anybody reaches into the water
            answer = self._answer(outcome, tries)
            if answer == "accept":
                self.session.accept(place.name, folder, self.args.duration or constant("protocol", "duration"))
                return
            if answer == "skip":
                self.session.skip(place.name, outcome.words)
                return

    def _pump(self, speed: float) -> None:
        """Asks for another setting of the pump when the speed changes."""
        if speed == self._speed:
            return
        water, how = self.waters.get(speed), f"set the pump so that the water moves at {speed:g} m/s"
        if water is not None:
            length = "" if water.length is None else f", L {water.length:.2f} m"
            how = f"set the pump to {water.pump:.4g} ({speed:g} m/s, TI {100 * water.intensity:.1f} %{length})"
        self.person.ready(f"{how} and wait until the water has settled, {SETTLE:.0f} s or so")
        self._speed = speed

    def _put(self, place: Place) -> None:
        x, y = (round(value, 2) + 0.0 for value in place.start[:2])  # + 0.0: never -0.00
        heading = round(float(np.degrees(place.start[2]))) % 360
        self.person.ready(f"put the fish at x = {x:.2f} m, y = {y:.2f} m, heading {heading} deg, straight and at rest")

    def _answer(self, outcome: SwimOutcome, tries: int) -> str:
        """The operator's answer: accept, repeat or skip."""
        whole = counts(outcome)
        if self.args.yes:
            return "accept" if whole else "repeat" if tries < TRIES else "skip"
        usual, asked = ("accept", "Enter accepts, r repeats") if whole else ("repeat", "no trial: Enter repeats")
        while True:
            answer = self.person.asked(f"{asked}, s skips it, q stops:").lower()
            if answer in ("", "r", "s"):
                return {"": usual, "r": "repeat", "s": "skip"}[answer]

    def _swum(self, place: Place, folder: Path) -> SwimOutcome:
        """Opens all devices, swims, and closes them.

        Raises ConfigError: no person at a tank that needs one; the robot does not arm; errors of `wiring.wire`.
        """
        args, water = self.args, self.waters.get(place.spec.speed)
        stream = (place.spec.speed, float(self.session.what["direction"]))
        seconds = args.duration or constant("protocol", "duration")
        x, y, yaw = place.start
        given: Any = Namespace(**{**vars(args), "flow": stream, "target": place.target})
        if args.link == "loopback":
            words = args.loopback or ""
            if "--seed" not in words:  # each trial its own robot, noise and gusts, where the person names no seed
                words += f" --seed={robot_seed(args.seed, place.name)}"
            words += f" --start={x:.6g},{y:.6g},{console.angle_text(yaw)}"
            given.loopback = f"{words} --flow={stream[0]:.6g},{console.angle_text(stream[1])}"
        watched = None if self.watched is None else replace(self.watched, flow=stream)
        with ExitStack() as stack:
            wired = self.wire(given, self.robot, stack)
            rig = Rig.of(wired, self.robot, self.controller, args.i_am_at_the_tank, self.at_the_tank, "trials")
            if not args.yes:
                self.person.hands_off(rig)
            meta = {**meta_of(given, self.robot, self.controller, wired), **condition_of(place, water)}
            for warning in target_warnings(place.target, args.bound, wired.calibration):
                console.warn(warning)
            log = stack.enter_context(TrialLog(folder, meta, self.robot.n_joints))
            status = StatusLine(seconds, quiet=args.yes)
            if watched is not None:
                stack.enter_context(LiveMonitor(watched, log, say=status.warn, stopped=self.stop.is_set, process=self.monitor))
            plan = SwimPlan(target=place.target, seconds=seconds, wait=args.wait, bound=args.bound)
            swim = SwimLoop(rig, PolicyPilot(self.controller), plan, log, stop=self.stop.is_set, status=status)
            with undisturbed(), steering(wired.link, wired.clock, self.stop, self.kept_words):
                return swim.run()


def robot_seed(seed: int, name: str) -> int:
    """Seed of the loopback robot of a trial, independent of the other trials."""
    return crc32(f"{seed} {name}".encode())


def same_trials(args: Namespace) -> str:
    """Options of `fishmj evaluate` that make the same trials."""
    several = {"speeds": args.speeds, "los": args.los}
    given = {name: ",".join(f"{value:g}" for value in values) for name, values in several.items() if values}
    given |= {name: f"{value:g}" for name, value in (("repeats", args.repeats), ("duration", args.duration)) if value}
    given |= {"seed": str(args.seed)} if args.seed else {}
    given |= {"robot": args.robot} if args.robot != "fish" else {}
    given |= {"flow-map": str(args.flow_map)} if args.flow_map else {}
    return "".join(f" --{name} {shlex.quote(value)}" for name, value in given.items())


def tables(
    args: Namespace,
    robot: Robot,
    controller: LearnedController,
    trials: MeasuredTrials,
    session: Session,
    places: Sequence[Place],
) -> int:
    """Judges the accepted trials; prints the tables and writes files into the session's folder. Returns the exit code."""
    from fishmj.evaluate import trial_report

    logs: dict[str, Trial] = session.read(places)
    simulated = bool(session.what.get("simulated"))
    engine = trials_tables.LOOPBACK if simulated else trials_tables.TANK
    name = f"{controller.name}, {'loopback robot' if simulated else 'robot'}"
    own = trials_tables.result_of(name, controller.sha256, robot, trials, places, logs, engine)
    own = own._replace(policy=controller.trained(robot, in_tank=True))
    given = args.beside if args.beside is not None else sorted(p.parent for p in (session.folder / BESIDE).glob("*/trials.csv"))
    results = [own, *(trials_tables.beside(folder, controller.name, own) for folder in given)]
    notes = [*trials_tables.lacking(own, logs, len(places)), *trials_tables.waters_beside(given)]
    replay = trials_tables.worst_replay(session.folder, own, places, args.robot)
    found, lacks = trials_tables.written(session.folder, results, notes, plots=args.plots, replay=replay)
    summaries = found["results"]
    trial_report.say_tables(results[: len(summaries)], summaries, [found["condition"]], summaries[:1])
    for line in lacks:
        console.warn(line)
    console.say("", f"wrote {session.folder / 'report.html'}")
    unswum = [place.name for place in places if place.name not in logs]
    for place_name in unswum:
        if place_name in session.skipped:
            console.warn(f"{place_name} was skipped: {session.skipped[place_name]}")
    if len(results) == 1:
        policy = f"{shlex.quote(str(args.policy))}{same_trials(args)} --log"
        fitted, solved = (shlex.quote(str(session.folder / BESIDE / name)) for name in ("simulated", "solver"))
        console.say(
            "the same trials in simulated water, for the next tables:",
            f"  fishmj evaluate {policy} --out {fitted}",
            f"  fishmj evaluate {policy} --water lbm --out {solved}",
        )
    if args.json:
        console.emit_json({**found, "trials": sorted(logs), "skipped": session.skipped, "missing": unswum, "out": session.folder})
    return console.FAILED_CHECK if unswum else console.OK
