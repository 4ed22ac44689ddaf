"""The learnt residual in the physics: hooks for `chain.step` that add its force and carry its memory.

    hooks = Learned(np, ch, residual, memory)               memory = at_rest(n), later Step.memory
    s = chain.step(np, ch, sw, q, v, attached, target, flow, ambient, hooks)

What is added is gamma_i sigma f_i, the members' mean f_i of `residual` faded twice:
    gamma_i = in range_i / (1 + (spread_i / spread0)^2)      0 where the motion of the link left what was fitted
    sigma   = smooth min(1, (eta D + R / T) / P+)            P = power of the faded forces, D = what drag takes
    R'      = eta D - sigma P+ - R / T,   R >= 0             a reservoir: only wake energy can come back
in the frame of the water. So the whole water stays passive up to the reservoir, and beyond its range it is the base alone.

The memory is flat, 3 N + 2 scalars or arrays of one batch shape: wake states link by link, R [J], and the number of steps that
had a link outside the range while it moved. `inner` are other hooks that act first, on the same fish.
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.hydro_fit import chain, residual, terms

ETA, STORED = 0.3, 1.0  # share of the dissipated power that may be kept, and for how long, s
TINY = 1e-24  # W4: 1 uW may pass
FADE = 0.85  # of the limit: from here the force fades, beyond the limit it is gone


class Range(NamedTuple):
    """Where the residual was fitted, for N links; see `inside`."""

    centre: Any  # (N, 5) of xi, odd features 0
    whiten: Any  # (N, 5, 5) with |whiten (xi - centre)| = Mahalanobis distance
    limit: Any  # (N,) of it
    speed: Any  # (N,) highest V, m/s
    spread: Any  # () spread of the members' coefficients at which the force is halved


class Residual(NamedTuple):
    """Weights and where they hold."""

    net: residual.Net
    reach: Range


def at_rest(links: int) -> list:
    """The memory of a fish in still water."""
    return [0.0] * (3 * links + 2)


def inside(xp, r: Range, m: residual.Motion, i: int):
    """1 well inside what was fitted for link i, 0 outside, and how far out its motion is (1 at the limit)."""
    off = [m.xi[i][c] - r.centre[i][c] for c in range(5)]
    distance: Any = 0.0
    for row in range(5):
        block = range(residual.EVEN) if row < residual.EVEN else range(residual.EVEN, 5)
        part = sum(r.whiten[i][row][c] * off[c] for c in block)
        distance = distance + part * part
    distance = distance / (r.limit[i] * r.limit[i])
    fast = m.speed[i] / r.speed[i]
    far = xp.maximum(distance, fast * fast)  # squares
    fade = xp.minimum(xp.maximum((1.0 - far) / (1.0 - FADE**2), 0.0), 1.0)
    return fade, far


class Learned:
    """Hooks that add a residual.

    Args:
        ch: the chain whose links the residual was fitted for.
        memory: flat list, inner's first where there is an `inner`.
        inner: other hooks, such as `hooks.Effects`.
        unrolled: scalar sums, for generated code.
    """

    def __init__(self, xp, ch: chain.Chain, learnt: Residual, memory, inner: Any = None, *, unrolled: bool = False):
        self.xp, self.learnt, self.inner, self.unrolled = xp, learnt, inner, unrolled
        self.panels, n = residual.panels(ch), ch.n
        own = list(memory)[-(3 * n + 2) :]
        self.z, self.store, self.guarded = [own[3 * i : 3 * i + 3] for i in range(n)], own[-2], own[-1]
        self.forces: list = []
        self.spread: list = []  # of the members' coefficients, a link

    def fish(self, ch, sw):
        return (ch, sw) if self.inner is None else self.inner.fish(ch, sw)

    def flow(self, ch, q, flow):
        return flow if self.inner is None else self.inner.flow(ch, q, flow)

    def servos(self, ch, sw, q, v, target):
        if self.inner is None:
            return chain.servo_drive(self.xp, ch, sw, q, v, target), [0.0] * (ch.n - 1)
        return self.inner.servos(ch, sw, q, v, target)

    def water(self, ch, sw, q, k, hydro):
        hydro = hydro if self.inner is None else self.inner.water(ch, sw, q, k, hydro)
        self.forces = self.advance(ch.strips, sw.water, k, ch.dt)
        return [tuple(a + b for a, b in zip(f, g, strict=True)) for f, g in zip(hydro, self.forces, strict=True)]

    def body(self, ch, sw, q, k, rhs, m) -> None:
        if self.inner is not None:
            self.inner.body(ch, sw, q, k, rhs, m)

    def end(self, ch, sw, v, drive):
        first = () if self.inner is None else tuple(self.inner.end(ch, sw, v, drive))
        return (*first, *(value for row in self.z for value in row), self.store, self.guarded)

    def advance(self, s: terms.Strips, c: terms.Coefficients, k: chain.Links, dt: float) -> list:
        """Forces on the links from the present wake, (F_t, F_n, moment) each; the wake moves on by dt."""
        xp, p = self.xp, self.panels
        m = residual.motion(xp, p, _batched(k))
        z = [[value + 0.0 * m.speed[0] for value in row] for row in self.z]
        g = residual.coefficients(xp, self.learnt.net, m, z, unrolled=self.unrolled)
        forces, outside = [], 0.0 * m.speed[0]
        self.spread = []
        for i in range(len(k.u)):
            mean, spread = _mean_and_spread(xp, g, i)
            fade, far = inside(xp, self.learnt.reach, m, i)
            gamma = fade / (1.0 + spread / self.learnt.reach.spread**2)
            forces.append(residual.load(p, s.rho, m, i, [gamma * value for value in mean]))
            outside = xp.maximum(outside, xp.where(m.square[i] > residual.FLOOR**2, xp.where(far > 1.0, 1.0, 0.0), 0.0))
            self.spread.append(spread)
        scale, self.store = bounded(xp, forces, residual.dissipated(xp, s, c, k), k, self.store, dt)
        self.z = residual.wake_step(xp, self.learnt.net, m, z, dt, unrolled=self.unrolled)
        self.guarded = self.guarded + outside
        return [tuple(scale * value for value in f) for f in forces]


def bounded(xp, forces: list, taken, k: chain.Links, store, dt: float):
    """Factor on all forces that keeps their power within eta D + R / T, and the reservoir dt later."""
    power: Any = 0.0
    for i, (ft, fn, moment) in enumerate(forces):
        power = power + ft * k.u[i] + fn * k.w[i] + moment * k.omega[i]
    gain, cap = xp.maximum(power, 0.0), ETA * taken + store / STORED
    two, four = gain * gain, cap * cap
    two, four = two * two, four * four
    scale = xp.sqrt(xp.sqrt((four + TINY) / (four + two + TINY)))
    return scale, xp.maximum(store + dt * (ETA * taken - scale * gain - store / STORED), 0.0)


def _batched(k: chain.Links) -> chain.Links:
    """Every velocity with the full batch shape."""
    zero = 0.0 * (k.u[-1] + k.w[-1] + k.omega[-1])
    whole = lambda values: [value + zero for value in values]  # noqa: E731
    return k._replace(u=whole(k.u), w=whole(k.w), omega=whole(k.omega))


def _mean_and_spread(xp, g, i: int):
    """Members' mean coefficients of link i, and the variance between members, mean over the three."""
    members = range(len(g))
    mean = [sum(g[e][c][i] for e in members) / len(g) for c in range(3)]
    if len(g) == 1:
        return mean, 0.0 * mean[0]
    spread = sum((g[e][c][i] - mean[c]) * (g[e][c][i] - mean[c]) for e in members for c in range(3))
    return mean, spread / (3.0 * (len(g) - 1))


