"""The water: arrays, one step, the velocity that a body would meet, and read-out.

Two copies of the populations and of the velocity take turns; `f`, `u` and `clock` are the present ones. Step n reads copy
n % 2 and writes the other, so a captured graph holds an even number of steps. The launches of a step are recorded once: one on
an accelerator; on a CPU one for each core, each a slab of x.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import checked_kind, shown_value
from fishmj.lbm_oracle.fluid import fields
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.fluid.domain_faces import PERIODIC, Boundaries
from fishmj.lbm_oracle.fluid.fields import Survey, Surveyor
from fishmj.lbm_oracle.fluid.guard import (
    StabilityMonitor,
    check_density,
    check_snapshot,
    check_speed,
    check_tau,
    numbers,
    whole_numbers,
)
from fishmj.lbm_oracle.fluid.in_kernels import vec19i
from fishmj.lbm_oracle.fluid.inflow import inflow_of
from fishmj.lbm_oracle.fluid.lattice import Lattice, Q
from fishmj.lbm_oracle.fluid.pairs import split_by, stream_collide_pairs
from fishmj.lbm_oracle.fluid.rows import stream_collide_rows
from fishmj.lbm_oracle.fluid.slabs import launch_slabs, record_slabs, slabs_for
from fishmj.lbm_oracle.fluid.step import Params, stream_collide
from fishmj.lbm_oracle.fluid.storage import STORAGE, decoded, encoded, velocity_type
from fishmj.water.flow import Flow

ROWS = 40_000  # cells from which on a CPU goes by rows: five times as fast, and longer to compile
FLAT = 2  # cells along z up to which it goes by cells: a vector register would hold one row. 13 and 13 MLUPS, by rows 6 and 12
CW, OMEGA_BULK, BLEND, LAYER = (constant("oracle", name) for name in ("wale", "omega_bulk", "blend", "blend_layer"))
NOWHERE = ((0, 0, 0), (0, 0, 0))
STRIDES = (20, 2)  # steps in a captured graph: between two of them the device pauses for a microsecond or two
BYTES_PER_CELL = 2 * 4 * Q + 2 * 12 + 12  # populations and velocity twice, force, without eddy viscosity

Box = tuple[tuple[int, int, int], tuple[int, int, int]]  # nodes of the present window, low inclusive, high exclusive


def blend_at(lattice: Lattice) -> float:
    """Blend for a swim in metres and seconds: the paper's value at the paper's dt / dx, elsewhere in proportion to dt / dx.

    A shorter step therefore loses no more stress in a second.
    """
    return min(1.0, BLEND * constant("oracle", "dx") / constant("oracle", "dt") / lattice.velocity)


def kernel_for(shape: tuple[int, int, int], device) -> tuple[Callable[..., wp.Kernel], int]:
    """Returns the factory of the step's kernel and the number of threads in a plane of x. All kernels compute the same."""
    row, cells = shape[2], int(np.prod(shape))
    if device.is_cuda and row % 2 == 0:
        return stream_collide_pairs, shape[1] * row // 2
    if not device.is_cuda and cells >= ROWS and row > FLAT:
        return stream_collide_rows, 1
    return stream_collide, shape[1] * row


