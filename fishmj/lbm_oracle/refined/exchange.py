"""What a box of finer cells and the coarse water round it exchange in a step.

Coarse node N covers the fine nodes 2 N and 2 N + 1 of every axis; a fine step takes half the time, so that a lattice unit of
velocity is the same. R is the box of whole coarse cells that are refined; the fine array has a ghost cell more on every side.
From a coarse step to the next, A and B are the fine populations at its start and half-way, d_x = +-1/4 is the place of a child x
in its coarse cell X, and s = 0, 1 counts the fine steps:

    explode    A_i(y) = E_i(y, 0),  B_i(y) = E_i(y - c_i, 1)                     y beside R, y + c_i in R: streamed, not collided
               E_i(w, s) = f_i(X) + [d_w + (2 s - 1) c_i / 4] . grad f_i         w in X; grad f_i by central differences
    coalesce   f_i(X) = mean over the children x of X of [B_i(x + c_i) if x + c_i in R, else A_i(x)]        X in R, X + c_i not
               f_i(X) gains the mean of [B_i(x + c_i) - A_i(x)] over those x with x + c_i in R              X and X + c_i not in R
    restrict   rho, rho u: means of the children,   P_c = mean P_f + rho c_s^2 dev S                        X in R, after the step
    prolong    rho, rho u: linear in the coarse cell, its mean kept,   P_f = P_c - rho c_s^2 dev S          cells new in R

`coalesce` writes into the coarse populations before their step, where the plain kernel of the solver pulls them. Each population
is pulled once, the path of a child in two fine steps is 2 c_i, the coarse one, and the mean of E over the children that enter is
f_i(X): what leaves one level enters the other, mass and momentum to round-off. The second line of `coalesce`: paths that cut an
edge of R. Beside an edge one child in four enters in the first step, and 2 s - 1 is taken less its mean, 1/2.

Nothing is divided by tau - 1, and the eddy viscosity may differ from cell to cell. After the collision the stress is
-2 rho c_s^2 (tau - 1) dt S; with one viscosity on both levels, (tau_f - 1/2) dt_f = (tau_c - 1/2) dt_c, the two differ by
rho c_s^2 S dt_f, and S is known from the velocity. In `explode` and `coalesce` the places do it. f_i of the fine level at x, t
is f_i of the coarse one less (dt_f / 2) D f_i, D = d / d t + c_i . grad, that is its value at x - c_i / 4, up to d / d t. So a
population that enters takes the value (d_w + s c_i / 2) - c_i / 4 from the middle of its cell; what d / d t adds is of opposite
sign in the two steps, and left out. A mean over children is right to second order the other way for the same reason.

Sources: Rohde, Kandhai, Derksen, van den Akker 2006, Int. J. Numer. Methods Fluids 51:439 (volumes, explode and coalesce); Chen,
Filippova, Hoch, Molvig, Shock, Teixeira, Zhang 2006, Physica A 362:158 (conservation). Departures: E is linear in place of
uniform, and paths along edges of R are exact.
"""

import warp as wp

from fishmj.lbm_oracle.fluid.collide import density, momentum, non_equilibrium_stress, reconstruct
from fishmj.lbm_oracle.fluid.lattice import Q, vec6, vec19, wrap
from fishmj.lbm_oracle.fluid.storage import peek, poke

wp.set_module_options({"max_unroll": 0, "enable_backward": False})  # unrolled, they take two minutes to compile

_Q = wp.constant(Q)
UNROLLED = {"max_unroll": 32, "enable_backward": False}  # nineteen loads under way at once
GHOST = 1  # layers of fine cells round R
_CS2 = wp.constant(1.0 / 3.0)


@wp.struct
class Nest:
    """Sizes of the two arrays and of R; `ghost` is 0 on an axis that R fills from end to end."""

    coarse: wp.vec3i  # cells of the coarse array
    fine: wp.vec3i  # cells of the fine array
    size: wp.vec3i  # fine cells of R
    ghost: wp.vec3i
    linear: float  # 1; 0 makes E uniform, to show what that costs


