"""Kernels that set and read whole fields: undisturbed water, a given velocity, density; and the survey that the watch reads.

A survey is summed on the device and copied to the host while both continue.
"""

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.collide import density, momentum, reconstruct, relaxed
from fishmj.lbm_oracle.fluid.in_kernels import vec6, vec19, wrap
from fishmj.lbm_oracle.fluid.inflow import Inflow, background
from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.step import OPTIONS, Params, is_ghost, within
from fishmj.lbm_oracle.fluid.storage import UNIT, peek, peek3, poke, poke3, six

wp.set_module_options(OPTIONS)

PLANES = 8  # of x that a thread of an accelerator looks through at one z; one on the CPU, all of its row


@wp.func
def _store(f: wp.array(dtype=Any), q: vec19, s: Params, x: int, y: int, z: int):
    cells = s.nx * s.ny * s.nz
    here = (x * s.ny + y) * s.nz + z
    for i in range(wp.static(Q)):
        poke(f, i * cells + here, q[i])


@wp.kernel
def settle(s: Params, flow: Inflow, low: wp.vec3i, clock: wp.array(dtype=int), f: wp.array(dtype=Any), u: wp.array(dtype=Any)):
    """Sets equilibrium at density 1 with the background flow, in a box of world nodes that starts at `low`."""
    i, j, k = wp.tid()
    wx, wy, wz = low[0] + i, low[1] + j, low[2] + k
    x, y, z = wrap(wx, s.nx), wrap(wy, s.ny), wrap(wz, s.nz)
    v = background(flow, wp.vec3(float(wx), float(wy), float(wz)), clock[0])
    _store(f, reconstruct(0.0, v, v, vec6()), s, x, y, z)
    poke3(u, (x * s.ny + y) * s.nz + z, v)


@wp.kernel
def impose(s: Params, drho: wp.array3d(dtype=float), u: wp.array3d(dtype=wp.vec3), f: wp.array(dtype=Any)):
    """Sets a given field with its viscous stress, P = -2 rho c_s^2 tau S; derivatives are taken across the periodic box."""
    x, y, z = wp.tid()
    xm, xp = wrap(x - 1, s.nx), wrap(x + 1, s.nx)
    ym, yp = wrap(y - 1, s.ny), wrap(y + 1, s.ny)
    zm, zp = wrap(z - 1, s.nz), wrap(z + 1, s.nz)
    dx = 0.5 * (u[xp, y, z] - u[xm, y, z])
    dy = 0.5 * (u[x, yp, z] - u[x, ym, z])
    dz = 0.5 * (u[x, y, zp] - u[x, y, zm])
    tau = 0.5 + 3.0 * s.nu
    scale = -tau * (1.0 + drho[x, y, z]) / 3.0
    p = scale * vec6(2.0 * dx[0], 2.0 * dy[1], 2.0 * dz[2], dy[0] + dx[1], dz[0] + dx[2], dz[1] + dy[2])
    v = u[x, y, z]
    _store(f, reconstruct(drho[x, y, z], v, v, relaxed(p, 1.0 / tau, s.omega_bulk)), s, x, y, z)


@wp.func
def _loaded(f: wp.array(dtype=Any), s: Params, x: int, y: int, z: int):
    cells = s.nx * s.ny * s.nz
    here = (x * s.ny + y) * s.nz + z
    q = vec19()
    for i in range(wp.static(Q)):
        q[i] = peek(f, i * cells + here)
    return q


@wp.kernel
def weigh(s: Params, f: wp.array(dtype=Any), drho: wp.array3d(dtype=float)):
    """Computes density minus one at every memory node."""
    x, y, z = wp.tid()
    drho[x, y, z] = density(_loaded(f, s, x, y, z))


@wp.kernel
def derive(s: Params, f: wp.array(dtype=Any), u: wp.array(dtype=Any)):
    """Computes the velocity from the populations if the step does not store it: u + G, with the second half of the force."""
    x, y, z = wp.tid()
    q = _loaded(f, s, x, y, z)
    poke3(u, (x * s.ny + y) * s.nz + z, momentum(q) / (1.0 + density(q)))


