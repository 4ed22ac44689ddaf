"""Pose, mass matrix and joint forces of an articulated body with any number of links, computed by one block of threads.

    S_d = (a_d, (o_d - r) x a_d) of a hinge, (0, a_d) of a slide      motion per unit speed of degree of freedom d
    c_d = v_d (V x S_d)                                               V: of the frame that carries d; how S_d v_d turns with it
    V_l = sum_d S_d v_d,   A_l = sum_d c_d                            over the d that move link l, at no joint acceleration
    N_l, F_l = I_l A_l + V_l x* I_l V_l - m_l g                       moment about r and force that this takes
    bias_d = S_d . sum_l (N_l, F_l)                                   over the links that d moves: Coriolis, centrifugal, weight
    M_ij = S_i . (I_j S_j),   I_j = sum_l I_l                         over the links that j moves; for i that moves j's link
    servo = clip(gain clip(u) + b_0 + b_1 q + b_2 v)                  passive = -D v

(Featherstone 2008, Rigid Body Dynamics Algorithms, chapters 5 and 6; sums over all links replace the recursions, so that each
thread has its own sum.) All motion is about one point r of the world, the origin of the first link's frame: the world's origin
would cost digits. Free joints turn about their body's axes and move along the world's axes, as MuJoCo's do.

MuJoCo computes the same on the host (`body.py`). This module computes it on a device that must not wait for the host.
"""

from typing import Any

import mujoco
import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed.fsi_solve import wait_for_block
from fishmj.lbm_oracle.immersed.link_dynamics import store_vec3

wp.set_module_options({"enable_backward": False})

FREE, SLIDE, HINGE = (
    int(kind) for kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
)


@wp.struct
class Tree:
    """Constants of the body: L links, J joints, n degrees of freedom, Q coordinates; float64, SI."""

    links: int
    joints: int
    dofs: int
    parent: wp.array(dtype=int)  # L; -1 is the world
    place: wp.array(dtype=wp.float64)  # 3 L, in the parent's frame
    turn: wp.array(dtype=wp.float64)  # 9 L
    begin: wp.array(dtype=int)  # L + 1, first joint of each link
    kind: wp.array(dtype=int)  # J
    axis: wp.array(dtype=wp.float64)  # 3 J, in the link's frame
    anchor: wp.array(dtype=wp.float64)  # 3 J
    coordinate: wp.array(dtype=int)  # J, address in qpos
    zero: wp.array(dtype=wp.float64)  # J
    first: wp.array(dtype=int)  # J, address of its degrees of freedom
    hinge: wp.array(dtype=int)  # L, address in qpos of the angle that bends the skin; -1 for none
    reach: wp.array(dtype=wp.float64)  # L n, whether the degree of freedom moves the link
    carrier: wp.array(dtype=int)  # n, link of the degree of freedom
    before: wp.array(dtype=int)  # n, degrees of freedom from here on do not move the frame that carries this one
    spins: wp.array(dtype=int)  # n
    mass: wp.array(dtype=wp.float64)  # L
    centre: wp.array(dtype=wp.float64)  # 3 L
    inertia: wp.array(dtype=wp.float64)  # 9 L, about it
    armature: wp.array(dtype=wp.float64)  # n
    damping: wp.array(dtype=wp.float64)  # n
    gravity: wp.vec3d
    servo: wp.array(dtype=int)  # n, -1 for none
    gain: wp.array(dtype=wp.float64)  # n
    law: wp.array(dtype=wp.float64)  # 3 n, b
    force_range: wp.array(dtype=wp.float64)  # 2 n
    range: wp.array(dtype=wp.float64)  # 2 n, of the command
    measured: wp.array(dtype=int)  # n, address in qpos of what the servo measures


@wp.struct
class Motion:
    """State of the body, and quantities derived from it."""

    qpos: wp.array(dtype=wp.float64)  # Q
    qvel: wp.array(dtype=wp.float64)  # n
    command: wp.array(dtype=wp.float64)  # of the servos, rad
    pose: wp.array(dtype=wp.float64)  # 12 L + L + 3 n + 3 n: frames, angles, axes a, anchors o
    screw: wp.array(dtype=wp.float64)  # 6 n, S
    drift: wp.array(dtype=wp.float64)  # 6 n, c
    momentum: wp.array(dtype=wp.float64)  # 6 n, I_j S_j
    arm: wp.array(dtype=wp.float64)  # 3 L, centres of mass from r
    turned: wp.array(dtype=wp.float64)  # 9 L, inertia about them in the world's axes
    force: wp.array(dtype=wp.float64)  # 6 L, (N, F)
    mass_matrix: wp.array(dtype=wp.float64)  # n n
    bias: wp.array(dtype=wp.float64)  # n
    actuator: wp.array(dtype=wp.float64)  # n
    passive: wp.array(dtype=wp.float64)  # n