@wp.func
def low_of(s: Nest, origin: wp.array(dtype=int)):
    """World node of R's low corner on the coarse level; `origin` is the fine array's."""
    return wp.vec3i((origin[0] + s.ghost[0]) / 2, (origin[1] + s.ghost[1]) / 2, (origin[2] + s.ghost[2]) / 2)


@wp.func
def place(node: wp.vec3i, n: wp.vec3i):
    """Where a world node is in memory."""
    return (wrap(node[0], n[0]) * n[1] + wrap(node[1], n[1])) * n[2] + wrap(node[2], n[2])


@wp.func
def half(i: int):
    """floor(i / 2) for i >= -4, a fine cell's coarse one."""
    return (i + 4) / 2 - 2


@wp.func
def parent(r: wp.vec3i):
    return wp.vec3i(half(r[0]), half(r[1]), half(r[2]))


@wp.func
def offset(r: wp.vec3i):
    """d of a child, coarse cells."""
    p = parent(r)
    return wp.vec3(0.5 * float(r[0] - 2 * p[0]) - 0.25, 0.5 * float(r[1] - 2 * p[1]) - 0.25, 0.5 * float(r[2] - 2 * p[2]) - 0.25)


@wp.func
def beyond(s: Nest, r: wp.vec3i, axis: int, scale: int):
    """Is r, in cells of size 1 / scale of a coarse one, outside R along an axis that R does not fill?"""
    return s.ghost[axis] > 0 and (r[axis] < 0 or 2 * r[axis] >= scale * s.size[axis])


@wp.func
def within_box(s: Nest, r: wp.vec3i, scale: int):
    return not (beyond(s, r, 0, scale) or beyond(s, r, 1, scale) or beyond(s, r, 2, scale))


@wp.func
def exploded(s: Nest, low: wp.vec3i, f: wp.array(dtype=float), i: int, c: wp.vec3i, w: wp.vec3i, second: float):
    """E_i(w, s) from the coarse populations; `low` is R's corner, w a fine cell counted from there."""
    x = parent(w)
    n = s.coarse
    first = i * n[0] * n[1] * n[2]
    here = peek(f, first + place(low + x, n))
    if s.linear == 0.0:
        return here
    k = 2.0 * second - 1.0
    edges = int(0)  # noqa: UP018  a variable to Warp
    for a in range(3):
        if c[a] != 0 and beyond(s, x, a, 1):
            edges += 1
    if edges == 2:
        k -= 0.5  # beside an edge of R one child in four enters in the first step: the mean over all shall stay f_i(X)
    d = offset(w) + 0.25 * k * wp.vec3(float(c[0]), float(c[1]), float(c[2]))
    value = here
    for a in range(3):
        if d[a] != 0.0:
            step = wp.vec3i(0, 0, 0)
            step[a] = 1
            value += 0.5 * d[a] * (peek(f, first + place(low + x + step, n)) - peek(f, first + place(low + x - step, n)))
    return value


@wp.kernel
def explode(
    s: Nest,
    directions: wp.array(dtype=wp.vec3i),
    ghosts: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=int),
    second: int,
    f: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    f_fine: wp.array(dtype=float),
    u_fine: wp.array(dtype=wp.vec3),
):
    """A population of a ghost cell before the first or the second fine step; with the rest population, the velocity, too."""
    i, cell = wp.tid()
    y, c = ghosts[cell], directions[i]
    enters = within_box(s, y + c, 2)
    if second == 1 and i > 0 and not enters:
        return
    low = low_of(s, origin)
    n, m = s.fine, s.coarse
    here, there = place(2 * low + y, n), place(low + parent(y), m)
    if enters:
        poke(f_fine, i * n[0] * n[1] * n[2] + here, exploded(s, low, f, i, c, y - second * c, float(second)))
    else:  # nobody pulls it: only kept within what water does
        poke(f_fine, i * n[0] * n[1] * n[2] + here, peek(f, i * m[0] * m[1] * m[2] + there))
    if i == 0:  # for the gradients beside it
        node, d = low + parent(y), offset(y)
        value = u[there]
        for a in range(3):
            step = wp.vec3i(0, 0, 0)
            step[a] = 1
            value += 0.5 * d[a] * (u[place(node + step, m)] - u[place(node - step, m)])
        u_fine[here] = value


