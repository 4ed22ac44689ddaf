"""Taylor-Green vortices in a periodic square: checks the viscosity, and that the error falls with dx^2.

u = -u0 cos kx sin ky e^(-2 nu k^2 t),   v = u0 sin kx cos ky e^(-2 nu k^2 t),   p = -rho u0^2 / 4 (cos 2kx + cos 2ky)
diffusive scaling: nu fixed in lattice units, u0 = 0.48 / N, so that dx^2 and Ma^2 fall together
"""

import numpy as np

from fishmj.lbm_oracle.cases import about, below, register
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice

SIZES = (16, 32, 64)
NU_LU = 0.15
DECAY = 1.0  # 2 nu k^2 t is twice this at the end: long enough for the sound of the start to die out


def decay(n: int, device: str) -> tuple[float, float]:
    """Relative L2 error of the velocity, and relative error of the viscosity, on n x n cells."""
    k, u0 = 2 * np.pi / n, 0.48 / n
    steps = round(DECAY / (NU_LU * k * k))
    x, y = np.meshgrid(np.arange(n) * k, np.arange(n) * k, indexing="ij")
    u = np.zeros((n, n, 1, 3))
    u[..., 0, 0], u[..., 0, 1] = -u0 * np.cos(x) * np.sin(y), u0 * np.sin(x) * np.cos(y)
    water = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=NU_LU), (n, n, 1), device, subgrid="none")
    water.impose(u, -(u0**2) / 4 * (np.cos(2 * x) + np.cos(2 * y))[..., None])
    water.run(steps)
    found, exponent = water.velocity(), 2 * NU_LU * k * k * steps
    exact = u * np.exp(-exponent)
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    nu = -np.log(np.linalg.norm(found) / np.linalg.norm(u)) / exponent
    return float(error), float(nu - 1)


@register("taylor_green", rung=1, quick=True, grid="16^2, 32^2, 64^2", source="Taylor and Green 1937: closed form")
def taylor_green(device):
    """Decay of a vortex array: order of convergence and viscosity."""
    errors, viscosity = zip(*(decay(n, device) for n in SIZES), strict=True)
    yield about("order of convergence", -np.polyfit(np.log(SIZES), np.log(errors), 1)[0], 2.0, 0.1, absolute=True)
    yield below(f"viscosity error, N = {SIZES[-1]}", abs(viscosity[-1]), 0.005)
