"""The flow solver as an engine for learners in JAX: a fish that begins an episode gets a new tank.

The learners' environment (`tasks.env`) resets its episodes inside a compiled loop. `LbmEpisodes.advance` leaves that loop by an
ordered callback; the tanks stay on the host, outside the train state. A fish at bus tick 0 begins an episode: its tank is filled
with the pose, constants and flow that the environment has drawn, and the fish is held as in `lbm`, while the others wait.

A fish too close to a wall has left its tank (`left`). If its water fails, a fish gets a non-finite pose, and the environment
drops the episode. Checkpoints do not hold the water: a resumed run begins new episodes.
"""

import gc
from typing import Any

import jax
import numpy as np
from jax.experimental import io_callback

from fishmj.engines import Current, FishParams, FishState, Trace, drained
from fishmj.engines.lbm import LbmEngine
from fishmj.lbm_oracle.run.run import ConcurrentRuns
from fishmj.mjcf.description import Robot
from fishmj.water.flow import DrawnFlow, Flow, table_of

AWAY = 1.0  # value of `attached`, unused by the solver, that marks a fish too close to a wall


class LbmEpisodes(LbmEngine):
    """Tanks for episodes that end at different times. The callback does not support jax.vmap over seeds.

    Args:
        robot: as in `LbmEngine`. turbulence, box: kind and table of the flows that the environment draws.
        options: options of `LbmEngine`, such as domain, slip, device.

    Attributes:
        failed: first error of a tank; all fish then diverge, and the caller raises it between two iterations.
    """

    name, jittable = "lbm", True

    def __init__(self, robot: Robot, turbulence: str, box: int, **options: Any):
        super().__init__(robot, [], **options)
        self.kind = Flow(turbulence=turbulence, box=box)
        self.table, self.cell = table_of(turbulence, box)
        self.failed: Exception | None = None
        self.emptied = 0  # discarded tanks since the last garbage collection

    def left(self, fish: FishState) -> Any:
        """True (B,) for fish that have come too close to a wall of their tank."""
        return fish.attached == AWAY

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick) -> tuple[FishState, Trace]:
        """Advances the tanks by bus commands (B, T, J) [rad]; fish with `tick` (B,) 0 begin an episode."""
        (batch, ticks, joints), real = commands.shape, state.q.dtype
        shape = lambda *size: jax.ShapeDtypeStruct((batch, *size), real)
        trace = Trace(shape(ticks, 3), shape(ticks, joints), shape(ticks, joints), shape(ticks, 3), shape(ticks))
        like = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, real), state), trace
        return io_callback(self._on_host, like, state, commands, params, current[:5], tick, ordered=True)

    def _on_host(self, *given: Any) -> tuple[FishState, Trace]:
        """Advances the tanks; stores an error in `failed`, because JAX would lose it."""
        state, commands, params, current, tick = jax.tree.map(np.asarray, given)
        try:
            if self.failed is None:
                self._refill(np.flatnonzero(tick == 0).tolist(), state, params, current)
                made = drained(self.advancing(state, commands, params, None, tick))
                return jax.tree.map(lambda a: np.asarray(a, state.q.dtype), self._judged(*made))
        except Exception as error:  # noqa: BLE001  raised again by the caller
            self.failed = error
        rows = lambda *size: np.full((*commands.shape[:2], *size), np.nan, state.q.dtype)
        joints = commands.shape[2]
        gone = FishState(*(np.full_like(a, np.nan, dtype=state.q.dtype) for a in state))
        return gone, Trace(rows(3), rows(joints), rows(joints), rows(3), rows())

    def _refill(self, rows: list[int], state: FishState, params: FishParams, current: tuple) -> None:
        """Makes new tanks for fish that begin an episode, in their drawn flows."""
        if not rows:
            return
        if len(rows) == len(state.q):  # a new batch
            self.tanks, self.flows = None, [self.kind] * len(rows)
            gc.collect()  # captured launches and their tank form reference cycles
        for i in rows:
            mean, rms, row, offset, turn = (a[i : i + 1].astype(float if a.dtype.kind == "f" else int) for a in current)
            self.flows[i] = DrawnFlow.of(Current(mean, rms, row, offset, turn, self.table, self.cell), self.kind)
        runs = drained(self.filled(rows, state, params))
        if self.tanks is None:
            self.tanks = ConcurrentRuns(runs, pipelined=True)
            return
        for i, run in zip(rows, runs, strict=True):
            self.tanks.runs[i] = run
        self.emptied += len(rows)
        if self.emptied >= len(self.flows):
            gc.collect()
            self.emptied = 0

    def _judged(self, fish: FishState, trace: Trace) -> tuple[FishState, Trace]:
        """Marks fish at a wall by `AWAY`, and makes the state of fish whose water failed non-finite."""
        away = np.array([why.startswith("left_domain") for why in self.stopped])
        failed = np.array([bool(why) for why in self.stopped]) & ~away
        return fish._replace(q=np.where(failed[:, None], np.nan, fish.q), attached=AWAY * away), trace
