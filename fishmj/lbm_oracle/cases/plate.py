"""A thin rectangular plate held in a stream at Re = U c / nu = 100, aspect ratio 2, from 10 to 90 degrees.

    C_L = 2 F_y / (rho U^2 S),   C_D = 2 F_x / (rho U^2 S),   S = 2 c^2;   leading edge up for positive C_L

The plate is a sheet: one layer of markers, shortened at its four edges by the offset of the kernel, as a fish's tail and fins
are. It starts at once in a uniform stream; the force is the mean over t = 15 to 20 c / U, as that of the solver PetIBM.

To the water a sheet is as thick as the kernel: the error of its forces is of first order in the cell. Judged is the extrapolation
from 16 and 32 cells a chord, C = 2 C_32 - C_16; both are reported. The same holds for a plate edge-on in a strip one cell deep,
whose friction is known:

    C_D = 2 (1.328 Re^-1/2 + 2.67 Re^-7/8)        both sides, Stewartson 1969 and Messiter 1970 (triple deck)

Box 9 x 8 x 8 c, the middle of the plate 4 c behind the inflow; open in x and y, free slip above and below. The plate covers at
most 1/32 of the section.

Source: an oil tow tank, Taira, Dickson, Colonius, Dickinson and Rowley 2007, AIAA paper 2007-710, as digitised by PetIBM
(BSD 3-Clause, barbagroup), `examples/data/taira_et_al_2007_flatPlateRe100AR2_{Cd,Cl}vsAoA.dat`; read between its points by
straight lines. PetIBM's own plate, 25 cells a chord, is its example `flatplate3dRe100_GPU`.
"""

from typing import Any

import numpy as np

from fishmj.lbm_oracle import scene
from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.immersed.markers import PLAIN, Sharpness
from fishmj.lbm_oracle.scene import Scene

REYNOLDS, ASPECT, STREAM = 100.0, 2.0, 0.06  # stream in lattice units
BOX, AHEAD = (9.0, 8.0, 8.0), 4 / 9  # chords; share of the box before the plate
SETTLED, END = 15.0, 20.0  # c / U
# Taira et al. 2007: angle, deg: C_L, C_D
TOW_TANK = {
    10: (0.380, 0.405),
    20: (0.675, 0.505),
    25: (0.744, 0.580),
    30: (0.758, 0.639),
    35: (0.748, 0.728),
    40: (0.742, 0.814),
    50: (0.692, 0.996),
    60: (0.588, 1.145),
    90: (0.069, 1.527),
}
NEAR_STALL = (20, 25, 30, 35, 40)  # deg; round the greatest lift, which the tank has at 29
LIFT, DRAG = 0.08, 0.12  # tolerances of the limits from 10 to 60 deg, set before the first run at these sizes
FRICTION = 0.05  # edge-on, of the limit


