# ruff: noqa: F821
"""MuJoCo's step of a tree of hinges and slides, many rollouts at once, compiled as text by `robot_kernel.py`.

Bias forces by recursive Newton-Euler and inertia by composite bodies, both in the links' own frames (Featherstone 2008), over
LANES rollouts; dry friction as MuJoCo's soft constraint, by Newton's method on its piecewise quadratic cost, then the integrator,
each rollout by itself. A link is a joint and what it carries; its frame has its origin on the joint and z along it.

    w[row * LANES + i]     row of the workspace: blocks of BLOCK rows, the first of the ground, then one a link; i: rollout
"""

import numpy as np


def down(w, b, p, slide):
    """Motion of link b from that of its parent p, the force that it needs without joint accelerations, and its own inertia."""
    for i in range(LANES):
        q, rate = w[(b + ANGLE) * LANES + i], w[(b + RATE) * LANES + i]
        s, c = (0.0, 1.0) if slide else (sin(q), cos(q))
        e0, e1, e2 = w[(b + TURN) * LANES + i], w[(b + TURN + 1) * LANES + i], w[(b + TURN + 2) * LANES + i]
        e3, e4, e5 = w[(b + TURN + 3) * LANES + i], w[(b + TURN + 4) * LANES + i], w[(b + TURN + 5) * LANES + i]
        r2, r5, r8 = e2, e5, w[(b + TURN + 8) * LANES + i]
        e6, e7 = w[(b + TURN + 6) * LANES + i], w[(b + TURN + 7) * LANES + i]
        r0, r1 = c * e0 + s * e1, c * e1 - s * e0
        r3, r4 = c * e3 + s * e4, c * e4 - s * e3
        r6, r7 = c * e6 + s * e7, c * e7 - s * e6
        way = q if slide else 0.0
        x, y, z = w[(b + PLACE) * LANES + i], w[(b + PLACE + 1) * LANES + i], w[(b + PLACE + 2) * LANES + i]
        x, y, z = x + r2 * way, y + r5 * way, z + r8 * way
        # the parent's motion at the link's origin, in the parent's axes
        px, py, pz = w[(p + SPIN) * LANES + i], w[(p + SPIN + 1) * LANES + i], w[(p + SPIN + 2) * LANES + i]
        ax, ay, az = w[(p + TWIST) * LANES + i], w[(p + TWIST + 1) * LANES + i], w[(p + TWIST + 2) * LANES + i]
        vx, vy, vz = py * z - pz * y, pz * x - px * z, px * y - py * x
        gx = w[(p + PULL) * LANES + i] + ay * z - az * y + py * vz - pz * vy
        gy = w[(p + PULL + 1) * LANES + i] + az * x - ax * z + pz * vx - px * vz
        gz = w[(p + PULL + 2) * LANES + i] + ax * y - ay * x + px * vy - py * vx
        vx, vy, vz = vx + w[(p + FLOW) * LANES + i], vy + w[(p + FLOW + 1) * LANES + i], vz + w[(p + FLOW + 2) * LANES + i]
        # in the link's axes, with the joint's own motion
        ox, oy, oz = r0 * px + r3 * py + r6 * pz, r1 * px + r4 * py + r7 * pz, r2 * px + r5 * py + r8 * pz
        tx, ty, tz = r0 * ax + r3 * ay + r6 * az, r1 * ax + r4 * ay + r7 * az, r2 * ax + r5 * ay + r8 * az
        ux, uy, uz = r0 * vx + r3 * vy + r6 * vz, r1 * vx + r4 * vy + r7 * vz, r2 * vx + r5 * vy + r8 * vz
        hx, hy, hz = r0 * gx + r3 * gy + r6 * gz, r1 * gx + r4 * gy + r7 * gz, r2 * gx + r5 * gy + r8 * gz
        if slide:
            uz = uz + rate
            hx, hy = hx + 2.0 * oy * rate, hy - 2.0 * ox * rate
        else:
            tx, ty = tx + oy * rate, ty - ox * rate
            oz = oz + rate
        # force and torque about the origin
        m, jx = w[(b + MASS) * LANES + i], w[(b + MASS + 1) * LANES + i]
        jy, jz = w[(b + MASS + 2) * LANES + i], w[(b + MASS + 3) * LANES + i]
        ixx, iyy, izz = w[(b + MASS + 4) * LANES + i], w[(b + MASS + 5) * LANES + i], w[(b + MASS + 6) * LANES + i]
        ixy, ixz, iyz = w[(b + MASS + 7) * LANES + i], w[(b + MASS + 8) * LANES + i], w[(b + MASS + 9) * LANES + i]
        cx, cy, cz = oy * jz - oz * jy, oz * jx - ox * jz, ox * jy - oy * jx
        fx = m * hx + ty * jz - tz * jy + oy * cz - oz * cy
        fy = m * hy + tz * jx - tx * jz + oz * cx - ox * cz
        fz = m * hz + tx * jy - ty * jx + ox * cy - oy * cx
        lx, ly, lz = ixx * ox + ixy * oy + ixz * oz, ixy * ox + iyy * oy + iyz * oz, ixz * ox + iyz * oy + izz * oz
        nx = ixx * tx + ixy * ty + ixz * tz + oy * lz - oz * ly + jy * hz - jz * hy
        ny = ixy * tx + iyy * ty + iyz * tz + oz * lx - ox * lz + jz * hx - jx * hz
        nz = ixz * tx + iyz * ty + izz * tz + ox * ly - oy * lx + jx * hy - jy * hx
        w[(b + TURNED) * LANES + i], w[(b + TURNED + 1) * LANES + i], w[(b + TURNED + 2) * LANES + i] = r0, r1, r2
        w[(b + TURNED + 3) * LANES + i], w[(b + TURNED + 4) * LANES + i], w[(b + TURNED + 5) * LANES + i] = r3, r4, r5
        w[(b + TURNED + 6) * LANES + i], w[(b + TURNED + 7) * LANES + i], w[(b + TURNED + 8) * LANES + i] = r6, r7, r8
        w[(b + APART) * LANES + i], w[(b + APART + 1) * LANES + i], w[(b + APART + 2) * LANES + i] = x, y, z
        w[(b + SPIN) * LANES + i], w[(b + SPIN + 1) * LANES + i], w[(b + SPIN + 2) * LANES + i] = ox, oy, oz
        w[(b + TWIST) * LANES + i], w[(b + TWIST + 1) * LANES + i], w[(b + TWIST + 2) * LANES + i] = tx, ty, tz
        w[(b + FLOW) * LANES + i], w[(b + FLOW + 1) * LANES + i], w[(b + FLOW + 2) * LANES + i] = ux, uy, uz
        w[(b + PULL) * LANES + i], w[(b + PULL + 1) * LANES + i], w[(b + PULL + 2) * LANES + i] = hx, hy, hz
        w[(b + FORCE) * LANES + i], w[(b + FORCE + 1) * LANES + i], w[(b + FORCE + 2) * LANES + i] = fx, fy, fz
        w[(b + FORCE + 3) * LANES + i], w[(b + FORCE + 4) * LANES + i], w[(b + FORCE + 5) * LANES + i] = nx, ny, nz
    for j in range(10 * LANES):
        w[(b + WHOLE) * LANES + j] = w[(b + MASS) * LANES + j]


