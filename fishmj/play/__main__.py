"""`python -m fishmj.play`: one fish live in MeshCat; the arrow keys set the current, w a s d move the target.

    keys -> current, target      every 0.2 s: observe -> controller -> engine (10 bus ticks) -> MeshCat at 25 pictures a second

The fish meets the same noise, latencies and water as in the tasks; it does not sense the current that you make.
"""

import argparse
import sys
import time
from collections.abc import Callable
from itertools import cycle

import numpy as np

from fishmj import console, controllers, engines, interrupt
from fishmj.flow import PRESETS, Flow
from fishmj.log import write_trial
from fishmj.play.keyboard import Keyboard, press
from fishmj.play.pond import Pond

FRAME = 0.04  # s between two pictures
LATE = 0.2  # s behind real time from which on pictures are skipped
KEYS = """keys: up, down   current faster, slower            w a s d   target up, left, down, right in the tank
      left, right  turn the current by 15 deg      space     pause        c  next controller
      r  start again                               q         quit"""
EXAMPLES = (
    """examples:
  python -m fishmj.play                                   the best shipped controller in a 0.2 m/s current
  python -m fishmj.play --controller drift --speed 0.3    what the current does to a fish that does nothing
  python -m fishmj.play --turbulence gust --intensity 0.1 --save runs/mine
  python -m fishmj.replay runs/mine                       what you just did, as a page

"""
    + KEYS
)


def swim(pond: Pond, view, keys: Keyboard, seconds: float | None, status: Callable[[str], None]) -> None:
    """The live loop: in real time, or as fast as it goes for `seconds` of simulated time."""
    brains = cycle(dict.fromkeys([pond.controller.name, *controllers.shipped_policies(), *controllers.NAMES]))
    next(brains)
    tick = pond.robot.timing.bus_dt
    stride = max(1, round(FRAME / tick))
    paused, due = False, time.monotonic()
    view.show(pond.q, pond.target, pond.flow.mean[:2])
    while seconds is None or pond.time < seconds - 1e-9:
        for key in keys.read():
            if key == "q":
                return
            press(pond, key, brains)
            if key == "r":
                view.clear_trail()
            paused ^= key == " "
        if paused:
            time.sleep(FRAME)
            due = time.monotonic()
            view.show(pond.q, pond.target, pond.flow.mean[:2])
            continue
        chunk = pond.step()
        for q in chunk.q[stride - 1 :: stride]:
            due += stride * tick
            if seconds is None:
                wait = due - time.monotonic()
                if wait < -LATE:  # too slow for real time: skip pictures, never physics
                    continue
                time.sleep(max(0.0, wait))
            view.show(q, pond.target, pond.flow.mean[:2])
        due = max(due, time.monotonic() - 1.0)  # after a long stall go on from here, without a burst
        view.trail(chunk.q[-1, :2])
        status(line(pond, chunk))


def line(pond: Pond, chunk) -> str:
    """The status line."""
    gap, flow = np.hypot(*(pond.target - chunk.q[-1, :2])), pond.flow
    return (
        f"{pond.time:6.1f} s  {pond.controller.name}  current {flow.speed:.2f} m/s to {np.degrees(flow.direction):3.0f} deg"
        f"  distance {gap:.2f} m  {chunk.power.mean():.1f} W"
    )


def show_status(text: str) -> None:
    """Rewrite the last line of the terminal."""
    sys.stderr.write("\r" + text.ljust(100))
    sys.stderr.flush()


def main(argv: list[str] | None = None) -> int:
    """The verb `play`. Returns the exit code."""
    parser = console.parser("play", "One fish live in MeshCat: you make the current and move the target.")
    parser.epilog, parser.formatter_class = EXAMPLES, argparse.RawDescriptionHelpFormatter
    best = "paper" if "paper" in controllers.shipped_policies() else "dob"
    parser.add_argument("--controller", default=best, help="controller, shipped policy or policy file (default: %(default)s)")
    parser.add_argument("--robot", default="fish", help="description, name or TOML (default: %(default)s)")
    parser.add_argument("--engine", default="batch", choices=engines.NAMES, help="default: %(default)s")
    parser.add_argument("--speed", type=float, default=0.2, help="of the current at the start, m/s (default: %(default)s)")
    parser.add_argument("--direction", type=float, default=180.0, help="the water moves towards it, deg (default: %(default)s)")
    parser.add_argument("--turbulence", default="default", choices=PRESETS, help="default: %(default)s")
    parser.add_argument("--intensity", type=float, default=0.05, help="of the turbulence (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of turbulence and sensor noise (default: %(default)s)")
    parser.add_argument("--save", metavar="FOLDER", help="write the swim as a trial folder at the end")
    parser.add_argument("--headless-seconds", type=float, metavar="S", help="swim S simulated seconds without keys, then stop")
    args = parser.parse_args(argv)
    direction = float(np.radians(args.direction))
    flow = Flow(speed=args.speed, direction=direction, turbulence=args.turbulence, intensity=args.intensity, seed=args.seed)
    pond = Pond(args.controller, args.robot, flow, args.engine)
    from fishmj.replay.live import LiveView

    alone = args.headless_seconds is not None
    with interrupt.raising(), LiveView(pond.robot) as view, Keyboard() if alone else Keyboard.of_terminal() as keys:
        console.say(f"open {view.url} in a browser", "" if alone else KEYS)
        try:
            swim(pond, view, keys, args.headless_seconds, (lambda text: None) if alone else show_status)
        except KeyboardInterrupt:
            pass  # the usual way to stop; what was swum is still saved
    if args.save:
        console.say(f"wrote {write_trial(args.save, pond.trial(), overwrite=True)}")
    if args.json:
        gap = float(np.hypot(*(pond.target - pond.q[:2])))
        console.emit_json({"seconds": pond.time, "controller": pond.controller.name, "distance": gap, "saved": args.save})
    return 0


if __name__ == "__main__":
    raise SystemExit(console.run(main))
