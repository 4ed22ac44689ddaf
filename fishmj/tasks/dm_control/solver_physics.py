"""dm_control `Physics` of a fish in the flow solver, and of one in a fitted water that the solver corrects while it swims.

The solver moves its own copy of the fish, one bus tick at a time. MuJoCo's data here take over its pose and velocity, so that
observations, rendering and named accessors work as in every other water. Each episode fills a tank of its own and first holds
the fish for a second, until the stream round it has developed.
"""

from typing import Any

import numpy as np
from dm_control.rl import control

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.engines import FishParams, FishState
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import reference_qpos
from fishmj.tasks.dm_control.physics import Physics
from fishmj.tasks.episode import TaskSpec
from fishmj.water.flow import BOXES, Current, DrawnFlow, Flow


class SolverPhysics(Physics):
    """A fish in a tank of the flow solver; make one with `SolverPhysics.in_tank`."""

    engine: Any  # fishmj.engines.lbm.LbmEngine of the running episode
    fish: engines.FishState
    alone = "the flow solver"

    @classmethod
    def in_tank(cls, rules: TaskSpec, options: dict) -> "SolverPhysics":
        """Straight fish; `options` are those of `fishmj.engines.lbm.LbmEngine`: domain, slip, device, finer.

        Raises ConfigError: a robot with effects that cannot act in the solver.
        """
        physics = cls.of(rules.robot)
        physics._solver, physics._setting = options, rules.setting
        physics.begin(np.zeros(3), physics.swim.params, physics.swim.current)
        return physics

    def _water_of(self, robot: Robot, root: str) -> None:
        """Returns None: the solver computes the forces."""

    def _start_water(self, params: FishParams) -> None:
        """Does nothing: the tank of `begin` is the water."""

    def begin(self, pose, params: FishParams, current: Current) -> None:
        """Fills a tank with this flow, with this fish at rest at pose (3,) [m, rad]. Call inside `reset_context`."""
        from fishmj.engines.lbm import LbmEngine

        super().begin(pose, params, current)
        flow = DrawnFlow.of(current, Flow(turbulence=self._setting.turbulence, box=BOXES[self._setting.box]))
        self.engine = LbmEngine(self.swim.robot, [flow], **self._solver)
        self.fish = engines.at_rest(self.swim.robot, np.asarray(pose)[None])
        self.fish.q[:, 3:] = params.zero  # the encoders read zero

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps, whole bus ticks only.

        Raises ConfigError: part of a bus tick; PhysicsError: the fish left the tank, or its water is not finite.
        """
        s = self.swim
        ticks, part = divmod(n_sub_steps, s.steps)
        if part:
            raise ConfigError(f"suite: {n_sub_steps} physics steps in the flow solver; expected whole bus ticks of {s.steps}")
        last = s.pending[-1:] if len(s.pending) else s.buffer[0, -1:]
        commands = np.concatenate([s.pending, np.repeat(last, ticks, 0)])[:ticks]
        self.fish, trace = self.engine.advance(self.fish, commands[None], s.params, s.current, np.array([s.step // s.steps]))
        if stopped := self.engine.stopped[0]:
            raise control.PhysicsError(f"the flow solver stopped: {stopped}")
        s.pending, s.step = s.pending[ticks:], s.step + n_sub_steps
        s.buffer = np.concatenate([s.buffer, commands[None]], 1)[:, -s.buffer.shape[1] :]
        s.rows = (*s.rows, *zip(*(column[0] for column in trace), strict=True))[-s.keep :]
        pose, joint = trace.pose[0, -1], trace.joint[0, -1] + s.params.zero[0]
        s.yaw = float(pose[2])
        self.data.qpos[:] = reference_qpos(self.model.ptr, pose, joint)
        self.data.qvel[:] = [*trace.velocity[0, -1], *trace.rate[0, -1]]
        self.data.time += ticks * s.robot.timing.bus_dt
        self.forward()


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
