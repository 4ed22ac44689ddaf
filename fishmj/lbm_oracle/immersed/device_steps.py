"""Several coupled steps in a row that never wait for the host: the body moves on the device, too.

    before   the host's block with the place of the body, state, servo commands of all steps    one launch of a graph
    a step   equation: M + dt D, right-hand side          beside the water's response K, b0
             solve, wrenches, F -> G, the fluid's step    beside `follow`: v+ -> state -> pose, box, fastest corner
    after    state, servo torques and joint rates of every step, wrenches, to the host          one wait

The arithmetic is that of `body.py` and `link_dynamics.py`, with a thread for each link and each degree of freedom
(`articulated_body.py`). The host's MuJoCo takes the state at the end and goes on from there, with this or step by step. Servos
and a push from outside drive the body; velocities that are prescribed, and the explicit scheme, are left to the host's steps.
"""

from contextlib import nullcontext
from typing import NamedTuple

import mujoco
import numpy as np
import warp as wp

from fishmj.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed import fsi_solve
from fishmj.lbm_oracle.immersed.articulated_body import (
    Motion,
    Tree,
    inertia_about,
    motion_of,
    move_joint,
    paired,
    place_body,
    tree_of,
    weigh_body,
)
from fishmj.lbm_oracle.immersed.body import RUNAWAY
from fishmj.lbm_oracle.immersed.coupling import FluidStructure, Graphs, Part
from fishmj.lbm_oracle.immersed.fsi_solve import wait_for_block
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays
from fishmj.lbm_oracle.immersed.link_dynamics import put

wp.set_module_options({"enable_backward": False})


@wp.struct
class Inside:
    """The water inside L links, and the boxes round their markers; float64, SI."""

    dt: wp.float64
    counts: int  # whether its gain does
    mass: wp.array(dtype=wp.float64)  # L
    centre: wp.array(dtype=wp.float64)  # 3 L, in the link's frame
    inertia: wp.array(dtype=wp.float64)  # 9 L
    weight: wp.array(dtype=wp.float64)  # 6 L, dt m g
    slid: wp.array(dtype=wp.float64)  # L, speed along the link as this step measures it
    speed: wp.array(dtype=wp.float64)  # L, as the step before measured it; nan: it moves as the link does
    last: wp.array(dtype=wp.float64)  # 6 L, momentum at the start of the step before
    total: wp.array(dtype=wp.float64)  # 6 L, what it gained in all steps
    push: wp.array(dtype=wp.float64)  # 6 L, moment about the first link's frame and force times dt
    applied: wp.array(dtype=wp.float64)  # n
    corner: wp.array(dtype=wp.float64)  # 24 L, of the boxes
    seen: wp.array(dtype=wp.float64)  # 7 L, low, high, and square of the greatest speed, of each link
    fastest: wp.array(dtype=wp.float64)  # 1, of all steps
    dx: wp.float64
    grid: wp.vec3d  # corner of the grid
    size: wp.vec3d  # cells of the scratch box


@wp.func
def twist_of(t: Tree, s: Motion, l: int):
    """Angular velocity, and velocity of the link's point at the first link's frame."""
    w, u = wp.vec3d(), wp.vec3d()
    for d in range(t.dofs):
        speed = t.reach[l * t.dofs + d] * s.qvel[d]
        w += speed * point3(s.screw, 6 * d)
        u += speed * point3(s.screw, 6 * d + 3)
    return w, u


@wp.func
def push_link(t: Tree, s: Motion, e: Inside, l: int):
    """The momentum that the water inside link l gained since the step before, and its buoyancy over this one."""
    w, u = twist_of(t, s, l)
    turn = matrix3(s.pose, 12 * l + 3)
    p = point3(s.pose, 12 * l) - point3(s.pose, 0) + turn * point3(e.centre, 3 * l)
    u += wp.cross(w, p)
    if e.speed[l] == e.speed[l]:  # not nan
        along = wp.vec3d(turn[0, 0], turn[1, 0], turn[2, 0])
        u += (e.speed[l] - wp.dot(along, u)) * along
    linear, angular = e.mass[l] * u, inertia_about(turn, matrix3(e.inertia, 9 * l)) * w
    gained, spun = linear - point3(e.last, 6 * l), angular - point3(e.last, 6 * l + 3)
    put(e.last, 6 * l, linear)
    put(e.last, 6 * l + 3, angular)
    if e.counts == 0:
        gained, spun = wp.vec3d(), wp.vec3d()
    put(e.total, 6 * l, point3(e.total, 6 * l) + gained)
    put(e.total, 6 * l + 3, point3(e.total, 6 * l + 3) + spun)
    gained -= point3(e.weight, 6 * l)
    put(e.push, 6 * l, wp.cross(p, gained) + spun)
    put(e.push, 6 * l + 3, gained)


