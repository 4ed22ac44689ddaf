"""Exchange of populations between a box of finer cells and the coarse water round it, in one coarse step.

Coarse node N covers two fine nodes on every axis. A fine step takes half the time, so that a lattice unit of velocity is equal on
both levels. R is the box of whole coarse cells that are refined. The fine array has one more ghost cell on every side, and a gap
along z. A and B are the fine populations at the start and in the middle of a coarse step, E the fine populations that enter R,
d_x = +-1/4 is the position of a child x in its coarse cell X, and s = 0, 1 counts the fine steps:

    explode    A_i(y) = E_i(y, 0),  B_i(y) = E_i(y - c_i, 1)                     y beside R, y + c_i in R: streamed, not collided
               E_i(w, s) = f_i(X) + [d_w + (2 s - 1) c_i / 4] . grad f_i         w in X; grad f_i by central differences
    coalesce   f_i(X) = mean over the children x of X of [B_i(x + c_i) if x + c_i in R, else A_i(x)]        X in R, X + c_i not
               f_i(X) gains the mean of [B_i(x + c_i) - A_i(x)] over those x with x + c_i in R              X and X + c_i not in R
    restrict   rho, rho u: means of the children,   P_c = mean P_f + rho c_s^2 dev S                        X at R's rim, later
    prolong    rho, rho u: linear in the coarse cell, its mean kept,   P_f = P_c - rho c_s^2 dev S          cells new in R

`coalesce` writes into the coarse populations before their step, where the plain kernel of the solver pulls them. Each population
is pulled once, a child moves by 2 c_i in two fine steps, which is the coarse path, and the mean of E over the entering children
is f_i(X). Whatever leaves one level therefore enters the other: mass and momentum are conserved to round-off. The second line of
`coalesce` is for paths that cut an edge of R. Beside an edge one child in four enters in the first step, and 2 s - 1 is reduced
by its mean, 1/2.

Crossings depend only on the box's size and are listed once, one thread for each entry. An entry is a word: the direction, and the
cell counted from the low corner of a box. `corner` is the place in memory of the fine array and of R: (3,) fine, (3,) coarse.

Nothing is divided by tau - 1, and the eddy viscosity may differ from cell to cell. After the collision the stress is
-2 rho c_s^2 (tau - 1) dt S. With one viscosity on both levels, (tau_f - 1/2) dt_f = (tau_c - 1/2) dt_c, the two stresses differ
by rho c_s^2 S dt_f, and S is known from the velocity. In `explode` and `coalesce` the positions account for this. f_i of the fine
level at x, t is f_i of the coarse one less (dt_f / 2) D f_i, D = d / d t + c_i . grad, which is its value at x - c_i / 4, up to
d / d t. An entering population therefore takes the value at (d_w + s c_i / 2) - c_i / 4 from the middle of its cell. The terms of
d / d t have opposite signs in the two steps and are left out. For the same reason a mean over children is second-order accurate
in the other direction.

In one dimension, with R = X0, X1 (capitals are coarse cells, small letters their children, c = +1):

    coarse      | W        |[ X0       | X1       ]| Y        |
    fine        | w0   w1  |[ a0   a1  | b0   b1  ]| y0   y1  |
    explode       f(W) ------> w1 enters a0 in fine step 0, w0 in fine step 1
    coalesce      A(b1) leaves in fine step 0, B(b1) in fine step 1: their mean -------> f(X1), which Y pulls
    restrict      means of a0, a1 and of b0, b1 ------> coarse moments of X0 and X1

Sources: Rohde, Kandhai, Derksen, van den Akker 2006, Int. J. Numer. Methods Fluids 51:439 (volumes, explode and coalesce); Chen,
Filippova, Hoch, Molvig, Shock, Teixeira, Zhang 2006, Physica A 362:158 (conservation). Departures: E is linear in place of
uniform, and paths along edges of R are exact.
"""

from typing import Any

import warp as wp

from fishmj.lbm_oracle.fluid.collide import density, momentum, non_equilibrium_stress, reconstruct
from fishmj.lbm_oracle.fluid.in_kernels import vec6, vec6i, vec19
from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.pairs import quotient
from fishmj.lbm_oracle.fluid.step import within
from fishmj.lbm_oracle.fluid.storage import VELOCITIES, peek, peek3, peek3_pair, peek_pair, poke, poke3, poke_end, six

