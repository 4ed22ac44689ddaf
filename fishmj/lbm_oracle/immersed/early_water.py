"""On the CPU: water that this step's force cannot reach is stepped while the markers ask the water round them.

    response, solve, spread      one core: small kernels in one thread
    far planes of x              the other cores, from the step's begin on
    near planes                  all cores, as soon as the force is known

A plane of x needs the last step's water only, so the parts may come in any order: every figure is the same to the bit.
"""

from collections import deque
from concurrent.futures import Future

from fishmj.lbm_oracle.fluid.fluid import THINNEST, Fluid, pieces, pool

SHARE = 8  # parts of the box for each core: small enough that all end together


class EarlyWater:
    """One step of a `Fluid` in parts, on several cores."""

    def __init__(self, fluid: Fluid):
        self.fluid, self._grain = fluid, max(THINNEST, fluid.shape[0] // (SHARE * fluid.threads))
        self._waiting: deque = deque()
        self._workers: list[Future] = []

    def begin(self, first: int, count: int) -> None:
        """Start on all but `count` world planes of x from `first` on, which hold all cells that a force may reach."""
        size, grain = self.fluid.shape[0], self._grain
        low = first // grain * grain
        wide = -(-(first + count) // grain) * grain - low
        self._near = (low, wide) if wide < size else (0, size)
        self._add(self._near[0] + self._near[1], size - self._near[1])
        self._workers = [pool().submit(self._work) for _ in range(self.fluid.threads - 1)]

    def finish(self) -> None:
        """The rest of the step, the force being known; then it is counted."""
        self._add(*self._near)
        more = [pool().submit(self._work) for _ in range(self.fluid.threads - 1)]  # those of `begin` may have gone home
        self._work()
        for worker in (*self._workers, *more):
            worker.result()
        self._workers = []
        self.fluid.skip(1)

    def _add(self, first: int, count: int) -> None:
        """Parts of so many world planes to what waits."""
        for start, planes in pieces(first, count, self.fluid.shape[0]):
            for low in range(start, start + planes, self._grain):
                self._waiting.append(self.fluid.planes(low, min(self._grain, start + planes - low)))

    def _work(self) -> None:
        """Part after part until none waits."""
        while True:
            try:
                part = self._waiting.popleft()
            except IndexError:
                return
            part.launch()
