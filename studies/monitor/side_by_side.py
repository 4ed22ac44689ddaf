"""Blocks of many swims at once: the monitor's own observer on arrays, one fish a column. Equal to it fish by fish (tests)."""

from collections.abc import Sequence
from math import cos, sin
from typing import Any

import numpy as np

from fishmj.deploy.monitor.monitor import BLOCK, RUN_IN, Tables
from fishmj.deploy.monitor.prediction import SwimPredictor, TickMeasurement, channels
from fishmj.deploy.monitor.tick_interpolation import Ticks
from fishmj.gap.models.kernel import Kernel
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain

Blocks = list[tuple[float, dict]]  # (s, block) of one swim


class Compiled(SwimPredictor):
    """The observer with its physics compiled: the same step, traced (`gap.models.kernel`), ten times as fast as NumPy's."""

    def __init__(self, robot: Robot, flow: tuple[np.ndarray, np.ndarray]):
        import jax.numpy as jnp

        super().__init__(robot, np, flow)
        bodies = 3 + self.joints

        def step(state: list, target: list, stream: list) -> list:
            q, v = state[:bodies], state[bodies : 2 * bodies]
            flows = [tuple(stream)] * self.chain.n
            made = planar_chain.step(jnp, self.chain, self.swimmer, q, v, state[2 * bodies], target, flows, (0.0, 0.0))
            return [*made.q, *made.v, made.attached, state[2 * bodies + 1] + made.power, *made.accel]

        count = 3 * bodies + 2
        self.kernel = Kernel(step, lambda state, stream: state, states=count, inputs=self.joints, parameters=2, watched=count)

    def _moved(self, targets: Any) -> tuple[Any, Any]:
        bodies, steps = 3 + self.joints, len(targets)
        swims = len(self.q[0])
        begin = np.stack([*self.q, *self.v, self.attached, np.zeros(swims), *np.zeros((bodies, swims))], 1)
        commands = np.moveaxis(np.asarray(targets, float), -1, 0)  # (B, S, J)
        each = np.arange(swims)
        stream = np.stack(np.broadcast_arrays(*self.flow[0]), -1)
        found = self.kernel(each, commands, np.full(swims, steps), stream, begin, np.zeros(swims), steps, 2)[:, 1].T
        self.q, self.v, self.attached = list(found[:bodies]), list(found[bodies : 2 * bodies]), found[2 * bodies]
        return found[2 * bodies + 1] / steps, list(found[2 * bodies + 2 :])


def blocks_of(robot: Robot, swims: Sequence[Tables], flows: Sequence[tuple[float, float]]) -> list[Blocks]:
    """Blocks of every swim, in float32, because hours of them are in memory. Tables have no pauses; flows: (m/s, rad)."""
    seen = []
    for tables in swims:
        ticks = Ticks(robot)
        ticks.add(tables)
        seen.append([(t, s) for t, s, _ in ticks.taken()])
    count, joints = min(map(len, seen)), robot.n_joints
    stream = np.array([(speed * cos(angle), speed * sin(angle)) for speed, angle in flows]).T
    observer = Compiled(robot, (stream[0], stream[1]))
    probes = channels(joints)
    length, run_in = round(BLOCK / robot.timing.bus_dt), round(RUN_IN / robot.timing.bus_dt)
    out: list[Blocks] = [[] for _ in swims]
    kept: list = []
    for k in range(count):
        rows = [s[k][1] for s in seen]
        now = TickMeasurement(
            target=np.moveaxis(np.array([r.target for r in rows]), 0, -1),
            joint=np.array([r.joint for r in rows]).T,
            pose=np.array([r.pose for r in rows]).T,
            power=np.array([r.power for r in rows]),
        )
        if k == 0:
            observer.begin(now)
            continue
        innovation = observer.step(now)
        if k <= run_in:
            continue
        kept.append(innovation)
        if len(kept) < length:
            continue
        for name in probes:
            e = np.array([i.error[name] for i in kept], np.float32)
            phi = np.array([i.probes[name] for i in kept], np.float32)  # (n, P, B)
            for b in range(len(swims)):
                if name == next(iter(probes)):
                    out[b].append((seen[b][k][0], {}))
                out[b][-1][1][name] = (e[:, b], phi[:, :, b])
        kept = []
    return out
