"""The planar fish in closed form: N links, 2 + N degrees of freedom, the water's added mass in the mass matrix.

    (M + M_a + h D) a = f_servo - c + Q_water          M_a is up to 22 times M, so it is solved implicitly
    v' = v + h a,   q' = q + h v'                      semi-implicit Euler with implicit joint damping D, as MuJoCo's

q = (x, y, psi, j_1 .. j_{N-1}): reference point in the world [m], heading and joint angles [rad].
The equations use head axes and absolute link rates Omega_i = psi' + j_1' + .. + j_i'. Link i starts at P_i, and
    V_i = V + sum_{j<i} d_j Omega_j n_j,   A_i = A + sum_{j<i} d_j (alpha_j n_j - Omega_j^2 t_j),   b_j = d_j n_j
    K_i = m_i 1 + m0_i n n^T,  S_i = m_i s_i + m1_i,  J_i = I_i + m_i s_i^2 + m2_i
    M_xj = g_j = (sum_{i>j} K_i) b_j + S_j n_j,   M_jk = b_j . g_k (j < k),   M_jj = b_j . (sum_{i>j} K_i) b_j + J_j
Featherstone 2008 gives the rigid part; it equals MuJoCo's mass matrix and bias to round-off (tests/test_mjcf.py).

Every quantity is a list of scalars or of arrays of one shape, so that one definition serves NumPy, JAX, MJX and the compiled CPU
engine, which is generated from it.
"""

from typing import Any, NamedTuple

from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import Geometry, geometry_of
from fishmj.water.dynamics import strip_forces


class Chain(NamedTuple):
    """Constants of one robot, plain floats."""

    n: int  # links
    d: tuple  # N-1: from a link's origin to its rear hinge along t, m (negative)
    com: tuple  # N, m
    inertia: tuple  # N at the centre of mass, kg m2, for unit mass scale
    mass: tuple  # N, kg, for unit mass scale
    strips: strip_forces.Strips
    torque: float  # servo stall torque, N m
    dt: float  # physics step, s
    motor: float = 1.0  # servo torque constant, V s/rad = N m/A


class Swimmer(NamedTuple):
    """Constants that may differ from fish to fish (domain randomisation). Lists of scalars or arrays of one batch shape."""

    mass: Any  # [N] factor on mass and inertia
    kp: Any  # [N-1] N m/rad
    kv: Any  # [N-1] N m s/rad, damping added by the controller
    kb: Any  # [N-1] N m s/rad, back-EMF slope (joint damping)
    zero: Any  # [N-1] rad, hinge angle at which the encoder reads zero
    water: strip_forces.Coefficients
    net: Any = 0  # which of the learnt residuals, in a family of waters that has several


class Links(NamedTuple):
    """Kinematics of every link in head axes, one list entry for each link."""

    t: list  # (tx, ty)
    n: list  # (nx, ny)
    omega: list  # yaw rate, relative to the water's rotation if its velocity varies along the link
    u: list  # t.(V_i - U_i)
    w: list  # n.(V_i - U_i), U_i at the link's centre, or at its origin if the water's velocity varies along the link
    bias: list  # A_i for zero generalised acceleration, (x, y)
    rates: Any = ()  # yaw rate in the world, if omega is a relative one

    @property
    def own(self) -> list:
        """Yaw rate of each link in the world, rad/s."""
        return self.rates or self.omega


def chain_of(robot: Robot, geometry: Geometry | None = None) -> Chain:
    """Constants of `robot`."""
    g = geometry_of(robot) if geometry is None else geometry
    line = lambda a: tuple(float(v) for v in a)
    strips = strip_forces.strips(g, robot.density_water, robot.water)
    if robot.water.get("model") == "none":
        strips = strips._replace(displaced=line(0.0 * g.displaced))  # a stream in air carries nothing along
    return Chain(
        n=g.n_links,
        d=line(g.joint),
        com=line(g.com[:, 0]),
        inertia=line(g.inertia[:, 2]),
        mass=line(g.mass),
        strips=strips,
        torque=robot.servo.torque,
        dt=robot.timing.physics_dt,
        motor=robot.servo.constant,
    )


def nominal(robot: Robot) -> Swimmer:
    """Calibrated fish without randomisation, as lists of floats."""
    links, s = len(robot.links), robot.servo
    kp, kv, kb, zero = ([value] * (links - 1) for value in (s.kp, s.kv, s.kb, 0.0))
    return Swimmer([1.0] * links, kp, kv, kb, zero, strip_forces.coefficients(robot.water, links))


