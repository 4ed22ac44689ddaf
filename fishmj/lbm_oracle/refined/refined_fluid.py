"""Water on two levels: a box of finer cells in a coarser `Fluid`, stepped together.

    step 2 n      explode into the ghosts of both steps, fine step, coalesce into the coarse populations
    step 2 n + 1  fine step, coarse step, restrict, the finest box first                       (exchange.py)

A `RefinedFluid` is the fine level, with the interface of a `Fluid`: a body is coupled to it and steps with it. `outer` is the
coarse level, which may be a window, and may itself be refined. Between two coarse steps (`whole`) the box may move by whole
coarse cells. The coarse cells already hold the water that it leaves, and newly covered fine cells are computed from them.

A strip of water, one cell deep along z and periodic, has boxes one cell deep: their children share that cell in pairs.

Only the rim of a box is restricted, one coarse cell wide: the coarse cells outside, and `explode`, read no deeper. The coarse
cells behind the rim hold the flow without the body, until the box moves or a caller asks for them (`restrict`, `complete`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_kind
from fishmj.lbm_oracle.fluid.domain_faces import FACES, PERIODIC, Boundaries
from fishmj.lbm_oracle.fluid.fields import Survey
from fishmj.lbm_oracle.fluid.fluid import NOWHERE, Fluid
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import RATIO, VELOCITIES, Lattice
from fishmj.lbm_oracle.fluid.pairs import split_by
from fishmj.lbm_oracle.refined import exchange
from fishmj.lbm_oracle.refined.crossings import Cells, lists_of
from fishmj.lbm_oracle.refined.exchange import BLOCK, GHOST, Nest
from fishmj.water.flow import Flow

ROOM = 2  # coarse cells between R and a face of the coarse water
AXES = {"f": (1, 2, 3), "u": (0, 1, 2)}  # x, y, z in the fields of a snapshot
SECTOR = 8  # numbers that an accelerator's memory reads and writes at once


def fine_lattice(coarse: Lattice, numbers: int = 0, strip: bool = False) -> Lattice:
    """Lattice of half the cell and half the step.

    Fine nodes 2 N and 2 N + 1 share the coarse cell N, along z with `numbers` more. In a strip both levels have the same z.
    """
    dx = coarse.dx / RATIO
    x, y, z = (c - dx / 2 for c in coarse.corner)
    z = coarse.corner[2] if strip else z - numbers * dx
    return replace(coarse, dx=dx, dt=coarse.dt / RATIO, corner=(x, y, z))


class RefinedFluid(Fluid):
    """The finer box in `outer`, with steps of half its dt.

    Args:
        outer: coarse water, at rest or developed; the box starts from its state.
        low: (3,) world node of `outer` at the box's low corner.
        size: (3,) coarse cells of the box.
        linear: False explodes uniformly (Rohde et al. 2006), kept to show the cost of that.
        numbers: along z the world node N of `outer` holds nodes 2 N + `numbers` and 2 N + `numbers` + 1 of this level. By default
            the box begins at a multiple of 8: no two of its rows then share a sector of the memory.

    Attributes:
        size_lu: (3,) `size`.
        embedded: indices of the axes that the box does not fill.
        extent: (3,) cells of the box, plus a ghost cell on each side except along an axis that it fills.
        shape: shape of the arrays; along z `extent` or more, up to a multiple of 8.

    Raises:
        ConfigError: the box does not fit into `outer` with two cells to spare, or half precision.
    """

    def __init__(
        self,
        outer: Fluid,
        low: Cells,
        size: Cells,
        *,
        linear: bool = True,
        threads: int | None = None,
        numbers: int | None = None,
    ):
        whole_numbers("refined: low", low, (3,)), whole_numbers("refined: size", size, (3,), low=1)
        checked_kind("refined: outer", outer, Fluid, needed=True)
        for name, value, least in (("threads", threads, 1), ("numbers", numbers, 0)):
            if value is not None:
                whole_numbers(f"refined: {name}", value, low=least)
        self._made = False
        self.outer, self.size_lu = outer, np.array(size, int)
        options = outer._options
        if options["dtype"] != "float32":
            raise ConfigError(f"refined: populations of the coarse water are {options['dtype']}; expected float32")
        fills = self._fills(np.array(low, int))
        self._linear = linear
        self._ghost = np.where(fills, 0, GHOST)
        self.embedded = np.flatnonzero(~fills).tolist()
        self._strip = bool(fills[2]) and outer.extent[2] == 1
        self._ratio = np.array([RATIO, RATIO, 1 if self._strip else RATIO])  # fine nodes to a coarse one
        if numbers is None:
            numbers = 0 if fills[2] else -RATIO * int(low[2]) % SECTOR
        self._numbers = np.array([0, 0, numbers])
        faces = Boundaries(**{name: getattr(PERIODIC, name) for name in "xyz"})
        more: dict[str, Any] = {name: value for name, value in options.items() if name != "dtype"}
        super().__init__(
            fine_lattice(outer.lattice, numbers, self._strip),
            (*self.extent[:2], self.extent[2] if fills[2] else -(-self.extent[2] // SECTOR) * SECTOR),
            outer.device,
            boundaries=faces,
            subgrid=outer.subgrid,
            flow=outer.flow,
            threads=threads or outer.threads,
            **more,
        )
        self._made = True
        self._nest = _nest(outer.shape, self.shape, RATIO * self.size_lu, self._ghost, linear)
        self._directions = wp.array(VELOCITIES.astype(np.int32), dtype=wp.vec3i, device=self.device)
        lists = [wp.array(found, dtype=int, device=self.device) for found in lists_of(_cells(size), _cells(self._ghost))]
        self._entering, self._children, self._leaving, self._later, self._all, self._rim = lists
        self._corner = wp.zeros(6, dtype=int, device=self.device)
        self._place(self._ratio * np.array(low, int) + self._numbers - self._ghost)
        self.set_steps(RATIO * outer.steps)
        self.prolong()

    def _fills(self, low: np.ndarray) -> np.ndarray:
        """Mask (3,) of the axes that a box at `low` fills from end to end; such an axis must be periodic."""
        shape, first = np.array(self.outer.extent), self.outer.origin_lu
        room = _room(self.outer)
        fills = self.size_lu == shape
        for a, axis in enumerate(self.outer.boundaries.axes):
            wraps = FACES[axis.low].wraps
            at, name = low[a] - first[a], "xyz"[a]
            if fills[a]:
                if not wraps or at != 0 or (isinstance(self.outer, RefinedFluid) and a in self.outer.embedded):
                    raise ConfigError(f"refined: the box fills axis {name}, which must be periodic, from its first cell on")
            elif self.size_lu[a] < 2 or at < room or at + self.size_lu[a] > shape[a] - room:
                raise ConfigError(
                    f"refined: cells {at} to {at + self.size_lu[a]} of axis {name}; expected two or more of {shape[a]},"
                    f" with {room} to spare at both ends. Make the box smaller, or the water larger"
                )
        return fills

    @property
    def extent(self) -> Cells:
        """Cells of the box and its ghosts, (3,)."""
        return _cells(self._ratio * self.size_lu + 2 * self._ghost)

    def _stepped(self) -> tuple[Cells, Cells]:
        return _cells(self._ghost), _cells(self._ratio * self.size_lu + self._ghost)

    @property
    def first_lu(self) -> np.ndarray:
        """World node (3,) of this level at the box's low corner."""
        return self.origin_lu + self._ghost

    @property
    def low_lu(self) -> np.ndarray:
        """World node (3,) of the coarse level at the box's low corner."""
        return (self.first_lu - self._numbers) // self._ratio

    @property
    def whole(self) -> bool:
        """Returns True if both levels are at the same time."""
        return self.steps % RATIO == 0

    def set_flow(self, flow: Flow) -> None:
        """Changes the background flow of all levels from now on; raises as `Fluid.set_flow`."""
        super().set_flow(flow)
        if flow is not self.outer.flow:
            self.outer.set_flow(flow)

    def set_steps(self, steps: int) -> None:
        """Sets the clocks of both levels.

        Raises:
            ConfigError: not a whole number of coarse steps.
        """
        if steps % RATIO:
            raise ConfigError(f"refined: {steps} steps are no whole number of coarse ones; expected a multiple of {RATIO}")
        super().set_steps(steps)
        self.outer.set_steps(steps // RATIO)

    def settle(self) -> None:
        """Sets the undisturbed background flow everywhere on both levels."""
        if self._made:
            self.outer.settle()
        super().settle()

    def _place(self, origin: np.ndarray) -> None:
        super()._place(origin)
        corner = np.concatenate([origin % self.shape, self.low_lu % self.outer.shape])
        self._corner.assign(corner.astype(np.int32))  # where in memory the fine array and R begin

    def stream_collide(self) -> None:
        """Does one fine time step, and every second time a coarse one."""
        self._advance()
        for box in self.boxes:  # the finest first: coarser cells are made of its
            if not box.whole:
                break
            box._restrict(box._rim)

    def _advance(self) -> None:
        """Like `stream_collide`, but the coarse cells in the box stay as their own step leaves them."""
        coarse = self.outer
        if self.whole:
            self._explode()
            super().stream_collide()
            self._coalesce()
        else:
            super().stream_collide()
            if isinstance(coarse, RefinedFluid):
                coarse._advance()
            else:
                coarse.stream_collide()

    def _explode(self) -> None:
        args = [self._nest, self._directions, self._entering, self._children, self._corner]
        args += [self.outer.f.flatten(), self.outer.u.flatten()]
        copies = [copy.flatten() for k in (self.parity, 1 - self.parity) for copy in (self._f[k], self._u[k])]
        self._exchange(exchange.explode, len(self._entering), args, copies)

    def _coalesce(self) -> None:
        args = [self._nest, self._directions, self._leaving, self._later, self._corner]
        args += [self._f[1 - self.parity].flatten(), self.f.flatten()]
        self._exchange(exchange.coalesce, len(self._leaving), args, [self.outer.f.flatten()])

    def restrict(self) -> None:
        """Computes all coarse cells in the box from the fine ones."""
        self._restrict(self._all)

    def complete(self) -> None:
        """Computes all coarse cells under finer boxes, on all levels."""
        for box in self.boxes:
            box.restrict()

    def _restrict(self, cells: wp.array) -> None:
        args = [self._nest, RATIO if self._strip else RATIO**2, cells, self._corner, self.f.flatten(), self.u.flatten()]
        self._exchange(exchange.restrict, len(cells), args, [self.outer.f.flatten(), self.outer.u.flatten()])

    def prolong(self, kept: tuple | None = None) -> None:
        """Computes fine cells from the coarse ones, except those in the box `kept` of coarse cells, (low, size)."""
        low, size = kept if kept is not None else NOWHERE
        args = [self._nest, self._corner, wp.vec3i(*_cells(low - self.low_lu)), wp.vec3i(*map(int, size))]
        args += [self.outer.f.flatten(), self.outer.u.flatten()]
        self._exchange(exchange.prolong, tuple(self.size_lu.tolist()), args, [self.f.flatten(), self.u.flatten()])

    def _exchange(self, kernel, dim, inputs, outputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device, block_dim=BLOCK)

    def move(self, by: Cells) -> None:
        """Moves the box by whole coarse cells, between two coarse steps.

        Raises:
            ConfigError: in the middle of a coarse step, or out of the coarse water.
        """
        whole_numbers("refined: move", by, (3,))
        if not self.whole:
            raise ConfigError("refined: the box moves between two coarse steps only, after an even number of its own")
        old = self.low_lu
        self._fills(old + by)
        self.restrict()  # what the box leaves behind
        self._place(self.origin_lu + self._ratio * np.array(by))
        self.prolong((old, self.size_lu))

    def centre_on(self, point) -> bool:
        """Moves the box until its middle is within a coarse cell of `point` (3,) m, as far as the coarse water reaches."""
        best = lowest(self.outer, point, self.size_lu)
        low = np.where(np.abs(self._offset_of(point)) >= 1, best, np.clip(self.low_lu, *_limits(self.outer, self.size_lu)))
        by = np.where(self._ghost > 0, low - self.low_lu, 0)
        if not by.any():
            return False
        self.move(_cells(by))
        return True

    def _offset_of(self, point) -> np.ndarray:
        """Offset (3,), in coarse cells, from the middle of the box to a point in m."""
        return self.outer.lattice.to_lu(point) - (self.low_lu + (self.size_lu - 1) / 2)

    def shift(self, by: Cells) -> None:
        """Raises ConfigError: the box moves by `move`, its coarse water by `outer.shift`."""
        raise ConfigError("refined: a box moves by whole coarse cells, `move`, and its coarse water by `outer.shift`")

    def run(self, steps: int, before=None) -> None:
        """Does fine steps without a body; on cuda in captured graphs of `period` steps."""
        self.set_box(NOWHERE)
        if before is None and self.device.is_cuda and steps >= self.period:
            graph, times = self._captured(self.period), steps // self.period
            for _ in range(times):
                wp.capture_launch(graph)
                self.skip(self.period)
                self.watch.after_step(self, self.period)
            steps -= times * self.period
        for _ in range(steps):
            if before is not None:
                before()
            self.stream_collide()
            self.watch.after_step(self)

    @property
    def period(self) -> int:
        """Number of fine steps after which all levels read the same copies again."""
        return RATIO * (self.outer.period if isinstance(self.outer, RefinedFluid) else 2)

    @property
    def phase(self) -> int:
        """Index of the case: the copies that the next step reads on every level, and the half of the coarse step."""
        return self.parity + 2 * (self.steps % RATIO) + 4 * self.outer.phase

    def skip(self, steps: int) -> None:
        """Counts, on the host, steps that a graph has done."""
        for _ in range(steps):
            if not self.whole:
                self.outer.skip(1)
            self.parity, self.steps = 1 - self.parity, self.steps + 1

    def _captured(self, stride: int) -> wp.Graph:
        """Captures a graph of a whole period from the present phase on, without running it."""
        key = self.phase
        if key not in self._graphs:
            for kernel in (exchange.explode, exchange.coalesce, exchange.restrict):
                kernel.module.load(self.device, BLOCK)
            for level in self.levels:
                level._kernel.module.load(self.device)
            account = self.account
            with wp.ScopedCapture(self.device) as capture:
                for _ in range(stride):
                    self.stream_collide()
            self._graphs[key], self.account = capture.graph, account
        return self._graphs[key]

    @property
    def boxes(self) -> "list[RefinedFluid]":
        """All boxes of finer cells, the finest first."""
        return [self, *(self.outer.boxes if isinstance(self.outer, RefinedFluid) else [])]

    @property
    def levels(self) -> list[Fluid]:
        """All levels, the finest first; the last is the water round all boxes."""
        return [*self.boxes, self.boxes[-1].outer]

    def totals(self) -> np.ndarray:
        """Mass less that of still water, kg, and momentum, (3,) kg m/s, of all levels; each place counts once.

        A strip counts as deep as a cell of this level.
        """
        sums, hole = np.zeros(len(VELOCITIES)), None
        for level in self.levels:
            counts = np.ones(level.shape, bool)
            if isinstance(level, RefinedFluid):
                counts[:] = False
                counts[_memory(level, level.first_lu, RATIO * level.size_lu)] = True
            if hole is not None:
                counts[hole] = False
            deep = self.lattice.dx / level.lattice.dx if self._strip else 1.0
            sums += level.f.numpy()[:, counts].sum(1, dtype=float) * level.lattice.mass * deep
            if isinstance(level, RefinedFluid):
                hole = _memory(level.outer, level.low_lu, level.size_lu)
        return np.concatenate([[sums.sum()], VELOCITIES.T @ sums * self.lattice.velocity])

    def box_slices(self) -> tuple[slice, slice, slice]:
        """Slices of the box, without ghosts, in arrays of the fine level from its low corner on (`velocity`, `pressure`)."""
        x, y, z = (slice(int(g), int(n - g)) for g, n in zip(self._ghost, self.extent, strict=True))
        return x, y, z

    def begin_survey(self) -> None:
        """Queues a survey of every level and returns at once."""
        super().begin_survey()
        self.outer.begin_survey()

    def surveyed(self) -> Survey:
        """Extremes of both levels.

        The mass is scaled so that its mean over the cells of this level is that of the coarse water.
        """
        fine, coarse = super().surveyed(), self.outer.surveyed()
        mass = coarse.mass / self.outer.cells * self.cells
        speed, lost = max(fine.speed, coarse.speed), fine.lost + coarse.lost
        return Survey(min(fine.rho_min, coarse.rho_min), max(fine.rho_max, coarse.rho_max), speed, mass, lost)

    def finer(self, factor: int) -> "RefinedFluid":
        """Undisturbed water on all levels, with the same cells at their present place and steps `factor` times finer."""
        outer = self.outer.finer(factor)
        outer._place(self.outer.origin_lu.copy())
        x, y, z = self.low_lu
        same: dict[str, Any] = {"linear": self._linear, "threads": self.threads, "numbers": int(self._numbers[2])}
        return RefinedFluid(outer, (x, y, z), _cells(self.size_lu), **same)

    def snapshot(self) -> dict[str, np.ndarray]:
        """Complete state of both levels. The coarse level's arrays are under `outer.`.

        This level's are by world node, without `numbers`.

        Raises:
            ConfigError: in the middle of a coarse step.
        """
        if not self.whole:
            raise ConfigError("refined: a state is kept between two coarse steps only, after an even number of fine ones")
        self.restrict()
        state, origin = super().snapshot(), self.origin_lu - self._numbers
        for name, axes in AXES.items():
            state[name] = np.roll(self._in_order(state[name], axes[0]), origin, axes)
        return state | {"origin": origin} | {f"outer.{name}": value for name, value in self.outer.snapshot().items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continues from a snapshot, bit for bit; the coarse clock follows the fine one.

        Raises:
            ConfigError: it was taken in boxes of other shapes, or holds one level only.
        """
        outer = {name.removeprefix("outer."): value for name, value in state.items() if name.startswith("outer.")}
        if "f" not in outer:
            raise ConfigError("refined: a snapshot of one level; expected one of refined water, with both")
        if state["f"].shape[1:] != self.extent:
            raise ConfigError(f"fluid: a snapshot of shape {state['f'].shape[1:]} does not fit a box of {self.extent}")
        plain = np.array(state["origin"], int)
        mine, changed = plain + self._numbers, {}
        for name, axes in AXES.items():
            more = [(0, 0)] * state[name].ndim
            more[axes[2]] = 0, self.shape[2] - self.extent[2]
            changed[name] = np.roll(np.pad(np.roll(state[name], -plain, axes), more), mine, axes)
        super().restore(state | changed | {"origin": mine})
        self.outer.restore(outer | {"steps": np.array(self.steps // RATIO)})


def _cells(n) -> Cells:
    x, y, z = (int(a) for a in n)
    return x, y, z


def nested_boxes(outer: Fluid, low: np.ndarray, high: np.ndarray, margins: Sequence[float]) -> Fluid:
    """Puts boxes of finer cells round low to high (3,) m into `outer`, the first by the first of `margins`, m, larger.

    They end before a sponge and before the faces; a box that would reach a periodic end of `outer` fills that axis.

    Returns:
        The finest water: `outer` without margins.
    """
    for margin in margins:
        faces, shape, room = outer.boundaries, np.array(outer.extent), np.full(3, _room(outer))
        if not isinstance(outer, RefinedFluid):
            room = np.maximum(room, [faces.sponge * ("open" in axis) for axis in faces.axes])
        ends = (np.floor(outer.lattice.to_lu(x) + 0.5) - outer.origin_lu for x in (low - margin, high + margin))
        a, b = (end.astype(int) for end in ends)
        wraps = np.array([FACES[axis.low].wraps for axis in faces.axes])
        if isinstance(outer, RefinedFluid):
            wraps[outer.embedded] = False
        fills = wraps & ((a < room) | (b >= shape - room))
        a, b = np.where(fills, 0, np.maximum(a, room)), np.where(fills, shape, np.minimum(b + 1, shape - room))
        outer = RefinedFluid(outer, _cells(outer.origin_lu + a), _cells(b - a))
    return outer


def lowest(outer: Fluid, point, size) -> Cells:
    """World node (3,) of the low corner of a box of `size` cells of `outer`, as near to `point` (3,) m as the room allows."""
    point = numbers("refined: point", point, (3,))
    wanted = np.rint(outer.lattice.to_lu(point) - (np.array(size) - 1) / 2).astype(int)
    return _cells(np.clip(wanted, *_limits(outer, size)))


def _limits(outer: Fluid, size) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest world node (3,) that the low corner of a box in `outer` may have."""
    low = outer.origin_lu + _room(outer)
    return low, outer.origin_lu + np.array(outer.extent) - _room(outer) - np.array(size)


def _room(outer: Fluid) -> int:
    """Number of cells between the box and the ends of the coarse array."""
    return ROOM + (GHOST if isinstance(outer, RefinedFluid) else 0)


def _nest(coarse, fine, size, ghost, linear: bool) -> Nest:
    made = Nest()
    shell = size // RATIO + 2 * ghost
    made.coarse, made.fine, made.size, made.ghost, made.shell = (
        wp.vec3i(*map(int, n)) for n in (coarse, fine, size, ghost, shell)
    )
    made.by_shell = wp.vec4i(*split_by(int(shell[1])), *split_by(int(shell[2])))
    made.gap, made.linear = int(fine[2] - size[2]), float(linear)
    return made


def _memory(level: Fluid, low, size) -> tuple[np.ndarray, ...]:
    """Index of a box of world nodes in a level's arrays."""
    return np.ix_(*((a + np.arange(b)) % n for a, b, n in zip(low, size, level.shape, strict=True)))
