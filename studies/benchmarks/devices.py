"""Weak scaling of the flow solver over the GPUs of one host.

    fishmj bench oracle_devices_2 oracle_devices_4 oracle_devices_8     steps per second on 2, 4, 8 GPUs, on one, and their ratio

As in `--device cuda:all`, every GPU has a process of its own with enough tanks to keep it busy; one host serves all of them.
"""

import traceback
import weakref
from collections.abc import Sequence
from functools import partial
from typing import Any

from fishmj.base import processes
from fishmj.base.errors import ConfigError
from studies.benchmarks import BenchmarkWork, NotHere, add
from studies.benchmarks.oracle import TANKS, TANKS_CPU, TICKS, TICKS_CPU, TICKS_QUICK, _resting

PATIENCE = 5.0  # s that a process has to end


def scaled(devices: Sequence[str], quick: bool = False) -> BenchmarkWork:
    """Steps of fish at rest in tanks on all of these devices at the same time, summed over tanks.

    Raises RuntimeError: a process failed to make its tanks; with its traceback.
    """
    side = _DeviceProcesses(devices, quick)
    each = TANKS if devices[0].startswith("cuda") else TANKS_CPU
    return BenchmarkWork(side.run, side.amount, f"{' '.join(devices)}, tanks: {len(devices)} x {each}")


class _DeviceProcesses:
    """Processes, one for each device with its tanks, that wait for commands."""

    def __init__(self, devices: Sequence[str], quick: bool):
        with processes.sigint_blocked():
            side = [processes.spawn_worker(_tanks, device, (n, len(devices)), quick) for n, device in enumerate(devices)]
        self.pipes, begun = [pipe for pipe, _ in side], [process for _, process in side]
        weakref.finalize(self, _stop_processes, begun)
        self.amount = sum(self._replies())

    def run(self) -> None:
        """Does the ticks of one run in all tanks."""
        for pipe in self.pipes:
            pipe.send(True)
        self._replies()

    def _replies(self) -> list[float]:
        """Replies of all processes. Raises RuntimeError with the traceback of one that failed."""
        answers: list[Any] = [pipe.recv() for pipe in self.pipes]
        if wrong := [text for text in answers if isinstance(text, str)]:
            raise RuntimeError(wrong[0])
        return answers


def _stop_processes(begun: list) -> None:
    for process in begun:
        process.kill()
    for process in begun:
        process.join(PATIENCE)


def _tanks(pipe, device: str, share: tuple[int, int], quick: bool) -> None:
    """Main function of a device's process: sends the number of steps of a run, then does a run for each command."""
    from fishmj.lbm_oracle.fluid.device import device_of
    from fishmj.lbm_oracle.run.domain import preset

    processes.ends_with_its_parent()
    try:
        if device.startswith("cpu"):
            processes.bind(*share)
        here = device_of(device)
        name, ticks, tanks = ("paper", TICKS, TANKS) if here.is_cuda else ("laptop", TICKS_CPU, TANKS_CPU)
        work = _resting(preset(name), here, TICKS_QUICK if quick else ticks, tanks)
        pipe.send(work.amount)
        while pipe.recv():
            work.run()
            pipe.send(work.amount)
    except Exception:  # noqa: BLE001  the waiting process must be told
        pipe.send(f"on device {device}:\n{traceback.format_exc()}")


def gpus(count: int) -> tuple[str, ...]:
    """First `count` GPUs. Raises NotHere: there are fewer."""
    from fishmj.lbm_oracle.fluid.device import devices_of

    try:
        found = devices_of("cuda:all")
    except ConfigError:
        found = ()
    if len(found) < count:
        raise NotHere(f"needs {count} GPUs in one host; here: {len(found)}")
    return found[:count]


def on_gpus(count: int, quick: bool) -> BenchmarkWork:
    """Tanks on the first `count` GPUs, each in a process of its own."""
    return scaled(gpus(count), quick)


for _count, _said in ((2, "Twelve tanks on each of two GPUs of this host, beside twelve on one."), (4, "The same on four."),
                      (8, "The same on eight.")):  # fmt: skip
    add(f"oracle_devices_{_count}", "tank-steps/s", _said, partial(on_gpus, _count), partial(on_gpus, 1))