def kinematics(xp, ch: Chain, q, v, flow) -> Links:
    """Link axes and relative velocities. flow: N pairs of world-frame water velocity at each link [m/s].

    A third entry is the velocity gradient along the link, n . dU/ds [1/s]; the pair is then the velocity at the link's origin.
    """
    cp, sp = xp.cos(q[2]), xp.sin(q[2])
    vel = (cp * v[0] + sp * v[1], cp * v[1] - sp * v[0])
    one = 0.0 * q[2] + 1.0
    t, n, omega, u, w, bias = [(one, 0.0 * one)], [(0.0 * one, one)], [v[2]], [], [], [(0.0, 0.0)]
    angle = 0.0
    for i in range(ch.n):
        if i > 0:
            angle = angle + q[2 + i]
            c, s = xp.cos(angle), xp.sin(angle)
            d, rate = ch.d[i - 1], omega[i - 1]
            vel = (vel[0] + d * rate * n[i - 1][0], vel[1] + d * rate * n[i - 1][1])
            push = d * rate * rate
            bias.append((bias[i - 1][0] - push * t[i - 1][0], bias[i - 1][1] - push * t[i - 1][1]))
            t.append((c, s))
            n.append((-s, c))
            omega.append(rate + v[2 + i])
        water = (cp * flow[i][0] + sp * flow[i][1], cp * flow[i][1] - sp * flow[i][0])
        rel = (vel[0] - water[0], vel[1] - water[1])
        u.append(rel[0] * t[i][0] + rel[1] * t[i][1])
        w.append(rel[0] * n[i][0] + rel[1] * n[i][1])
    if len(flow[0]) > 2:
        return Links(t, n, [rate - water[2] for rate, water in zip(omega, flow, strict=True)], u, w, bias, omega)
    return Links(t, n, omega, u, w, bias)


def mass_matrix(ch: Chain, sw: Swimmer, k: Links, *, rigid: bool = True, water: bool = True):
    """Lower triangle (rows) of M, M_a or M + M_a over (ax, ay, alpha_0 .. alpha_{N-1}) in head axes."""
    size = ch.n + 2
    m: list[list[Any]] = [[0.0] * (r + 1) for r in range(size)]
    kxx = kxy = kyy = 0.0  # sum of K_i over the links behind
    g: list[Any] = [None] * ch.n
    for i in reversed(range(ch.n)):
        mi = sw.mass[i] * ch.mass[i] if rigid else 0.0
        m0, m1, m2 = (sw.water.k[i] * ch.strips.mu[i][j] if water else 0.0 for j in range(3))
        nx, ny = k.n[i]
        first = mi * ch.com[i] + m1
        second = (sw.mass[i] * ch.inertia[i] if rigid else 0.0) + mi * ch.com[i] ** 2 + m2
        if i < ch.n - 1:
            bx, by = ch.d[i] * nx, ch.d[i] * ny
            cx, cy = kxx * bx + kxy * by, kxy * bx + kyy * by
            m[2 + i][2 + i] = bx * cx + by * cy + second
            g[i] = (cx + first * nx, cy + first * ny)
        else:
            m[2 + i][2 + i] = second
            g[i] = (first * nx, first * ny)
        m[2 + i][0], m[2 + i][1] = g[i]
        for j in range(i):
            m[2 + i][2 + j] = ch.d[j] * (k.n[j][0] * g[i][0] + k.n[j][1] * g[i][1])
        kxx = kxx + mi + m0 * nx * nx
        kxy = kxy + m0 * nx * ny
        kyy = kyy + mi + m0 * ny * ny
    m[0][0], m[1][0], m[1][1] = kxx, kxy, kyy
    return m


def gather(ch: Chain, k: Links, forces):
    """Generalised force over (ax, ay, alpha_i) from per-link (F_t, F_n, moment about P_i)."""
    fx = fy = 0.0
    out = [0.0] * (ch.n + 2)
    for i in reversed(range(ch.n)):
        ft, fn, moment = forces[i]
        if i < ch.n - 1:
            moment = moment + ch.d[i] * (k.n[i][0] * fx + k.n[i][1] * fy)
        out[2 + i] = moment
        fx = fx + ft * k.t[i][0] + fn * k.n[i][0]
        fy = fy + ft * k.t[i][1] + fn * k.n[i][1]
    out[0], out[1] = fx, fy
    return out


def bias_forces(ch: Chain, sw: Swimmer, k: Links, *, rigid: bool = True, water: bool = True):
    """Per-link minus (inertia x centripetal acceleration), rigid and added-mass parts: (F_t, F_n, moment)."""
    out = []
    for i in range(ch.n):
        at = k.bias[i][0] * k.t[i][0] + k.bias[i][1] * k.t[i][1]
        an = k.bias[i][0] * k.n[i][0] + k.bias[i][1] * k.n[i][1]
        mi = sw.mass[i] * ch.mass[i] if rigid else 0.0
        m0, m1 = (sw.water.k[i] * ch.strips.mu[i][j] if water else 0.0 for j in range(2))
        ft = -mi * (at - ch.com[i] * k.own[i] * k.own[i])
        out.append((ft, -(mi + m0) * an, -(mi * ch.com[i] + m1) * an))
    return out


