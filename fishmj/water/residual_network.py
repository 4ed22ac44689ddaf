"""What the strips leave out, learnt: a bounded force on every link from what all links do, with a few wake states.

For N links with velocity u, w (at the middle of the link's strips) through the water, yaw rate Omega, side area A, length L,
    Vb_i^2 = <u^2 + (w0 + Omega x)^2>  over strips     Vb^2 = sum A_i Vb_i^2 / sum A     V^2 = Vb^2 + 0.05^2
    x  = [u_1 .. u_N, V^2 / (V + 0.2) | w_1 .. w_N, Omega_1 L_1 .. Omega_N L_N] / V          even | odd under a mirror S
    z' = (V / l) (zeta - z),     zeta = 1/2 [phi(x, z) + S phi(S x, S z)]                     l: a learnt length a state, m
    g  = c tanh(G / c),          G    = 1/2 [N(x, z) + S N(S x, S z)] + P (x x^T)
    f_i = 1/2 rho A_i 1/2 (Vb_i^2 + Vb^2) [1, 1, L_i] g_i                                     F_t, F_n, couple about the middle
    phi = tanh(B s + b),         N    = D tanh(A s + a) + d
P holds the products of two features that mirror as the force does: in a frictionless fluid all forces of steady motion are such
products (Lamb 1932, ch. VI), within a link and between links, so that water turned at a joint needs no hidden unit.

Only velocities relative to the water in link axes enter, so the force is Galilean and rotation invariant; both branches of
the mirror are run, so it mirrors to round-off; it grows with speed squared, is bounded by c, and is zero at rest. N has E
members (an ensemble); phi and P are shared by them. The wake is advanced exactly over a step with frozen speed.
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.dynamics import strip_forces
from fishmj.dynamics.planar_chain import Chain, Links

FLOOR, HALF = 0.05, 0.2  # m/s, inside features only
WAKES = 16  # states, the first half even
WAKE = (*[1.0] * (WAKES // 2), *[-1.0] * (WAKES // 2))  # what a mirror makes of them
BOUND = 2.0  # c, of every force coefficient


class Panels(NamedTuple):
    """Each link as one plate, plain floats."""

    middle: tuple  # mean x of its strips, m
    square: tuple  # mean x^2, m2
    area: tuple  # side area, m2
    length: tuple  # m


class Net(NamedTuple):
    """Weights for N links, F = 3 N + 1 features, G = WAKES, E members, H hidden units each; all over [x, z]."""

    reach: Any  # (G,) ln of the lengths l [m]
    wake: Any  # (G, F + G)
    wake_bias: Any  # (G,)
    inner: Any  # (E, H, F + G)
    inner_bias: Any  # (E, H)
    outer: Any  # (E, 3 N, H): F_t of every link, then F_n, then the couple
    outer_bias: Any  # (E, 3 N)
    even: Any  # (N, products that a mirror leaves alone)
    odd: Any  # (2 N, products that it turns)

    @property
    def members(self) -> int:
        return self.inner.shape[0]


MEMBERS = ("inner", "inner_bias", "outer", "outer_bias")  # what each member has for itself


class Motion(NamedTuple):
    """One instant, component lists."""

    x: list  # F features
    speed: Any  # V, m/s
    push: list  # N of 1/2 (Vb_i^2 + Vb^2), m2/s2
    square: list  # N of Vb_i^2, m2/s2
    middle: list  # N of w at the middle of the strips, m/s


def panels(ch: Chain) -> Panels:
    """The plates of a chain."""
    rows = [(np.array(x), np.array(h)) for x, h in zip(ch.strips.x, ch.strips.h, strict=True)]
    ends = [*ch.d, ch.strips.tail_x]
    spacing = [abs(x[1] - x[0]) if len(x) > 1 else 2 * abs(x[0] - end) for (x, _), end in zip(rows, ends, strict=True)]
    return Panels(
        middle=tuple(float(x.mean()) for x, _ in rows),
        square=tuple(float((x * x).mean()) for x, _ in rows),
        area=tuple(float(h.sum()) for _, h in rows),
        length=tuple(float(s * len(x)) for s, (x, _) in zip(spacing, rows, strict=True)),
    )


def products(links: int) -> tuple[tuple, tuple]:
    """Pairs of features whose product is even, and odd, under a mirror: two pairs of index arrays."""
    i, j = np.triu_indices(3 * links + 1)
    alike = (i <= links) == (j <= links)
    return (i[alike], j[alike]), (i[~alike], j[~alike])


def blank(links: int, members: int = 5, hidden: int = 16, seed: int = 0) -> Net:
    """Small random inner weights and zero outer ones: a net that adds no force, ready to learn (NumPy, float64)."""
    rng = np.random.default_rng([31, seed])
    draw = lambda *shape: rng.normal(0, 1 / np.sqrt(shape[-1]), shape)
    seen = 3 * links + 1 + WAKES
    even, odd = (len(pair[0]) for pair in products(links))
    return Net(
        reach=np.log(np.tile(np.geomspace(0.03, 0.6, WAKES // 2), 2)),
        wake=draw(WAKES, seen),
        wake_bias=np.zeros(WAKES),
        inner=draw(members, hidden, seen),
        inner_bias=np.zeros((members, hidden)),
        outer=np.zeros((members, 3 * links, hidden)),
        outer_bias=np.zeros((members, 3 * links)),
        even=np.zeros((links, even)),
        odd=np.zeros((2 * links, odd)),
    )


def without(net: Net, *, memory: bool = True, products: bool = True) -> Net:
    """The net with a wake that stays at rest, or no products, for comparison."""
    off = [*([] if memory else ["wake", "wake_bias"]), *([] if products else ["even", "odd"])]
    return net._replace(**{name: 0.0 * getattr(net, name) for name in off})


def motion(xp, p: Panels, k: Links) -> Motion:
    """Features from the kinematics of the links."""
    n, area = len(p.area), sum(p.area)
    middle = [k.w[i] + k.omega[i] * p.middle[i] for i in range(n)]
    square = [
        k.u[i] * k.u[i] + k.w[i] * k.w[i] + k.omega[i] * (2 * p.middle[i] * k.w[i] + p.square[i] * k.omega[i]) for i in range(n)
    ]
    square = [xp.maximum(s, 0.0) for s in square]
    # V is of the whole fish: a link at rest still lies in water that the others move
    whole = sum(a / area * s for a, s in zip(p.area, square, strict=True))
    speed = xp.sqrt(whole + FLOOR**2)
    # features are divided by V, so forces scale with speed squared; the one feature that is left tells fast from slow, saturating
    even = [*k.u, speed * speed / (speed + HALF)]
    odd = [*middle, *(k.omega[i] * p.length[i] for i in range(n))]
    return Motion([value / speed for value in (*even, *odd)], speed, [0.5 * (s + whole) for s in square], square, middle)


def wake_step(xp, net: Net, m: Motion, z: list, dt: float) -> list:
    """Wake states dt later, from z: lists of `WAKES`."""
    both, shape, _ = _branches(xp, m.x, z)
    # the mirrored input through the same weights, averaged with its signs: the symmetry holds exactly, whatever was learnt
    out = xp.tanh(net.wake @ both.reshape(len(both), -1) + net.wake_bias[:, None]).reshape(len(z), 2, -1)
    signs = np.array(WAKE, dtype=out.dtype)[:, None]
    target, before = 0.5 * (out[:, 0] + signs * out[:, 1]), both[len(m.x) :, 0]
    # exact for constant V: stable for any learnt length and step, and of frozen motion the same wake at 4 ms as at 20 ms
    # a constant's own exp is NumPy's: JAX keeps jnp.exp of one in single precision for a later program in double
    own = np if isinstance(net.reach, np.ndarray) else xp
    decay = xp.exp(-dt * xp.reshape(m.speed, (1, -1)) / own.exp(net.reach)[:, None])
    return list((target + (before - target) * decay).reshape(len(z), *shape))


def coefficients(xp, net: Net, m: Motion, z: list):
    """Force coefficients g of every member, (E, 3, N, ..): F_t, F_n, couple of every link."""
    both, shape, links = _branches(xp, m.x, z)
    members, units, _ = net.inner.shape
    hidden = (net.inner.reshape(members * units, -1) @ both.reshape(len(both), -1)).reshape(members, units, -1)
    hidden = xp.tanh(hidden + net.inner_bias[:, :, None])
    out = (net.outer @ hidden + net.outer_bias[:, :, None]).reshape(members, 3 * links, 2, -1)
    signs = np.array([1.0] * links + [-1.0] * (2 * links), dtype=out.dtype)[:, None]
    x = both[: len(m.x), 0]
    # potential-flow forces are such products: given as they are, hidden units are left for what is not potential
    pairs = [weights @ (x[i] * x[j]) for weights, (i, j) in zip((net.even, net.odd), products(links), strict=True)]
    whole = 0.5 * (out[:, :, 0] + signs * out[:, :, 1]) + xp.concatenate(pairs)
    # bounded smoothly: a clip has no gradient, and a motion outside the data must not make a large force
    return (BOUND * xp.tanh(whole / BOUND)).reshape(members, 3, links, *shape)


def load(p: Panels, rho: float, m: Motion, i: int, g) -> tuple:
    """(F_t, F_n, moment about the link's origin) of link i from its three coefficients."""
    push = 0.5 * rho * p.area[i] * m.push[i]
    normal = push * g[1]
    return push * g[0], normal, p.middle[i] * normal + p.length[i] * push * g[2]


def dissipated(xp, s: strip_forces.Strips, c: strip_forces.Coefficients, k: Links):
    """Power that drag and friction take from the motion relative to the water, W; never negative."""
    total: Any = 0.0
    for i in range(len(s.mu)):
        ft, fn, moment = strip_forces.resistive(xp, s, c, i, k.u[i], k.w[i], k.omega[i])
        total = total - (ft * k.u[i] + fn * k.w[i] + moment * k.omega[i])
    return total - strip_forces.head_form(xp, s, c, k.u[0]) * k.u[0]


def _branches(xp, x: list, z: list):
    """(F + G, 2, B) with the mirrored inputs beside the true ones, the batch shape, and the number of links."""
    links = (len(x) - 1) // 3
    rows = xp.stack([*x, *z])
    shape = rows.shape[1:]
    rows = rows.reshape(len(rows), 1, -1)
    signs = np.array([*[1.0] * (links + 1), *[-1.0] * (2 * links), *WAKE], dtype=rows.dtype).reshape(-1, 1, 1)
    return xp.concatenate([rows, signs * rows], 1), shape, links
