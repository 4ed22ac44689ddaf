"""The bodies of a scene as one MuJoCo model with markers: shapes with joints and motions, or a model of the user's own.

Bodies without joints hang on the first of them, which has one slide that is held: the coupled step needs a degree of freedom.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import mujoco
import numpy as np

from fishmj.base import console
from fishmj.lbm_oracle.fluid.guard import numbers
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.lbm_oracle.immersed.markers import Markers
from fishmj.lbm_oracle.immersed.shapes import SHOWN, BodyShape, link_surfaces, solid_moments, surface_markers
from fishmj.lbm_oracle.immersed.silhouettes import Surface, frontal_area, thinnest
from fishmj.mjcf import passive_slot

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


@dataclass(frozen=True)
class SceneBodies:
    """Bodies of a scene where they begin, one link each; a MuJoCo model has a link for each of its bodies.

    surfaces: of each link, in its frame; a shape without a surface has none. drives: degrees of freedom that follow a motion,
    with that motion. areas: (L,) m2, of the coefficients. front: m2, of the union of all silhouettes; NaN with a shape without a
    surface. size: m, the longest side of the greatest link's upright box. width: m, the thinnest that the stream sees.
    """

    body: ImmersedBody
    markers: Markers
    surfaces: list[list[Surface]]
    drives: list[tuple[slice, MotionFunction]]
    areas: np.ndarray = field(default_factory=lambda: np.zeros(0))
    front: float = np.nan
    size: float = 0.0
    width: float = 0.0

    @property
    def moves(self) -> bool:
        """Returns False if all bodies are held."""
        return sum(part.stop - part.start for part, motion in self.drives if motion is _at_rest) < self.body.dofs

    def placed(self, link: int) -> list[Surface]:
        """Surfaces of a link where they are now, world frame, m."""
        place, turn = self.body.data.xpos[link + 1], self.body.data.xmat[link + 1].reshape(3, 3)
        return [(vertices @ turn.T + place, faces) for vertices, faces in self.surfaces[link]]

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round all markers where they are now."""
        places = self.marker_places()
        return places.min(0), places.max(0)

    def marker_places(self) -> np.ndarray:
        """Markers (N, 3) m where they are now, world frame."""
        place, turn = self.body.data.xpos[1:], self.body.data.xmat[1:].reshape(-1, 3, 3)
        return place[self.markers.before] + np.einsum("nij,nj->ni", turn[self.markers.before], self.markers.rest)


def of_shapes(placed: Sequence[PlacedBody], gravity: np.ndarray, lattice: Lattice, flat: bool) -> SceneBodies:
    """Makes one MuJoCo body a shape; `placed` has the held ones first, as MuJoCo numbers their tree."""
    spec = mujoco.MjSpec()
    spec.option.integrator, spec.option.gravity = mujoco.mjtIntegrator.mjINT_EULER, gravity
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    depth, frame, origin = lattice.dx if flat else 1.0, None, np.zeros(3)
    for i, one in enumerate(placed):
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
    water = DisplacedWater(
        mass=np.array([one.shape.volume for one in placed]) * lattice.rho * depth,
        centre=np.array([one.shape.centre for one in placed]),
        inertia=np.array([one.shape.inertia for one in placed]) * lattice.rho * depth,
    )
    body = ImmersedBody(passive_slot.compiled(spec), water, lattice.dt)
    ends = np.cumsum(body.model.body_dofnum[1:])
    drives = [
        (slice(int(end - count), int(end)), one.motion or _at_rest)
        for one, end, count in zip(placed, ends, body.model.body_dofnum[1:], strict=True)
        if count and not one.density
    ]
    _begin(body, drives)
    markers = _joined([one.shape.markers(lattice.dx) for one in placed], range(len(placed)))
    surfaces = [[] if one.shape.surface is None else [one.shape.surface] for one in placed]
    made = SceneBodies(body, markers, surfaces, drives)
    return replace(
        made,
        areas=np.array([one.shape.area for one in placed]),
        front=frontal_area([one for link in range(len(placed)) for one in made.placed(link)]) if all(surfaces) else np.nan,
        size=max(one.shape.size for one in placed),
        width=min(one.shape.width or one.shape.size for one in placed),
    )