wp.set_module_options({"max_unroll": 0, "enable_backward": False})  # unrolled, they take two minutes to compile

_Q = wp.constant(Q)
UNROLLED = {"max_unroll": 32, "enable_backward": False}  # all loads of a thread under way at once
BLOCK = 64  # threads that start and end together: `restrict` needs many registers, and few cells shall keep all processors busy
GHOST = 1  # layers of fine cells round R
CELL_BITS = 27  # of a word of a list; the direction has the other five: nineteen times the cells of an array are under 2^31
_BITS, _CELL = wp.constant(CELL_BITS), wp.constant((1 << CELL_BITS) - 1)
_CS2 = wp.constant(1.0 / 3.0)

mat219 = wp.types.matrix(shape=(2, Q), dtype=wp.float32)


@wp.struct
class Nest:
    """Sizes of the two arrays and of R; `ghost` is 0 on an axis that R fills from end to end."""

    coarse: wp.vec3i  # cells of the coarse array
    fine: wp.vec3i  # cells of the fine array
    size: wp.vec3i  # fine cells of R
    ghost: wp.vec3i
    gap: int  # cells of a row of the fine array that are no R's: two ghosts, and what fills it up to a multiple of eight
    shell: wp.vec3i  # coarse cells of R and of a layer round it, where there are ghosts
    by_shell: wp.vec4i  # what divides by the sizes of y and z of that shell (pairs.py)
    linear: float  # 1; 0 makes E uniform, to show what that costs


@wp.func
def child_at(n: int):
    """Position of child n in its coarse cell, 0 or 1 on every axis."""
    return wp.vec3i(n / 4, (n / 2) % 2, n % 2)


@wp.func
def offset(r: wp.vec3i):
    """Offset d of a child from the middle of its coarse cell, in coarse cells."""
    return wp.vec3(0.5 * float(r[0]) - 0.25, 0.5 * float(r[1]) - 0.25, 0.5 * float(r[2]) - 0.25)


@wp.func
def is_outside(s: Nest, x: wp.vec3i, axis: int):
    """True if a coarse cell, counted from R's low corner, is outside R along an axis that R does not fill."""
    return s.ghost[axis] > 0 and (x[axis] < 0 or 2 * x[axis] >= s.size[axis])


@wp.func
def within_box(s: Nest, x: wp.vec3i):
    """True if a coarse cell, counted from R's low corner, is inside R."""
    return not (is_outside(s, x, 0) or is_outside(s, x, 1) or is_outside(s, x, 2))


@wp.func_native("return (later ? second.data : first.data)[i];")
def peek_either(first: wp.array(dtype=wp.float32), second: wp.array(dtype=wp.float32), later: int, i: int) -> wp.float32:
    """Loads a population from the first or, if `later`, from the second array."""
    ...


@wp.func
def direction_in(word: int):
    """Direction i of a word of a list."""
    return (word >> _BITS) & 31


@wp.func
def cell_in(word: int, n: wp.vec3i, by: wp.vec4i):
    """Cell of a word of a list, counted from the low corner of a box of n cells."""
    at = word & _CELL
    column = quotient(at, by[2], by[3])
    x = quotient(column, by[0], by[1])
    return wp.vec3i(x, column - x * n[1], at - column * n[2])


@wp.func
def in_fine(s: Nest, corner: vec6i, p: wp.vec3i):
    """Index in memory of a fine cell, counted from the low corner of the fine array; a strip has one cell along z."""
    n = s.fine
    x, y, z = within(corner[0] + p[0], n[0]), within(corner[1] + p[1], n[1]), within(corner[2] + p[2], n[2])
    z = wp.where(n[2] > 1, z, 0)
    return (x * n[1] + y) * n[2] + z


@wp.func
def in_coarse(s: Nest, corner: vec6i, x: wp.vec3i):
    """Index in memory of a coarse cell, counted from R's low corner."""
    n = s.coarse
    i, j, k = within(corner[3] + x[0], n[0]), within(corner[4] + x[1], n[1]), within(corner[5] + x[2], n[2])
    return (i * n[1] + j) * n[2] + k


