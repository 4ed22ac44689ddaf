"""The learnt residual in the physics: hooks for `planar_chain.step` that add its force and carry its memory.

    hooks = LearnedResidual(np, ch, residual, memory)       memory = at_rest(), later Step.memory
    s = planar_chain.step(np, ch, sw, q, v, attached, target, flow, ambient, hooks)

The added force is gamma sigma f_i: f_i is the ensemble's mean, gamma fades it outside the fit, and sigma bounds its power:
    gamma   = r min_i (in range)_i / (1 + (spread / spread0)^2)  0 if the motion of a link is outside the range of the fit; r:
                                                                 the coefficient `residual`, 1 in a fitted water
    sigma   = (1 + (P+ / (eta D + R / T))^4)^-1/4                P: power of gamma f_i, D: power dissipated by drag
    R'      = eta D - sigma P+ - R / T,   R >= 0                 energy reservoir: only wake energy can return
in the frame of the water. The water is therefore passive up to the reservoir, and outside the range only the strips act.
The range of a link depends on its motion and that of the link before it, xi = [u_i, u_i-1 | w_i, w_i-1, Omega_i L_i] / V_i.

The memory is flat, WAKES + 2 scalars or arrays of one batch shape: wake states, R [J], and the number of steps with a moving link
outside the range. `inner`: other hooks for the same fish, which act first.
"""

import hashlib
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.water import residual_network, residual_step
from fishmj.water.dynamics import planar_chain, strip_forces

ETA, STORED = 0.3, 1.0  # eta, share of the dissipated power that enters the reservoir; T, its time constant, s
TINY, MOST = 1e-6, 1e6  # W, power that is always allowed; bound on the ratio in sigma, so that its fourth power stays finite
FADE = 0.85  # the force fades from this share of the limit on, and is zero beyond the limit
EVEN, SEEN = 2, 5  # number of even features (under the mirror symmetry) of a link's range, which come first; of all


class MotionRange(NamedTuple):
    """Range of motion in which the residual was fitted, for N links; see `inside`."""

    centre: Any  # (N, 5) of xi, odd features 0
    whiten: Any  # (N, 5, 5) with |whiten (xi - centre)| = Mahalanobis distance
    limit: Any  # (N,) of it
    speed: Any  # (N,) highest V, m/s
    spread: Any  # () spread of the members' coefficients at which the force is halved


class Residual(NamedTuple):
    """Weights of the residual, and the range of its fit."""

    net: residual_network.Net
    reach: MotionRange | None  # None: no limit


def at_rest() -> list:
    """The memory of a fish in still water."""
    return [0.0] * (residual_network.WAKES + 2)


def near(xp, p: residual_network.Panels, k: planar_chain.Links, m: residual_network.MotionFeatures) -> tuple[list, list]:
    """Features xi of every link, N lists of 5, and speeds V_i, m/s, on which the range depends."""
    xi, speed = [], [xp.sqrt(square + residual_network.FLOOR**2) for square in m.square]
    for i, v in enumerate(speed):
        j = max(i - 1, 0)
        xi.append([value / v for value in (k.u[i], k.u[j], m.middle[i], m.middle[j], k.omega[i] * p.length[i])])
    return xi, speed


def inside(xp, r: MotionRange, xi: list, speed, i: int):
    """Factor, 1 well inside the fitted range of link i and 0 outside, and distance of its motion (1 at the limit)."""
    off = [xi[c] - r.centre[i][c] for c in range(SEEN)]
    distance: Any = 0.0
    for row in range(SEEN):
        block = range(EVEN) if row < EVEN else range(EVEN, SEEN)
        part = sum(r.whiten[i][row][c] * off[c] for c in block)
        distance = distance + part * part
    distance = distance / (r.limit[i] * r.limit[i])
    fast = speed / r.speed[i]
    far = xp.maximum(distance, fast * fast)  # squares
    fade = xp.minimum(xp.maximum((1.0 - far) / (1.0 - FADE**2), 0.0), 1.0)
    return fade, far


_panels = lru_cache(8)(residual_network.panels)  # cached, because every step needs it


def either(xp, there, one, other):
    """Elementwise `where` for nested lists of arrays: `one` where `there` is true, else `other`."""
    if isinstance(one, list | tuple):
        return [either(xp, there, a, b) for a, b in zip(one, other, strict=True)]
    return xp.where(there, one, other)


