"""Worker processes of a command: they ignore Ctrl-C, end with the command, and share the cores.

with deaf():
    pipe, process = beside(work, ...)   Ctrl-C is left to the parent (`interrupt`)
ends_with_its_parent()                  first call in the worker: it ends whenever its parent ends
bind(number, of)                        the worker takes cores number, number + of, ... of those that it may run on
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
    """Starts a process that runs `work(pipe, *args)`. Returns our end of the pipe and the process.

    The process is killed if this one ends. It is spawned, because a fork of a process that has used a GPU cannot use it.
    All arguments must be picklable.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs, *args), name=name or None, daemon=True)
    process.start()
    theirs.close()
    return ours, process


@contextmanager
def deaf() -> Iterator[None]:
    """Context in which started processes ignore Ctrl-C, also while they import; the parent handles it."""
    ensure_running()  # what frees semaphores takes the block off where it is begun meanwhile
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ends_with_its_parent() -> None:
    """Makes this process end when its parent ends, for whatever reason."""
    threading.Thread(target=_orphaned, name="orphaned", daemon=True).start()


def bind(number: int, of: int) -> None:
    """Binds this process to its share of the cores, at least one; does nothing on a system without core affinity.

    Args:
        number: index from 0 of this process among the `of` processes that share the cores.
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, set(cores[number::of]) or {cores[number % len(cores)]})


def _orphaned() -> None:
    """Waits for the end of the parent process."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
