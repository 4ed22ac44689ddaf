"""The host's time. The loop asks a clock, so that the very same loop runs in real time and in lockstep with a simulated robot."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

PRIORITY = 10  # of 99, among threads that go before all ordinary ones: the loop
HEARING, SEEING = 9, 5  # who takes datagrams in, and who looks for the fish


class Clock(Protocol):
    """Seconds that only rise."""

    def now(self) -> float:
        """s since any fixed moment."""

    def sleep_until(self, t: float) -> None:
        """Return at `t` or later; at once where that has passed."""


class MonotonicClock:
    """This computer's monotonic clock, the one that the camera's stamps are on as well."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        left = t - time.monotonic()
        if left > 0:
            time.sleep(left)


@contextmanager
def first_in_line(priority: int = PRIORITY) -> Iterator[bool]:
    """Within, this thread goes before ordinary ones, where the system allows it (Linux, with the right to); whether it does.

    Of several such threads the one with the higher `priority`, 1 to 99, goes first. Threads and processes that begin within are
    ordinary.
    """
    allowed = False
    if hasattr(os, "SCHED_RESET_ON_FORK"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
            allowed = True
    try:
        yield allowed
    finally:
        if allowed:
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
