"""Ctrl-C, SIGTERM and SIGHUP of a fishmj command: it ends within five seconds with exit code 130 (143, 129), at any moment.

Raising an exception is not safe. Compilers (XLA, numba, Warp) run for minutes inside one call, where Python neither runs a
signal's handler nor raises. Code in such a call may swallow an exception. An interpreter that is torn down beside running XLA
threads crashes. So a thread waits for the signal instead, lets the verb save its state, prints how to go on, and ends the
process. Nothing is lost, because every write is atomic (`store`) and finished work is on disk already. This works while
compilers run, because they all release the interpreter lock.

    with keeping(words):          on an interrupt, words() is called in another thread: it saves what is not saved yet and
                                  returns what was saved and how to go on
    with finishing(words):        the same for a loop that stops by itself: it has GRACE seconds before words() is called; a
                                  loop that must bring a robot to rest asks for more, and names the very last action
    with raising():               Ctrl-C raises KeyboardInterrupt here, as usual in Python: for parts that users end that way

A command (`python -m fishmj...` or the script `fishmj`) is watched from the import of `fishmj` on. A program that imports fishmj
is not watched and keeps its own handlers.
"""

import atexit
import os
import select
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path, PurePath
from typing import NamedTuple, NoReturn

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}
SAID = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
if hasattr(signal, "SIGHUP"):  # a terminal that was closed, a connection that was dropped
    CODES[signal.SIGHUP], SAID[signal.SIGHUP] = 129, "hung up"
GRACE = 2.0  # s that a verb has which stops by itself
LIMIT = 4.5  # s after which the process ends, whatever is still being kept; a longer grace moves it
TWICE = 0.5  # s after which another signal counts as asked twice (some launchers pass the terminal's own on)

Words = Callable[[], str]


class ExitPlan(NamedTuple):
    """Exit plan of a part of a verb: its save function, the seconds that it has to end by itself, and its last action."""

    words: Words
    grace: float
    heard: Callable[[], object] | None
    last: Callable[[], object] | None


writing = threading.RLock()  # held while a file is written, so that no half of it stays behind
_asked: list[int] = []
_kept: list[ExitPlan] = []  # innermost last
_closed: list[float] = []  # monotonic s at which the last loop that stops by itself ended
_leaving = threading.Lock()
_armed = False
_left_alone: set[int] = set()
_tell: list[Callable[[str], object]] = []


def is_command() -> bool:
    """Returns True if this process was started as `python -m fishmj...` or as the script `fishmj`."""
    words = sys.orig_argv
    if "-m" in words:
        module = "".join(words[words.index("-m") + 1 :][:1])
        return module.partition(".")[0] == "fishmj"
    return PurePath(sys.argv[0] if sys.argv else "").stem == "fishmj"


def arm() -> None:
    """Starts to watch for these signals if this process is a command. An ignored signal (as by nohup) stays ignored."""
    global _armed
    if _armed or os.name != "posix" or threading.current_thread() is not threading.main_thread() or not is_command():
        return
    heard, write = os.pipe()
    os.set_blocking(write, False)
    threading.Thread(target=_watch, args=(heard,), name="interrupt", daemon=True).start()
    for number in CODES:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _nothing)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    os.register_at_fork(after_in_child=disarm)
    _armed = True


def disarm() -> None:
    """Restores the system's handling of these signals, in a fork."""
    global _armed
    if not _armed:
        return
    _armed = False
    signal.set_wakeup_fd(-1)
    for number in CODES:
        if signal.getsignal(number) is _nothing:
            signal.signal(number, signal.SIG_DFL)


def asked() -> bool:
    """Returns True while this command is being interrupted."""
    return bool(_asked)


def again(verb: str = "go on") -> str:
    """`go on with: fishmj evaluate dob --out runs/dob`, the command line of this process; in a program `the same command`."""
    if not is_command():
        return f"{verb} with the same command"
    words = sys.orig_argv
    if "-m" in words:
        module, *rest = words[words.index("-m") + 1 :]
        given = [*module.split(".")[1:], *rest]
    else:
        given = sys.argv[1:]
    return f"{verb} with: {shlex.join(['fishmj', *given])}"


def telling(tell: Callable[[str], object]) -> None:
    """Makes `tell(message)` print the last line."""
    _tell[:] = [tell]


@contextmanager
def keeping(words: Words) -> Iterator[None]:
    """Context in which an interrupt calls `words()`, which saves what is not saved yet; the last line ends with its answer."""
    with _leaving_by(ExitPlan(words, 0.0, None, None)):
        yield


def finishing(
    words: Words, *, grace: float = GRACE, heard: Callable[[], object] | None = None, last: Callable[[], object] | None = None
) -> AbstractContextManager[None]:
    """Like `keeping`, for a loop that reacts to the signals itself: it has `grace` s to come to its end.

    Args:
        heard: called at the first signal, in another thread. last: called before the process ends without the loop's own end:
            after `grace`, and at once at a second signal. It must not wait.
    """
    return _leaving_by(ExitPlan(words, grace, heard, last))


@contextmanager
def _leaving_by(plan: ExitPlan) -> Iterator[None]:
    _kept.append(plan)
    try:
        if _asked and plan.heard is not None:
            plan.heard()
        yield
    finally:
        _kept.remove(plan)
        if plan.grace:
            _closed[:] = [time.monotonic()]


