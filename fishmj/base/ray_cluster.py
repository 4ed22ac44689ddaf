"""Workers of a Ray cluster (extra `ray`): a worker is one process with its own device, and does one group of tasks at a time.

    def work(tasks):                           a generator, in a worker: yields (id, result) as each ends; calls report(done)
    cluster = RayCluster("local:2")            two workers here; "auto": the cluster that this machine belongs to
    for task, result in cluster.spread(work, deque(tasks)): ...

Every machine needs the same fishmj installed. A worker that dies loses only its unfinished tasks: they go to other workers,
`ATTEMPTS` times in all, and are left out after that. Results come back to the caller as they are made.
"""

import os
import socket
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from math import ceil
from typing import Any, NamedTuple

from fishmj import __version__
from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.source import commit, package_sha256

ATTEMPTS = 3
STARTS = 10  # workers that may die before their first task
POLL = 0.5  # s between two looks at the clock while workers are busy
EVERY = 1.0  # s between two reports of a worker's progress
PATIENCE = 10.0  # s until an address that does not answer is given up
OPTION = "auto, the address of a Ray cluster, or local:N for N workers here (extra ray)"

_tell: list[Callable[[float], object]] = []  # in a worker: sends its progress to the caller


class RayTask(NamedTuple):
    """Task of `RayCluster.spread`: name in messages, and what the function takes."""

    id: str
    given: Any


Work = Callable[[list], Iterator[tuple[str, Any]]]  # a generator


def refuse_own_code(names: Iterable[str]) -> None:
    """Raises ConfigError for code of the user's own, which a worker on another machine has not loaded."""
    if found := ", ".join(names):
        raise ConfigError(f"--ray: a worker has no code of your own ({found}); leave --ray out")


def report(done: float) -> bool:
    """Reports a worker's progress on its present tasks; does nothing in any other process. Returns True: it may go on."""
    for tell in _tell:
        tell(done)
    return True


class ProgressBoard:
    """Actor that holds the progress of every group of tasks."""

    def __init__(self):
        self.done: dict[int, float] = {}

    def write(self, group: int, done: float) -> None:
        """Stores the progress of a group."""
        self.done[group] = done

    def read(self) -> dict[int, float]:
        """Returns the progress of all groups."""
        return self.done


class RayWorker:
    """Worker process; `work` yields (id, result) of a list of tasks."""

    def __init__(self, work: Work, board: Any):
        self.work, self.board = work, board

    def differs(self, code: str) -> str:
        """Description of this machine and its fishmj if its files are others than those of `code`; "" if they are the same."""
        here = f"{socket.gethostname()} has fishmj {__version__} of {commit()} under Python {sys.version.split()[0]}"
        return "" if code == package_sha256() else here

    def do(self, group: int, tasks: list) -> Iterator[Any]:
        """Yields (id, result), or one error that a user can mend."""
        sent = time.monotonic()

        def tell(done: float) -> None:
            nonlocal sent
            if time.monotonic() - sent > EVERY:
                sent = time.monotonic()
                self.board.write.remote(group, done)

        _tell[:] = [tell]
        try:
            yield from self.work(tasks)
        except FishmjError as error:
            yield error


