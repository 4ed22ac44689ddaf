"""A self-propelled eel: rigid links whose joints follow a travelling wave, free in x, y and yaw, as heavy as the water.

    y(s, t) = 0.125 L (s / L + 0.03125) / 1.03125 sin 2 pi (s / L - t / T)            lateral displacement of the midline
    half width   sqrt(2 w s - s^2) to s = w = 0.04 L,  then falling to 0.01 L at 0.95 L,  then to 0
    half height  0.08 L sqrt(1 - ((s - 0.51 L) / 0.51 L)^2),                          nu = 1.4e-4 L^2 / T, no slip

Link i lies along the chord of the midline between s = i L / n and (i + 1) L / n; the joints are the differences of neighbouring
headings. The motion grows from nothing within the first beat. Speed is the displacement of the centre of mass over a beat.

A window of 3 x 1.2 x 0.75 L follows by whole cells; open in x and y, free slip above and below; no eddy viscosity.

Source of gait and body: Kern and Koumoutsakos 2006, J. Exp. Biol. 209:4841, the anguilliform reference swimmer, as other codes
state them. **Its speed was not found in the part of the paper that could be read** (summary and first page). Eels in experiments
swim 0.26 to 0.5 L / T, as the authors say of their own swimmers (www.cse-lab.ethz.ch/swimming). That band, the convergence and a
straight course are gated; the speed itself is reported.

A stiff eel is towed while it heaves (`towed_forces`), which shows the effect of the boundary alone on the forces.
"""

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.lbm_oracle.cases import Check, about, above, below, register, reported
from fishmj.lbm_oracle.cases.plate import limit
from fishmj.lbm_oracle.fluid.domain_faces import channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import EDGES, PLAIN, Sharpness, chain_markers
from fishmj.mjcf import passive_slot
from fishmj.mjcf.description import Link, Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.model import PLANAR_JOINTS

VISCOSITY, DENSITY = 1.4e-4, 1000.0  # L = 1 m, T = 1 s
BOX = (3.0, 1.2, 0.75)  # L
PER_CELL = 13  # steps a beat over cells a length: the tail's 0.79 L / T is then 0.06 in lattice units
LINKS, BEATS = 16, 8
AHEAD = 0.35  # share of the window before the centre of mass
BAND = (0.26, 0.5)  # L / T, eels in experiments
STEP = 0.10  # that the speed may change from 96 to 144 cells, set before the first run; from 64 to 192, half from 96, set later
TURN = 2.0  # deg of yaw a beat
TOWED, HEAVE = 0.4, 0.08  # L / T, L, of a stiff eel


class EelSwim(NamedTuple):
    """Record beat by beat, (B,): speed L / T, forwards positive; yaw deg at the end of each beat."""

    speed: np.ndarray
    yaw: np.ndarray


def half_width(s) -> np.ndarray:
    """Half-width of the body at s from the nose, L."""
    s = np.asarray(s, float)
    head, tail, wide, thin = 0.04, 0.95, 0.04, 0.01
    round_nose = np.sqrt(np.maximum(2 * wide * s - s**2, 0.0))
    return np.where(s < head, round_nose, np.interp(s, [head, tail, 1.0], [wide, thin, 0.0]))


def half_height(s) -> np.ndarray:
    """Half-height of the body at s from the nose, L."""
    return 0.08 * np.sqrt(np.maximum(1 - ((np.asarray(s, float) - 0.51) / 0.51) ** 2, 0.0))


def eel(links: int = LINKS, sections: int = 12) -> Robot:
    """Eel of `links` equal links, 1 m long, each as heavy as its water; `sections` for each link."""
    made = []
    for i in range(links):
        s = np.linspace(i, i + 1, sections + 1) / links
        height, width = 2 * np.maximum(half_height(s), 1e-4), 2 * np.maximum(half_width(s), 1e-4)
        fine = np.linspace(s[0], s[-1], 2001)
        area = pi / 4 * np.interp(fine, s, height) * np.interp(fine, s, width)
        mass = DENSITY * float(np.mean((area[1:] + area[:-1]) / 2)) / links
        rows = tuple((float(a - s[0]), float(h), float(w)) for a, h, w in zip(s, height, width, strict=True))
        made.append(Link(name=f"link{i}", length=1.0 / links, mass=mass, sections=rows))
    return Robot(name="eel", links=tuple(made), density_water=DENSITY)


def chain(robot: Robot, dt: float) -> ImmersedBody:
    """Body of the eel, free in x, y and yaw; a robot description allows at most twelve links, and has servos."""
    g, spec = geometry_of(robot), mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.gravity = [0, 0, 0]
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    parent = spec.worldbody
    for i, link in enumerate(robot.links):
        body = parent.add_body(name=link.name, pos=[g.joint[i - 1] if i else 0.0, 0, 0])
        body.mass, body.ipos, body.inertia, body.explicitinertial = g.mass[i], g.com[i], g.inertia[i], True
        for name, kind, axis in PLANAR_JOINTS if i == 0 else ((f"j{i}", mujoco.mjtJoint.mjJNT_HINGE, [0, 0, 1]),):
            body.add_joint(name=name, type=kind, axis=axis)
        parent = body
    return ImmersedBody(passive_slot.compiled(spec), DisplacedWater.of(robot), dt)


