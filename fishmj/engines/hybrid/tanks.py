"""Reference water of a hybrid: tanks of the flow solver, one for each segment, side by side on one device.

Every segment has its own tank with MuJoCo's background flow at that time: the same eddies at the same places, with the tank's
mean stream if one is given. The fish has the masses, gains, latency and state of MuJoCo's fish.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from fishmj.engines import lbm
from fishmj.engines.hybrid.hybrid_segment import FreeSwim, HybridSegment
from fishmj.lbm_oracle.run.run import ConcurrentRuns, Run
from fishmj.lbm_oracle.run.solver_water import SolverWater
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import reference_qpos
from fishmj.water.flow import DrawnFlow, Flow, shifted


class Tanks:
    """Flow solver as an `Oracle`.

    Args:
        water: water of the solver. device: auto, cpu or cuda.
        stream: flow whose mean is that of the tanks; None: MuJoCo's. side_by_side: number of segments at a time.
        go_on: called before every tick; False ends the segments.
    """

    def __init__(
        self, robot: Robot, water: SolverWater, *, device: str = "auto", stream: Flow | None = None,
        side_by_side: int = 12, go_on: Callable[[], bool] = lambda: True,
    ):  # fmt: skip
        self.robot, self.stream, self.side_by_side, self.go_on = robot, stream, side_by_side, go_on
        box: dict[str, Any] = {"domain": water.domain, "slip": water.slip, "device": device}
        self.water = box | water.immersed

    def swim(self, segments: Sequence[HybridSegment]) -> list["FreeSwim | str"]:
        """Swims the segments in the flow solver; as `Oracle.swim`."""
        some = self.side_by_side
        return [one for k in range(0, len(segments), some) for one in self._together(segments[k : k + some])]

    def flow(self, segment: HybridSegment) -> Flow:
        """The background flow of a segment's tank."""
        drawn = segment.current
        if self.stream is not None:
            drawn = shifted(drawn, self.stream.mean[None, :2] - drawn.mean, np.array([segment.tick]))
        return DrawnFlow.of(drawn, segment.kind)

    def _together(self, segments: Sequence[HybridSegment]) -> list["FreeSwim | str"]:
        runs = [self._seeded(segment) for segment in segments]
        tanks = ConcurrentRuns(runs)
        for _ in range(len(segments[0].q) - 1):
            self._tick(tanks)
        for run, segment in zip(runs, segments, strict=True):
            run.tethered, run.root, run.prescribed = False, None, None
            run.commands, run.rows = list(segment.start.buffer[0]), []
            run.ticks = len(run.commands) - 1
        for commands in zip(*(segment.commands for segment in segments), strict=True):
            self._tick(tanks, commands)
        return [run.stopped or _swum(run) for run in runs]

    def _tick(self, tanks: ConcurrentRuns, commands=None) -> None:
        if not self.go_on():
            raise RuntimeError("given up")
        tanks.tick(commands)

    def _seeded(self, segment: HybridSegment) -> Run:
        """Tank with the fish at the start of its lead."""
        engine = lbm.LbmEngine(self.robot, [self.flow(segment)], **self.water)
        kept = None if engine.active is None else segment.start.memory[0, : len(engine.active.memory)]
        run = engine.tank(0, segment.q[0], segment.params, kept)
        lbm.set_clock(run, segment.tick * self.robot.timing.bus_dt)
        q, v = segment.q, segment.v
        run.coupled.body.place(reference_qpos(run.coupled.body.model, q[0, :3], q[0, 3:]), v[0])
        run.begin()
        path = CubicHermiteSpline(np.arange(len(q)) * self.robot.timing.bus_dt, q, v)
        run.root, run.prescribed = (lambda t: path(t)[:3]), (lambda t: path(t)[3:])
        return run


def _swum(run: Run) -> FreeSwim:
    pose, joint, rate = (np.array([row[i] for row in run.rows]) for i in (3, 4, 5))
    return FreeSwim(np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1))