def carry(w, b, p, start, to):
    """Adds the force and torque at rows b + start, of link b about its origin, to those at rows p + to of its parent."""
    for i in range(LANES):
        r0, r1, r2 = w[(b + TURNED) * LANES + i], w[(b + TURNED + 1) * LANES + i], w[(b + TURNED + 2) * LANES + i]
        r3, r4, r5 = w[(b + TURNED + 3) * LANES + i], w[(b + TURNED + 4) * LANES + i], w[(b + TURNED + 5) * LANES + i]
        r6, r7, r8 = w[(b + TURNED + 6) * LANES + i], w[(b + TURNED + 7) * LANES + i], w[(b + TURNED + 8) * LANES + i]
        x, y, z = w[(b + APART) * LANES + i], w[(b + APART + 1) * LANES + i], w[(b + APART + 2) * LANES + i]
        fx, fy, fz = w[(b + start) * LANES + i], w[(b + start + 1) * LANES + i], w[(b + start + 2) * LANES + i]
        nx, ny, nz = w[(b + start + 3) * LANES + i], w[(b + start + 4) * LANES + i], w[(b + start + 5) * LANES + i]
        gx, gy, gz = r0 * fx + r1 * fy + r2 * fz, r3 * fx + r4 * fy + r5 * fz, r6 * fx + r7 * fy + r8 * fz
        w[(p + to) * LANES + i] += gx
        w[(p + to + 1) * LANES + i] += gy
        w[(p + to + 2) * LANES + i] += gz
        w[(p + to + 3) * LANES + i] += r0 * nx + r1 * ny + r2 * nz + y * gz - z * gy
        w[(p + to + 4) * LANES + i] += r3 * nx + r4 * ny + r5 * nz + z * gx - x * gz
        w[(p + to + 5) * LANES + i] += r6 * nx + r7 * ny + r8 * nz + x * gy - y * gx


