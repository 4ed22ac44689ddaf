"""Pictures with the time of exposure: from a device, a video file, or the loopback robot's camera in shared memory.

Every stamp is on this computer's monotonic clock, s. Pictures are (H, W, 3) uint8, blue green red.
"""

import struct
import threading
import time
from collections import deque
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.loop.clock import Clock, MonotonicClock

Frame = tuple[float, np.ndarray]  # s on the monotonic clock, (H, W, 3) uint8
MAGIC = 0x464D4A46  # "FMJF": a ring of frames
HEADER = 8  # int64 of it
POLL = 0.002  # s between two looks at a ring
TRIES = 3  # times that a slot which is being written is looked at again


class Camera(Protocol):
    """Interface of a camera, used by a localiser."""

    def open(self) -> None:
        """Opens the device. Raises ConfigError if it is not available."""

    def read(self, now: float) -> list[Frame]:
        """Pictures taken since the last call, oldest first; does not wait."""

    def wait(self, most: float) -> list[Frame]:
        """Pictures as of `read`, waiting up to `most` s for the first one."""

    def close(self) -> None:
        """Releases the device."""


def cv2() -> Any:
    """Imports and returns OpenCV. Raises MissingExtra if it is not installed."""
    import cv2 as opencv

    opencv.utils.logging.setLogLevel(opencv.utils.logging.LOG_LEVEL_SILENT)  # what does not open is said in our words
    return opencv


class Device:
    """A camera of this computer by its number. A thread grabs pictures, so that no old one waits in the driver's queue.

    Args:
        size: requested (width, height) px. rate: requested, Hz. A driver may choose others.
    """

    def __init__(self, number: int, size: tuple[int, int] = (1280, 720), rate: float = 60.0):
        self.number, self.size, self.rate = number, size, rate
        self._frames: deque[Frame] = deque(maxlen=4)
        self._ready, self._running = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._device: Any = None

    def open(self) -> None:
        """Opens the device and starts to grab. Raises ConfigError if it does not open."""
        opencv = cv2()
        device = opencv.VideoCapture(self.number)
        if not device.isOpened():
            raise ConfigError(f"camera {self.number}: does not open; is it plugged in, and no other program using it?")
        for key, value in (
            (opencv.CAP_PROP_FRAME_WIDTH, self.size[0]),
            (opencv.CAP_PROP_FRAME_HEIGHT, self.size[1]),
            (opencv.CAP_PROP_FPS, self.rate),
            (opencv.CAP_PROP_BUFFERSIZE, 1),
        ):
            device.set(key, value)
        self._device = device
        self._running.set()
        self._thread = threading.Thread(target=self._grab, name="camera", daemon=True)
        self._thread.start()

    def _grab(self) -> None:
        while self._running.is_set():
            if not self._device.grab():
                time.sleep(0.01)  # unplugged: no picture, the pose grows old
                continue
            t = time.monotonic()
            good, image = self._device.retrieve()
            if good:
                self._frames.append((t, image))
                self._ready.set()

    def read(self, now: float) -> list[Frame]:
        """Pictures grabbed since the last call, oldest first; does not wait."""
        self._ready.clear()
        return [self._frames.popleft() for _ in range(len(self._frames))]

    def wait(self, most: float) -> list[Frame]:
        """Pictures as of `read`, waiting up to `most` s for the first one."""
        self._ready.wait(most)
        return self.read(0.0)

    def close(self) -> None:
        """Stops to grab and releases the device."""
        self._running.clear()
        if self._thread is not None:
            self._thread.join(1.0)
            self._thread = None
        if self._device is not None:
            self._device.release()
            self._device = None


