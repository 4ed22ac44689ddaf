"""The loopback robot in the host's own process: time moves when the host sleeps, so hours pass in minutes, without a thread.

    robot = make_robot(Settings(seed=3))
    clock = LockstepClock(robot)
    link = Fishmj1Link(LockstepTransport(clock))
    localiser = InStep(LockstepCamera(clock), PoseTracker(seed=3))     # or LockstepCamera(clock, artist) and a tracker

The host's loop is the same as in real time over UDP.

`wired` connects it to the host's own commands, without a second process:

    trials_command.main([..., "--link", "loopback", "--yes"], in_step=wired)
    rig_experiment.main([..., "--link", "loopback", "--yes"], wire=wired)

No camera is drawn: the host gets poses with a tracker's errors and the delay of frames.
"""

import shlex
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, constant, read_toml
from fishmj.base.errors import UnknownName
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import RobotLink, datagram_link
from fishmj.deploy.loop.wiring import Wired, servo_link
from fishmj.deploy.loopback import loopback_command
from fishmj.deploy.loopback.camera_frames import FrameArtist
from fishmj.deploy.loopback.loopback_body import MILLISECOND
from fishmj.deploy.loopback.loopback_settings import make_robot
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.protocols import SERVO_BUS
from fishmj.deploy.tracker.fix import Fix, wrapped
from fishmj.gap.laboratory import random_streams
from fishmj.mjcf.description import Robot


class LockstepClock:
    """The host's clock. origin: its value, s, at the robot's time 0; the two differ, as for any host and robot."""

    def __init__(self, robot: LoopbackRobot, origin: float = 100.0):
        self.robot, self.origin = robot, origin
        self.arrived: deque[tuple[float, bytes]] = deque()
        self._now = origin + robot.time

    def now(self) -> float:
        """Time on the host's clock, s."""
        return self._now

    def sleep_until(self, t: float) -> None:
        """Advances the robot to t, s on this clock; returns at once if that has passed."""
        if t <= self._now:
            return
        self._now = t
        self.arrived.extend((self.origin + arrival.t, arrival.data) for arrival in self.robot.advance_to(t - self.origin))


class LockstepTransport:
    """Datagrams to and from the robot, through its radio."""

    def __init__(self, clock: LockstepClock):
        self.clock = clock

    def open(self) -> None:
        """Does nothing."""

    def send(self, data: bytes) -> None:
        """Sends one datagram now."""
        self.clock.robot.receive(data)

    def receive(self) -> list[tuple[float, bytes]]:
        """Datagrams since the last call, with their times of arrival on the host's clock, s."""
        heard = self.clock.arrived
        return [heard.popleft() for _ in range(len(heard))]

    def close(self) -> None:
        """Does nothing."""