def gather(w, b, p):
    """Adds the inertia of what link b carries to that of its parent p."""
    for i in range(LANES):
        r0, r1, r2 = w[(b + TURNED) * LANES + i], w[(b + TURNED + 1) * LANES + i], w[(b + TURNED + 2) * LANES + i]
        r3, r4, r5 = w[(b + TURNED + 3) * LANES + i], w[(b + TURNED + 4) * LANES + i], w[(b + TURNED + 5) * LANES + i]
        r6, r7, r8 = w[(b + TURNED + 6) * LANES + i], w[(b + TURNED + 7) * LANES + i], w[(b + TURNED + 8) * LANES + i]
        x, y, z = w[(b + APART) * LANES + i], w[(b + APART + 1) * LANES + i], w[(b + APART + 2) * LANES + i]
        m, jx = w[(b + WHOLE) * LANES + i], w[(b + WHOLE + 1) * LANES + i]
        jy, jz = w[(b + WHOLE + 2) * LANES + i], w[(b + WHOLE + 3) * LANES + i]
        ixx, iyy, izz = w[(b + WHOLE + 4) * LANES + i], w[(b + WHOLE + 5) * LANES + i], w[(b + WHOLE + 6) * LANES + i]
        ixy, ixz, iyz = w[(b + WHOLE + 7) * LANES + i], w[(b + WHOLE + 8) * LANES + i], w[(b + WHOLE + 9) * LANES + i]
        hx, hy, hz = r0 * jx + r1 * jy + r2 * jz, r3 * jx + r4 * jy + r5 * jz, r6 * jx + r7 * jy + r8 * jz
        a0, a1, a2 = r0 * ixx + r1 * ixy + r2 * ixz, r0 * ixy + r1 * iyy + r2 * iyz, r0 * ixz + r1 * iyz + r2 * izz
        a3, a4, a5 = r3 * ixx + r4 * ixy + r5 * ixz, r3 * ixy + r4 * iyy + r5 * iyz, r3 * ixz + r4 * iyz + r5 * izz
        a6, a7, a8 = r6 * ixx + r7 * ixy + r8 * ixz, r6 * ixy + r7 * iyy + r8 * iyz, r6 * ixz + r7 * iyz + r8 * izz
        along, far = 2.0 * (x * hx + y * hy + z * hz), m * (x * x + y * y + z * z)
        w[(p + WHOLE) * LANES + i] += m
        w[(p + WHOLE + 1) * LANES + i] += hx + m * x
        w[(p + WHOLE + 2) * LANES + i] += hy + m * y
        w[(p + WHOLE + 3) * LANES + i] += hz + m * z
        w[(p + WHOLE + 4) * LANES + i] += a0 * r0 + a1 * r1 + a2 * r2 + along + far - 2.0 * x * hx - m * x * x
        w[(p + WHOLE + 5) * LANES + i] += a3 * r3 + a4 * r4 + a5 * r5 + along + far - 2.0 * y * hy - m * y * y
        w[(p + WHOLE + 6) * LANES + i] += a6 * r6 + a7 * r7 + a8 * r8 + along + far - 2.0 * z * hz - m * z * z
        w[(p + WHOLE + 7) * LANES + i] += a0 * r3 + a1 * r4 + a2 * r5 - x * hy - y * hx - m * x * y
        w[(p + WHOLE + 8) * LANES + i] += a0 * r6 + a1 * r7 + a2 * r8 - x * hz - z * hx - m * x * z
        w[(p + WHOLE + 9) * LANES + i] += a3 * r6 + a4 * r7 + a5 * r8 - y * hz - z * hy - m * y * z