@wp.func
def neighbours_of(s: Nest, corner: vec6i, x: wp.vec3i):
    """Index `in_coarse` of a cell, and of its neighbours behind it and ahead of it on each axis."""
    n = s.coarse
    i, j, k = within(corner[3] + x[0], n[0]), within(corner[4] + x[1], n[1]), within(corner[5] + x[2], n[2])
    here = (i * n[1] + j) * n[2] + k
    plane, row = n[1] * n[2], n[2]
    behind = wp.vec3i(
        here + wp.where(i > 0, -plane, (n[0] - 1) * plane),
        here + wp.where(j > 0, -row, (n[1] - 1) * row),
        here + wp.where(k > 0, -1, n[2] - 1),
    )
    ahead = wp.vec3i(
        here + wp.where(i < n[0] - 1, plane, (1 - n[0]) * plane),
        here + wp.where(j < n[1] - 1, row, (1 - n[1]) * row),
        here + wp.where(k < n[2] - 1, 1, 1 - n[2]),
    )
    return here, behind, ahead


@wp.func
def entry(s: Nest, x: wp.vec3i, c: wp.vec3i, second: int):
    """Factor (2 s - 1) / 4 of `explode`, or its replacement beside an edge of R."""
    k = 2.0 * float(second) - 1.0
    edges = int(0)  # noqa: UP018  a variable to Warp
    for a in range(3):
        if c[a] != 0 and is_outside(s, x, a):
            edges += 1
    if edges == 2:
        k -= 0.5  # one child in four enters in the first step: the mean over all shall stay f_i(X)
    return 0.25 * k


@wp.func
def unfilled_end(s: Nest, p: wp.vec3i, here: int):
    """-1 or 1 for a ghost cell at the low or high end of z whose sector of the memory has nothing of R in it, else 0.

    The ghost of the other end may be in that sector. A write for one end destroys nothing of the other: no population enters at
    both ends, and eight velocities are three sectors. Velocities of 16 bits fill no sector.
    """
    if s.gap >= 8 and p[2] == 0 and here % 8 == 7:
        return -1
    if s.gap >= 8 and p[2] == s.size[2] + 1 and here % 8 == 0:
        return 1
    return 0


@wp.func
def load_cell(f: wp.array(dtype=float), n: wp.vec3i, here: int):
    """Loads all populations of a cell."""
    q = vec19()
    for i in range(_Q):
        q[i] = peek(f, i * n[0] * n[1] * n[2] + here)
    return q


@wp.func
def store_cell(f: wp.array(dtype=float), n: wp.vec3i, here: int, q: vec19):
    """Stores all populations of a cell."""
    for i in range(_Q):
        poke(f, i * n[0] * n[1] * n[2] + here, q[i])


@wp.kernel(module="unique", module_options=UNROLLED, grid_stride=False)
def explode(
    s: Nest,
    directions: wp.array(dtype=wp.vec3i),
    entering: wp.array(dtype=int),
    children: wp.array(dtype=int),
    corner: wp.array(dtype=int),
    f: wp.array(dtype=float),
    u: wp.array(dtype=Any),
    f_first: wp.array(dtype=float),
    u_first: wp.array(dtype=Any),
    f_second: wp.array(dtype=float),
    u_second: wp.array(dtype=Any),
):
    """Writes the populations that the two fine steps pull out of ghost cells: one thread for a coarse cell and a direction.

    Bits 0 to 7 of `children` are set for each child from which a population enters R in the first step, 8 to 15 in the second.
    Entries of direction 0 write the velocity, which the gradients beside a ghost cell need: one bit for each child that is a
    ghost cell.
    """
    t = wp.tid()
    o = six(corner)
    word, bits = entering[t], children[t]
    i = direction_in(word)
    x = cell_in(word, s.shell, s.by_shell) - s.ghost
    low = 2 * x + s.ghost
    here, behind, ahead = neighbours_of(s, o, x)
    if i == 0:
        middle = peek3(u, here)
        gx = peek3(u, ahead[0]) - peek3(u, behind[0])
        gy = peek3(u, ahead[1]) - peek3(u, behind[1])
        gz = peek3(u, ahead[2]) - peek3(u, behind[2])
        for child in range(8):
            if (bits >> child) & 1 == 1:
                r = child_at(child)
                d = offset(r)
                there = in_fine(s, o, low + r)
                end = unfilled_end(s, low + r, there)
                v = middle + 0.5 * d[0] * gx + 0.5 * d[1] * gy + 0.5 * d[2] * gz
                poke_end(u_first, there, end, v)
                poke_end(u_second, there, end, v)
    else:
        c, first = directions[i], i * (s.coarse[0] * s.coarse[1] * s.coarse[2])
        plane = i * (s.fine[0] * s.fine[1] * s.fine[2])
        value, g = peek(f, first + here), wp.vec3()
        if s.linear != 0.0:
            for a in range(3):
                g[a] = peek(f, first + ahead[a]) - peek(f, first + behind[a])
        for second in range(2):
            along = entry(s, x, c, second) * wp.vec3(float(c[0]), float(c[1]), float(c[2]))
            for child in range(8):
                if (bits >> (8 * second + child)) & 1 == 1:
                    r = child_at(child)
                    d = offset(r) + along
                    p = low + r + second * c
                    there = in_fine(s, o, p)
                    end = unfilled_end(s, p, there)
                    w = value + 0.5 * d[0] * g[0] + 0.5 * d[1] * g[1] + 0.5 * d[2] * g[2]
                    if second == 0:
                        poke_end(f_first, plane + there, end, w)
                    else:
                        poke_end(f_second, plane + there, end, w)


