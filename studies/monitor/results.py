"""Small files of the monitor's result for a swim and of its reference for a robot: a study continues without the swims."""

from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.store import read_npz, write_npz
from fishmj.deploy.monitor.monitor import BLOCK
from fishmj.deploy.monitor.statistics import ChannelStatistics, Cusums, Reference
from studies.monitor.side_by_side import Blocks

FIELDS = tuple(field.name for field in fields(ChannelStatistics))


class Watched(NamedTuple):
    """One swim under the monitor.

    Attributes:
        rate: allowed false alarms an hour. blocks: number of watched blocks of `monitor.BLOCK` s.
        alarms: (s, channel, probe) of each; the tests restart after it. highest: highest CUSUM over its limit.
    """

    rate: float
    blocks: int
    alarms: list[tuple[float, str, str]]
    highest: float


def watched(reference: Reference, blocks: Blocks, rate: float) -> Watched:
    """Result of the monitor for the blocks of a swim."""
    cusums, found, highest = Cusums(reference, rate, BLOCK), [], 0.0
    for t, block in blocks:
        cusums.take(block)
        highest = max(highest, *cusums.share().values())
        if channel := cusums.parted():
            found.append((t, channel, cusums.highest(channel)[0]))
            cusums = Cusums(reference, rate, BLOCK)
    return Watched(rate, len(blocks), found, highest)


def reference_name(robot: int) -> str:
    """File of the reference of a robot."""
    return f"reference_{robot}.npz"


def write_reference(file: Path, reference: Reference) -> None:
    """Writes a reference: channel by channel, its names as text."""
    made: dict[str, np.ndarray] = {"blocks": np.array(reference.blocks), "channels": np.array(list(reference.channels))}
    for name, channel in reference.channels.items():
        made |= {f"{name}.{field}": np.array(getattr(channel, field)) for field in FIELDS}
    write_npz(file, made)


def read_reference(file: Path) -> Reference:
    """Reads a reference. Raises StoreError if it is missing or damaged."""
    kept = read_npz(file)
    made = {}
    for name in map(str, kept["channels"]):
        probes, *numbers = (kept[f"{name}.{field}"] for field in FIELDS)
        made[name] = ChannelStatistics(tuple(map(str, probes)), *numbers)
    return Reference(made, int(kept["blocks"]))