def unit(w, b, slide):
    """Force and torque at rows SHARE of link b for a unit acceleration of its joint, of all that it carries."""
    for i in range(LANES):
        m, jx, jy = w[(b + WHOLE) * LANES + i], w[(b + WHOLE + 1) * LANES + i], w[(b + WHOLE + 2) * LANES + i]
        if slide:
            fx, fy, fz, nx, ny, nz = 0.0, 0.0, m, jy, -jx, 0.0
        else:
            fx, fy, fz = -jy, jx, 0.0
            nx, ny, nz = w[(b + WHOLE + 8) * LANES + i], w[(b + WHOLE + 9) * LANES + i], w[(b + WHOLE + 6) * LANES + i]
        w[(b + SHARE) * LANES + i], w[(b + SHARE + 1) * LANES + i], w[(b + SHARE + 2) * LANES + i] = fx, fy, fz
        w[(b + SHARE + 3) * LANES + i], w[(b + SHARE + 4) * LANES + i], w[(b + SHARE + 5) * LANES + i] = nx, ny, nz


def inertias(w, n, parent, slide, inertia):
    """Carries the links' forces to the joints, and fills the matrix of inertia (n, n) at rows `inertia` on, its lower part."""
    for k in range(n - 1, -1, -1):
        b = (1 + k) * BLOCK
        unit(w, b, slide[k])
        at = k
        while at >= 0:
            row = inertia + k * n + at
            seen = (1 + at) * BLOCK + SHARE + (2 if slide[at] else 5)
            for i in range(LANES):
                w[row * LANES + i] = w[seen * LANES + i]
            if parent[at] >= 0:
                above = (1 + parent[at]) * BLOCK
                for j in range(SHARE * LANES, (SHARE + 6) * LANES):
                    w[above * LANES + j] = 0.0
                carry(w, (1 + at) * BLOCK, above, SHARE, SHARE)
            at = parent[at]
        if parent[k] >= 0:
            above = (1 + parent[k]) * BLOCK
            carry(w, b, above, FORCE, FORCE)
            gather(w, b, above)


