"""The immersed boundary of one body on one device: its arrays, and the order in which the kernels of a step run.

    assemble_response   pose -> u* -> F0, F_j -> K, b0              response of the water to any velocity of the body
    solve               (M + dt D + K) v = right - b0               on the device, so that the fluid never waits for the host
                        F = F0 + sum v_j F_j -> link wrenches       v and wrenches are written into the host's memory
    spread_force        F -> G                                      the force field of this step

All three queue launches without waiting for the host; a GPU captures each as a graph. `assemble_response` needs only the pose of
the body, and the host assembles its equation meanwhile. The host may overwrite the block that it sends once the velocity has come
back.
"""

from contextlib import nullcontext
from math import isfinite
from typing import Any

import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.fluid.domain_faces import FACES
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.guard import check_spacing, numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed import fsi_solve, kernels, wall_law
from fishmj.lbm_oracle.immersed.kernels import check_width
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.lbm_oracle.immersed.markers import LAYER_WIDTH, Markers

MARKERS_A_CHUNK, CHUNKS = 24, (16, 256)  # of a partial sum over the markers; how many of these at least and at most on a GPU
ROOM = 1.1  # rounding to whole numbers of markers: a median distance so far over a limit is still allowed
MARGIN = 4  # cells of the scratch box round the markers: half a kernel, rounding, the bend of the skin


def slip_on_grid(slip: float, lattice: Lattice, dx: float = 0.02, dt: float = 0.004) -> float:
    """Slip ratio on this grid for a ratio quoted at the paper's: s = exp(-c dt / dx), c = -ln(slip) dx0 / dt0.

    c [m/s] is the wall stress over rho and the slip velocity, so that neither the time step nor the cell changes the friction.
    slip = 1 is a frictionless wall and 0 no slip on every grid.
    """
    if not 0 <= numbers("slip", slip) <= 1:
        raise ConfigError(f"slip = {slip}; expected 0 (no slip) to 1 (free slip)")
    return float(slip ** ((lattice.dt / lattice.dx) * (dx / dt))) if slip > 0 else 0.0


def slips_of(markers: Markers, slip: float, nu: float, passes: int) -> np.ndarray:
    """Slip ratio (N,) of each marker on this grid: the wall's own; for a no-slip wall, that of the markers' slip lengths.

        F = A (1 - s) (U - u*) = n nu (U - u*) / b,   A = 2 (1 - 2^-passes)          n: sides with water, 2 for a sheet

    b is the slip length in cells, nu the viscosity in lattice units. A is the effect of the passes on a wanted velocity change,
    because a sheet of markers a cell apart feels half of its own force. b = 0 is no slip.
    """
    if slip > 0 or markers.slip_length is None:
        return np.full(len(markers), slip)
    resistance = 2 * (1 - 0.5**passes) * markers.slip_length / (np.where(markers.sheet, 2, 1) * nu)
    return resistance / (1 + resistance)


