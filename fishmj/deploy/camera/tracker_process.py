"""The process of camera and tracker that `localiser.InProcess` starts: `python -m fishmj.deploy.camera.tracker_process OPTIONS`.

It ends with its host: if its parent changes, or if its output is no longer read.
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
    """The arguments: the camera and tracker options of a swim."""
    made = console.parser("deploy.tracker_process", "Camera and tracker in a process of their own: fixes as lines of JSON.")
    wiring.camera_options(made)
    made.add_argument("--parent", type=console.whole(1, 2**31), required=True, metavar="PID", help="the host, with which it ends")
    return made


def main(argv: list[str]) -> int:
    """Finds the fish until the host is gone. Exit code 0: the host ended; 2: the camera does not open."""
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
    """Report on one picture, for the process's output."""
    packet: dict = {"counts": list(counts.values())}
    if fix is not None:
        packet |= {"t": fix.t, "pose": [fix.x, fix.y, fix.yaw], "quality": fix.quality}
        packet["covariance"] = [float(value) for value in fix.covariance.ravel()]
    return packet


def _write(text: str) -> None:
    """Writes one line completely or not at all; a host that does not read for seconds misses the lines of that time."""
    with suppress(BlockingIOError):
        os.write(sys.stdout.fileno(), f"{text}\n".encode())


if __name__ == "__main__":
    sys.exit(console.run(main))
