"""Several coupled steps in a row without waiting for the host: the body also moves on the device.

    before   the host's block with the place of the body, state, servo commands of all steps    one launch of a graph
    a step   the water's response K, b0, solve  beside the interior water's speed
             F -> G, the water's step           beside v+ -> state -> pose, box -> the next step's equation, and its markers
    after    state, servo torques and joint rates of every step, wrenches, to the host          one wait, not for the water

If the commands are known one run ahead, `queue_next` starts the next steps before the host has read these back: the device
continues from its own state.

The arithmetic is that of `body.py` and `link_dynamics.py`, with a thread for each link and each degree of freedom
(`device_body.py`), and that of `kernels.py`, with a warp for each marker (`marker_warps.py`). The host's MuJoCo takes the
state at the end and continues from it, with this or step by step; at intervals it does the same steps itself (`audit`).
Servos and a push from outside drive the body, and some of its degrees of freedom may be held; other velocities that are
prescribed, and the explicit scheme, are left to the host.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.immersed import device_body, fsi_solve
from fishmj.lbm_oracle.immersed.articulated_body import Motion, motion_of, tree_of
from fishmj.lbm_oracle.immersed.body import RUNAWAY, ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_body import InteriorWater
from fishmj.lbm_oracle.immersed.marker_warps import PASSES, MarkerWarps

AGREES = 1e-9  # greatest difference from MuJoCo's own steps in an audit, over 1 + the greatest velocity: as `body.EXACT`
OFTEN = 2000  # looks at the host's memory between two at the device


class StepResults(NamedTuple):
    """Results of the steps of one run."""

    torque: np.ndarray  # (S, A) N m, of the servos, at the start of each step
    rate: np.ndarray  # (S, n) m/s and rad/s, at the same times
    fastest: float  # m/s, of a corner of the links' boxes after any of the steps


class QueuedSteps(NamedTuple):
    """One run that the device has to do."""

    number: int
    command: np.ndarray  # (S, A) rad
    held: np.ndarray  # (n,) 1 where the velocity is zero in all of them
    carried: int  # numbers of the state that the device has from the steps before; 0: the host sends it


class DeviceSteps:
    """Does `count` steps of a coupled fish at a time.

    Args:
        coupled: fish and water; servo gains, masses and damping of its model are read once, now.
        count: steps that `run` does.
        warps: use the markers' kernels of `marker_warps.py`, which need two passes; by default on an accelerator.

    Raises ConfigError: the explicit scheme, a body with an equation of its own, links that can part without bounds, or a model
    with more in it than the device computes (`tree_of`).
    """

    def __init__(self, coupled: FluidStructure, count: int, *, warps: bool | None = None):
        if coupled.scheme != "implicit":
            raise ConfigError(f"steps on the device: the coupling scheme is {coupled.scheme!r}; expected 'implicit'")
        if type(coupled.body) is not ImmersedBody:
            raise ConfigError(f"steps on the device: the body is a {type(coupled.body).__name__}; expected a plain ImmersedBody")
        body, self.boundary, self.fluid = coupled.body, coupled.boundary, coupled.fluid
        if self.boundary.spanned_axes:
            raise ConfigError(
                "steps on the device: the body's links can part without bounds; expected a chain or a tree of hinges"
            )
        self.coupled, self.count, device = (
            coupled,
            int(whole_numbers("steps on the device: count", count, low=1)),
            coupled.fluid.device,
        )
        self._tree, links, n, servos = tree_of(body.model, device), body.links, body.dofs, body.model.nu
        self._dof = body.model.jnt_dofadr[body.model.actuator_trnid[:, 0]]
        self._carried = {
            "qpos": body.model.nq,
            "qvel": n,
            "last_momentum": 6 * links,
            "layer_momentum": 6 * links,
            "speed": links,
        }  # the device can keep these
        sizes = self._carried | {"applied": n, "total_gain": 6 * links, "fastest": 1, "command": self.count * max(servos, 1)}
        self._sent_size = sum(sizes.values())  # what the host sends, besides the number of the run; the steps find the rest
        sizes |= {"actuator": self.count * n, "rate": self.count * n, "measured_speed": self.count * links, "done": 1}
        self._staging = wp.array(ptr=self.boundary.staging.ptr, dtype=wp.float64, shape=len(self.boundary.staging), device=device)
        self._state = wp.zeros(sum(sizes.values()), dtype=wp.float64, device=device)
        here, place = {}, 0  # by name
        for name, size in sizes.items():
            here[name], place = self._state[place : place + size], place + size
        # used in turns: one is read while the other is written
        self._host = [_HostMemory(sizes, 6 * links, device) for _ in range(2)]
        interior, pose = self._interior_of(body, here, 0), self.boundary.host[: body.pose.size]
        first = motion_of(body.model, device, qpos=here["qpos"], qvel=here["qvel"], pose=pose)
        structs = [self._tree, first, interior]
        self._packed = tuple(device_body.pack_arrays(structs, kind, device) for kind in (wp.int32, wp.float64))
        self._interiors = [interior, *(self._interior_of(body, here, k) for k in range(1, self.count))]
        self._motions = self._motions_of(body, here, first)
        self._rates = [here["rate"][k * n : (k + 1) * n] for k in range(self.count)]
        self._threads = fsi_solve.BLOCK if device.is_cuda else 1
        fits = self.boundary.passes == PASSES and (device.is_cuda if warps is None else warps)
        self._warps = MarkerWarps(self.boundary, self.fluid.f.dtype) if fits else None
        # higher priority than other tanks' water: a few small blocks at a time, for which everything else waits
        self._side_stream = wp.Stream(device, priority=-1) if device.is_cuda else None
        self._queued: list[QueuedSteps] = []
        self._runs = 0

    def _motions_of(self, body: ImmersedBody, here: dict[str, wp.array], first: Motion) -> list:
        """State structs of all steps: each has its own commands and torques; all other arrays are shared."""
        device, n, size = self.fluid.device, body.dofs, max(body.model.nu, 1)  # an array without entries cannot be cut
        again = ("screw", "drift", "momentum", "arm", "turned", "force", "mass_matrix", "bias", "passive")
        shared = {name: getattr(first, name) for name in again} | {"qpos": here["qpos"], "qvel": here["qvel"], "pose": first.pose}
        made = []
        for k in range(self.count):
            own = {"command": here["command"][k * size : (k + 1) * size], "actuator": here["actuator"][k * n : (k + 1) * n]}
            made.append(motion_of(body.model, device, **shared, **own))
        return made

    def _interior_of(self, body: ImmersedBody, here: dict[str, wp.array], k: int) -> InteriorWater:
        """Interior water in step k: each step measures a speed of its own; all other arrays are shared."""
        e: Any = InteriorWater()  # its fields are Warp's
        corners, water, device = self.boundary.corners, body.water, self.fluid.device
        make = lambda values: wp.array(np.ascontiguousarray(values, float).reshape(-1), dtype=wp.float64, device=device)
        weight = np.zeros((body.links, 6))
        weight[:, :3] = body.dt * water.mass[:, None] * body.model.opt.gravity
        e.dt, e.counts_gain = body.dt, int(self.coupled.interior)
        e.speed, e.applied, e.fastest = here["speed"], here["applied"], here["fastest"]
        e.last_momentum, e.total_gain, e.layer_momentum = (
            here[name] for name in ("last_momentum", "total_gain", "layer_momentum")
        )
        e.measured_speed = here["measured_speed"][k * body.links : (k + 1) * body.links]
        e.has_layers = int(body.layers.any())
        (e.dx, e.grid, e.size) = corners.grid
        if k:
            for name in ("mass", "centre", "inertia", "layers", "weight", "push", "link_boxes", "corner"):
                setattr(e, name, getattr(self._first, name))
            return e
        self._first = e
        e.mass, e.centre, e.inertia, e.weight = make(water.mass), make(water.centre), make(water.inertia), make(weight)
        e.layers = make(body.layers)
        e.push, e.link_boxes, e.corner = make(np.zeros(6 * body.links)), make(np.zeros(7 * body.links)), make(corners.at)
        return e

    def run(self, command: np.ndarray, held: np.ndarray | None = None) -> StepResults:
        """Does `count` steps; arguments as `queue`, raises as `queue` and `finish`."""
        self.queue(command, held)
        try:
            return self.finish()
        finally:
            self.coupled.join_stream()

    def queue(self, command: np.ndarray, held: np.ndarray | None = None) -> None:
        """Starts the steps on the device; the host may serve another tank meanwhile.

        Args:
            command: (count, A) rad, targets of the servos in each step.
            held: (n,) 1 for velocities that are zero in all of them.

        Raises ConfigError: not a command for every step and servo; or a marker is so near to a face at the start that its kernel
        would read beyond it.
        """
        body, command = self.coupled.body, self._checked(command)
        fixed = np.zeros(body.dofs) if held is None else np.asarray(held, float)
        self._queued = []  # a new start gives up all sets in flight
        self.coupled.place_markers()
        self.boundary.set_equation(body.system, 0.0, fixed, 0.0)  # the device finds the rest anew
        sent = self._host[(self._runs + 1) % 2].sent
        sent["qpos"][:], sent["qvel"][:] = body.data.qpos, body.data.qvel
        sent["last_momentum"][:], sent["speed"][:] = body.momentum.ravel(), body.interior_speed
        sent["layer_momentum"][:] = body.layer_momentum.ravel()
        self._send(command, fixed, 0)

    def queue_next(self, command: np.ndarray) -> None:
        """Queues the steps that follow those under way, from the state in which the device will then be.

        The same velocities stay held.

        Raises ConfigError: not a command for every step and servo; no steps are under way, or two sets of them are.
        """
        if not self.can_queue_next or len(self._queued) != 1:
            raise ConfigError(f"steps on the device: {len(self._queued)} sets under way; `queue_next` goes behind one")
        self._send(self._checked(command), self._queued[0].held, sum(self._carried.values()))

    @property
    def can_queue_next(self) -> bool:
        """Returns True if the next steps can be queued behind those under way."""
        return self._warps is not None

    @property
    def sets_in_flight(self) -> int:
        """Number of sets of steps that were queued and not finished."""
        return len(self._queued)

    def _checked(self, command: np.ndarray) -> np.ndarray:
        command, shape = np.asarray(command, float), (self.count, len(self._dof))
        if command.shape != shape:
            raise ConfigError(f"steps on the device: commands of shape {command.shape}; expected {shape}, rad, one row a step")
        return numbers("steps on the device: command", command, shape)

    def _send(self, command: np.ndarray, fixed: np.ndarray, carried: int) -> None:
        """Writes the host's input of one set of steps, and launches them."""
        self._runs += 1
        sent = self._host[self._runs % 2].sent
        sent["applied"][:], sent["total_gain"][:], sent["fastest"][:] = self.coupled.body.applied, 0.0, 0.0
        sent["command"][: command.size], sent["done"][:] = command.ravel(), self._runs
        self._queued.append(QueuedSteps(self._runs, command, fixed, carried))
        if self.coupled.graphs is None:
            self.launch()
        else:
            self.coupled.graphs.launch("steps", self.launch, (self.count, carried, self._runs % 2))

    def ready(self) -> bool:
        """Returns True if the final state of the oldest steps under way is on the host. The water may still be under way."""
        number = self._queued[0].number
        return self.coupled.graphs is None or self._host[number % 2].returned["done"][0] == number

    def finish(self, audit: bool = False) -> StepResults:
        """Waits for the state and hands it to MuJoCo; the water may still be under way (`FluidStructure.join_stream`).

        Args:
            audit: MuJoCo does the same steps first, and both results are compared; nothing may be queued behind them.

        Raises SimDiverged: a velocity is not finite or too large, or (`audit`) MuJoCo found something else. The body is then as
        before; the water is not.
        """
        graphs = self.coupled.graphs
        while not self.ready():
            for _ in range(OFTEN):
                if self.ready():
                    break
            else:
                if graphs is not None and graphs.idle() and not self.ready():
                    raise SimDiverged("steps on the device: it ended without a state", time=self.coupled.time, term="coupling")
        queued, behind = self._queued[0], self._queued[1:]
        self._queued, self.returned = [], self._host[queued.number % 2].returned  # an error drops the sets behind, too
        self._check_speed()
        if audit:
            self._audit(queued.command, queued.held > 0.5)
        self._update_mujoco()
        self._queued = behind
        returned, shape = self.returned, (self.count, self.coupled.body.dofs)
        torque, rate = returned["actuator"].reshape(shape)[:, self._dof], returned["rate"].reshape(shape)
        return StepResults(torque.copy(), rate.copy(), float(returned["fastest"][0]))

    def _check_speed(self) -> None:
        """Raises SimDiverged for a state that MuJoCo cannot take."""
        body, returned, time = self.coupled.body, self.returned, self.coupled.time
        speed, within = np.abs(returned["qvel"]), f"within {self.count} steps from t = {time:.4g} s"
        if not speed.max() < RUNAWAY:  # nan is never less
            at = int(np.argmax(np.nan_to_num(speed, nan=np.inf)))
            joint = body.model.joint(body.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {returned['qvel'][at]:.3g} {within} (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=time, term="coupling", link=joint)

    def _update_mujoco(self) -> None:
        """Copies the final state into MuJoCo's."""
        body, returned, d = self.coupled.body, self.returned, self.coupled.body.data
        d.qpos[:], d.qvel[:] = returned["qpos"], returned["qvel"]
        mujoco.mj_normalizeQuat(body.model, d.qpos)
        d.time += self.count * body.dt
        if len(self._dof):
            d.ctrl[:] = returned["command"].reshape(self.count, -1)[-1]
        body.momentum[:], body.interior_speed[:] = returned["last_momentum"].reshape(-1, 6), returned["speed"]
        body.layer_momentum[:] = returned["layer_momentum"].reshape(-1, 6)
        body.forward()
        self.boundary.set_wrench(returned["wrench"].reshape(-1, 6))
        if self.coupled.interior:
            self.coupled.gain += returned["total_gain"].reshape(-1, 6)
        self.coupled.steps, self.coupled.steps_since_sync = self.coupled.steps + self.count, self.count

    def _audit(self, command: np.ndarray, held: np.ndarray) -> None:
        """Compares MuJoCo's own steps, `mj_step` to the velocity of each, with the device's; the body is put back.

        Compared are the servo torques of every step, the final state, and in the last step the velocity that follows from
        MuJoCo's masses and forces with the response of the water that the device found.

        Raises SimDiverged: they differ by more than `AGREES`.
        """
        coupled, body, returned = self.coupled, self.coupled.body, self.returned
        d, n, time = body.data, body.dofs, self.coupled.time
        kept = d.qpos.copy(), d.qvel.copy(), body.momentum.copy(), body.interior_speed.copy(), d.ctrl.copy()
        layers = body.layer_momentum.copy()
        actuator, rates = returned["actuator"].reshape(self.count, n), returned["rate"].reshape(self.count, n)
        measured_speed, torque, right = returned["measured_speed"].reshape(self.count, -1), np.zeros(n), np.zeros(n)
        try:
            for k in range(self.count):
                d.ctrl[:] = command[k]
                system, right = body.equation(interior=coupled.interior)
                torque = np.maximum(torque, np.abs(d.qfrc_actuator - actuator[k]))
                if k == self.count - 1:
                    self.coupled.wait_for_water()
                    k_water, b_water = self.boundary.response
                    whole = np.where(held[:, None], np.eye(n), system + k_water)
                    expected = np.linalg.solve(whole, np.where(held, 0.0, right - b_water))
                if self.boundary.interior is not None:
                    body.set_interior_speed(measured_speed[k])
                body.advance(rates[k + 1] if k + 1 < self.count else returned["qvel"])
            pairs = {
                "velocity": (returned["qvel"], expected),
                "position": (returned["qpos"], d.qpos),
                "torque": (torque, np.zeros(n)),
            }
            allowed = AGREES * (1.0 + float(np.abs(returned["qvel"]).max()))
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
            body.momentum[:], body.layer_momentum[:] = momentum, layers

    # launches: none waits for the host, so that a graph can hold them ---------------------------------------------------

    def launch(self) -> None:
        """Queues all steps: `FluidStructure.stepping` without the host, the markers' part fused into four kernels."""
        boundary, fluid, tree = self.boundary, self.fluid, self._tree
        block, at, wrench = boundary.host, boundary.layout, boundary.wrench_sum
        number, carried = self._queued[-1].number, self._queued[-1].carried
        host = self._host[number % 2]
        with self._branch(self._side_stream):
            sent = [tree, at, block, self._staging, self._state, host.device_sent, wrench, carried, self._sent_size]
            self._launch(device_body.load_state, sent)
            if carried:  # the pose stands
                self._queue_equation(0)
            else:
                self._queue_motion(0, 0)
            self._queue_markers()
        if self._warps is not None and not carried:
            self._warps.begin()
        for k in range(self.count):
            self._join_branch(self._side_stream)
            if self._warps is None:
                boundary.assemble_response(fluid.f.flatten(), fluid.origin, fluid.box, self._interiors[k].measured_speed)
                boundary.solve()
                boundary.spread_force(fluid.f.flatten(), fluid.force)
            else:
                with self._branch(self._side_stream):
                    boundary.measure_interior(fluid.f.flatten(), self._interiors[k].measured_speed)
                self._warps.sample_fluid(fluid.f.flatten(), fluid.origin, fluid.box, fluid.force)
                self._warps.assemble_response()
                self._warps.spread_force(fluid.f.flatten(), fluid.force)
            with self._branch(self._side_stream):
                if self._warps is None:
                    boundary.sum_wrench()  # before the body moves: about where the links were
                self._queue_motion(k, 1)
                if k + 1 < self.count:
                    self._queue_markers()
                else:
                    self._launch(device_body.return_state, [self._state, host.device_returned, wrench])
            fluid.stream_collide()
            if self._warps is None:
                boundary.clear_force(fluid.force)
        if self._warps is not None:
            boundary.clear_force(fluid.force)
        self._join_branch(self._side_stream)

    def _queue_motion(self, k: int, moves: int) -> None:
        """Queues the state after step k (`moves`), or the pose of the present state, and the equation of the following step."""
        coming = k + moves
        assembles, coming = int(coming < self.count), min(coming, self.count - 1)
        block, at, measured = self.boundary.host, self.boundary.layout, int(self.boundary.interior is not None)
        args = [self._tree, self._motions[k], self._interiors[k], block, at, self.boundary.target, moves, measured]
        args += [self._motions[coming], self._rates[coming], assembles]
        self._launch(device_body.move_body, [*args, *self._packed, self._state])

    def _queue_markers(self) -> None:
        """Queues the markers' positions, after `move_body`."""
        if self._warps is not None:
            self._warps.place_markers()

    def _queue_equation(self, k: int) -> None:
        """Queues the body's equation of step k."""
        block, at, rate = self.boundary.host, self.boundary.layout, self._rates[k]
        args = [self._tree, self._motions[k], self._interiors[k], block, at, rate, *self._packed, self._state]
        self._launch(device_body.assemble_equation, args)

    @contextmanager
    def _branch(self, stream: "wp.Stream | None") -> Iterator[None]:
        """Launches inside come after all work queued so far, and run in parallel with later work until `_join_branch`."""
        if stream is None:
            yield
            return
        stream.wait_stream(wp.get_stream(self.fluid.device))
        with wp.ScopedStream(stream, sync_enter=False):
            yield

    def _join_branch(self, stream: "wp.Stream | None") -> None:
        if stream is not None:
            wp.get_stream(self.fluid.device).wait_stream(stream)

    def _launch(self, kernel: wp.Kernel, inputs: list) -> None:
        wp.launch(kernel, dim=self._threads, inputs=inputs, device=self.fluid.device)


class _HostMemory:
    """Pinned memory between host and device: fields by name on the host, flat arrays on the device."""

    def __init__(self, sizes: dict[str, int], wrenches: int, device: Any):
        whole = sum(sizes.values())
        self._pinned = wp.zeros(2 * whole + wrenches, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        seen = wp.array(ptr=self._pinned.ptr, dtype=wp.float64, shape=2 * whole + wrenches, device=device)
        self.device_sent, self.device_returned = seen[:whole], seen[whole:]
        self.sent, self.returned, place = {}, {}, 0
        for name, size in sizes.items():
            self.sent[name] = self._pinned.numpy()[place : place + size]
            self.returned[name] = self._pinned.numpy()[whole + place : whole + place + size]
            place += size
        self.returned["wrench"] = self._pinned.numpy()[2 * whole :]