@wp.kernel(module="unique", module_options=UNROLLED, grid_stride=False)
def coalesce(
    s: Nest,
    directions: wp.array(dtype=wp.vec3i),
    leaving: wp.array(dtype=int),
    later: wp.array(dtype=int),
    corner: wp.array(dtype=int),
    f_first: wp.array(dtype=float),
    f_second: wp.array(dtype=float),
    f: wp.array(dtype=float),
):
    """Writes the populations that the next coarse step pulls out of R, and along its edges: coarse cells on both sides of R's
    faces.

    A bit of `later` is set for each child x with x + c_i in R.
    """
    t = wp.tid()
    o = six(corner)
    word, bits = leaving[t], later[t]
    i = direction_in(word)
    c = directions[i]
    x = cell_in(word, s.shell, s.by_shell) - s.ghost
    low = 2 * x + s.ghost
    first = i * (s.fine[0] * s.fine[1] * s.fine[2])
    slot = i * (s.coarse[0] * s.coarse[1] * s.coarse[2]) + in_coarse(s, o, x)
    total = float(0.0)  # noqa: UP018
    if within_box(s, x):
        for child in range(8):
            bit = (bits >> child) & 1
            p = low + child_at(child) + bit * c
            total += peek_either(f_first, f_second, bit, first + in_fine(s, o, p))
        poke(f, slot, 0.125 * total)
    else:
        for child in range(8):
            if (bits >> child) & 1 == 1:
                p = low + child_at(child)
                total += peek(f_second, first + in_fine(s, o, p + c))
                total -= peek(f_first, first + in_fine(s, o, p))
        poke(f, slot, peek(f, slot) + 0.125 * total)


@wp.func
def strain(dx: wp.vec3, dy: wp.vec3, dz: wp.vec3):
    """dev S from d u / d x, d y, d z; (xx, yy, zz, xy, xz, yz)."""
    third = (dx[0] + dy[1] + dz[2]) / 3.0
    xy, xz, yz = 0.5 * (dx[1] + dy[0]), 0.5 * (dx[2] + dz[0]), 0.5 * (dy[2] + dz[1])
    return vec6(dx[0] - third, dy[1] - third, dz[2] - third, xy, xz, yz)


@wp.func
def load_cell_pair(f: wp.array(dtype=float), cells: int, here: int):
    """Loads all populations of two neighbours along z, the first at an even place."""
    q = mat219()
    for i in range(_Q):
        both = peek_pair(f, i * cells + here)
        q[0, i] = both[0]
        q[1, i] = both[1]
    return q


