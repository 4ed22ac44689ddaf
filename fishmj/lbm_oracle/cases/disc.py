"""Thin discs and rectangular plates that start broadside in still water: the added mass of a sheet; and a disc in creeping flow.

    F = M dU/dt     disc of radius a: M = 8/3 rho a^3        plate of sides b <= c: M = C pi / 4 rho b^2 c, C = 0.579 (c = b),
                                                                                     0.757 (c = 2 b)
    F = 16 mu a U   disc without inertia, broadside

Added mass: a frictionless sheet in a periodic box of seven radii (plates: seven halves of the shorter side along it and across,
the length of the longer one more), 1e-5 m2/s on cells of 1 m and steps of 1 s, so that nothing but the lattice damps. The
acceleration grows within 4 a / c and then stays (c: a cell a step); F is the mean over 10 to 16 a / c, after which the sheet has
moved by 2e-5 a^2 cells / 2: the flow is a potential flow. Sound crosses the radius six times before; the images of the box add
0.2 % (the same potential problem in boxes of 8 and 12 radii).

The creeping disc is held without slip in a periodic box of eight radii that an acceleration drives. F over the mean velocity U
of the box is read when the shear of the start is gone, long before U is steady. Images raise it by 1 / (1 - 2.837 F0 / (6 pi mu
U0 L)) (Hasimoto 1959), F0 / U0 of the disc alone.

Sources: Lamb, Hydrodynamics, art. 102 and 339 (disc); DNV-RP-C205, table of rectangular plates, which a lattice of doublets meets
to 1e-4 (0.5791, 0.7569; studies/solver/NOTES.md). Hasimoto, J. Fluid Mech. 5:317.
"""

from math import cos, pi, radians, sin

import numpy as np

from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import FINS, PLAIN, SHARP, Markers, Sharpness
from fishmj.lbm_oracle.immersed.shapes import plate_markers

PLATES = {1: 0.579, 2: 0.757}  # C, by the ratio of the sides
STEP = 1e-6  # cells a step^2, the acceleration
RAMP, FIRST, LAST = 4, 10, 16  # a / c
BOX, OFF = 7, (0.3, 0.1, -0.2)  # radii; cells of the middle off the nodes
TREATMENTS = {"plain": PLAIN, "rims": Sharpness(rim=1.0), "sharp, edges": SHARP, "fins": FINS}
ROOM = {4: 0.15, 8: 0.10, 16: 0.06}  # by cells a radius; set before the treatment was chosen
LAMB, DNV = "Lamb, Hydrodynamics, art. 102", "DNV-RP-C205"


def disc_markers(radius: float, sharpness: Sharpness, slip: float = 1.0, angle: float = 0.0) -> Markers:
    """Markers of a disc of `radius` cells, its middle at the origin, on rings a cell apart, turned by `angle` rad about z."""
    last = radius - sharpness.insets(slip=slip)[1] - 0.5
    count = max(1, round(last))
    apart = last / count
    places, areas = [np.zeros((1, 2))], [np.full(1, pi * apart**2 / 4)]
    for ring in apart * np.arange(1, count + 1):
        n = max(4, 2 * round(pi * ring))
        turn = 2 * pi * (np.arange(n) + 0.5) / n
        places.append(ring * np.stack([np.cos(turn), np.sin(turn)], -1))
        areas.append(np.full(n, 2 * pi * ring * apart / n))
    s, z = np.concatenate(places).T
    normal = np.broadcast_to([sin(angle), cos(angle), 0.0], (len(s), 3))
    rest = np.stack([s * cos(angle), -s * sin(angle), z], -1)
    return Markers.rigid(rest, normal, np.concatenate(areas), sheet=True, sharpness=sharpness)


def sheet_in_water(markers: Markers, water: Fluid, *, off=OFF, slip: float, **options) -> FluidStructure:
    """The sheet in the middle of its water."""
    body = ImmersedBody.on_slides("xyz", 1.0, [1.0] * 3, 0.0, [0.0] * 3, 1.0)
    body.place(np.array(water.shape) / 2 + off)
    return FluidStructure(water, body, markers, slip=slip, **options)


