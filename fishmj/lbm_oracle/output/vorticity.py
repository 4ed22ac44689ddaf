"""Velocity and vertical vorticity at one height, read off the device as one plane.

omega_z = dv/dx - du/dy        central differences, one-sided at the faces; times 1 / dt from cells to 1/s
"""

import numpy as np
import warp as wp

from fishmj.errors import ConfigError
from fishmj.lbm_oracle.fluid.lattice import wrap
from fishmj.lbm_oracle.fluid.step import OPTIONS, Params
from fishmj.lbm_oracle.output.map_plots import outline
from fishmj.lbm_oracle.output.slices import Slice

wp.set_module_options(OPTIONS)


@wp.func
def _at(s: Params, u: wp.array3d(dtype=wp.vec3), origin: wp.vec3i, i: int, j: int, k: int, share: float):
    """Velocity of window node (i, j) between planes k and k + 1."""
    x, y = wrap(origin[0] + i, s.nx), wrap(origin[1] + j, s.ny)
    low = u[x, y, wrap(origin[2] + k, s.nz)]
    high = u[x, y, wrap(origin[2] + wp.min(k + 1, s.nz - 1), s.nz)]
    return (1.0 - share) * low + share * high


@wp.kernel
def cut(
    s: Params,
    u: wp.array3d(dtype=wp.vec3),
    origin: wp.vec3i,
    k: int,
    share: float,
    plane: wp.array2d(dtype=wp.vec3),
):
    """(u, v, omega_z) [lu] of every column of the window, low corner first."""
    i, j = wp.tid()
    w, e = wp.max(i - 1, 0), wp.min(i + 1, s.nx - 1)
    d, n = wp.max(j - 1, 0), wp.min(j + 1, s.ny - 1)
    here = _at(s, u, origin, i, j, k, share)
    dv = _at(s, u, origin, e, j, k, share)[1] - _at(s, u, origin, w, j, k, share)[1]
    du = _at(s, u, origin, i, n, k, share)[0] - _at(s, u, origin, i, d, k, share)[0]
    plane[i, j] = wp.vec3(here[0], here[1], dv / float(e - w) - du / float(n - d))


def plane_of(fluid, z: float | None = None) -> np.ndarray:
    """(nx, ny, 3) of u, v in m/s and omega_z in 1/s at height z [m], linear between planes of nodes; None: mid-depth.

    Raises:
        ConfigError: z lies outside the water.
    """
    lattice, (nx, ny, nz) = fluid.lattice, fluid.shape
    height = fluid.origin_lu[2] + (nz - 1) / 2 if z is None else lattice.to_lu((0.0, 0.0, z))[2]
    level = float(height - fluid.origin_lu[2])
    if not -1e-6 <= level <= nz - 1 + 1e-6:
        low, high = (lattice.to_si((0, 0, fluid.origin_lu[2] + k))[2] for k in (0, nz - 1))
        raise ConfigError(f"slice at z = {z} m lies outside the water; expected {low:.3f} to {high:.3f} m, or mid")
    k = int(np.clip(np.floor(level), 0, nz - 1))
    out = wp.empty((nx, ny), dtype=wp.vec3, device=fluid.device)
    inputs = [fluid.params, fluid.u, wp.vec3i(*map(int, fluid.origin_lu)), k, max(level - k, 0.0), out]
    wp.launch(cut, dim=(nx, ny), inputs=inputs, device=fluid.device)
    return out.numpy() * np.array([lattice.velocity, lattice.velocity, 1 / lattice.dt], np.float32)


def slice_of(run, z: float | None = None) -> Slice:
    """The water of a run as it is now at height z [m]; None: mid-depth."""
    coupled = run.coupled
    fluid = coupled.fluid
    with coupled.scope():
        plane = plane_of(fluid, z)
    low = fluid.lattice.to_si(fluid.origin_lu)
    x, y = (low[axis] + fluid.lattice.dx * np.arange(fluid.shape[axis]) for axis in range(2))
    at = low[2] + (fluid.shape[2] - 1) / 2 * fluid.lattice.dx if z is None else z
    return Slice(run.time, float(at), x, y, plane[..., 0], plane[..., 1], plane[..., 2], outline(run))