@wp.kernel
def coalesce(
    s: Nest,
    directions: wp.array(dtype=wp.vec3i),
    shell: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=int),
    f_first: wp.array(dtype=float),
    f_second: wp.array(dtype=float),
    f: wp.array(dtype=float),
):
    """Coarse cells on both sides of R's faces: the populations that the next coarse step pulls out of R, and along its edges."""
    i, cell = wp.tid()
    x, c = shell[cell], directions[i]
    if within_box(s, x + c, 1):
        return
    low = low_of(s, origin)
    n, m = s.fine, s.coarse
    first = i * n[0] * n[1] * n[2]
    inside = within_box(s, x, 1)
    total = float(0.0)  # noqa: UP018
    cut = int(0)  # noqa: UP018
    for child in range(8):
        r = 2 * x + wp.vec3i(child / 4, (child / 2) % 2, child % 2)
        if inside:
            if within_box(s, r + c, 2):
                total += peek(f_second, first + place(2 * low + r + c, n))
            else:
                total += peek(f_first, first + place(2 * low + r, n))
        elif within_box(s, r + c, 2):
            cut += 1
            total += peek(f_second, first + place(2 * low + r + c, n))
            total -= peek(f_first, first + place(2 * low + r, n))
    slot = i * m[0] * m[1] * m[2] + place(low + x, m)
    if inside:
        poke(f, slot, 0.125 * total)
    elif cut > 0:
        poke(f, slot, peek(f, slot) + 0.125 * total)


@wp.func
def loaded(f: wp.array(dtype=float), n: wp.vec3i, here: int):
    q = vec19()
    for i in range(_Q):
        q[i] = peek(f, i * n[0] * n[1] * n[2] + here)
    return q


@wp.func
def stored(f: wp.array(dtype=float), n: wp.vec3i, here: int, q: vec19):
    for i in range(_Q):
        poke(f, i * n[0] * n[1] * n[2] + here, q[i])


@wp.func
def strain(dx: wp.vec3, dy: wp.vec3, dz: wp.vec3):
    """dev S from d u / d x, d y, d z; (xx, yy, zz, xy, xz, yz)."""
    third = (dx[0] + dy[1] + dz[2]) / 3.0
    xy, xz, yz = 0.5 * (dx[1] + dy[0]), 0.5 * (dx[2] + dz[0]), 0.5 * (dy[2] + dz[1])
    return vec6(dx[0] - third, dy[1] - third, dz[2] - third, xy, xz, yz)


@wp.kernel(module="unique", module_options=UNROLLED)
def restrict(
    s: Nest,
    children: int,
    origin: wp.array(dtype=int),
    f_fine: wp.array(dtype=float),
    u_fine: wp.array(dtype=wp.vec3),
    f: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
):
    """The coarse cells of R from their children."""
    i, j, k = wp.tid()
    x = wp.vec3i(i, j, k)
    low = low_of(s, origin)
    drho, m, p, v = float(0.0), wp.vec3(), vec6(), wp.vec3()  # noqa: UP018
    dx, dy, dz = wp.vec3(), wp.vec3(), wp.vec3()
    for child in range(children):  # eight, but the compiler shall not write them out
        a, b, c = child / 4, (child / 2) % 2, child % 2
        here = place(2 * (low + x) + wp.vec3i(a, b, c), s.fine)
        q = loaded(f_fine, s.fine, here)
        rho = density(q)
        flow = momentum(q)
        drho += 0.125 * rho
        m += 0.125 * flow
        p += 0.125 * non_equilibrium_stress(
            q, rho, (1.0 / (1.0 + rho)) * flow
        )  # of each child: not the stress of their differences
        w = u_fine[here]
        v += 0.125 * w
        dx += 0.25 * float(2 * a - 1) * w
        dy += 0.25 * float(2 * b - 1) * w
        dz += 0.25 * float(2 * c - 1) * w
    w = (1.0 / (1.0 + drho)) * m
    p += ((1.0 + drho) * _CS2) * strain(dx, dy, dz)
    here = place(low + x, s.coarse)
    stored(f, s.coarse, here, reconstruct(drho, w, w, p))
    u[here] = v


