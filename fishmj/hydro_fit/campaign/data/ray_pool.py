"""The same campaign on many machines: a Ray worker is one process with its own device, and takes one task at a time.

A task has as many segments as a worker has tanks, one by default. A worker that dies loses only these: they go to another worker,
`ATTEMPTS` times in all, and stay missing after that. Workers need fishmj installed. Results come back to the caller, and only the
caller writes files.

    collect(plan, out, setup, pool=RayPool("auto"))            the cluster that this machine belongs to
    collect(plan, out, setup, pool=RayPool("local:2"))         two workers here
"""

import os
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

from fishmj.base import console
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup
from fishmj.hydro_fit.campaign.data.segment import Segment

ATTEMPTS = 3
POLL = 0.5  # s between two looks at the clock while workers are busy
RUNNER = "fishmj.hydro_fit.campaign.data.run_segments:side_by_side"


class Worker:
    """Worker process; `runner` is module:function with the signature of `run_segments.side_by_side`."""

    def __init__(self, runner: str):
        module, _, name = runner.partition(":")
        self.runner = getattr(import_module(module), name)

    def work(self, tables: list[dict], setup: Setup) -> tuple[str, list]:
        """Runs segments given as plain numbers -> ("", [(meta, arrays), ..]) in their order, or (error text, [])."""
        try:
            done = list(self.runner(deque(map(Segment.of, tables)), setup, tanks=len(tables)))
        except FishmjError as error:  # not every error survives the way back
            return f"{type(error).__name__}: {error}", []
        made = {item.segment.id: (item.meta, item.arrays) for item in done}
        return "", [made[table["id"]] for table in tables]


@dataclass
class RayPool:
    """Workers of a Ray cluster.

    address: of the cluster, `auto`, or `local:N`. tanks: segments side by side in one worker. workers: their number; by default
        one
    for each GPU, or one for each CPU without a GPU. deaths: of workers so far; retried: ids of segments that were given out
    again.
    """

    address: str = "auto"
    tanks: int = 1
    workers: int | None = None
    runner: str = RUNNER
    deaths: int = 0
    retried: Counter = field(default_factory=Counter)

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Yields finished segments as `run_segments.side_by_side`, in the order in which workers finish.

        Raises:
            MissingExtra: Ray is not installed. ConfigError: no such cluster, no such device there, or a segment's own error.
        """
        ray, ours = self._connect()
        try:
            yield from self._run(ray, waiting, setup, go_on)
        finally:
            if ours:
                ray.shutdown()

    def _run(self, ray, waiting: deque[Segment], setup: Setup, go_on) -> Iterator[Finished]:
        number, share = self._share(ray, setup)
        if setup.device.startswith("cuda"):
            setup = replace(setup, device="cuda")  # a worker sees only its own
        hire = ray.remote(**share)(Worker).remote
        idle: list[Any] = [hire(self.runner) for _ in range(min(number, len(waiting)))]
        busy: dict[Any, tuple[Any, list[Segment]]] = {}
        try:
            while waiting or busy:
                while waiting and idle:
                    worker = idle.pop()
                    group = [waiting.popleft() for _ in range(min(self.tanks, len(waiting)))]
                    busy[worker.work.remote([segment.table() for segment in group], setup)] = worker, group
                ready, _ = ray.wait(list(busy), timeout=POLL)
                for task in ready:
                    worker, group = busy.pop(task)
                    try:
                        wrong, results = ray.get(task)
                    except (ray.exceptions.RayActorError, ray.exceptions.ObjectLostError) as error:
                        waiting.extend(self._mourn(group, error))
                        idle.append(hire(self.runner))
                        continue
                    if wrong:
                        raise ConfigError(f"ray: {', '.join(s.id for s in group)}: {wrong}")
                    idle.append(worker)
                    for segment, (meta, arrays) in zip(group, results, strict=True):
                        yield Finished(segment, meta, arrays)
                if not go_on(0.0):
                    return
        finally:
            for worker in [*idle, *(worker for worker, _ in busy.values())]:
                ray.kill(worker)

    def _mourn(self, group: list[Segment], error: Exception) -> list[Segment]:
        """Segments of a dead worker's task that get another attempt."""
        self.deaths += 1
        self.retried.update(segment.id for segment in group)
        again = [segment for segment in group if self.retried[segment.id] < ATTEMPTS]
        given_up = [segment.id for segment in group if segment not in again]
        console.warn(f"ray: a worker died ({type(error).__name__}); run again: {', '.join(s.id for s in again) or 'nothing'}")
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

    def _share(self, ray, setup: Setup) -> tuple[int, dict]:
        """Number of workers, and resources of a machine that each one takes."""
        there = ray.cluster_resources()
        gpus, cpus = int(there.get("GPU", 0)), int(there.get("CPU", 1))
        if setup.device.startswith("cuda") and not gpus:
            raise ConfigError("ray: cuda was asked for and the cluster has no GPU; use --device cpu, or auto")
        on_gpu = bool(gpus) and not setup.device.startswith("cpu")
        share = {"num_gpus": 1, "num_cpus": 1} if on_gpu else {"num_cpus": 1}
        return self.workers or (gpus if on_gpu else cpus), share