def water_forces(xp, ch: Chain, sw: Swimmer, k: Links, heading, ambient, attached):
    """Water forces on each link except M_a a: strips, trailing edge, ambient acceleration [world m/s2], bias of M_a."""
    cp, sp = xp.cos(heading), xp.sin(heading)
    dx, dy = cp * ambient[0] + sp * ambient[1], cp * ambient[1] - sp * ambient[0]
    out = []
    for i, bias in enumerate(bias_forces(ch, sw, k, rigid=False)):
        du_t, du_n = dx * k.t[i][0] + dy * k.t[i][1], dx * k.n[i][0] + dy * k.n[i][1]
        force = strip_forces.link_forces(xp, ch.strips, sw.water, i, k.u[i], k.w[i], k.omega[i], du_t, du_n, attached, k.own[i])
        out.append(tuple(a + b for a, b in zip(force, bias, strict=True)))
    return out


def servo_drive(xp, ch: Chain, sw: Swimmer, q, v, target):
    """Drive torque before back-EMF, clipped to the stall torque; target is the encoder angle [rad] of each joint."""
    out = []
    for j in range(ch.n - 1):
        raw = sw.kp[j] * (target[j] + sw.zero[j] - q[3 + j]) - sw.kv[j] * v[3 + j]
        out.append(xp.minimum(xp.maximum(raw, -ch.torque), ch.torque))
    return out


def electrical_power(xp, sw: Swimmer, v, drive):
    """Sum over servos of V i with V = drive R/K, i = (drive - kb w)/K, K^2/R = kb; no regeneration [W]."""
    power = 0.0
    for j, d in enumerate(drive):
        power = power + xp.maximum(d * (d - sw.kb[j] * v[3 + j]) / sw.kb[j], 0.0)
    return power


def to_world(xp, ch: Chain, heading, a):
    """(ax, ay, alpha_i) in head axes -> (x, y, psi, j) accelerations in the world."""
    cp, sp = xp.cos(heading), xp.sin(heading)
    return [cp * a[0] - sp * a[1], sp * a[0] + cp * a[1], a[2]] + [a[2 + i] - a[1 + i] for i in range(1, ch.n)]


def generalised(xp, ch: Chain, heading, f):
    """Forces over (ax, ay, alpha_i) in head axes -> generalised forces over (x, y, psi, j)."""
    cp, sp = xp.cos(heading), xp.sin(heading)
    out = [cp * f[0] - sp * f[1], sp * f[0] + cp * f[1]]
    tail = 0.0
    rest = []
    for i in reversed(range(ch.n)):
        tail = tail + f[2 + i]
        rest.append(tail)
    return out + rest[::-1]


class Step(NamedTuple):
    """Result of one physics step, component lists."""

    q: list
    v: list
    attached: Any
    power: Any  # servos only, W
    applied: list  # generalised force that makes MuJoCo take the same step, N and N m
    accel: list  # (ax, ay, alpha_i) in head axes
    memory: tuple = ()  # memory of the hooks


