"""The residual, learnt from swims: gradients through free swims from recorded states.

    L = mean h(dv / size) + mean h(dV / size) / part^2 + power mean h(dP / size) + mean h(dT / asked) + L_forces
    h(e) = 2 c^2 (sqrt(1 + e^2 / c^2) - 1)

dv: surge, sway and yaw rate over windows of 0.2 s, dV: over the whole piece, dP: servo power, in shares of the record with floors
(tolerance.py); dT: mean thrust of held fish; L_forces (force_training) keeps forces right where swims do not determine them. A
model that is right to a per cent in every force may still swim wrong, so the swims decide. The error within a beat is larger than
that of the mean, which makes a fish late or turn too wide, so the mean has a term of its own. The wake at a start is filled by
the recorded motion of the 1.2 s before it; gradients include that. The members act together, as in a fish. Backpropagation
through a differentiable simulator: Degrave et al. 2019, doi 10.3389/fnbot.2019.00006.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.fit import force_training
from fishmj.hydro_fit.fit.gauss_newton import flaps, thrusts, tow_drag
from fishmj.hydro_fit.fit.regression_rows import attachment, base_force, rows_of
from fishmj.hydro_fit.fit.rollout import FishBatch, SwimWindow, cut, is_free
from fishmj.hydro_fit.fit.training_loop import Loop, devices, replicated, sharded, short_op_compiler_options, stacked
from fishmj.hydro_fit.fit.training_windows import EVERY, TrainingWindows, motion_of, subset
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.dynamics.tolerance import TOLERANCE, body_rates, of_movement

BURN, WINDOW = 1.2, 0.2  # s: of recorded motion before a piece, of the means that are compared
CLIP, POWER = 6.0, 0.3
THRUST = 0.10  # of the tow drag: what is asked for
LENGTH, BATCH, RATE = 2.0, 32, 1.5e-3  # s of a piece, which begin half of it apart; pieces a step; of learning
FORCE_WINDOWS, TETHERED = 32, 16  # pieces of forces, and held fish, a step
FLOORS, PART = 2.0, 0.25  # of the tolerances: times the floors in a window, times all of it for a mean
TURN = 0.5  # times that of a mean yaw rate: a heading adds up what it is off by


class Windows(NamedTuple):
    """P free swims of T ticks; x (T_b, F, P), speed (T_b, P): recorded motion before them, speed zero if there is none."""

    fleet: FishBatch
    x: Any
    speed: Any
    attached: Any  # (P,)
    share: np.ndarray  # (P,) how often each is drawn, sum 1


class TetheredRecords(NamedTuple):
    """R held fish that flap, with T rows spaced as in `TrainingWindows`; thrusts are means over a record, (R,) N."""

    x: Any  # (T, F, R)
    speed: Any  # (T, R)
    push: Any  # (T, N, R)
    weight: Any  # (T, R)
    strips: Any  # thrust of the strips
    recorded: Any  # in the flow solver


def windows_of(ch: planar_chain.Chain, robot: Robot, records: Sequence[SegmentRecord], c: strip_forces.Coefficients) -> Windows:
    """Overlapping pieces of all free swims. Raises DatasetError: none is long enough."""
    free = [r for r in records if is_free(r) and r.seconds >= LENGTH]
    if not free:
        raise DatasetError(f"no free swim of {LENGTH:g} s among the records; collect gaits")
    tick = free[0].tick
    size, apart, burn = (round(seconds / tick) for seconds in (LENGTH, LENGTH / 2, BURN))
    rows = rows_of(ch, free)
    m, attached = motion_of(residual_network.panels(ch), rows), attachment(rows, ch.strips, c, tick)
    features = np.array(m.x)
    at, x, speed, state = [], [], [], []
    for number, (record, span) in enumerate(zip(free, rows.spans(), strict=True)):
        settled = record.meta.get("settle", 0.0) > 0
        for a in range(burn if settled else 0, len(record.q) - size + 1, apart):
            before, more = slice(span.start + max(0, a - burn), span.start + a), max(0, burn - a)
            at.append((number, a, a + size))
            x.append(np.pad(features[:, before], ((0, 0), (more, 0))).T)
            speed.append(np.pad(m.speed[before], (more, 0)))
            state.append(attached[span.start + a] if a else 0.5)
    fleet = cut(ch, robot, free, at)
    share = shares([free[number].meta["block"] for number, _, _ in at])
    return Windows(fleet, np.stack(x, -1), np.stack(speed, -1), np.array(state), share)


def shares(blocks: Sequence[str]) -> np.ndarray:
    """Weights of the blocks, the square root of their pieces, so that the largest do not dominate."""
    _, at, count = np.unique(blocks, return_inverse=True, return_counts=True)
    share = 1 / np.sqrt(count[at])
    return share / share.sum()


def tethered_of(ch: planar_chain.Chain, records: Sequence[SegmentRecord], c: strip_forces.Coefficients) -> TetheredRecords | None:
    """Held fish that flap, or None."""
    chosen = [r for r in records if flaps(r)]
    if not chosen:
        return None
    rows, tick = rows_of(ch, chosen), chosen[0].tick
    m, strips = motion_of(residual_network.panels(ch), rows), base_force(rows, ch.strips, c, attachment(rows, ch.strips, c, tick))
    wide = lambda values: np.moveaxis(rows.wide(values), -2, 0)  # (.., M) -> (T, .., R)
    weight = wide(np.ones(len(rows.record)))[::EVERY]
    thrust = (thrusts(rows, force) for force in (strips, rows.force))
    motion = (wide(np.asarray(values))[::EVERY] for values in (m.x, m.speed, m.push))
    return TetheredRecords._make([*motion, weight / weight.sum(0), *thrust])


def some(pieces: Windows, at) -> Windows:
    """Some of the pieces, without their sources."""
    fleet = FishBatch._make([*(a[at] for a in pieces.fleet[:-1]), ()])
    return Windows(fleet, pieces.x[..., at], pieces.speed[..., at], pieces.attached[at], pieces.share[at])


def huber(error):
    """Mean of h(e)."""
    return jnp.mean(2 * CLIP**2 * (jnp.sqrt(1 + (error / CLIP) ** 2) - 1))


class RolloutTrainer:
    """Trains a net by free swims.

    Args:
        water: flat coefficients of the strips, which stay unchanged.
        ablated: parts that `residual_network.without` leaves out, for comparison.
    """

    def __init__(
        self, robot: Robot, swim: SwimWindow, pieces: Windows, tethered: TetheredRecords | None, force_windows: TrainingWindows,
        water: np.ndarray, *, ablated: dict | None = None,
    ):  # fmt: skip
        self.swim, self.water, self.ablated = swim, np.asarray(water, np.float32), ablated or {}
        single = lambda tree: jax.tree.map(lambda a: np.asarray(a, np.float32), tree)
        self.pieces, self.force_windows = single(pieces._replace(fleet=pieces.fleet._replace(source=()))), force_windows
        self.tethered, self.share = None if tethered is None else single(tethered), pieces.share
        self.ch, self.tick = swim.chain, force_windows.step / EVERY
        self.panels, self.drag = residual_network.panels(self.ch), tow_drag(self.ch, robot)

    def loss(self, net: residual_network.Net, part: Windows, windows: TrainingWindows, drawn, tethered: TetheredRecords | None):
        """Loss L of a batch."""
        net = residual_network.without(net, **self.ablated)
        total = self.swim_loss(net, part) + force_training.loss(net, windows, drawn, self.panels, self.ch.strips.rho)
        return total if tethered is None else total + huber(self.thrust_errors(net, tethered))

    def swim_loss(self, net: residual_network.Net, part: Windows):
        """Swim terms of the loss."""
        fleet, count = part.fleet, len(part.attached)
        # the wake at the start depends on the weights, too: it is filled within the gradient, else training would ignore that
        _, wake = force_training.wakes(net, part.x, part.speed, self.tick)
        memory = jnp.concatenate([wake.T, jnp.zeros((count, 2))], 1)
        # no range during training: a force that fades outside would have no gradient where its error is largest
        learnt = residual_hooks.Residual(net, None)
        water = jnp.tile(self.water, (count, 1))
        start = (fleet.q[:, 0], fleet.v[:, 0], fleet.target, fleet.flow, fleet.ambient)
        (q, v, power), _ = self.swim.trace(*start, water, part.attached, memory, learnt)
        whole, (error, spent) = self.means(q, v, fleet), self.errors(q, v, power, fleet)
        return huber(error) + huber(whole) / PART**2 + POWER * huber(spent)

    def errors(self, q, v, power, fleet: FishBatch):
        """Errors of movement (P, W, 3) and of power (P, W) over windows, in tolerances."""
        size = round(WINDOW / self.tick)

        def mean(a):
            whole = a.shape[1] // size * size
            return a[:, :whole].reshape(len(a), -1, size, *a.shape[2:]).mean(2)

        got, recorded = mean(body_rates(q, v, jnp)), mean(body_rates(fleet.q[:, 1:], fleet.v[:, 1:], jnp))
        (part, least), spent, wanted = TOLERANCE["power"], mean(power), mean(fleet.power)
        # nan if no power was recorded: such windows have no weight
        off = (spent - wanted) / (part * jnp.abs(wanted) + FLOORS * least)
        return (got - recorded) / _tolerated(recorded, FLOORS), jnp.where(jnp.isfinite(off), off, 0.0)

    def means(self, q, v, fleet: FishBatch):
        """Errors of movement over whole pieces, (P, 3), in tolerances."""
        got, recorded = body_rates(q, v, jnp).mean(1), body_rates(fleet.q[:, 1:], fleet.v[:, 1:], jnp).mean(1)
        return (got - recorded) / (_tolerated(recorded, 1.0) * np.array([1.0, 1.0, TURN], np.float32))

    def thrust_errors(self, net: residual_network.Net, tethered: TetheredRecords):
        """Errors of the mean thrust of held fish, (R,), in the required accuracy."""
        z, _ = force_training.wakes(net, tethered.x, tethered.speed, self.force_windows.step)
        force = force_training.forces(net, self.panels, self.ch.strips.rho, tethered.x, tethered.push, z).mean(0)  # (T, 3, N, R)
        got = tethered.strips + (tethered.weight * force[:, 0].sum(1)).sum(0)
        return (got - tethered.recorded) / (THRUST * self.drag)

    def draw_tethered(self, rng: np.random.Generator, most: int) -> TetheredRecords | None:
        """At most so many of the held fish, at random."""
        if self.tethered is None:
            return None
        at = rng.permutation(len(self.tethered.recorded))[:most]
        return TetheredRecords._make(a[..., at] for a in self.tethered)

    def learn(
        self, net: residual_network.Net, *, steps: int, seed: int = 0, report: Callable | None = None, loop: Loop | None = None
    ) -> residual_network.Net:
        """Minimises L from `net`. One seed gives one result on one machine.

        Args:
            report: called with (step, steps, loss). loop: keeps the state.
        """
        optimiser = force_training.adam(RATE, steps)
        net = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), net)
        rng, loop = np.random.default_rng([47, seed]), loop or Loop()
        since, (net, state) = loop.begin((net, optimiser.init(net)))
        count = len(self.force_windows.episode)
        drawn = force_training.bootstrap(self.force_windows.episode, net.members, seed)
        swim_count, force_count = (min(most, there) for most, there in ((BATCH, len(self.share)), (FORCE_WINDOWS, count)))
        shards = devices(swim_count, force_count)
        gradient_of = sharded(self.loss, shards)
        net, state = replicated((net, state), shards)

        @partial(jax.jit, compiler_options=short_op_compiler_options(shards[0].platform))
        def step(net, state, *batches):
            value, gradient = gradient_of(net, *batches)
            updates, state = optimiser.update(gradient, state)
            return optax.apply_updates(net, updates), state, value

        for k in range(steps):
            at = np.split(rng.choice(len(self.share), swim_count, replace=False, p=self.share), len(shards))
            rows = np.split(rng.choice(count, force_count, replace=False), len(shards))
            fish = [self.draw_tethered(rng, TETHERED // len(shards)) for _ in shards]
            if k < since:  # done before; drawn all the same, so that the generator stands where it stood
                continue
            batches = [
                (some(self.pieces, a), subset(self.force_windows, r), drawn[:, r], h)
                for a, r, h in zip(at, rows, fish, strict=True)
            ]
            net, state, value = step(net, state, *stacked(batches))
            if report is not None and (k % 5 == 4 or k + 1 == steps):
                report(k + 1, steps, float(value))
            loop.after(k + 1, (net, state))
        return residual_network.without(jax.tree.map(np.asarray, net), **self.ablated)


def _tolerated(recorded, floors: float):
    """Tolerances of recorded surge, sway and yaw rate, (.., 3)."""
    speed, turn = of_movement(recorded[..., 0], recorded[..., 1], recorded[..., 2], floors, jnp)
    return jnp.stack([speed, speed, turn], -1)
