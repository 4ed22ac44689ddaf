"""The process that `live.MonitorProcess` starts: `python -m fishmj.deploy.monitor.process`.

It reads lines of JSON, for each swim: the settings, then rows of the tables as they come, then {"over": true}. It writes lines
of JSON: the watched channels, every alarm, and at the end of a swim the watched time. It keeps the reference from healthy swims
for the next one.
"""

import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.errors import FishmjError
from fishmj.deploy.monitor.live import OVER
from fishmj.deploy.monitor.monitor import Monitor, has, reference_of
from fishmj.deploy.monitor.statistics import Reference
from fishmj.log import Trial, read_trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

LOOK = 3.0  # s of rows after which it is clear what this robot measures
BELOW = 10  # niceness: the loop comes first
Rows = Mapping[str, Mapping[str, list[float]]]


def watch(wanted: Mapping[str, Any], lines: Iterable[Rows], tell: Callable[[dict], object]) -> None:
    """Watches rows until they end.

    Args:
        wanted: model, flow (m/s, rad), rate, settle s, healthy: folders. lines: rows; poses are stamped at exposure.
        tell: receives the messages for `LiveMonitor`.

    Raises FishmjError: the model or a healthy log cannot be read, or is too short.
    """
    robot = load_robot(wanted["model"])
    healthy = _healthy(tuple(wanted["healthy"]))
    stamped = [float(trial.value("latency.pose") or robot.timing.camera_latency) for trial in healthy]
    late = float(np.mean(stamped)) if stamped else robot.timing.camera_latency
    monitor: Monitor | None = None
    waiting: list[Rows] = []
    seconds, settled = 0.0, False
    for rows in lines:
        waiting.append(_stamped(rows, late))
        if monitor is None:
            if not _long_enough(waiting):
                continue
            monitor = _monitor(wanted, robot, healthy, waiting, late)
        for part in waiting:
            alarms = monitor.update(part)
            if monitor.settled and not settled:
                settled = True
                tell({"watching": list(monitor.blocks.probes), "t": max(table["t"][-1] for table in part.values())})
            for alarm in alarms:
                tell({"alarm": alarm._asdict()})
        waiting = []
        if monitor.history.t:
            seconds = monitor.history.t[-1] - monitor.history.t[0]
    history = monitor.history.share if monitor is not None else []
    highest = {name: round(max(share[name] for share in history), 3) for name in history[0]} if history else {}
    tell({"end": {"watched_s": round(seconds, 1), "highest": highest}})


@cache
def _healthy(folders: tuple[str, ...]) -> tuple[Trial, ...]:
    """The healthy swims."""
    return tuple(read_trial(Path(folder)) for folder in folders)


@cache
def _learnt(model: str, folders: tuple[str, ...], pose: bool, power: bool) -> Reference:
    """Reference from the healthy swims, computed once for all swims of this process because it takes 1.2 ms a tick."""
    return reference_of(load_robot(model), _healthy(folders), pose, power)


def _monitor(wanted: Mapping[str, Any], robot: Robot, healthy: Sequence[Trial], waiting: list[Rows], late: float) -> Monitor:
    """A monitor for the tables that both this robot and the healthy swims have."""
    there = {name: any(name in rows for rows in waiting) and has(healthy, name) for name in ("pose", "power")}
    reference = _learnt(wanted["model"], tuple(wanted["healthy"]), **there) if healthy else None
    flow = (float(wanted["flow"][0]), float(wanted["flow"][1]))
    return Monitor(robot, flow, wanted["rate"], wanted["settle"], reference, camera=late, **there)


def _stamped(rows: Rows, late: float) -> Rows:
    """The rows, with poses stamped as in a log: `late` s after exposure."""
    if "pose" not in rows:
        return rows
    return {**rows, "pose": {**rows["pose"], "t": [t + late for t in rows["pose"]["t"]]}}


def _long_enough(waiting: list[Rows]) -> bool:
    """Returns True once commands have come for long enough to know the available tables."""
    t = [t for rows in waiting for t in rows.get("cmd", {}).get("t", [])]
    return bool(t) and t[-1] - t[0] >= LOOK


def main(argv: list[str]) -> int:
    """Watches standard input. Exit code 0: its end; 2: nothing can be watched, and the last line gives the reason."""
    console.parser("deploy.monitor_process", "The monitor beside a swim: rows and alarms as lines of JSON.").parse_args(argv)
    with suppress(OSError):
        os.nice(BELOW)
    lines = map(json.loads, sys.stdin)
    try:
        for wanted in lines:
            watch(wanted, takewhile(lambda rows: OVER not in rows, lines), tell)
    except FishmjError as error:
        tell({"failed": str(error)})
        return console.BAD_INPUT
    return console.OK


def tell(told: dict) -> None:
    """Writes a line at once; does nothing if the reader is gone."""
    with suppress(BrokenPipeError):
        console.emit_json(told)


if __name__ == "__main__":
    sys.exit(console.run(main))
