"""Motion of a body's links and of the water inside them: the host's arithmetic of a step, compiled.

    c_l = p_l + R_l r_l                            centre of link l's water, at r_l in its frame
    (u_l, w_l) = J_l v                             its motion; columns (a x (c_l - o), a) of a hinge, (a, 0) of a slide
    h_l = (m_l (u_l + t_l (s_l - t_l . u_l)),      its momentum; s_l: measured along the link; nan: it moves with the link
           R_l I_l R_l^T w_l)
    g_l <- g_l + b (R_l S_l R_l^T (u_l, w_l) - g_l)            of the layers on its sheets, S_l: `Markers.layer_inertia`
    right = (M + dt D) v + dt f + sum_l J_l^T (h_l^n - h_l^n-1 + g_l^n - g_l^n-1 - dt m_l g)

g_l follows the sheet with a lag, since a light sheet would vibrate from step to step without it.

The boxes round the markers of every link give the part of the water that they span, and the speed of their corners:

    x = p_l + R_l c                                 low and high corner of the upright box round all
    first = round((middle - o) / dx - n / 2)        first of the n cells whose middle is nearest to the box's; grid from o
    speed = |u_l + w_l x R_l (c - r_l)|             of corner c, from the twist (u, w) at r_l

A few hundred multiplications take about as long as one call of NumPy, so each kernel is one call and one thread. The arrays
are MuJoCo's own or the `ImmersedBody`'s: nothing is copied.
"""

import ctypes
from collections.abc import Sequence

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed.markers import Markers

wp.set_module_options({"enable_backward": False})

FOLLOWS = 0.5  # b, share of a step's change that the layers' momentum takes up
HINGE, FIXED = -1, -2  # axes of motion: MuJoCo's own; one of the world's (FIXED - i); one of the link's that turns (0, 1, 2)


@wp.struct
class LinkArrays:
    """L links, n degrees of freedom, Q coordinates; float64, except the integer tables."""

    links: int
    dofs: int
    place: wp.array(dtype=wp.float64)  # 3 L, p
    turn: wp.array(dtype=wp.float64)  # 9 L, R by rows
    mujoco_axis: wp.array(dtype=wp.float64)  # 3 a joint
    mujoco_anchor: wp.array(dtype=wp.float64)
    qpos: wp.array(dtype=wp.float64)
    qvel: wp.array(dtype=wp.float64)
    joint: wp.array(dtype=int)  # n, of every degree of freedom
    kind: wp.array(dtype=int)  # n, HINGE, FIXED - i or 0, 1, 2
    carrier: wp.array(dtype=int)  # n, link of every degree of freedom
    slides: wp.array(dtype=int)  # n
    hinge: wp.array(dtype=int)  # L, where in qpos; -1 for none
    reach: wp.array(dtype=wp.float64)  # L n, whether the degree of freedom moves the link
    arm: wp.array(dtype=wp.float64)  # 3 L, r
    mass: wp.array(dtype=wp.float64)  # L
    inertia: wp.array(dtype=wp.float64)  # 9 L
    layers: wp.array(dtype=wp.float64)  # 36 L, S, by rows
    has_layers: wp.array(dtype=int)  # 1, 0 where S is zero
    interior_speed: wp.array(dtype=wp.float64)  # L, s; nan where it moves as the link does
    pose: wp.array(dtype=wp.float64)  # 12 L + L + 3 n + 3 n: frames, angles, axes a, anchors o
    centre: wp.array(dtype=wp.float64)  # 3 L, c
    jacobian: wp.array(dtype=wp.float64)  # 6 L n, J
    twist: wp.array(dtype=wp.float64)  # 6 L, (u, w)
    now: wp.array(dtype=wp.float64)  # 6 L, h
    sheet: wp.array(dtype=wp.float64)  # 6 L, momentum of the layers at this twist


