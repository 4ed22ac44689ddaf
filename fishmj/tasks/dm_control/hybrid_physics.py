"""dm_control `Physics` of a fish that MuJoCo moves in a fitted water, which the flow solver corrects while it swims."""

from typing import Any

import numpy as np

from fishmj.engines import FishParams, FishState
from fishmj.tasks.dm_control.physics import Physics
from fishmj.tasks.episode import TaskSpec
from fishmj.water.flow import BOXES, Current, Flow


class HybridPhysics(Physics):
    """A fish with corrected water; make one with `HybridPhysics.corrected`. Every episode begins with the water as fitted.

    Attributes:
        hybrid: the corrections (`fishmj.engines.hybrid.Hybrid.report`).
    """

    hybrid: Any
    alone = "the water hybrid"

    @classmethod
    def corrected(cls, rules: TaskSpec, options: Any = None) -> "HybridPhysics":
        """Straight fish; options: `fishmj.engines.hybrid.HybridOptions`."""
        from fishmj.engines.hybrid import Hybrid

        setting = rules.setting
        physics = cls.of(rules.robot)
        kind = Flow(turbulence=setting.turbulence, box=BOXES[setting.box])
        physics.hybrid = Hybrid(rules.robot, options, kind=kind)
        physics._given = physics.swim.params, physics.swim.current
        return physics

    def begin(self, pose, params: FishParams, current: Current) -> None:
        """Starts an episode as `Physics.begin`, without corrections."""
        super().begin(pose, params, current)
        self._given = params, current
        self.hybrid.reset()

    def _next_tick(self) -> None:
        s, data, water = self.swim, self.data, self.water
        batch = lambda values: np.array([values], float)
        fish = FishState(batch(data.qpos), batch(data.qvel), batch(water.attached), s.buffer, batch(water.memory))
        s.params, s.current = self.hybrid.tick(fish, *self._given, s.step // s.steps)
        water.set_fish(s.params)
        super()._next_tick()
