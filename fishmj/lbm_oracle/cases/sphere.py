"""A sphere held in a stream, and one that is pushed through still water.

    drag         C_D = F / (rho U^2 pi D^2 / 8) = 24 / Re (1 + 0.1935 Re^0.6305), Re 20 to 260    Clift, Grace, Weber 1978
    added mass   F = (1 + C_m) m_f a while the interior water moves along,  C_m = 1/2        Lamb, Hydrodynamics, art. 92

The drag of Schiller and Naumann 1933, 24 / Re (1 + 0.15 Re^0.687), covers Re 0 to 800 in one line within 5 % and is reported
beside it: at Re 200 it gives 0.806, where the fit of that range gives 0.775 and Roos and Willmarth measured 0.78 (1971, as noted
in the validation scripts of the solver CubismUP_3D). Clift's fit was read in the package fluids 1.3.1 and in PetIBM's examples.

    torque       M = 8 pi nu rho R^3 omega / (1 - (R / b)^3) of a slow turn inside a shell of radius b    Lamb, art. 334
    wake         C_D = 0.656, St = f D / U = 0.137 at Re 300                          Johnson, Patel 1999, J. Fluid Mech. 378:19

The added mass is measured on a frictionless sphere (slip = 1), whose flow is a potential flow without Stokes' or Basset's force.
The interior water adds m_f exactly; a free sphere is pushed with and without it.
"""

from dataclasses import replace
from math import cos, pi

import numpy as np

from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import FINS, sphere_markers
from fishmj.lbm_oracle.scene import Scene, sphere
from fishmj.water.flow import Flow

STREAM = 0.05  # lattice units
CLIFT = "Clift et al. 1978, formula"


def ball(radius: float, lattice: Lattice, *, density: float = 1.0, at=(0.0, 0.0, 0.0)) -> ImmersedBody:
    """A free, non-rotating sphere of `radius` m and `density` times the water's, at `at` m; no gravity."""
    mass = lattice.rho * 4 / 3 * pi * radius**3
    solid, water = ([0.4 * m * radius**2] * 3 for m in (density * mass, mass))
    body = ImmersedBody.on_slides("xyz", density * mass, solid, mass, water, lattice.dt)
    body.place(at)
    return body


def drag(
    reynolds: float,
    cells: int,
    device: str,
    *,
    box=(9, 7, 7),
    times: float = 4.0,
    slip: float = 0.0,
    towed: bool = False,
    sides: str = "slip",
    **options,
) -> float:
    """Drag coefficient of a sphere of `cells` cells in a box of so many diameters, mean over the last fifth of `times` D / U.

    Held in a stream; or towed through still water against it, in a window that follows by whole cells. `sides` are the faces of
    y and z; walls are at rest, so that only a towed sphere may have them.
    """
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=STREAM * cells / reynolds)
    shape = tuple(round(b * cells) for b in box)
    faces = Boundaries(x=Axis("open", "open"), y=Axis(sides, sides), z=Axis(sides, sides), sponge=8)
    flow = Flow() if towed else Flow(speed=STREAM)
    water = Fluid(lattice, shape, device, subgrid="none", boundaries=faces, flow=flow)
    where = np.array(shape) * [0.4, 0.5, 0.5] + [0.2, -0.3, -0.4]  # off the nodes, as a fish is
    markers = sphere_markers(cells / 2, 1.0, slip=slip, **options)
    held = FluidStructure(water, ball(cells / 2, lattice, at=where), markers, slip=slip)
    steps, tail = round(times * cells / STREAM), round(0.2 * times * cells / STREAM)
    for n in range(steps):
        if n == steps - tail:
            held.take_wrench(1.0)
        held.step(np.ones(3), [-STREAM if towed else 0.0, 0.0, 0.0])
        if towed and where[0] + water.origin_lu[0] - held.body.data.qpos[0] >= 1.0:
            with held.scope():
                water.shift((-1, 0, 0))
    raw, _ = held.take_wrench(tail)
    return raw[0, 0] / (STREAM**2 * pi * cells**2 / 8)


