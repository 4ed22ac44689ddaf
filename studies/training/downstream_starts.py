"""Starts at the target, headed downstream: what an egocentric fish finds hardest, and nothing else; `--at-target` mixes them in.

fishmj train --preset quick --task studies/training/downstream_starts.py:Downstream --water swift --flow-speeds 0.2
    --memory 8 --steps 5e6 --gamma 0.98 --reward wD=5 wS=0.00075 --seed 0
"""

from dataclasses import dataclass

from fishmj.tasks.reference import SHORT, WITHIN, EpisodeStart, StationHoldReference


@dataclass(frozen=True, kw_only=True)
class Downstream(StationHoldReference):
    """Episodes of 8 s that begin at the target; of these `share` within 45 deg of downstream, the rest at any heading."""

    seconds: float = SHORT
    share: float = 0.7

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7); the fourth, which would place the target, tells both kinds of starts apart."""
        begun = super().launch(xp, uniforms)
        start = begun.start
        yaw = start.direction + WITHIN * (2 * uniforms[:, 2] - 1)
        yaw = xp.where(uniforms[:, 3] < self.share, yaw, start.pose[:, 2])
        pose = xp.concatenate([start.pose[:, :2], yaw[:, None]], -1)
        return begun._replace(start=start._replace(pose=pose, target=start.pose[:, :2]))
