"""Station holding with a conventional reward: the baseline "RL" of the comparison (after Zhang et al. 2022).

    fishmj train --preset paper-sac --engine planar --task studies/training/conventional_reward.py:Conventional --seed 0

    r = progress (d_first - d_last) + alignment cos(bearing of the target - yaw)      over the bus ticks of one control step

It pays for approach and for facing the target, and not for holding a place: at the target both terms have no optimum. Zhang et
al. end an episode at arrival and act on the parameters of a generator; here episodes go on and actions are joint angles, as for
every other policy, so that only the reward differs.
"""

from dataclasses import dataclass

from fishmj.tasks.reference import StationHoldReference


@dataclass(frozen=True, kw_only=True)
class Conventional(StationHoldReference):
    """Station holding that pays for approach and for facing the target."""

    progress: float = 10.0  # 1/m
    alignment: float = 0.1

    def reward(self, xp, step):
        """(B,) of one control step: `step.trace.pose` (B, T, 3) m, m, rad and `step.target` (B, 2) m."""
        pose = step.trace.pose
        x, y = step.target[:, 0] - pose[:, -1, 0], step.target[:, 1] - pose[:, -1, 1]
        first = xp.hypot(step.target[:, 0] - pose[:, 0, 0], step.target[:, 1] - pose[:, 0, 1])
        yaw = pose[:, -1, 2]
        facing = (xp.cos(yaw) * x + xp.sin(yaw) * y) / xp.maximum(step.distance, 1e-3)
        return self.progress * (first - step.distance) + self.alignment * facing
