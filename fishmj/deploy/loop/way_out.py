"""The way out of a robot that swims: a signal asks it to stop, and it has the time to come to rest and to let go.

    first Ctrl-C, SIGTERM or SIGHUP    `stop` is set; the loop brings the joints to zero and lets go by itself, within GRACE
    a second one, or GRACE is over     `let_go` is called at once, several times, and the process ends

Nothing else ends the process meanwhile.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event

from fishmj.base import interrupt

GRACE = 6.0  # s: joints to zero 2.0, letting go 0.2, writing the log of a long swim; it ends as soon as all that is done
TIMES = 5  # that a robot is told to let go where nothing waits for its answer
APART = 0.01  # s between them


@contextmanager
def way_out(stop: Event, let_go: Callable[[], object], words: Callable[[], str], grace: float = GRACE) -> Iterator[None]:
    """Within, a signal sets `stop`, and the loop that looks at it has `grace` s.

    Args:
        let_go: tells the robot once to let go, now; called from another thread, where the loop does not come to its own end.
        words: keeps what is not kept yet and says what was; for the last line, only where the loop does not come to its own end.
    """

    def last() -> None:
        for _ in range(TIMES):
            with suppress(Exception):  # a link that is gone must not keep the others from being told
                let_go()
            time.sleep(APART)

    with interrupt.finishing(words, grace=grace, heard=stop.set, last=last):
        yield
