"""Starts at the target, headed downstream: what an egocentric fish finds hardest, in more episodes than a draw at random has.

fishmj train --preset quick --task studies/training/downstream_starts.py:Downstream --water swift --flow-speeds 0.2
    --memory 8 --steps 5e6 --gamma 0.98 --reward wD=5 wS=0.00075 --seed 0
"""

from dataclasses import dataclass
from math import pi

from fishmj.tasks.reference import EpisodeStart, StationHoldReference
from fishmj.tasks.station_hold import begun_at_target, draw_start

WITHIN = pi / 4  # rad, from downstream
SHORT = 8.0  # s


@dataclass(frozen=True, kw_only=True)
class Downstream(StationHoldReference):
    """Episodes of 8 s that begin at the target; of these `share` within 45 deg of downstream, the rest at any heading."""

    seconds: float = SHORT
    at_target: float = 1.0  # share of all episodes
    share: float = 0.7

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7); the fourth tells the kinds of starts apart, as in `begun_at_target`."""
        start = begun_at_target(xp, draw_start(xp, uniforms), uniforms, self.at_target)
        yaw = start.direction + WITHIN * (2 * uniforms[:, 2] - 1)
        yaw = xp.where(uniforms[:, 3] < self.share * self.at_target, yaw, start.pose[:, 2])
        pose = xp.concatenate([start.pose[:, :2], yaw[:, None]], -1)
        return EpisodeStart(start._replace(pose=pose), 0.0 * yaw)


@dataclass(frozen=True, kw_only=True)
class ShortDownstream(Downstream):
    """Half of the episodes begin at the target, half of these within 45 deg of downstream, and last 8 s; the others last 30 s."""

    seconds: float = 30.0
    at_target: float = 0.5
    share: float = 0.5

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7), with their lengths."""
        return super().launch(xp, uniforms)._replace(seconds=xp.where(uniforms[:, 3] < self.at_target, SHORT, self.seconds))


@dataclass(frozen=True, kw_only=True)
class SomeDownstream(Downstream):
    """Episodes of station holding; three in ten begin at the target, half of these within 45 deg of downstream."""

    seconds: float = 30.0
    at_target: float = 0.3
    share: float = 0.5
