"""A ring of camera frames in shared memory: one writer, any number of readers, no copy through a socket.

    int64[8]    magic, width, height, slots, newest, rate mHz, 0, 0
    per slot    int64 number, float64 captured, uint8[height][width][3] BGR

`newest` is the slot of the newest complete frame, -1 before the first. `captured` is on the machine's monotonic clock, s.
`number` is 2 n of the n-th frame, from n = 1, and odd while the slot is being written. A reader that finds an odd number, or
another one after copying, drops the torn frame (a sequence lock). Slots follow each other without gaps, 16 + 3 W H bytes each.
"""

from multiprocessing import resource_tracker, shared_memory
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError, StoreError

MAGIC = 0x464D4A46  # "FMJF"
FIELDS = 8
HEADER, SLOT = 8 * FIELDS, 16  # bytes
SLOTS = 6
_NEWEST, _RATE = 4, 5


class SharedFrame(NamedTuple):
    """One frame."""

    number: int  # from 1
    t: float  # s, when it was captured
    image: np.ndarray  # (H, W, 3) uint8 BGR


class _Ring:
    """Views of the memory."""

    def __init__(self, memory: shared_memory.SharedMemory, width: int, height: int, slots: int):
        self.memory, self.width, self.height, self.slots = memory, width, height, slots
        self.header = np.ndarray((FIELDS,), np.int64, memory.buf)
        step = SLOT + 3 * width * height
        begins = [HEADER + k * step for k in range(slots)]
        self.numbers = [np.ndarray((1,), np.int64, memory.buf, begin) for begin in begins]
        self.stamps = [np.ndarray((1,), np.float64, memory.buf, begin + 8) for begin in begins]
        self.images = [np.ndarray((height, width, 3), np.uint8, memory.buf, begin + SLOT) for begin in begins]

    def close(self) -> None:
        """Detaches from the memory; may be called twice."""
        self.header, self.numbers, self.stamps, self.images = np.zeros(FIELDS, np.int64), [], [], []
        self.memory.close()


class FrameWriter(_Ring):
    """Makes the ring and owns it.

    Args:
        width, height: px. rate: frames a second, for readers' information. slots: of the ring, 2 at least.

    Attributes:
        name: for readers.

    Raises ConfigError: an impossible size; StoreError: the machine has no room for it.
    """

    def __init__(self, width: int, height: int, rate: float, slots: int = SLOTS):
        if not (1 <= width <= 16384 and 1 <= height <= 16384 and slots >= 2 and rate > 0):
            given = f"{width} x {height} px, {slots} slots, {rate} frames/s"
            raise ConfigError(f"frames: {given}; expected 1 to 16384 px, 2 slots or more, a rate above 0")
        size = HEADER + slots * (SLOT + 3 * width * height)
        try:
            memory = shared_memory.SharedMemory(create=True, size=size)
        except OSError as error:
            raise StoreError(f"frames: no shared memory of {size / 1e6:.0f} MB: {error.strerror or error}") from error
        super().__init__(memory, width, height, slots)
        self.name, self.count = memory.name, 0
        self.header[1:] = (width, height, slots, -1, round(1000 * rate), 0, 0)
        self.header[0] = MAGIC  # last: a reader that comes early finds no ring

    def write(self, image: np.ndarray, t: float) -> int:
        """Writes a frame (H, W, 3) uint8 that was captured at t [s] over the oldest; returns its number.

        Raises ConfigError: an image of another size or kind.
        """
        if image.shape != (self.height, self.width, 3) or image.dtype != np.uint8:
            raise ConfigError(f"frames: image {image.shape} {image.dtype}; expected ({self.height}, {self.width}, 3) uint8")
        slot = self.count % self.slots
        self.begin(slot)
        self.stamps[slot][0] = t
        self.images[slot][:] = image
        return self.finish(slot)

    def begin(self, slot: int) -> None:
        """Marks a slot as being written."""
        self.numbers[slot][0] = 2 * self.count + 1

    def finish(self, slot: int) -> int:
        """Marks a slot as complete and newest; returns the frame's number."""
        self.count += 1
        self.numbers[slot][0] = 2 * self.count
        self.header[_NEWEST] = slot
        return self.count

    def close(self) -> None:
        """Returns the memory to the machine; readers keep their mapping."""
        super().close()
        try:
            self.memory.unlink()
        except FileNotFoundError:
            pass  # somebody has cleaned up


class SharedFrameReader(_Ring):
    """Reads a ring of another process. Raises StoreError: no ring of that name, or something else."""

    def __init__(self, name: str):
        memory = _attach(name)
        header = np.ndarray((FIELDS,), np.int64, memory.buf).copy() if memory.size >= HEADER else np.zeros(FIELDS, np.int64)
        magic, width, height, slots = (int(value) for value in header[:4])
        sound = magic == MAGIC and 1 <= width <= 16384 and 1 <= height <= 16384 and slots >= 2
        if not sound or memory.size < HEADER + slots * (SLOT + 3 * width * height):
            memory.close()
            raise StoreError(f"frames: shared memory {name[:60]!r} holds no ring of camera frames")
        super().__init__(memory, width, height, slots)
        self.rate, self.torn, self._last = header[_RATE] / 1000.0, 0, 0

    def newest(self) -> SharedFrame | None:
        """The newest frame, if it was not returned before; None also if the writer was faster three times in a row."""
        for _ in range(3):
            slot = int(self.header[_NEWEST])
            if not 0 <= slot < self.slots:
                return None
            before = int(self.numbers[slot][0])
            if before % 2 == 0 and before // 2 == self._last:
                return None
            found = SharedFrame(before // 2, float(self.stamps[slot][0]), self.images[slot].copy())
            if before % 2 == 0 and int(self.numbers[slot][0]) == before:
                self._last = found.number
                return found
            self.torn += 1
        return None


def _attach(name: str) -> shared_memory.SharedMemory:
    """The memory of that name, not owned: Python 3.11 and 3.12 would otherwise remove it when this process ends."""
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return shared_memory.SharedMemory(name=name)
    except (OSError, ValueError) as error:
        raise StoreError(f"frames: no shared memory {name[:60]!r}: {getattr(error, 'strerror', '') or error}") from error
    finally:
        resource_tracker.register = register