class Boundary:
    """Markers of one body in one fluid.

    Args:
        markers: positions in the frames of the body's links.
        body: degrees of freedom and motion axes.
        width: points of the kernel, 3 or 4.
        passes: passes of the direct forcing.
        slip: slip ratio quoted at the paper's grid; 1 for markers with a `law_height`, whose ratios follow from a law.

    If links can part without bounds, as two free bodies can, the scratch box spans all of the water on those axes
    (`spanned_axes`).

    Raises:
        ConfigError: a marker of a link that the body does not have, or on a bend without a hinge; invalid numbers; a `width` for
            which the markers' layers were not measured.
        OracleUnstable: the markers' spacing does not fit this grid's cells; usually they were made for another grid.
    """

    def __init__(self, markers: Markers, body, fluid: Fluid, *, width: int = 3, passes: int = 2, slip: float = 1.0):
        lattice, device = fluid.lattice, fluid.device
        self.markers, self.lattice, self.shape, self.device = markers, lattice, fluid.shape, device
        self.passes = int(whole_numbers("immersed boundary: passes", passes, low=1))
        self.width, self.slip = check_width(width), slip_on_grid(slip, lattice)
        self.body_acceleration = fluid.params.body_acceleration
        wraps = [FACES[axis.low].wraps for axis in fluid.boundaries.axes]
        self.wraps, self._walled_axes = wp.vec3i(*map(int, wraps)), [a for a in range(3) if not wraps[a]]
        n, self.dofs, self.links = len(markers), body.dofs, body.links
        if n == 0:
            raise ConfigError("immersed boundary: no markers")
        _check_links(markers, body)
        if markers.law_height is not None and slip < 1:
            raise ConfigError(
                f"immersed boundary: slip = {slip} with a law for the wall's stress, which sets it; leave slip at 1"
            )
        if width != LAYER_WIDTH and markers.layer is not None and markers.layer.any():
            raise ConfigError(
                f"immersed boundary: a kernel of {width} points for markers with a layer of water (boundary fins), which was"
                f" measured for {LAYER_WIDTH} points; take width = {LAYER_WIDTH} (--kernel {LAYER_WIDTH}), or boundary rims"
            )
        apart = float(np.sqrt(np.median(markers.area)))
        check_spacing(lattice, apart / ROOM if apart > lattice.dx else apart * ROOM, "immersed boundary")
        self.count, self.rhs = n, self.dofs + 1
        self.layout = _layout(self.links, self.dofs)
        self.corners = Corners.of(markers, body.water.centre)
        size = body.largest_extent(self.corners)
        self.spanned_axes = [a for a in range(3) if not isfinite(size[a])]
        cells = (n if a in self.spanned_axes else int(np.ceil(size[a] / lattice.dx)) for a, n in enumerate(fluid.shape))
        self.law = wall_law.law_of(markers, lattice.dx, lattice.nu_lu, device)
        self.has_law = self.law.height > 0
        self._margin = MARGIN + self.law.points  # the law's force reaches further than a kernel
        self.box_shape = tuple(n + 2 * self._margin for n in cells)
        if self.spanned_axes:
            device_of(str(device), int(np.prod(self.box_shape)) * (12 * self.rhs + 16))
        # cells before the first cell of water, on axes where the scratch box wraps round
        self._fold_margin = [self._margin if a in self.spanned_axes and wraps[a] else 0 for a in range(3)]
        self.corners.set_grid(lattice.dx, lattice.corner, self.box_shape)
        make = lambda values, dtype: wp.array(values, dtype=dtype, device=device)
        self.rest = make(markers.rest, wp.vec3d)
        self.rest_normal = make(markers.normal, wp.vec3d)
        self.pivot = make(markers.pivot, wp.vec3d)
        self.before, self.after = make(markers.before.astype(np.int32), wp.int32), make(markers.after.astype(np.int32), wp.int32)
        self.share = make(markers.share.astype(float), wp.float64)
        self.volume = make((markers.area / lattice.dx**2).astype(np.float32), wp.float32)
        self.slips = make(slips_of(markers, self.slip, lattice.nu_lu, self.passes).astype(np.float32), wp.float32)
        self.reach = max(width / 2, self.law.height + 1 if self.has_law else 0.0)  # cells round a marker that it reads
        self._probed = wp.zeros((n if self.has_law else 0, 2 * wall_law.NODES), dtype=wp.vec3, device=device)
        self.moves, self.slides = make(body.reach, wp.float64), make(body.slides, wp.int32)
        empty = lambda shape, dtype: wp.zeros(shape, dtype=dtype, device=device)
        self.host = empty(self.layout.size, wp.float64)
        self.staging = wp.zeros(self.layout.size, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        self.inbox = wp.zeros(self.dofs + 7 * self.links, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        self.world, self.cell, self.normal = empty(n, wp.vec3d), empty(n, wp.vec3), empty(n, wp.vec3)
        self.store, self.jacobian = empty(n, wp.vec3i), empty((n, self.dofs), wp.vec3)
        self.box_u, self.box_rho = empty(self.box_shape, wp.vec3), empty(self.box_shape, wp.float32)
        self.wanted, self.force = empty((n, self.rhs), wp.vec3), empty((n, self.rhs), wp.vec3)
        self.scratch = empty((*self.box_shape, self.rhs), wp.vec3)  # all v_j and the rest state at once: one set of launches
        self.final, self._across = empty(n, wp.vec3), empty(n if self.has_law else 0, wp.vec3)
        self._recorded: dict[tuple, Any] = {}  # launches on a CPU, by kernel and arguments
        chunks = min(n, max(CHUNKS[0], min(n // MARKERS_A_CHUNK, CHUNKS[1]))) if device.is_cuda else 1
        self.part = empty((chunks, self.dofs, self.rhs), wp.float64)
        self.water = empty((self.dofs, self.rhs), wp.float64)  # b0 and K, SI
        self._solve_threads = fsi_solve.BLOCK if device.is_cuda else 1  # threads
        self._sum_threads = fsi_solve.WARP if device.is_cuda else 1  # threads that add up the chunks of an entry
        self.elimination = empty(self.dofs * self.rhs, wp.float64), empty(self.dofs, wp.int32), empty(self.dofs, wp.int32)
        self.target, self._wrench = empty(self.dofs, wp.float64), empty((self.links, 6), wp.float64)
        sent, returned = (_device_view(array, device) for array in (self.staging, self.inbox))
        first = self.layout.system  # place and velocity of the body go ahead of its equation
        self._transfers = [(sent[:first], self.host[:first]), (sent[first:], self.host[first:])]
        velocity, impulse = self.dofs, self.dofs + 6 * self.links
        self._velocity, self._interior_speed = returned[:velocity], returned[impulse:]
        self._returned_wrench = returned[velocity:impulse].reshape((self.links, 6))
        self.wrench_part = empty((chunks, self.links, 6), wp.float64)
        self._had_prescribed = False  # velocities were prescribed in the last step
        self._wrench_read = False  # the host has read `_wrench`; the next step starts from zero
        self._host_wrench_valid = True  # `inbox` holds the same as `_wrench`
        on_host = self.inbox.numpy()
        self.velocity, self.interior_speed = on_host[:velocity], on_host[impulse:]  # views: v+ (n,), s (L,) m/s
        self._impulse = on_host[velocity:impulse].reshape(self.links, 6)
        self.interior, self._branch = body.water.points, wp.Stream(device) if device.is_cuda else None
        if self.interior is not None:
            order = np.argsort(self.interior.link, kind="stable")  # link after link: whoever sums over one reads its own only
            place, link, share = (values[order] for values in self.interior)
            self._points, self._shares = (make(place, wp.vec3d), make(link.astype(np.int32), wp.int32)), make(share, wp.float32)
            self._first_points = make(np.searchsorted(link, np.arange(self.links + 1)).astype(np.int32), wp.int32)
            self._node_speeds = empty((len(link), 8), wp.float32)  # of the nodes round each
        self.view = _views(self.staging.numpy(), self.links, self.dofs)  # what is sent, by name
        self.view["pose"] = self.staging.numpy()[: body.pose.size]  # frame, angle, axis, anchor
        self.view["origin"][:] = lattice.corner

    def place_markers(self, body, origin: np.ndarray) -> None:
        """Writes pose and velocity of the body into the staging block; `origin` (3,) is the fluid's low corner, a world node.

        Raises ConfigError: a marker is nearer to a face than `reach`: it would read and push water of the other side.
        """
        self.view["pose"][:], self.view["box"][:] = body.pose, body.first_cell(self.corners)
        self.view["before"][:] = body.data.qvel
        found, first, dx = body.corner_box(self.corners).tolist(), origin.tolist(), self.lattice.dx
        if not np.isfinite(body.pose).all():
            raise ConfigError("immersed boundary: the body's place is not finite; see body.data.qpos")
        for a in range(3):
            if a in self.spanned_axes:
                self.view["box"][a] = first[a] - self._margin
            elif found[3 + a] - found[a] > (self.box_shape[a] - 2 * self._margin + 1) * dx:  # the kernels would write beyond it
                raise ConfigError(
                    f"immersed boundary: the body spans {found[3 + a] - found[a]:.3g} m along {'xyz'[a]}, further than its links"
                    " reached when it was put into the water; put a changed model into the water anew"
                )
        for a in self._walled_axes:  # plain numbers: a handful is faster so than in NumPy
            corner = self.lattice.corner[a] + first[a] * dx
            room = min((found[a] - corner) / dx, self.shape[a] - 1 - (found[3 + a] - corner) / dx)
            if room < self.reach:
                raise ConfigError(
                    f"immersed boundary: a marker is {room:.2f} cells from the outermost nodes of axis {'xyz'[a]}, and"
                    f" {'the law of its wall' if self.has_law else 'its kernel'} reaches {self.reach:g}, across to the other"
                    " side; keep the body further in, or enlarge the box"
                )

    def set_equation(self, system, right, fixed=None, value=None) -> None:
        """Writes the body's equation into the staging block; `fixed` (n,) marks velocities that are prescribed by `value`."""
        view = self.view
        view["system"][:], view["momentum"][:] = system, right
        if fixed is not None or self._had_prescribed:
            view["fixed"][:] = 0.0 if fixed is None else fixed
            view["value"][:] = 0.0 if value is None else value
            self._had_prescribed = fixed is not None
        view["reset_wrench"][:] = self._wrench_read
        self._wrench_read = False
        self._host_wrench_valid = True

    def fetch_pose(self) -> None:
        """Queues the transfer of the pose that `place_markers` wrote."""
        self._fetch(*self._transfers[0])

    def fetch_equation(self) -> None:
        """Queues the transfer of the equation that `set_equation` wrote."""
        self._fetch(*self._transfers[1])

    def assemble_response(self, f: wp.array, corner: wp.array, force_box: wp.array, speed: wp.array | None = None) -> None:
        """Queues all kernels up to K and b0, and the speed of the interior water, for the pose in `host`.

        Args:
            f: populations that this step will pull, flat. corner: (3,) world node of the fluid's low corner.
            force_box: (6,) world nodes between which the fluid reads a force; written here.
            speed: (L,) m/s, output for the interior water's speed; the host's memory by default.
        """
        lat, w, shape, n = self.lattice, self.width, wp.vec3i(*self.shape), self.count
        with nullcontext() if self._branch is None else wp.ScopedStream(self._branch):  # a branch of its own
            self._measure_interior(f, shape, self._interior_speed if speed is None else speed)
        pose_in = [self.host, self.layout, self.rest, self.rest_normal, self.pivot, self.before, self.after, self.share]
        pose_in += [self.moves, self.slides, lat.dx, lat.dt, w, shape]
        pose_in += [wp.vec3i(*self.box_shape), self.wraps, wp.vec3i(*self._fold_margin), corner]
        self._launch(kernels.pose, n, pose_in, [force_box, self.world, self.cell, self.normal, self.store, self.jacobian])
        read_in = [f, self.body_acceleration, self.cell, self.store, w, shape]
        self._launch(kernels.read_cells, (n, w**3), read_in, [self.box_u, self.box_rho])
        if self.has_law:
            law_in = [self.host, self.layout, self.law]
            probe_in = [*law_in, f, self.body_acceleration, self.world, self.normal, wp.float64(lat.dx), shape]
            self._launch(wall_law.probe_water, self._probed.shape, probe_in, [self._probed])
            slip_in = [*law_in, self.cell, self.normal, self.jacobian, w, self.box_u, self._probed]
            self._launch(wall_law.set_slips, n, slip_in, [self.slips])
        target_in = [self.cell, self.normal, self.jacobian, self.slips, w, self.box_u]
        self._launch(kernels.set_target, (n, self.rhs), target_in, [self.wanted, self.force])
        for _ in range(self.passes - 1):
            self.scratch.zero_()
            self._launch(kernels.spread, (n, self.rhs, w), [self.cell, self.volume, self.force, w, self.box_rho], [self.scratch])
            for a in self.spanned_axes:
                self._fold(a)
            correct_in = [self.cell, self.normal, int(self.has_law), self.wanted, w, self.scratch]
            self._launch(kernels.correct, (n, self.rhs), correct_in, [self.force])
        # float32 forces, float64 sums: K couples the masses of trunk and tail in one solve
        scale = lat.mass * lat.velocity**2 * lat.dt / lat.dx  # J is in cells a step: back to SI on both sides
        self._launch(fsi_solve.response_part, self.part.shape, [self.jacobian, self.volume, self.force], [self.part])
        total_in = [self.part, scale * lat.velocity, self._sum_threads]
        self._launch(fsi_solve.response_total, (*self.water.shape, self._sum_threads), total_in, [self.water])
        if self._branch is not None:
            wp.get_stream(self.device).wait_stream(self._branch)

    def _fold(self, axis: int) -> None:
        """Queues the sum over cells of the scratch box that are one cell of water, a period apart; each gets the sum."""
        if self._fold_margin[axis]:
            dim = list(self.scratch.shape)
            dim[axis] = min(self.shape[axis], 2 * self._margin)
            self._launch(kernels.fold, tuple(dim), [axis, self.shape[axis]], [self.scratch])

    def _measure_interior(self, f: wp.array, shape: wp.vec3i, speed: wp.array) -> None:
        """Queues the measurement of the interior water's speed along the links."""
        if self.interior is None:
            return
        args = [self.host, self.layout, *self._points, f, self.body_acceleration]
        args += [wp.float64(self.lattice.dx), shape]
        self._launch(kernels.measure_interior, self._node_speeds.shape, args, [self._node_speeds])
        args = [self._node_speeds, self._first_points, self._shares, self.lattice.velocity]
        self._launch(kernels.mean_interior_speed, self.links, args, [speed])

    def solve(self, implicit: bool = True) -> None:
        """Queues the solve of the equation in `host`, which writes into the host's memory, and the markers' final forces."""
        args = [self.host, self.layout, self.water, int(implicit)]
        self._launch(fsi_solve.solve, self._solve_threads, args, [*self.elimination, self._velocity, self.target])
        self._launch(kernels.combine, self.count, [self.force, self.target], [self.final])

    def sum_wrench(self) -> None:
        """Queues the wrench on every link, on the device and into the host's memory; call it after `solve`."""
        lat = self.lattice
        args = [self.world, self.before, self.after, self.share, self.volume, self.final, self.host, self.layout]
        self._launch(fsi_solve.wrench, self.wrench_part.shape[:2], args, [self.wrench_part])
        args = [self.wrench_part, lat.mass * lat.velocity, self._sum_threads, self.host, self.layout]
        self._launch(fsi_solve.add_wrench, (self.links, 6, self._sum_threads), args, [self._wrench, self._returned_wrench])

    def spread_force(self, f: wp.array, acceleration: wp.array) -> None:
        """Queues the spreading of the final force into the fluid's `acceleration`; `f` as in `assemble_response`."""
        force, shape = self.final, wp.vec3i(*self.shape)
        if self.has_law:
            force = self._across
            self._launch(wall_law.take_across, self.count, [self.normal, self.final], [force])
            args = [self.host, self.layout, self.law, f, self.world, self.normal, self.volume, self.final, force]
            nodes = self.law.last.shape[1] * wall_law.NODES
            self._launch(wall_law.push_layers, (self.count, nodes), [*args, wp.float64(self.lattice.dx), shape], [acceleration])
        args = [self.cell, self.store, self.volume, force, self.width, shape, self.box_rho]
        self._launch(kernels.spread_force, (self.count, self.width), args, [acceleration])

    def clear_force(self, acceleration: wp.array) -> None:
        """Queues G = 0 in the cells of the last spread force."""
        args = [self.store, self.width, wp.vec3i(*self.shape)]
        self._launch(kernels.clear_force, (self.count, self.width**3), args, [acceleration])
        if self.has_law:
            nodes = self.law.last.shape[1] * wall_law.NODES
            self._launch(wall_law.clear_layers, (self.count, nodes), [self.law, args[2]], [acceleration])

    def take_wrench(self) -> np.ndarray:
        """Impulse of the water on every link since the last call, (L, 6): N s in the world frame, N m s about its origin.

        It came with the velocity of the last step, so this does not wait for the water.
        """
        if self._wrench_read:
            return np.zeros((self.links, 6))
        self._wrench_read = True
        if self._host_wrench_valid:
            return self._impulse.copy()
        wp.synchronize_device(self.device)
        return self._wrench.numpy().copy()

    def set_wrench(self, impulse: np.ndarray) -> None:
        """Sets the impulse since the last `take_wrench`, (L, 6), from the sum of steps without the host."""
        self._impulse[:] = impulse
        self._wrench_read, self._host_wrench_valid = False, True

    @property
    def wrench(self) -> wp.array:
        """Impulse since the last `take_wrench` on the device, (L, 6); may be saved or set between two steps."""
        if self._wrench_read:
            self._wrench.zero_()
        self._wrench_read = self._host_wrench_valid = False
        return self._wrench

    @property
    def wrench_sum(self) -> wp.array:
        """Device array to which the steps add that impulse; for launches."""
        return self._wrench

    def measure_interior(self, f: wp.array, speed: wp.array) -> None:
        """Queues the measurement of the interior water's speed along the links into `speed`, (L,) m/s, for the pose in `host`."""
        self._measure_interior(f, wp.vec3i(*self.shape), speed)

    def fastest_marker(self, velocity: np.ndarray) -> float:
        """Greatest speed of a marker, m/s, at the body's velocity (n,) and the markers' positions of the last step."""
        speed = np.einsum("kdc,d->kc", self.jacobian.numpy(), velocity)
        return float(np.sqrt((speed * speed).sum(1).max())) * self.lattice.velocity

    @property
    def response(self) -> tuple[np.ndarray, np.ndarray]:
        """K (n, n) and b0 (n,) of the last step, SI momentum units."""
        water = self.water.numpy()
        return water[:, 1:].copy(), water[:, 0].copy()

    def _fetch(self, sent: wp.array, host: wp.array) -> None:
        self._launch(fsi_solve.fetch, len(sent), [sent], [host])

    def _launch(self, kernel, dim, inputs, outputs) -> None:
        if self.device.is_cuda:  # graphs hold it
            wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)
            return
        key = (kernel, dim, *map(_identity, inputs), *map(_identity, outputs))
        if key not in self._recorded:  # Warp looks at every argument of a launch anew, which takes longer than a small kernel
            args: dict[str, Any] = {"inputs": inputs, "outputs": outputs, "device": self.device, "record_cmd": True}
            self._recorded[key] = wp.launch(kernel, dim=dim, **args)
        self._recorded[key].launch()


def _check_links(markers: Markers, body) -> None:
    """Raises ConfigError for a marker of a missing link, or on a bend between two links that no hinge about z joins."""
    for name in ("before", "after"):
        whole_numbers(
            f"immersed boundary: markers' link {name!r}", getattr(markers, name), (len(markers),), low=0, high=body.links - 1
        )
    bends = markers.share > 0
    for before, after in sorted({*zip(markers.before[bends].tolist(), markers.after[bends].tolist(), strict=True)}):
        if not body.bends(before, after):
            at = int(np.argmax(bends & (markers.before == before) & (markers.after == after)))
            raise ConfigError(
                f"immersed boundary: marker {at} bends by {markers.share[at]:g} from link {before} to link {after}; expected one"
                " that hangs on the other by one hinge about z, or share 0"
            )


def _identity(value: Any) -> Any:
    """Key of a launch argument: place and shape of an array, else the value; a struct equals only itself."""
    if isinstance(value, wp.array):
        return value.ptr, value.shape
    if isinstance(value, wp.float64):
        return value.value
    if isinstance(value, int | float):
        return value
    return tuple(value) if hasattr(value, "__len__") else id(value)


def _device_view(array: wp.array, device) -> wp.array:
    """Pinned host array as the device sees it: at the same address, so that no copy stands between two kernels."""
    return wp.array(ptr=array.ptr, dtype=array.dtype, shape=array.shape, device=device)


def _shapes(links: int, dofs: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the fields of the host block, in their order."""
    shapes: dict[str, tuple[int, ...]] = {"frame": (links, 12), "angle": (links,), "axis": (dofs, 3), "anchor": (dofs, 3)}
    shapes |= {"origin": (3,), "box": (3,), "before": (dofs,), "system": (dofs, dofs)}
    return shapes | {name: (dofs,) for name in ("momentum", "fixed", "value")} | {"reset_wrench": (1,)}


def _layout(links: int, dofs: int) -> kernels.CouplingArrays:
    at, place = kernels.CouplingArrays(), 0
    at.links, at.dofs = links, dofs
    for name, shape in _shapes(links, dofs).items():
        setattr(at, name, place)
        place += int(np.prod(shape))
    at.size = place
    return at


def _views(block: np.ndarray, links: int, dofs: int) -> dict[str, np.ndarray]:
    views, place = {}, 0
    for name, shape in _shapes(links, dofs).items():
        size = int(np.prod(shape))
        views[name] = block[place : place + size].reshape(shape)
        place += size
    return views