@wp.struct
class LinkDynamics:
    """Arrays of a step's equation; `interior`: 1 to include the interior water's gain."""

    body: LinkArrays
    interior: int
    dt: wp.array(dtype=wp.float64)  # 1
    damping: wp.array(dtype=wp.float64)  # n
    passive: wp.array(dtype=wp.float64)
    actuator: wp.array(dtype=wp.float64)
    bias: wp.array(dtype=wp.float64)
    applied: wp.array(dtype=wp.float64)
    weight: wp.array(dtype=wp.float64)  # 6 L, dt m g
    last: wp.array(dtype=wp.float64)  # 6 L, h of the step before
    layer_last: wp.array(dtype=wp.float64)  # 6 L, g of the step before
    gain: wp.array(dtype=wp.float64)  # 6 L
    impulse: wp.array(dtype=wp.float64)  # n, I
    smooth: wp.array(dtype=wp.float64)  # n, f
    system: wp.array(dtype=wp.float64)  # n n, M on entry, then M + dt D
    right: wp.array(dtype=wp.float64)  # n
    target: wp.array(dtype=wp.float64)  # n, the velocity that the step shall end with
    applied_force: wp.array(dtype=wp.float64)  # n, MuJoCo's qfrc_applied
    check: wp.array(dtype=wp.float64)  # greatest |target|, and what |v - target| is off, over 1 + greatest |target|


@wp.func_native("a.data[at] = v[0]; a.data[at + 1] = v[1]; a.data[at + 2] = v[2];")
def store_vec3(a: wp.array(dtype=wp.float64), at: int, v: wp.vec3d):
    """Stores a vector at offset `at` of a flat array."""
    ...


@wp.func
def layer_momentum(layers: wp.array(dtype=wp.float64), at: int, turn: wp.mat33d, u: wp.vec3d, w: wp.vec3d):
    """Linear and angular momentum of the layers of water on a link's sheets, S at offset `at`, at the link's twist (u, w)."""
    back = wp.transpose(turn)
    v, spin = back * u, back * w
    linear, angular = wp.vec3d(), wp.vec3d()
    for i in range(3):
        for j in range(3):
            linear[i] += layers[at + 6 * i + j] * v[j] + layers[at + 6 * i + 3 + j] * spin[j]
            angular[i] += layers[at + 6 * (i + 3) + j] * v[j] + layers[at + 6 * (i + 3) + 3 + j] * spin[j]
    return turn * linear, turn * angular


@wp.kernel
def move(s: LinkArrays):
    """Computes pose, centres, J, twists and momenta from the results of `mj_step1`."""
    frames, angles = s.pose, 12 * s.links
    axes = angles + s.links
    anchors = axes + 3 * s.dofs
    for d in range(s.dofs):
        axis, kind = point3(s.mujoco_axis, 3 * s.joint[d]), s.kind[d]
        if kind <= FIXED:
            axis = wp.vec3d()
            axis[FIXED - kind] = wp.float64(1.0)
        if kind >= 0:
            own = matrix3(s.turn, 9 * s.carrier[d])
            axis = wp.vec3d(own[0, kind], own[1, kind], own[2, kind])
        store_vec3(s.pose, axes + 3 * d, axis)
        store_vec3(s.pose, anchors + 3 * d, point3(s.mujoco_anchor, 3 * s.joint[d]))
    for l in range(s.links):
        place, turn = point3(s.place, 3 * l), matrix3(s.turn, 9 * l)
        store_vec3(frames, 12 * l, place)
        for i in range(9):
            frames[12 * l + 3 + i] = s.turn[9 * l + i]
        if s.hinge[l] >= 0:
            s.pose[angles + l] = s.qpos[s.hinge[l]]
        centre = place + turn * point3(s.arm, 3 * l)
        store_vec3(s.centre, 3 * l, centre)
        u, w = wp.vec3d(), wp.vec3d()
        for d in range(s.dofs):
            along = s.reach[l * s.dofs + d] * point3(s.pose, axes + 3 * d)
            shift = wp.where(s.slides[d] == 1, along, wp.cross(along, centre - point3(s.pose, anchors + 3 * d)))
            spin = wp.where(s.slides[d] == 1, wp.vec3d(), along)
            for i in range(3):
                s.jacobian[(6 * l + i) * s.dofs + d] = shift[i]
                s.jacobian[(6 * l + 3 + i) * s.dofs + d] = spin[i]
            u += s.qvel[d] * shift
            w += s.qvel[d] * spin
        store_vec3(s.twist, 6 * l, u)
        store_vec3(s.twist, 6 * l + 3, w)
        if s.has_layers[0] == 1:
            linear, angular = layer_momentum(s.layers, 36 * l, turn, u, w)
            store_vec3(s.sheet, 6 * l, linear)
            store_vec3(s.sheet, 6 * l + 3, angular)
        if (
            s.interior_speed[l] == s.interior_speed[l]
        ):  # not nan: measured. Only along the link: across it the wall takes it along
            axis = wp.vec3d(turn[0, 0], turn[1, 0], turn[2, 0])
            u += (s.interior_speed[l] - wp.dot(axis, u)) * axis
        store_vec3(s.now, 6 * l, s.mass[l] * u)
        store_vec3(s.now, 6 * l + 3, turn * (matrix3(s.inertia, 9 * l) * (wp.transpose(turn) * w)))


