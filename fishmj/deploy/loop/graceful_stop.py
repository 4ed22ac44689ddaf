"""Graceful stop of a swimming robot: a signal requests it, and the robot gets the time to come to rest and switch torque off.

    first Ctrl-C, SIGTERM or SIGHUP    `stop` is set; the loop brings the joints to zero and disarms by itself, within GRACE
    a second one, or GRACE is over     `let_go` is called at once, several times, and the process ends

Nothing else ends the process in between.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from threading import Event

from fishmj.base import interrupt
from fishmj.deploy.link.links import RobotLink
from fishmj.deploy.loop.clock import Clock, MonotonicClock, first_in_line

GRACE = 6.0  # s: joints to zero 2.0, letting go 0.2, writing the log of a long swim; it ends as soon as all that is done
TIMES = 5  # that a robot is told to let go where nothing waits for its answer
APART = 0.01  # s between them


@contextmanager
def graceful_stop(stop: Event, let_go: Callable[[], object], words: Callable[[], str]) -> Iterator[None]:
    """Context in which a signal sets `stop`; the loop that reads it has `GRACE` s to end.

    Args:
        let_go: requests torque off once, now; called from another thread if the loop does not end by itself.
        words: saves the remaining data and returns a report for the last line; only called if the loop does not end by itself.
    """

    def last() -> None:
        for _ in range(TIMES):
            with suppress(Exception):  # a link that is gone must not keep the others from being told
                let_go()
            time.sleep(APART)

    with interrupt.finishing(words, grace=GRACE, heard=stop.set, last=last):
        yield


@contextmanager
def steering(link: RobotLink, clock: Clock, stop: Event, words: Callable[[], str]) -> Iterator[bool]:
    """Context of a loop that steers a robot: `graceful_stop`, and before other threads. Yields True if the system permits that.

    In lockstep it does not go before the others: a loop that never waits would keep everything else waiting.
    """
    ahead = first_in_line() if isinstance(clock, MonotonicClock) else nullcontext(False)
    with graceful_stop(stop, lambda: link.disarm(clock.now()), words), ahead as first:
        yield first
