"""A ring of camera frames in shared memory: one writer, any number of readers, no copy through a socket.

    int64[8]    magic, width, height, slots, newest, rate mHz, 0, 0
    per slot    int64 number, float64 captured, uint8[height][width][3] BGR

`newest` is the slot of the newest complete frame, -1 before the first. `captured` is on the machine's monotonic clock, s.
`number` is 2 n of the n-th frame, from n = 1, and odd while the slot is being written. A reader that finds an odd number, or
another one after copying, drops the torn frame (a sequence lock), as `camera.cameras.SharedFrames` does. Slots follow each
other without gaps, 16 + 3 W H bytes each.
"""

from multiprocessing import shared_memory

import numpy as np

from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.camera.cameras import MAGIC

FIELDS = 8
HEADER, SLOT = 8 * FIELDS, 16  # bytes
SLOTS = 6
_NEWEST = 4


class FrameWriter:
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
        self.memory, self.width, self.height, self.slots = memory, width, height, slots
        self.name, self.count = memory.name, 0
        self.header = np.ndarray((FIELDS,), np.int64, memory.buf)
        begins = [HEADER + k * (SLOT + 3 * width * height) for k in range(slots)]
        self.numbers = [np.ndarray((1,), np.int64, memory.buf, begin) for begin in begins]
        self.stamps = [np.ndarray((1,), np.float64, memory.buf, begin + 8) for begin in begins]
        self.images = [np.ndarray((height, width, 3), np.uint8, memory.buf, begin + SLOT) for begin in begins]
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
        """Returns the memory to the machine; readers keep their mapping. May be called twice."""
        self.header, self.numbers, self.stamps, self.images = np.zeros(FIELDS, np.int64), [], [], []
        self.memory.close()
        try:
            self.memory.unlink()
        except FileNotFoundError:
            pass  # somebody has cleaned up