class LearnedResidual:
    """Hooks that add a residual.

    Args:
        ch: the chain whose links the residual was fitted for.
        learnt: the residual; several, from which `Swimmer.net` selects; or a function that selects one.
        memory: flat list, which begins with that of `inner`.
        inner: other hooks, such as `hooks.Effects`.
    """

    def __init__(self, xp, ch: planar_chain.Chain, learnt: Any, memory, inner: Any = None):
        self.xp, self.learnt, self.inner, self.panels = xp, learnt, inner, _panels(ch)
        *self.z, self.store, self.guarded = list(memory)[-(residual_network.WAKES + 2) :]
        self.forces: list = []
        self.spread: Any = 0.0  # variance between the members' coefficients

    def fish(self, ch, sw):
        """Chain and swimmer, as `inner` changes them."""
        return (ch, sw) if self.inner is None else self.inner.fish(ch, sw)

    def flow(self, ch, q, flow):
        """Water velocity at each link, as `inner` changes it."""
        return flow if self.inner is None else self.inner.flow(ch, q, flow)

    def servos(self, ch, sw, q, v, target):
        """Drive torque (N m) and damping beyond back-EMF (N m s/rad) of each joint."""
        if self.inner is None:
            return planar_chain.servo_drive(self.xp, ch, sw, q, v, target), [0.0] * (ch.n - 1)
        return self.inner.servos(ch, sw, q, v, target)

    def water(self, ch, sw, q, k, hydro):
        """Forces of the water on each link (N, N, N m), with the residual added."""
        hydro = hydro if self.inner is None else self.inner.water(ch, sw, q, k, hydro)
        self.forces = self.advance(ch.strips, sw.water, k, ch.dt, sw.net)
        return [tuple(a + b for a, b in zip(f, g, strict=True)) for f, g in zip(hydro, self.forces, strict=True)]

    def body(self, ch, sw, q, k, rhs, m) -> None:
        """Adds the forces and masses of `inner`; the residual adds none."""
        if self.inner is not None:
            self.inner.body(ch, sw, q, k, rhs, m)

    def end(self, ch, sw, v, drive):
        """Memory for the next step: `inner`'s, wake states, reservoir and the counter of steps outside the range."""
        first = () if self.inner is None else tuple(self.inner.end(ch, sw, v, drive))
        return (*first, *self.z, self.store, self.guarded)

    def advance(
        self, s: strip_forces.Strips, c: strip_forces.Coefficients, k: planar_chain.Links, dt: float, net: Any = 0
    ) -> list:
        """Forces (F_t, F_n, moment) on the links with the present wake; then advances the wake by dt. net: as `Swimmer.net`."""
        xp, p = self.xp, self.panels
        k = batched(k)
        m = residual_network.motion(xp, p, k)
        z = [value + 0.0 * m.speed for value in self.z]
        mean, self.spread, wake, gamma, outside = self._own(net, lambda learnt: self._faded(learnt, k, m, z, dt))
        gamma = gamma * c.residual
        forces = [residual_network.load(p, s.rho, m, i, [gamma * mean[c][i] for c in range(3)]) for i in range(len(k.u))]
        scale, self.store = bounded(xp, forces, residual_network.dissipated(xp, s, c, k), k, self.store, dt)
        self.z, self.guarded = wake, self.guarded + outside
        return [tuple(scale * value for value in f) for f in forces]

    def network(self, learnt: Residual, m: residual_network.MotionFeatures, z: list, dt: float) -> tuple:
        """Mean coefficients of the members (3, N, ..), their variance, and the wake states dt later."""
        return residual_step.mean_step(self.xp, learnt.net, m, z, dt)

    def _own(self, net, of: Any):
        """Applies `of` to each fish's residual."""
        if isinstance(self.learnt, Residual):
            return of(self.learnt)
        if callable(self.learnt):
            return self.learnt(net, of)
        if self.xp is np and np.ndim(net) == 0:
            return of(self.learnt[int(net)])
        made = of(self.learnt[0])
        for number, learnt in enumerate(self.learnt[1:], 1):
            made = either(self.xp, net == number, of(learnt), made)
        return made

    def _faded(self, learnt: Residual, k: planar_chain.Links, m: residual_network.MotionFeatures, z: list, dt: float) -> tuple:
        """Mean coefficients, variance, wake dt later; gamma / r; 1 if a moving link is outside the range."""
        mean, spread, wake = self.network(learnt, m, z, dt)
        if learnt.reach is None:
            return mean, spread, wake, 1.0, 0.0
        fade, outside = self._inside(learnt.reach, k, m)
        return mean, spread, wake, fade / (1.0 + spread / learnt.reach.spread**2), outside

    def _inside(self, reach: MotionRange, k: planar_chain.Links, m: residual_network.MotionFeatures):
        """Fade factor of the whole fish, and 1 if a moving link is outside the range."""
        xp, (xi, speed) = self.xp, near(self.xp, self.panels, k, m)
        fade: Any = 1.0
        outside: Any = 0.0
        for i in range(len(xi)):
            one, far = inside(xp, reach, xi[i], speed[i], i)
            fade = xp.minimum(fade, one)
            outside = xp.maximum(outside, xp.where((m.square[i] > residual_network.FLOOR**2) & (far > 1.0), 1.0, 0.0))
        return fade, outside


