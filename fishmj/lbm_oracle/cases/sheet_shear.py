"""A sheet at rest between two walls that slide past it: its effective thickness.

    F / area = rho nu U (1 / H1 + 1 / H2)          H1, H2: distances of the walls; an exact solution, u = U |y - y0| / H

The regularised force smears the kink of the profile over the kernel, so the no-slip point lies k cells in front of a plain sheet
(`immersed/markers.py`): k = U nu rho (1 / F1 - 1 / F), the thickness per side that explains the friction. A slip length of k
corrects the thickness.
"""

import numpy as np

from fishmj.lbm_oracle.cases import about, register, reported
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import KINK, PLAIN, Markers, Sharpness

WALL, NU = 0.02, 0.1  # lattice units
WIDE = 4  # cells along the sheet, periodic


def friction(cells: int, place: float, device: str, *, sharpness: Sharpness = PLAIN, width: int = 3) -> tuple[float, float]:
    """(F over the exact one, thickness k per side in cells) of a sheet amid `cells` cells, `place` cells off the nodes."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=NU)
    faces = Boundaries(y=Axis("moving", "moving"), wall_velocity_lu=(WALL, 0.0, 0.0))
    water = Fluid(lattice, (WIDE, cells, WIDE), device, subgrid="none", boundaries=faces)
    body = ImmersedBody.on_slides("xy", 1.0, [1.0] * 3, 0.0, [0.0] * 3, 1.0)
    at = cells // 2 + place
    body.place([0.3, at])
    x, z = (side.ravel() for side in np.meshgrid(np.arange(WIDE) - 0.1, np.arange(WIDE) + 0.2, indexing="ij"))
    normal = np.broadcast_to([0.0, 1.0, 0.0], (len(x), 3))
    markers = Markers.rigid(np.stack([x, 0 * x, z], -1), normal, 1.0, sheet=True, sharpness=sharpness)
    held = FluidStructure(water, body, markers, slip=0.0, width=width)
    steps = round(cells**2 / NU / 4)  # eight times what the slowest part of the start takes to fall to a third
    for n in range(steps):
        if n == steps - 20:
            held.take_wrench(1.0)
        held.step(np.ones(2), np.zeros(2))
    raw, _ = held.take_wrench(20.0)
    found = raw[0, 0] / WIDE**2 / (NU * WALL)
    low, high = at + 0.5, cells - 0.5 - at
    thick = np.roots([found, -found * (low + high) + 2.0, found * low * high - low - high])  # found = 1/(low - k) + 1/(high - k)
    return float(found / (1 / low + 1 / high)), float(thick.real[np.argmin(np.abs(thick))])


@register("sheet_shear", rung=6.5, quick=True, grid="4 x 12 x 4", source="u = U |y| / H")
def sheet_shear(device):
    """A sheet amid two sliding walls: plain it is as thick as the kernel, with a slip length it is thin."""
    for place in (0.0, 0.5):
        plain, thick = friction(12, place, device)
        sharp, _ = friction(12, place, device, sharpness=Sharpness(sheet_slip=KINK[3]))
        yield reported(f"friction of a plain sheet {place:g} cells off the nodes, over the exact", plain, 1.0)
        yield reported("its thickness per side, cells", thick, KINK[3])
        yield about(f"friction with a slip length of {KINK[3]:g} cells, {place:g} off the nodes", sharp, 1.0, 0.02)