@wp.func
def add_interior(e: LinkDynamics):
    """Computes I: the gain of the displaced water in the last step (if `interior`), and its buoyancy over this step."""
    s = e.body
    for d in range(s.dofs):
        e.impulse[d] = wp.float64(0.0)
    for k in range(6 * s.links):
        # a difference in the world's axes, not M_f a: it contains the Coriolis part and telescopes over the steps
        e.gain[k] = s.now[k] - e.last[k]
        e.last[k] = s.now[k]
        if s.has_layers[0] == 1:
            gained = wp.float64(FOLLOWS) * (s.sheet[k] - e.layer_last[k])
            e.gain[k] += gained
            e.layer_last[k] += gained
        push = wp.where(e.interior == 1, e.gain[k], wp.float64(0.0)) - e.weight[k]
        for d in range(s.dofs):
            e.impulse[d] += push * s.jacobian[k * s.dofs + d]


@wp.kernel
def assemble(e: LinkDynamics):
    """Assembles M + dt D and the right-hand side."""
    add_interior(e)
    s = e.body
    n, dt = s.dofs, e.dt[0]
    for i in range(n):
        e.system[i * n + i] += dt * e.damping[i]  # on the left, as MuJoCo's Euler takes it: else its step would not return v+
        e.smooth[i] = e.passive[i] + e.actuator[i] - e.bias[i]
        total = dt * (e.smooth[i] + e.applied[i]) + e.impulse[i]
        for j in range(n):
            total += e.system[i * n + j] * s.qvel[j]
        e.right[i] = total


@wp.kernel
def inverse_force(e: LinkDynamics):
    """Computes the force with which MuJoCo's own step ends at the target velocity: (M + dt D) (v+ - v) / dt - f."""
    n = e.body.dofs
    greatest, lost = wp.float64(0.0), wp.float64(0.0)  # a greatest alone would pass over nan, which compares as false
    for i in range(n):
        total = wp.float64(0.0)
        for j in range(n):
            total += e.system[i * n + j] * (e.target[j] - e.body.qvel[j])
        e.applied_force[i] = total / e.dt[0] - e.smooth[i]
        greatest = wp.max(greatest, wp.abs(e.target[i]))
        lost += e.target[i] - e.target[i]  # 0, or nan where it is not finite
    e.check[0] = greatest + lost


@wp.kernel
def compare(e: LinkDynamics):
    """Computes the distance of MuJoCo's result from the target velocity, relative to 1 + the greatest target."""
    off, lost = wp.float64(0.0), wp.float64(0.0)
    for i in range(e.body.dofs):
        gap = e.body.qvel[i] - e.target[i]
        off = wp.max(off, wp.abs(gap))
        lost += gap - gap
    e.check[1] = (off + lost) / (wp.float64(1.0) + e.check[0])


def host_view(values: np.ndarray, dtype=wp.float64) -> wp.array:
    """Flat Warp array over the same memory."""
    flat = values.reshape(-1)
    if not np.shares_memory(flat, values):
        raise ValueError("links: only contiguous arrays are shared")
    return wp.array(flat, dtype=dtype, device="cpu", copy=False)


class Recorded:
    """One thread of a host kernel with its one argument, for repeated launches.

    It calls the compiled function itself, in half a microsecond; Warp's own launch takes 1.7 before it calls.
    """

    def __init__(self, kernel: wp.Kernel, given):
        recorded = wp.launch(kernel, dim=1, inputs=[given], device="cpu", record_cmd=True)
        argument = recorded.params[1]
        whole = type("Arguments", (ctypes.Structure,), {"_fields_": [("given", type(argument))]})
        self._kept = recorded, given  # their code and their arrays
        self._forward = recorded.hooks.forward
        self._bounds, self._whole = ctypes.byref(recorded.bounds), ctypes.byref(whole(argument))

    def launch(self) -> None:
        """Calls the kernel."""
        self._forward(self._bounds, self._whole)