@wp.func_native("for (int i = 0; i < 9; ++i) a.data[at + i] = m.data[i / 3][i % 3];")
def store_mat33(a: wp.array(dtype=wp.float64), at: int, m: wp.mat33d):
    """Stores a 3 x 3 matrix row by row at offset `at` of a flat array."""
    ...


@wp.func
def rotation_about(axis: wp.vec3d, angle: wp.float64) -> wp.mat33d:
    """Rotation by `angle` about a unit axis."""
    c, s = wp.cos(angle), wp.sin(angle)
    return c * wp.identity(n=3, dtype=wp.float64) + s * wp.skew(axis) + (wp.float64(1.0) - c) * wp.outer(axis, axis)


@wp.func
def orientation(q: wp.array(dtype=wp.float64), at: int) -> wp.mat33d:
    """Rotation of a quaternion (w, x, y, z) of any length."""
    w, v = q[at], point3(q, at + 1)
    length = w * w + wp.dot(v, v)
    return (
        (w * w - wp.dot(v, v)) * wp.identity(n=3, dtype=wp.float64)
        + wp.float64(2.0) * wp.outer(v, v)
        + wp.float64(2.0) * w * wp.skew(v)
    ) / length


@wp.func
def follow_joints(t: Tree, s: Motion, l: int, place: wp.vec3d, turn: wp.mat33d):
    """Writes the frame of link l, its axes and its anchors; (place, turn) is the frame with all its joints at zero."""
    x, r = place + wp.vec3d(), turn * wp.identity(n=3, dtype=wp.float64)
    axes = 13 * t.links
    anchors = axes + 3 * t.dofs
    for j in range(t.begin[l], t.begin[l + 1]):
        d, q = t.first[j], t.coordinate[j]
        if t.kind[j] == wp.static(FREE):
            x, r = point3(s.qpos, q), orientation(s.qpos, q + 3)
            for i in range(3):
                along = wp.vec3d()
                along[i] = wp.float64(1.0)
                store_vec3(s.pose, axes + 3 * (d + i), along)
                store_vec3(s.pose, axes + 3 * (d + 3 + i), r * along)
                store_vec3(s.pose, anchors + 3 * (d + i), x)
                store_vec3(s.pose, anchors + 3 * (d + 3 + i), x)
        else:
            own = point3(t.axis, 3 * j)
            axis, anchor, moved = r * own, x + r * point3(t.anchor, 3 * j), s.qpos[q] - t.zero[j]
            store_vec3(s.pose, axes + 3 * d, axis)
            store_vec3(s.pose, anchors + 3 * d, anchor)
            if t.kind[j] == wp.static(SLIDE):
                x += moved * axis
            else:
                r = r * rotation_about(own, moved)
                x = anchor - r * point3(t.anchor, 3 * j)
    store_vec3(s.pose, 12 * l, x)
    store_mat33(s.pose, 12 * l + 3, r)
    if t.hinge[l] >= 0:
        s.pose[12 * t.links + l] = s.qpos[t.hinge[l]]


@wp.func
def place_links(t: Tree, s: Motion):
    """Writes frames, angles, axes and anchors, link after link."""
    for l in range(t.links):
        place, turn, p = point3(t.place, 3 * l), matrix3(t.turn, 9 * l), t.parent[l]
        if p >= 0:
            carried = matrix3(s.pose, 12 * p + 3)
            place, turn = point3(s.pose, 12 * p) + carried * place, carried * turn
        follow_joints(t, s, l, place, turn)


@wp.func
def set_screw(t: Tree, s: Motion, d: int):
    """Writes S_d, the motion per unit speed of degree of freedom d."""
    axis = point3(s.pose, 13 * t.links + 3 * d)
    if t.spins[d] == 1:
        store_vec3(s.screw, 6 * d, axis)
        store_vec3(s.screw, 6 * d + 3, wp.cross(point3(s.pose, 13 * t.links + 3 * t.dofs + 3 * d) - point3(s.pose, 0), axis))
    else:
        store_vec3(s.screw, 6 * d, wp.vec3d())
        store_vec3(s.screw, 6 * d + 3, axis)


