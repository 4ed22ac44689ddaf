"""The camera over the loopback's tank: the times of exposure and of reading, and its faults.

    exposure    k period + jitter u,  u in [0, 1)         stamped then; a planted error of the clock is in the stamp
    readable    exposure + latency

`camera_frames` draws the frames; here a frame is the pose to be drawn.
"""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fishmj.deploy.loopback.faults import LoopbackFault, active
from fishmj.deploy.loopback.loopback_body import MILLISECOND, Body
from fishmj.gap.laboratory import random_streams

KEPT = 64  # frames


class CameraTiming(NamedTuple):
    """Times of exposure and of reading, s."""

    period: float = 0.02
    latency: float = 0.065  # from exposure until the frame can be read
    jitter: float = 0.002  # of the exposure, uniform


class CameraFrame(NamedTuple):
    """One frame: the pose as the camera records it."""

    t: float  # s, its stamp
    pose: np.ndarray  # (3 + J,): x, y [m], yaw [rad], hinges [rad]
    drawn: float  # s, time of the scene: ripple, glare and noise are of it; that of an older frame where the picture is frozen
    readable: float  # s


class LoopbackCamera:
    """Frames of a body. timing: of the frames. seed: of the jitter. faults: only those of the camera count."""

    def __init__(self, body: Body, timing: CameraTiming, seed: int, faults: Iterable[LoopbackFault] = ()):
        self.body, self.timing, self._faults = body, timing, tuple(faults)
        self._random = random_streams.stream(seed, "exposure")
        self._count = 0
        self._frames: deque[CameraFrame] = deque(maxlen=KEPT)
        self._fresh: deque[CameraFrame] = deque(maxlen=KEPT)
        self._frozen: CameraFrame | None = None

    def next_exposure(self) -> int:
        """Time of the next exposure in ms; call once for each."""
        t = self._count * self.timing.period + self.timing.jitter * self._random.random()
        self._count += 1
        return round(t / MILLISECOND)

    def expose(self) -> None:
        """Takes a frame of the body now."""
        now = self.body.time
        stamp, pose = self.body.seen()
        if fault := active(self._faults, "camera_jump", now):
            pose = pose + np.r_[fault.value, np.zeros(len(pose) - 1)]
        frame = CameraFrame(stamp, pose, now, now + self.timing.latency)
        if active(self._faults, "camera_freeze", now):
            self._frozen = self._frozen or frame
            frame = frame._replace(pose=self._frozen.pose, drawn=self._frozen.drawn)
        else:
            self._frozen = None
        if not active(self._faults, "camera_loss", now):
            self._frames.append(frame)
            self._fresh.append(frame)

    def frames(self, since: float, now: float) -> list[CameraFrame]:
        """Frames that are readable now and became so after `since` [s], oldest first."""
        return [frame for frame in self._frames if since < frame.readable <= now]

    def exposed(self) -> list[CameraFrame]:
        """Frames taken since the last call, readable or not, for drawing them in the meantime."""
        return [self._fresh.popleft() for _ in range(len(self._fresh))]
