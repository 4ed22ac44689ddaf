"""Free swims of a whole batch of recorded fish, from their recorded starts, by their recorded commands, in a model of the water.

    fleet = fish_batch_of(ch, robot, records, seconds=10)           pieces of free swimming, padded to one length
    track = SwimWindow(ch, swimmer).run(fleet, water (B, P), learnt)    swims in the model; JAX, one compilation a shape
    view = windows(track, fleet); rec = windows(recorded(fleet), fleet)

Commands take the same path as on the robot; the undisturbed flow is that of the records, tick by tick.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import PartitionSpec

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.fit.regression_rows import ambient_of
from fishmj.hydro_fit.fit.training_loop import devices, mesh_of
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain, tolerance
from fishmj.water.prior import unflat

WINDOW = 2.0  # s, over which velocities are averaged
SHORTEST = 2.0  # s, of a piece of a swim
START, SHARE = 2.0, 0.9  # s from rest that `from_rest` looks at; of the swims that stay below what it says
LEAST = 128  # fish swum at once, the last one repeated: a step of them costs as much as one of ten, a compilation 5 s


class FishBatch(NamedTuple):
    """B pieces of T ticks; `mask` (B, T) is 0 behind the end of a shorter one. World frame, SI."""

    q: np.ndarray  # (B, 1 + T, nv) recorded, row 0 at the start
    v: np.ndarray  # (B, 1 + T, nv)
    target: np.ndarray  # (B, T, S, J) what the servos aim at in each physics step, rad
    flow: np.ndarray  # (B, T, N, 2)
    ambient: np.ndarray  # (B, T, 2)
    power: np.ndarray  # (B, T) servos without the electronics, W
    mask: np.ndarray  # (B, T)
    source: tuple  # B pairs of (number of the record, first tick)


class SwimTrack(NamedTuple):
    """Swims in the model, (B, T, ..), at the ends of ticks; `memory` (B, M) at the end, `outside` (B,) share of steps."""

    q: Any
    v: Any
    power: Any
    outside: Any


def is_free(record: SegmentRecord) -> bool:
    """Returns True for a record driven by its servos alone."""
    held = record.meta["prescribed"]
    return not (held["joints"] or held["root"])


def fish_batch_of(ch: planar_chain.Chain, robot: Robot, records: Sequence[SegmentRecord], *, seconds: float = 10.0) -> FishBatch:
    """Free swims cut into pieces of `seconds`; a rest shorter than `SHORTEST` is left out.

    Raises DatasetError: no record swims freely.
    """
    pieces = []
    for number, record in enumerate(records):
        if not is_free(record):
            continue
        size, whole = round(seconds / record.tick), len(record.q)
        starts = [a for a in range(0, whole, size) if min(size, whole - a) * record.tick >= SHORTEST]
        pieces += [(number, a, min(a + size, whole)) for a in starts]
    if not pieces:
        raise DatasetError("no free swim among the records; the fit of speed and turning needs some: collect gaits")
    return cut(ch, robot, records, pieces)


def cut(
    ch: planar_chain.Chain, robot: Robot, records: Sequence[SegmentRecord], pieces: Sequence[tuple[int, int, int]]
) -> FishBatch:
    """Batch of these pieces, (number of the record, first tick, end)."""
    longest = max(b - a for _, a, b in pieces)
    columns = [_piece(ch, robot, records[n], a, b, longest) for n, a, b in pieces]
    return FishBatch._make([*(np.stack(c) for c in zip(*columns, strict=True)), tuple((n, a) for n, a, _ in pieces)])


def _piece(ch: planar_chain.Chain, robot: Robot, record: SegmentRecord, a: int, b: int, longest: int) -> tuple:
    q0, v0 = record.before
    steps, more = round(record.tick / ch.dt), longest - (b - a)
    delay = round(record.meta.get("latency", robot.timing.command_latency) / ch.dt)
    ramp = robot.timing.command_path == "move_time"
    before = np.concatenate([q0[:1, 3:], record.command])  # on the bus before the start: where the joints were
    due = np.arange(a * steps, b * steps) - delay
    whole, part = np.floor_divide(due, steps), np.mod(due, steps)
    newest = before[np.maximum(whole + 1, 0)]
    if ramp:
        older = before[np.maximum(whole, 0)]
        newest = older + ((part + 1) / steps)[:, None] * (newest - older)
    pad = lambda x: np.concatenate([x, np.repeat(x[-1:], more, 0)])
    states = (np.concatenate([q0[a : a + 1], record.q[a:b]]), np.concatenate([v0[a : a + 1], record.v[a:b]]))
    target = newest.reshape(b - a, steps, -1)
    mask = np.concatenate([np.ones(b - a), np.zeros(more)])
    rest = (target, record.flow[a:b], ambient_of(record)[a:b], record.power[a:b] - robot.servo.idle_power)
    return (*(pad(x) for x in states), *(pad(x) for x in rest), mask)


def recorded(fleet: FishBatch) -> SwimTrack:
    """Recorded swims in the same shape."""
    return SwimTrack(fleet.q[:, 1:], fleet.v[:, 1:], fleet.power, np.zeros(len(fleet.q)))


def repeated(fleet: FishBatch, times: int) -> FishBatch:
    """Fleet repeated `times` times, for as many waters."""
    return FishBatch._make([*(np.concatenate([a] * times) for a in fleet[:-1]), fleet.source * times])


def some(fleet: FishBatch, keep) -> FishBatch:
    """Pieces of the fleet by number or boolean."""
    at = np.arange(len(fleet.q))[keep]
    return FishBatch._make([*(a[at] for a in fleet[:-1]), tuple(fleet.source[int(i)] for i in at)])


def padded(fleet: FishBatch, like: FishBatch) -> FishBatch:
    """Fleet with at least as many pieces and ticks as `like`, the rest masked: both then share one compilation."""
    more, ticks = max(0, len(like.q) - len(fleet.q)), max(0, like.mask.shape[1] - fleet.mask.shape[1])
    long = [np.concatenate([a, np.repeat(a[:, -1:], ticks, 1)], 1) for a in fleet[:-2]]
    mask = np.concatenate([fleet.mask, np.zeros((len(fleet.mask), ticks))], 1)
    whole = [np.concatenate([a, np.repeat(a[-1:], more, 0)]) for a in (*long, mask)]
    return FishBatch._make([*whole, fleet.source])


class SwimWindow:
    """Free swims of one robot in JAX. swimmer: the fish; `run` replaces its water."""

    def __init__(self, ch: planar_chain.Chain, swimmer: planar_chain.Swimmer):
        self.chain, self.swimmer = ch, swimmer
        self._key = repr((ch, swimmer[:5]))

    def __hash__(self) -> int:  # equal fish share what was compiled
        return hash(self._key)

    def __eq__(self, other) -> bool:
        return isinstance(other, SwimWindow) and self._key == other._key

    def run(
        self, fleet: FishBatch, water: np.ndarray, learnt: "residual_hooks.Residual | None" = None, attached=None, memory=None
    ) -> SwimTrack:
        """Swims every piece from its recorded start.

        Args:
            water: (P,) or (B, P) flat coefficients. learnt: a residual, or None for the base alone.
            attached: (B,) at the start, 0.5 by default; memory: (B, WAKES + 2), at rest by default.
        Returns:
            Track of NumPy arrays; a fish whose state is no longer finite is nan from then on.
        """
        batch = len(fleet.q)
        water = np.broadcast_to(np.asarray(water, np.float32), (batch, np.shape(water)[-1]))
        attached = np.full(batch, 0.5) if attached is None else attached
        memory = np.zeros((batch, len(residual_hooks.at_rest()))) if memory is None else memory
        given = (fleet.q[:, 0], fleet.v[:, 0], fleet.target, fleet.flow, fleet.ambient, water, attached, memory)
        size = LEAST * -(-batch // LEAST)  # few sizes, so that few are compiled
        wide = [np.concatenate([a, np.repeat(a[-1:], size - batch, 0)]) for a in map(np.asarray, given)]
        single = lambda tree: jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
        out = self._run(None if learnt is None else single(learnt), *single(wide))
        return SwimTrack(*(np.asarray(a)[:batch].astype(float) for a in out))

    @partial(jax.jit, static_argnums=0)
    def _run(self, learnt, *given):
        """Swims a batch, in equal parts on as many devices as there are."""
        mesh, parts = mesh_of(devices(len(given[0]))), PartitionSpec("devices")
        specs = PartitionSpec(), *[parts] * len(given)
        return jax.shard_map(self._track, mesh=mesh, in_specs=specs, out_specs=parts, check_vma=False)(learnt, *given)

    def _track(self, learnt, q, v, target, flow, ambient, water, attached, memory):
        track, (_, _, _, memory) = self.trace(q, v, target, flow, ambient, water, attached, memory, learnt)
        return (*track, memory[-1] / (target.shape[1] * target.shape[2]))

    def trace(self, q, v, target, flow, ambient, water, attached, memory, learnt):
        """Swim as JAX code: ((q, v, power) (B, T, ..), state at the end)."""
        ch, n = self.chain, self.chain.n
        split = lambda a: tuple(a[:, i] for i in range(a.shape[1]))
        sw, hooks_of = self.in_water(split(water), learnt)

        def tick(state, given):
            target, flow, ambient = given
            stream = [(flow[:, i, 0], flow[:, i, 1]) for i in range(n)]

            def step(state, aim):
                q, v, x, memory, power = state
                s = planar_chain.step(jnp, ch, sw, q, v, x, split(aim), stream, split(ambient), hooks_of(memory))
                memory = memory if learnt is None else tuple(s.memory)
                return (tuple(s.q), tuple(s.v), s.attached, memory, power + s.power), None

            again = jax.checkpoint(step, prevent_cse=False)  # a gradient does each step once more: it needs its state alone
            (q, v, x, memory, power), _ = lax.scan(again, (*state, 0.0 * state[2]), jnp.swapaxes(target, 0, 1))
            return (q, v, x, memory), (jnp.stack(q, -1), jnp.stack(v, -1), power / target.shape[1])

        ahead = tuple(jnp.swapaxes(a, 0, 1) for a in (target, flow, ambient))
        start = (split(q), split(v), attached, split(memory))
        state, out = lax.scan(tick, start, ahead)
        return tuple(jnp.swapaxes(a, 0, 1) for a in out), state

    def in_water(self, water: tuple, learnt) -> tuple:
        """(swimmer, function from the memory to the hooks of a step) in a water's coefficients, (B,) each."""
        sw = self.swimmer._replace(water=unflat(list(water)))
        if learnt is None:
            return sw, lambda memory: None
        learnt = learnt._replace(net=residual_network.halves(jnp, learnt.net))  # sorted once, and not in every step
        return sw, lambda memory: residual_hooks.LearnedResidual(jnp, self.chain, learnt, memory)


