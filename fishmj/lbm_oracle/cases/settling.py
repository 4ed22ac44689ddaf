"""A sphere that sinks in a closed box of silicone oil, found together with its water as the fish is.

15 mm across, 1120 kg/m3, in 100 x 100 x 160 mm; four oils of 960 to 970 kg/m3, Reynolds number 1.4 to 30. The sphere is a MuJoCo
body on slides, 1.15 to 1.17 times as heavy as what it displaces; its weight and buoyancy are the model's gravity.

Source: ten Cate, Nieuwstad, Derksen and van den Akker 2002, Phys. Fluids 14:4012, table 2, as kept with oils, box and gap by the
benchmark SettlingSphereInBox of the solver waLBerla (read 2026-11-20), which starts a quarter of a diameter higher than the
120 mm stated, to match the measured tracks; so does this.

The time step keeps the viscosity small in lattice units: the markers' retraction was measured for that, and the layer of the
force is thinner where the water is thick (a sphere of six cells at Re 4 has 8 % less drag at 0.075 than at 0.02, 15 % at 0.15).
At 0.02 the thicker oils still sink 3 to 5 % too fast.
"""

from math import inf
from typing import NamedTuple

import numpy as np

from fishmj.lbm_oracle.ball import ball
from fishmj.lbm_oracle.boundaries import Axis, Boundaries
from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.coupling import Coupled
from fishmj.lbm_oracle.fluid import Fluid
from fishmj.lbm_oracle.markers import sphere_markers
from fishmj.lbm_oracle.units import Lattice
from fishmj.units import G

DIAMETER, DENSITY = 0.015, 1120.0  # m, kg/m3
BOX, GAP = (0.1, 0.1, 0.16), 0.12 + DIAMETER / 4  # m
FASTEST, THICKEST = 0.05, 0.01  # lattice units, speed and viscosity: the time step is the shorter of the two


class Oil(NamedTuple):
    """kg/m3, Pa s, and the greatest speed measured, m/s."""

    density: float
    viscosity: float
    speed: float


OILS = {
    "E1": Oil(970.0, 0.373, 0.035986),
    "E2": Oil(965.0, 0.212, 0.05718),
    "E3": Oil(962.0, 0.113, 0.087269),
    "E4": Oil(960.0, 0.058, 0.12224),
}


class Fall(NamedTuple):
    """Speed downwards m/s and gap below the sphere m at every step, (T,), and the time step, s."""

    speed: np.ndarray
    gap: np.ndarray
    dt: float


def fall(oil: Oil, cells: int, device: str, *, longest: float = inf, **options) -> Fall:
    """Let the sphere go, `cells` cells across, until its speed has passed its peak by 1 %, it nears the floor, or `longest` s."""
    dx, nu = DIAMETER / cells, oil.viscosity / oil.density
    dt = min(FASTEST * dx / oil.speed, THICKEST * dx**2 / nu)
    lattice = Lattice(dx=dx, dt=dt, rho=oil.density, nu=nu, corner=(dx / 2,) * 3)  # walls lie half a cell outside the nodes
    wall = Axis("wall", "wall")
    x, y, z = (round(side / dx) for side in BOX)
    water = Fluid(lattice, (x, y, z), device, subgrid="none", boundaries=Boundaries(x=wall, y=wall, z=wall))
    start = (BOX[0] / 2, BOX[1] / 2, GAP + DIAMETER / 2)
    body = ball(DIAMETER / 2, lattice, density=DENSITY / oil.density, at=start)
    body.model.opt.gravity[:] = 0.0, 0.0, -G
    body.place(start)  # the forces of this gravity
    free = Coupled(water, body, sphere_markers(DIAMETER / 2, dx, **options), slip=0.0)
    speed, gap, peak = [], [], 0.0
    while not gap or (gap[-1] > 3 * dx and speed[-1] > 0.99 * peak and len(gap) * dt < longest):
        speed.append(-free.step()[2])
        gap.append(float(body.data.qpos[2]) - DIAMETER / 2)
        peak = max(peak, speed[-1])
    return Fall(np.array(speed), np.array(gap), dt)


def checks(name: str, cells: int, device: str, room: float):
    """The checks of one oil."""
    oil = OILS[name]
    found = fall(oil, cells, device)
    top = int(np.argmax(found.speed))
    yield about(f"{name}: greatest speed, m/s, D = {cells}", found.speed[top], oil.speed, room)
    yield reported(f"{name}: at the time, s", top * found.dt)
    yield reported(f"{name}: gap over diameter there", found.gap[top] / DIAMETER)


SOURCE = "ten Cate et al. 2002, table 2, as kept by waLBerla"


@register("settling_coarse", rung=10, grid="67 x 67 x 107, D = 10, E4", source=SOURCE, cost="50 s")
def settling_coarse(device):
    """A sphere that sinks in the thinnest of four oils, ten cells across."""
    yield from checks("E4", 10, device, 0.04)


@register("settling_oils", rung=10.1, grid="67 x 67 x 107, D = 10, E1 to E3", source=SOURCE, cost="GPU, 44 G updates", gpu=True)
def settling_oils(device):
    """The same in the three thicker oils."""
    for name in ("E1", "E2", "E3"):
        yield from checks(name, 10, device, 0.04)


@register("settling", rung=10.2, grid="107 x 107 x 171, D = 16, E1 to E4", source=SOURCE, cost="GPU, 450 G updates", gpu=True)
def settling(device):
    """A sphere that sinks in four oils."""
    for name in OILS:
        yield from checks(name, 16, device, 0.025)
