"""Independent waters side by side on a device, and over several devices, a process each: segments, swims, points of a map.

    def swim_all(waiting, device, go_on):        a generator: takes keys from the left, yields what it has finished
        while waiting: yield swim(waiting.popleft(), device)

    for found in spread(swim_all, keys, devices_of("cuda:all")): book.add(found)

On one device the work runs in this process. On several, each process asks for a key whenever it has room, so that a slow one
takes fewer; none takes more than its part of the rest. No result depends on the process that made it: seeds belong to keys. Only
the caller writes, as each result arrives, so that an interrupted command loses only the work under way.

Processes are used because a step is a queue of small launches: in one process a second device would wait for the host's Python.
"""

import gc
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import ceil
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Protocol

from fishmj.base import errors, plugins, processes
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.ray_cluster import RayCluster, RayTask, report
from fishmj.lbm_oracle.fluid.device import device_of, several

EVERY = 0.2  # s from one report of progress of a process to its next
LOOK = 0.5  # s between two questions whether to go on
PATIENCE = 5.0  # s that a process has to end before it is killed


class Waiting(Protocol):
    """Work to be done: a deque, or this process's part of it; false if there is none now."""

    def popleft(self) -> Any:
        """Removes and returns the next key."""
        ...


GoOn = Callable[[float], bool]
Work = Callable[[Waiting, str, GoOn], Iterator[Any]]  # asks `waiting` only where it has room for one more


def never_stop(done: float) -> bool:
    """Returns True: a `go_on` that never ends the work."""
    return True


class TankWork(Protocol):
    """One run of water that gives way to others while its device works. water: its seconds so far."""

    @property
    def water(self) -> float: ...

    def ticking(self) -> Iterator[None]:
        """Does all ticks; yields when other tanks can have their turn."""
        ...

    def finished(self) -> Any:
        """Returns the result, after `ticking` has ended."""
        ...


def side_by_side(
    waiting: Waiting, start: Callable[[Any], TankWork], *, tanks: int = 1, go_on: GoOn = never_stop
) -> Iterator[Any]:
    """Runs the waiting keys in one process, `tanks` at a time, each at its own pace; a free tank takes the next key.

    Args:
        waiting: emptied from the left, only when there is room for one more.
        start: makes the run of a key.
        go_on: called after every round with the simulated seconds of the unfinished runs; False drops these and ends.

    Raises ConfigError: fewer than one tank.
    """
    if tanks < 1:
        raise ConfigError(f"{tanks} tanks side by side; expected at least 1")
    busy: list[tuple[TankWork, Iterator[None]]] = []
    emptied = 0
    while busy or waiting:
        while len(busy) < tanks and waiting:
            tank = start(waiting.popleft())
            busy.append((tank, tank.ticking()))
        for tank, ticks in list(busy):
            if next(ticks, tank) is tank:
                busy.remove((tank, ticks))
                yield tank.finished()
                emptied += 1
            del tank, ticks
        if emptied >= tanks:  # captured launches and their tank hold each other: without this a GPU fills up with old water
            gc.collect()
            emptied = 0
        if not go_on(sum(tank.water for tank, _ in busy)):
            return


def spread(work: Work, keys: Iterable[Any], devices: Sequence[str], go_on: GoOn = never_stop) -> Iterator[Any]:
    """Yields the results of `work` as they arrive.

    Args:
        work: called once for each device. On several devices, `work`, keys and results must be picklable, as a function of a
            module (or a `partial` of one) is. Results are not in the order of the keys.
        go_on: called often with the progress that `work` reports of unfinished keys, summed over devices; False ends the work.

    Raises ConfigError: something cannot be sent to a process, or a process died. All errors of `work`.
    """
    todo = keys if isinstance(keys, deque) else deque(keys)
    if len(devices) == 1 or len(todo) == 1:
        yield from work(todo, devices[0], go_on)
        return
    side: list[_Process] = []
    try:
        with processes.sigint_blocked():
            some = devices[: len(todo)]
            side += (_start_process(device, (number, len(some))) for number, device in enumerate(some))
        for one in side:  # after all have begun: they import at the same time
            one.send(work)
        yield from _serve_processes(side, todo, go_on)
    finally:
        for one in side:
            one.end()


def ray_device(asked: str) -> str:
    """Device of every worker of a Ray cluster, which sees only its own.

    Raises ConfigError: several devices; a worker has one, and there is one worker for every GPU.
    """
    if several(asked):
        raise ConfigError(f"--device {asked} with --ray: a worker has one device, and each GPU gets a worker; use --device cuda")
    return "cuda" if asked.startswith("cuda") else asked


def spread_over_ray(
    address: str, work: Work, keys: Mapping[str, Any], device: str, *, tanks: int, go_on: GoOn = never_stop
) -> Iterator[Any]:
    """Yields the results of `work` as `spread`, from the workers of a Ray cluster, `tanks` keys at a time in each.

    Args:
        work: its results are tuples that begin with their key.
        keys: hashable keys by their names in messages. device: of every worker, as `ray_device` returns it.

    Raises ConfigError: keys that no worker ended, when all others are yielded. Errors as `RayCluster.spread`.
    """
    cluster, waiting = RayCluster(address), deque(RayTask(name, key) for name, key in keys.items())
    for _, found in cluster.spread(
        partial(_in_worker, work=work, device=device), waiting, device=device, group=tanks, go_on=go_on
    ):
        yield found
    cluster.check()