@wp.kernel
def equation(
    t: Tree, s: Motion, e: Inside, block: wp.array(dtype=wp.float64), at: CouplingArrays, rate: wp.array(dtype=wp.float64)
):
    """M + dt D, the right-hand side and the velocity into the block that the solve reads; one block of threads."""
    me, threads, n = wp.tid(), wp.block_dim(), t.dofs
    weigh_body(t, s, me, threads)
    l = int(me)
    while l < t.links:
        push_link(t, s, e, l)
        l += threads
    wait_for_block()
    i = int(me)
    while i < n:
        rate[i] = s.qvel[i]
        block[at.before + i] = s.qvel[i]
        right = e.dt * (s.passive[i] + s.actuator[i] - s.bias[i] + e.applied[i])
        for k in range(t.links):
            right += t.reach[k * n + i] * paired(s.screw, i, e.push, k)
        for j in range(n):
            entry = s.mass_matrix[n * i + j] + wp.where(i == j, e.dt * t.damping[i], wp.float64(0.0))
            block[at.system + n * i + j] = entry
            right += entry * s.qvel[j]
        block[at.momentum + i] = right
        i += threads


@wp.func
def settle_inside(s: Motion, e: Inside, l: int):
    """The speed along the link as measured; the first one is a state, not a gain."""
    if e.speed[l] != e.speed[l]:
        along = wp.vec3d(s.pose[12 * l + 3], s.pose[12 * l + 6], s.pose[12 * l + 9])
        linear = point3(e.last, 6 * l)
        put(e.last, 6 * l, linear + (e.mass[l] * e.slid[l] - wp.dot(along, linear)) * along)
    e.speed[l] = e.slid[l]


@wp.func
def look_round(t: Tree, s: Motion, e: Inside, l: int):
    """The upright box round link l's markers, and the square of its fastest corner's speed."""
    w, u = twist_of(t, s, l)
    place, turn = point3(s.pose, 12 * l), matrix3(s.pose, 12 * l + 3)
    far, fast = wp.float64(wp.inf), wp.float64(0.0)
    low, high = wp.vec3d(far, far, far), wp.vec3d(-far, -far, -far)
    for k in range(8):
        x = place + turn * point3(e.corner, 24 * l + 3 * k)
        low, high = wp.min(low, x), wp.max(high, x)
        v = u + wp.cross(w, x - point3(s.pose, 0))
        fast = wp.max(fast, wp.dot(v, v))
    put(e.seen, 7 * l, low)
    put(e.seen, 7 * l + 3, high)
    e.seen[7 * l + 6] = fast


@wp.kernel
def follow(
    t: Tree,
    s: Motion,
    e: Inside,
    block: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    v: wp.array(dtype=wp.float64),
    moves: int,
    measured: int,
):
    """The state after the step, and pose and box of cells round it into the block that the markers read; one block of threads.

    `moves` = 0 leaves the state as it is, `measured` = 0 the interior water moving with its links.
    """
    me, threads = wp.tid(), wp.block_dim()
    l = int(me)
    while l < t.links and moves * measured == 1:
        settle_inside(s, e, l)
        l += threads
    wait_for_block()
    j = int(me)
    while j < t.joints and moves == 1:
        move_joint(t, s, j, v, e.dt)
        j += threads
    wait_for_block()
    place_body(t, s, me, threads)
    l = int(me)
    while l < t.links:
        look_round(t, s, e, l)
        l += threads
    wait_for_block()
    a = int(me)
    while a < 3:
        low, high = wp.float64(wp.inf), -wp.float64(wp.inf)
        for k in range(t.links):
            low, high = wp.min(low, e.seen[7 * k + a]), wp.max(high, e.seen[7 * k + 3 + a])
        middle = wp.float64(0.5) * (low + high)
        block[at.box + a] = wp.rint((middle - e.grid[a]) / e.dx - wp.float64(0.5) * e.size[a])
        a += threads
    if me == 0 and moves == 1:
        block[at.fresh] = wp.float64(0.0)
        for k in range(t.links):
            e.fastest[0] = wp.max(e.fastest[0], wp.sqrt(e.seen[7 * k + 6]))


