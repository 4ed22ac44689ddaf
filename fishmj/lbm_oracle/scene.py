"""A body of your own in a box of water, in SI units.

    scene = Scene(box=(0.6, 0.4), dx=0.001, nu=1e-6, stream=0.01)       two lengths: a flat flow, forces per metre of span
    scene.add(cylinder(0.01), at=(0.2, 0.2))
    scene.run(60.0)
    print(scene, scene.drag_coefficient(20.0))

The box spans 0 to `box`. The water streams along x through open faces, or is at rest. A body is held, moves as a function of
time, or is free:

    add(cylinder(0.01), at=(0.2, 0.2))                                                             held
    add(plate(0.1), at=(0.3, 0.2), joints=("slide y", "hinge z"), motion=lambda t: (h(t), a(t)))   moved, m and rad
    add(sphere(0.02), at=(0.1, 0.1, 0.1), joints=("free",), density=1100.0)                      free
    add(mujoco.MjModel.from_xml_path("fish.xml"), motion=lambda t: angles(t))                      your model in its own frame

All walls of bodies are without slip. docs/solver/your_own_body.md has the measured accuracy.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_kind, checked_name, shown_value
from fishmj.base.units import WATER_DENSITY, WATER_VISCOSITY
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.guard import check_speed, check_tau, numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import RATIO, Lattice
from fishmj.lbm_oracle.immersed import scene_bodies
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.scene_bodies import JOINTS, MotionFunction, Numbers, PlacedBody, SceneBodies, position
from fishmj.lbm_oracle.immersed.shapes import BodyShape, cylinder, mesh, plate, section, sphere, upright_edges
from fishmj.lbm_oracle.immersed.silhouettes import outlines
from fishmj.lbm_oracle.immersed.strip import coupled_in
from fishmj.lbm_oracle.output.force_record import SWING, ForceRecord, frequency, settled_mean, window
from fishmj.lbm_oracle.output.slices import Slice
from fishmj.lbm_oracle.refined.refined_fluid import nested_boxes
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.water.flow import Flow

__all__ = ["Scene", "cylinder", "mesh", "plate", "section", "sphere"]

SIDES = ("slip", "wall", "open", "periodic")
COURANT, THICKEST = 0.05, 0.1  # cells a step of the stream: Mach 0.09; greatest viscosity in lattice units
FEWEST, CLEAR = 6, 4  # cells across a body; between a body and a face
NEAR_NODE = 0.25 - 1e-6  # cells between an edge along the grid and a row of nodes
AHEAD, BLOCKED = 5.0, 0.1  # body lengths to the inlet, and blockage: a narrower box raises the force by more than some 15 %
SHEDS, BLUNT = 47.0, 0.3  # Re from which a cylinder sheds; frontal height over length of a body that may
QUIET = 5.0  # s of work before a progress line


class Scene:
    """A box of water with bodies of your own.

    Args:
        box: lengths m, (x, y, z), or (x, y) for a flow in the plane; rounded to whole cells. dx: cell at the bodies, m.
        near: distances from the bodies, m, within which cells are dx, 2 dx, 4 dx, ..; beyond the last they double once more. One
            upright box for each, round all bodies, follows them. By default all cells are dx.
        nu: kinematic viscosity, m2/s. stream: speed along x, m/s; 0: water at rest. rho: density, kg/m3.
        dt: time step at the bodies, s; by default the stream moves 0.05 cells in it (Mach 0.09), or it is 0.1 dx^2 / nu if less.
        sides: kind of the side faces: slip, wall, open (above and below: slip) or periodic; of all faces without a stream.
        sponge: largest cells behind each open face in which waves are damped; half a body's size, at least 8, by default.
        subgrid: eddy viscosity, "wale", for flows that the cells do not resolve; "none".
        gravity: (3,) m/s2, on free bodies and on the water that they displace. device: cpu, cuda or auto.

    Raises:
        ConfigError, UnknownName, OracleUnstable: an argument that does not fit; the message says what would.
    """

    def __init__(
        self,
        box: Numbers,
        dx: float,
        nu: float = WATER_VISCOSITY,
        stream: float = 0.0,
        *,
        near: Numbers | float = (),
        rho: float = WATER_DENSITY,
        dt: float | None = None,
        sides: str = "slip",
        sponge: int | None = None,
        subgrid: str = "none",
        gravity: Numbers = (0.0, 0.0, 0.0),
        device: str = "cpu",
    ):
        dx, nu = (float(numbers(f"scene: {name}", value, low=1e-300)) for name, value in (("dx", dx), ("nu", nu)))
        stream = float(numbers("scene: stream", stream, low=0.0))
        if np.shape(box) not in ((2,), (3,)):
            raise ConfigError(f"scene: box = {shown_value(box)}; expected three lengths in m, or two for a flow in the plane")
        self._near = _checked_near(near, dx)
        coarsest = dx * RATIO ** len(self._near)
        lengths = numbers("scene: box", box, (len(box),), low=coarsest)
        self.flat = len(lengths) == 2
        x, y, z = (int(round(length / coarsest)) for length in (*lengths, *([coarsest] if self.flat else [])))
        self.shape = x, y, z
        if dt is None and not stream:
            raise ConfigError("scene: water at rest and no dt; expected dt = 0.05 dx / (greatest speed of a body), s")
        step = min(COURANT * dx / stream, THICKEST * dx**2 / nu) if dt is None else dt
        self.lattice = Lattice(dx=dx, dt=step, rho=rho, nu=nu, corner=(dx / 2,) * 3)  # faces half a cell outside the nodes
        middle = (coarsest / 2,) * 2 + (dx / 2 if self.flat else coarsest / 2,)
        self._coarse = replace(self.lattice, dx=coarsest, dt=step * RATIO ** len(self._near), corner=middle)
        check_speed(self.lattice, stream, "scene: stream")
        check_tau(self._coarse, subgrid, "scene: largest cells" if self._near else "scene")
        checked_name("kind of side face", sides, SIDES)
        if sponge is not None:
            whole_numbers("scene: sponge", sponge, low=0)
        self.gravity = numbers("scene: gravity", gravity, (3,))
        self.stream, self.subgrid, self.sides, self.device = stream, subgrid, sides, device
        device_of("cpu")  # Warp starts without its banner
        self._sponge, self._placed, self._holds_model = sponge, list[PlacedBody](), False
        self._made: SceneBodies | None = None
        self._coupled: FluidStructure | None = None
        self._times: list[float] = []
        self._wrenches: list[np.ndarray] = []

    def add(
        self,
        body: "BodyShape | mujoco.MjModel",
        at: Numbers | None = None,
        *,
        joints: Sequence[str] = (),
        motion: MotionFunction | None = None,
        density: float | None = None,
    ) -> "Scene":
        """Adds a body before the first step; returns the scene.

        Args:
            body: sphere(..), cylinder(..), section(..), plate(..), mesh(..); or a MuJoCo model, alone, in its own frame, whose
                geoms of the groups 0 to 2 are its surface. Without joints it is held. Geoms that overlap displace water twice.
            at: place of the shape's origin, m, as many numbers as the box has.
            joints: "slide x", "hinge z", .., the outermost first, or "free"; none: the body is held.
            motion: function of the time in s to the positions of all joints, m and rad; without it a body with joints is free.
            density: of a free body, kg/m3.

        Raises:
            ConfigError: a body too small for the cells, outside the box or too near to a face; arguments that do not go together.
        """
        if self._coupled is not None:
            raise ConfigError("scene: the water has been stepped; add every body before the first run")
        if motion is not None and not callable(motion):
            raise ConfigError(f"scene: motion = {shown_value(motion)}; expected a function of the time in s")
        if isinstance(body, mujoco.MjModel):
            return self._add_model(body, motion, at is None and not joints and density is None)
        shape = checked_kind("scene: body", body, BodyShape, needed=True)
        if self._holds_model:
            raise ConfigError("scene: a shape beside a MuJoCo model; a model holds all bodies: add the shape to it as a geom")
        if shape.flat != self.flat:
            wanted = "two lengths, box=(x, y)" if shape.flat else "three lengths, box=(x, y, z)"
            raise ConfigError(f"scene: a {shape.name} in a box of {len(self.extent)} lengths; expected {wanted}")
        if at is None:
            raise ConfigError(f"scene: a {shape.name} without a place; expected at=({', '.join('xyz'[: len(self.extent)])}) in m")
        place = np.append(numbers(f"scene: at of the {shape.name}", at, (len(self.extent),)), [self.lattice.dx / 2] * self.flat)
        joints = _checked_joints(joints, self.flat)
        if motion is not None and (not joints or "free" in joints):
            raise ConfigError("scene: a motion without slides or hinges; expected joints=('slide y', ..), one for each number")
        if (density is None) != (not joints or motion is not None):
            needs = "a free body needs its density in kg/m3" if density is None else "a density is that of a free body"
            raise ConfigError(f"scene: {shape.name}: {needs}; a held one has no joints, a moved one a motion")
        if density is not None and not shape.volume:
            raise ConfigError(
                f"scene: a free {shape.name} without volume; put a thin free body into a MuJoCo model with its mass"
            )
        weight = 0.0 if density is None else float(numbers("scene: density", density, low=1e-300))
        one = PlacedBody(shape, place, joints, motion, weight)
        self._check_size(f"across the {shape.name}", shape.size)
        self._warn_if_thin(shape.name, shape.width or shape.size)
        start = np.zeros(3) if motion is None else _shifted(joints, position(motion, 0.0, len(joints)))
        markers = shape.markers(self.lattice.dx)
        if markers.law_height is not None:
            raise ConfigError(
                f"scene: {shape.name}: markers with a law for the wall's stress; the walls of a scene are without slip: take"
                " another sharpness, or FluidStructure with slip = 1"
            )
        self._check_place(shape.name, markers.rest + place + start, self._sponge_for(shape.size))
        if self.flat and shape.volume and shape.surface is not None and not {"hinge z", "free"} & set(joints):
            self._warn_of_edges_on_nodes(shape.name, place + start, upright_edges(shape.surface))
        self._placed.append(one)
        self._made = None
        return self

    def _add_model(self, model: mujoco.MjModel, motion: MotionFunction | None, plain: bool) -> "Scene":
        if not plain:
            raise ConfigError(
                "scene: a MuJoCo model with at, joints or density; its place, joints and masses are those of the model"
            )
        if self._holds_model or self._placed:
            raise ConfigError("scene: a MuJoCo model beside other bodies; expected one model that holds all of them")
        if self.flat:
            raise ConfigError("scene: a MuJoCo model in a box of two lengths; expected box=(x, y, z)")
        if self.gravity.any():
            raise ConfigError("scene: gravity beside a MuJoCo model, which has its own; set it there: <option gravity=..>")
        if motion is not None and model.nq != model.nv:
            raise ConfigError("scene: the motion of a model with a free or ball joint; expected hinges and slides only")
        if motion is not None and not model.nv:
            raise ConfigError("scene: the motion of a model without joints, which is held; give the model joints, or no motion")
        made = scene_bodies.of_model(model, motion, self.lattice)
        self._check_place("the model", made.marker_places(), self._sponge_for(made.size))
        self._check_size("along the model", made.size)
        self._warn_if_thin("a geom of the model", made.width)
        self._holds_model, self._made = True, made
        return self

    def _check_size(self, where: str, size: float) -> None:
        if size < FEWEST * self.lattice.dx * (1 - 1e-9):
            cells = f"{size / self.lattice.dx:.1f} cells {where}; expected {FEWEST} at least"
            raise ConfigError(f"scene: {cells}: dx = {size / FEWEST:.3g} m or less")

    def _warn_if_thin(self, name: str, width: float) -> None:
        if width < FEWEST * self.lattice.dx * (1 - 1e-9):
            console.warn(
                f"scene: {width / self.lattice.dx:.1f} cells across {name} where it is thinnest to the stream; {FEWEST} or more"
                f" give a force to trust: dx = {width / FEWEST:.3g} m or less"
            )

    def _warn_of_edges_on_nodes(self, name: str, place: np.ndarray, edges: list[tuple[int, float]]) -> None:
        """Warns of edges (axis, m from `place`) that are nearer to a row of nodes than to the middle between two rows."""
        dx, edges = self.lattice.dx, [(axis, place[axis] + far) for axis, far in edges]
        near = [f"{'xy'[axis]} = {at:.4g} m" for axis, at in edges if abs((at / dx) % 1 - 0.5) < NEAR_NODE]  # nodes: (i + 1/2) dx
        if near:
            console.warn(
                f"scene: {name}: edges at {', '.join(near)} lie on rows of nodes, which takes up to 2 % off a square's drag. Put"
                f" them a whole number of cells of {dx:.4g} m from the corner of the box: a side of whole cells, and half a cell"
                " more in `at` if their number is odd"
            )

    def _bodies(self) -> SceneBodies:
        if self._made is None:
            if not self._placed:
                one = "cylinder(0.02), at=(0.1, 0.1)" if self.flat else "sphere(0.02), at=(0.1, 0.1, 0.1)"
                raise ConfigError(f"scene: no body; add one: scene.add({one})")
            order = sorted(self._placed, key=lambda one: bool(one.joints))  # stable
            self._made = scene_bodies.of_shapes(order, self.gravity, self.lattice, self.flat)
        return self._made

    def _check_place(self, name: str, points: np.ndarray, sponge: int) -> None:
        """Raises ConfigError for markers (N, 3) m outside the box, or too near to a face that is not periodic."""
        dx = self._coarse.dx
        for a, (axis, length) in enumerate(zip(self._faces(0).axes, self.extent, strict=False)):
            low, high = points[:, a].min(), points[:, a].max()
            room = CLEAR if "open" not in axis else sponge + CLEAR * bool(self._near)
            if axis.low != "periodic" and min(low, length - high) < room * dx * (1 - 1e-9):
                side = "the damping layer" if "open" in axis else "the kernel"
                side += " and the boxes of smaller cells" * bool(self._near)
                raise ConfigError(
                    f"scene: {name} from {'xyz'[a]} = {low:.4g} to {high:.4g} m in a box of 0 to {length:.4g} m; expected {room}"
                    f" cells of {dx:.3g} m ({room * dx:.3g} m) to each face for {side}. Move the body or enlarge the box"
                )

    def _sponge_for(self, size: float) -> int:
        return max(8, round(size / self._coarse.dx) // 2) if self._sponge is None else self._sponge

    def _faces(self, sponge: int) -> Boundaries:
        side, plane = Axis(self.sides, self.sides), Axis("periodic", "periodic")
        top = plane if self.flat else Axis("slip", "slip") if self.sides == "open" else side
        return Boundaries(x=Axis("open", "open") if self.stream else side, y=side, z=top, sponge=sponge)

    @property
    def extent(self) -> tuple[float, ...]:
        """Lengths of the box in whole cells, m: two of a flow in the plane, else three."""
        return tuple(n * self._coarse.dx for n in self.shape[: 2 if self.flat else 3])

    @property
    def coupled(self) -> FluidStructure:
        """Water and bodies as the solver couples them, made at the first use.

        Raises:
            ConfigError: no body; a model that the coupled step does not compute.
        """
        if self._coupled is None:
            self._coupled = self._couple()
        return self._coupled

    def _couple(self) -> FluidStructure:
        made = self._bodies()
        if self.stream and (self._ahead() < AHEAD or self.blockage > BLOCKED):
            console.warn(
                f"scene: {self._ahead():.3g} D to the inlet and a blockage of {100 * self.blockage:.2g} % raise the force;"
                " 8 D and 5 % raise that of a cylinder by 6 % at Re 60, 16 D and 2.5 % by 2 %"
            )
        faces = self._faces(self._sponge_for(made.size))
        options: dict[str, Any] = {"subgrid": self.subgrid, "boundaries": faces, "flow": Flow(speed=self.stream)}
        self._fixed, self._position = np.zeros(made.body.dofs), np.zeros(made.body.dofs)
        for part, motion in made.drives:
            self._fixed[part] = 1.0
            self._position[part] = position(motion, 0.0, part.stop - part.start)
        water = nested_boxes(Fluid(self._coarse, self.shape, self.device, **options), *made.bounds(), self._near[::-1])
        return coupled_in(water, made.body, made.markers, RefinedStructure if self._near else FluidStructure)

    def step(self) -> None:
        """Does one time step.

        Raises:
            SimDiverged, OracleUnstable: the flow left the limits of the scheme. ConfigError: a body came too near to a face.
        """
        coupled = self.coupled
        ahead = self._position.copy()
        for part, motion in self._bodies().drives:
            ahead[part] = position(motion, (coupled.steps + 1) * self.lattice.dt, part.stop - part.start)
        coupled.step(self._fixed, (ahead - self._position) / self.lattice.dt)
        self._position = ahead
        if isinstance(coupled, RefinedStructure) and self._bodies().moves and coupled.steps % RATIO ** len(self._near) == 0:
            with coupled.scope():
                for box in reversed(coupled.fluid.boxes):  # the finest last: it stays inside the others
                    box.centre_on(np.mean(self._bodies().bounds(), 0))

    def run(self, seconds: float, every: int = 1) -> ForceRecord:
        """Steps for `seconds` and records the force each `every` steps; returns the record since the first run.

        An interrupted run keeps its record, and the next call goes on. Raises as `step`.
        """
        every = int(whole_numbers("scene: every", every, low=1))
        steps = max(1, round(float(numbers("scene: seconds", seconds, low=1e-300)) / self.lattice.dt / every))
        self.coupled.take_wrench(1.0)  # of steps outside this record
        self._record(every)  # compiles, and would spoil the first estimates of the time left
        with console.Progress((steps - 1) * every, "scene", unit="steps") as bar:
            for n in range(1, steps):
                self._record(every)
                if bar.elapsed > QUIET:
                    bar.update(n * every)
        return self.forces

    def _record(self, every: int) -> None:
        for _ in range(every):
            self.step()
        _, wrench = self.coupled.take_wrench(every * self.lattice.dt)
        self._times.append(self.time)
        self._wrenches.append(wrench / (self.lattice.dx if self.flat else 1.0))

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return 0.0 if self._coupled is None else self._coupled.steps * self.lattice.dt

    @property
    def forces(self) -> ForceRecord:
        """All that was recorded: times (T,) s and wrenches (T, L, 6); links are the shapes, held ones first, each as added."""
        shape = len(self._times), self._bodies().body.links, 6
        return ForceRecord(np.array(self._times), np.array(self._wrenches).reshape(shape))

    def coefficients(self, area: float | None = None, link: int = 0) -> np.ndarray:
        """Force of one link over rho U^2 A / 2, (T, 3).

        A: a plate's chord x span; of all others the frontal area, of a model's link that of the union of its geoms at the start.

        Raises:
            ConfigError: no stream, nothing recorded, no such link, or a link without a surface and no `area`.
        """
        if not self.stream or not self._times:
            raise ConfigError("scene: coefficients need a stream and a record; give stream=, and run(seconds) first")
        whole_numbers("scene: link", link, low=0, high=self.coupled.body.links - 1)
        area = float(numbers("scene: area", self._bodies().areas[link] if area is None else area, low=1e-300))
        return self.forces.wrench[:, link, :3] / (0.5 * self.lattice.rho * self.stream**2 * area)

    def drag_coefficient(self, seconds: float, link: int = 0, area: float | None = None) -> float:
        """Mean C_D of the record's last `seconds`.

        Warns if the two halves of them differ by more than 1 %, and if a blunt body in the plane sheds no wake from Re 47 on.

        Raises ConfigError as `coefficients`, and if the record is shorter.
        """
        found, made = self.coefficients(area, link), self._bodies()
        last = window(self.forces.times, float(numbers("scene: seconds of a mean", seconds)))
        drag, side = found[last, :2].T
        blunt = self.flat and made.front > BLUNT * made.size and self.stream * made.size / self.lattice.nu >= SHEDS
        if blunt and side.std() < SWING * abs(drag.mean()):
            console.warn(
                f"scene: the side force swings by {side.std() / abs(drag.mean()):.1g} of the drag: no wake is shed. A symmetric"
                " body keeps its steady wake, with too little drag, until something disturbs it: move it aside and back in the"
                " first four D / U by joints=('slide y',) and a motion, as examples/cylinder.py does"
            )
        return settled_mean("C_D", drag, seconds)

    def strouhal(self, seconds: float, link: int = 0, length: float | None = None) -> float:
        """Strouhal number f D / U of the force along y in the record's last `seconds`; D: `length` m, or that of Re.

        Raises:
            ConfigError: as `drag_coefficient`; no even swing, or fewer than three periods of it.
        """
        side = self.coefficients(link=link)[:, 1]
        last = window(self.forces.times, float(numbers("scene: seconds of a Strouhal number", seconds)))
        size = float(numbers("scene: length", self._bodies().size if length is None else length, low=1e-300))
        return frequency(self.forces.times[last], side[last]) * size / self.stream

    def vorticity(self, z: float | None = None) -> Slice:
        """Velocity and vorticity in the plane at height `z` m (None: the middle); `outline`: the bodies seen from above.

        Raises:
            ConfigError: z lies outside the water.
        """
        from fishmj.lbm_oracle.output.record_fields import plane_of_levels

        coupled, lattice = self.coupled, self.lattice
        height = self._coarse.corner[2] + (self.shape[2] - 1) * self._coarse.dx / 2 if z is None else z
        with coupled.scope():
            plane = plane_of_levels(coupled.fluid, height)
        x, y = (lattice.corner[a] + lattice.dx * np.arange(plane.shape[a]) for a in range(2))
        lines = [line for link in range(coupled.body.links) for one in self._bodies().placed(link) for line in outlines(one)]
        return Slice(self.time, height, x, y, plane[..., 0], plane[..., 1], plane[..., 2], lines)

    def plot(self, path: str | Path, strong: float | None = None) -> Path:
        """Draws the vorticity in the middle plane; `strong`: ends of the colour scale, 1/s. Returns the path of the picture."""
        from fishmj.lbm_oracle.output.slice_plots import SlicePicture

        found = self.vorticity()
        strong = float(np.quantile(np.abs(found.omega_z), 0.99)) if strong is None else strong
        return SlicePicture(strong).write(Path(path), found)

    @property
    def frontal_area(self) -> float:
        """Area of the union of all bodies where they begin, seen along the stream, m2; of a flat flow m2 per metre of span."""
        return self._bodies().front

    @property
    def blockage(self) -> float:
        """Frontal area of the bodies over the section of the box."""
        return self.frontal_area / float(np.prod(self.extent[1:]))

    def _ahead(self) -> float:
        """Distance of the middle of all bodies to the inlet, D."""
        made = self._bodies()
        return float(np.mean(made.bounds(), 0)[0]) / made.size

    def __str__(self) -> str:
        """Numbers that judge the grid and the box, in two lines."""
        lattice = self.lattice
        grid = f"{' x '.join(map(str, self.shape))} cells of {self._coarse.dx:g} m, "
        for level in reversed(range(len(self._near))):
            grid += f"{lattice.dx * RATIO**level:g} m within {self._near[level]:g} m of the bodies, "
        grid += f"dt {lattice.dt:.4g} s"
        wave = f"Mach {lattice.mach(self.stream):.2f}, tau {lattice.tau:.4f}"
        if not (self._placed or self._holds_model):
            return f"{grid}, {wave}, no body"
        made, ahead = self._bodies(), self._ahead()
        behind = self.extent[0] / made.size - ahead
        wide = " x ".join(f"{length / made.size:.3g}" for length in self.extent[1:])
        return (
            f"{grid}, {round(made.width / lattice.dx, 1):g} across the body, Re {self.stream * made.size / lattice.nu:.4g} on D ="
            f" {1e3 * made.size:.4g} mm, {wave}\n{ahead:.3g} D to the inlet, {behind:.3g} D behind, {wide} D wide, frontal area"
            f" {self.frontal_area:.4g} {'m2/m' if self.flat else 'm2'}, blockage {100 * self.blockage:.2g} %"
        )


def _checked_near(near: Numbers | float, dx: float) -> list[float]:
    """Distances of `near`, m. Raises ConfigError for one that leaves a box too narrow."""
    found, least = np.atleast_1d(near), CLEAR * dx
    found = numbers("scene: near", found, (len(found),)).tolist()
    for level, distance in enumerate(found):
        if distance < least * (1 - 1e-9):
            raise ConfigError(
                f"scene: near = {shown_value(near)}; expected {least:.3g} m or more at place {level}: {CLEAR} cells from the body"
                " or from the box inside it"
            )
        least = distance + CLEAR * dx * RATIO ** (level + 1)
    return found


def _shifted(joints: tuple[str, ...], position: np.ndarray) -> np.ndarray:
    """Displacement (3,) m by the slides."""
    move = np.zeros(3)
    for name, value in zip(joints, position, strict=True):
        if name.startswith("slide"):
            move["xyz".index(name[-1])] += value
    return move


def _checked_joints(joints: Sequence[str], flat: bool) -> tuple[str, ...]:
    known = [f"{kind} {axis}" for kind in JOINTS for axis in "xyz"]
    known = ["slide x", "slide y", "hinge z"] if flat else [*known, "free"]
    if isinstance(joints, str) or any(name not in known for name in joints) or ("free" in joints and len(joints) > 1):
        raise ConfigError(f"scene: joints = {shown_value(joints)}; expected a tuple of some of {', '.join(known)}; free alone")
    return tuple(joints)
