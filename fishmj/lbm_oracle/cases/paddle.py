"""A paddle of elliptic section that heaves across itself: the force of a tail that is too thin for its cells.

    y(t) = -A cos 2 pi t / T         C_a, C_v: its force in phase with acceleration and velocity, over rho U^2 H L / 2

Height H, length L = 2 H, blunt ends, thickness H / 4, A = H / 2, U = 2 pi A / T, Re = U H / nu = 500, no slip, second period.
A box of 4.5 x 5 x 3.5 H with free slip on all faces. The only reference is the same paddle with more cells. The radius at the
section's upper and lower edge, H / 32, is below a cell on every grid here, and the markers there decide where the water leaves
the edge. A second paddle, H / 2 thick (radius H / 8), has edges only.
"""

from math import pi

import numpy as np

from fishmj.lbm_oracle.cases import below, register, reported
from fishmj.lbm_oracle.cases.eel import chain, in_phase
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import EDGES, SHARP, Sharpness, chain_markers
from fishmj.mjcf.description import Link, Robot

RHO, LENGTH, REYNOLDS, SPEED = 1000.0, 2.0, 500.0, 0.05  # kg/m3, H, 1, cells a step; H = 1 m, T = 1 s
BOX, SWING = (4.5, 5.0, 3.5), 0.5  # H
SIZES = (6, 8, 12)  # cells a height


def paddle(ratio: float = 0.25) -> Robot:
    """Two links in a row, as heavy as their water; `ratio` of thickness and height."""
    s = np.linspace(0, LENGTH, 41)
    full = np.maximum(np.sqrt(np.maximum(1 - (2 * s / LENGTH - 1) ** 8, 0.0)), 1e-3)
    mass, half, links = RHO * pi / 4 * ratio * float(np.mean(full**2)) * LENGTH / 2, LENGTH / 2, []
    for front, part in ((0.0, s <= half), (half, s >= half)):
        rows = tuple((float(x - front), float(k), float(ratio * k)) for x, k in zip(s[part], full[part], strict=True))
        links.append(Link(name=f"half{len(links)}", length=half, mass=mass, sections=rows))
    return Robot(name="paddle", links=tuple(links), density_water=RHO)


def heave(cells: int, device: str, *, sharpness: Sharpness = EDGES, ratio: float = 0.25, periods: int = 2) -> tuple[float, float]:
    """C_a and C_v in the last period of a paddle that is `cells` cells high."""
    dx, steps = 1.0 / cells, 4 * round(2 * pi * SWING * cells / SPEED / 4)
    dt, fastest = 1.0 / steps, 2 * pi * SWING
    corner = (0.0, 0.0, -BOX[2] / 2 + 0.1 * dx)  # it heaves at z = 0, off the nodes
    lattice = Lattice(dx=dx, dt=dt, rho=RHO, nu=fastest / REYNOLDS, corner=corner)
    side = Axis("slip", "slip")
    x, y, z = (round(length * cells) for length in BOX)
    faces = Boundaries(x=side, y=side, z=side)
    water = Fluid(lattice, (x, y, z), device, subgrid="none", boundaries=faces)
    robot = paddle(ratio)
    body = chain(robot, dt)
    body.place(np.array([BOX[0] / 2 + 0.2 * dx, BOX[1] / 2 - 0.3 * dx, 0.0, 0.0]))
    held = FluidStructure(water, body, chain_markers(robot, dx, slip=0.0, sharpness=sharpness), slip=0.0)
    force = []
    for k in range(periods * steps):
        t = (k + 1) * dt
        speed = fastest * np.sin(2 * pi * t) * min(1.0, 4 * t)  # grown within a quarter of a period
        held.step(np.ones(4), np.array([0.0, speed, 0.0, 0.0]))
        force.append(held.take_wrench(dt)[0][:, 1].sum())
    unit = 0.5 * RHO * fastest**2 * LENGTH
    return in_phase(np.array(force)[-steps:] / unit)


@register("paddle", rung=6.6, grid="27 x 30 x 21, 36 x 40 x 28 and 54 x 60 x 42, H = 6, 8 and 12", source="itself, more cells",
          cost="30 s")  # fmt: skip
def paddle_heaves(device):
    """A thin paddle that heaves: with edges its force hardly depends on the grid."""
    runs = [("sharp", SHARP, 0.25), ("edges", EDGES, 0.25), ("edges, H / 2 thick", EDGES, 0.5)]
    found = {(name, cells): heave(cells, device, sharpness=edge, ratio=ratio) for cells in SIZES for name, edge, ratio in runs}
    for (name, cells), values in found.items():
        for quantity, value in zip(("C_a", "C_v"), values, strict=True):
            yield reported(f"{quantity}, H = {cells}, {name}", value)
    for name, *_ in runs[1:]:
        for k, (quantity, room) in enumerate((("C_a", 0.05), ("C_v", 0.1))):
            values = [found[name, cells][k] for cells in SIZES]
            yield below(f"{quantity} with {name}: greatest over least, less 1", max(values) / min(values) - 1, room)
