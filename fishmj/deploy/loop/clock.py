"""The host's time. The loop asks a clock, so that the same loop runs in real time and in lockstep with a simulated robot."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

PRIORITY = 10  # of 99, among threads that go before all ordinary ones: the loop
HEARING, SEEING = 9, 5  # who takes datagrams in, and who looks for the fish


class Clock(Protocol):
    """Interface of a monotonic clock in seconds."""

    def now(self) -> float:
        """Time since any fixed moment, s."""

    def sleep_until(self, t: float) -> None:
        """Returns at `t` [s] or later; at once if that has passed."""


class MonotonicClock:
    """This computer's monotonic clock, which also stamps the camera's pictures."""

    def now(self) -> float:
        """Time on the monotonic clock, s."""
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        """Sleeps until `t` [s]; returns at once if that has passed."""
        left = t - time.monotonic()
        if left > 0:
            time.sleep(left)


@contextmanager
def first_in_line(priority: int = PRIORITY) -> Iterator[bool]:
    """Context in which this thread runs before ordinary ones, if the system permits it. Yields True if so.

    It needs Linux and the right to set priorities. Of several such threads the one with the higher `priority`, 1 to 99, goes
    first. Threads and processes that start inside are ordinary.
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