class Seen(NamedTuple):
    """Of the steps that were done together."""

    torque: np.ndarray  # (S, A) N m, of the servos, at the start of each step
    rate: np.ndarray  # (S, n) m/s and rad/s, at the same times
    fastest: float  # m/s, of a corner of the links' boxes after any of the steps


class DeviceSteps:
    """`count` steps of a coupled fish at a time.

    Args:
        coupled: fish and water; servo gains, masses and damping of its model are taken as they are now.
        count: steps that `run` does.

    Raises:
        ConfigError: the explicit scheme, refined water, or a model with more in it than the device computes (`tree_of`).
    """

    def __init__(self, coupled: FluidStructure, count: int):
        if coupled.scheme != "implicit":
            raise ConfigError(f"steps on the device: the coupling scheme is {coupled.scheme!r}; expected 'implicit'")
        if type(coupled.fluid) is not Fluid:  # whose graphs know one parity of copies only
            raise ConfigError(f"steps on the device: the water is a {type(coupled.fluid).__name__}; expected one level, a Fluid")
        body, self.boundary, self.fluid = coupled.body, coupled.boundary, coupled.fluid
        self.coupled, self.count, device = coupled, int(count), coupled.fluid.device
        self._tree, links, n, servos = tree_of(body.model, device), body.links, body.dofs, body.model.nu
        self._dof = body.model.jnt_dofadr[body.model.actuator_trnid[:, 0]]
        sizes = {"qpos": body.model.nq, "qvel": n, "last": 6 * links, "speed": links, "applied": n, "total": 6 * links}
        sizes |= {"fastest": 1, "command": self.count * max(servos, 1), "actuator": self.count * n, "rate": self.count * n}
        whole = sum(sizes.values())
        pinned = wp.zeros(whole, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        self._kept = pinned
        self._host = wp.array(ptr=pinned.ptr, dtype=wp.float64, shape=whole, device=device)  # as the device sees it
        self._state = wp.zeros(whole, dtype=wp.float64, device=device)
        self.held, here, place = {}, {}, 0  # by name, on the host and on the device
        for name, size in sizes.items():
            self.held[name], here[name] = pinned.numpy()[place : place + size], self._state[place : place + size]
            place += size
        self._inside = self._inside_of(body, here)
        pose, model = self.boundary.host[: body.pose.size], body.model
        first = motion_of(model, device, qpos=here["qpos"], qvel=here["qvel"], pose=pose)
        between = {
            name: getattr(first, name) for name in ("screw", "drift", "momentum", "force", "mass_matrix", "bias", "passive")
        }
        between |= {"qpos": here["qpos"], "qvel": here["qvel"], "pose": pose}
        self._motions = []  # of each step: its own commands and torques, all else is used again
        for k in range(self.count):
            size = max(servos, 1)  # an array without entries cannot be cut
            own = {"command": here["command"][k * size : (k + 1) * size], "actuator": here["actuator"][k * n : (k + 1) * n]}
            self._motions.append(motion_of(model, device, **between, **own))
        self._rates = [here["rate"][k * n : (k + 1) * n] for k in range(self.count)]
        self._threads = fsi_solve.BLOCK if device.is_cuda else 1
        self._branch = wp.Stream(device) if device.is_cuda else None
        self._graphs = Graphs(self) if device.is_cuda else None

    def _inside_of(self, body, here: dict[str, wp.array]) -> Inside:
        e, corners, water, device = Inside(), self.boundary.corners, body.water, self.fluid.device
        make = lambda values: wp.array(np.ascontiguousarray(values, float).reshape(-1), dtype=wp.float64, device=device)
        weight = np.zeros((body.links, 6))
        weight[:, :3] = body.dt * water.mass[:, None] * body.model.opt.gravity
        e.dt, e.counts = body.dt, int(self.coupled.interior)
        e.mass, e.centre, e.inertia, e.weight = make(water.mass), make(water.centre), make(water.inertia), make(weight)
        e.speed, e.last, e.total, e.applied, e.fastest = (here[name] for name in ("speed", "last", "total", "applied", "fastest"))
        e.slid, e.push, e.seen = make(np.zeros(body.links)), make(np.zeros(6 * body.links)), make(np.zeros(7 * body.links))
        e.corner, (e.dx, e.grid, e.size) = make(corners.at), corners.grid
        return e

    def run(self, command: np.ndarray) -> Seen:
        """`count` steps under the servo commands (count, A) rad; raises as `queue` and `finish`."""
        self.queue(command)
        return self.finish()

    def queue(self, command: np.ndarray) -> None:
        """Set the device to work on them; the host may look after another tank meanwhile.

        Raises:
            ConfigError: not a command for every step and servo; or a marker is so near to a face that its kernel would read
                beyond it, at the start.
        """
        body, held, shape = self.coupled.body, self.held, (self.count, len(self._dof))
        command = np.asarray(command, float)
        if command.shape != shape:
            raise ConfigError(f"steps on the device: commands of shape {command.shape}; expected {shape}, rad, one row a step")
        self.coupled.place_markers()
        self.boundary.set_equation(body.system, 0.0, body.data.qvel)  # nothing prescribed; the rest is found anew
        held["qpos"][:], held["qvel"][:], held["applied"][:] = body.data.qpos, body.data.qvel, body.applied
        held["last"][:], held["speed"][:], held["total"][:] = body.momentum.ravel(), body.interior_speed, 0.0
        held["fastest"][:], held["command"][: command.size] = 0.0, command.ravel()
        if self._graphs is None:
            self.launch()
        else:
            self._graphs.launch("steps")

    def finish(self) -> Seen:
        """Wait, and hand the state to MuJoCo.

        Raises:
            SimDiverged: a velocity is not finite or runs away. The body is then as it was before; the water is not.
        """
        if self._graphs is not None:
            self._graphs.wait()
            self._graphs.join_stream()
        self._take()
        held, shape = self.held, (self.count, self.coupled.body.dofs)
        torque, rate = held["actuator"].reshape(shape)[:, self._dof], held["rate"].reshape(shape)
        return Seen(torque.copy(), rate.copy(), float(held["fastest"][0]))

    def _take(self) -> None:
        """The state at the end, into MuJoCo's."""
        body, held, d = self.coupled.body, self.held, self.coupled.body.data
        speed = np.abs(held["qvel"])
        if not speed.max() < RUNAWAY:  # nan is never less
            at = int(np.argmax(np.nan_to_num(speed, nan=np.inf)))
            joint = body.model.joint(body.model.dof_jntid[at]).name
            message = (
                f"oracle: velocity of joint {joint!r} is {held['qvel'][at]:.3g} within {self.count} steps from t = {d.time:.4g} s"
            )
            raise SimDiverged(f"{message} (limit {RUNAWAY:g})", time=float(d.time), term="coupling", link=joint)
        d.qpos[:], d.qvel[:] = held["qpos"], held["qvel"]
        mujoco.mj_normalizeQuat(body.model, d.qpos)
        d.time += self.count * body.dt
        body.momentum[:], body.interior_speed[:] = held["last"].reshape(-1, 6), held["speed"]
        body.forward()
        if self.coupled.interior:
            self.coupled.gain += held["total"].reshape(-1, 6)
        self.coupled.steps += self.count

    def launch(self, part: Part = "steps") -> None:
        """Queue all of it; no look at the host, so that a graph can hold it."""
        boundary, fluid, e, tree = self.boundary, self.fluid, self._inside, self._tree
        block, at, measured = boundary.host, boundary.layout, int(boundary.interior is not None)
        boundary.fetch_place()
        boundary.fetch_equation()
        self._launch(fsi_solve.fetch, len(self._state), [self._host, self._state])
        follows = [e, block, at, boundary.target]
        self._launch(follow, self._threads, [tree, self._motions[0], *follows, 0, 0])
        for motion, rate in zip(self._motions, self._rates, strict=True):
            with self._beside():
                self._launch(equation, self._threads, [tree, motion, e, block, at, rate])
            boundary.assemble_response(fluid.f.flatten(), fluid.origin, fluid.box, e.slid)
            self._join()
            boundary.solve()
            with self._beside():
                boundary.sum_wrench()  # ahead of the body's move: about where the links were
                self._launch(follow, self._threads, [tree, motion, *follows, 1, measured])
            boundary.spread_force(fluid.force)
            fluid.stream_collide()
            boundary.clear_force(fluid.force)
            self._join()
        self._launch(fsi_solve.fetch, len(self._state), [self._state, self._host])

    def _beside(self):
        """Launches inside go beside those that come behind it, until `_join`."""
        return nullcontext() if self._branch is None else wp.ScopedStream(self._branch)

    def _join(self) -> None:
        if self._branch is not None:
            wp.get_stream(self.fluid.device).wait_stream(self._branch)

    def _launch(self, kernel: wp.Kernel, dim: int, inputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.fluid.device)