def added_mass(radius: float, cells: int, device: str, *, slip: float = 1.0, passes: int = 2, **options) -> float:
    """C_m of a frictionless sphere in a periodic box of `cells`, from a smooth start to a constant acceleration."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)
    water = Fluid(lattice, (cells,) * 3, device, subgrid="none")
    body = ball(radius, lattice, at=np.full(3, cells / 2) + [0.3, 0.1, -0.2])
    driven = FluidStructure(water, body, sphere_markers(radius, 1.0, slip=slip, **options), slip=slip, passes=passes)
    a, speed, ramp, first, last = 1e-4, 0.0, 20, 30, 90
    for n in range(last):
        if n == first:
            driven.take_wrench(1.0)
        speed += a * min(1.0, (n + 1) / ramp)
        driven.step(np.ones(3), [speed, 0.0, 0.0])
    raw, _ = driven.take_wrench(last - first)
    return -raw[0, 0] / (body.water.mass[0] * a) - 1


def virtual_mass(density: float, device: str, *, interior: bool = True, scheme: str = "implicit", steps: int = 100) -> float:
    """(F / a) / m_f - density of a free sphere under a constant push. Raises SimDiverged: the coupling is unstable."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)
    water = Fluid(lattice, (32,) * 3, device, subgrid="none")
    body = ball(5.0, lattice, density=density, at=(16.3, 16.1, 15.8))
    free = FluidStructure(water, body, sphere_markers(5.0, 1.0), slip=0.0, passes=3, interior=interior, scheme=scheme)
    push, speed = 1e-4 * body.water.mass[0], []
    body.applied[0] = push
    for _ in range(steps):
        speed.append(free.step()[0])
    acceleration = np.polyfit(np.arange(steps // 2), speed[-(steps // 2) :], 1)[0]
    return push / acceleration / body.water.mass[0] - density


def clift(reynolds: float) -> float:
    """C_D of a sphere at Re 20 to 260."""
    return 24 / reynolds * (1 + 0.1935 * reynolds**0.6305)


def schiller_naumann(reynolds: float) -> float:
    """C_D of a sphere at Re up to 800."""
    return 24 / reynolds * (1 + 0.15 * reynolds**0.687)


@register("sphere_drag", rung=7, quick=True, grid="72 x 56 x 56, D = 8", source=CLIFT)
def sphere_drag(device):
    """A held sphere at Re 20."""
    found = drag(20.0, 8, device)
    yield about("C_D at Re 20, D = 8", found, clift(20.0), 0.08)
    yield reported("C_D at Re 20 over Schiller and Naumann's", found / schiller_naumann(20.0), 1.0)


@register("sphere_reynolds", rung=7.1, grid="144 x 112 x 112, D = 16", source=CLIFT, cost="GPU, 25 G updates", gpu=True)
def sphere_reynolds(device):
    """A held sphere at Re 20 to 200."""
    for reynolds in (20.0, 50.0, 100.0, 200.0):
        found = drag(reynolds, 16, device, times=16.0 if reynolds > 60 else 5.0)
        yield about(f"C_D at Re {reynolds:g}, D = 16", found, clift(reynolds), 0.04)
        yield reported(f"C_D at Re {reynolds:g} over Schiller and Naumann's", found / schiller_naumann(reynolds), 1.0)


def torque(radius: float, half: int, device: str, *, nu: float = 0.1, spin: float = 1e-3) -> float:
    """Torque on a sphere of `radius` cells over the exact one; `spin`: omega R. In a cube of 2 `half` cells, b = half."""
    turn = spin / radius
    scene = Scene((2 * half,) * 3, 1.0, nu, rho=1.0, dt=1.0, sides="wall", device=device)
    scene.add(sphere(2 * radius), at=half + np.array([0.3, 0.1, -0.2]), joints=("hinge z",), motion=lambda t: (turn * t,))
    found = scene.run(1.2 * half**2 / (3 * nu), every=10).wrench[-5:, 0, 5]
    return abs(found.mean()) / (8 * pi * nu * radius**3 * turn) * (1 - (radius / half) ** 3)


@register("sphere_rotating", rung=7.15, grid="48^3, R = 8", source="Lamb, Hydrodynamics, art. 334", cost="30 s")
def sphere_rotating(device):
    """A sphere that turns slowly in water at rest: its torque."""
    yield about("torque over the exact one, R = 8", torque(8.0, 24, device), 1.0, 0.08)


def wake(cells: int, device: str, *, reynolds: float = 300.0, times: float = 100.0) -> tuple[float, float]:
    """C_D and St of a held sphere with boundary `fins`, over the last 40 % of `times` D / U, in a box of 13 x 9 x 9 D.

    The sphere goes aside by D / 5 and back in the first four D / U: undisturbed, its wake stays steady.
    """
    turn, size = cells / STREAM, float(cells)
    held = Scene((13 * size, 9 * size, 9 * size), 1.0, STREAM * size / reynolds, STREAM, rho=1.0, dt=1.0, device=device)
    body = replace(sphere(size), markers=lambda dx: sphere_markers(size / 2, dx, sharpness=FINS))
    aside = lambda t: (0.1 * size * (1 - cos(2 * pi * min(t / (4 * turn), 1.0))),)
    held.add(body, at=(4.5 * size, 4.5 * size, 4.5 * size), joints=("slide y",), motion=aside)
    held.run(times * turn, every=20)
    last = 0.4 * times * turn
    return held.drag_coefficient(last), held.strouhal(last)


@register("sphere_wake", rung=7.17, grid="260 x 180 x 180, D = 20", source="Johnson, Patel 1999, J. Fluid Mech. 378:19",
          cost="GPU, 1 min", gpu=True)  # fmt: skip
def sphere_wake(device):
    """A held sphere at Re 300, which sheds."""
    drag_coefficient, strouhal = wake(20, device)
    yield about("C_D at Re 300, D = 20", drag_coefficient, 0.656, 0.04)
    yield about("St at Re 300, D = 20", strouhal, 0.137, 0.08)


@register("sphere_towed", rung=7.2, grid="72 x 56 x 56, D = 8", source="Galileo", cost="1 min")
def sphere_towed(device):
    """A sphere at Re 50, towed through still water and held in a stream."""
    held, towed = (drag(50.0, 8, device, times=8.0, towed=choice) for choice in (False, True))
    yield about("C_D towed over C_D held", towed / held, 1.0, 0.03)


@register("added_mass", rung=9, quick=True, grid="64^3 and 48^3, R = 8 and 5", source="Lamb, Hydrodynamics, art. 92: 1/2")
def added_mass_of_a_sphere(device):
    """An accelerated sphere in water at rest."""
    yield about("C_m, R = 8, 3-point kernel", added_mass(8.0, 64, device), 0.5, 0.1)
    yield about("C_m, R = 5, 3-point kernel", added_mass(5.0, 48, device), 0.5, 0.15)
    with_inside, without = (virtual_mass(1.0, device, interior=choice) for choice in (True, False))
    yield about("inside water over m_f", without - with_inside, 1.0, 0.01)
    for density in (10.0, 0.5, 0.1):
        yield about(f"virtual mass at density {density:g} as at 1", virtual_mass(density, device), with_inside, 0.02)
    yield reported("virtual mass of a sphere without slip", with_inside)