@dataclass
class RayCluster:
    """Ray cluster, connected for one call of `spread`.

    address: of the cluster, `auto`, or `local:N`. workers: their number; by default as many as there is room for.
    deaths: of workers so far. starts: deaths before the first task. retried: ids of tasks that were given out again. given_up:
        ids of those that no worker ended.
    """

    address: str = "auto"
    workers: int | None = None
    deaths: int = 0
    starts: int = 0
    retried: Counter = field(default_factory=Counter)
    given_up: list[str] = field(default_factory=list)

    def spread(
        self,
        work: Work,
        waiting: deque,
        *,
        device: str = "auto",
        gpus: int = 1,
        group: int = 1,
        go_on: Callable[[float], bool] = lambda done: True,
    ) -> Iterator[tuple[Any, Any]]:
        """Yields (task, result) in the order in which workers make them.

        Args:
            work: generator of a list of tasks, which yields (id, result). It, tasks and results must be picklable.
            waiting: tasks with an `id`, taken from the left.
            device: `cpu`, or `cuda` for workers that need a GPU; `auto`: GPUs if the cluster has them.
            gpus: number of a worker on GPUs. group: tasks of one call at most; fewer if some workers would have none.
            go_on: called often with the sum of what busy workers reported; False ends the work.

        Raises:
            MissingExtra: Ray is not installed. ConfigError: no such cluster, no such device there, a worker that cannot start or
                has another fishmj. All errors of `work`.
        """
        ray, ours = self._connect()
        try:
            number, share = self._share(ray, device, gpus)
            group = min(group, ceil(len(waiting) / number)) or 1
            yield from self._spread(ray, work, waiting, number, share, group, go_on)
        finally:
            if ours:
                ray.shutdown()

    def check(self) -> None:
        """Raises ConfigError with the tasks that no worker ended."""
        if self.given_up:
            raise ConfigError(f"ray: no worker ended {', '.join(self.given_up)}; all others are kept; {interrupt.again()}")

    def _spread(self, ray, work, waiting, number, share, group, go_on) -> Iterator[tuple[Any, Any]]:
        here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
        board = ray.remote(num_cpus=0, scheduling_strategy=here)(ProgressBoard).remote()
        try:
            sent = ray.put(work)
        except Exception as error:  # noqa: BLE001  whatever it holds cannot be pickled
            raise ConfigError(f"ray: the work cannot be sent to a worker: {str(error).splitlines()[0]}") from error
        starting: dict[Any, Any] = {}  # its answer -> a worker that may wait for room in the cluster
        idle: list[Any] = []
        busy: dict[Any, tuple[Any, int, dict]] = {}  # stream of results -> worker, number of the group, its unfinished tasks

        def hire() -> None:
            worker = ray.remote(**share)(RayWorker).remote(sent, board)
            starting[worker.differs.remote(package_sha256())] = worker

        begun, done, gone = 0, {}, (ray.exceptions.RayActorError, ray.exceptions.ObjectLostError)
        try:
            for _ in range(min(number, len(waiting))):
                hire()
            while waiting or busy:
                while waiting and idle:
                    worker, tasks = idle.pop(), [waiting.popleft() for _ in range(min(group, len(waiting)))]
                    stream = worker.do.options(num_returns="streaming").remote(begun, tasks)
                    busy[stream] = worker, begun, {task.id: task for task in tasks}
                    begun += 1
                ready, _ = ray.wait([*starting, *busy], timeout=POLL)
                for ref in ready:
                    try:
                        if ref in starting:
                            self._check_code(ray.get(ref))
                            idle.append(starting.pop(ref))
                            continue
                        worker, _, left = busy[ref]
                        answer = ray.get(next(ref))
                    except StopIteration:
                        idle.append(busy.pop(ref)[0])
                    except gone as error:
                        worker, _, left = busy.pop(ref) if ref in busy else (starting.pop(ref), 0, {})
                        ray.kill(worker)  # it may be out of reach only
                        waiting.extend(self._mourn(left.values(), error))
                        hire()
                    else:
                        if isinstance(answer, FishmjError):
                            console.warn(f"ray: failed with {', '.join(left)}")
                            raise answer
                        yield left.pop(answer[0]), answer[1]
                with suppress(ray.exceptions.RayError):  # progress alone: the last known one serves
                    done = ray.get(board.read.remote())
                if not go_on(sum(done.get(number, 0.0) for _, number, _ in busy.values())):
                    return
        finally:
            for worker in [board, *idle, *starting.values(), *(worker for worker, _, _ in busy.values())]:
                ray.kill(worker)

    @staticmethod
    def _check_code(there: str) -> None:
        if there:
            raise ConfigError(f"ray: {there}, whose files are not those here; install the same fishmj on all machines")

    def _mourn(self, tasks: Iterable, error: Exception) -> list:
        """Unfinished tasks of a dead worker that get another attempt. Raises ConfigError if workers cannot start."""
        tasks = list(tasks)
        why = f"{type(error).__name__}: {str(error).strip().splitlines()[-1]}"  # what its start raised, if that failed
        self.deaths += 1
        self.starts += not tasks
        if "creation task" in str(error) or self.starts == STARTS:
            raise ConfigError(f"ray: a worker cannot start ({why}); install the same fishmj on all machines")
        self.retried.update(task.id for task in tasks)
        again = [task for task in tasks if self.retried[task.id] < ATTEMPTS]
        given_up = [task.id for task in tasks if task not in again]
        self.given_up += given_up
        more = f"; run again: {', '.join(task.id for task in again) or 'nothing'}" if tasks else ", which had not begun"
        console.warn(f"ray: a worker died ({why}){more}")
        if given_up:
            console.warn(f"ray: given up after {ATTEMPTS} workers died over them: {', '.join(given_up)}")
        return again

    def _connect(self) -> tuple[Any, bool]:
        """Returns Ray, connected, and True if this call started it."""
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        import ray
        import ray.exceptions
        import ray.util.scheduling_strategies

        if ray.is_initialized():
            return ray, False
        kind, _, number = self.address.partition(":")
        if kind == "local":
            if not number.isdigit() or int(number) < 1:
                raise ConfigError(f"ray: {self.address!r}; expected local:N with N workers, an address, or auto")
            ray.init("local", num_cpus=int(number), include_dashboard=False, log_to_driver=False, logging_level="error")
            return ray, True
        try:
            _answers(self.address)
            ray.init(address=self.address, log_to_driver=False, logging_level="error")
        except (OSError, ValueError, RuntimeError, ImportError) as error:
            raise ConfigError(f"ray: no cluster at {self.address!r}: {error}; start one with `ray start --head`") from error
        return ray, True

    def _share(self, ray, device: str, gpus: int) -> tuple[int, dict]:
        """Number of workers, and resources of a machine that each one takes."""
        there = ray.cluster_resources()
        cards, cpus = int(there.get("GPU", 0)), int(there.get("CPU", 1))
        if device.startswith("cuda") and not cards:
            raise ConfigError("ray: cuda was asked for and the cluster has no GPU; use --device cpu, or auto")
        on_gpu = bool(cards) and not device.startswith("cpu")
        share = {"num_gpus": gpus, "num_cpus": 1} if on_gpu else {"num_cpus": 1}
        return self.workers or max(1, cards // gpus if on_gpu else cpus), share


def _answers(address: str) -> None:
    """Raises OSError if nothing listens at host:port, for which Ray would wait minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host, int(port)), PATIENCE).close()