def step(xp, ch: Chain, sw: Swimmer, q, v, attached, target, flow, ambient, hooks=None) -> Step:
    """Does one physics step of ch.dt.

    Args:
        q, v: 2 + N generalised positions and velocities (m, rad; world frame).
        attached: attachment state of the tail, 0..1.
        target: commanded encoder angle of each joint, rad.
        flow: N pairs, water velocity at each link, m/s, world frame.
        ambient: pair, DU/Dt of the uniform part of the flow, m/s2.
        hooks: additions to the fish at the sites of hooks.py; None adds nothing and costs nothing.
    """
    h = ch.dt
    # originals for `applied`: MuJoCo has the robot as described, without the hooks' changes
    given = (ch, sw)
    if hooks is not None:
        ch, sw = hooks.fish(ch, sw)
        flow = hooks.flow(ch, q, flow)
    k = kinematics(xp, ch, q, v, flow)
    if hooks is None:
        drive, resist = servo_drive(xp, ch, sw, q, v, target), [0.0] * (ch.n - 1)
    else:
        drive, resist = hooks.servos(ch, sw, q, v, target)
    # forces use the velocities before the step. Those proportional to the acceleration are in the matrix: an added mass of up to
    # 22 times M with a delay of one step would be unstable at any step size
    hydro = water_forces(xp, ch, sw, k, q[2], ambient, attached)
    if hooks is not None:
        hydro = hooks.water(ch, sw, q, k, hydro)
    rigid = bias_forces(ch, sw, k, water=False)
    rhs = gather(ch, k, [tuple(a + b for a, b in zip(f, r, strict=True)) for f, r in zip(hydro, rigid, strict=True)])
    m = mass_matrix(ch, sw, k)
    if hooks is not None:
        hooks.body(ch, sw, q, k, rhs, m)
    # back-EMF is stiff: h kb is many times the inertia of a middle link, so explicit damping would need a much smaller step
    damp_joints(ch, v, drive, [kb + r for kb, r in zip(sw.kb, resist, strict=True)], rhs, m)
    a = solve(m, rhs)
    if hooks is None:
        # without hooks MuJoCo lacks only the water, Q - M_a a; hooks may change any term, so the full force balance is used
        added = mass_matrix(ch, sw, k, rigid=False)
        inertia = [sum(added[max(r, c)][min(r, c)] * a[c] for c in range(ch.n + 2)) for r in range(ch.n + 2)]
        applied = generalised(xp, ch, q[2], [f - g for f, g in zip(gather(ch, k, hydro), inertia, strict=True)])
    else:
        applied = generalised(xp, ch, q[2], missing(xp, *given, q, v, target, k, a))
    accel = to_world(xp, ch, q[2], a)
    v_new = [vi + h * ai for vi, ai in zip(v, accel, strict=True)]
    # semi-implicit Euler uses the new velocity, and keeps the energy of a swinging joint bounded; explicit Euler adds energy
    q_new = [qi + h * vi for qi, vi in zip(q, v_new, strict=True)]
    last = ch.n - 1
    # uses the motion before the step, as `Handle.step` does, so that all engines agree to round-off
    x_new = strip_forces.attachment(xp, ch.strips, sw.water, k.u[last], k.w[last], k.omega[last], attached, h)
    power = electrical_power(xp, sw, v, drive)
    memory = () if hooks is None else tuple(hooks.end(ch, sw, v, drive))
    return Step(q_new, v_new, x_new, power, applied, a, memory)


def damp_joints(ch: Chain, v, drive, damping, rhs, m) -> None:
    """Adds each joint's torque, drive - D w, to rhs and its damping h D to m; implicit, as MuJoCo's Euler does.

    Joint j sits between links j and j + 1.
    """
    for j in range(ch.n - 1):
        torque, hb = drive[j] - damping[j] * v[3 + j], ch.dt * damping[j]
        rhs[3 + j], rhs[2 + j] = rhs[3 + j] + torque, rhs[2 + j] - torque
        m[3 + j][3 + j], m[2 + j][2 + j] = m[3 + j][3 + j] + hb, m[2 + j][2 + j] + hb
        m[3 + j][2 + j] = m[3 + j][2 + j] - hb


def missing(xp, ch: Chain, sw: Swimmer, q, v, target, k: Links, a) -> list:
    """Force that MuJoCo, with the rigid fish and its servos, lacks for the acceleration a: (M + h D) a - drive + D w - c."""
    rhs = gather(ch, k, bias_forces(ch, sw, k, water=False))
    m = mass_matrix(ch, sw, k, water=False)
    damp_joints(ch, v, servo_drive(xp, ch, sw, q, v, target), sw.kb, rhs, m)
    size = range(ch.n + 2)
    return [sum(m[max(r, c)][min(r, c)] * a[c] for c in size) - rhs[r] for r in size]


def solve(m, rhs):
    """Solves A x = rhs for a symmetric positive definite A given by its lower triangle (LDL^T, unrolled); returns x."""
    size = len(rhs)
    # LDL^T instead of Cholesky avoids square roots, and needs one reciprocal for each column
    low = [[None] * size for _ in range(size)]
    inv = [None] * size
    for j in range(size):
        pivot = m[j][j]
        for k in range(j):
            pivot = pivot - low[j][k][0] * low[j][k][1]
        inv[j] = 1.0 / pivot
        for i in range(j + 1, size):
            value = m[i][j]
            for k in range(j):
                value = value - low[i][k][1] * low[j][k][0]
            # L_ij D_j is needed twice below, so the table holds both
            low[i][j] = (value * inv[j], value)  # (L_ij, L_ij D_j)
    x = list(rhs)
    # L y = b, then D L^T x = y. No pivoting: A is positive definite, and row exchanges, which depend on values, are impossible in
    # straight-line code for a batch
    for i in range(size):
        for k in range(i):
            x[i] = x[i] - low[i][k][0] * x[k]
    for i in reversed(range(size)):
        x[i] = x[i] * inv[i]
        for k in range(i + 1, size):
            x[i] = x[i] - low[k][i][0] * x[k]
    return x
