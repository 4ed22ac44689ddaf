"""`fishmj deploy experiment`: plays named excitations on the robot, three repeats, into a data set for calibration and search."""

import shlex
from argparse import Namespace
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from math import inf
from pathlib import Path
from threading import Event
from typing import Any

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError
from fishmj.base.store import Manifest
from fishmj.deploy.commands.swim_command import flow
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.clock import MonotonicClock
from fishmj.deploy.loop.graceful_stop import steering
from fishmj.deploy.loop.open_loop_experiment import REPEATS, SESSIONS, ExperimentRun, meta_of, placing, play, runs
from fishmj.deploy.loop.swim_loop import Rig, SwimOutcome
from fishmj.deploy.rig.rig_prompt import Person
from fishmj.deploy.tracker.fix import Fix
from fishmj.log import Trial, read_trial, write_trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

Wire = Callable[..., wiring.Wired]
RAW, CUT = "host", "trials"  # folders below --out: the host's whole logs, and what goes into the data set
EXAMPLES = """examples:
  fishmj deploy experiment session --link udp://192.168.1.40 --camera 0 --calibration tank.toml --out data/monday
  fishmj deploy experiment gait chirp --repeats 3 --link loopback --yes --out data/loopback
  fishmj deploy experiment air --medium air --link serial:/dev/ttyUSB0 --out data/bench
the data set is OUT/trials:
  fishmj gap find OUT/trials --model fish --out report          after `session`
  fishmj calibrate servo --data OUT/trials --out fish.toml      after `calibrate` or `air`"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser("deploy experiment", "Named experiments on the robot, open loop, into a data set.", examples=EXAMPLES)
    add = made.add_argument
    named = f"experiments of fishmj.log.excitation, or {', '.join(SESSIONS)}"
    add("names", nargs="+", type=console.text, metavar="NAME", help=named)
    add("--robot", type=console.text, default="fish", help="description: shipped name or TOML file")
    out = "of the session; the same command goes on with it"
    add("--out", type=console.out_folder, required=True, metavar="FOLDER", help=out)
    add("--repeats", type=console.whole(1, 20), default=REPEATS, help=f"of every experiment (default {REPEATS})")
    add("--medium", choices=("water", "air"), default="water", help="air: the fish hangs, no camera is needed")
    about = "m; a run ends where |x| or |y| of the fish goes beyond it, before a wall (default: none)"
    add("--bound", type=console.number(0.1, 100), metavar="M", help=about)
    add("--wait", type=console.number(0.5, 3600), default=10.0, help="s to wait for robot and camera")
    add("--yes", action="store_true", help="ask nobody: only with --link loopback, whose fish is put in place")
    at_the_tank = "arm a robot without a watchdog: a person stands there, a hand on its switch"
    add("--i-am-at-the-tank", action="store_true", help=at_the_tank)
    add("--flow", type=flow, metavar="M/S,DEG", help="the stream, m/s and deg (default: not known)")
    add("--notes", type=console.text, metavar="TEXT", help="a sentence for every meta.toml (default none)")
    wiring.link_options(made)
    wiring.camera_options(made)
    wiring.loopback_options(made)
    return made


def main(argv: list[str], wire: Wire | None = None) -> int:
    """The command. Exit code 0: everything was played; 1: some were not, or a robot did not confirm its torque off.

    wire: opens the devices that the options name, like `wiring.wire` (the default); another one may play in lockstep.
    """
    args = wiring.parsed(options(), argv)
    if args.yes and args.link != "loopback":
        raise ConfigError("experiment: --yes is for --link loopback; a robot in water is put in place by a person")
    if args.medium == "air" and args.link == "loopback":
        raise ConfigError("experiment: the loopback robot swims in water; --medium air is for a robot on its bench")
    robot, person = load_robot(args.robot), Person()
    todo = runs(args.names, args.repeats, robot.n_joints)
    raw, cut = args.out / RAW, args.out / CUT
    done = finished(cut)
    if done:
        console.say(f"{len(done)} of {len(todo)} are there already: going on")
    unplayed: dict[str, str] = {}
    held: list[str] = []  # after which the robot did not say that its torque is off
    stop, at_the_tank = Event(), cache(console.confirmed)  # a person is asked once a session
    kept = lambda: f"{len(done)} trials are in {cut}; {interrupt.again('go on')}"
    for number, run in enumerate(todo):
        if run.name in done:
            continue
        if stop.is_set():
            break
        console.say(f"{number + 1} of {len(todo)}: {run.name}, {run.what.seconds:.1f} s ({run.what.about})")
        with interrupt.keeping(kept):  # while the robot swims, `steering` stands within
            trial, outcome = _played(args, robot, run, free_name(raw, run.name), person, at_the_tank, stop, kept, wire)
            why = outcome.words
            held += [run.name] if outcome.released is False else []
            if trial is None:
                unplayed[run.name] = why
                console.warn(f"{run.name}: {why}")
                continue
            console.say(why)  # whether the torque is off, before anybody reaches into the water
            write_trial(cut / run.name, trial)
            done[run.name] = trial
    if stop.is_set():
        console.warn(f"interrupted; {kept()}")
    console.say(*collect(args.out, done, args.robot))
    if args.json:
        console.emit_json({"trials": sorted(done), "unplayed": unplayed, "torque_not_off": held, "data": cut})
    return console.INTERRUPTED if stop.is_set() else console.FAILED_CHECK if unplayed or held else console.OK


def finished(folder: Path) -> dict[str, Trial]:
    """Trials of a running session."""
    if not folder.is_dir():
        return {}
    return {path.name: read_trial(path) for path in sorted(folder.iterdir()) if (path / "meta.toml").is_file()}


def free_name(folder: Path, name: str) -> Path:
    """An unused folder of this name: an interrupted repeat keeps its log."""
    tries = [folder / name, *(folder / f"{name}.{k}" for k in range(2, 100))]
    return next(path for path in tries if not path.exists())


def collect(out: Path, done: dict[str, Trial], model: str) -> list[str]:
    """Writes the data set's manifest; returns the next steps for the described robot."""
    if not done:
        return ["nothing was played"]
    Manifest.of(out / CUT, {"source": "fishmj deploy experiment"}).write(out / CUT)
    seconds = sum(trial.span[1] for trial in done.values())
    bench = any(t.value("excitation") in SESSIONS["calibrate"] for t in done.values())
    servo = ["calibrate", "servo", "--data", out / CUT, "--model", model, "--out", out / "calibrated.toml"]
    search = ["gap", "find", out / CUT, "--model", model, "--out", out / "report"]
    more = "a search fits one trial and judges another: record more, --repeats 2 or a session"
    after = more if len(done) < 2 and not bench else shlex.join(["fishmj", *map(str, servo if bench else search)])
    return [f"{len(done)} trials, {seconds:.0f} s in {out / CUT}", f"next: {after}"]


