"""Processes that a command begins beside itself: deaf to Ctrl-C, ending with it, each with its share of the cores.

with deaf():
    pipe, process = beside(work, ...)   Ctrl-C is left to the one that began it (`interrupt`)
ends_with_its_parent()                  first in the process: however the other ends, nobody would take the answer
bind(number, of)                        it takes the cores number, number + of, ... of those that it may run on
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.resource_tracker import ensure_running
from typing import Any


def beside(work: Callable[..., None], *args: Any, name: str = "") -> tuple[Connection, BaseProcess]:
    """A process that does `work(pipe, *args)`: our end of the pipe, and the process, which is killed if this one ends.

    It is spawned: a fork of a process that has used a GPU cannot use it. All can be pickled.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs, *args), name=name or None, daemon=True)
    process.start()
    theirs.close()
    return ours, process


@contextmanager
def deaf() -> Iterator[None]:
    """Processes begun meanwhile do not hear Ctrl-C, not even while they import: it is left to the one that began them."""
    ensure_running()  # what frees semaphores takes the block off where it is begun meanwhile
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ends_with_its_parent() -> None:
    """From now on this process ends when the one that began it does, however that ends."""
    threading.Thread(target=_orphaned, name="orphaned", daemon=True).start()


def bind(number: int, of: int) -> None:
    """Keep this process to its share of the cores, one at least; where the system cannot, it stays as it is.

    Args:
        number: from 0, of `of` processes that share what this one may run on.
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, set(cores[number::of]) or {cores[number % len(cores)]})


def _orphaned() -> None:
    """Waits for the end of the process that began this one."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
