"""Flow between two walls, driven by a uniform acceleration.

    u(y) = g y (H - y) / (2 nu),   u_max = g H^2 / (8 nu)

Halfway bounce-back is exact at tau = 1/2 + sqrt(3/16) for a collision with one rate (He, Zou, Luo, Dembo 1997, J. Stat. Phys.
87:115); elsewhere its wall sits beside the half cell by an amount that falls with dx^2.
"""

import numpy as np

from fishmj.lbm_oracle.cases import below, register
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice

NU_LU = (3 / 16) ** 0.5 / 3
U_MAX = 0.02  # lattice units


def profile_error(height: int, device: str, axis: int = 1) -> float:
    """Relative L2 error of the steady profile over `height` cells between walls normal to y (1) or z (2)."""
    wall = Axis("wall", "wall")
    shape, faces = ((1, height, 1), Boundaries(y=wall)) if axis == 1 else ((1, 1, height), Boundaries(z=wall))
    g = 8 * NU_LU * U_MAX / height**2
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=NU_LU)
    water = Fluid(lattice, shape, device, boundaries=faces, subgrid="none", body_acceleration=(g, 0.0, 0.0))
    water.run(round(9 * height**2 / (np.pi**2 * NU_LU)))  # nine times the slowest mode's time
    y = np.arange(height) + 0.5
    exact = g * y * (height - y) / (2 * NU_LU)
    return float(np.linalg.norm(water.velocity()[..., 0].ravel() - exact) / np.linalg.norm(exact))


@register("poiseuille", rung=2, quick=True, grid="16 and 32 cells across", source="Poiseuille: closed form")
def poiseuille(device):
    """Force-driven flow between bounce-back walls."""
    yield below("profile error, H = 16", profile_error(16, device), 2e-3)
    yield below("profile error, H = 32", profile_error(32, device), 1e-3)
    yield below("profile error, H = 32, walls below and above", profile_error(32, device, axis=2), 1e-3)
