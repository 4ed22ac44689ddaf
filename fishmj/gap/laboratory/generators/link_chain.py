"""Chain of rigid links in water: maps the state of the joints to the motion of each link, and link forces to joint forces.

    origin    P_i = P_0 + sum_{m<i} d_m t_m,   V_i = V_0 + sum_{m<i} d_m W_m n_m,   W_i = psi' + the rates of the hinges before it
    relative  nu_i = (u, v, r): velocity of the origin through the water, link axes, and yaw rate against the water's own
    Kirchhoff p = A nu;  F_t = -(p_t' - W p_n),  F_n = -(p_n' + W p_t),  M = -(L' + u p_n - v p_t)     Lamb 1932, art. 124

t, n are unit vectors along the link to the nose and to its left, A the (3, 3) added mass of a link at its origin: the front
hinge, for the head the reference point. The part of p' that is A times the joints' acceleration goes into the mass matrix,
J^T A J; the rest is a force. Accelerated water adds rho V DU/Dt on the displaced volume.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.laboratory.generators.water_compiler import inlined

MOTION = 12  # columns of `motion`: u, v, r; the link's yaw rate, t_x, t_y, bias of u', v'; the water's DU/Dt along t, n; origin


class LinkChain(NamedTuple):
    """Constants of the links for compiled code. N links, nv degrees of freedom: x, y, yaw, hinges, others of MuJoCo."""

    hinge: np.ndarray  # (N,) x of the rear hinge of a link along its own axis, m; the last entry is not used
    first: np.ndarray  # (nv,) first link that a degree of freedom turns; N if it turns none
    centre: np.ndarray  # (N,) x of the link's middle, where it meets the flow, m
    added: np.ndarray  # (N, 3, 3) added mass at the origin: kg, kg m, kg m2
    displaced: np.ndarray  # (N,) kg
    buoyancy: np.ndarray  # (N,) x of the centre of buoyancy, m
    rows: np.ndarray  # (nM,) row of each entry of MuJoCo's sparse mass matrix
    columns: np.ndarray  # (nM,)


class ScratchArrays(NamedTuple):
    """Scratch arrays of one step."""

    motion: np.ndarray  # (N, MOTION)
    jacobian: np.ndarray  # (N, 3, nv)
    force: np.ndarray  # (N, 3) F_t, F_n, moment on each link, from `law`
    mass: np.ndarray  # (nv, nv)


def work_of(links: int, freedoms: int) -> ScratchArrays:
    """Fresh scratch arrays."""
    shapes = (links, MOTION), (links, 3, freedoms), (links, 3), (freedoms, freedoms)
    return ScratchArrays(*(np.zeros(shape) for shape in shapes))


@inlined
def move(chain, q, rate, flow, work):
    """Fills work.motion and work.jacobian. flow (8,): U_x, U_y at the tank's centre, its gradient xx, xy, yx, yy, dU/dt x, y."""
    n, freedoms = chain.hinge.shape[0], q.shape[0]
    jacobian, motion = work.jacobian, work.motion
    jacobian[:] = 0.0
    px, py, vx, vy, ax, ay = q[0], q[1], rate[0], rate[1], 0.0, 0.0
    angle, turn = 0.0, 0.0
    curl = 0.5 * (flow[4] - flow[3])
    for i in range(n):
        for k in range(2, freedoms):
            if chain.first[k] == i:
                angle += q[k]
                turn += rate[k]
        c, s = np.cos(angle), np.sin(angle)
        jacobian[i, 0, 0], jacobian[i, 0, 1] = c, s
        jacobian[i, 1, 0], jacobian[i, 1, 1] = -s, c
        for k in range(2, freedoms):
            if chain.first[k] <= i:
                jacobian[i, 2, k] = 1.0
                jx, jy = 0.0, 0.0
                for m in range(chain.first[k], i):
                    jx -= chain.hinge[m] * motion[m, 5]
                    jy += chain.hinge[m] * motion[m, 4]
                jacobian[i, 0, k], jacobian[i, 1, k] = c * jx + s * jy, c * jy - s * jx
        mx, my = px + chain.centre[i] * c, py + chain.centre[i] * s
        cx, cy = vx - chain.centre[i] * turn * s, vy + chain.centre[i] * turn * c  # of the middle
        ux = flow[0] + flow[2] * mx + flow[3] * my
        uy = flow[1] + flow[4] * mx + flow[5] * my
        wx, wy = flow[6] + flow[2] * cx + flow[3] * cy, flow[7] + flow[4] * cx + flow[5] * cy  # dU/dt as the link meets it
        dx = flow[6] + flow[2] * ux + flow[3] * uy  # DU/Dt
        dy = flow[7] + flow[4] * ux + flow[5] * uy
        u, v = c * (vx - ux) + s * (vy - uy), c * (vy - uy) - s * (vx - ux)
        motion[i, 0], motion[i, 1], motion[i, 2], motion[i, 3] = u, v, turn - curl, turn
        motion[i, 4], motion[i, 5] = c, s
        motion[i, 6] = c * (ax - wx) + s * (ay - wy) + turn * v
        motion[i, 7] = c * (ay - wy) - s * (ax - wx) - turn * u
        motion[i, 8], motion[i, 9] = c * dx + s * dy, c * dy - s * dx
        motion[i, 10], motion[i, 11] = px, py
        d = chain.hinge[i]
        px, py = px + d * c, py + d * s
        vx, vy = vx - d * turn * s, vy + d * turn * c
        ax, ay = ax - d * turn * turn * c, ay - d * turn * turn * s


