"""What the strips leave out, learnt: a bounded force on every link with a few wake states.

For link i with origin velocity u, w0 through its water, yaw rate Omega, strips at x, side area A, length L,
    w = w0 + Omega <x>     Vb^2 = <u^2 + (w0 + Omega x)^2>     V^2 = Vb^2 + 0.05^2
    xi_i = [u_i, u_i-1 | w_i, w_i-1, Omega_i L_i] / V_i                                   even | odd under a mirror
    z_i' = (V_i / l) (zeta_i - z_i),         zeta = 1/2 [phi(xi, z_i-1) + S_z phi(S xi, S_z z_i-1)]        l: 3 lengths, m
    f_i  = 1/2 rho A Vb^2 [1, 1, L] g_i,     g    = 1/2 [N(xi, z_i, z_i-1) + S_f N(S xi, S_z z_i, S_z z_i-1)]
    phi = tanh(C tanh(B s + b_i)),           N    = c tanh((D tanh(A s + a_i) + d_i) / c)                 one pair a link

Only velocities relative to the water in link axes enter, so the force is Galilean and rotation invariant; both branches of
the mirror are run, so it mirrors to round-off; it grows with speed squared, is bounded by c, and is zero at rest. N has E
members (an ensemble), phi is shared by them. The wake is advanced exactly over a step with frozen speed.

Two ways to write the same sums: stacked arrays (NumPy, JAX) and `unrolled` scalars, from which code is generated.
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.hydro_fit import terms
from fishmj.hydro_fit.chain import Chain, Links

FLOOR = 0.05  # m/s, inside features only
EVEN = 2  # leading features that a mirror leaves alone
MIRROR = (1.0, 1.0, -1.0, -1.0, -1.0)  # of xi
WAKE = (1.0, -1.0, -1.0)  # of the wake states of a link
FORCE = (1.0, -1.0, -1.0)  # of (F_t, F_n, couple)
BOUND = 2.0  # c, of every force coefficient


class Panels(NamedTuple):
    """Each link as one plate, plain floats."""

    middle: tuple  # mean x of its strips, m
    square: tuple  # mean x^2, m2
    area: tuple  # side area, m2
    length: tuple  # m


class Net(NamedTuple):
    """Weights for N links, E members, H hidden units, G in the wake; `inner` takes xi, z_i, z_i-1, `wake` xi, z_i-1."""

    reach: Any  # (3,) ln of the lengths l [m]
    wake: Any  # (G, 8)
    wake_bias: Any  # (G, N)
    wake_out: Any  # (3, G)
    inner: Any  # (E, H, 11)
    inner_bias: Any  # (E, H, N)
    outer: Any  # (E, 3, H)
    outer_bias: Any  # (E, 3, N)

    @property
    def members(self) -> int:
        return self.inner.shape[0]


class Motion(NamedTuple):
    """Features of one instant, component lists over N links."""

    xi: list  # N lists of 5
    speed: list  # V, m/s
    square: list  # Vb^2, m2/s2


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


def blank(links: int, members: int = 5, hidden: int = 16, wake: int = 8, seed: int = 0) -> Net:
    """Small random inner weights and zero outer ones: a net that adds no force, ready to learn (NumPy, float64)."""
    rng = np.random.default_rng([31, seed])
    draw = lambda *shape: rng.normal(0, 1 / np.sqrt(shape[-1]), shape)  # noqa: E731
    return Net(
        reach=np.log([0.05, 0.15, 0.4]),
        wake=draw(wake, 8),
        wake_bias=np.zeros((wake, links)),
        wake_out=draw(3, wake),
        inner=draw(members, hidden, 11),
        inner_bias=np.zeros((members, hidden, links)),
        outer=np.zeros((members, 3, hidden)),
        outer_bias=np.zeros((members, 3, links)),
    )


def motion(xp, p: Panels, k: Links) -> Motion:
    """Features from the kinematics of the links."""
    n = len(p.area)
    middle = [k.w[i] + k.omega[i] * p.middle[i] for i in range(n)]
    square = [
        k.u[i] * k.u[i] + k.w[i] * k.w[i] + k.omega[i] * (2 * p.middle[i] * k.w[i] + p.square[i] * k.omega[i]) for i in range(n)
    ]
    square = [xp.maximum(s, 0.0) for s in square]
    speed = [xp.sqrt(s + FLOOR**2) for s in square]
    xi = []
    for i in range(n):
        j = max(i - 1, 0)
        raw = (k.u[i], k.u[j], middle[i], middle[j], k.omega[i] * p.length[i])
        xi.append([value / speed[i] for value in raw])
    return Motion(xi, speed, square)


def wake_step(xp, net: Net, m: Motion, z, dt: float, *, unrolled: bool = False) -> list:
    """Wake states dt later: N lists of 3, from z of the same shape."""
    n = len(m.xi)
    seen = [[*m.xi[i], *(z[i - 1] if i else _nothing(z[0]))] for i in range(n)]
    run = _unrolled_wake if unrolled else _stacked_wake
    target = run(xp, net, seen)
    out = []
    for i in range(n):
        decay = [xp.exp(-dt * m.speed[i] / xp.exp(net.reach[c])) for c in range(3)]
        out.append([target[c][i] + (z[i][c] - target[c][i]) * decay[c] for c in range(3)])
    return out


def coefficients(xp, net: Net, m: Motion, z, *, unrolled: bool = False):
    """Force coefficients g of every member, indexed [member][component][link]."""
    n = len(m.xi)
    seen = [[*m.xi[i], *z[i], *(z[i - 1] if i else _nothing(z[0]))] for i in range(n)]
    return (_unrolled_force if unrolled else _stacked_force)(xp, net, seen)


def load(p: Panels, rho: float, m: Motion, i: int, g) -> tuple:
    """(F_t, F_n, moment about the link's origin) of link i from its three coefficients."""
    push = 0.5 * rho * p.area[i] * m.square[i]
    normal = push * g[1]
    return push * g[0], normal, p.middle[i] * normal + p.length[i] * push * g[2]


def dissipated(xp, s: terms.Strips, c: terms.Coefficients, k: Links):
    """Power that drag and friction take from the motion relative to the water, W; never negative."""
    total: Any = 0.0
    for i in range(len(s.mu)):
        ft, fn, moment = terms.resistive(xp, s, c, i, k.u[i], k.w[i], k.omega[i])
        total = total - (ft * k.u[i] + fn * k.w[i] + moment * k.omega[i])
    return total - terms.head_form(xp, s, c, k.u[0]) * k.u[0]


def _nothing(z) -> list:
    return [0.0 * value for value in z]


def _signs(count: int) -> list:
    return [*MIRROR, *(WAKE * count)]


def _branches(xp, seen: list, count: int):
    """(F, 2, N, B) with the mirrored inputs beside the true ones, and the batch shape."""
    x = xp.stack([xp.stack([row[f] for row in seen]) for f in range(len(seen[0]))])
    shape = x.shape[2:]
    x = x.reshape(x.shape[0], 1, x.shape[1], -1)
    signs = np.array(_signs(count), dtype=x.dtype).reshape(-1, 1, 1, 1)
    return xp.concatenate([x, signs * x], 1), shape


def _stacked_wake(xp, net: Net, seen: list):
    x, shape = _branches(xp, seen, 1)
    size = x.shape[1:]
    hidden = xp.tanh((net.wake @ x.reshape(x.shape[0], -1)).reshape(-1, *size) + net.wake_bias[:, None, :, None])
    out = xp.tanh(net.wake_out @ hidden.reshape(hidden.shape[0], -1)).reshape(3, *size)
    signs = np.array(WAKE, dtype=x.dtype).reshape(3, 1, 1)
    return (0.5 * (out[:, 0] + signs * out[:, 1])).reshape(3, size[1], *shape)


def _stacked_force(xp, net: Net, seen: list):
    x, shape = _branches(xp, seen, 2)
    size, (members, units, _) = x.shape[1:], net.inner.shape
    hidden = (net.inner.reshape(members * units, -1) @ x.reshape(x.shape[0], -1)).reshape(members, units, *size)
    hidden = xp.tanh(hidden + net.inner_bias[:, :, None, :, None])
    out = (net.outer @ hidden.reshape(members, units, -1)).reshape(members, 3, *size) + net.outer_bias[:, :, None, :, None]
    out = BOUND * xp.tanh(out / BOUND)
    signs = np.array(FORCE, dtype=x.dtype).reshape(1, 3, 1, 1)
    return (0.5 * (out[:, :, 0] + signs * out[:, :, 1])).reshape(members, 3, size[1], *shape)


def _tanh(xp, x):
    return 1.0 - 2.0 / (xp.exp(2.0 * x) + 1.0)


def _dense(w, b, x: list) -> list:
    return [sum((float(wi) * xi for wi, xi in zip(row, x, strict=True)), float(bias)) for row, bias in zip(w, b, strict=True)]


def _unrolled_wake(xp, net: Net, seen: list) -> list:
    none, out = np.zeros(3), []
    for i, row in enumerate(seen):
        both = []
        for x in (row, [s * v for s, v in zip(_signs(1), row, strict=True)]):
            hidden = [_tanh(xp, v) for v in _dense(net.wake, net.wake_bias[:, i], x)]
            both.append([_tanh(xp, v) for v in _dense(net.wake_out, none, hidden)])
        out.append([0.5 * (a + s * b) for a, b, s in zip(*both, WAKE, strict=True)])
    return [[row[c] for row in out] for c in range(3)]


def _unrolled_force(xp, net: Net, seen: list) -> list:
    members = []
    for e in range(net.members):
        out = []
        for i, row in enumerate(seen):
            both = []
            for x in (row, [s * v for s, v in zip(_signs(2), row, strict=True)]):
                hidden = [_tanh(xp, v) for v in _dense(net.inner[e], net.inner_bias[e, :, i], x)]
                raw = _dense(net.outer[e], net.outer_bias[e, :, i], hidden)
                both.append([BOUND * _tanh(xp, v / BOUND) for v in raw])
            out.append([0.5 * (a + s * b) for a, b, s in zip(*both, FORCE, strict=True)])
        members.append([[row[c] for row in out] for c in range(3)])
    return members
