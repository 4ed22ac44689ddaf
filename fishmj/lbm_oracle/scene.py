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

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_kind, checked_name, shown_value
from fishmj.base.units import WATER_DENSITY, WATER_VISCOSITY
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.guard import check_speed, check_tau, numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import Markers
from fishmj.lbm_oracle.immersed.shapes import (
    BodyShape,
    cylinder,
    frontal_area,
    link_surfaces,
    mesh,
    plate,
    solid_moments,
    sphere,
    surface_markers,
)
from fishmj.lbm_oracle.immersed.strip import coupled_in
from fishmj.lbm_oracle.output.slices import Slice
from fishmj.mjcf import passive_slot
from fishmj.water.flow import Flow

__all__ = ["Scene", "cylinder", "mesh", "plate", "sphere"]

SIDES = ("slip", "wall", "open", "periodic")
COURANT, THICKEST = 0.05, 0.1  # cells a step of the stream: Mach 0.09; greatest viscosity in lattice units
FEWEST, CLEAR = 6, 4  # cells across a body; between a body and a face
QUIET = 5.0  # s of work before a progress line
JOINTS = {"slide": mujoco.mjtJoint.mjJNT_SLIDE, "hinge": mujoco.mjtJoint.mjJNT_HINGE}

Numbers = Sequence[float] | np.ndarray
MotionFunction = Callable[[float], Numbers | float]


@dataclass(frozen=True)
class PlacedBody:
    """A shape with its place, joints, motion and density (0: weightless and driven)."""

    shape: BodyShape
    at: np.ndarray
    joints: tuple[str, ...]
    motion: MotionFunction | None
    density: float


class ForceRecord(NamedTuple):
    """Means over intervals ending at `times` (T,) s: wrenches (T, L, 6) N and N m on each link, of a flat flow per metre of span.

    World frame, moments about the link's origin; on a hull without water inside, and without its buoyancy.
    """

    times: np.ndarray
    wrench: np.ndarray