@inlined
def carried(chain, work):
    """Adds to work.force the inertial forces of the water beyond A times the joints' acceleration."""
    for i in range(chain.hinge.shape[0]):
        a, m, f = chain.added[i], work.motion[i], work.force[i]
        p0 = a[0, 0] * m[0] + a[0, 1] * m[1] + a[0, 2] * m[2]
        p1 = a[1, 0] * m[0] + a[1, 1] * m[1] + a[1, 2] * m[2]
        f[0] += m[3] * p1 - (a[0, 0] * m[6] + a[0, 1] * m[7])
        f[1] += -m[3] * p0 - (a[1, 0] * m[6] + a[1, 1] * m[7])
        f[2] += m[1] * p0 - m[0] * p1 - (a[2, 0] * m[6] + a[2, 1] * m[7])
        f[0] += chain.displaced[i] * m[8]
        f[1] += chain.displaced[i] * m[9]
        f[2] += chain.displaced[i] * chain.buoyancy[i] * m[9]


@inlined
def gather(chain, work, generalised, sparse):
    """Sets generalised (nv,) = J^T force and adds J^T A J to MuJoCo's sparse mass matrix."""
    n, freedoms = chain.hinge.shape[0], generalised.shape[0]
    work.mass[:] = 0.0
    for k in range(freedoms):
        generalised[k] = 0.0
    for i in range(n):
        jac, a = work.jacobian[i], chain.added[i]
        for k in range(freedoms):
            j0, j1, j2 = jac[0, k], jac[1, k], jac[2, k]
            if j0 == 0.0 and j1 == 0.0 and j2 == 0.0:
                continue
            generalised[k] += j0 * work.force[i, 0] + j1 * work.force[i, 1] + j2 * work.force[i, 2]
            b0 = j0 * a[0, 0] + j1 * a[1, 0] + j2 * a[2, 0]
            b1 = j0 * a[0, 1] + j1 * a[1, 1] + j2 * a[2, 1]
            b2 = j0 * a[0, 2] + j1 * a[1, 2] + j2 * a[2, 2]
            for m in range(k + 1):
                work.mass[k, m] += b0 * jac[0, m] + b1 * jac[1, m] + b2 * jac[2, m]
    for e in range(chain.rows.shape[0]):
        sparse[e] += work.mass[chain.rows[e], chain.columns[e]]


@inlined
def own_effects(head, extra, tether):
    """(F_t, F_n, moment) on the head by whole-body faults. extra: linear, quadratic, turning drag, lift; tether: k, x, y."""
    u, v, r = head[0], head[1], head[2]
    along = -(extra[0] + extra[1] * abs(u)) * u
    across = -extra[3] * abs(u) * v
    pull_x, pull_y = -tether[0] * (head[10] - tether[1]), -tether[0] * (head[11] - tether[2])
    along += head[4] * pull_x + head[5] * pull_y
    across += head[4] * pull_y - head[5] * pull_x
    return along, across, -extra[2] * abs(r) * r


@inlined
def finish(chain, extra, tether, work, generalised, sparse):
    """Converts a water's own forces in work.force to joint forces, with whole-body faults on the head and accelerated water."""
    a, b, c = own_effects(work.motion[0], extra, tether)
    work.force[0, 0] += a
    work.force[0, 1] += b
    work.force[0, 2] += c
    carried(chain, work)
    gather(chain, work, generalised, sparse)
