"""Learnt residual force: a bounded force on every link from the motion of all links, with a few wake states.

For N links with velocity u, w (at the middle of the link's strips) through the water, yaw rate Omega, side area A, length L,
    Vb_i^2 = <u^2 + (w0 + Omega x)^2>  over strips     Vb^2 = sum A_i Vb_i^2 / sum A     V^2 = Vb^2 + 0.05^2
    x  = [u_1 .. u_N, V^2 / (V + 0.2) | w_1 .. w_N, Omega_1 L_1 .. Omega_N L_N] / V          even | odd under a mirror S
    z' = (V / l) (zeta - z),     zeta = 1/2 [phi(x, z) + S phi(S x, S z)]                     l: a learnt length a state, m
    g  = c tanh(G / c),          G    = 1/2 [N(x, z) + S N(S x, S z)] + P (x x^T)
    f_i = 1/2 rho A_i 1/2 (Vb_i^2 + Vb^2) [1, 1, L_i] g_i                                     F_t, F_n, couple about the middle
    phi = tanh(B s + b),         N    = D tanh(A s + a) + d
P holds the products of two features that mirror as the force does. In a frictionless fluid all forces of steady motion are such
products (Lamb 1932, ch. VI), within a link and between links, so that hidden units need not represent them.

The inputs are velocities relative to the water in link axes, so the force is Galilean and rotation invariant. The average over
both branches of the mirror makes the symmetry exact, to the bit. The force grows with speed squared, its coefficients are bounded
by c, and it is zero at rest. N is an ensemble of E members, which share phi and P. The wake is integrated exactly for constant
speed over a step.

With s = [x, z] = [e; o], even and odd, the products of one branch give both: A s = A_e e + A_o o = p + q, A S s = p - q. In D,
h+ + h- multiplies the rows of F_t only, and h+ - h- those of F_n and the couple, whose bias d cancels. See `Halves`.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fishmj.water.dynamics import strip_forces
from fishmj.water.dynamics.planar_chain import Chain, Links

FLOOR, HALF = 0.05, 0.2  # m/s, in the features only
WAKES = 16  # number of wake states, the first half even
WAKE = (*[1.0] * (WAKES // 2), *[-1.0] * (WAKES // 2))  # their signs under the mirror symmetry
BOUND = 2.0  # c, of every force coefficient


class Panels(NamedTuple):
    """Links as plates, plain floats."""

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
    even: Any  # (N, number of even products)
    odd: Any  # (2 N, number of odd products)

    @property
    def members(self) -> int:
        """Number of members of the ensemble."""
        return self.inner.shape[0]


MEMBERS = ("inner", "inner_bias", "outer", "outer_bias")  # weights that differ between members


class MotionFeatures(NamedTuple):
    """Features and speeds at one instant, component lists."""

    x: list  # F features
    speed: Any  # V, m/s
    push: list  # N of 1/2 (Vb_i^2 + Vb^2), m2/s2
    square: list  # N of Vb_i^2, m2/s2
    middle: list  # N of w at the middle of the strips, m/s


@lru_cache(8)
def panels(ch: Chain) -> Panels:
    """Plates of a chain."""
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
    """Initial net with small random inner and zero outer weights, which adds no force (NumPy, float64)."""
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
    """Net with a wake that stays at rest, or without products, for ablations."""
    off = [*([] if memory else ["wake", "wake_bias"]), *([] if products else ["even", "odd"])]
    return net._replace(**{name: 0.0 * getattr(net, name) for name in off})


def motion(xp, p: Panels, k: Links) -> MotionFeatures:
    """Features from the kinematics of the links."""
    n, area = len(p.area), sum(p.area)
    middle = [k.w[i] + k.omega[i] * p.middle[i] for i in range(n)]
    square = [
        k.u[i] * k.u[i] + k.w[i] * k.w[i] + k.omega[i] * (2 * p.middle[i] * k.w[i] + p.square[i] * k.omega[i]) for i in range(n)
    ]
    square = [xp.maximum(s, 0.0) for s in square]
    # V is that of the whole fish, because a link at rest is in water that the others move
    whole = sum(a / area * s for a, s in zip(p.area, square, strict=True))
    speed = xp.sqrt(whole + FLOOR**2)
    # dividing features by V makes forces scale with speed squared; one saturating feature still encodes the speed
    even = [*k.u, speed * speed / (speed + HALF)]
    odd = [*middle, *(k.omega[i] * p.length[i] for i in range(n))]
    return MotionFeatures([value / speed for value in (*even, *odd)], speed, [0.5 * (s + whole) for s in square], square, middle)


class Halves(NamedTuple):
    """Weights of a `Net`, split by the parity of their inputs under the mirror. M = E H + G rows, those of N first."""

    even: Any  # (M, number of even features and wake states)
    odd: Any  # (M, number of odd ones)
    bias: Any  # (M, 1)
    forward: Any  # (E, N, H), half the weights of F_t
    forward_bias: Any  # (E, N, 1)
    aside: Any  # (E, 2 N, H), half the weights of F_n and the couple
    squares: Any  # (N, number of even products)
    crossed: Any  # (2 N, number of odd products)
    length: Any  # (G, 1) l, m


def halves(xp, net: "Net | Halves") -> Halves:
    """Weights split by parity; the result for the last NumPy net is cached. `Halves` are returned unchanged."""
    global _sorted
    if isinstance(net, Halves):
        return net
    known = all(isinstance(part, np.ndarray) for part in net)
    if known:
        xp, before = np, _sorted  # read once, because another thread may replace it
        if before[0] is net:
            return before[1]
    links, (members, units) = len(net.even), net.inner.shape[:2]
    whole = xp.concatenate([xp.reshape(net.inner, (members * units, -1)), net.wake])
    bias = xp.concatenate([xp.reshape(net.inner_bias, -1), net.wake_bias])[:, None]
    ends = 0, links + 1, 3 * links + 1, 3 * links + 1 + WAKES // 2, 3 * links + 1 + WAKES
    x_even, x_odd, z_even, z_odd = (whole[:, a:b] for a, b in pairwise(ends))
    made = Halves(
        even=xp.concatenate([x_even, z_even], 1),
        odd=xp.concatenate([x_odd, z_odd], 1),
        bias=bias,
        # factor 1/2 of the mean over both branches; the bias of odd outputs is equal in both and cancels
        forward=0.5 * net.outer[:, :links],
        forward_bias=net.outer_bias[:, :links, None],
        aside=0.5 * net.outer[:, links:],
        squares=net.even,
        crossed=net.odd,
        length=xp.exp(net.reach)[:, None],
    )
    if known:
        _sorted = net, made
    return made


_sorted: tuple[Any, Any] = (None, None)  # the last net in NumPy arrays and its halves


def wake_step(xp, net: "Net | Halves", m: MotionFeatures, z: list, dt: float) -> list:
    """Wake states dt later, from z: lists of `WAKES`."""
    weights, rows = _prepared(xp, net, m, z)
    units = len(weights.bias) - WAKES
    only = weights._replace(even=weights.even[units:], odd=weights.odd[units:], bias=weights.bias[units:])
    return _next_wake(xp, weights, rows, _hidden(xp, only, rows), m, dt)


def coefficients(xp, net: "Net | Halves", m: MotionFeatures, z: list):
    """Force coefficients g of every member, (E, 3, N, ..): F_t, F_n, couple of every link."""
    weights, rows = _prepared(xp, net, m, z)
    units = len(weights.bias) - WAKES
    only = weights._replace(even=weights.even[:units], odd=weights.odd[:units], bias=weights.bias[:units])
    return _bounded(xp, weights, rows, _hidden(xp, only, rows))


def step(xp, net: "Net | Halves", m: MotionFeatures, z: list, dt: float) -> tuple[Any, list]:
    """Computes `coefficients` and `wake_step` of one instant in one pass of the input through the weights."""
    weights, rows = _prepared(xp, net, m, z)
    units, (plus, minus) = len(weights.bias) - WAKES, _hidden(xp, weights, rows)
    g = _bounded(xp, weights, rows, (plus[:units], minus[:units]))
    return g, _next_wake(xp, weights, rows, (plus[units:], minus[units:]), m, dt)


def load(p: Panels, rho: float, m: MotionFeatures, i: int, g) -> tuple:
    """(F_t, F_n, moment about the link's origin) of link i from its three coefficients."""
    push = 0.5 * rho * p.area[i] * m.push[i]
    normal = push * g[1]
    return push * g[0], normal, p.middle[i] * normal + p.length[i] * push * g[2]


def dissipated(xp, s: strip_forces.Strips, c: strip_forces.Coefficients, k: Links):
    """Power dissipated by drag and friction, in the frame of the water, W; never negative."""
    total: Any = 0.0
    for i in range(len(s.mu)):
        ft, fn, moment = strip_forces.resistive(xp, s, c, i, k.u[i], k.w[i], k.omega[i])
        total = total - (ft * k.u[i] + fn * k.w[i] + moment * k.omega[i])
    return total - strip_forces.head_form(xp, s, c, k.u[0]) * k.u[0]


def mean_by_products(xp, net: "Net | Halves", m: MotionFeatures, z: list, dt: float) -> tuple:
    """Mean of the members' coefficients, 3 lists of N; the variance between them (..); wake states dt later."""
    g, z = step(xp, net, m, z, dt)
    mean = g.mean(0)
    apart = 0.0 * mean[0, 0] if len(g) == 1 else ((g - mean) ** 2).sum(0).mean((0, 1)) / (len(g) - 1)
    return [list(row) for row in mean], apart, z


PRECISION = "highest"  # of matrix products in JAX


class ParityInput(NamedTuple):
    """Inputs at one instant, split by parity, and the shape of the batch."""

    even: Any  # (N + 1 + G / 2, B)
    odd: Any  # (2 N + G / 2, B)
    shape: tuple


def rows_of(xp, x: list, z: list) -> ParityInput:
    """Features and wake states by parity."""
    links, half = (len(x) - 1) // 3, WAKES // 2
    even, odd = xp.stack([*x[: links + 1], *z[:half]]), xp.stack([*x[links + 1 :], *z[half:]])
    return ParityInput(xp.reshape(even, (len(even), -1)), xp.reshape(odd, (len(odd), -1)), even.shape[1:])


def _prepared(xp, net: "Net | Halves", m: MotionFeatures, z: list) -> tuple[Halves, ParityInput]:
    """Weights and inputs of one instant; in JAX the weights get the precision of the inputs."""
    weights, rows = halves(xp, net), rows_of(xp, m.x, z)
    return weights if xp is np else Halves._make(xp.asarray(part, rows.even.dtype) for part in weights), rows


def _hidden(xp, weights: Halves, rows: ParityInput) -> tuple:
    """tanh of both branches, (M, B) each.

    A mirrored input differs only in the sign of its odd half: A S s = A_e e - A_o o. Both branches are therefore the sum and
    difference of the same two products, and a mirrored input exchanges them, to the bit.
    """
    p, q = _matmul(xp, weights.even, rows.even) + weights.bias, _matmul(xp, weights.odd, rows.odd)
    return xp.tanh(p + q), xp.tanh(p - q)


def _bounded(xp, weights: Halves, rows: ParityInput, hidden: tuple):
    """Bounded coefficients (E, 3, N, ..) from the hidden units of N."""
    members, links, units = weights.forward.shape
    plus, minus = (xp.reshape(branch, (members, units, -1)) for branch in hidden)
    e, o = rows.even[: links + 1], rows.odd[: 2 * links]
    # potential-flow forces are such products; with them the hidden units need only represent the other forces
    squares = xp.concatenate([part[i] * part[i:] for part in (e, o) for i in range(len(part))])
    crossed = xp.reshape(e[:, None] * o, (len(e) * len(o), -1))
    forward = _matmul(xp, weights.forward, plus + minus) + weights.forward_bias + _matmul(xp, weights.squares, squares)
    aside = _matmul(xp, weights.aside, plus - minus) + _matmul(xp, weights.crossed, crossed)
    # a smooth bound limits forces outside the data; a clip would have no gradient
    g = BOUND * xp.tanh(xp.concatenate([forward, aside], 1) / BOUND)
    return xp.reshape(g, (members, 3, links, *rows.shape))


def _next_wake(xp, weights: Halves, rows: ParityInput, hidden: tuple, m: MotionFeatures, dt: float) -> list:
    """Wake dt later from its hidden units."""
    plus, minus = hidden
    half = WAKES // 2
    target = 0.5 * xp.concatenate([plus[:half] + minus[:half], plus[half:] - minus[half:]])
    before = xp.concatenate([rows.even[-half:], rows.odd[-half:]])
    # exact for constant V, so stable for any learnt length, and independent of the step size for steady motion
    decay = xp.exp(-dt * xp.reshape(m.speed, (1, -1)) / weights.length)
    return list(xp.reshape(target + (before - target) * decay, (WAKES, *rows.shape)))


def _matmul(xp, a, b):
    """Product a @ b in full precision; by default JAX on a GPU rounds float32 operands to a ten-bit mantissa (TF32)."""
    return a @ b if xp is np else xp.matmul(a, b, precision=PRECISION)
