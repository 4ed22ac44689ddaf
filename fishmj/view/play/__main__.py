"""`python -m fishmj play`: one fish live in MeshCat; the arrow keys set the current, w a s d move the target.

    keys -> current, target      every 0.2 s: observe -> controller -> engine (10 bus ticks) -> MeshCat at 25 pictures a second

The fish meets the same noise, latencies and water as in the tasks; it does not sense the current that you make.
"""

import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

from fishmj import control, engines
from fishmj.base import console, interrupt
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.control.policy import BEST
from fishmj.lbm_oracle.run.domain import NAMES
from fishmj.log import write_trial
from fishmj.log.trial_folder import META_FILE
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.view.play.live_session import Keyboard, LiveSession, press
from fishmj.view.replay.live_view import LOCAL, LiveView, check_host
from fishmj.water import choice
from fishmj.water.flow import PRESETS, Flow

FRAME = 0.04  # s between two pictures
LATE = 0.2  # s behind real time from which on pictures are skipped
KEYS = """keys: up, down   current faster, slower            w a s d   target up, left, down, right in the tank
      left, right  turn the current by 15 deg      space     pause        c  next controller
      r  start again                               q         quit"""
EXAMPLES = f"""examples:
  fishmj play                                   the best shipped controller in a 0.2 m/s current
  fishmj play --controller drift --speed 0.3    what the current does to a fish that does nothing
  fishmj play --turbulence gust --intensity 0.1 --save runs/mine
  fishmj replay runs/mine                       what you just did, as a page

{control.shipped_lines()}

{KEYS}"""


def others(session: LiveSession) -> Iterator[control.Controller | str]:
    """Yields the controllers that can steer the fish, again and again; tries each when it is asked for, since some take long."""
    first = session.controller
    names = [name for name in (*control.shipped_policies(), *control.NAMES) if name != first.name]
    while True:
        yield from filter(session.can_steer, names)
        yield first


def swim(session: LiveSession, view, keys: Keyboard, seconds: float | None, status: Callable[[str], None]) -> None:
    """Runs the live loop: in real time, or as fast as possible for `seconds` of simulated time."""
    choices = others(session)
    tick = session.robot.timing.bus_dt
    stride = max(1, round(FRAME / tick))
    paused, due = False, time.monotonic()
    view.show(session.q, session.target, session.flow.mean[:2])
    while seconds is None or session.time < seconds - 1e-9:
        for key in keys.read():
            if key == "q":
                return
            before = session.controller
            press(session, key, choices)
            if session.controller is not before:
                say_notes(session.controller)
            if key == "r":
                view.clear_trail()
            paused ^= key == " "
        if paused:
            time.sleep(FRAME)
            due = time.monotonic()
            view.show(session.q, session.target, session.flow.mean[:2])
            continue
        chunk = session.step()
        for q in chunk.q[stride - 1 :: stride]:
            due += stride * tick
            if seconds is None:
                wait = due - time.monotonic()
                if wait < -LATE:  # too slow for real time: skip pictures, never physics
                    continue
                time.sleep(max(0.0, wait))
            view.show(q, session.target, session.flow.mean[:2])
        due = max(due, time.monotonic() - 1.0)  # after a long stall go on from here, without a burst
        view.trail(chunk.q[-1, :2])
        status(line(session, chunk))


def line(session: LiveSession, chunk) -> str:
    """The status line."""
    gap, flow = np.hypot(*(session.target - chunk.q[-1, :2])), session.flow
    return (
        f"{session.time:6.1f} s  {session.controller.name}  current {flow.speed:.2f} m/s to {np.degrees(flow.direction):3.0f} deg"
        f"  distance {gap:.2f} m  {chunk.power.mean():.1f} W"
    )


def show_status(text: str) -> None:
    """Rewrites the last line of the terminal."""
    sys.stderr.write("\r" + text.ljust(100))
    sys.stderr.flush()