def bounded(xp, forces: list, taken, k: planar_chain.Links, store, dt: float):
    """Factor sigma, which keeps the power of all forces below eta D + R / T, and the reservoir dt later."""
    power: Any = 0.0
    for i, (ft, fn, moment) in enumerate(forces):
        power = power + ft * k.u[i] + fn * k.w[i] + moment * k.omega[i]
    gain, cap = xp.maximum(power, 0.0), ETA * taken + store / STORED
    ratio = xp.minimum(gain / (cap + TINY), MOST)
    square = ratio * ratio
    scale = 1.0 / xp.sqrt(xp.sqrt(1.0 + square * square))
    return scale, xp.maximum(store + dt * (ETA * taken - scale * gain - store / STORED), 0.0)


def batched(k: planar_chain.Links) -> planar_chain.Links:
    """Kinematics with all velocities broadcast to the full batch shape."""
    zero = 0.0 * (k.u[-1] + k.w[-1] + k.omega[-1])
    whole = lambda values: [value + zero for value in values]
    return k._replace(u=whole(k.u), w=whole(k.w), omega=whole(k.omega))


def member(learnt: Residual, e: int) -> Residual:
    """Ensemble in which every member is member e, in arrays of the same shapes."""
    net = learnt.net
    alike = {name: np.repeat(np.asarray(getattr(net, name))[e : e + 1], net.members, 0) for name in residual_network.MEMBERS}
    return learnt._replace(net=net._replace(**alike))


def packed(learnt: Residual) -> dict[str, np.ndarray]:
    """A residual with a range as named arrays, for a file."""
    if learnt.reach is None:
        raise ConfigError("a residual without a range is for training only; expected one with a MotionRange")
    parts: dict[str, Any] = {"net": learnt.net, "range": learnt.reach}
    return {f"{part}.{key}": np.asarray(value) for part, fields in parts.items() for key, value in fields._asdict().items()}


def sha256(learnt: Residual) -> str:
    """Hex digest of the weights and the range, in single precision as a file holds them."""
    digest = hashlib.sha256()
    for key, value in sorted(packed(learnt).items()):
        digest.update(key.encode() + np.ascontiguousarray(value, np.float32).tobytes())
    return digest.hexdigest()


def unpacked(arrays: dict) -> Residual:
    """Inverse of `packed`; further arrays are ignored. Raises KeyError if one is missing."""
    net = residual_network.Net(*(arrays[f"net.{key}"] for key in residual_network.Net._fields))
    return Residual(net, MotionRange(*(arrays[f"range.{key}"] for key in MotionRange._fields)))


def unlimited(links: int) -> MotionRange:
    """Range without limits on motion and spread, for fitting."""
    return MotionRange(
        np.zeros((links, 5)), np.tile(np.eye(5), (links, 1, 1)), np.full(links, 1e6), np.full(links, 1e6), np.array(1e6)
    )


SHARE, MARGIN = 0.999, 1.15  # share of the data inside a range, and margin factor on its limits


def fitted(xi: np.ndarray, speed: np.ndarray, spread: float) -> MotionRange:
    """Range that contains `SHARE` of the data, with limits of distance and speed enlarged by `MARGIN`.

    Args:
        xi: (M, N, 5) features. speed: (M, N) V, m/s.
        spread: spread of the members' coefficients at which the force is halved.
    """
    links = xi.shape[1]
    centre, whiten = np.zeros((links, SEEN)), np.zeros((links, SEEN, SEEN))
    for i in range(links):
        centre[i, :EVEN] = xi[:, i, :EVEN].mean(0)
        off = xi[:, i] - centre[i]  # odd features have mean 0 by symmetry
        for block in (slice(0, EVEN), slice(EVEN, SEEN)):
            part = off[:, block]
            cov = part.T @ part / len(part)
            cov += 1e-4 * np.eye(len(cov)) * max(np.trace(cov) / len(cov), 1e-6)
            whiten[i, block, block] = np.linalg.inv(np.linalg.cholesky(cov))
    none = np.zeros(links)
    return widened(MotionRange(centre, whiten, none, none, np.array(float(spread))), xi, speed)


def widened(r: MotionRange, xi: np.ndarray, speed: np.ndarray) -> MotionRange:
    """Range, widened to contain these data; arguments as in `fitted`."""
    off = np.einsum("mic,idc->mid", xi - r.centre, r.whiten)
    limit = MARGIN * np.quantile(np.linalg.norm(off, axis=2), SHARE, axis=0)
    return r._replace(limit=np.maximum(r.limit, limit), speed=np.maximum(r.speed, MARGIN * np.quantile(speed, SHARE, axis=0)))
