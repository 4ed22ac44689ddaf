"""Bus ticks on a fixed grid, t_k = t_0 + k T. A late tick is counted, and never caught up in a burst.

A tick that starts late runs at once. Grid points that have passed by then, and one less than T / 2 ahead, are dropped and
counted. So two commands are never less than T / 2 apart, and the grid itself does not drift.
"""

from math import floor
from typing import NamedTuple

import numpy as np

from fishmj.deploy.loop.clock import Clock

BIN, BINS = 5e-5, 1000  # s, and how many: lateness up to 50 ms is told in steps of 0.05 ms
LATE = 2e-3  # s, a tick that starts later than this is a late one


class Tick(NamedTuple):
    """One beat of the bus.

    Attributes:
        slot: number of its grid point. began: s on the clock. late: s after the awaited grid point.
        dropped: grid points without a tick since the tick before.
    """

    slot: int
    began: float
    late: float
    dropped: int


class Ticker:
    """Waits for the next grid point.

    Args:
        period: s between two.

    Attributes:
        count: ticks so far. late: those that began more than LATE after their grid point. dropped: grid points without a tick.
        worst: largest lateness, s. histogram: (BINS + 1,) ticks by lateness in steps of BIN s; the last bin holds all later ones.
    """

    def __init__(self, clock: Clock, period: float):
        self.clock, self.period, self.start = clock, period, clock.now()
        self.count = self.late = self.dropped = 0
        self.worst = 0.0
        self.histogram = np.zeros(BINS + 1, int)
        self._last, self._next = -1, 0

    def wait(self) -> Tick:
        """Sleeps until the next grid point."""
        due = self.start + self._next * self.period
        self.clock.sleep_until(due)
        began = self.clock.now()
        late = max(began - due, 0.0)
        slot = self._next + floor(late / self.period + 1e-9)
        tick = Tick(slot, began, late, slot - self._last - 1)
        ahead = self.start + (slot + 1) * self.period - began
        self._last, self._next = slot, slot + (1 if ahead > self.period / 2 else 2)
        self.count, self.dropped, self.worst = self.count + 1, self.dropped + tick.dropped, max(self.worst, late)
        self.late += late > LATE
        self.histogram[min(int(late / BIN), BINS)] += 1
        return tick

    def lateness(self, share: float) -> float:
        """Lateness [s] that a share (0 to 1) of the ticks stayed below, rounded up to BIN; `worst` beyond the histogram."""
        if not self.count:
            return 0.0
        at = int(np.searchsorted(np.cumsum(self.histogram), share * self.count))
        return min((at + 1) * BIN, self.worst) if at < BINS else self.worst

    def figures(self) -> dict[str, float]:
        """Figures for logs: ticks, late, dropped, and the lateness in ms of the median tick, of 99 %, and of the latest."""
        ms = {"p50_ms": self.lateness(0.5), "p99_ms": self.lateness(0.99), "worst_ms": self.worst}
        counts = {"ticks": self.count, "late": int(self.late), "dropped": self.dropped}
        return counts | {key: round(1e3 * value, 3) for key, value in ms.items()}