class Fluid:
    """A box of water, still or in the background flow, on `cpu` or `cuda`.

    Attributes:
        f: (19, nx, ny, nz) populations after collision, minus their weights; the next step pulls them. float32, or float16 and
            scaled (`storage`).
        u: (nx, ny, nz) velocity of the last step as stored (storage.py); without `keep_velocity` it is derived on access.
        force: (nx, ny, nz) vec3, acceleration G by the body, zero outside the box given to `step`.
        box: (6,) int32, low and high world node of that box, on the device.
        origin: (6,) int32, world node of the low corner and the same modulo shape, on the device (`origin_lu` on the host).
        clock: (1,) int32, steps done.

    Args:
        boundaries: kinds of the six faces. subgrid: eddy viscosity, `wale` or `none`. cw: WALE's constant.
        flow: background flow, still water by default. body_acceleration: (3,) m/s2, everywhere.
        omega_bulk: rate at which the trace of the stress relaxes. blend: share of the stress from the velocity gradient in a step
            of this grid (collide.py), 0 to 1; 0 is kept to show that it fails. `blend_at` adapts it to another step.
        dtype: storage of the populations. threads: slabs on a CPU; all cores by default.

    Arrays are indexed by world node modulo shape. `step` and `run` check the water every 50 steps (`watch`).

    Raises:
        ConfigError, UnknownName: invalid arguments.
        OracleUnstable: a flow or a wall beyond Mach 0.3, tau below 0.5005 without eddy viscosity; later, the limits of `watch`.
    """

    def __init__(
        self,
        lattice: Lattice,
        shape: tuple[int, int, int],
        device: Any = "cpu",
        *,
        boundaries: Boundaries = PERIODIC,
        subgrid: str = "wale",
        flow: Flow | None = None,
        body_acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0),
        cw: float = CW,
        omega_bulk: float = OMEGA_BULK,
        blend: float = BLEND,
        dtype: str = "float32",
        keep_velocity: bool = True,
        threads: int | None = None,
    ):
        checked_kind("fluid: lattice", lattice, Lattice, needed=True)
        checked_kind("fluid: boundaries", boundaries, Boundaries, needed=True)
        if dtype not in STORAGE:
            raise UnknownName("storage", dtype, STORAGE)
        if subgrid != "none" and not keep_velocity:
            raise ConfigError("fluid: the eddy viscosity reads the velocity of the last step; keep_velocity must be True with it")
        if subgrid != "none" and "moving" in boundaries.kinds:
            raise ConfigError(
                "fluid: a moving wall with an eddy viscosity: its node would stand in for the wall in the velocity gradient, and"
                " the shear would be wrong; take subgrid = 'none'"
            )
        whole_numbers("fluid: shape", shape, (3,), low=1)
        if Q * np.prod(shape, dtype=float) >= 2**31:
            raise ConfigError(f"fluid: shape = {shape}; expected three sizes with under {2**31 // Q} cells in all")
        numbers("fluid: body_acceleration", body_acceleration, (3,))
        for name, value, most in (("cw", cw, np.inf), ("omega_bulk", omega_bulk, 2.0), ("blend", blend, 1.0)):
            numbers(f"fluid: {name}", value, low=0.0, high=most)
        if threads is not None:
            whole_numbers("fluid: threads", threads, low=1)
        check_tau(lattice, subgrid, "fluid")
        check_speed(lattice, float(np.linalg.norm(boundaries.wall_velocity_lu)) * lattice.velocity, "fluid: moving wall")
        check_speed(lattice, float(np.linalg.norm(body_acceleration)) * lattice.dt, "fluid: body_acceleration, in a step")
        boundaries.check_room(shape)
        self.lattice, self.boundaries, self.subgrid = lattice, boundaries, subgrid
        self.shape = shape = (int(shape[0]), int(shape[1]), int(shape[2]))
        self.device = device if isinstance(device, wp.Device) else device_of(device, BYTES_PER_CELL * int(np.prod(shape)))
        self.flow = checked_kind("fluid: flow", flow, Flow) or Flow()
        make, self._plane = kernel_for(shape, self.device)
        self._kernel, self._paired = make(boundaries.axes, subgrid == "wale", dtype, keep_velocity), make is stream_collide_pairs
        self._keeps = keep_velocity
        self._options: dict[str, Any] = {"cw": cw, "omega_bulk": omega_bulk, "blend": blend, "dtype": dtype}
        self._options["body_acceleration"] = body_acceleration
        self.params = _params(lattice, shape, boundaries, body_acceleration, cw, omega_bulk, blend)
        self.params.low, self.params.high = (wp.vec3i(*end) for end in self._stepped())
        self.threads = slabs_for(self.device, shape[0], threads)
        with wp.ScopedDevice(self.device):
            self._f = [wp.zeros((Q, *shape), dtype=STORAGE[dtype]) for _ in range(2)]
            self._u = [wp.zeros(shape, dtype=velocity_type(subgrid == "wale")) for _ in range(2)]
            self._clock = [wp.zeros(1, dtype=int) for _ in range(2)]
            self.force = wp.zeros(shape, dtype=wp.vec3)
            self.box, self.origin = wp.zeros(6, dtype=int), wp.zeros(6, dtype=int)
        self.origin_lu, self.parity, self.steps, self._box = np.zeros(3, int), 0, 0, ([0] * 3, [0] * 3)
        self._launches: list[list[Any]] | None = None
        self._parts: dict[tuple[int, int, int], Any] = {}
        self._graphs: dict[int, wp.Graph] = {}
        self._surveyor, self.watch = Surveyor(shape, self.device), StabilityMonitor()
        self.set_flow(self.flow)
        self.settle()

    @property
    def extent(self) -> tuple[int, int, int]:
        """Number of cells (3,) from the low corner that hold water: all of `shape`."""
        return self.shape

    def _stepped(self) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """Logical nodes that are stepped, low inclusive, high exclusive."""
        return (0, 0, 0), self.shape

    @property
    def f(self) -> wp.array:
        """Present populations (19, nx, ny, nz), minus their weights."""
        return self._f[self.parity]

    @property
    def u(self) -> wp.array:
        """Present velocity (nx, ny, nz) as it is stored; derived from the populations if the step does not store it."""
        if not self._keeps:
            args = [self.params, _flat(self.f), _flat(self._u[self.parity])]
            wp.launch(fields.derive, dim=self.shape, inputs=args, device=self.device)
        return self._u[self.parity]

    @property
    def clock(self) -> wp.array:
        """Steps done, (1,) int32 on the device."""
        return self._clock[self.parity]

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.steps * self.lattice.dt

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    @property
    def levels(self) -> list["Fluid"]:
        """All levels of water, the finest first; here only this one."""
        return [self]

    @property
    def phase(self) -> int:
        """Index of the copies that the next step reads. A captured graph of steps is valid for one phase."""
        return self.parity

    @property
    def account(self) -> list[tuple[int, int]]:
        """Copy and number of steps of each level, as the host counts them."""
        return [(level.parity, level.steps) for level in self.levels]

    @account.setter
    def account(self, value: list[tuple[int, int]]) -> None:
        """Sets copy and number of steps of each level. Raises ValueError for another number of levels."""
        for level, (parity, steps) in zip(self.levels, value, strict=True):
            level.parity, level.steps = parity, steps

    def skip(self, steps: int) -> None:
        """Counts, on the host, steps that a graph has done."""
        self.parity, self.steps = (self.parity + steps) % 2, self.steps + steps

    def set_flow(self, flow: Flow) -> None:
        """Changes the background flow from now on; the water inside follows through the sponge.

        Raises ConfigError: not a `Flow`; OracleUnstable: the flow is faster than the Mach limit of this grid.
        """
        checked_kind("fluid: flow", flow, Flow, needed=True)
        check_speed(self.lattice, flow.speed, "fluid: background flow")
        self.flow = flow
        self._inflow = inflow_of(flow, self.lattice, self.device)
        self._launches, self._graphs, self._parts = None, {}, {}

    def set_steps(self, steps: int) -> None:
        """Sets the clock, in steps since the start; the water stays as it is. Raises ConfigError if `steps` is not whole."""
        self.steps = int(whole_numbers("fluid: steps", steps))
        self.clock.fill_(self.steps)

    def settle(self) -> None:
        """Sets the undisturbed background flow of the present time everywhere."""
        self._settle(self.origin_lu, self.shape)

    def _settle(self, low, size) -> None:
        inputs = [self.params, self._inflow, wp.vec3i(*map(int, low)), self.clock, _flat(self.f), _flat(self.u)]
        wp.launch(fields.settle, dim=tuple(map(int, size)), inputs=inputs, device=self.device)

    def impose(self, u: np.ndarray, pressure: np.ndarray | None = None) -> None:
        """Sets velocity (nx, ny, nz, 3) m/s and pressure (nx, ny, nz) Pa, with the viscous stress that belongs to them.

        Raises:
            ConfigError: another shape, or not finite. OracleUnstable: a speed beyond the Mach limit, a density beyond the
                watch's.
        """
        u = numbers("fluid: velocity", u, (*self.shape, 3))
        check_speed(self.lattice, float(np.sqrt((u * u).sum(-1).max())), "fluid: velocity")
        if pressure is not None:
            pressure = numbers("fluid: pressure", pressure, self.shape)
            check_density(1 + pressure * 3 / self.lattice.pressure, "fluid: pressure")
        u_lu = np.asarray(u, np.float32) / self.lattice.velocity
        drho = np.zeros(self.shape, np.float32) if pressure is None else pressure * 3 / self.lattice.pressure
        rolled = np.roll(u_lu, self.origin_lu, (0, 1, 2))
        self._keep(rolled)
        u_exact = wp.array(rolled, dtype=wp.vec3, device=self.device)
        rho = wp.array(np.roll(drho, self.origin_lu, (0, 1, 2)).astype(np.float32), dtype=float, device=self.device)
        wp.launch(fields.impose, dim=self.shape, inputs=[self.params, rho, u_exact, _flat(self.f)], device=self.device)

    def _keep(self, u: np.ndarray) -> None:
        """Stores velocities (nx, ny, nz, 3), in memory order and cells a step, as those of the last step."""
        now = self.u
        now.assign(encoded(u, now.dtype))

    def step(self, box: Box | None = None) -> None:
        """Does one time step; `box` holds the nodes where `force` acts (None: nowhere)."""
        self.set_box(NOWHERE if box is None else box)
        self.stream_collide()
        self.watch.after_step(self)

    def set_box(self, box: Box) -> None:
        """Sets the box of world nodes where `force` acts. Raises ConfigError if `box` has no low and high corner."""
        low, high = whole_numbers("fluid: box", box, (2, 3)).tolist()
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ConfigError(f"fluid: box = {shown_value(box)}; expected its low corner first, then the high one")
        if (low, high) != self._box:
            self.box.assign(np.array([*low, *high], np.int32))
            self._box = low, high

    def stream_collide(self) -> None:
        """Does one time step with the force in `self.box`, without a host transfer, so that a graph can capture it."""
        if self._launches is None:
            self._launches = [self._recorded(parity) for parity in range(2)]
        launch_slabs(self._launches[self.parity])
        self.parity, self.steps = 1 - self.parity, self.steps + 1

    def planes(self, first: int, count: int) -> Any:
        """Launch of a part of a time step: `count` planes of x from `first` on, in memory order. `skip(1)` counts the step.

        The parts of a step may run in any order: each reads only the result of the previous step.
        """
        whole_numbers("fluid: planes", (first, count), (2,))
        key = self.parity, first, count
        if key not in self._parts:
            if not 0 <= first < first + count <= self.shape[0]:
                raise ConfigError(f"fluid: planes {first} to {first + count} of {self.shape[0]}; expected some within the box")
            args = [first * self._plane, *self._arguments(self.parity)]
            self._parts[key] = wp.launch(self._kernel, dim=count * self._plane, inputs=args, device=self.device, record_cmd=True)
        return self._parts[key]

    def _recorded(self, parity: int) -> list[Any]:
        """Launches of a step that starts from `parity`."""
        turn = self.shape[0] * self._plane - 1 if parity else -1  # back and forth: what was written last is read first
        return record_slabs(self._kernel, self.shape[0], self._plane, self._arguments(parity, turn), self.device, self.threads)

    def _arguments(self, parity: int, turn: int = -1) -> list[Any]:
        """Arguments of the kernel, after its first thread, for a step that starts from `parity`; `turn`: pairs.py."""
        a, b = parity, 1 - parity
        args = [
            *([turn] if self._paired else []),
            self.params,
            self._inflow,
            self.origin,
            self.box,
            self._clock[a],
            _flat(self._f[a]),
            _flat(self._u[a]),
        ]
        return args + [_flat(self.force), _flat(self._f[b]), _flat(self._u[b]), self._clock[b]]

    def run(self, steps: int, before: Callable[[], None] | None = None) -> None:
        """Does `steps` steps without a body; on cuda in a captured graph.

        `before` is called before every step and forbids a graph.
        """
        whole_numbers("fluid: steps", steps, low=0)
        self.set_box(NOWHERE)
        if before is None and self.device.is_cuda and steps >= 4:
            if self.parity:
                self.stream_collide()
                steps -= 1
            for stride in STRIDES:
                for _ in range(steps // stride):
                    wp.capture_launch(self._captured(stride))
                    self.steps += stride
                    self.watch.after_step(self, stride)
                steps %= stride
        for _ in range(steps):
            if before is not None:
                before()
            self.stream_collide()
            self.watch.after_step(self)

    def _captured(self, stride: int) -> wp.Graph:
        """Captures a graph of an even number of steps from even parity, without running them."""
        if stride not in self._graphs:
            self._kernel.module.load(self.device)
            steps = self.steps
            with wp.ScopedCapture(self.device) as capture:
                for _ in range(stride):
                    self.stream_collide()
            self._graphs[stride], self.steps = capture.graph, steps
        return self._graphs[stride]

    def shift(self, by: tuple[int, int, int]) -> None:
        """Moves the window by whole cells; the planes that it uncovers get the undisturbed background flow."""
        whole_numbers("fluid: shift", by, (3,))
        if any(abs(b) >= n for b, n in zip(by, self.shape, strict=True)):
            raise ConfigError(f"fluid: shift by {by} cells in a window of {self.shape}; a shift is smaller than the window")
        self._place(self.origin_lu + by)
        for axis in np.flatnonzero(by):
            low, size = self.origin_lu.copy(), np.array(self.shape)
            size[axis] = abs(by[axis])
            if by[axis] > 0:
                low[axis] += self.shape[axis] - by[axis]
            self._settle(low, size)

    def _place(self, origin: np.ndarray) -> None:
        self.origin_lu = origin
        self.origin.assign(np.concatenate([origin, origin % self.shape]).astype(np.int32))

    def velocity_lu(self) -> wp.array:
        """Velocity (nx, ny, nz) vec3 of the last step in memory order, cells a step."""
        u = self.u  # once: without `keep_velocity` a kernel makes it
        if u.dtype is wp.vec3:
            return u
        out = wp.empty(self.shape, dtype=wp.vec3, device=self.device)
        wp.launch(fields.resolve, dim=self.shape, inputs=[self.params, _flat(self.f), _flat(u), out], device=self.device)
        return out

    def velocity(self) -> np.ndarray:
        """Velocity (nx, ny, nz, 3) m/s, low corner first; nx, ny, nz: `extent`."""
        return self._in_order(self.velocity_lu().numpy()) * self.lattice.velocity

    def pressure(self) -> np.ndarray:
        """Pressure (nx, ny, nz) Pa above that of still water, low corner first; nx, ny, nz: `extent`."""
        return self._in_order(self.drho().numpy()) * self.lattice.pressure / 3

    def _in_order(self, values: np.ndarray, first: int = 0) -> np.ndarray:
        """Reorders a field from memory order to logical nodes and cuts it to `extent`; x, y, z are its axes from `first` on."""
        held = *(slice(None) for _ in range(first)), *(slice(n) for n in self.extent)
        return np.roll(values, -self.origin_lu, (first, first + 1, first + 2))[held]

    def drho(self) -> wp.array:
        """Density minus one, (nx, ny, nz), in memory order."""
        out = wp.empty(self.shape, dtype=float, device=self.device)
        wp.launch(fields.weigh, dim=self.shape, inputs=[self.params, _flat(self.f), out], device=self.device)
        return out

    def survey(self) -> Survey:
        """Extremes of density and speed, mass, and number of nodes that are not finite."""
        self.begin_survey()
        wp.synchronize_device(self.device)
        return self.surveyed()

    def begin_survey(self) -> None:
        """Queues a survey on the present stream and returns at once."""
        self._surveyor.start(self.params, self.origin, _flat(self.f), _flat(self.u))

    def surveyed(self) -> Survey:
        """Survey that was begun last; the device must have finished it."""
        return self._surveyor.result()

    def finer(self, factor: int) -> "Fluid":
        """Undisturbed water in a box of the same cells, faces and options, with steps `factor` times finer, a whole number.

        A sponge acts once a step: sound, which is `factor` times as fast, loses as much on its way through; a wake loses more.
        """
        factor = int(whole_numbers("fluid: factor of finer steps", factor, low=1))
        old = self.lattice
        lattice = replace(old, dt=old.dt / factor)
        x, y, z = self.boundaries.wall_velocity_lu  # in lattice units a wall of the same m/s is slower
        faces = replace(self.boundaries, wall_velocity_lu=(x / factor, y / factor, z / factor))
        more: dict[str, Any] = {"boundaries": faces, "subgrid": self.subgrid, "flow": self.flow, "threads": self.threads}
        more["blend"] = self._options["blend"] / factor  # the same loss in a second
        return Fluid(lattice, self.shape, self.device, keep_velocity=self._keeps, **(self._options | more))

    def snapshot(self) -> dict[str, np.ndarray]:
        """Complete state of the water as arrays: `f`, `u`, `origin`, `steps`."""
        f, u = self.f.numpy().copy(), decoded(self.u.numpy()).copy()
        return {"f": f, "u": u, "origin": self.origin_lu.copy(), "steps": np.array(self.steps)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continues from a snapshot, bit for bit. Raises ConfigError for other data, or another shape or storage."""
        check_snapshot(state, (Q, *self.shape), wp.dtype_to_numpy(self.f.dtype))
        self.f.assign(state["f"])
        self._keep(state["u"])
        self._place(np.array(state["origin"], int))
        self.set_steps(int(state["steps"]))


def _params(lattice, shape, boundaries, body_acceleration, cw, omega_bulk, blend) -> Params:
    made = Params()
    made.nx, made.ny, made.nz = shape
    made.planes = vec19i(*(i * int(np.prod(shape)) for i in range(Q)))
    made.by_ny, made.by_nz = wp.vec2i(*split_by(shape[1])), wp.vec2i(*split_by(shape[2]))
    made.nu, made.omega_bulk, made.cw2 = lattice.nu_lu, omega_bulk, cw * cw
    made.hybrid_share, made.hybrid_share_layer = blend, LAYER * blend
    made.body_acceleration = wp.vec3(*(np.asarray(body_acceleration, float) / lattice.acceleration))
    made.wall_velocity = wp.vec3(*boundaries.wall_velocity_lu)
    made.sponge, made.sponge_rate = max(boundaries.sponge, 1), boundaries.sponge_rate
    return made


def _flat(f: wp.array) -> wp.array:
    """One-dimensional view of an array: kernels compute their own offsets."""
    return f.flatten()