@contextmanager
def raising() -> Iterator[None]:
    """Context in which Ctrl-C raises KeyboardInterrupt in the main thread."""
    if not _armed:
        yield
        return
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    _left_alone.add(signal.SIGINT)
    try:
        yield
    finally:
        _left_alone.discard(signal.SIGINT)
        signal.signal(signal.SIGINT, before)


@contextmanager
def stop_requests(once: bool = False) -> Iterator[list[int]]:
    """Yields a list that fills on Ctrl-C or SIGTERM, instead of an exception that leaves a step half done.

    once: a second signal raises KeyboardInterrupt. Outside the main thread the caller keeps its own handlers.
    """
    asked: list[int] = []

    def hear(number, frame) -> None:
        if once and asked:
            raise KeyboardInterrupt
        asked.append(number)

    old = {}
    with suppress(ValueError):  # not the main thread
        for number in (signal.SIGINT, signal.SIGTERM):
            old[number] = signal.signal(number, hear)
    try:
        yield asked
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def leave(words: "str | None" = "") -> NoReturn:
    """Prints the last line (None: already printed), ends the children and the process, without the interpreter's own teardown."""
    _leaving.acquire()  # never given back: whoever comes second waits for the end
    with suppress(Exception):
        if words is None:
            _at_once()
        said = SAID[signal.Signals(_asked[0])] if _asked else SAID[signal.SIGINT]
        message = f"{said}; {words}" if words else said
        _tell[0](message) if _tell else os.write(2, f"fishmj: {message}\n".encode())
    _at_once()


def finish(code: int) -> None:
    """Ends a command that was not interrupted; does nothing in a program that keeps its own handlers.

    Functions registered with `atexit` run. The interpreter's teardown does not: Ctrl-C during it would be a death by signal.
    """
    if not _armed:
        return
    with suppress(Exception):
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):  # closed, or its reader is gone
            stream.flush()
    os._exit(code)


def code() -> int:
    """Exit code of the interrupt."""
    return CODES[signal.Signals(_asked[0])] if _asked else CODES[signal.SIGINT]


def _nothing(number, frame) -> None:
    """Does nothing: handler while a command is watched, since the thread has received the signal already."""


def _watch(heard: int) -> None:
    """Thread that waits for the first signal, then for the end, a second signal or the time limit."""
    first, limit = 0.0, LIMIT
    while True:
        if _asked and not select.select([heard], [], [], max(first + limit - time.monotonic(), 0.0))[0]:
            os._exit(code())
        numbers = [number for number in os.read(heard, 64) if number in CODES and number not in _left_alone]
        if not numbers:
            continue
        if not _asked:
            first = time.monotonic()
            limit = LIMIT + max(_kept[-1].grace - GRACE, 0.0) if _kept else LIMIT
            _asked.append(numbers[0])
            threading.Thread(target=_end, name="interrupted", daemon=True).start()
        elif time.monotonic() - first > TWICE:
            first = min(first, time.monotonic() - limit + 1.0)
            threading.Thread(target=_at_once, name="interrupted twice", daemon=True).start()


def _end() -> None:
    """Saves, prints and ends the process after the first signal."""
    plan = _kept[-1] if _kept else None
    words = ""
    if plan is None and _closed and time.monotonic() - _closed[0] < GRACE:
        time.sleep(GRACE)  # the loop saw the signal before this thread and prints its own last line
    if plan is not None:
        with suppress(Exception):
            if plan.heard is not None:
                plan.heard()
        time.sleep(plan.grace)  # the main thread leaves meanwhile, if it can
        _last()
        with suppress(Exception):  # what cannot be kept now must not keep the process
            words = plan.words()
    leave(words)


def _last() -> None:
    """Runs the last action of every open exit plan, innermost first."""
    for plan in reversed(_kept):
        with suppress(Exception):
            if plan.last is not None:
                plan.last()


def _at_once() -> NoReturn:
    _last()
    with suppress(Exception):
        writing.acquire(timeout=1.0)
        sys.stdout.flush()
    spared = None
    with suppress(Exception):
        spared = _tidied()
    for child in _children() - {spared}:
        with suppress(OSError):
            os.kill(child, signal.SIGKILL)
    os._exit(code())


def _tidied() -> int | None:
    """Releases the semaphores of multiprocessing and ends its tracker, which would otherwise release them with a warning."""
    if "multiprocessing.resource_tracker" not in sys.modules:
        return None
    import multiprocessing.resource_tracker
    import multiprocessing.util

    multiprocessing.util._run_finalizers(0)  # type: ignore[attr-defined]
    return multiprocessing.resource_tracker._resource_tracker._pid  # type: ignore[attr-defined]


def _children() -> set[int]:
    """Processes that this one started, including, where the system reports it, one that is just being started."""
    found = set()
    with suppress(OSError):
        for listed in Path("/proc/self/task").glob("*/children"):
            found |= {int(word) for word in listed.read_text().split()}
    if not found and "multiprocessing" in sys.modules:
        import multiprocessing

        found = {child.pid for child in multiprocessing.active_children() if child.pid}
    return found