def options() -> console.Parser:
    """The arguments of `play`."""
    parser = console.parser("play", "One fish live in MeshCat: you make the current and move the target.", examples=EXAMPLES)
    add = parser.add_argument
    steered = "controller, shipped policy, policy file, folder of a training, or your own as module:Name; default"
    steered += f" {BEST} where it fits the robot, else drift"
    add("--controller", type=console.text, help=steered)
    control.anyway_option(parser)
    add("--robot", type=console.text, default="fish", help="description, name or TOML")
    add("--water", type=console.text, help=f"{choice.HELP}; hybrid: fitted, and corrected by the flow solver beside the swim")
    add("--domain", choices=NAMES, help="box of water of --water hybrid, default that of the fitted water; laptop is a preview")
    add("--device", type=console.device, default="auto", help="of the flow solver of --water hybrid: auto, cpu or cuda")
    add("--engine", default="batch", choices=engines.NAMES, help="what moves the fish")
    add("--speed", type=console.number(0, 1), default=0.2, metavar="M/S", help="of the current at the start")
    add("--direction", type=console.number(-360, 360), default=180.0, metavar="DEG", help="the water moves towards it")
    add("--turbulence", default="default", choices=tuple(PRESETS), help="of the current")
    add("--intensity", type=console.number(0, 0.99), help="of the turbulence: u_rms / max(speed, 0.1 m/s); default 0.05")
    add("--seed", type=console.SEED, default=0, help="of turbulence and sensor noise")
    host = "address that the page is served on; 0.0.0.0 lets everybody watch who can reach this machine"
    add("--host", type=console.text, default=LOCAL, metavar="ADDRESS", help=host)
    save = "write the swim as a trial folder at the end; by default not; one that is there is refused without --overwrite"
    add("--save", type=console.out_folder, metavar="FOLDER", help=save)
    add("--overwrite", action="store_true", help="replace the trial in --save")
    alone = "swim S simulated seconds without keys, then stop; by default until q"
    add("--headless-seconds", type=console.number(0, 86_400, above=True), metavar="S", help=alone)
    return parser


def controller_of(args, robot: Robot) -> control.Controller:
    """The requested controller; by default the best shipped one that can steer this robot."""
    if args.controller is not None:
        return control.chosen(args.controller, robot, anyway=args.anyway)
    try:
        return control.chosen(BEST, robot, anyway=args.anyway)
    except ConfigError:
        why = f"the policy {BEST} is made for another fish or command path"
        console.warn(f"{why}: {robot.name} drifts; choose another with --controller, or add --anyway for another path")
        return control.chosen("drift", robot)


def say_notes(controller: control.Controller) -> None:
    """Prints the warnings about a policy, for example that it was trained for another robot."""
    for note in getattr(controller, "notes", ()):
        console.warn(note)


def main(argv: list[str] | None = None) -> int:
    """The verb `play`. Returns the exit code."""
    parser = options()
    args = parser.parse_args(argv)
    water = choice.chosen(load_robot(args.robot), args.water)
    needs: dict = {"--water hybrid": (water.kind == choice.HYBRID, ("domain", "device"))}
    needs |= {"--save": (args.save, ("overwrite",)), "an eddying --turbulence": (args.turbulence != "none", ("intensity",))}
    console.refuse_unheeded("play", args, parser, needs)
    args.intensity = constant("turbulence", "intensity") if args.intensity is None else args.intensity
    if args.save and args.save.exists() and not args.overwrite:
        raise ConfigError(f"play: {args.save} is there already; choose another --save, or replace it with --overwrite")
    if args.save and args.save.is_dir() and not (args.save / META_FILE).is_file():
        raise ConfigError(f"play: {args.save} exists and is no trial (no {META_FILE}); choose another --save")
    direction = float(np.radians(args.direction))
    flow = Flow(speed=args.speed, direction=direction, turbulence=args.turbulence, intensity=args.intensity, seed=args.seed)
    check_host(args.host)
    robot = water.within((*choice.SELF_MADE, choice.HYBRID), "play").robot
    controller = controller_of(args, robot)
    console.say(
        f"water: {water.said}", f"building {robot.name} and its water; the first start on a machine compiles for up to a minute"
    )
    say_notes(controller)
    engine = args.engine
    if water.kind == choice.HYBRID:
        from fishmj.engines.hybrid.engine import HybridEngine, HybridOptions

        engine = HybridEngine(robot, flow, HybridOptions(domain=args.domain, device=args.device), inner=args.engine)
    session = LiveSession(controller, robot, flow, engine)
    alone = args.headless_seconds is not None
    with interrupt.raising(), LiveView(session.robot, args.host) as view, Keyboard() if alone else Keyboard.of_terminal() as keys:
        reach = "this machine only" if args.host in (LOCAL, "localhost", "::1") else "whoever can reach this machine"
        if not alone:  # else it ends before anyone has opened the page
            console.say(f"open {view.url} in a browser (served on {args.host}: {reach})", KEYS)
        try:
            swim(session, view, keys, args.headless_seconds, (lambda text: None) if alone else show_status)
        except KeyboardInterrupt:
            pass  # the usual way to stop; what was swum is still saved
    saved = str(write_trial(args.save, session.trial(), overwrite=True)) if args.save else None
    if saved:
        console.say(f"wrote {saved}")
    if args.json:
        gap = float(np.hypot(*(session.target - session.q[:2])))
        console.emit_json({"seconds": session.time, "controller": session.controller.name, "distance": gap, "saved": saved})
    return 0


if __name__ == "__main__":
    raise SystemExit(console.run(main))
