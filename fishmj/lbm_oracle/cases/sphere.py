"""A sphere held in a stream, and one that is pushed through still water.

    drag         C_D = F / (rho U^2 pi D^2 / 8),   24 / Re (1 + 0.15 Re^0.687)        Schiller, Naumann 1933
    added mass   F = (1 + C_m) m_f a while the inside water moves along,  C_m = 1/2        Lamb, Hydrodynamics, art. 92

The added mass is read off a frictionless sphere (slip = 1), whose flow is a potential flow: nothing of Stokes' or Basset's is
to be taken off. The inside water adds m_f exactly; a free sphere is pushed with and without it.
"""

from math import pi

import numpy as np

from fishmj.flow import Flow
from fishmj.lbm_oracle.ball import ball
from fishmj.lbm_oracle.boundaries import Axis, Boundaries
from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.coupling import Coupled
from fishmj.lbm_oracle.fluid import Fluid
from fishmj.lbm_oracle.markers import sphere_markers
from fishmj.lbm_oracle.units import Lattice

STREAM = 0.05  # lattice units


def drag(reynolds: float, cells: int, device: str, *, box=(9, 7, 7), times: float = 4.0, slip: float = 0.0, **options) -> float:
    """Drag coefficient of a sphere of `cells` cells in a box of so many diameters, after `times` box lengths of flow."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=STREAM * cells / reynolds)
    shape = tuple(round(b * cells) for b in box)
    faces = Boundaries(x=Axis("open", "open"), y=Axis("slip", "slip"), z=Axis("slip", "slip"), sponge=8)
    water = Fluid(lattice, shape, device, subgrid="none", boundaries=faces, flow=Flow(speed=STREAM))
    where = np.array(shape) * [0.4, 0.5, 0.5] + [0.2, -0.3, -0.4]  # off the nodes, as a fish is
    markers = sphere_markers(cells / 2, 1.0, slip=slip, **options)
    held = Coupled(water, ball(cells / 2, lattice, at=where), markers, slip=slip)
    steps, tail = round(times * cells / STREAM), round(0.2 * times * cells / STREAM)
    for n in range(steps):
        if n == steps - tail:
            held.take_wrench(1.0)
        held.step(np.ones(3), np.zeros(3))
    raw, _ = held.take_wrench(tail)
    return raw[0, 0] / (STREAM**2 * pi * cells**2 / 8)


def added_mass(radius: float, cells: int, device: str, *, slip: float = 1.0, passes: int = 2, **options) -> float:
    """C_m of a frictionless sphere in a periodic box of `cells`, from a smooth start to a constant acceleration."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)
    water = Fluid(lattice, (cells,) * 3, device, subgrid="none")
    body = ball(radius, lattice, at=np.full(3, cells / 2) + [0.3, 0.1, -0.2])
    driven = Coupled(water, body, sphere_markers(radius, 1.0, slip=slip, **options), slip=slip, passes=passes)
    a, speed, ramp, first, last = 1e-4, 0.0, 20, 30, 90
    for n in range(last):
        if n == first:
            driven.take_wrench(1.0)
        speed += a * min(1.0, (n + 1) / ramp)
        driven.step(np.ones(3), [speed, 0.0, 0.0])
    raw, _ = driven.take_wrench(last - first)
    return -raw[0, 0] / (body.water.mass[0] * a) - 1


def virtual_mass(density: float, device: str, *, interior: bool = True, scheme: str = "implicit", steps: int = 100) -> float:
    """(F / a) / m_f - density of a free sphere under a constant push.

    Raises:
        SimDiverged: the coupling is unstable.
    """
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)
    water = Fluid(lattice, (32,) * 3, device, subgrid="none")
    body = ball(5.0, lattice, density=density, at=(16.3, 16.1, 15.8))
    free = Coupled(water, body, sphere_markers(5.0, 1.0), slip=0.0, passes=3, interior=interior, scheme=scheme)
    push, speed = 1e-4 * body.water.mass[0], []
    body.applied[0] = push
    for _ in range(steps):
        speed.append(free.step()[0])
    acceleration = np.polyfit(np.arange(steps // 2), speed[-(steps // 2) :], 1)[0]
    return push / acceleration / body.water.mass[0] - density


@register("sphere_drag", rung=7, quick=True, grid="72 x 56 x 56, D = 8", source="Schiller and Naumann 1933, formula")
def sphere_drag(device):
    """A held sphere at Re 20."""
    reynolds = 20.0
    yield about("C_D at Re 20, D = 8", drag(reynolds, 8, device), 24 / reynolds * (1 + 0.15 * reynolds**0.687), 0.08)


@register("sphere_reynolds", rung=7.1, grid="144 x 112 x 112, D = 16", source="Schiller and Naumann 1933, formula")
def sphere_reynolds(device):
    """A held sphere at Re 20 to 200."""
    for reynolds in (20.0, 50.0, 100.0, 200.0):
        exact = 24 / reynolds * (1 + 0.15 * reynolds**0.687)
        yield about(
            f"C_D at Re {reynolds:g}, D = 16", drag(reynolds, 16, device, times=8.0 if reynolds > 60 else 5.0), exact, 0.04
        )


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