@wp.func
def set_drift(t: Tree, s: Motion, d: int):
    """Writes c_d, the velocity-product acceleration of degree of freedom d."""
    w, u = wp.vec3d(), wp.vec3d()
    for e in range(t.before[d]):
        speed = t.reach[t.carrier[d] * t.dofs + e] * s.qvel[e]
        w += speed * point3(s.screw, 6 * e)
        u += speed * point3(s.screw, 6 * e + 3)
    a, b = point3(s.screw, 6 * d), point3(s.screw, 6 * d + 3)
    store_vec3(s.drift, 6 * d, s.qvel[d] * wp.cross(w, a))
    store_vec3(s.drift, 6 * d + 3, s.qvel[d] * (wp.cross(w, b) + wp.cross(u, a)))


@wp.func
def inertia_about(turn: wp.mat33d, inertia: wp.mat33d) -> wp.mat33d:
    """Moments of inertia in the world's axes."""
    return turn * inertia * wp.transpose(turn)


@wp.func
def set_masses(t: Tree, s: Motion, l: int):
    """Writes the centre of mass of link l relative to r, and its moments of inertia in the world's axes."""
    turn = matrix3(s.pose, 12 * l + 3)
    store_vec3(s.arm, 3 * l, point3(s.pose, 12 * l) - point3(s.pose, 0) + turn * point3(t.centre, 3 * l))
    store_mat33(s.turned, 9 * l, inertia_about(turn, matrix3(t.inertia, 9 * l)))


@wp.func
def set_force(t: Tree, s: Motion, l: int):
    """Writes (N_l, F_l) of link l."""
    w, u, dw, du = wp.vec3d(), wp.vec3d(), wp.vec3d(), wp.vec3d()
    for d in range(t.dofs):
        reach = t.reach[l * t.dofs + d]
        speed = reach * s.qvel[d]
        w += speed * point3(s.screw, 6 * d)
        u += speed * point3(s.screw, 6 * d + 3)
        dw += reach * point3(s.drift, 6 * d)
        du += reach * point3(s.drift, 6 * d + 3)
    p, inertia = point3(s.arm, 3 * l), matrix3(s.turned, 9 * l)
    gained = du + wp.cross(dw, p) + wp.cross(w, u + wp.cross(w, p))
    force = t.mass[l] * (gained - t.gravity)
    store_vec3(s.force, 6 * l, inertia * dw + wp.cross(w, inertia * w) + wp.cross(p, force))
    store_vec3(s.force, 6 * l + 3, force)


@wp.func
def set_momentum(t: Tree, s: Motion, d: int):
    """Writes the angular momentum about r and the linear momentum of all links that d moves, at unit speed of d."""
    mass, first, second = wp.float64(0.0), wp.vec3d(), wp.mat33d()
    for l in range(t.links):
        if t.reach[l * t.dofs + d] > wp.float64(0.5):
            p = point3(s.arm, 3 * l)
            mass += t.mass[l]
            first += t.mass[l] * p
            second += matrix3(s.turned, 9 * l)
            second += t.mass[l] * (wp.dot(p, p) * wp.identity(n=3, dtype=wp.float64) - wp.outer(p, p))
    a, b = point3(s.screw, 6 * d), point3(s.screw, 6 * d + 3)
    store_vec3(s.momentum, 6 * d, second * a + wp.cross(first, b))
    store_vec3(s.momentum, 6 * d + 3, mass * b + wp.cross(a, first))


@wp.func
def screw_product(a: wp.array(dtype=wp.float64), i: int, b: wp.array(dtype=wp.float64), j: int) -> wp.float64:
    """Product of the six-vectors a_i and b_j, angular part plus linear part."""
    return wp.dot(point3(a, 6 * i), point3(b, 6 * j)) + wp.dot(point3(a, 6 * i + 3), point3(b, 6 * j + 3))


@wp.func
def set_joint_forces(t: Tree, s: Motion, d: int):
    """Writes bias, passive and servo force of one degree of freedom."""
    bias = wp.float64(0.0)
    for l in range(t.links):
        bias += t.reach[l * t.dofs + d] * screw_product(s.screw, d, s.force, l)
    s.bias[d] = bias
    s.passive[d] = -t.damping[d] * s.qvel[d]
    s.actuator[d] = wp.float64(0.0)
    if t.servo[d] >= 0:
        u = wp.clamp(s.command[t.servo[d]], t.range[2 * d], t.range[2 * d + 1])
        b = point3(t.law, 3 * d)
        wanted = t.gain[d] * u + b[0] + b[1] * s.qpos[t.measured[d]] + b[2] * s.qvel[d]
        s.actuator[d] = wp.clamp(wanted, t.force_range[2 * d], t.force_range[2 * d + 1])


