"""Camera and tracker together: pictures in, fixes out.

Beside the tank both run in a thread of their own, and the loop takes what is ready; in lockstep the loop calls them itself.

A camera that hangs gives one picture for ever, and a tracker that follows the fish finds it there a little elsewhere each time.
So pictures are compared: noise makes two of a living camera differ, and one that repeats the picture before it is none.
"""

import threading
from collections import deque
from typing import Protocol

import numpy as np

from fishmj.deploy.cameras import Camera
from fishmj.errors import FishmjError
from fishmj.tracker.fix import Fix, Tracker

EVERY = 16  # rows of a picture between two that are compared first: nearly all pictures differ there already


class Localiser(Protocol):
    """What the loop asks for fixes.

    Attributes:
        counts: frames looked at, fixes found, frames left out because newer ones waited, frames that repeat the one before.
    """

    counts: dict[str, int]

    def open(self) -> None: ...
    def fixes(self, now: float) -> list[Fix]: ...
    def close(self) -> None: ...


class Repeats:
    """Tells whether a picture (H, W, 3) is, to the last bit, the one before. A "picture" that is no image never is."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None

    def __call__(self, image: np.ndarray) -> bool:
        last, self._last = self._last, image
        if last is None or image.ndim != 3 or last.shape != image.shape:
            return False
        return last is image or (np.array_equal(last[::EVERY], image[::EVERY]) and np.array_equal(last, image))


class InStep:
    """Looks at every frame when it is asked to: for lockstep, where time waits."""

    def __init__(self, camera: Camera, tracker: Tracker):
        self.camera, self.tracker = camera, tracker
        self.counts = {"frames": 0, "fixes": 0, "skipped": 0, "repeated": 0}
        self._repeats = Repeats()

    def open(self) -> None:
        self.camera.open()

    def fixes(self, now: float) -> list[Fix]:
        found = []
        for t, image in self.camera.read(now):
            self.counts["frames"] += 1
            if self._repeats(image):
                self.counts["repeated"] += 1
                continue
            if (fix := self.tracker.locate(image, t)) is not None:
                self.counts["fixes"] += 1
                found.append(fix)
        return found

    def close(self) -> None:
        self.camera.close()


class InThread:
    """Looks at the newest frame in a thread of its own; OpenCV works without the interpreter's lock.

    Attributes:
        failed: why no more fixes come, None while all is well.
    """

    def __init__(self, camera: Camera, tracker: Tracker):
        self.camera, self.tracker = camera, tracker
        self.counts = {"frames": 0, "fixes": 0, "skipped": 0, "repeated": 0}
        self._repeats = Repeats()
        self.failed: Exception | None = None
        self._found: deque[Fix] = deque(maxlen=200)
        self._running = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        self.camera.open()
        self._running.set()
        self._thread = threading.Thread(target=self._look, name="tracker", daemon=True)
        self._thread.start()

    def _look(self) -> None:
        try:
            while self._running.is_set():
                frames = self.camera.wait(0.1)
                self.counts["skipped"] += max(len(frames) - 1, 0)
                for t, image in frames[-1:]:
                    self.counts["frames"] += 1
                    if self._repeats(image):
                        self.counts["repeated"] += 1
                        continue
                    if (fix := self.tracker.locate(image, t)) is not None:
                        self.counts["fixes"] += 1
                        self._found.append(fix)
        except FishmjError as error:  # a camera that goes: the pose grows old, and the loop says why
            self.failed = error

    def fixes(self, now: float) -> list[Fix]:
        return [self._found.popleft() for _ in range(len(self._found))]

    def close(self) -> None:
        self._running.clear()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
        self.camera.close()