def of_model(model: mujoco.MjModel, motion: MotionFunction | None, lattice: Lattice) -> SceneBodies:
    """Makes markers and displaced water of a model's geoms; a model without joints is held.

    Raises ConfigError: a model that the coupled step does not compute, or without a surface; a part too thin for its markers.
    """
    found = link_surfaces(model)
    parts, links, masses = [], [], []
    for link, geoms in enumerate(found):
        moments = [solid_moments(vertices, faces) for _, vertices, faces in geoms]
        total = sum(volume for volume, _, _ in moments)
        middle = sum((volume * place for volume, place, _ in moments), np.zeros(3)) / (total or 1.0)
        inertia = np.zeros((3, 3))
        for volume, place, about in moments:
            arm = place - middle
            inertia += about + volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        masses.append((total, middle, inertia))
        parts += [surface_markers(name, vertices, faces, lattice.dx) for name, vertices, faces in geoms]
        links += [link] * len(geoms)
    volumes, centres, inertias = (np.array(column) for column in zip(*masses, strict=True))
    water = DisplacedWater(mass=lattice.rho * volumes, centre=centres, inertia=lattice.rho * inertias)
    held = model.nv == 0
    body = ImmersedBody(_held(model) if held else copy.copy(model), water, lattice.dt)
    drives: list[tuple[slice, MotionFunction]] = []
    if held or motion is not None:
        drives = [(slice(0, body.dofs), motion or _at_rest)]
    _begin(body, drives)
    if not held:
        _warn_of_overlaps(body, lattice.dx)
    made = SceneBodies(body, _joined(parts, links), [[geom[1:] for geom in geoms] for geoms in found], drives)
    world = [made.placed(link) for link in range(len(found))]
    return replace(
        made,
        areas=np.array([frontal_area(link) for link in world]),
        front=frontal_area([one for link in world for one in link]),
        size=max(float(np.ptp(np.concatenate([vertices for vertices, _ in link]), 0).max()) for link in world if link),
        width=min(thinnest(vertices) for link in world for vertices, _ in link),
    )


def _held(model: mujoco.MjModel) -> mujoco.MjModel:
    """Bodies of a model without joints, in their poses, on one slide that is to be held."""
    data, spec = mujoco.MjData(model), mujoco.MjSpec()
    mujoco.mj_kinematics(model, data)
    spec.option.integrator, spec.option.gravity = mujoco.mjtIntegrator.mjINT_EULER, np.zeros(3)
    back, turn = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(back, data.xquat[1])
    frame = None
    for i in range(1, model.nbody):
        place = data.xpos[i]
        if frame is None:
            link = frame = spec.worldbody.add_body(name=f"body {i}", pos=place, quat=data.xquat[i])
            link.add_joint(name="held", type=JOINTS["slide"], axis=[1.0, 0.0, 0.0])
        else:
            mujoco.mju_mulQuat(turn, back, data.xquat[i])
            arm = data.xmat[1].reshape(3, 3).T @ (place - data.xpos[1])
            link = frame.add_body(name=f"body {i}", pos=arm, quat=turn)
        link.mass, link.inertia, link.ipos, link.explicitinertial = 1.0, np.ones(3), np.zeros(3), True
    return passive_slot.compiled(spec)


def _warn_of_overlaps(body: ImmersedBody, dx: float) -> None:
    """Warns of shown geoms whose convex hulls overlap by more than a cell: their water is displaced twice."""
    model, data, found = body.model, body.data, []
    shown = [int(geom) for geom in np.flatnonzero((model.geom_group < SHOWN) & (model.geom_bodyid > 0))]
    for one, other in combinations(shown, 2):
        deep = -mujoco.mj_geomDistance(model, data, one, other, dx, None)
        if deep > dx:
            found.append((deep, *(model.geom(geom).name or str(geom) for geom in (one, other))))
    if found:
        deep, one, other = max(found)
        console.warn(
            f"scene: {len(found)} pairs of geoms overlap, {one!r} and {other!r} by {deep:.3g} m: where they do, their water is"
            " displaced twice, in the force on an accelerating body and in the weight of a free one. Let them touch only"
        )


def _begin(body: ImmersedBody, drives: Sequence[tuple[slice, MotionFunction]]) -> None:
    """Places the body where its motions begin."""
    qpos, qvel = body.data.qpos.copy(), np.zeros(body.dofs)
    for part, motion in drives:
        count = part.stop - part.start
        start, ahead = (position(motion, time, count) for time in (0.0, body.dt))
        qvel[part] = (ahead - start) / body.dt
        joints = [int(j) for j in np.unique(body.model.dof_jntid[part])]
        qpos[body.model.jnt_qposadr[joints]] = start
    body.place(qpos, qvel)


def _at_rest(time: float) -> tuple[float, ...]:
    return (0.0,)


def position(motion: MotionFunction, time: float, count: int) -> np.ndarray:
    """Positions (count,) of a motion. Raises ConfigError for others than `count` finite numbers."""
    return numbers(f"scene: motion at t = {time:.4g} s", np.atleast_1d(motion(time)), (count,))


def _joined(parts: Sequence[Markers], links: Sequence[int]) -> Markers:
    """Markers of several rigid links as one."""
    join = lambda name: np.concatenate([getattr(part, name) for part in parts])
    index = np.concatenate([np.full(len(part), link) for part, link in zip(parts, links, strict=True)])
    names = ("rest", "normal", "area", "pivot", "share", "sheet", "slip_length", "layer")
    plain: dict[str, Any] = {name: join(name) for name in names}
    return Markers(**plain, before=index, after=index)
