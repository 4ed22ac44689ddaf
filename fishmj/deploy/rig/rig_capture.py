"""`fishmj deploy capture`: takes pictures of a board, or of the tank's marks, at the size used in a swim."""

from collections import deque
from collections.abc import Iterator

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import write_bytes
from fishmj.deploy.camera.cameras import Camera, Device, Frame, cv2
from fishmj.deploy.loop.clock import Clock, MonotonicClock
from fishmj.deploy.loop.wiring import camera_of, make_camera

SILENT = 5.0  # s without a picture after which there is no camera
GAPS = 200  # newest distances of stamps that the rate is taken from
EXAMPLES = """examples:
  fishmj deploy capture --camera 0 --count 12 --every 2 --out board      tilt the board another way before each
  fishmj deploy capture --camera 0 --count 1 --out marks                 the tank with its marks, seen by the clamped camera"""


class Shots:
    """Pictures of an opened camera, one every `every` s, the first after that time.

    Attributes:
        rate: Hz, from the median distance of neighbouring stamps; NaN before the second picture.
    """

    def __init__(self, camera: Camera, clock: Clock, every: float):
        self.camera, self.clock, self.every = camera, clock, every
        self._gaps: deque[float] = deque(maxlen=GAPS)

    @property
    def rate(self) -> float:
        """Rate from the median distance of neighbouring stamps, Hz; NaN before the second picture."""
        return 1.0 / float(np.median(self._gaps)) if self._gaps else float("nan")

    def taken(self, count: int) -> Iterator[Frame]:
        """`count` pictures with their stamps. Raises ConfigError: no picture for `SILENT` s."""
        heard = begun = self.clock.now()
        last: float | None = None
        number = 1
        while number <= count:
            frames = self.camera.wait(0.1)
            now = self.clock.now()
            if not frames:
                if now - heard > SILENT:
                    raise ConfigError(f"capture: no picture for {SILENT:g} s after {number - 1} of {count}; is the camera there?")
                continue
            heard = now
            for t, _ in frames:
                if last is not None and t > last:
                    self._gaps.append(t - last)
                last = t
            if now - begun >= number * self.every:
                number += 1
                yield frames[-1]


def options() -> console.Parser:
    """The arguments."""
    summary = "Pictures for calibrate-camera, at the size at which the fish swims."
    made = console.parser("deploy capture", summary, examples=EXAMPLES)
    add = made.add_argument
    add("--camera", type=console.text, required=True, metavar="CAMERA", help="a camera's number, shm:NAME, or a video file")
    add("--count", type=console.whole(1, 500), default=12, help="of pictures")
    add("--every", type=console.number(0.1, 60), default=2.0, help="s between two of them, and before the first")
    add("--out", type=console.out_folder, required=True, metavar="FOLDER", help="PNG files; those that are there stay")
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: all were taken; 1: not at the size used in a swim."""
    args = options().parse_args(argv)
    clock = MonotonicClock()
    camera, opencv, files = make_camera(camera_of(args.camera, None), clock), cv2(), []
    shots = Shots(camera, clock, args.every)
    camera.open()
    try:
        for number, (_, image) in enumerate(shots.taken(args.count), 1):
            done, data = opencv.imencode(".png", image)
            if not done:
                raise StoreError(f"{args.out}: OpenCV makes no PNG of a picture of shape {image.shape}")
            taken = {path.name for path in args.out.glob("*.png")}
            name = next(name for k in range(1, 10000) if (name := f"{k:03d}.png") not in taken)
            files.append(write_bytes(args.out / name, data.tobytes()))
            console.say(f"{number} of {args.count}: {files[-1]}")
    finally:
        camera.close()
    size, wanted = (image.shape[1], image.shape[0]), Device(0).size
    console.say(f"{len(files)} pictures of {size[0]} x {size[1]} px in {args.out}; the camera gives {shots.rate:.1f} a second")
    if size != wanted:
        text = f"the fish swims at {wanted[0]} x {wanted[1]} where the camera can"
        console.warn(f"{text}; a calibration is of one size, and this camera's swims have to have {size[0]} x {size[1]}")
    if args.json:
        console.emit_json({"files": files, "size": size, "rate": shots.rate})
    return console.OK if size == wanted else console.FAILED_CHECK
