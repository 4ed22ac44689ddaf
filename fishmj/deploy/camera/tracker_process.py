"""The process of camera and tracker that `localiser.InProcess` starts: `python -m fishmj.deploy.camera.tracker_process OPTIONS`.

It ends with its host: where its parent is another one, or nobody reads what it prints.
"""

import gc
import json
import os
import sys
from contextlib import suppress

from fishmj.base import console
from fishmj.base.errors import FishmjError
from fishmj.deploy.camera.cameras import cv2
from fishmj.deploy.camera.localiser import Newest
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.clock import SEEING, MonotonicClock, first_in_line
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.deploy.tracker.fix import Fix

LOOK = 0.1  # s that a picture is waited for before it looks whether the host is there


def options() -> console.Parser:
    """The arguments: those of a swim that say how to see the robot."""
    made = console.parser("deploy.tracker_process", "Camera and tracker in a process of their own: fixes as lines of JSON.")
    wiring.camera_options(made)
    made.add_argument("--parent", type=console.whole(1, 2**31), required=True, metavar="PID", help="the host, with which it ends")
    return made


def main(argv: list[str]) -> int:
    """Look until the host is gone. Exit code 0: it went; 2: the camera does not open."""
    args = options().parse_args(argv)
    calibration = Calibration.read(args.calibration)
    eyes = Newest(wiring.make_camera(args.camera, MonotonicClock()), wiring.make_tracker(args, calibration))
    cv2().setNumThreads(1)  # one thread finds the fish in every frame; more of them would take turns with the host
    eyes.open()
    gc.collect()
    gc.freeze()
    os.set_blocking(sys.stdout.fileno(), False)
    try:
        with first_in_line(SEEING):
            _write("")
            while os.getppid() == args.parent:
                _write(json.dumps(line(eyes.look(LOOK), eyes.counts)))
    except FishmjError as error:  # a camera that goes: the pose grows old, and the loop says why
        _write(json.dumps({"failed": str(error)}))
    except BrokenPipeError:
        pass  # nobody listens any more
    finally:
        eyes.close()
    return console.OK


def line(fix: Fix | None, counts: dict[str, int]) -> dict:
    """What is told of one picture."""
    told: dict = {"counts": list(counts.values())}
    if fix is not None:
        told |= {"t": fix.t, "pose": [fix.x, fix.y, fix.yaw], "quality": fix.quality}
        told["covariance"] = [float(value) for value in fix.covariance.ravel()]
    return told


def _write(text: str) -> None:
    """One line, whole or not at all: a host that does not listen for seconds misses what was seen meanwhile."""
    with suppress(BlockingIOError):
        os.write(sys.stdout.fileno(), f"{text}\n".encode())


if __name__ == "__main__":
    sys.exit(console.run(main))
