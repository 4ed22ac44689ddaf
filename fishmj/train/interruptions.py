"""What a run outlives: a signal in the middle of an update, and a disk without room."""

import errno
import signal
import time
from collections.abc import Callable
from contextlib import contextmanager

from fishmj import console, interrupt

FULL = (errno.ENOSPC, errno.EDQUOT)
PAUSE = 5.0  # s between two tries on a full disk


@contextmanager
def stop_on_signal(words: interrupt.Words = str):
    """A list that fills on Ctrl-C or SIGTERM instead of an exception in the middle of an update.

    words: of `interrupt.finishing`, for an update that takes longer than an interrupt may.
    """
    asked: list[int] = []
    old = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            old[number] = signal.signal(number, lambda n, _: asked.append(n))
    except ValueError:  # not the main thread: the caller keeps its own handlers
        pass
    try:
        with interrupt.finishing(words):
            yield asked
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def when_there_is_room(write: Callable[[], object], asked: list, pause: float | None = None) -> bool:
    """Call `write()`; on a full disk say what it needs, wait and try again.

    Returns:
        True when it is written; False when a stop was asked for while there was no room. Any other failure is raised.
    """
    pause = PAUSE if pause is None else pause
    waiting = False
    while True:
        try:
            write()
        except OSError as error:  # a StoreError is one, and keeps the errno
            if error.errno not in FULL:
                raise
            if asked:
                console.warn(f"not saved: {error}")
                return False
            if not waiting:
                console.warn(f"paused: {error}; looking again every {pause:g} s, Ctrl-C stops without this save")
            waiting = True
        else:
            if waiting:
                console.warn("there is room again: saved, going on")
            return True
        until = time.monotonic() + pause
        while time.monotonic() < until and not asked:
            time.sleep(min(0.1, pause))
