"""The residual, learnt: forces tick by tick.

    L = mean_rows,members b |dF / size|^2 + thrust b |mean dF_t / size|^2 + decay |W|^2

b are bootstrap weights, drawn by episode: each member sees another sample of the episodes. Features get noise, so that
small differences are no information. Adam with a cosine schedule; one seed gives one result on one machine.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax

from fishmj.hydro_fit import chain, residual
from fishmj.hydro_fit.fit.lessons import Lessons, taken

NOISE = 0.01  # of the features
THRUST, DECAY = 3.0, 1e-4
RATE, BATCH = 4e-3, 40  # pieces a step
THIN = 2  # forces are looked at in every second row, from a random one on


class Schooling(NamedTuple):
    """Weights and the losses on the way."""

    net: residual.Net
    losses: np.ndarray


def bootstrap(episodes: np.ndarray, members: int, seed: int) -> np.ndarray:
    """(E, P) how often each member draws the episode of each piece."""
    rng = np.random.default_rng([41, seed])
    count = int(episodes.max()) + 1
    drawn = np.stack([np.bincount(rng.integers(0, count, count), minlength=count) for _ in range(members)])
    return drawn[:, episodes].astype(np.float32)


def wakes(net: residual.Net, xi, speed, tick: float, start=None, *, memory: bool = True):
    """Wake states before every tick, (T, 3, N, P), from features (T, 5, N, P) and V (T, N, P); and after the last."""
    n = xi.shape[2]
    zero = jnp.zeros((3, n, xi.shape[3]), xi.dtype) if start is None else start

    def step(z, given):
        features, v = given
        m = residual.Motion([[features[f, i] for f in range(5)] for i in range(n)], [v[i] for i in range(n)], [])
        new = residual.wake_step(jnp, net, m, [[z[c, i] for c in range(3)] for i in range(n)], tick)
        new = jnp.stack([jnp.stack([new[i][c] for i in range(n)]) for c in range(3)])
        return (new if memory else zero), z

    last, before = lax.scan(step, zero, (xi, speed))
    return before, last


def forces(net: residual.Net, p: residual.Panels, rho: float, xi, square, z):
    """Forces of every member, (E, T, 3, N, P), moments about the middle of each link."""
    n = xi.shape[2]
    m = residual.Motion([[xi[:, f, i] for f in range(5)] for i in range(n)], [], [])
    g = residual.coefficients(jnp, net, m, [[z[:, c, i] for c in range(3)] for i in range(n)])  # (E, 3, N, T, P)
    arm = np.stack([np.ones(n), np.ones(n), np.array(p.length)])[:, :, None] * (0.5 * rho * np.array(p.area))[:, None]
    return jnp.moveaxis(g, 3, 1) * arm.astype(np.float32) * square[None, :, None]


def loss(net: residual.Net, lessons: Lessons, b, p: residual.Panels, rho: float, memory: bool = True, first: int = 0):
    """The force part of L; b (E, P). `first`: row from which every `THIN`th counts."""
    z, _ = wakes(net, lessons.xi, lessons.speed, lessons.step, memory=memory)
    thin = lambda a: a[first::THIN]  # noqa: E731
    xi, square, left, weight = (thin(a) for a in (lessons.xi, lessons.square, lessons.left, lessons.weight))
    error = (forces(net, p, rho, xi, square, thin(z)) - left) / lessons.size[:, :, None]
    w = b[:, None] * weight[None]
    whole = jnp.sum(w) + 1e-6
    square = jnp.sum(w[:, :, None, None] * error**2) / (whole * error.shape[2] * error.shape[3])
    along = (error[:, :, 0] * lessons.size[0][:, None]).sum(2) / jnp.sqrt((lessons.size[0] ** 2).sum())  # sum over links
    mean = (along * weight).sum(1) / (weight.sum(0) + 1e-6)
    thrust = jnp.sum(b * mean**2) / (jnp.sum(b) + 1e-6)
    decay = sum(jnp.mean(getattr(net, k) ** 2) for k in ("inner", "outer", "wake", "wake_out"))
    return square + THRUST * thrust + DECAY * decay


def learn(
    ch: chain.Chain, lessons: Lessons, net: residual.Net, *, steps: int = 800, seed: int = 0, memory: bool = True,
    report: Callable | None = None,
) -> Schooling:  # fmt: skip
    """Teach forces.

    Args:
        memory: without, the wake stays at rest (for comparison). report: called with (step, steps, loss).
    """
    p, rho = residual.panels(ch), ch.strips.rho
    b = bootstrap(lessons.episode, net.members, seed)
    schedule = optax.cosine_decay_schedule(RATE, steps, 0.03)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    net = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), net)
    state, rng, losses = optimiser.init(net), np.random.default_rng([43, seed]), []

    @jax.jit
    def step(net, state, part, weights, key):
        part = part._replace(step=lessons.step)
        part = part._replace(xi=part.xi + NOISE * jax.random.normal(key, part.xi.shape))
        value, slope = jax.value_and_grad(loss)(net, part, weights, p, rho, memory)
        change, state = optimiser.update(slope, state)
        return optax.apply_updates(net, change), state, value

    count, key = len(lessons.episode), jax.random.key(seed)
    for k in range(steps):
        at = rng.choice(count, min(BATCH, count), replace=False)
        part = taken(lessons, at)
        net, state, value = step(net, state, part, b[:, at], jax.random.fold_in(key, k))
        if k % 20 == 19 or k + 1 == steps:
            losses.append(float(value))
            if report is not None:
                report(k + 1, steps, losses[-1])
    return Schooling(jax.tree.map(np.asarray, net), np.array(losses))
