"""Boundary `wall_stress` on flat sheets: channels whose two walls are the sides of one sheet, and a plate in a stream.

    laminar      u = g y (2 h - y) / (2 nu) + g H^2 / (2 nu)                         the law takes the profile as straight up to H
    turbulent    U_b / u_tau = (ln Re_tau - 1) / 0.41 + 5.2                          the logarithmic law over a half height
    plate        C_F = 0.074 Re^-1/5;   0.242 / sqrt(C_F) = log10(Re C_F)            1/7-power law; Schoenherr 1932

A turbulent channel keeps its bulk velocity: in each step the sheet gets the velocity of the water, known from its momentum, less
U_b. A push g near the expected stress keeps that velocity small; a given push alone would give u_tau by itself. All sizes are in
cells.
"""

from dataclasses import replace
from math import log, log10, pi, sqrt

import numpy as np

from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import WALL_STRESS, Markers
from fishmj.lbm_oracle.immersed.wall_law import STANDOFF
from fishmj.water.flow import Flow

BULK, STREAM = 0.06, 0.06  # lattice units
KAPPA, CONSTANT = 0.41, 5.2  # of the logarithmic law
TURNOVERS = 30.0  # h / u_tau, the second half counts
ROOM, PLATE, CHANGE = 0.08, 0.1, 0.05  # of channels; of a plate's drag, and of its change when the cell is halved
BESIDE = (0.3, 0.25, 0.2)  # of a node, where the first marker is: off the nodes, as a fish is


def flat_markers(long: int, deep: int, height: float = STANDOFF) -> Markers:
    """Markers a cell apart on a sheet of `long` by `deep` cells of 1 m, with the law at `height` cells."""
    x, z = (side.ravel() for side in np.meshgrid(np.arange(long), np.arange(deep), indexing="ij"))
    normal = np.broadcast_to([0.0, 1.0, 0.0], (len(x), 3))
    law = replace(WALL_STRESS, law_height=height)
    return Markers.rigid(np.stack([x, 0 * x, z], -1), normal, 1.0, sheet=True, sharpness=law)