def member(learnt: Residual, e: int) -> Residual:
    """The ensemble with member e in every place: that member alone, in arrays of the same shapes."""
    net = learnt.net
    alike = {name: np.repeat(np.asarray(getattr(net, name))[e : e + 1], net.members, 0) for name in net._fields[4:]}
    return learnt._replace(net=net._replace(**alike))


def unlimited(links: int) -> Range:
    """A range that nothing leaves, with members of any spread: for fitting."""
    return Range(np.zeros((links, 5)), np.tile(np.eye(5), (links, 1, 1)), np.full(links, 1e6), np.full(links, 1e6), np.array(1e6))


def fitted(xi: np.ndarray, speed: np.ndarray, spread: float, *, share: float = 0.999, margin: float = 1.15) -> Range:
    """The range that data span.

    Args:
        xi: (M, N, 5) features. speed: (M, N) V, m/s.
        spread: of the members' coefficients at which the force is halved.
        share: of the data that lies inside; `margin` on top, for distance and speed.
    """
    links = xi.shape[1]
    centre, whiten, limit = np.zeros((links, 5)), np.zeros((links, 5, 5)), np.zeros(links)
    for i in range(links):
        centre[i, : residual.EVEN] = xi[:, i, : residual.EVEN].mean(0)
        off = xi[:, i] - centre[i]  # odd features have mean 0: a fish turns both ways
        for block in (slice(0, residual.EVEN), slice(residual.EVEN, 5)):
            part = off[:, block]
            cov = part.T @ part / len(part)
            cov += 1e-4 * np.eye(len(cov)) * max(np.trace(cov) / len(cov), 1e-6)
            whiten[i, block, block] = np.linalg.inv(np.linalg.cholesky(cov))
        limit[i] = margin * np.quantile(np.linalg.norm(off @ whiten[i].T, axis=1), share)
    return Range(centre, whiten, limit, margin * np.quantile(speed, share, axis=0), np.array(float(spread)))
