"""Processes beside a command: Ctrl-C is left to the command (`interrupt`), and they end with it.

with sigint_blocked():
    pipe, process = spawn_worker(work, ...)   runs a function of ours
ends_with_its_parent()                  first in the worker: however the parent ends, nobody would take the answer
bind(number, of)                        the worker takes the cores number, number + of, ... of those that it may run on

process = start_command(words, ...)     runs a command line
end_command(process, patience)          the command's `last_words` say why it ended by itself
"""

import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.resource_tracker import ensure_running
from typing import Any


def spawn_worker(work: Callable[..., None], *args: Any, name: str = "") -> tuple[Connection, BaseProcess]:
    """Starts a process that does `work(pipe, *args)`: our end of the pipe, and the process, which is killed if this one ends.

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
def sigint_blocked() -> Iterator[None]:
    """Blocks Ctrl-C for processes begun meanwhile, even while they import: it is left to the one that began them."""
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


def start_command(words: Sequence[str], **pipes: Any) -> subprocess.Popen[Any]:
    """Starts a command line in a session of its own, which Ctrl-C does not reach; its output comes by a pipe.

    pipes: more arguments of `Popen`.
    """
    return subprocess.Popen(words, stdout=subprocess.PIPE, start_new_session=True, **pipes)


def end_command(process: subprocess.Popen[Any], patience: float = 0.0) -> None:
    """Ends a process and closes its pipes: asks it, and kills it after `patience` seconds; 0: kills it at once."""
    if patience:
        process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for pipe in (process.stdout, process.stdin):
        with suppress(OSError, ValueError):
            if pipe is not None:
                pipe.close()


def last_words(said: str) -> str:
    """Last line of what a command of fishmj printed, without its name; "" where it printed nothing."""
    return said.strip().splitlines()[-1].removeprefix("fishmj: ") if said.strip() else ""


def _orphaned() -> None:
    """Waits for the end of the parent process."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
