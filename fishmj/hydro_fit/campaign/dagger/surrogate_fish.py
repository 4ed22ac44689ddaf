"""One fish in the fitted water by bus ticks, in NumPy, for roll-outs of a policy."""

import numpy as np

from fishmj.engines.extensions import Extensions
from fishmj.engines.single import SingleFish
from fishmj.mjcf.description import Robot
from fishmj.mjcf.servos import arrived_of, on_the_bus
from fishmj.water import residual_hooks
from fishmj.water.dynamics import planar_chain, strip_forces


class Surrogate(SingleFish):
    """One fish in the strip water with or without a residual. water: coefficients. learnt: a residual."""

    def __init__(
        self, robot: Robot, ch: planar_chain.Chain, water: strip_forces.Coefficients, *, learnt=None, pose=(0.0, 0.0, 0.0)
    ):
        nets = () if learnt is None else (learnt,)
        added = Extensions(None, np.zeros(0), np.array(residual_hooks.at_rest() if nets else []), nets, robot)
        super().__init__(ch, planar_chain.nominal(robot)._replace(water=water), added)
        self.robot, self.steps = robot, round(robot.timing.bus_dt / ch.dt)
        self.delay = round(robot.timing.command_latency / ch.dt)
        self.q, self.v = np.array([*pose, *np.zeros(ch.n - 1)], float), np.zeros(ch.n + 2)
        self.commands, self.ticks = [np.zeros(ch.n - 1)], 0

    def tick(self, command, flow) -> None:
        """Advances 20 ms after sending `command`, (J,) rad; `flow` (N, 2) m/s at the links."""
        stream = [tuple(u) for u in np.asarray(flow).tolist()]
        self.commands.append(on_the_bus(self.robot.servo, np.asarray(command, float)))
        ramp = self.robot.timing.command_path == "move_time"
        for i in range(self.steps):
            target = arrived_of(self.commands, self.ticks * self.steps + i, self.delay, self.steps, ramp)
            s = self.advance(list(self.q), list(self.v), list(target), stream, (0.0, 0.0))
            self.q, self.v = np.array(s.q), np.array(s.v)
        self.ticks += 1
