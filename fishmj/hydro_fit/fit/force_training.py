"""The residual, learnt: forces tick by tick.

    L = mean_rows,members b min(|dF / size|^2, far) + thrust b |mean dF_t / size|^2 + decay |W|^2

b are bootstrap weights, drawn by episode: each member gets another sample of the episodes. Features get noise, so that small
differences carry no information. Adam with a cosine schedule; one seed gives one result on one machine.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax

from fishmj.hydro_fit.fit.training_loop import Loop
from fishmj.hydro_fit.fit.training_windows import TrainingWindows, subset
from fishmj.water import residual_network
from fishmj.water.dynamics import planar_chain

NOISE = 0.01  # of the features
THRUST, DECAY = 3.0, 1e-4
FAR = 25.0  # squared error from which a row pulls no more
RATE, BATCH = 4e-3, 40  # pieces a step
THIN = 2  # forces are looked at in every second row


class ForceFit(NamedTuple):
    """Weights, and the losses during the training."""

    net: residual_network.Net
    losses: np.ndarray


def bootstrap(episodes: np.ndarray, members: int, seed: int) -> np.ndarray:
    """Number of draws (E, P) of each piece's episode by each member."""
    rng = np.random.default_rng([41, seed])
    count = int(episodes.max()) + 1
    drawn = np.stack([np.bincount(rng.integers(0, count, count), minlength=count) for _ in range(members)])
    return drawn[:, episodes].astype(np.float32)


def wakes(net: residual_network.Net, x, speed, step: float):
    """Wake states before every row, (T, G, P), from features (T, F, P) and V (T, P), each piece from rest; and after the last.

    Rows without speed do not change the wake.
    """
    weights = residual_network.halves(jnp, net)  # sorted once, and not in every step

    def advance(z, given):
        features, v = given
        new = residual_network.wake_step(
            jnp, weights, residual_network.MotionFeatures(list(features), v, [], [], []), list(z), step
        )
        return jnp.stack(new), z

    last, before = lax.scan(advance, jnp.zeros((residual_network.WAKES, x.shape[2]), x.dtype), (x, speed))
    return before, last


def forces(net: residual_network.Net, p: residual_network.Panels, rho: float, x, push, z):
    """Forces of every member, (E, T, 3, N, P), moments about the middle of each link, from x (T, F, P), z (T, G, P)."""
    rows = lambda a: list(jnp.moveaxis(a, 1, 0))
    g = residual_network.coefficients(
        jnp, net, residual_network.MotionFeatures(rows(x), None, [], [], []), rows(z)
    )  # (E, 3, N, T, P)
    n = push.shape[1]
    arm = np.stack([np.ones(n), np.ones(n), np.array(p.length)])[:, :, None] * (0.5 * rho * np.array(p.area))[:, None]
    return jnp.moveaxis(g, 3, 1) * arm.astype(np.float32) * push[None, :, None]


def loss(net: residual_network.Net, windows: TrainingWindows, drawn, p: residual_network.Panels, rho: float):
    """Force part of L; drawn (E, P): the bootstrap weights b."""
    z, _ = wakes(net, windows.x, windows.speed, windows.step)
    thin = lambda a: a[::THIN]
    x, push, left, weight = (thin(a) for a in (windows.x, windows.push, windows.left, windows.weight))
    error = (forces(net, p, rho, x, push, thin(z)) - left) / windows.size[:, :, None]
    w = drawn[:, None] * weight[None]
    square = jnp.sum(w[:, :, None, None] * jnp.minimum(error**2, FAR)) / ((jnp.sum(w) + 1e-6) * error.shape[2] * error.shape[3])
    along = (error[:, :, 0] * windows.size[0][:, None]).sum(2) / jnp.sqrt((windows.size[0] ** 2).sum())  # sum over links
    mean = (along * weight).sum(1) / (weight.sum(0) + 1e-6)
    thrust = jnp.sum(drawn * mean**2) / (jnp.sum(drawn) + 1e-6)
    return square + THRUST * thrust + DECAY * size_of(net)


def size_of(net: residual_network.Net):
    """Mean squares of the weights."""
    return sum(jnp.mean(getattr(net, k) ** 2) for k in ("inner", "outer", "wake", "even", "odd"))


def adam(rate: float, steps: int) -> optax.GradientTransformation:
    """Adam with clipped gradients and a learning rate that falls by a cosine."""
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(optax.cosine_decay_schedule(rate, steps, 0.03)))


def learn(
    ch: planar_chain.Chain, windows: TrainingWindows, net: residual_network.Net, *, steps: int = 800, seed: int = 0,
    ablated: dict | None = None, report: Callable | None = None, loop: Loop | None = None,
) -> ForceFit:  # fmt: skip
    """Trains on forces.

    Args:
        ablated: parts that `residual_network.without` leaves out, for comparison.
        report: called with (step, steps, loss). loop: keeps the state.
    """
    p, rho, ablated = residual_network.panels(ch), ch.strips.rho, ablated or {}
    bootstrap_weights = bootstrap(windows.episode, net.members, seed)
    optimiser = adam(RATE, steps)
    net = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), net)
    rng, loop = np.random.default_rng([43, seed]), loop or Loop()
    done, (net, state, losses) = loop.begin((net, optimiser.init(net), np.full(-(-steps // 20), np.nan)))

    @jax.jit
    def step(net, state, part, weights, key):
        part = part._replace(step=windows.step)
        part = part._replace(x=part.x + NOISE * jax.random.normal(key, part.x.shape))
        of_net = lambda net: loss(residual_network.without(net, **ablated), part, weights, p, rho)
        value, gradient = jax.value_and_grad(of_net)(net)
        updates, state = optimiser.update(gradient, state)
        return optax.apply_updates(net, updates), state, value

    count, key = len(windows.episode), jax.random.key(seed)
    for k in range(steps):
        at = rng.choice(count, min(BATCH, count), replace=False)
        if k < done:  # drawn and done before
            continue
        part = subset(windows, at)
        net, state, value = step(net, state, part, bootstrap_weights[:, at], jax.random.fold_in(key, k))
        if k % 20 == 19 or k + 1 == steps:
            losses = np.concatenate([losses[: k // 20], [float(value)], losses[k // 20 + 1 :]])
            if report is not None:
                report(k + 1, steps, losses[k // 20])
        loop.after(k + 1, (net, state, losses))
    return ForceFit(residual_network.without(jax.tree.map(np.asarray, net), **ablated), losses)