@wp.kernel
def resolve(s: Params, f: wp.array(dtype=Any), u: wp.array(dtype=Any), out: wp.array3d(dtype=wp.vec3)):
    """Refines stored 16-bit velocities to the precision of the populations.

    Where both disagree by more than the rounding the stored value stays: the populations' velocity lacks half a force.
    """
    x, y, z = wp.tid()
    kept, q = peek3(u, (x * s.ny + y) * s.nz + z), _loaded(f, s, x, y, z)
    v = momentum(q) / (1.0 + density(q))
    off = wp.max(wp.max(wp.abs(v[0] - kept[0]), wp.abs(v[1] - kept[1])), wp.abs(v[2] - kept[2]))
    out[x, y, z] = wp.where(off <= wp.static(0.5001 * UNIT), v, kept)


@wp.kernel
def survey(
    s: Params,
    origin: wp.array(dtype=int),
    f: wp.array(dtype=Any),
    u: wp.array(dtype=Any),
    planes: int,
    depth: int,
    least: wp.array(dtype=float),
    greatest: wp.array(dtype=float),
    fastest: wp.array(dtype=float),
    mass: wp.array(dtype=wp.float64),
    lost: wp.array(dtype=int),
):
    """Reduces for each y: least and greatest drho, greatest speed squared, sum of drho, number of nodes that are not finite.

    Ghosts are skipped. One thread covers some planes of x and some nodes of z.
    """
    part, y, column = wp.tid()
    o = six(origin)
    low, high, fast, total, bad = float(0.0), float(0.0), float(0.0), wp.float64(0.0), int(0)  # noqa: UP018  variables to Warp
    for x in range(part * planes, wp.min((part + 1) * planes, s.nx)):
        for z in range(column * depth, (column + 1) * depth):
            if is_ghost(s, wp.vec3i(within(x - o[3], s.nx), within(y - o[4], s.ny), within(z - o[5], s.nz))):
                continue
            drho = density(_loaded(f, s, x, y, z))
            speed2 = wp.length_sq(peek3(u, (x * s.ny + y) * s.nz + z))
            if wp.isfinite(drho) and wp.isfinite(speed2):
                low, high, fast = wp.min(low, drho), wp.max(high, drho), wp.max(fast, speed2)
                total += wp.float64(drho)
            else:
                bad += 1
    wp.atomic_min(least, y, low)
    wp.atomic_max(greatest, y, high)
    wp.atomic_max(fastest, y, fast)
    wp.atomic_add(mass, y, total)
    if bad > 0:
        wp.atomic_add(lost, y, bad)


class Survey(NamedTuple):
    """Extremes and sums of one survey, in lattice units."""

    rho_min: float
    rho_max: float
    speed: float  # greatest |u|
    mass: float  # sum of rho - 1
    lost: int  # nodes that are not finite


class Surveyor:
    """Runs surveys of one box of water on one device. Results are kept by columns of y, so that few threads add to one number."""

    def __init__(self, shape: tuple[int, int, int], device):
        self.device = device
        self.planes, self.depth = (PLANES, 1) if device.is_cuda else (1, shape[2])  # as memory likes to be read
        self.dim = (-(-shape[0] // self.planes), shape[1], shape[2] // self.depth)
        kinds = (wp.float32, wp.float32, wp.float32, wp.float64, wp.int32)  # least, greatest drho, greatest u^2, sum, lost
        self.found = [wp.zeros(shape[1], dtype=kind, device=device) for kind in kinds]
        self.on_host = [wp.zeros(shape[1], dtype=kind, device="cpu", pinned=device.is_cuda) for kind in kinds]

    def start(self, params, origin: wp.array, f: wp.array, u: wp.array) -> None:
        """Queues one survey, and the copies of its results, on the present stream."""
        for column in self.found:
            column.zero_()
        wp.launch(survey, dim=self.dim, inputs=[params, origin, f, u, self.planes, self.depth, *self.found], device=self.device)
        for near, far in zip(self.on_host, self.found, strict=True):
            wp.copy(near, far)

    def result(self) -> Survey:
        """Survey that was started last; the device must have finished it."""
        low, high, fast, mass, lost = (column.numpy() for column in self.on_host)
        return Survey(1 + float(low.min()), 1 + float(high.max()), float(np.sqrt(fast.max())), float(mass.sum()), int(lost.sum()))