def joints(t, links: int = LINKS) -> np.ndarray:
    """Angles of the joints (.., links - 1) rad at times t in beats, full swing."""
    s = np.linspace(0, 1, 20 * links + 1)
    t = np.asarray(t, float)[..., None]
    across = 0.125 * (s + 0.03125) / 1.03125 * np.sin(2 * pi * (s - t))
    along = np.sqrt(np.maximum(np.diff(s) ** 2 - np.diff(across, axis=-1) ** 2, 0.0))  # the midline keeps its length
    back = np.concatenate([np.zeros((*along.shape[:-1], 1)), np.cumsum(along, -1)], -1)[..., ::20]
    heading = np.arctan2(-np.diff(across[..., ::20], axis=-1), np.diff(back, axis=-1))  # of each link, nose towards +x
    return np.diff(heading, axis=-1)


def growth(t) -> np.ndarray:
    """Share of the full swing at times t in beats: 0 to 1 within the first, smooth at both ends."""
    t = np.minimum(t, 1.0)
    return t - np.sin(2 * pi * t) / (2 * pi)


class Window:
    """An eel of `cells` cells a length at rest in its window, which follows the body's centre of mass by whole cells."""

    def __init__(self, cells: int, device: str, robot: Robot, box: tuple[float, float, float], sharpness: Sharpness):
        self.dx, self.steps = 1.0 / cells, PER_CELL * cells  # steps a beat
        corner = (0.0, 0.0, -box[2] / 2 + 0.1 * self.dx)  # the eel swims at z = 0, off the nodes
        lattice = Lattice(dx=self.dx, dt=1.0 / self.steps, rho=DENSITY, nu=VISCOSITY, corner=corner)
        faces = channel(sponge=max(8, cells // 10))
        shape = (round(box[0] * cells), round(box[1] * cells), round(box[2] * cells))
        self.water = Fluid(lattice, shape, device, subgrid="none", boundaries=faces)
        self.body = chain(robot, lattice.dt)
        home = np.array(shape[:2]) * [1 - AHEAD, 0.5] * self.dx
        self.body.place(np.concatenate([home + [0.2 * self.dx, -0.3 * self.dx], np.zeros(self.body.dofs - 2)]))
        markers = chain_markers(robot, self.dx, slip=0.0, sharpness=sharpness)
        self.held = FluidStructure(self.water, self.body, markers, slip=0.0)
        self.start = self.centre()

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self.water.lattice.dt

    def centre(self) -> np.ndarray:
        """Centre of mass, (2,) m."""
        return self.body.data.subtree_com[1][:2].copy()

    def step(self, fixed: np.ndarray, value: np.ndarray) -> None:
        """Does one step of water and body; value: velocities of the degrees of freedom that are `fixed`."""
        self.held.step(fixed, value)
        moved = (self.centre() - self.start) / self.dx - self.water.origin_lu[:2]
        by = np.where(np.abs(moved) >= 1.0, np.sign(moved), 0.0).astype(int)
        if by.any():
            with self.held.scope():
                self.water.shift((int(by[0]), int(by[1]), 0))


def swim(
    cells: int,
    device: str,
    *,
    links: int = LINKS,
    beats: int = BEATS,
    box=BOX,
    sharpness: Sharpness = PLAIN,
    progress: Callable[[int, float], None] | None = None,
) -> EelSwim:
    """Lets an eel of `cells` cells a length swim from rest; `progress` is called with every beat and its speed, L / T."""
    window = Window(cells, device, eel(links), box, sharpness)
    wave = joints((np.arange(window.steps + 1)) / window.steps, links)
    wave[-1] = wave[0]
    fixed = np.concatenate([np.zeros(3), np.ones(links - 1)])
    value = np.zeros(window.body.dofs)
    at, speed, yaw = window.centre(), [], []
    for beat in range(beats):
        grown = growth(beat + np.arange(window.steps + 1) / window.steps)[:, None] * wave
        for rate in np.diff(grown, axis=0) / window.dt:
            value[3:] = rate
            window.step(fixed, value)
        here = window.centre()
        gone, at = here - at, here
        speed.append(float(np.hypot(*gone) * np.sign(gone[0])))
        yaw.append(float(np.degrees(window.body.data.qpos[2])))
        if progress is not None:
            progress(beat + 1, speed[-1])
    return EelSwim(np.array(speed), np.array(yaw))


def in_phase(force: np.ndarray) -> tuple[float, float]:
    """Amplitudes in phase with acceleration and velocity of the force (N,) on a body at -cos 2 pi t / T, over one period."""
    turn = 2 * pi * (np.arange(len(force)) + 0.5) / len(force)
    return float(-2 * np.mean(force * np.cos(turn))), float(-2 * np.mean(force * np.sin(turn)))


def towed_forces(cells: int, device: str, *, sharpness: Sharpness = PLAIN, periods: int = 3) -> tuple[float, float, float]:
    """Mean axial force, N, and lateral force in phase with acceleration and velocity, N, of a stiff eel over the last period.

    It is towed nose first at 0.4 L / T while it heaves by 0.08 L.
    """
    window = Window(cells, device, eel(2), (2.0, 0.9, 0.6), sharpness)
    fixed, force = np.ones(window.body.dofs), []
    for k in range(periods * window.steps):
        t = (k + 1) * window.dt
        window.step(fixed, min(1.0, 2 * t) * np.array([TOWED, 2 * pi * HEAVE * np.sin(2 * pi * t), 0.0, 0.0]))
        force.append(window.held.take_wrench(window.dt)[0][:, :2].sum(0))
    axial, lateral = np.array(force)[-window.steps :].T
    return float(axial.mean()), *in_phase(lateral)


SOURCE = "gait of Kern and Koumoutsakos 2006; speeds of eels in experiments"


def table(cells: int, found: EelSwim):
    """Rows for the beats of one size, and the checks of each size alone."""
    for beat, speed in enumerate(found.speed, 1):
        yield reported(f"speed in beat {beat}, L/T, L = {cells}", speed)
    last, middle = found.speed[-1], sum(BAND) / 2
    yield about(f"speed in the last beat, L/T, L = {cells}", last, middle, BAND[1] - middle, absolute=True)
    yield below(f"yaw in the last beat, deg, L = {cells}", abs(found.yaw[-1] - found.yaw[-2]), TURN)


def change(coarse: int, one: EelSwim, fine: int, other: EelSwim, room: float) -> Check:
    """Check of the change of the speed between two sizes in the last beat."""
    return below(f"change of the speed from L = {coarse} to {fine}", abs(one.speed[-1] / other.speed[-1] - 1), room)


@register("eel_coarse", rung=21, grid="120 x 48 x 30, L = 40, six links, two beats", source=SOURCE, cost="2 min")
def eel_coarse(device):
    """A self-propelled eel of six links, 40 cells long: it swims nose first."""
    found = swim(40, device, links=6, beats=2)
    yield above("speed in the second beat, L/T, L = 40", found.speed[-1], 0.02)
    yield reported("yaw in the second beat, deg", found.yaw[-1] - found.yaw[-2])


@register("eel", rung=21.1, grid="192 x 77 x 48, 288 x 115 x 72 and 576 x 230 x 144, L = 64, 96 and 192", source=SOURCE,
          cost="GPU, 410 G updates", gpu=True)  # fmt: skip
def eel_swims(device):
    """A self-propelled eel of sixteen links, 64, 96 and 192 cells long; the radius of its tail's edges is below a cell."""
    found = {}
    for cells in (64, 96, 192):
        found[cells] = swim(cells, device, sharpness=EDGES)
        yield from table(cells, found[cells])
    yield change(64, found[64], 192, found[192], STEP)
    yield change(96, found[96], 192, found[192], STEP / 2)


@register("eel_fine", rung=21.2, grid="432 x 173 x 108 and 576 x 230 x 144, L = 144 and 192", source=SOURCE,
          cost="GPU, 500 G updates", gpu=True)  # fmt: skip
def eel_fine(device):
    """The same eel with the plain boundary, 144 and 192 cells long."""
    coarse, fine = swim(144, device), swim(192, device)
    yield from table(192, fine)
    yield change(144, coarse, 192, fine, STEP / 2)
    yield reported("speed in the limit of the two, L/T", float(limit(144, coarse.speed[-1], 192, fine.speed[-1])))


@register("eel_towed", rung=21.3, grid="96 x 43 x 29 to 384 x 173 x 115, L = 48 to 192", source="itself, more cells",
          cost="GPU, 62 G updates", gpu=True)  # fmt: skip
def eel_towed(device):
    """A stiff eel, towed while it heaves: the lateral force of few cells is that of many, the axial one is not."""
    found = {cells: towed_forces(cells, device, sharpness=EDGES) for cells in (48, 64, 96, 192)}
    for cells, forces in found.items():
        for name, force in zip(("mean axial force", "in phase with acceleration", "in phase with velocity"), forces, strict=True):
            yield reported(f"{name}, N, L = {cells}", force)
    for k, name in ((1, "acceleration"), (2, "velocity")):
        yield below(f"in phase with {name}, 64 against 192 cells", abs(found[64][k] / found[192][k] - 1), STEP)