class WindowMeans(NamedTuple):
    """Means over windows of a swim, (B, K): velocity over ground in the body frame, yaw rate, servo power; nan behind the end."""

    surge: np.ndarray  # m/s
    sway: np.ndarray
    yaw_rate: np.ndarray  # rad/s
    power: np.ndarray  # W


def windows(track: SwimTrack, fleet: FishBatch, tick: float, seconds: float = WINDOW) -> WindowMeans:
    """Means over whole windows of `seconds` from the start."""
    size = round(seconds / tick)
    count = max(1, track.q.shape[1] // size)
    size = min(size, track.q.shape[1])
    yaw, (vx, vy) = track.q[..., 2], (track.v[..., 0], track.v[..., 1])
    surge, sway = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    shape = (len(yaw), count, size)
    whole = fleet.mask[:, : count * size].reshape(shape).min(-1) > 0
    mean = lambda a: np.where(whole, a[:, : count * size].reshape(shape).mean(-1), np.nan)
    return WindowMeans(mean(surge), mean(sway), mean(track.v[..., 2]), mean(track.power))


def begins_at_rest(record: SegmentRecord) -> bool:
    """Returns True for a free gait from rest in still water."""
    still = not np.any(record.meta["start"]["v"]) and float(np.abs(record.flow).max()) < 1e-6
    return record.meta["block"] == "gait" and is_free(record) and still and record.seconds >= START


def from_rest(swim: SwimWindow, robot: Robot, records: Sequence[SegmentRecord], water: np.ndarray) -> float:
    """Movement error of an exact model in the first two seconds from rest, which a correction must not take for its error.

    The wake is not developed then, which strips cannot model; the error is therefore larger than later in the same swim.

    Returns:
        90th percentile over such swims, 1 at least: mean square difference of velocity ahead, to the left, and yaw rate
        over windows of `tolerance.WINDOW`, in tolerances.
    """
    chosen = [r for r in records if begins_at_rest(r)]
    if not chosen:
        return 1.0
    tick, size = chosen[0].tick, round(START / chosen[0].tick)
    whole = fish_batch_of(swim.chain, robot, chosen, seconds=1e6)
    fleet = FishBatch._make([*(a[:, : size + 1] for a in whole[:2]), *(a[:, :size] for a in whole[2:-1]), whole.source])
    got, seen = (windows(track, fleet, tick, tolerance.WINDOW) for track in (swim.run(fleet, water, None), recorded(fleet)))
    speed, turn = tolerance.of_movement(seen.surge, seen.sway, seen.yaw_rate)
    wide = {"surge": speed, "sway": speed, "yaw_rate": turn}
    errors = [(getattr(got, name) - getattr(seen, name)) / size for name, size in wide.items()]
    return max(1.0, float(np.quantile(np.mean(np.square(errors), axis=(0, 2)), SHARE)))
