"""Several coupled steps in a row that never wait for the host: the body moves on the device, too.

    before   the host's block with the place of the body, state, servo commands of all steps    one launch of a graph
    a step   water far from the body            beside all of the following
             the water's response K, b0, solve  beside the interior water's speed
             F -> G, water round the body       beside `follow`: v+ -> state -> pose, box, the next step's equation
    after    state, servo torques and joint rates of every step, wrenches, to the host          one wait, not for the water

The arithmetic is that of `body.py` and `link_dynamics.py`, with a thread for each link and each degree of freedom
(`device_body.py`), and that of `kernels.py`, with a warp for each marker (`marker_warps.py`). Water far from the body is planes
of x that its force cannot reach within these steps: it needs the last step's water only. The host's MuJoCo takes the state at
the end and goes on from there, with this or step by step; every so often it does the same steps itself (`audit`). Servos and a
push from outside drive the body; velocities that are prescribed, and the explicit scheme, are left to the host's steps.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp

from fishmj.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.fluid.fluid import Fluid, pieces
from fishmj.lbm_oracle.immersed import device_body, fsi_solve
from fishmj.lbm_oracle.immersed.articulated_body import motion_of, tree_of
from fishmj.lbm_oracle.immersed.body import RUNAWAY, ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_body import Inside
from fishmj.lbm_oracle.immersed.marker_warps import PASSES, MarkerWarps

AGREES = 1e-9  # greatest difference from MuJoCo's own steps in an audit, over 1 + the greatest velocity: as `body.EXACT`
AROUND, DRIFT = 4, 2  # planes of x on both sides of the scratch box that count as near; of which it may move in one run
GRAIN = 8  # planes: a body that moves by less keeps the graph
OFTEN = 2000  # looks at the host's memory between two at the device


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
        split: step the water far from the body beside the rest, in a box that is long enough.

    Raises:
        ConfigError: the explicit scheme, a body with an equation of its own, or a model with more in it than the device
            computes (`tree_of`).
    """

    def __init__(self, coupled: FluidStructure, count: int, *, split: bool = False, warps: bool | None = None):
        if coupled.scheme != "implicit":
            raise ConfigError(f"steps on the device: the coupling scheme is {coupled.scheme!r}; expected 'implicit'")
        if type(coupled.body) is not ImmersedBody:
            raise ConfigError(f"steps on the device: the body is a {type(coupled.body).__name__}; expected a plain ImmersedBody")
        body, self.boundary, self.fluid = coupled.body, coupled.boundary, coupled.fluid
        self.coupled, self.count, device = coupled, int(count), coupled.fluid.device
        self._tree, links, n, servos = tree_of(body.model, device), body.links, body.dofs, body.model.nu
        self._dof = body.model.jnt_dofadr[body.model.actuator_trnid[:, 0]]
        sizes = {"qpos": body.model.nq, "qvel": n, "last": 6 * links, "speed": links, "applied": n, "total": 6 * links}
        sizes |= {"fastest": 1, "planes": 2, "command": self.count * max(servos, 1), "actuator": self.count * n}
        sizes |= {"rate": self.count * n, "slid": self.count * links, "done": 1}
        whole = sum(sizes.values())
        self._pinned = wp.zeros(2 * whole, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        seen = wp.array(ptr=self._pinned.ptr, dtype=wp.float64, shape=2 * whole, device=device)  # as the device sees it
        self._sent, self._returned = seen[:whole], seen[whole:]
        self._block = wp.array(ptr=self.boundary.staging.ptr, dtype=wp.float64, shape=len(self.boundary.staging), device=device)
        self._state = wp.zeros(whole, dtype=wp.float64, device=device)
        self.held, self.found, here, place = {}, {}, {}, 0  # by name: what the host sends, what comes back, on the device
        for name, size in sizes.items():
            self.held[name], here[name] = self._pinned.numpy()[place : place + size], self._state[place : place + size]
            self.found[name] = self._pinned.numpy()[whole + place : whole + place + size]
            place += size
        self._insides = [self._inside_of(body, here, k) for k in range(self.count)]
        self._motions = self._motions_of(body, here)
        self._rates = [here["rate"][k * n : (k + 1) * n] for k in range(self.count)]
        self._threads = fsi_solve.BLOCK if device.is_cuda else 1
        plain = type(self.fluid) is Fluid
        fits = self.boundary.passes == PASSES and self.fluid.f.dtype is wp.float32
        self._warps = MarkerWarps(self.boundary) if fits and (device.is_cuda if warps is None else warps) else None
        room = self.boundary.box_shape[0] + 2 * AROUND + 2 * GRAIN
        self._splits = plain and 2 * room <= self.fluid.shape[0] and split
        # ahead of the far water: a few small blocks at a time, for which everything else waits
        self._side, self._masses = (wp.Stream(device, priority=-1) if device.is_cuda else None for _ in range(2))
        self._far = wp.Stream(device) if device.is_cuda else None
        self._ends = [wp.Event(device) for _ in range(2)] if device.is_cuda else [None, None]  # of far water, step by step
        self._started: tuple | None = None
        self._runs = 0

    def _motions_of(self, body: ImmersedBody, here: dict[str, wp.array]) -> list:
        """The state in each step: its own commands and torques, all else is used again."""
        device, n, size = self.fluid.device, body.dofs, max(body.model.nu, 1)  # an array without entries cannot be cut
        pose = self.boundary.host[: body.pose.size]
        first = motion_of(body.model, device, qpos=here["qpos"], qvel=here["qvel"], pose=pose)
        again = ("screw", "drift", "momentum", "arm", "turned", "force", "mass_matrix", "bias", "passive")
        shared = {name: getattr(first, name) for name in again} | {"qpos": here["qpos"], "qvel": here["qvel"], "pose": pose}
        made = []
        for k in range(self.count):
            own = {"command": here["command"][k * size : (k + 1) * size], "actuator": here["actuator"][k * n : (k + 1) * n]}
            made.append(motion_of(body.model, device, **shared, **own))
        return made

    def _inside_of(self, body: ImmersedBody, here: dict[str, wp.array], k: int) -> Inside:
        """The water inside in step k: each measures a speed of its own, all else is used again."""
        e: Any = Inside()  # its fields are Warp's
        corners, water, device = self.boundary.corners, body.water, self.fluid.device
        make = lambda values: wp.array(np.ascontiguousarray(values, float).reshape(-1), dtype=wp.float64, device=device)
        weight = np.zeros((body.links, 6))
        weight[:, :3] = body.dt * water.mass[:, None] * body.model.opt.gravity
        e.dt, e.counts = body.dt, int(self.coupled.interior)
        e.speed, e.last, e.total, e.applied, e.fastest = (here[name] for name in ("speed", "last", "total", "applied", "fastest"))
        e.planes, e.slid = here["planes"], here["slid"][k * body.links : (k + 1) * body.links]
        (e.dx, e.grid, e.size) = corners.grid
        if k:
            for name in ("mass", "centre", "inertia", "weight", "push", "seen", "corner"):
                setattr(e, name, getattr(self._first, name))
            return e
        self._first = e
        e.mass, e.centre, e.inertia, e.weight = make(water.mass), make(water.centre), make(water.inertia), make(weight)
        e.push, e.seen, e.corner = make(np.zeros(6 * body.links)), make(np.zeros(7 * body.links)), make(corners.at)
        return e

    def run(self, command: np.ndarray) -> Seen:
        """`count` steps under the servo commands (count, A) rad; raises as `queue` and `finish`."""
        self.queue(command)
        try:
            return self.finish()
        finally:
            self.coupled.join_stream()

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
        held["fastest"][:], held["planes"][:], held["command"][: command.size] = 0.0, (np.inf, -np.inf), command.ravel()
        if len(self._dof):
            body.data.ctrl[:] = command[-1]
        self._runs += 1
        held["done"][:], self._started = self._runs, (command, self._near())
        if self.coupled.graphs is None:
            self.launch()
        else:
            self.coupled.graphs.launch("steps", self.launch, (self.count, self._started[1]))

    def _near(self) -> tuple[int, int] | None:
        """First world plane of x that counts as near, and how many; None where the water is stepped as a whole."""
        if not self._splits:
            return None
        first = int(self.boundary.view["box"][0])
        low = (first - AROUND) // GRAIN * GRAIN
        return low, -(-(first + self.boundary.box_shape[0] + AROUND) // GRAIN) * GRAIN - low

    def ready(self) -> bool:
        """Is the state on the host? The water may still be under way."""
        return self.coupled.graphs is None or self.found["done"][0] == self._runs

    def finish(self, audit: bool = False) -> Seen:
        """Wait for the state, and hand it to MuJoCo; the water may still be under way (`FluidStructure.join_stream`).

        Args:
            audit: MuJoCo does the same steps first, and the two are compared.

        Raises:
            SimDiverged: a velocity is not finite or runs away, the body moved too far for one run, or (`audit`) MuJoCo found
                something else. The body is then as it was before; the water is not.
        """
        graphs = self.coupled.graphs
        while not self.ready():
            for _ in range(OFTEN):
                if self.ready():
                    break
            else:
                if graphs is not None and graphs.idle() and not self.ready():
                    raise SimDiverged("steps on the device: it ended without a state", time=self.coupled.time, term="coupling")
        self._judge()
        if audit:
            self._audit()
        self._take()
        found, shape = self.found, (self.count, self.coupled.body.dofs)
        torque, rate = found["actuator"].reshape(shape)[:, self._dof], found["rate"].reshape(shape)
        return Seen(torque.copy(), rate.copy(), float(found["fastest"][0]))

    def _judge(self) -> None:
        """Raise SimDiverged for a state that MuJoCo cannot take."""
        body, found, time = self.coupled.body, self.found, self.coupled.time
        speed, within = np.abs(found["qvel"]), f"within {self.count} steps from t = {time:.4g} s"
        if not speed.max() < RUNAWAY:  # nan is never less
            at = int(np.argmax(np.nan_to_num(speed, nan=np.inf)))
            joint = body.model.joint(body.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {found['qvel'][at]:.3g} {within} (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=time, term="coupling", link=joint)
        low, high = found["planes"]
        if self._splits and high - low > DRIFT:
            message = f"oracle: the body moved by {high - low:.0f} cells {within} (limit {DRIFT})"
            raise SimDiverged(message, time=time, term="coupling")

    def _take(self) -> None:
        """The state at the end, into MuJoCo's."""
        body, found, d = self.coupled.body, self.found, self.coupled.body.data
        d.qpos[:], d.qvel[:] = found["qpos"], found["qvel"]
        mujoco.mj_normalizeQuat(body.model, d.qpos)
        d.time += self.count * body.dt
        body.momentum[:], body.interior_speed[:] = found["last"].reshape(-1, 6), found["speed"]
        body.forward()
        if self.coupled.interior:
            self.coupled.gain += found["total"].reshape(-1, 6)
        self.coupled.steps, self.coupled.together = self.coupled.steps + self.count, self.count

    def _audit(self) -> None:
        """MuJoCo's own steps, `mj_step` to the velocity of each, beside what the device did; the body is put back.

        Compared: servo torques of every step, the state at the end, and in the last step the velocity that MuJoCo's masses and
        forces give with the response of the water that the device found there.

        Raises:
            SimDiverged: they differ by more than `AGREES`.
        """
        coupled, body, found = self.coupled, self.coupled.body, self.found
        d, n, time = body.data, body.dofs, self.coupled.time
        kept = d.qpos.copy(), d.qvel.copy(), body.momentum.copy(), body.interior_speed.copy(), d.ctrl.copy()
        command, _ = self._started or (np.zeros((self.count, 0)), None)
        actuator, rates = found["actuator"].reshape(self.count, n), found["rate"].reshape(self.count, n)
        slid, torque, right = found["slid"].reshape(self.count, -1), np.zeros(n), np.zeros(n)
        try:
            for k in range(self.count):
                d.ctrl[:] = command[k]
                system, right = body.equation(interior=coupled.interior)
                torque = np.maximum(torque, np.abs(d.qfrc_actuator - actuator[k]))
                if k == self.count - 1:
                    wp.synchronize_device(self.fluid.device)
                    k_water, b_water = self.boundary.response
                    expected = np.linalg.solve(system + k_water, right - b_water)
                if self.boundary.interior is not None:
                    body.set_interior_speed(slid[k])
                body.advance(rates[k + 1] if k + 1 < self.count else found["qvel"])
            pairs = {
                "velocity": (found["qvel"], expected),
                "position": (found["qpos"], d.qpos),
                "torque": (torque, np.zeros(n)),
            }
            allowed = AGREES * (1.0 + float(np.abs(found["qvel"]).max()))
            for name, (mine, theirs) in pairs.items():
                off = np.abs(mine - theirs)
                if not off.max(initial=0.0) <= allowed:
                    at = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
                    message = (
                        f"oracle: audit by mj_step at t = {time:.4g} s: {name} {at} is {mine[at]:.12g} on the device and"
                        f" {theirs[at]:.12g} in MuJoCo; expected a difference of {allowed:.1g} at most"
                    )
                    raise SimDiverged(message, time=time, term="mj_step")
        finally:
            qpos, qvel, momentum, speed, d.ctrl[:] = kept
            d.time = time
            body.place(qpos, qvel, speed)
            body.momentum[:] = momentum

    # launches: no look at the host, so that a graph can hold them -------------------------------------------------------

    def launch(self) -> None:
        """Queue all of it."""
        boundary, fluid, tree, measured = self.boundary, self.fluid, self._tree, int(self.boundary.interior is not None)
        block, at, (wrench, wrench_on_host) = boundary.host, boundary.layout, boundary.wrench_arrays
        near = self._started[1] if self._started else None
        with self._beside(self._side):
            self._launch(device_body.begin, [at, block, self._block, self._state, self._sent, wrench])
            self._launch(device_body.follow, [tree, self._motions[0], self._insides[0], block, at, boundary.target, 0, measured])
        if self._warps is not None:
            self._warps.begin()
        behind: wp.Event | None = None  # the far water's step before is done
        for k in range(self.count):
            ended = self._step_far(near, self._ends[k % 2])
            self._join(self._side)
            with self._beside(self._masses):
                args = [tree, self._motions[k], self._insides[k], block, at, self._rates[k]]
                self._launch(device_body.equation, args)
            if self._warps is None:
                boundary.assemble_response(fluid.f.flatten(), fluid.origin, fluid.box, self._insides[k].slid)
                self._join(self._masses)
                boundary.solve()
                boundary.spread_force(fluid.force)
            else:
                with self._beside(self._side):
                    boundary.measure_interior(fluid.f.flatten(), self._insides[k].slid)
                self._warps.look(fluid.f.flatten(), fluid.origin, fluid.box, fluid.force)
                self._join(self._masses)
                self._warps.answer()
                self._warps.push(fluid.force)
            with self._beside(self._side):
                if self._warps is None:
                    boundary.sum_wrench()  # ahead of the body's move: about where the links were
                after = [tree, self._motions[k], self._insides[k], block, at, boundary.target, 1, measured]
                self._launch(device_body.follow, after)
                if k + 1 == self.count:
                    self._launch(device_body.give_back, [self._state, self._returned, wrench, wrench_on_host])
            self._step_near(near, behind)
            behind = ended
            if self._warps is None:
                boundary.clear_force(fluid.force)
        if self._warps is not None:
            boundary.clear_force(fluid.force)
        self._join(self._side)
        if near is not None:
            self._join(self._far)

    def _step_far(self, near: tuple[int, int] | None, end: "wp.Event | None") -> "wp.Event | None":
        """Queue the planes that no force reaches, beside what comes behind; `end` is set behind them."""
        if near is None:
            return None
        low, count = near
        with self._beside(self._far):
            for first, planes in pieces(low + count, self.fluid.shape[0] - count, self.fluid.shape[0]):
                self.fluid.planes(first, planes).launch()
        return None if self._far is None or end is None else self._far.record_event(end)

    def _step_near(self, near: tuple[int, int] | None, behind: "wp.Event | None") -> None:
        """Queue the planes round the body, or all; then this step of the water is counted."""
        if near is None:
            return self.fluid.stream_collide()
        if behind is not None:
            wp.get_stream(self.fluid.device).wait_event(behind)
        for first, planes in pieces(*near, self.fluid.shape[0]):
            self.fluid.planes(first, planes).launch()
        return self.fluid.skip(1)

    @contextmanager
    def _beside(self, stream: "wp.Stream | None") -> Iterator[None]:
        """Launches inside come behind what was queued so far, and beside what will be, until `_join`."""
        if stream is None:
            yield
            return
        stream.wait_stream(wp.get_stream(self.fluid.device))
        with wp.ScopedStream(stream, sync_enter=False):
            yield

    def _join(self, stream: "wp.Stream | None") -> None:
        if stream is not None:
            wp.get_stream(self.fluid.device).wait_stream(stream)

    def _launch(self, kernel: wp.Kernel, inputs: list) -> None:
        wp.launch(kernel, dim=self._threads, inputs=inputs, device=self.fluid.device)
