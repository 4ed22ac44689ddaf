"""Camera and tracker together: from pictures to fixes.

Beside the tank both run in a process of their own (`tracker_process`), and the loop takes the finished fixes. A tracker in a
thread of the host would hold the interpreter for milliseconds at a time and delay the loop. In lockstep the loop calls them
itself.

    {"t": s, "pose": [m, m, rad], "covariance": [9 numbers], "quality": 0..1, "counts": [frames, fixes, skipped, repeated]}

is a line of that process, one a fix. A picture without a fix gives a line without the first four keys; a failed camera gives
{"failed": "reason"}.

A camera that hangs repeats one picture, in which a tracker that follows the fish finds it at slightly different places. So
pictures are compared: noise makes any two of a working camera differ, and an exact repetition is ignored.
"""

import json
import os
import select
import subprocess
import tempfile
import time
from collections.abc import Sequence
from typing import IO, Protocol

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.processes import end_command, last_words, start_command
from fishmj.deploy.camera.cameras import Camera
from fishmj.deploy.tracker.fix import Fix, Tracker

STARTS = 30.0  # s that the process may take until its camera is open
ENDS = 2.0  # s that it may take to end
COUNTS = ("frames", "fixes", "skipped", "repeated")
EVERY = 16  # rows of a picture between two that are compared first: nearly all pictures differ there already


class Localiser(Protocol):
    """Interface of a localiser, which gives the loop its fixes.

    Attributes:
        counts: frames examined, fixes found, frames skipped for newer ones, frames that repeat the one before.
    """

    counts: dict[str, int]

    def open(self) -> None:
        """Opens the camera. Raises ConfigError if it is not available."""

    def fixes(self, now: float) -> list[Fix]:
        """Fixes found since the last call, oldest first."""

    def close(self) -> None:
        """Closes the camera."""


class Repeats:
    """Detects a picture (H, W, 3) that equals the one before to the last bit. An object that is no image never counts as one."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None

    def __call__(self, image: np.ndarray) -> bool:
        last, self._last = self._last, image
        if last is None or image.ndim != 3 or last.shape != image.shape:
            return False
        return last is image or (np.array_equal(last[::EVERY], image[::EVERY]) and np.array_equal(last, image))


class Looking:
    """A camera and its tracker, picture by picture."""

    def __init__(self, camera: Camera, tracker: Tracker):
        self.camera, self.tracker = camera, tracker
        self.counts = dict.fromkeys(COUNTS, 0)
        self._repeats = Repeats()

    def open(self) -> None:
        """Opens the camera."""
        self.camera.open()

    def close(self) -> None:
        """Closes the camera."""
        self.camera.close()

    def _found(self, t: float, image: np.ndarray) -> Fix | None:
        self.counts["frames"] += 1
        if self._repeats(image):
            self.counts["repeated"] += 1
            return None
        fix = self.tracker.locate(image, t)
        self.counts["fixes"] += fix is not None
        return fix


class InStep(Looking):
    """Examines every frame on request: for lockstep, in which time waits."""

    def fixes(self, now: float) -> list[Fix]:
        """Fixes of all frames up to `now` [s]."""
        found = [self._found(t, image) for t, image in self.camera.read(now)]
        return [fix for fix in found if fix is not None]


class Newest(Looking):
    """Examines the newest waiting frame and skips older ones."""

    def look(self, most: float) -> Fix | None:
        """Fix of the next picture, waiting up to `most` s for it; None without one. Raises the camera's errors."""
        frames = self.camera.wait(most)
        self.counts["skipped"] += max(len(frames) - 1, 0)
        return self._found(*frames[-1]) if frames else None


class InProcess:
    """Camera and tracker in a process of their own, which ends with this one.

    Args:
        words: its command line. It prints the lines above, the first one empty once its camera is open.

    Attributes:
        failed: error that ended the fixes, None before.
    """

    def __init__(self, words: Sequence[str]):
        self.words = list(words)
        self.counts = dict.fromkeys(COUNTS, 0)
        self.failed: Exception | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._told: IO[bytes] | None = None
        self._text = b""

    def open(self) -> None:
        """Starts the process and waits until its camera is open. Raises ConfigError with the process's own message."""
        self._told = tempfile.TemporaryFile()  # noqa: SIM115  open as long as the process
        # Ctrl-C is for the host, which brings the fish to rest first
        self._process = start_command(self.words, stdin=subprocess.DEVNULL, stderr=self._told)
        end = time.monotonic() + STARTS
        while b"\n" not in self._text and self.failed is None and time.monotonic() < end:
            select.select([self._pipe], [], [], 0.1)
            self._read()
        if b"\n" in self._text:
            return
        why = self.failed or f"no picture within {STARTS:g} s"
        self.close()
        raise ConfigError(str(why).removeprefix("tracker: "))

    def fixes(self, now: float) -> list[Fix]:
        """Fixes that the process has printed since the last call."""
        self._read()
        found, (*lines, self._text) = [], self._text.split(b"\n")
        for line in filter(None, lines):
            packet = json.loads(line)
            if "failed" in packet:
                self.failed = ConfigError(packet["failed"])
                continue
            self.counts = dict(zip(COUNTS, packet["counts"], strict=True))
            if "t" in packet:
                x, y, yaw = packet["pose"]
                found.append(Fix(packet["t"], x, y, yaw, np.reshape(packet["covariance"], (3, 3)), packet["quality"]))
        return found

    def close(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None:
            end_command(process, ENDS)
        if self._told is not None:
            self._told.close()
            self._told = None

    @property
    def _pipe(self) -> int:
        return self._process.stdout.fileno() if self._process is not None and self._process.stdout is not None else -1

    def _read(self) -> None:
        """Reads the output since the last call; does not wait."""
        while self._process is not None and self.failed is None and select.select([self._pipe], [], [], 0.0)[0]:
            data = os.read(self._pipe, 65536)
            if not data:
                self.failed = ConfigError(f"tracker: {self._last_words()}")
            self._text += data

    def _last_words(self) -> str:
        """Reason for the end of the process, from its own message."""
        if self._told is None or self._process is None:
            return "closed"
        self._told.seek(0)
        said, code = self._told.read(100_000).decode("utf-8", "replace"), self._process.wait()
        return last_words(said)[:300] or f"its process ended with exit code {code}"