@wp.func
def moments(f: wp.array(dtype=float), n: wp.vec3i, node: wp.vec3i):
    """rho - 1 and rho u of a coarse node."""
    q = loaded(f, n, place(node, n))
    m = momentum(q)
    return wp.vec4(density(q), m[0], m[1], m[2])


@wp.kernel
def prolong(
    s: Nest,
    origin: wp.array(dtype=int),
    kept_low: wp.vec3i,
    kept_size: wp.vec3i,
    f: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    f_fine: wp.array(dtype=float),
    u_fine: wp.array(dtype=wp.vec3),
):
    """The fine cells of R from the coarse level, but for those in a box of coarse cells that keep what they have."""
    i, j, k = wp.tid()
    n = s.coarse
    node = low_of(s, origin) + wp.vec3i(i, j, k)
    at = node - kept_low
    if at[0] >= 0 and at[0] < kept_size[0] and at[1] >= 0 and at[1] < kept_size[1] and at[2] >= 0 and at[2] < kept_size[2]:
        return
    q = loaded(f, n, place(node, n))
    drho, m = density(q), momentum(q)
    p = non_equilibrium_stress(q, drho, (1.0 / (1.0 + drho)) * m)
    ex, ey, ez = wp.vec3i(1, 0, 0), wp.vec3i(0, 1, 0), wp.vec3i(0, 0, 1)
    gx = 0.5 * (moments(f, n, node + ex) - moments(f, n, node - ex))
    gy = 0.5 * (moments(f, n, node + ey) - moments(f, n, node - ey))
    gz = 0.5 * (moments(f, n, node + ez) - moments(f, n, node - ez))
    ux = 0.5 * (u[place(node + ex, n)] - u[place(node - ex, n)])
    uy = 0.5 * (u[place(node + ey, n)] - u[place(node - ey, n)])
    uz = 0.5 * (u[place(node + ez, n)] - u[place(node - ez, n)])
    p -= (0.5 * (1.0 + drho) * _CS2) * strain(ux, uy, uz)  # a fine cell is half a coarse one: S in 1 / dt_f
    for child in range(8):
        r = wp.vec3i(child / 4, (child / 2) % 2, child % 2)
        d = offset(r)
        g = wp.vec4(drho, m[0], m[1], m[2]) + d[0] * gx + d[1] * gy + d[2] * gz
        v = (1.0 / (1.0 + g[0])) * wp.vec3(g[1], g[2], g[3])
        here = place(2 * node + r, s.fine)
        stored(f_fine, s.fine, here, reconstruct(g[0], v, v, p))
        u_fine[here] = u[place(node, n)] + d[0] * ux + d[1] * uy + d[2] * uz


@wp.kernel
def change_step(
    f: wp.array(dtype=float), u: wp.array(dtype=wp.vec3), r: float, f_out: wp.array(dtype=float), u_out: wp.array(dtype=wp.vec3)
):
    """Every cell for a time step r times as long: rho - 1 times r^2, u and P times r (run/time_refinement.py)."""
    here = wp.tid()
    cells = u.shape[0]
    q = vec19()
    for i in range(_Q):
        q[i] = peek(f, i * cells + here)
    drho = density(q)
    v = (1.0 / (1.0 + drho)) * momentum(q)
    q = reconstruct(r * r * drho, r * v, r * v, r * non_equilibrium_stress(q, drho, v))
    for i in range(_Q):
        poke(f_out, i * cells + here, q[i])
    u_out[here] = r * u[here]