def channel(
    half: int, nu: float, push: float, device: str, *, long: int = 4, deep: int = 4, subgrid: str = "none"
) -> FluidStructure:
    """A sheet across a periodic box of twice `half` cells under a uniform `push`, on a slide along x."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=nu)
    water = Fluid(lattice, (long, 2 * half, deep), device, subgrid=subgrid, body_acceleration=(push, 0.0, 0.0))
    body = ImmersedBody.on_slides("xyz", 1.0, [1.0] * 3, 0.0, [0.0] * 3, 1.0)
    body.place(np.array([0, half, 0]) + BESIDE)
    return FluidStructure(water, body, flat_markers(long, deep))


def laminar(half: int, device: str, *, nu: float = 0.2, fastest: float = 0.03) -> tuple[float, float]:
    """Mean of (u - Poiseuille's) over the greatest velocity beyond H, and the greatest distance from that mean, over the same."""
    push = 2 * nu * fastest / half**2
    held = channel(half, nu, push, device)
    for _ in range(round(7 * (2 * half / pi) ** 2 / nu)):
        held.step(np.ones(3), np.zeros(3))
    y = (np.arange(2 * half) - half - BESIDE[1]) % (2 * half)
    more = held.fluid.velocity()[..., 0].mean((0, 2)) - push * y * (2 * half - y) / (2 * nu)
    more = more[np.minimum(y, 2 * half - y) > STANDOFF] / fastest
    return float(more.mean()), float(np.abs(more - more.mean()).max())


def bulk_of(reynolds: float) -> float:
    """U_b / u_tau of a channel at Re_tau by the logarithmic law."""
    return (log(reynolds) - 1) / KAPPA + CONSTANT


def turbulent(
    reynolds: float, half: int, device: str, *, turnovers: float = TURNOVERS, seed: int = 0
) -> tuple[float, np.ndarray]:
    """u_tau over that of the logarithmic law, and the mean profile u / u_tau at cells from the wall (2 half,), of a channel.

    The box is 2 pi h long and pi h deep. The start is the bulk velocity with waves of a fifth of it.
    """
    long, deep, friction = round(2 * pi * half), round(pi * half), BULK / bulk_of(reynolds)
    push = friction**2 / half
    held = channel(half, friction * half / reynolds, push, device, long=long, deep=deep, subgrid="wale")
    held.fluid.impose(BULK * stirred((long, 2 * half, deep), np.random.default_rng(seed)))
    area, moves, stress, rows = 2 * long * deep, BULK, [], []  # moves: mean velocity of the water, from its momentum
    for n in range(steps := round(turnovers * half / friction)):
        held.step(np.ones(3), [moves - BULK, 0.0, 0.0])
        stress.append(held.take_wrench(1.0)[0][0, 0] / area)
        moves += push - stress[-1] / half
        if n >= steps // 2 and n % 50 == 0:
            rows.append(held.fluid.velocity()[..., 0].mean((0, 2)) - held.body.data.qvel[0])
    found = sqrt(np.mean(stress[steps // 2 :]))
    return found / friction, np.roll(np.mean(rows, 0), -half) / found


def over_law(reynolds: float, half: int, profile: np.ndarray) -> np.ndarray:
    """Mean velocities over the logarithmic law's at y+ 100 to 1000; `reynolds` is that of the u_tau in `profile`."""
    y = (np.arange(2 * half) - BESIDE[1]) % (2 * half)
    plus = np.minimum(y, 2 * half - y) / half * reynolds
    inside = (plus >= 100) & (plus <= 1000)
    return profile[inside] / (np.log(plus[inside]) / KAPPA + CONSTANT)


def stirred(shape: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    """Unit stream along x with divergence-free waves of a fifth of it, (nx, ny, nz, 3)."""
    u, x = np.zeros((*shape, 3)), np.stack(np.meshgrid(*(np.arange(n) / n for n in shape), indexing="ij"), -1)
    for _ in range(24):
        wave = rng.integers(1, 4, 3) * rng.choice([-1, 1], 3)
        k = 2 * pi * wave / np.array(shape)
        side = np.cross(k, rng.normal(size=3))
        u += np.sin(2 * pi * (x @ wave) + rng.uniform(0, 2 * pi))[..., None] * side / np.linalg.norm(side)
    u *= 0.2 / np.sqrt((u * u).mean(axis=(0, 1, 2)).max())
    u[..., 0] += 1.0
    return u


def plate_drag(reynolds: float, cells: int, height: float, device: str, *, deep: int = 16, end: float = 3.0) -> float:
    """C_F of both sides of a plate of `cells` cells at Re = U L / nu, with the law at `height` cells.

    It is the mean over the last third of `end` L / U, in a box `deep` cells deep.
    """
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=STREAM * cells / reynolds)
    faces = Boundaries(x=Axis("open", "open"), y=Axis("open", "open"), sponge=8)
    shape = (round(2.2 * cells), round(0.6 * cells), deep)
    water = Fluid(lattice, shape, device, boundaries=faces, flow=Flow(speed=STREAM))
    body = ImmersedBody.on_slides("xyz", 1.0, [1.0] * 3, 0.0, [0.0] * 3, 1.0)
    body.place(np.array([round(0.5 * cells), shape[1] // 2, 0]) + BESIDE)
    held = FluidStructure(water, body, flat_markers(cells, deep, height))
    last = round(end * cells / STREAM)
    for n in range(last):
        if n == round(last * 2 / 3):
            held.take_wrench(1.0)
        held.step(np.ones(3), np.zeros(3))
    raw, _ = held.take_wrench(last - round(last * 2 / 3))
    return float(raw[0, 0] / (0.5 * STREAM**2 * 2 * cells * deep))


def schoenherr(reynolds: float) -> float:
    """C_F of a smooth turbulent plate, by iteration."""
    found = 0.074 * reynolds**-0.2
    for _ in range(50):
        found = (0.242 / log10(reynolds * found)) ** 2
    return found


@register("wall_stress", rung=2.5, quick=True, grid="4 x 20 x 4", source="Poiseuille: closed form", cost="3 s")
def wall_stress(device):
    """A laminar channel whose walls are markers with a law for their stress."""
    offset, bent = laminar(10, device)
    yield about("faster than Poiseuille's, over u_max; (H / h)^2", offset, (STANDOFF / 10) ** 2, 0.005, absolute=True)
    yield about("distance of the profile from its shape, over u_max", bent, 0.0, 0.005, absolute=True)


@register("wall_stress_channel", rung=23, grid="63 x 20 x 31 and 126 x 40 x 63", source="logarithmic law, 0.41 and 5.2",
          cost="GPU, 10 min", gpu=True)  # fmt: skip
def wall_stress_channel(device):
    """Turbulent channels with 10 and 20 cells a half height at a given bulk velocity."""
    for reynolds in (640.0, 2003.0):
        for half in (10, 20):
            ratio, profile = turbulent(reynolds, half, device)
            name = f"Re_tau {reynolds:g}, {half} cells:"
            off = over_law(reynolds * ratio, half, profile)
            yield about(f"{name} u_tau over that of the law", ratio, 1.0, ROOM)
            for which, value in (("least", off.min()), ("greatest", off.max())):
                yield about(f"{name} {which} u over that of the law, y+ 100 to 1000", value, 1.0, ROOM)


@register("wall_stress_plate", rung=23.1, grid="352 x 96 x 16 and 704 x 192 x 16", source="Schoenherr 1932; 0.074 Re^-1/5",
          cost="GPU, 10 min", gpu=True)  # fmt: skip
def wall_stress_plate(device):
    """A plate along a stream at Re 5e4 to 5e5, on two grids with the law at the same place."""
    for reynolds in (5e4, 1e5, 5e5):
        found = [plate_drag(reynolds, cells, STANDOFF * cells / 160, device) for cells in (160, 320)]
        for cells, drag in zip((160, 320), found, strict=True):
            yield about(f"C_F at Re {reynolds:g}, {cells} cells", drag, schoenherr(reynolds), PLATE)
            yield reported("over 0.074 Re^-1/5", drag / (0.074 * reynolds**-0.2), 1.0)
        yield about(f"change at Re {reynolds:g} when the cell is halved", found[1] / found[0] - 1, 0.0, CHANGE, absolute=True)
