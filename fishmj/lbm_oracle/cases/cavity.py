"""Square cavity with a sliding lid, Re 100, 400 and 1000, steady.

References: extremes of the centreline velocities. Re 100: Marchi, Suero, Araki 2009, J. Braz. Soc. Mech. Sci. Eng. 31:186;
Re 1000: Botella and Peyret 1998, Comput. Fluids 27:421 (spectral); Re 400: Ghia, Ghia, Shin 1982, J. Comput. Phys. 48:387, whose
values at Re 100 and 1000 lie 1 to 3 % below the other two.
"""

import numpy as np

from fishmj.lbm_oracle.cases import about, register
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice

LID = 0.1  # lattice units
EXTREMES = {  # Re: (least u at x = 1/2, greatest v at y = 1/2, least v at y = 1/2)
    100: (-0.2140417, 0.1795728, -0.2538030),
    400: (-0.32726, None, None),
    1000: (-0.3885698, 0.3769447, -0.5270771),
}


def centrelines(reynolds: int, n: int, device: str) -> tuple[float, float, float]:
    """Extremes of u on the vertical and of v on the horizontal centreline, in units of the lid's speed."""
    wall = Axis("wall", "wall")
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=LID * n / reynolds)
    water = Fluid(
        lattice,
        (n, n, 1),
        device,
        boundaries=Boundaries(x=wall, y=Axis("wall", "moving"), wall_velocity_lu=(LID, 0.0, 0.0)),
        subgrid="none",
    )
    before, turn = np.zeros((n, n, 2)), round(n / LID)
    for _ in range(200):
        water.run(turn)
        now = water.velocity()[:, :, 0, :2] / LID
        if np.max(np.abs(now - before)) < 2e-5:
            break
        before = now
    middle = slice(n // 2 - 1, n // 2 + 1)  # n is even: the centreline lies between two columns
    u, v = now[middle, :, 0].mean(0), now[:, middle, 1].mean(1)
    return extreme(u, np.argmin(u)), extreme(v, np.argmax(v)), extreme(v, np.argmin(v))


def extreme(values, at) -> float:
    """Vertex of the parabola through the extreme value and its neighbours."""
    a, b, c = values[at - 1 : at + 2]
    return float(b - (a - c) ** 2 / (8 * (a - 2 * b + c)))


@register("cavity", rung=3, grid="64^2 (Re 100), 96^2 (Re 400), 128^2 (Re 1000)", source="Marchi 2009, Ghia 1982, Botella 1998")
def cavity(device):
    """Steady flow in a lid-driven cavity."""
    for reynolds, n, tolerance in ((100, 64, 0.01), (400, 96, 0.02), (1000, 128, 0.02)):
        names = ("least u", "greatest v", "least v")
        for name, found, reference in zip(names, centrelines(reynolds, n, device), EXTREMES[reynolds], strict=True):
            if reference is not None:
                yield about(f"{name}, Re {reynolds}", found, reference, tolerance)