class VideoFile:
    """A film as if it were live: picture k is taken at start + k / rate."""

    def __init__(self, path: "str | Path", clock: Clock):
        self.path, self.clock = Path(path), clock
        self._film: Any = None

    def open(self) -> None:
        """Opens the film and starts its clock. Raises StoreError for a file that OpenCV cannot read."""
        opencv = cv2()
        self._film = opencv.VideoCapture(str(self.path))
        rate = self._film.get(opencv.CAP_PROP_FPS) if self._film.isOpened() else 0.0
        if not 1.0 <= rate <= 1000.0:
            raise StoreError(f"{self.path}: no film that OpenCV reads, or without a rate; expected mp4, avi or mkv")
        self.period, self._start, self._count = 1.0 / rate, self.clock.now(), 0

    def read(self, now: float) -> list[Frame]:
        """Pictures that are due at `now` [s] and were not read yet."""
        found = []
        while self._film is not None and (t := self._start + self._count * self.period) <= now:
            good, image = self._film.read()
            if not good:
                break
            self._count += 1
            found.append((t, image))
        return found

    def wait(self, most: float) -> list[Frame]:
        """Pictures as of `read`, after waiting up to `most` s for the next one."""
        due = self._start + self._count * self.period
        now = self.clock.now()
        self.clock.sleep_until(min(max(due, now + POLL), now + most))
        return self.read(self.clock.now())

    def close(self) -> None:
        """Closes the film."""
        if self._film is not None:
            self._film.release()
            self._film = None


class SharedFrames:
    """The loopback robot's camera: the newest frame of a ring in shared memory, with its stamp.

        int64[8]    MAGIC, width, height, slots, newest, rate mHz, 0, 0
        per slot    int64 number, float64 taken, uint8[height][width][3]

    `newest` is a slot, -1 before the first frame. `number` is 2 n of the n-th frame, and odd while the slot is written.

    Args:
        name: of the shared memory, as the server prints it.

    Attributes:
        passed: frames that were overwritten before they were read.
    """

    def __init__(self, name: str, clock: Clock | None = None):
        self.name, self.clock, self.passed = name, clock or MonotonicClock(), 0
        self._memory: SharedMemory | None = None
        self._ring = memoryview(b"")
        self._seen = 0

    def open(self) -> None:
        """Attaches to the shared memory. Raises ConfigError: there is no such shared memory, or it holds something else."""
        memory = _attached(self.name)
        ring = memory.buf if memory.buf is not None else memoryview(b"")
        magic, width, height, slots = struct.unpack_from("<4q", ring) if len(ring) >= 8 * HEADER else (0, 0, 0, 0)
        self._step = 16 + 3 * width * height
        if magic != MAGIC or len(ring) < 8 * HEADER + slots * self._step:
            memory.close()
            raise ConfigError(f"camera loopback: shared memory {self.name!r} is no ring of frames; is it the server's name?")
        self._memory, self._ring, self.shape, self.slots = memory, ring, (height, width, 3), slots

    def read(self, now: float) -> list[Frame]:
        """The newest frame if it was not read before, copied while no writer changed it; else []."""
        for _ in range(TRIES):
            slot = struct.unpack_from("<q", self._ring, 32)[0] if self._memory is not None else -1
            if not (self._memory is not None and 0 <= slot < self.slots):
                return []
            begin = 8 * HEADER + slot * self._step
            number, taken = struct.unpack_from("<qd", self._ring, begin)
            if number == 2 * self._seen:
                return []
            image = np.frombuffer(self._ring, np.uint8, self._step - 16, begin + 16).reshape(self.shape).copy()
            if number % 2 == 0 and struct.unpack_from("<q", self._ring, begin)[0] == number:
                self.passed += max(number // 2 - self._seen - 1, 0) if self._seen else 0
                self._seen = number // 2
                return [(taken, image)]
        return []

    def wait(self, most: float) -> list[Frame]:
        """Frames as of `read`, waiting up to `most` s for a new one."""
        end = self.clock.now() + most
        while not (found := self.read(self.clock.now())) and self.clock.now() < end:
            self.clock.sleep_until(self.clock.now() + POLL)
        return found

    def close(self) -> None:
        """Detaches from the shared memory."""
        if self._memory is not None:
            self._ring = memoryview(b"")
            self._memory.close()
            self._memory = None


def _attached(name: str) -> SharedMemory:
    """The memory of that name, not owned: Python below 3.13 would otherwise remove it when this process ends."""
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return SharedMemory(name)
    except (OSError, ValueError) as error:
        raise ConfigError(f"camera loopback: no shared memory {name[:60]!r}; start fishmj deploy loopback first") from error
    finally:
        resource_tracker.register = register