def drag(w, i, parent, slide, boxes, owner, density, viscosity, slopes, v):
    """Takes the drag of the medium at the box of each body's inertia off its link's force; adds -dF/dv to `slopes` (n, n).

    boxes (B, 15): sides, centre and axes in the link's frame. v (n + 3, 9) is scratch.
    """
    n = len(parent)
    r, t, f = (v[n], v[n + 1], v[n + 2])  # its axes, the same in the frame before, slopes and place
    for k in range(len(owner)):
        b = (1 + owner[k]) * BLOCK
        wide = (boxes[k, 0] + boxes[k, 1] + boxes[k, 2]) / 3.0
        x, y, z = boxes[k, 3], boxes[k, 4], boxes[k, 5]
        ox, oy, oz = w[(b + SPIN) * LANES + i], w[(b + SPIN + 1) * LANES + i], w[(b + SPIN + 2) * LANES + i]
        ux = w[(b + FLOW) * LANES + i] + oy * z - oz * y
        uy = w[(b + FLOW + 1) * LANES + i] + oz * x - ox * z
        uz = w[(b + FLOW + 2) * LANES + i] + ox * y - oy * x
        fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(3):
            e0, e1, e2 = boxes[k, 6 + j], boxes[k, 9 + j], boxes[k, 12 + j]
            r[j], r[3 + j], r[6 + j] = e0, e1, e2
            one, two = boxes[k, (j + 1) % 3], boxes[k, (j + 2) % 3]
            spin, flow = e0 * ox + e1 * oy + e2 * oz, e0 * ux + e1 * uy + e2 * uz
            thick, turning = 3.0 * np.pi * wide * viscosity, np.pi * wide * wide * wide * viscosity
            broad = 0.5 * density * one * two
            one, two = one * one, two * two
            paddle = density * boxes[k, j] * (one * one + two * two) / 64.0
            force, torque = -(thick + broad * abs(flow)) * flow, -(turning + paddle * abs(spin)) * spin
            f[j], f[3 + j] = turning + 2.0 * paddle * abs(spin), thick + 2.0 * broad * abs(flow)
            fx, fy, fz = fx + e0 * force, fy + e1 * force, fz + e2 * force
            nx, ny, nz = nx + e0 * torque, ny + e1 * torque, nz + e2 * torque
        w[(b + FORCE) * LANES + i] -= fx
        w[(b + FORCE + 1) * LANES + i] -= fy
        w[(b + FORCE + 2) * LANES + i] -= fz
        w[(b + FORCE + 3) * LANES + i] -= nx + y * fz - z * fy
        w[(b + FORCE + 4) * LANES + i] -= ny + z * fx - x * fz
        w[(b + FORCE + 5) * LANES + i] -= nz + x * fy - y * fx
        # spin and flow at the body, in its axes, by a unit rate of each joint before it
        at = owner[k]
        while at >= 0:
            for j in range(3):
                along, across = r[6 + j], r[3 + j] * x - r[j] * y
                v[at, j], v[at, 3 + j] = (0.0, along) if slide[at] else (along, across)
            one = owner[k]
            while True:
                total = 0.0
                for j in range(6):
                    total += v[one, j] * f[j] * v[at, j]
                slopes[one, at] += total
                if one == at:
                    break
                one = parent[one]
            a = (1 + at) * BLOCK
            for j in range(3):
                g0, g1 = w[(a + TURNED + 3 * j) * LANES + i], w[(a + TURNED + 3 * j + 1) * LANES + i]
                g2 = w[(a + TURNED + 3 * j + 2) * LANES + i]
                for l in range(3):
                    t[3 * j + l] = g0 * r[l] + g1 * r[3 + l] + g2 * r[6 + l]
                f[6 + j] = w[(a + APART + j) * LANES + i] + g0 * x + g1 * y + g2 * z
            x, y, z = f[6], f[7], f[8]
            for j in range(9):
                r[j] = t[j]
            at = parent[at]


def solve(a, n, x):
    """Solves a x = x in place, a (n, n) symmetric and positive, its lower part given; a becomes its Cholesky factor."""
    for j in range(n):
        for k in range(j):
            s = a[j, k]
            for l in range(k):
                s -= a[j, l] * a[k, l]
            a[j, k] = s / a[k, k]
        s = a[j, j]
        for l in range(j):
            s -= a[j, l] * a[j, l]
        a[j, j] = np.sqrt(s)
        s = x[j]
        for l in range(j):
            s -= a[j, l] * x[l]
        x[j] = s / a[j, j]
    for j in range(n - 1, -1, -1):
        s = x[j]
        for l in range(j + 1, n):
            s -= a[l, j] * x[l]
        x[j] = s / a[j, j]


def rub(m, n, smooth, limit, soft, aim, sticks, out, a, x):
    """Forces `out` (n,) of dry friction: least of (x - M^-1 f)^T M (x - M^-1 f) / 2 + sum of Huber's cost of x - aim.

    limit (n,) N m, 0 without friction; soft: R of MuJoCo's constraint; aim: its reference acceleration. sticks: 0 for a joint
    within its limit, else the sign of the force; that of the step before on entry. Returns False if it does not settle.
    """
    for attempt in range(60):
        for j in range(n):
            for k in range(j + 1):
                a[j, k] = m[j, k]
            x[j] = smooth[j]
            if limit[j] > 0.0:
                if sticks[j] == 0:
                    a[j, j] += 1.0 / soft[j]
                    x[j] += aim[j] / soft[j]
                else:
                    x[j] += sticks[j] * limit[j]
        solve(a, n, x)
        same = True
        for j in range(n):
            same = same and (limit[j] <= 0.0 or stuck((x[j] - aim[j]) / soft[j], limit[j]) == sticks[j])
        if same:
            for j in range(n):
                out[j] = 0.0 if limit[j] <= 0.0 else sticks[j] * limit[j] if sticks[j] != 0 else -(x[j] - aim[j]) / soft[j]
            return True
        high = 1.0
        if attempt and slope(m, n, smooth, limit, soft, aim, out, x, 1.0) > 0.0:  # beyond the least along the way
            low = 0.0
            for _ in range(50):
                middle = 0.5 * (low + high)
                if slope(m, n, smooth, limit, soft, aim, out, x, middle) > 0.0:
                    high = middle
                else:
                    low = middle
        for j in range(n):
            out[j] = out[j] + high * (x[j] - out[j]) if attempt else x[j]
            sticks[j] = stuck((out[j] - aim[j]) / soft[j], limit[j])
    return False