@wp.struct
class Boxes:
    """Arrays of the boxes of L links; float64."""

    links: int
    at: wp.array(dtype=wp.float64)  # 24 L, c
    arm: wp.array(dtype=wp.float64)  # 3 L, r
    pose: wp.array(dtype=wp.float64)  # 12 L and more, (p, R)
    twist: wp.array(dtype=wp.float64)  # 6 L
    seen: wp.array(dtype=wp.float64)  # low, high, first, speed
    dx: wp.float64  # of the grid, m
    corner: wp.vec3d  # of the grid, m
    size: wp.vec3d  # n


@wp.kernel
def compute_bounds(b: Boxes):
    """Computes the box round all corners, its first cell and its greatest speed; one thread, a few hundred multiplications."""
    far, fast = wp.float64(wp.inf), wp.float64(0.0)
    low, high = wp.vec3d(far, far, far), wp.vec3d(-far, -far, -far)
    for l in range(b.links):
        place, turn, r = point3(b.pose, 12 * l), matrix3(b.pose, 12 * l + 3), point3(b.arm, 3 * l)
        u, w = point3(b.twist, 6 * l), point3(b.twist, 6 * l + 3)
        for k in range(8):
            c = point3(b.at, 24 * l + 3 * k)
            x = place + turn * c
            low, high = wp.min(low, x), wp.max(high, x)
            v = u + wp.cross(w, turn * (c - r))
            fast = wp.max(fast, wp.dot(v, v))
    for i in range(3):
        b.seen[i] = low[i]
        b.seen[3 + i] = high[i]
        middle = wp.float64(0.5) * (low[i] + high[i])
        b.seen[6 + i] = wp.rint((middle - b.corner[i]) / b.dx - wp.float64(0.5) * b.size[i])
    b.seen[9] = wp.sqrt(fast)


class Corners:
    """Eight corners for every link of one body.

    Args:
        at: (L, 8, 3) m, in the frames of the links.
        centre: (L, 3) m, the points whose twists are known, in the same frames.
    """

    def __init__(self, at: np.ndarray, centre: np.ndarray):
        self.at, self.centre = np.array(at, float), np.array(centre, float)
        self._seen = np.zeros(10)
        self._at: tuple = ()
        self._surround: Recorded | None
        self.set_grid(1.0, (0.0, 0.0, 0.0), (0, 0, 0))

    @classmethod
    def of(cls, markers: Markers, centre: np.ndarray) -> "Corners":
        """Corners round the markers of every link of which `centre` (L, 3) has a row; a link without markers has its origin."""
        at = np.zeros((len(centre), 8, 3))
        for i in range(len(centre)):
            mine = markers.rest[(markers.before == i)]
            if len(mine):
                ends = np.stack([mine.min(0), mine.max(0)])
                at[i] = [[ends[a, 0], ends[b, 1], ends[c, 2]] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
        return cls(at, centre)

    def set_grid(self, dx: float, corner: Sequence[float], size: Sequence[int]) -> None:
        """Sets the cell size dx [m], the grid's `corner` (3,) m, and the number of cells (3,) in the box round all corners."""
        self.grid, self._surround = (dx, wp.vec3d(*corner), wp.vec3d(*map(float, size))), None

    def measure(self, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Low and high corner [m] of the upright box round all, first cell of the box of cells, greatest speed [m/s], (10,).

        Args:
            pose: links' positions and rotations by rows, (12 L,) or longer.
            twist: (L, 6). The addresses of both are remembered; the result is always written to the same array.
        """
        if self._surround is None or self._at[0] is not pose or self._at[1] is not twist:
            boxes = Boxes()
            boxes.links, boxes.at, boxes.arm = len(self.at), host_view(self.at), host_view(self.centre)
            boxes.dx, boxes.corner, boxes.size = self.grid
            boxes.pose, boxes.twist, boxes.seen = host_view(pose), host_view(twist), host_view(self._seen)
            self._at, self._surround = (pose, twist), Recorded(compute_bounds, boxes)
        self._surround.launch()
        return self._seen
