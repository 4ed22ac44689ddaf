"""How differently a right model moves in the first two seconds from rest: what a correction may not take for an error.

The wake is not there yet, which no strips know; so this is more than the same model misses by in a swim that goes on.
"""

from collections.abc import Sequence

import numpy as np

from fishmj.hydro_fit.fit.rollout import FishBatch, SwimWindow, fish_batch_of, is_free, recorded, windows
from fishmj.hydro_fit.fit.tolerance import WINDOW, of_movement
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot

START = 2.0  # s
SHARE = 0.9


def begins_at_rest(record: SegmentRecord) -> bool:
    """A free gait from rest in still water."""
    still = not np.any(record.meta["start"]["v"]) and float(np.abs(record.flow).max()) < 1e-6
    return record.meta["block"] == "gait" and is_free(record) and still and record.seconds >= START


def from_rest(swim: SwimWindow, robot: Robot, records: Sequence[SegmentRecord], water: np.ndarray) -> float:
    """What nine of ten such swims stay below, 1 at least: mean square difference over windows of `WINDOW` s, in tolerances.

    Of velocity ahead, to the left, and yaw rate.
    """
    chosen = [r for r in records if begins_at_rest(r)]
    if not chosen:
        return 1.0
    tick, size = chosen[0].tick, round(START / chosen[0].tick)
    whole = fish_batch_of(swim.chain, robot, chosen, seconds=1e6)
    fleet = FishBatch._make([*(a[:, : size + 1] for a in whole[:2]), *(a[:, :size] for a in whole[2:-1]), whole.source])
    got, seen = (windows(track, fleet, tick, WINDOW) for track in (swim.run(fleet, water, None), recorded(fleet)))
    speed, turn = of_movement(seen.surge, seen.sway, seen.yaw_rate)
    wide = {"surge": speed, "sway": speed, "yaw_rate": turn}
    errors = [(getattr(got, name) - getattr(seen, name)) / size for name, size in wide.items()]
    return max(1.0, float(np.quantile(np.mean(np.square(errors), axis=(0, 2)), SHARE)))