def added_mass_of_sheet(
    half: int, device: str, *, ratio: int = 0, sharpness: Sharpness = FINS, tilt: float = 0.0, off=OFF, box: int = BOX, **options
) -> float:
    """Added mass over the exact one of a disc of `half` cells a radius, or of a plate of 2 half x 2 ratio half cells."""
    angle = radians(tilt)
    if ratio:
        markers = plate_markers(2 * half, 2 * ratio * half, angle, 1.0, sharpness)
    else:
        markers = disc_markers(half, sharpness, angle=angle)
    exact = PLATES[ratio] * pi * 2 * ratio * half**3 if ratio else 8 / 3 * half**3
    across, along = box * half, (box + 2 * (max(ratio, 1) - 1)) * half
    water = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-5), (across, across, along), device)
    driven, normal, speed = sheet_in_water(markers, water, off=off, slip=1.0, **options), markers.normal[0], 0.0
    for n in range(LAST * half):
        if n == FIRST * half:
            driven.take_wrench(1.0)
        speed += STEP * min(1.0, (n + 1) / (RAMP * half))
        driven.step(np.ones(3), speed * normal)
    _, wrench = driven.take_wrench((LAST - FIRST) * half)
    return float(-wrench[0, :3] @ normal / STEP / exact)


def creeping_drag(radius: int, device: str, *, sharpness: Sharpness = FINS, nu: float = 0.03, push: float = 1e-7) -> float:
    """Drag over 16 mu a U of a disc of `radius` cells that is held broadside in a creeping periodic stream."""
    size = 8 * radius
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=nu)
    water = Fluid(lattice, (size,) * 3, device, subgrid="none", body_acceleration=(0.0, push, 0.0))
    fixed = sheet_in_water(disc_markers(radius, sharpness, 0.0), water, slip=0.0)
    steps = round(size**2 / nu / 6)  # six times what the slowest shear takes to fall to a third
    for n in range(steps):
        if n == steps - 2:
            fixed.take_wrench(1.0)
        fixed.step(np.ones(3), np.zeros(3))
    raw, _ = fixed.take_wrench(2.0)
    free = 16 * nu * radius
    images = 1 - 2.837 * free / (6 * pi * nu * size)
    return float(raw[0, 1] / water.velocity()[..., 1].mean() * images / free)


@register("disc", rung=9.1, quick=True, grid="28^3 and 56^3, a = 4 and 8", source=f"{LAMB}; {DNV}", cost="20 s")
def disc_broadside(device):
    """A thin disc and thin plates that start broadside: their added mass."""
    for half in (4, 8):
        for name, sharpness in TREATMENTS.items():
            found, label = added_mass_of_sheet(half, device, sharpness=sharpness), f"disc, a = {half}, {name}: M over exact"
            yield about(label, found, 1.0, ROOM[half]) if sharpness == FINS else reported(label, found, 1.0)
    for ratio, half in ((1, 4), (2, 4), (1, 8)):
        found = added_mass_of_sheet(half, device, ratio=ratio)
        yield about(f"plate {ratio}:1, half side {half}: M over exact", found, 1.0, ROOM[half])
    for tilt in (20.0, 45.0):
        found = added_mass_of_sheet(4, device, tilt=tilt, off=(0.0, 0.5, 0.2))
        yield about(f"disc, a = 4, at {tilt:g} deg to the grid", found, 1.0, ROOM[4])


@register("disc_fine", rung=9.2, grid="to 224^3, a = 4 to 32", source=f"{LAMB}; {DNV}", cost="GPU, 15 G updates", gpu=True)
def disc_fine(device):
    """The same at more sizes, places and angles, for every treatment; and a creeping disc, whose drag is reported."""
    shapes = [("disc", half, 0) for half in (4, 8, 16, 32)] + [("plate", half, ratio) for half in (4, 8, 16) for ratio in PLATES]
    for kind, half, ratio in shapes:
        for name, sharpness in TREATMENTS.items():
            found = added_mass_of_sheet(half, device, ratio=ratio, sharpness=sharpness)
            label = f"{kind}{f' {ratio}:1' if ratio else ''}, half {half}, {name}: M over exact"
            yield about(label, found, 1.0, ROOM[min(half, 16)]) if sharpness == FINS else reported(label, found, 1.0)
    for half in (4, 8, 16):
        for tilt in (20.0, 45.0):
            found = added_mass_of_sheet(half, device, tilt=tilt, off=(0.0, 0.5, 0.2))
            yield about(f"disc, a = {half}, at {tilt:g} deg to the grid", found, 1.0, ROOM[half])
    for radius in (4, 8):
        for name in ("plain", "fins"):
            found = creeping_drag(radius, device, sharpness=TREATMENTS[name])
            yield reported(f"creeping disc, a = {radius}, {name}: F over 16 mu a U", found, 1.0)