def hold(
    cells: int, angle: float, device: str, *, box=BOX, end: float = END, settled: float = SETTLED, sharpness: Sharpness = PLAIN
) -> np.ndarray:
    """Mean (C_L, C_D) of a plate of `cells` cells a chord at `angle` deg, leading edge up, `settled` to `end` c / U."""
    options: dict[str, Any] = {"sides": "open", "sponge": max(8, cells // 2), "device": device}
    held = Scene(np.multiply(box, cells), 1.0, STREAM * cells / REYNOLDS, STREAM, rho=1.0, dt=1.0, **options)
    place = np.multiply(held.extent, [AHEAD, 0.5, 0.5]) + [0.7, 0.2, 0.1]  # off the nodes, as a fish is
    held.add(scene.plate(cells, ASPECT * cells, angle=angle, sharpness=sharpness), place)
    first, last = (round(times * cells / STREAM) for times in (settled, end))
    held.run(last)
    return held.coefficients()[first:, [1, 0]].mean(0)


def greatest(angles, lift) -> tuple[float, float]:
    """Angle and value of the greatest lift: the vertex of the parabola through the greatest value and its two neighbours."""
    i = int(np.clip(np.argmax(lift), 1, len(lift) - 2))
    a, b, c = np.polyfit(np.asarray(angles, float)[i - 1 : i + 2], np.asarray(lift)[i - 1 : i + 2], 2)
    return float(-b / (2 * a)), float(c - b * b / (4 * a))


def limit(coarse: int, one, fine: int, other):
    """Extrapolation of the values on two grids to a cell of zero, for an error of first order in the cell."""
    return (fine * np.asarray(other) - coarse * np.asarray(one)) / (fine - coarse)


def edge_on(cells: int, device: str, *, box=(8, 6), end: float = 8.0, sharpness: Sharpness = PLAIN) -> float:
    """C_D of a sheet of `cells` cells along the stream, in a strip one cell deep; mean over the last fifth of `end` c / U."""
    options: dict[str, Any] = {"sides": "open", "sponge": 8, "device": device}
    held = Scene(np.multiply(box, cells), 1.0, STREAM * cells / REYNOLDS, STREAM, rho=1.0, dt=1.0, **options)
    held.add(scene.plate(cells, sharpness=sharpness), np.multiply(held.extent, [0.4, 0.5]) + [0.7, 0.2])
    last = round(end * cells / STREAM)
    held.run(last)
    return held.drag_coefficient(last - round(0.8 * last))


def triple_deck(reynolds: float) -> float:
    """C_D of both sides of a flat plate edge-on, laminar, Re 1 to 1e5."""
    return 2 * (1.328 * reynolds**-0.5 + 2.67 * reynolds**-0.875)


SOURCE = "Taira et al. 2007, tow tank, as digitised by PetIBM"


@register("plate_coarse", rung=18, grid="128 x 96 x 1 and 256 x 192 x 1, c = 16 and 32", source="triple deck", cost="2 min")
def plate_coarse(device):
    """A plate edge-on at Re 100 in a strip: its friction on two grids, and where they lead to."""
    coarse, fine = edge_on(16, device), edge_on(32, device)
    yield about("C_D edge-on in the limit", limit(16, coarse, 32, fine), triple_deck(REYNOLDS), FRICTION)
    yield reported("C_D edge-on, c = 16", coarse, triple_deck(REYNOLDS))
    yield reported("C_D edge-on, c = 32", fine, triple_deck(REYNOLDS))


@register("plate", rung=18.1, grid="144 x 128 x 128 and 288 x 256 x 256, c = 16 and 32", source=SOURCE,
          cost="GPU, 1900 G updates", gpu=True)  # fmt: skip
def plate(device):
    """A held plate of aspect ratio 2 at Re 100, 10 to 90 degrees."""
    found = {}
    for angle, tank in TOW_TANK.items():
        coarse, fine = (hold(cells, angle, device) for cells in (16, 32))
        found[angle] = limit(16, coarse, 32, fine)
        for i, (name, room) in enumerate({"C_L": LIFT, "C_D": DRAG}.items()):
            label = f"{name} at {angle} deg"
            judged = about if angle <= 60 else lambda text, value, reference, _: reported(text, value, reference)
            yield judged(f"{label} in the limit", found[angle][i], tank[i], room)
            yield reported(f"{label}, c = 32; c = 16: {coarse[i]:.3f}", fine[i], tank[i])
    at, value = greatest(NEAR_STALL, [found[angle][0] for angle in NEAR_STALL])
    yield about("angle of the greatest C_L, deg", at, 28.5, 4.5, absolute=True)
    yield reported("greatest C_L", value, 0.762)


@register("plate_grid", rung=18.2, grid="216 x 192 x 192, c = 24", source=SOURCE, cost="GPU, 64 G updates", gpu=True)
def plate_grid(device):
    """The same plate at 30 degrees with 24 cells a chord: whether its error is of the first order."""
    for name, value, tank in zip(("C_L", "C_D"), hold(24, 30, device), TOW_TANK[30], strict=True):
        yield reported(f"{name} at 30 deg, c = 24", value, tank)
