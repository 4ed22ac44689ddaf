"""Mechanics of a chain of hinged links, by virtual power at each link's origin: J^T A J.

Generalised rates: the reference point's velocity in the tank frame and the links' absolute rates, (VX, VY, W1..WN). Origins:

    o_{i+1} = o_i + W_i x_i n_i,     a_{i+1} = a_i + W_i' x_i n_i - W_i^2 x_i t_i       x_i: rear hinge of link i

The origin of link i moves with (VX, VY) and W_k x_k n_k of every k < i; the link turns with W_i. Its inertia about the origin is
rigid plus added mass. The momentum of the latter, p = (a u, b v + s r), L = s v + J r in link axes, relative to the water, obeys
Kirchhoff's equations:

    force = - dp/dt - W x p,     moment = - dL/dt - (u p_n - v p_t)

and an accelerating stream adds (displaced mass + added mass) DU/Dt. One step: (M + h D) dv = h f, v += dv, z += h v.
"""

from math import cos, exp, sin, sqrt

from fishmj.gap.laboratory.virtual_robot.loop_compiler import compiled
from fishmj.gap.laboratory.virtual_robot.water import link_force


@compiled
def assemble(body, water, tank, odd, s, stream, A, f, h):
    """Mass matrix A (N + 2, N + 2), lower half, and forces f (N + 2,) without the joints' own torques.

    stream = (u, v, du/dt, dv/dt)
    """
    n = len(body.links)
    for a in range(n + 2):
        f[a] = 0.0
        for b in range(n + 2):
            A[a, b] = 0.0
    time = s.clock[0]
    px, py, ox, oy, bx, by = s.z[0], s.z[1], s.rate[0], s.rate[1], 0.0, 0.0
    near = 1.0
    if water.wall != 0.0:
        distance = tank.half - max(abs(px), abs(py))
        near = 1.0 + water.wall * exp(-max(distance, 0.0) / body.length)
    bend = s.rate[n + 1] - s.rate[2]
    for i in range(n):
        c, d, w = cos(s.z[2 + i]), sin(s.z[2 + i]), s.rate[2 + i]
        mass, first, spin = body.mass[i], body.first[i], body.second[i]
        if i == 0 and odd.shift != 0.0 and time > odd.shift_time:
            slid = odd.shift * body.total / mass
            spin += (2.0 * first + mass * slid) * slid
            first += mass * slid
        # rigid body
        tx, ty, nx, ny = c, d, -d, c
        Fx = -mass * bx + first * w * w * tx
        Fy = -mass * by + first * w * w * ty
        moment = -first * (nx * bx + ny * by)
        along, across, cross = mass, mass, first
        if water.active > 0.0:
            ux = stream[0] + tank.shear * py - tank.swirl * py
            uy = stream[1] + tank.swirl * px
            dux = stream[2] + (tank.shear - tank.swirl) * uy
            duy = stream[3] + tank.swirl * ux
            # rotation of the stream along the link: n . (grad U) t
            turning = nx * (tank.shear - tank.swirl) * ty + ny * tank.swirl * tx
            u, v, r = tx * (ox - ux) + ty * (oy - uy), nx * (ox - ux) + ny * (oy - uy), w - turning
            ft, fn, m = link_force(body, water, odd, s, i, u, v, r, bend, time, h)
            ft, fn, m = ft * near, fn * near, m * near
            a, b, s1 = body.surge[i] * near, body.sway[i, 0] * near, body.sway[i, 1] * near
            J = body.sway[i, 2] * near + body.spin[i]
            at, an = tx * (bx - dux) + ty * (by - duy), nx * (bx - dux) + ny * (by - duy)
            ft += -a * (at + w * v) + w * (b * v + s1 * r)
            fn += -b * (an - w * u) - w * a * u
            m += -s1 * (an - w * u) - u * (b * v + s1 * r) + v * a * u
            Fx += ft * tx + fn * nx + body.displaced[i] * dux
            Fy += ft * ty + fn * ny + body.displaced[i] * duy
            moment += m + body.displaced[i] * body.buoyancy[i] * (nx * dux + ny * duy)
            along, across, cross, spin = along + a, across + b, cross + s1, spin + J
        if i == 0 and tank.tether != 0.0:
            Fx -= tank.tether * (px - tank.tether_x)
            Fy -= tank.tether * (py - tank.tether_y)
        _add_link(A, f, i, (along, across, cross, spin), (tx, ty, nx, ny), (Fx, Fy, moment), s.arm)
        x = body.hinge[i]
        s.arm[i, 0], s.arm[i, 1] = x * nx, x * ny
        px, py = px + x * tx, py + x * ty
        ox, oy = ox + w * x * nx, oy + w * x * ny
        bx, by = bx - w * w * x * tx, by - w * w * x * ty


@compiled
def _add_link(A, f, i, inertia, axes, load, arms):
    """Adds link i to A and f, and to the links before it through the arms x_k n_k. inertia: link axes; load: tank axes."""
    along, across, cross, spin = inertia
    tx, ty, nx, ny = axes
    Fx, Fy, moment = load
    bxx = along * tx * tx + across * nx * nx
    bxy = along * tx * ty + across * nx * ny
    byy = along * ty * ty + across * ny * ny
    A[0, 0] += bxx
    A[1, 0] += bxy
    A[1, 1] += byy
    qx, qy = cross * nx, cross * ny
    A[2 + i, 0] += qx
    A[2 + i, 1] += qy
    A[2 + i, 2 + i] += spin
    f[0] += Fx
    f[1] += Fy
    f[2 + i] += moment
    for k in range(i):
        gx, gy = arms[k, 0], arms[k, 1]
        hx, hy = bxx * gx + bxy * gy, bxy * gx + byy * gy
        A[2 + k, 0] += hx
        A[2 + k, 1] += hy
        A[2 + i, 2 + k] += qx * gx + qy * gy
        f[2 + k] += gx * Fx + gy * Fy
        for j in range(k + 1):
            A[2 + k, 2 + j] += hx * arms[j, 0] + hy * arms[j, 1]


@compiled
def hang(air, s, anchor, f):
    """Adds the forces of the thread on a fish in air. air: stiffness, damping, torsional stiffness, torsional damping."""
    f[0] -= air[0] * (s.z[0] - anchor[0]) + air[1] * s.rate[0]
    f[1] -= air[0] * (s.z[1] - anchor[1]) + air[1] * s.rate[1]
    f[2] -= air[2] * (s.z[2] - anchor[2]) + air[3] * s.rate[2]


@compiled
def push_joint(A, f, j, torque, inertia):
    """Adds a torque between links j and j + 1; inertia: rotor inertia plus h times the damping, kg m2."""
    f[2 + j] -= torque
    f[3 + j] += torque
    A[2 + j, 2 + j] += inertia
    A[3 + j, 3 + j] += inertia
    A[3 + j, 2 + j] -= inertia


@compiled
def factor(body, A):
    """Cholesky factor of the lower half, in place; the diagonal holds its inverse."""
    for i in range(len(body.links) + 2):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total * A[j, j] if j < i else 1.0 / sqrt(total)


@compiled
def solve(body, L, b):
    """Solves L L^T x = b in place."""
    n = len(body.links) + 2
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * b[k]
        b[i] = total * L[i, i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for k in range(i + 1, n):
            total -= L[k, i] * b[k]
        b[i] = total * L[i, i]