@wp.func
def place_body(t: Tree, s: Motion, me: int, threads: int):
    """Writes the pose and S."""
    if me == 0:
        place_links(t, s)
    wait_for_block()
    d = int(me)
    while d < t.dofs:
        set_screw(t, s, d)
        d += threads
    wait_for_block()


@wp.func
def weigh_body(t: Tree, s: Motion, me: int, threads: int):
    """Writes M, bias, passive and servo forces; `place_body` must have run."""
    d, l, k, c = int(me), int(me), int(me), int(me)
    while c < t.links:
        set_masses(t, s, c)
        c += threads
    wait_for_block()
    while d < t.dofs:
        set_drift(t, s, d)
        set_momentum(t, s, d)
        d += threads
    wait_for_block()
    while l < t.links:
        set_force(t, s, l)
        l += threads
    while k < t.dofs * t.dofs:
        i, j = wp.min(k // t.dofs, k % t.dofs), wp.max(k // t.dofs, k % t.dofs)
        entry = wp.where(i == j, t.armature[i], wp.float64(0.0))
        if t.reach[t.carrier[j] * t.dofs + i] > wp.float64(0.5):  # else they lie on two branches
            entry += screw_product(s.screw, i, s.momentum, j)
        s.mass_matrix[k] = entry
        k += threads
    wait_for_block()
    d = int(me)
    while d < t.dofs:
        set_joint_forces(t, s, d)
        d += threads
    wait_for_block()


@wp.kernel
def state_equation(t: Tree, s: Motion):
    """Computes pose, M, bias, passive and servo forces of a state in one block of threads; in one thread on the CPU.

    The tests' entry: they hold the two functions, which `device_body` calls inside its own kernels, to MuJoCo.
    """
    me, threads = wp.tid(), wp.block_dim()
    place_body(t, s, me, threads)
    weigh_body(t, s, me, threads)


@wp.func
def move_joint(t: Tree, s: Motion, j: int, v: wp.array(dtype=wp.float64), dt: wp.float64):
    """Advances the coordinates and velocities of joint j by a step dt at velocity v."""
    d, q = t.first[j], t.coordinate[j]
    if t.kind[j] == wp.static(FREE):
        for i in range(3):
            s.qpos[q + i] += dt * v[d + i]
            s.qvel[d + i] = v[d + i]
            s.qvel[d + 3 + i] = v[d + 3 + i]
        w = point3(v, d + 3)
        speed = wp.length(w)
        if speed > wp.float64(0.0):
            half = wp.float64(0.5) * dt * speed
            c, x = wp.cos(half), (wp.sin(half) / speed) * w
            # the step's rotation is about the body's own axes: it multiplies from the right. Both parts are read before a write
            c0, x0 = s.qpos[q + 3], point3(s.qpos, q + 4)
            real, vector = c0 * c - wp.dot(x0, x), c0 * x + c * x0 + wp.cross(x0, x)
            s.qpos[q + 3] = real
            store_vec3(s.qpos, q + 4, vector)
    else:
        s.qpos[q] += dt * v[d]
        s.qvel[d] = v[d]


@wp.kernel
def advance_state(t: Tree, s: Motion, v: wp.array(dtype=wp.float64), dt: wp.float64):
    """Advances the state by one step, one thread for each joint; the tests' entry to `move_joint`, as `state_equation` is."""
    move_joint(t, s, wp.tid(), v, dt)


def tree_of(model: mujoco.MjModel, device: Any) -> Tree:
    """Constants of a model on a device. Raises ConfigError: the model has something that these kernels leave out."""
    m, n, count = model, model.nv, model.nbody - 1
    _refuse_what_is_left_out(m)
    make = lambda values, dtype=wp.float64: wp.array(np.ascontiguousarray(values).reshape(-1), dtype=dtype, device=device)
    whole = lambda values: make(np.asarray(values, np.int32), wp.int32)
    owner = m.dof_bodyid - 1
    above = [_ancestors(m, body + 1) for body in range(count)]
    first = m.jnt_dofadr[m.dof_jntid]
    free = m.jnt_type[m.dof_jntid] == FREE
    spins = (m.jnt_type[m.dof_jntid] == HINGE) | (free & (np.arange(n) - first >= 3))
    hung = [m.body_jntadr[body + 1] for body in range(count)]  # the one hinge of a link that hangs on another
    bends = [m.body_parentid[b + 1] > 0 and m.body_jntnum[b + 1] == 1 and m.jnt_type[hung[b]] == HINGE for b in range(count)]
    inertia = np.zeros((count, 3, 3))
    turn = np.zeros((count, 9))
    for body in range(count):
        own = np.zeros(9)
        mujoco.mju_quat2Mat(own, m.body_iquat[body + 1])
        mujoco.mju_quat2Mat(turn[body], m.body_quat[body + 1])
        inertia[body] = own.reshape(3, 3) * m.body_inertia[body + 1] @ own.reshape(3, 3).T
    t = Tree()
    t.links, t.joints, t.dofs, t.gravity = count, m.njnt, n, wp.vec3d(*m.opt.gravity)
    t.parent, t.place, t.turn = whole(m.body_parentid[1:] - 1), make(m.body_pos[1:]), make(turn)
    t.begin = whole(np.searchsorted(m.jnt_bodyid, np.arange(1, count + 2)))
    t.kind, t.axis, t.anchor, t.coordinate = whole(m.jnt_type), make(m.jnt_axis), make(m.jnt_pos), whole(m.jnt_qposadr)
    t.zero, t.first = make(m.qpos0[m.jnt_qposadr]), whole(m.jnt_dofadr)
    t.hinge = whole([m.jnt_qposadr[joint] if bent else -1 for joint, bent in zip(hung, bends, strict=True)])
    t.reach = make(np.array([[float(owner[d] in above[body]) for d in range(n)] for body in range(count)]))
    t.carrier, t.spins = whole(owner), whole(spins)
    t.before = whole(np.where(free, first + 3 * spins, np.arange(n)))  # turns of a free joint are about axes that all three move
    t.mass, t.centre, t.inertia = make(m.body_mass[1:]), make(m.body_ipos[1:]), make(inertia)
    t.armature, t.damping = make(m.dof_armature), make(m.dof_damping)
    servo = np.full(n, -1)
    servo[m.jnt_dofadr[m.actuator_trnid[:, 0]]] = np.arange(m.nu)
    law, limits, commands, gain = np.zeros((n, 3)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
    driven = servo >= 0
    endless = np.array([-np.inf, np.inf])
    gain[driven], law[driven] = m.actuator_gainprm[servo[driven], 0], m.actuator_biasprm[servo[driven], :3]
    limits[driven] = np.where(m.actuator_forcelimited[:, None], m.actuator_forcerange, endless)[servo[driven]]
    commands[driven] = np.where(m.actuator_ctrllimited[:, None], m.actuator_ctrlrange, endless)[servo[driven]]
    t.servo, t.gain, t.law, t.force_range, t.range = whole(servo), make(gain), make(law), make(limits), make(commands)
    t.measured = whole(m.jnt_qposadr[m.dof_jntid])
    return t


def motion_of(model: mujoco.MjModel, device: Any, **given: wp.array) -> Motion:
    """Arrays for the state of a model and for derived quantities; those `given` by name are used, the others are made."""
    n, count, s = model.nv, model.nbody - 1, Motion()
    sizes = {"qpos": model.nq, "qvel": n, "command": model.nu, "pose": 13 * count + 6 * n, "screw": 6 * n, "drift": 6 * n}
    sizes |= {
        "momentum": 6 * n,
        "arm": 3 * count,
        "turned": 9 * count,
        "force": 6 * count,
        "mass_matrix": n * n,
        "bias": n,
        "actuator": n,
        "passive": n,
    }
    for name, size in sizes.items():
        setattr(s, name, given[name] if name in given else wp.zeros(size, dtype=wp.float64, device=device))
    return s


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """Indices of the links that carry a body, its own included."""
    found = set()
    while body:
        found.add(body - 1)
        body = int(model.body_parentid[body])
    return found


def _refuse_what_is_left_out(m: mujoco.MjModel) -> None:
    """Raises ConfigError for a model with more in it than `state_equation` computes."""
    plain = {
        "a joint that is no slide, hinge or free joint": not np.isin(m.jnt_type, (FREE, SLIDE, HINGE)).all(),
        "a spring": m.jnt_stiffness.any(),
        "a tendon": m.ntendon,
        "compensated gravity": m.body_gravcomp.any(),
        "MuJoCo's fluid": m.opt.density or m.opt.viscosity,
        "an actuator that is no servo of one hinge or slide": m.nu
        and not (
            (m.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT).all()
            and (m.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE).all()
            and (m.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED).all()
            and (m.actuator_gear[:, 0] == 1).all()
            and (m.jnt_type[m.actuator_trnid[:, 0]] != FREE).all()
            and len(set(m.actuator_trnid[:, 0])) == m.nu
        ),
    }
    found = [name for name, there in plain.items() if there]
    if found:
        raise ConfigError(f"articulated body: the model has {', '.join(found)}; the device computes none of these")
