"""A segment: the swim of a fish in MuJoCo, the same swim in a better water, and the difference of the two.

    |---- lead ----|---- span ----|        bus ticks
     the better water's fish is led along MuJoCo's own path, then swims the same commands by its servos

The better water starts undisturbed and develops during the lead. The span is compared; it starts from one state, with the same
commands in the same eddies. Compared are means of velocity ahead, to the left, and yaw rate over windows of `WINDOW` s.
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

WIDE = 12  # replays side by side; a batch of one size is compiled once


class HybridSegment(NamedTuple):
    """Swim of one fish; every field of a batch has one row."""

    fish: int  # its number
    tick: int  # bus ticks from t = 0 to the begin of the lead
    q: np.ndarray  # (L + 1, 3 + J) states at the begin and after each tick of the lead, m, rad
    v: np.ndarray  # (L + 1, 3 + J) m/s, rad/s
    start: FishState  # where the lead ends; its buffer holds the commands until then
    commands: np.ndarray  # (n, J) rad, as they were on the bus, one a tick of the span
    params: FishParams  # the fish, in the water that is to be corrected
    current: Current  # background flow as MuJoCo is told
    kind: Flow  # its turbulence and box

    @property
    def span(self) -> int:
        """Tick at which the span begins."""
        return self.tick + len(self.q) - 1


class FreeSwim(NamedTuple):
    """n ticks of free swimming, states after each, (n, 3 + J); of B replays (B, n, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class Oracle(Protocol):
    """A better water."""

    def swim(self, segments: Sequence[HybridSegment]) -> list["FreeSwim | str"]:
        """Swims of the fish of each segment in its span there, or the reason for an early end.

        Raises FishmjError, ArithmeticError, RuntimeError: this water does not work at all.
        """


class Replay:
    """Repeats the span of a segment in the simulation's water with other factors and another stream: the closed form, in JAX.

    chain: a chain other than the robot's own.
    """

    def __init__(self, robot: Robot, chain: planar_chain.Chain | None = None):
        self.engine, self.tick = planar.PlanarEngine(robot), robot.timing.bus_dt
        self.engine.chain = chain or self.engine.chain
        self._device = jax.local_devices(backend="cpu")[0]  # a dozen fish: a GPU would take longer, and has the solver's tanks

    def means(self, segment: HybridSegment, factors: np.ndarray, stream: np.ndarray) -> np.ndarray:
        """Velocity ahead, to the left, and yaw rate by windows, (K, 3, B); for factors (10, B) and streams (2, B)."""
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
    """Differences of the simulation's movement from the observed one, divided by the irreducible error: (K, 3, B).

    own: 90th percentile of the mean square in tolerances, of the worst channel, over segments of an exact water.
    """

    def __init__(self, replay: Replay, segment: HybridSegment, seen: FreeSwim, own: float):
        self.replay, self.segment = replay, segment
        self.seen = windows(body_rates(seen.q, seen.v), replay.tick)[..., None]
        # the tolerance grows with the speed through the water: a fish that holds station swims as fast as the stream
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