class Scene:
    """A box of water with bodies of your own.

    Args:
        box: lengths m, (x, y, z), or (x, y) for a flow in the plane; rounded to whole cells. dx: cell, m.
        nu: kinematic viscosity, m2/s. stream: speed along x, m/s; 0: water at rest. rho: density, kg/m3.
        dt: time step, s; by default the stream moves 0.05 cells in it, less at a low Reynolds number.
        sides: kind of the side faces: slip, wall, open (above and below: slip) or periodic; of all faces without a stream.
        sponge: cells behind each open face in which waves are damped; half a body's size, at least 8, by default.
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
        lengths = numbers("scene: box", box, (len(box),), low=dx)
        self.flat = len(lengths) == 2
        x, y, z = (int(round(length / dx)) for length in (*lengths, *([dx] if self.flat else [])))
        self.shape = x, y, z
        if dt is None and not stream:
            raise ConfigError("scene: water at rest and no dt; expected dt = 0.05 dx / (greatest speed of a body), s")
        step = min(COURANT * dx / stream, THICKEST * dx**2 / nu) if dt is None else dt
        self.lattice = Lattice(dx=dx, dt=step, rho=rho, nu=nu, corner=(dx / 2,) * 3)  # faces half a cell outside the nodes
        check_speed(self.lattice, stream, "scene: stream")
        check_tau(self.lattice, subgrid, "scene")
        checked_name("kind of side face", sides, SIDES)
        if sponge is not None:
            whole_numbers("scene: sponge", sponge, low=0)
        self.gravity = numbers("scene: gravity", gravity, (3,))
        self.stream, self.subgrid, self.sides, self.device = stream, subgrid, sides, device
        self._sponge, self._placed, self._order = sponge, list[PlacedBody](), list[PlacedBody]()
        self._model: tuple[mujoco.MjModel, MotionFunction | None, list] | None = None
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
            body: sphere(..), cylinder(..), plate(..), mesh(..); or a MuJoCo model, alone, in its own frame, whose geoms of the
                groups 0 to 2 are its surface. Overlapping geoms displace their water twice.
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
        if self._model is not None:
            raise ConfigError("scene: a shape beside a MuJoCo model; a model holds all bodies: add the shape to it as a geom")
        if shape.flat != self.flat:
            wanted = "two lengths, box=(x, y)" if shape.flat else "three lengths, box=(x, y, z)"
            raise ConfigError(f"scene: a {shape.name} in a box of {len(self.extent)} lengths; expected {wanted}")
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
        if shape.size < FEWEST * self.lattice.dx * (1 - 1e-9):
            raise ConfigError(
                f"scene: {shape.size / self.lattice.dx:.1f} cells across the {shape.name}; expected {FEWEST} at least: dx ="
                f" {shape.size / FEWEST:.3g} m or less"
            )
        start = np.zeros(3) if motion is None else _shifted(joints, _position(motion, 0.0, len(joints)))
        markers = shape.markers(self.lattice.dx)
        if markers.law_height is not None:
            raise ConfigError(
                f"scene: {shape.name}: markers with a law for the wall's stress; the walls of a scene are without slip: take"
                " another sharpness, or FluidStructure with slip = 1"
            )
        self._check_place(shape.name, markers.rest + place + start, self._sponge_for(shape.size))
        self._placed.append(one)
        return self

    def _add_model(self, model: mujoco.MjModel, motion: MotionFunction | None, plain: bool) -> "Scene":
        if not plain:
            raise ConfigError(
                "scene: a MuJoCo model with at, joints or density; its place, joints and masses are those of the model"
            )
        if self._model is not None or self._placed:
            raise ConfigError("scene: a MuJoCo model beside other bodies; expected one model that holds all of them")
        if self.flat:
            raise ConfigError("scene: a MuJoCo model in a box of two lengths; expected box=(x, y, z)")
        if self.gravity.any():
            raise ConfigError("scene: gravity beside a MuJoCo model, which has its own; set it there: <option gravity=..>")
        if motion is not None and model.nq != model.nv:
            raise ConfigError("scene: the motion of a model with a free or ball joint; expected hinges and slides only")
        self._model = model, motion, link_surfaces(model)
        return self

    def _check_place(self, name: str, points: np.ndarray, sponge: int) -> None:
        """Raises ConfigError for markers (N, 3) m outside the box, or too near to a face that is not periodic."""
        dx = self.lattice.dx
        for a, (axis, length) in enumerate(zip(self._faces(0).axes, self.extent, strict=False)):
            low, high = points[:, a].min(), points[:, a].max()
            room = sponge if "open" in axis else CLEAR
            if axis.low != "periodic" and min(low, length - high) < room * dx * (1 - 1e-9):
                side = "its damping layer" if "open" in axis else "which the kernel needs"
                raise ConfigError(
                    f"scene: {name} from {'xyz'[a]} = {low:.4g} to {high:.4g} m in a box of 0 to {length:.4g} m; expected {room}"
                    f" cells ({room * dx:.3g} m) to each face, {side}. Move the body or enlarge the box"
                )

    def _sponge_for(self, size: float) -> int:
        return max(8, round(size / self.lattice.dx) // 2) if self._sponge is None else self._sponge

    def _faces(self, sponge: int) -> Boundaries:
        side, plane = Axis(self.sides, self.sides), Axis("periodic", "periodic")
        top = plane if self.flat else Axis("slip", "slip") if self.sides == "open" else side
        return Boundaries(x=Axis("open", "open") if self.stream else side, y=side, z=top, sponge=sponge)

    @property
    def extent(self) -> tuple[float, ...]:
        """Lengths of the box in whole cells, m: two of a flow in the plane, else three."""
        return tuple(n * self.lattice.dx for n in self.shape[: 2 if self.flat else 3])

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
        if self._model is None and not self._placed:
            raise ConfigError("scene: no body; add one: scene.add(sphere(0.02), at=(0.1, 0.1, 0.1))")
        body, markers = self._of_shapes() if self._model is None else self._of_model(*self._model)
        sponge = self._sponge_for(self._size())
        options: dict[str, Any] = {"subgrid": self.subgrid, "boundaries": self._faces(sponge), "flow": Flow(speed=self.stream)}
        coupled = coupled_in(Fluid(self.lattice, self.shape, self.device, **options), body, markers)
        if self._model is not None:
            self._check_place("the model", np.array(body.bounds(coupled.boundary.corners)), sponge)
        return coupled

    def _of_shapes(self) -> tuple[ImmersedBody, Markers]:
        """One MuJoCo body a shape: all held ones hang on the first of them, so that they have one degree of freedom."""
        spec = mujoco.MjSpec()
        spec.option.integrator, spec.option.gravity = mujoco.mjtIntegrator.mjINT_EULER, self.gravity
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        depth, frame, origin = self.lattice.dx if self.flat else 1.0, None, np.zeros(3)
        order = sorted(self._placed, key=lambda one: bool(one.joints))  # stable: held ones first, as MuJoCo numbers their tree
        for i, one in enumerate(order):
            held = not one.joints
            parent = frame if held and frame is not None else spec.worldbody
            link = parent.add_body(name=f"body {i}", pos=one.at - (origin if parent is frame else 0.0))
            mass = one.density * one.shape.volume * depth
            inertia = one.shape.inertia * (one.density * depth) if mass else np.eye(3)
            link.mass, link.ipos, link.explicitinertial = mass or 1.0, one.shape.centre, True
            link.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
            for name in one.joints or (("slide x",) if frame is None else ()):
                if name == "free":
                    link.add_freejoint()
                else:
                    kind, axis = name.split()
                    link.add_joint(name=f"{name} {i}", type=JOINTS[kind], axis=np.eye(3)["xyz".index(axis)])
            if held and frame is None:
                frame, origin = link, one.at
        self._order = order
        water = DisplacedWater(
            mass=np.array([one.shape.volume for one in order]) * self.lattice.rho * depth,
            centre=np.array([one.shape.centre for one in order]),
            inertia=np.array([one.shape.inertia for one in order]) * self.lattice.rho * depth,
        )
        body = ImmersedBody(passive_slot.compiled(spec), water, self.lattice.dt)
        ends = np.cumsum(body.model.body_dofnum[1:])
        self._drives = [
            (slice(int(end - count), int(end)), one.motion or _at_rest)
            for one, end, count in zip(order, ends, body.model.body_dofnum[1:], strict=True)
            if count and not one.density
        ]
        self._start(body)
        return body, _joined([one.shape.markers(self.lattice.dx) for one in order], range(len(order)))

    def _of_model(self, model: mujoco.MjModel, motion: MotionFunction | None, surfaces: list) -> tuple[ImmersedBody, Markers]:
        parts, links, masses = [], [], []
        for link, geoms in enumerate(surfaces):
            moments = [solid_moments(vertices, faces) for _, vertices, faces in geoms]
            total = sum(volume for volume, _, _ in moments)
            middle = sum((volume * place for volume, place, _ in moments), np.zeros(3)) / (total or 1.0)
            inertia = np.zeros((3, 3))
            for volume, place, about in moments:
                arm = place - middle
                inertia += about + volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            masses.append((total, middle, inertia))
            parts += [surface_markers(name, vertices, faces, self.lattice.dx) for name, vertices, faces in geoms]
            links += [link] * len(geoms)
        volumes, centres, inertias = (np.array(column) for column in zip(*masses, strict=True))
        water = DisplacedWater(mass=self.lattice.rho * volumes, centre=centres, inertia=self.lattice.rho * inertias)
        body = ImmersedBody(copy.copy(model), water, self.lattice.dt)
        self._drives = [] if motion is None else [(slice(0, model.nv), motion)]
        self._start(body)
        return body, _joined(parts, links)

    def _start(self, body: ImmersedBody) -> None:
        """Places the body where its motions begin."""
        self._fixed, self._position = np.zeros(body.dofs), np.zeros(body.dofs)
        qpos, qvel = body.data.qpos.copy(), np.zeros(body.dofs)
        for part, motion in self._drives:
            self._fixed[part] = 1.0
            self._position[part] = _position(motion, 0.0, part.stop - part.start)
            ahead = _position(motion, body.dt, part.stop - part.start)
            qvel[part] = (ahead - self._position[part]) / body.dt
            joints = [int(j) for j in np.unique(body.model.dof_jntid[part])]
            qpos[body.model.jnt_qposadr[joints]] = self._position[part]
        body.place(qpos, qvel)

    def step(self) -> None:
        """Does one time step.

        Raises:
            SimDiverged, OracleUnstable: the flow left the limits of the scheme. ConfigError: a body came too near to a face.
        """
        coupled = self.coupled
        ahead = self._position.copy()
        for part, motion in self._drives:
            ahead[part] = _position(motion, (coupled.steps + 1) * self.lattice.dt, part.stop - part.start)
        coupled.step(self._fixed, (ahead - self._position) / self.lattice.dt)
        self._position = ahead

    def run(self, seconds: float, every: int = 1) -> ForceRecord:
        """Steps for `seconds` and records the force each `every` steps; returns the record since the first run.

        An interrupted run keeps its record, and the next call goes on. Raises as `step`.
        """
        every = int(whole_numbers("scene: every", every, low=1))
        steps = max(1, round(float(numbers("scene: seconds", seconds, low=1e-300)) / self.lattice.dt / every))
        self.coupled.take_wrench(1.0)  # of steps outside this record
        depth = self.lattice.dx if self.flat else 1.0
        with console.Progress(steps, "scene", unit="records") as bar:
            for n in range(steps):
                for _ in range(every):
                    self.step()
                _, wrench = self.coupled.take_wrench(every * self.lattice.dt)
                self._times.append(self.time)
                self._wrenches.append(wrench / depth)
                if bar.elapsed > QUIET:
                    bar.update(n + 1)
        return self.forces

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return 0.0 if self._coupled is None else self._coupled.steps * self.lattice.dt

    @property
    def forces(self) -> ForceRecord:
        """All that was recorded: times (T,) s and wrenches (T, L, 6); links are the shapes, held ones first, each as added."""
        return ForceRecord(np.array(self._times), np.array(self._wrenches).reshape(len(self._times), -1, 6))

    def coefficients(self, area: float | None = None, link: int = 0) -> np.ndarray:
        """Force of one link over rho U^2 A / 2, (T, 3); A is the shape's own, of a model its frontal area.

        Raises:
            ConfigError: no stream, nothing recorded, or no such link.
        """
        if not self.stream or not self._times:
            raise ConfigError("scene: coefficients need a stream and a record; give stream=, and run(seconds) first")
        whole_numbers("scene: link", link, low=0, high=self.coupled.body.links - 1)
        default = self._order[link].shape.area if self._model is None else _front(self._model[2][link])
        area = default if area is None else float(numbers("scene: area", area, low=1e-300))
        return self.forces.wrench[:, link, :3] / (0.5 * self.lattice.rho * self.stream**2 * area)

    def drag_coefficient(self, seconds: float, link: int = 0) -> float:
        """Mean C_D of the record's last `seconds`. Raises ConfigError as `coefficients`, and if the record is shorter."""
        drag, times = self.coefficients(link=link)[:, 0], self.forces.times
        if not 0 < float(numbers("scene: seconds of a mean", seconds)) <= times[-1]:
            raise ConfigError(f"scene: a mean over {seconds} s of a record of {times[-1]:.4g} s; expected less, and more than 0")
        return float(drag[times > times[-1] - seconds].mean())

    def vorticity(self, z: float | None = None) -> Slice:
        """Velocity and vorticity in the plane at height `z` m (None: the middle), as they are; `outline` is the bodies' markers.

        Raises:
            ConfigError: z lies outside the water.
        """
        from fishmj.lbm_oracle.output.record_fields import plane_of

        coupled, lattice = self.coupled, self.lattice
        with coupled.scope():
            plane = plane_of(coupled.fluid, z)
            world = coupled.boundary.world.numpy()[:, :2]
        x, y = (lattice.corner[a] + lattice.dx * np.arange(self.shape[a]) for a in range(2))
        height = self.shape[2] * lattice.dx / 2 if z is None else z
        lines = [_hull(world[coupled.boundary.markers.before == link]) for link in range(coupled.body.links)]
        return Slice(self.time, height, x, y, plane[..., 0], plane[..., 1], plane[..., 2], lines)

    def plot(self, path: str | Path, strong: float | None = None) -> Path:
        """Draws the vorticity in the middle plane; `strong`: ends of the colour scale, 1/s. Returns the path of the picture."""
        from fishmj.lbm_oracle.output.slice_plots import SlicePicture

        found = self.vorticity()
        strong = float(np.quantile(np.abs(found.omega_z), 0.99)) if strong is None else strong
        return SlicePicture(strong).write(Path(path), found)

    def _size(self) -> float:
        if self._model is None:
            return max(one.shape.size for one in self._placed)
        return max(float(np.ptp(vertices, 0).max()) for geoms in self._model[2] for _, vertices, _ in geoms)

    @property
    def blockage(self) -> float:
        """Frontal area of the bodies over the section of the box."""
        section = float(np.prod(self.extent[1:]))
        shapes = (one.shape.front for one in self._placed)
        return sum(shapes if self._model is None else map(_front, self._model[2])) / section

    def __str__(self) -> str:
        """Numbers that judge the grid, in one line."""
        lattice, size = self.lattice, self._size() if self._placed or self._model else 0.0
        return (
            f"{' x '.join(map(str, self.shape))} cells of {lattice.dx:g} m, {size / lattice.dx:.3g} across a body, dt"
            f" {lattice.dt:.4g} s, Re {self.stream * size / lattice.nu:.4g}, Mach {lattice.mach(self.stream):.2f}, tau"
            f" {lattice.tau:.4f}, blockage {100 * self.blockage:.2g} %"
        )