def _in_worker(tasks: list[RayTask], work: Work, device: str) -> Iterator[tuple[str, Any]]:
    """Yields names and results of keys in a worker."""
    names = {task.given: task.id for task in tasks}
    for found in work(deque(names), device, report):
        yield names[found[0]], found


class _Process:
    """One worker process: its number of keys in hand, and its reported progress on them."""

    def __init__(self, pipe: Connection, process, device: str):
        self.pipe, self.process, self.device = pipe, process, device
        self.held, self.done, self.ended = 0, 0.0, False

    def send(self, work: Work) -> None:
        """Sends the work to the process. Raises ConfigError if it cannot be sent."""
        try:
            self.pipe.send(work)
        except OSError as error:
            raise self.died() from error
        except Exception as error:
            raise ConfigError(f"device {self.device}: the work cannot be sent to a process: {error}; use one device") from error

    def died(self) -> ConfigError:
        """Error for a process that died."""
        self.process.join(PATIENCE)
        how = f"its process ended with exit code {self.process.exitcode}"
        return ConfigError(f"device {self.device}: {how}; the same command goes on, with fewer --tanks if memory ran out")

    def end(self) -> None:
        """Waits for the process if it has finished, else ends it: it holds nothing that was not sent."""
        if self.ended:
            self.process.join(PATIENCE)
        self.process.kill()
        self.process.join()
        self.pipe.close()


class _Message(NamedTuple):
    """Message of a process: want, made, done, failed, broken or end, with its value."""

    what: str
    value: Any = None


def _start_process(device: str, share: tuple[int, int]) -> _Process:
    own = {kind: list(plugins.loaded(kind)) for kind in plugins.KINDS}
    return _Process(*processes.spawn_worker(_work, device, share, own, name=device), device)


def _serve_processes(side: list[_Process], todo: deque, go_on: GoOn) -> Iterator[Any]:
    """Answers the processes until all have ended."""
    while busy := [one for one in side if not one.ended]:
        ready = wait([one.pipe for one in busy], timeout=LOOK)
        for one in (one for one in busy if one.pipe in ready):
            try:
                answer = one.pipe.recv()
                if answer.what == "want":
                    _send_key(one, side, todo)
            except (EOFError, OSError) as error:
                raise one.died() from error
            if answer.what == "made":
                one.held, one.done = one.held - 1, 0.0
                yield answer.value
            elif answer.what == "done":
                one.done = answer.value
            elif answer.what == "end":
                one.ended = True
            elif answer.what != "want":
                raise _error_of(one.device, answer)
        if not go_on(sum(one.done for one in side)):
            return


def _send_key(one: _Process, side: list[_Process], todo: deque) -> None:
    """Sends a key, or no key if this process has its part of the rest: (True, key), or (False, ask again or not)."""
    part = ceil((len(todo) + sum(other.held for other in side)) / len(side))
    if todo and one.held < part:
        one.held += 1
        one.pipe.send((True, todo.popleft()))
    else:
        one.pipe.send((False, bool(todo)))


def _error_of(device: str, said: _Message) -> Exception:
    """Error of a process, of its original type if that is one of fishmj's."""
    if said.what == "broken":
        return RuntimeError(f"on device {device}:\n{said.value}")
    kind, message = said.value
    made = getattr(errors, kind, FishmjError)
    try:
        return made(message)
    except TypeError:  # made of more than a message
        return FishmjError(message)


# in the process -------------------------------------------------------------------------------------------------------


class _KeyRequests:
    """`Waiting` in a process: asks for the next key; asks again after one was finished, or if none is in hand."""

    def __init__(self, pipe: Connection):
        self.pipe, self.found, self.more, self.full = pipe, deque[Any](), True, False

    def __bool__(self) -> bool:
        if not self.found and self.more and not self.full:
            self.pipe.send(_Message("want"))
            given, value = self.pipe.recv()
            if given:
                self.found.append(value)
            else:
                self.more, self.full = value, True
        return bool(self.found)

    def popleft(self) -> Any:
        if not self:
            raise IndexError("nothing is waiting")
        return self.found.popleft()


def _work(pipe: Connection, device: str, share: tuple[int, int], own: dict[str, list[str]]) -> None:
    """Main function of the process of one device.

    own: the user's code that the parent loaded, by kind, which the work may need.
    """
    processes.ends_with_its_parent()
    if device.startswith("cpu"):
        processes.bind(*share)
    try:
        for kind, texts in own.items():
            for text in texts:
                plugins.load(kind, text)
        work = pipe.recv()
        if "warp" in sys.modules:  # all that computes has imported it by now
            device_of(device)  # before anything else begins Warp, which would greet the user
        asked = _KeyRequests(pipe)
        for found in work(asked, device, _ProgressReports(pipe)):
            asked.full = False
            pipe.send(_Message("made", found))
        pipe.send(_Message("end"))
    except FishmjError as error:
        pipe.send(_Message("failed", (type(error).__name__, str(error))))
    except Exception:  # noqa: BLE001  whatever it is, the one that waits must hear of it
        pipe.send(_Message("broken", traceback.format_exc()))


class _ProgressReports:
    """`go_on` in a process: reports from time to time; the parent ends the process."""

    def __init__(self, pipe: Connection, clock: Callable[[], float] = time.monotonic):
        self.pipe, self.clock, self.last = pipe, clock, clock()

    def __call__(self, done: float) -> bool:
        if self.clock() - self.last > EVERY:
            self.last = self.clock()
            self.pipe.send(_Message("done", done))
        return True