class LockstepSerial:
    """The serial line to the robot's servos, as `serial.Serial`: a read without data waits for a millisecond."""

    def __init__(self, clock: LockstepClock):
        self.clock, self._heard = clock, b""

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read."""
        while self.clock.arrived:
            self._heard += self.clock.arrived.popleft()[1]
        return len(self._heard)

    def write(self, data: bytes) -> None:
        """Sends bytes to the servos now."""
        self.clock.robot.receive(data)

    def read(self, count: int) -> bytes:
        """Up to `count` bytes; none after a millisecond without any."""
        if not self.in_waiting:
            self.clock.sleep_until(self.clock.now() + MILLISECOND)
        there = min(count, self.in_waiting)
        found, self._heard = self._heard[:there], self._heard[there:]
        return found

    def close(self) -> None:
        """Does nothing."""


class LockstepCamera:
    """Frames as they become readable.

    Args:
        artist: draws (H, W, 3) uint8 images; without one the "image" is the pose to be drawn, (3 + J,), which
            `PoseTracker` reads: a hundred times faster.
    """

    def __init__(self, clock: LockstepClock, artist: FrameArtist | None = None):
        self.clock, self.artist = clock, artist
        self._since = -np.inf
        self._drawn: tuple[float, np.ndarray] | None = None

    def open(self) -> None:
        """Starts the frames."""
        self._since = self.clock.robot.time

    def read(self, now: float) -> list[tuple[float, np.ndarray]]:
        """(stamp on the host's clock [s], image) of each frame since the last call, oldest first."""
        frames = self.clock.robot.frames(self._since)
        if frames:
            self._since = frames[-1].readable
        return [(self.clock.origin + frame.t, self._image(frame.pose, frame.drawn)) for frame in frames]

    def wait(self, most: float) -> list[tuple[float, np.ndarray]]:
        """Frames as of `read`, advancing time by up to `most` s until there is one."""
        end = self.clock.now() + most
        while not (found := self.read(self.clock.now())) and self.clock.now() < end:
            self.clock.sleep_until(min(self.clock.now() + self.clock.robot.camera.timing.period, end))
        return found

    def close(self) -> None:
        """Does nothing."""

    def _image(self, pose: np.ndarray, drawn: float) -> np.ndarray:
        if self.artist is None:
            return pose
        if self._drawn is None or self._drawn[0] != drawn:  # a frozen camera gives the same picture again
            self._drawn = drawn, self.artist.draw(pose[:3].tolist(), pose[3:].tolist(), drawn)
        return self._drawn[1]


class FixNoise(NamedTuple):
    """Errors of a tracker.

    Attributes:
        position, heading: standard deviation, m and rad. slow: share of the variance that lasts, with memory
            `memory` s; slow_heading, memory_heading: the same of the heading, None as of the position.
        missed: share of the frames without a fix.
    """

    position: float
    heading: float
    slow: float = 0.0
    memory: float = 0.2
    missed: float = 0.0
    slow_heading: float | None = None
    memory_heading: float | None = None

    @classmethod
    def measured(cls, case: str = "tag_clean") -> "FixNoise":
        """Errors measured on drawn frames (`data/calib/camera_noise.toml`).

        Args:
            case: tag_clean, tag_glare, colour_clean or colour_glare.

        Raises UnknownName: no such case.
        """
        table = read_toml(calib_folder() / "camera_noise.toml")
        cases = {name: entry for name, entry in table.items() if isinstance(entry, dict) and "position" in entry}
        if case not in cases:
            raise UnknownName("case of camera_noise.toml", case, cases)
        found = cases[case]
        (x, lasting), (yaw, lasting_yaw) = (_size(found[name]) for name in ("position", "yaw"))
        memories = [found[name]["tau"] or 0.2 for name in ("position", "yaw")]
        return cls(x, yaw, lasting, memories[0], found["missed"], lasting_yaw, memories[1])

    @classmethod
    def of_the_task(cls) -> "FixNoise":
        """Errors of the camera in training, white: [noise] of paper.toml."""
        return cls(constant("noise", "position"), constant("noise", "yaw"))


def _size(part: dict) -> tuple[float, float]:
    """Standard deviation of a white and a lasting part together, and the lasting one's share of the variance."""
    variance = part["white"] ** 2 + part["lasting"] ** 2
    return variance**0.5, part["lasting"] ** 2 / variance if variance else 0.0


class PoseTracker:
    """Replaces a tracker: adds its errors to the poses of a `LockstepCamera` without an artist.

    Args:
        noise: of its fixes; None: of the tag on clean frames, as measured.
    """

    def __init__(self, noise: FixNoise | None = None, seed: int = 0):
        self.noise = found = noise or FixNoise.measured()
        self._random = random_streams.stream(seed, "fix")
        self._slow, self._t = np.zeros(3), 0.0
        sizes = np.array([found.position, found.position, found.heading])
        as_position = lambda value, heading: np.array([value, value, value if heading is None else heading])
        slow = as_position(found.slow, found.slow_heading)
        self._memory = as_position(found.memory, found.memory_heading)
        self._fast_size, self._slow_size = np.sqrt(1.0 - slow) * sizes, np.sqrt(slow) * sizes
        self._covariance = np.diag(sizes**2)

    def reset(self) -> None:
        """Does nothing: there is no memory but that of the errors."""

    def locate(self, image: np.ndarray, t: float) -> Fix | None:
        """Fix from a "frame" (3 + J,) stamped t [s]; None if it is missed."""
        draws, missed = self._random.standard_normal((2, 3)), self._random.random() < self.noise.missed
        keep = np.exp(-max(t - self._t, 0.0) / self._memory) if self._t else np.zeros(3)
        self._slow, self._t = keep * self._slow + np.sqrt(1.0 - keep * keep) * draws[0] * self._slow_size, t
        if missed:
            return None
        x, y, yaw = image[:3] + self._slow + draws[1] * self._fast_size
        return Fix(t, float(x), float(y), wrapped(yaw), self._covariance, 1.0)


def wired(
    args: Any, robot: Robot, stack: ExitStack, clock: Callable[[LoopbackRobot], LockstepClock] = LockstepClock,
    noise: FixNoise | None = None,
) -> Wired:  # fmt: skip
    """Replaces `deploy.wiring.wire`.

    Args:
        args: `loopback` are the options of `deploy loopback`; `robot` and `protocol` as in the host's command.
        clock: makes the clock that moves the robot. noise: of the fixes; None: a tag's on clean frames, as measured.
    """
    words = ["--protocol", args.protocol, "--model", args.robot, *shlex.split(args.loopback or "")]
    settings = loopback_command.served(loopback_command.options().parse_args(words)).settings
    made = clock(make_robot(settings))
    link: RobotLink
    if settings.protocol == SERVO_BUS:
        link = servo_link(args, robot, made, lambda _: LockstepSerial(made))
    else:
        link = datagram_link(settings.protocol, LockstepTransport(made))
    localiser = InStep(LockstepCamera(made), PoseTracker(noise, settings.seed))
    for part in (link, localiser):
        part.open()
        stack.callback(part.close)
    return Wired(link, localiser, made, True)