def stuck(off, limit):
    """0 where a force of -off is within the limit, else its sign."""
    return 1 if off <= -limit else -1 if off >= limit else 0


def slope(m, n, smooth, limit, soft, aim, begin, end, share):
    """Derivative of the cost of `rub` along the way from `begin` to `end`, at a share of it."""
    total = 0.0
    for j in range(n):
        force = -smooth[j]
        for k in range(n):
            inertia = m[j, k] if k <= j else m[k, j]
            force += inertia * (begin[k] + share * (end[k] - begin[k]))
        if limit[j] > 0.0:
            off = (begin[j] + share * (end[j] - begin[j]) - aim[j]) / soft[j]
            force += min(max(off, -limit[j]), limit[j])
        total += (end[j] - begin[j]) * force
    return total


def roll(first, stop, which, models, bodies, medium, laws, tree, driven, begins, inputs, pushed, euler, out, ok):
    """Rollouts first..stop (first a multiple of LANES); ok[r] is False where MuJoCo itself has to be asked.

    which (R,) model; models (M, GROUND + n JOINT + drives DRIVE), bodies (M, B, 15), medium (M, 2) density and viscosity, laws
    (M, n, WIDTH). tree (3, max(n, B)): parent of each link, whether it slides, link of each body; driven (A,) link.
    begins (R, 1 + 2 n), inputs (R, T, A), pushed (R, T, n) or (R, 0, n), out (R, T, 1 + 2 n).
    """
    n, actuators, steps = (begins.shape[1] - 1) // 2, inputs.shape[2], inputs.shape[1]
    parent, slide, owner = tree[0, :n], tree[1, :n], tree[2, : bodies.shape[1]]
    inertia = (1 + n) * BLOCK
    w = np.zeros((inertia + n * n) * LANES)
    m, a, slopes, v = np.zeros((n, n)), np.zeros((n, n)), np.zeros((LANES, n, n)), np.zeros((n + 3, 9))
    smooth, limit, soft, aim, x, rest = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    held = np.zeros(n)
    sticks = np.zeros((LANES, n), np.int64)
    memory = np.zeros((LANES, n, MEMORY))
    viscous = False
    for block in range(first, stop, LANES):
        lanes_here = min(LANES, stop - block)
        sticks[:] = 0
        memory[:] = 0.0
        viscous = False
        for i in range(LANES):
            r = min(block + i, stop - 1)
            p = models[which[r]]
            viscous = viscous or medium[which[r], 0] > 0.0 or medium[which[r], 1] > 0.0
            for j in range(3):
                w[(PULL + j) * LANES + i], w[(FLOW + j) * LANES + i] = -p[j], -p[3 + j]
            for k in range(n):
                b, at = (1 + k) * BLOCK, GROUND + k * JOINT
                for j in range(22):
                    w[(b + PLACE + j) * LANES + i] = p[at + j]
                w[(b + ANGLE) * LANES + i] = begins[r, 1 + k] - p[at + ZERO]
                w[(b + RATE) * LANES + i] = begins[r, 1 + n + k]
        for step in range(steps):
            for k in range(n):
                down(w, (1 + k) * BLOCK, (1 + parent[k]) * BLOCK, slide[k])
            if viscous:
                slopes[:] = 0.0
                for i in range(lanes_here):
                    mine = which[block + i]
                    if medium[mine, 0] > 0.0 or medium[mine, 1] > 0.0:
                        drag(w, i, parent, slide, bodies[mine], owner, medium[mine, 0], medium[mine, 1], slopes[i], v)
            inertias(w, n, parent, slide, inertia)
            for i in range(lanes_here):
                r = block + i
                p, table, time = models[which[r]], laws[which[r]], begins[r, 0] + step * models[which[r], STEP]
                h = p[STEP]
                any_limit = False
                for k in range(n):
                    b, at = (1 + k) * BLOCK, GROUND + k * JOINT
                    q, rate = w[(b + ANGLE) * LANES + i], w[(b + RATE) * LANES + i]
                    if not (p[at + LOW] < q + p[at + ZERO] < p[at + HIGH]) or not abs(rate) < WILD:
                        ok[r] = False
                    for j in range(k + 1):
                        m[k, j] = 0.0
                    j = k
                    while j >= 0:
                        m[k, j] = w[(inertia + k * n + j) * LANES + i]
                        j = parent[j]
                    m[k, k] += p[at + ARMATURE]
                    speed = abs(rate)
                    damping = p[at + DAMPING] + speed * (p[at + DAMPING + 1] + speed * p[at + DAMPING + 2])
                    steep = p[at + DAMPING] + speed * (2.0 * p[at + DAMPING + 1] + 3.0 * speed * p[at + DAMPING + 2])
                    smooth[k] = -w[(b + FORCE + (2 if slide[k] else 5)) * LANES + i] - damping * rate
                    smooth[k] -= p[at + STIFF] * (q + p[at + ZERO] - p[at + STIFF + 1])
                    rest[k] = steep
                    limit[k], soft[k], aim[k] = p[at + RUB], p[at + RUB + 1], -p[at + RUB + 2] * rate
                    if pushed.shape[1]:
                        smooth[k] += pushed[r, step, k]
                    held[k] = 0.0
                for d in range(actuators):
                    k, at = driven[d], GROUND + n * JOINT + d * DRIVE
                    b = (1 + k) * BLOCK
                    gear = p[at]
                    length = gear * (w[(b + ANGLE) * LANES + i] + p[GROUND + k * JOINT + ZERO])
                    velocity = gear * w[(b + RATE) * LANES + i]
                    u = min(max(inputs[r, step, d], p[at + 7]), p[at + 8])
                    force = (p[at + 1] + p[at + 2] * length + p[at + 3] * velocity) * u
                    force += p[at + 4] + p[at + 5] * length + p[at + 6] * velocity
                    if p[at + 9] < force < p[at + 10] and not euler:
                        rest[k] -= gear * gear * (p[at + 6] + p[at + 3] * inputs[r, step, d])
                    force = min(max(force, p[at + 9]), p[at + 10])
                    held[k] = min(max(gear * force, p[at + 11]), p[at + 12])
                    smooth[k] += held[k]
                for k in range(n):
                    if table[k, ACTIVE] != 0.0:
                        b, at = (1 + k) * BLOCK, GROUND + k * JOINT
                        q, rate = w[(b + ANGLE) * LANES + i] + p[at + ZERO], w[(b + RATE) * LANES + i]
                        torque, most = act(table[k], q, rate, held[k], time, memory[i, k])
                        smooth[k] += torque
                        limit[k] += most
                    any_limit = any_limit or limit[k] > 0.0
                if any_limit:
                    if not rub(m, n, smooth, limit, soft, aim, sticks[i], held, a, x):
                        ok[r] = False
                    for k in range(n):
                        smooth[k] += held[k]
                for k in range(n):
                    for j in range(k + 1):
                        a[k, j] = m[k, j]
                    a[k, k] += h * rest[k]
                if viscous and not euler:
                    for k in range(n):
                        for j in range(k + 1):
                            a[k, j] += h * slopes[i, k, j]
                solve(a, n, smooth)
                out[r, step, 0] = time + h
                for k in range(n):
                    b, at = (1 + k) * BLOCK, GROUND + k * JOINT
                    w[(b + RATE) * LANES + i] += h * smooth[k]
                    w[(b + ANGLE) * LANES + i] += h * w[(b + RATE) * LANES + i]
                    out[r, step, 1 + k] = w[(b + ANGLE) * LANES + i] + p[at + ZERO]
                    out[r, step, 1 + n + k] = w[(b + RATE) * LANES + i]
                    if not abs(w[(b + RATE) * LANES + i]) < WILD:
                        ok[r] = False
