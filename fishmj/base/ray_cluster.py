"""Workers of a Ray cluster (extra `ray`): a worker is one process with its own device, and does one task at a time.

    cluster = RayCluster("local:2")            two workers here; "auto": the cluster that this machine belongs to
    for item, result in cluster.spread("package.module:function", deque(items)): ...

Workers need fishmj installed. A worker that dies loses only its task: it goes to another worker, `ATTEMPTS` times in all, and is
left out after that. Results come back to the caller.
"""

import os
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError, FishmjError

ATTEMPTS = 3
POLL = 0.5  # s between two looks at the clock while workers are busy
OPTION = "auto, the address of a Ray cluster, or local:N for N workers here (extra ray)"


class RayTask(NamedTuple):
    """Item of `RayCluster.spread`: name in messages, and what the function takes."""

    id: str
    given: Any


class RayWorker:
    """Worker process; `work` is module:function, called with a list of items and returning their results in this order."""

    def __init__(self, work: str):
        module, _, name = work.partition(":")
        self.function = getattr(import_module(module), name)

    def do(self, items: list, given: tuple) -> tuple[str, list]:
        """Returns ("", results) or (error text, [])."""
        try:
            return "", self.function(items, *given)
        except FishmjError as error:  # not every error survives the way back
            return f"{type(error).__name__}: {error}", []


@dataclass
class RayCluster:
    """Ray cluster, connected for one call of `spread`.

    address: of the cluster, `auto`, or `local:N`. workers: their number; by default as many as there is room for.
    deaths: of workers so far. retried: ids of items that were given out again.
    """

    address: str = "auto"
    workers: int | None = None
    deaths: int = 0
    retried: Counter = field(default_factory=Counter)

    def spread(
        self,
        work: str,
        waiting: deque,
        *given: Any,
        device: str = "auto",
        gpus: int = 1,
        group: int = 1,
        go_on: Callable[[float], bool] = lambda done: True,
    ) -> Iterator[tuple[Any, Any]]:
        """Yields (item, result) in the order in which workers finish.

        Args:
            work: module:function of a list of items and `given`; returns their results in order. All must be picklable.
            waiting: items with an `id`, taken from the left.
            device: `cpu`, or `cuda` for workers that need a GPU; `auto`: GPUs if the cluster has them.
            gpus: number of a worker on GPUs. group: items of one call. go_on: called often; False ends the work.

        Raises:
            MissingExtra: Ray is not installed. ConfigError: no such cluster, no such device there, or an error of `work`.
        """
        ray, ours = self._connect()
        try:
            number, share = self._share(ray, device, gpus)
            yield from self._spread(ray, work, waiting, given, number, share, group, go_on)
        finally:
            if ours:
                ray.shutdown()

    def _spread(self, ray, work, waiting, given, number, share, group, go_on) -> Iterator[tuple[Any, Any]]:
        hire = ray.remote(**share)(RayWorker).remote
        idle: list[Any] = [hire(work) for _ in range(min(number, len(waiting)))]
        busy: dict[Any, tuple[Any, list]] = {}
        try:
            while waiting or busy:
                while waiting and idle:
                    worker = idle.pop()
                    items = [waiting.popleft() for _ in range(min(group, len(waiting)))]
                    busy[worker.do.remote(items, given)] = worker, items
                ready, _ = ray.wait(list(busy), timeout=POLL)
                for task in ready:
                    worker, items = busy.pop(task)
                    try:
                        wrong, results = ray.get(task)
                    except (ray.exceptions.RayActorError, ray.exceptions.ObjectLostError) as error:
                        waiting.extend(self._mourn(items, error))
                        idle.append(hire(work))
                        continue
                    if wrong:
                        raise ConfigError(f"ray: {', '.join(item.id for item in items)}: {wrong}")
                    idle.append(worker)
                    yield from zip(items, results, strict=True)
                if not go_on(0.0):
                    return
        finally:
            for worker in [*idle, *(worker for worker, _ in busy.values())]:
                ray.kill(worker)

    def _mourn(self, items: list, error: Exception) -> list:
        """Items of a dead worker's task that get another attempt."""
        self.deaths += 1
        self.retried.update(item.id for item in items)
        again = [item for item in items if self.retried[item.id] < ATTEMPTS]
        given_up = [item.id for item in items if item not in again]
        why = f"{type(error).__name__}: {str(error).strip().splitlines()[-1]}"  # what its start raised, if that failed
        console.warn(f"ray: a worker died ({why}); run again: {', '.join(i.id for i in again) or 'nothing'}")
        if given_up:
            console.warn(f"ray: given up after {ATTEMPTS} workers died over them: {', '.join(given_up)}")
        return again

    def _connect(self) -> tuple[Any, bool]:
        """Returns Ray, connected, and True if this call started it."""
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        import ray
        import ray.exceptions

        if ray.is_initialized():
            return ray, False
        kind, _, number = self.address.partition(":")
        if kind == "local":
            if not number.isdigit() or int(number) < 1:
                raise ConfigError(f"ray: {self.address!r}; expected local:N with N workers, an address, or auto")
            ray.init(num_cpus=int(number), include_dashboard=False, log_to_driver=False, logging_level="error")
            return ray, True
        try:
            ray.init(address=self.address, log_to_driver=False, logging_level="error")
        except (ConnectionError, ValueError, RuntimeError) as error:
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
        return self.workers or (cards // gpus if on_gpu else cpus), share