def _at_rest(time: float) -> tuple[float, ...]:
    return (0.0,)


def _position(motion: MotionFunction, time: float, count: int) -> np.ndarray:
    """Positions (count,) of a motion. Raises ConfigError for others than `count` finite numbers."""
    return numbers(f"scene: motion at t = {time:.4g} s", np.atleast_1d(motion(time)), (count,))


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


def _joined(parts: Sequence[Markers], links: Sequence[int]) -> Markers:
    """Markers of several rigid links as one."""
    join = lambda name: np.concatenate([getattr(part, name) for part in parts])
    index = np.concatenate([np.full(len(part), link) for part, link in zip(parts, links, strict=True)])
    names = ("rest", "normal", "area", "pivot", "share", "sheet", "slip_length", "layer")
    plain: dict[str, Any] = {name: join(name) for name in names}
    return Markers(**plain, before=index, after=index)


def _front(geoms: list) -> float:
    return sum(frontal_area(vertices, faces) for _, vertices, faces in geoms)


def _hull(points: np.ndarray) -> np.ndarray:
    """Convex hull (P, 2) of points seen from above; two ends if they lie in a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        along = points @ (points[-1] - points[0]) if len(points) else np.zeros(0)
        return points[[int(np.argmin(along)), int(np.argmax(along))]] if len(points) else points
