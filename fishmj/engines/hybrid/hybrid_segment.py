"""Segments: the swim of a fish in MuJoCo, the same swim in a reference water, and the difference of the two.

    |---- lead ----|---- span ----|        bus ticks
     the fish in the reference water is moved along MuJoCo's path, then swims freely with the same commands

The reference water starts undisturbed, and its wake develops during the lead. Only the span is compared: both swims start from
the same state, with the same commands and eddies. Forward and lateral velocity and yaw rate are averaged over windows of `WINDOW`
s.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import jax
import numpy as np

from fishmj.engines import FishParams, FishState, planar
from fishmj.engines.hybrid import online_correction
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.tolerance import WINDOW, body_rates, of_movement
from fishmj.water.flow import Current, Flow, shifted

WIDE = 12  # batch size of replays; one size is compiled once


class HybridSegment(NamedTuple):
    """Segment of one fish; fields of a batch have one row."""

    fish: int  # its index
    tick: int  # bus ticks from t = 0 to the start of the lead
    q: np.ndarray  # (L + 1, 3 + J) states at the start and after each tick of the lead, m, rad
    v: np.ndarray  # (L + 1, 3 + J) m/s, rad/s
    start: FishState  # where the lead ends; its buffer holds the commands until then
    commands: np.ndarray  # (n, J) rad, bus commands of the span, one for each tick
    params: FishParams  # the fish, in the water before the correction
    current: Current  # background flow in MuJoCo
    kind: Flow  # turbulence and box of that flow

    @property
    def span(self) -> int:
        """Tick at which the span begins."""
        return self.tick + len(self.q) - 1


class FreeSwim(NamedTuple):
    """States after each of n ticks of free swimming, (n, 3 + J); of B replays (B, n, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class Oracle(Protocol):
    """Reference water of a hybrid."""

    def swim(self, segments: Sequence[HybridSegment]) -> list["FreeSwim | str"]:
        """Swims the span of each segment in this water; returns the swims, or the reason for an early end.

        Raises FishmjError, ArithmeticError, RuntimeError: the water as a whole failed.
        """


class Replay:
    """Repeats the span of a segment in the simulation's water with given factors and stream, by the closed form in JAX.

    chain: chain to use in place of the robot's.
    """

    def __init__(self, robot: Robot, chain: planar_chain.Chain | None = None):
        self.engine, self.tick = planar.PlanarEngine(robot), robot.timing.bus_dt
        self.engine.chain = chain or self.engine.chain
        self._device = jax.local_devices(backend="cpu")[0]  # faster for a dozen fish than a GPU, which computes the tanks

    def means(self, segment: HybridSegment, factors: np.ndarray, stream: np.ndarray) -> np.ndarray:
        """Forward and lateral velocity and yaw rate in each window, (K, 3, B), for factors (10, B) and streams (2, B)."""
        parts = []
        for k in range(0, factors.shape[1], WIDE):
            swum = self.swim(segment, factors[:, k : k + WIDE], stream[:, k : k + WIDE])
            parts.append(windows(np.moveaxis(body_rates(swum.q, swum.v), 0, -1), self.tick))
        return np.concatenate(parts, -1)

    def swim(self, segment: HybridSegment, factors: np.ndarray, stream: np.ndarray) -> FreeSwim:
        """States after each tick, (B, n, 3 + J); for factors (10, B) and streams (2, B), B at most `WIDE`."""
        count = factors.shape[1]
        rows, wide = np.minimum(np.arange(WIDE), count - 1), lambda a: np.repeat(np.asarray(a), WIDE, 0)
        every = lambda tree: type(tree)(*map(wide, tree))
        c, tick = segment.current, np.full(WIDE, segment.span)
        current = shifted(Current._make([*map(wide, c[:5]), *c[5:]]), stream[:, rows].T, tick)
        params = every(segment.params)
        params = params._replace(water=online_correction.applied_to_rows(params.water, factors[:, rows]))
        arguments = (every(segment.start), wide(segment.commands[None]), params, current, tick)
        with jax.enable_x64(True), jax.default_device(self._device):  # as the engine `batch`
            _, trace = self.engine.advance(*arguments)
        pose, joint, rate, velocity = (np.asarray(a, float)[:count] for a in trace[:4])
        return FreeSwim(np.concatenate([pose, joint + segment.params.zero[0]], -1), np.concatenate([velocity, rate], -1))


class Misses:
    """Residuals (K, 3, B): simulated minus observed motion, divided by the irreducible error.

    own: 90th percentile of the mean square, in tolerances, of the worst channel, over segments of a correct water.
    """

    def __init__(self, replay: Replay, segment: HybridSegment, seen: FreeSwim, own: float):
        self.replay, self.segment = replay, segment
        self.seen = windows(body_rates(seen.q, seen.v), replay.tick)[..., None]
        # tolerances use the speed through the water: a fish that holds station swims as fast as the stream
        through = seen.v[:, :3] - [*segment.current.mean[0], 0.0]
        speed, turn = of_movement(*windows(body_rates(seen.q, through), replay.tick).T)
        self.wide = np.stack([speed, speed, turn], 1)[..., None] * np.sqrt(own)

    def __call__(self, factors: np.ndarray, stream: np.ndarray) -> np.ndarray:
        return (self.replay.means(self.segment, factors, stream) - self.seen) / self.wide


def windows(values: np.ndarray, tick: float) -> np.ndarray:
    """Means over whole windows: (T, ...) -> (K, ...)."""
    size = max(1, min(round(WINDOW / tick), len(values)))
    k = len(values) // size
    return values[: k * size].reshape(k, size, *values.shape[1:]).mean(1)