def _played(
    args: Namespace, robot: Robot, run: ExperimentRun, folder: Path, person: Person, ask: Callable[[str], bool], stop: Event,
    words: Callable[[], str], wire: Wire | None = None,
) -> tuple[Trial | None, SwimOutcome]:  # fmt: skip
    """One experiment: the fish is put in place, all devices are opened, played and closed.

    Args:
        ask: returns True if a person stands at the tank. stop: set by a signal while the robot swims. words: of `graceful_stop`.
        wire: as `main`.

    Raises ConfigError: the robot has no watchdog and no person stands at the tank; errors of `wiring.wire`.
    """
    given: Any = args
    if args.link == "loopback":
        x, y, yaw = run.what.start
        start = f"--start={x:.6g},{y:.6g},{console.angle_text(yaw)}"
        given = Namespace(**{**vars(args), "loopback": f"{args.loopback or ''} {start}"})
    if not args.yes:
        person.ready(placing(run.what) if args.medium == "water" else "hang the fish by its head, clear of everything")
    with ExitStack() as stack:
        wired = (wire or wiring.wire)(given, robot, stack) if args.medium == "water" else _blind(args, robot, stack)
        rig = Rig.of(wired, robot, None, args.i_am_at_the_tank, ask, "experiment")
        meta = meta_of(robot, args.flow, wired.loopback, args.notes or "")
        if not args.yes:
            person.hands_off(rig)
        with steering(wired.link, wired.clock, stop, words):
            outcome, trial = play(
                rig, run, folder, meta, medium=args.medium, wait=args.wait, stop=stop.is_set, bound=args.bound or inf
            )
    return trial, outcome


class Blind:
    """Replaces a localiser in experiments without a camera."""

    def __init__(self) -> None:
        self.counts = {"frames": 0, "fixes": 0, "skipped": 0}

    def open(self) -> None:
        """Does nothing."""

    def fixes(self, now: float) -> list[Fix]:
        """Returns [], always."""
        return []

    def close(self) -> None:
        """Does nothing."""


def _blind(args: Namespace, robot: Robot, stack: ExitStack) -> wiring.Wired:
    """Opens the link only."""
    clock = MonotonicClock()
    link = wiring.make_link(args, robot, clock, None)
    link.open()
    stack.callback(link.close)
    return wiring.Wired(link, Blind(), clock, False)
