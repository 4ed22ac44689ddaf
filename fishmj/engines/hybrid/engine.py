"""Hybrid engine: another engine moves the fish, and segments of the flow solver correct its water."""

from typing import Any

import numpy as np

from fishmj import engines
from fishmj.engines import FishParams, FishState, Trace, check_commands
from fishmj.engines.hybrid.hybrid import Hybrid, HybridOptions
from fishmj.engines.hybrid.hybrid_segment import Oracle, Replay
from fishmj.mjcf.description import Robot
from fishmj.water.flow import Current, Flow


class HybridEngine:
    """Moves a batch of fish, each corrected by its own segments.

    Args:
        kind: a flow with the turbulence and box of the background. inner: engine that moves the fish, or its name.
        oracle, replay: as in `Hybrid`.

    Attributes:
        name: its name in tables.
    """

    jittable = False

    def __init__(
        self, robot: Robot, kind: Flow | None = None, options: HybridOptions | None = None, *, inner: Any = "batch",
        oracle: Oracle | None = None, replay: Replay | None = None,
    ):  # fmt: skip
        self.robot = robot
        self.inner = engines.make(inner, robot) if isinstance(inner, str) else inner
        self.hybrid = Hybrid(robot, options, kind=kind, oracle=oracle, replay=replay)
        self.name = self.hybrid.options.label(robot)

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick) -> tuple[FishState, Trace]:
        """Advances the fish by the inner engine's `advance`, with corrected water; `tick` is the same for all of them."""
        commands, tick = np.asarray(commands, float), np.asarray(tick)
        check_commands(commands, self.robot.n_joints)
        traces = []
        for k in range(commands.shape[1]):
            water = self.hybrid.tick(state, params, current, int(tick[0]) + k)
            state, trace = self.inner.advance(state, commands[:, k : k + 1], *water, tick + k)
            traces.append(trace)
        return state, Trace(*(np.concatenate([np.asarray(a) for a in column], 1) for column in zip(*traces, strict=True)))
