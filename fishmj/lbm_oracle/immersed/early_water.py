"""On the CPU, water out of reach of this step's force is stepped while the markers read the water round them.

    response, solve, spread      one core: small kernels in one thread
    far planes of x              the other cores, from the start of the step
    near planes                  all cores, as soon as the force is known

A plane of x needs the last step's water only, so the parts may come in any order: every number is the same to the bit.
"""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from threading import Lock
from typing import Any

from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.slabs import THINNEST, slab_pool, split_wrapped

SHARE = 8  # parts of the box for each core
SMALL = 2  # so many of them, those at the end, are halved: all cores end together


class EarlyWater:
    """Does one step of a `Fluid` in parts, on several cores."""

    def __init__(self, fluid: Fluid):
        self.fluid, self._grain = fluid, max(THINNEST, fluid.shape[0] // (SHARE * fluid.threads))
        self._waiting: deque = deque()
        self._workers: list[Future] = []
        self._lock, self._working = Lock(), 0  # threads that look for parts

    def begin(self, first: int, count: int) -> None:
        """Starts all planes except `count` world planes of x from `first` on, which hold all cells that a force may reach."""
        size, grain = self.fluid.shape[0], self._grain
        low = first // grain * grain
        wide = -(-(first + count) // grain) * grain - low
        self._near = (low, wide) if wide < size else (0, size)
        self._workers, self._working = [], 0
        self._begin(self._parts(self._near[0] + self._near[1], size - self._near[1]))

    def finish(self) -> None:
        """Does the rest of the step once the force is known, and counts the step."""
        self._begin(self._parts(*self._near, small=SMALL * self._grain))
        with self._lock:
            self._working += 1
        self._work()
        for worker in self._workers:
            worker.result()
        self.fluid.skip(1)

    def _parts(self, first: int, count: int, small: int = 0) -> list[Any]:
        """Launches for so many world planes; the last `small` of them in half parts, so that all cores end together."""
        made = []
        for start, planes in split_wrapped(first, count, self.fluid.shape[0]):
            low, end = start, start + planes
            while low < end:
                size = min(self._grain if end - low > small else self._grain // 2, end - low)
                made.append(self.fluid.planes(low, size))
                low += size
        return made

    def _begin(self, parts: Iterable[Any]) -> None:
        """Offers the parts to all other cores; one thread more than there are cores would delay one of them."""
        with self._lock:
            self._waiting.extend(parts)
            more = self.fluid.threads - 1 - self._working
            self._working += more
        self._workers += [slab_pool().submit(self._work) for _ in range(more)]

    def _work(self) -> None:
        """Runs part after part until none is left."""
        while True:
            with self._lock:
                if not self._waiting:
                    self._working -= 1
                    return
                part = self._waiting.popleft()
            part.launch()