@wp.kernel(module="unique", module_options=UNROLLED, grid_stride=False)
def restrict(
    s: Nest,
    pairs: int,
    cells: wp.array(dtype=int),
    corner: wp.array(dtype=int),
    f_fine: wp.array(dtype=float),
    u_fine: wp.array(dtype=Any),
    f: wp.array(dtype=float),
    u: wp.array(dtype=Any),
):
    """Computes coarse cells of R from their children, two neighbours along z at once: the first is at an even place.

    `pairs`: four, or two along y in a strip.
    """
    x = cell_in(cells[wp.tid()], s.shell, s.by_shell) - s.ghost
    o = six(corner)
    fine_cells = s.fine[0] * s.fine[1] * s.fine[2]
    drho, m, p, v = float(0.0), wp.vec3(), vec6(), wp.vec3()  # noqa: UP018
    dx, dy, dz = wp.vec3(), wp.vec3(), wp.vec3()
    share, half = 0.5 / float(pairs), pairs / 2
    for pair in range(pairs):  # four, but the compiler shall not write them out
        a, b = pair / half, pair % half
        here = in_fine(s, o, 2 * x + s.ghost + wp.vec3i(a, b, 0))
        both, velocities = load_cell_pair(f_fine, fine_cells, here), peek3_pair(u_fine, here)
        for c in range(2):
            q, w = both[c], velocities[c]
            rho = density(q)
            flow = momentum(q)
            drho += share * rho
            m += share * flow
            p += share * non_equilibrium_stress(
                q, rho, (1.0 / (1.0 + rho)) * flow
            )  # of each child: not the stress of their differences
            v += share * w
            dx += 2.0 * share * float(2 * a - 1) * w
            if half == 2:
                dy += 0.25 * float(2 * b - 1) * w
                dz += 0.25 * float(2 * c - 1) * w
            else:
                dy += 0.5 * float(2 * c - 1) * w
    w = (1.0 / (1.0 + drho)) * m
    p += ((1.0 + drho) * _CS2) * strain(dx, dy, dz)
    here = in_coarse(s, o, x)
    store_cell(f, s.coarse, here, reconstruct(drho, w, w, p))
    poke3(u, here, v)


@wp.func
def moments(f: wp.array(dtype=float), n: wp.vec3i, here: int):
    """rho - 1 and rho u of a coarse cell."""
    q = load_cell(f, n, here)
    m = momentum(q)
    return wp.vec4(density(q), m[0], m[1], m[2])


@wp.kernel
def prolong(
    s: Nest,
    corner: wp.array(dtype=int),
    kept_low: wp.vec3i,
    kept_size: wp.vec3i,
    f: wp.array(dtype=float),
    u: wp.array(dtype=Any),
    f_fine: wp.array(dtype=float),
    u_fine: wp.array(dtype=Any),
):
    """Computes the fine cells of R from the coarse level, except those in a box of coarse cells that stay as they are.

    kept_low: that box's low corner, counted from R's.
    """
    i, j, k = wp.tid()
    n, x = s.coarse, wp.vec3i(i, j, k)
    at = x - kept_low
    if at[0] >= 0 and at[0] < kept_size[0] and at[1] >= 0 and at[1] < kept_size[1] and at[2] >= 0 and at[2] < kept_size[2]:
        return
    o = six(corner)
    here, behind, ahead = neighbours_of(s, o, x)
    q = load_cell(f, n, here)
    drho, m = density(q), momentum(q)
    p = non_equilibrium_stress(q, drho, (1.0 / (1.0 + drho)) * m)
    gx = 0.5 * (moments(f, n, ahead[0]) - moments(f, n, behind[0]))
    gy = 0.5 * (moments(f, n, ahead[1]) - moments(f, n, behind[1]))
    gz = 0.5 * (moments(f, n, ahead[2]) - moments(f, n, behind[2]))
    ux = 0.5 * (peek3(u, ahead[0]) - peek3(u, behind[0]))
    uy = 0.5 * (peek3(u, ahead[1]) - peek3(u, behind[1]))
    uz = 0.5 * (peek3(u, ahead[2]) - peek3(u, behind[2]))
    p -= (0.5 * (1.0 + drho) * _CS2) * strain(ux, uy, uz)  # a fine cell is half a coarse one: S in 1 / dt_f
    for child in range(8):
        r = child_at(child)
        d = offset(r)
        g = wp.vec4(drho, m[0], m[1], m[2]) + d[0] * gx + d[1] * gy + d[2] * gz
        v = (1.0 / (1.0 + g[0])) * wp.vec3(g[1], g[2], g[3])
        there = in_fine(s, o, 2 * x + s.ghost + r)
        store_cell(f_fine, s.fine, there, reconstruct(g[0], v, v, p))
        poke3(u_fine, there, peek3(u, here) + d[0] * ux + d[1] * uy + d[2] * uz)


for _kept in VELOCITIES:  # beforehand: an overload that comes later reloads the module under captured graphs
    _array = wp.array(dtype=_kept)
    wp.overload(explode, {"u": _array, "u_first": _array, "u_second": _array})
    wp.overload(restrict, {"u": _array, "u_fine": _array})
    wp.overload(prolong, {"u": _array, "u_fine": _array})
