"""Wall stress of a hull from the water a height H off it: the law of Werner and Wengle (1991), or Blasius' layer.

    P   = X + H n,   u_t = (I - n n^T) (u_P - v_wall),   U = |u_t|               velocity at P: trilinear between nodes
    tau = rho max(nu U / H, ((U / 8.3) (nu / H)^(1/7))^(7/4))                    turbulent hull
    tau = rho max(nu U / H, 0.332 U (nu U / x)^(1/2))                            laminar hull, x along it from the nose
    s   = 1 - min(tau dt / (rho dx |u*_t - v_wall|), 1)                          slip ratio of the marker in this step

The two terms of the first law meet at y+ = 8.3^(7/6) = 11.81: on fine cells it is the viscous stress. H is `STANDOFF` cells,
where the marker's own force does not reach, or the markers' `law_height` if that is longer. A sheet has two such points and the
sum of both stresses.

s is frozen within a step, so that the force stays affine in the velocity of the body. The first pass of the forcing sets the
tangential force, and later passes correct the normal one alone: the force along the wall is tau times the area, whatever
other markers share its cells.
"""

from typing import Any

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.storage import STORAGE, point3
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays, first_cell, pulled_moments, weight
from fishmj.lbm_oracle.immersed.markers import Markers

wp.set_module_options({"enable_backward": False, "max_unroll": Q})

STANDOFF = 3.0  # cells
NODES = wp.constant(8)  # round a point
FACTOR, POWER, BLASIUS = wp.constant(8.3), wp.constant(1.0 / 7.0), wp.constant(0.332)


@wp.struct
class WallLaw:
    """Constants of the law on one grid; arrays have one entry a marker."""

    height: float  # H, cells; 0: no law
    nu: float  # lattice units
    sides: wp.array(dtype=int)  # 2 for sheets
    from_nose: wp.array(dtype=float)  # x, cells, of a laminar hull; 0: turbulent


def law_of(markers: Markers, dx: float, nu: float, device) -> WallLaw:
    """Law for the markers on cells of `dx` m, with the viscosity `nu` in lattice units; without `law_height` an empty one."""
    made, off = WallLaw(), markers.law_height is None
    made.height, made.nu = 0.0 if off else max(STANDOFF, markers.law_height / dx), nu
    count = 0 if off else len(markers)
    nose = np.zeros(len(markers)) if markers.from_nose is None else markers.from_nose / dx
    made.sides = wp.array((1 + markers.sheet[:count]).astype(np.int32), dtype=wp.int32, device=device)
    made.from_nose = wp.array(nose[:count].astype(np.float32), dtype=wp.float32, device=device)
    return made


@wp.func
def wall_stress(speed: float, height: float, nu: float, from_nose: float) -> float:
    """Stress over density of water that passes at `speed` a height off the wall; `from_nose` > 0: of a laminar layer."""
    viscous = nu * speed / height
    if from_nose > 0.0:
        return wp.max(viscous, BLASIUS * speed * wp.sqrt(nu * speed / from_nose))
    return wp.max(viscous, wp.pow(speed / FACTOR * wp.pow(nu / height, POWER), 1.75))


@wp.func
def probe(
    f: wp.array(dtype=Any),
    body_acceleration: wp.vec3,
    x: wp.vec3d,
    normal: wp.vec3,
    height: float,
    o: int,
    shape: wp.vec3i,
):
    """Share of node o % 8 in the velocity at X + H n for o < 8, else at X - H n; x is in cells of the world."""
    h = wp.float64(wp.where(o < NODES, height, -height))
    p = x + h * wp.vec3d(wp.float64(normal[0]), wp.float64(normal[1]), wp.float64(normal[2]))
    low = wp.vec3i(int(wp.floor(p[0])), int(wp.floor(p[1])), int(wp.floor(p[2])))
    part = wp.vec3(float(p[0] - wp.float64(low[0])), float(p[1] - wp.float64(low[1])), float(p[2] - wp.float64(low[2])))
    i, j, k = (o // 4) % 2, (o // 2) % 2, o % 2
    share = wp.abs(float(1 - i) - part[0]) * wp.abs(float(1 - j) - part[1]) * wp.abs(float(1 - k) - part[2])
    rho, m = pulled_moments(f, low[0] + i, low[1] + j, low[2] + k, shape)
    return share * (m / rho + body_acceleration)


@wp.func
def along_wall(u: wp.vec3, normal: wp.vec3) -> float:
    """Speed of u along the wall."""
    return wp.length(u - wp.dot(u, normal) * normal)


@wp.func
def law_slip(law: WallLaw, k: int, normal: wp.vec3, u: wp.vec3, outer: wp.vec3, inner: wp.vec3) -> float:
    """Slip ratio of marker k; velocities relative to the wall: at the marker, at X + H n and at X - H n."""
    stress = wall_stress(along_wall(outer, normal), law.height, law.nu, law.from_nose[k])
    if law.sides[k] == 2:
        stress += wall_stress(along_wall(inner, normal), law.height, law.nu, law.from_nose[k])
    return 1.0 - wp.min(stress / wp.max(along_wall(u, normal), 1.0e-30), 1.0)


@wp.func
def wall_velocity(host: wp.array(dtype=wp.float64), at: CouplingArrays, jacobian: wp.array2d(dtype=wp.vec3), k: int):
    """Velocity of marker k at the start of the step, cells a step."""
    v = wp.vec3(0.0, 0.0, 0.0)
    for d in range(at.dofs):
        v += float(host[at.before + d]) * jacobian[k, d]
    return v


@wp.kernel
def probe_water(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    law: WallLaw,
    f: wp.array(dtype=Any),
    body_acceleration: wp.vec3,
    world: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3),
    dx: wp.float64,
    shape: wp.vec3i,
    probed: wp.array2d(dtype=wp.vec3),
):
    """Computes the share of node o in the velocities at the points of marker k: 8 nodes outside, 8 behind a sheet."""
    k, o = wp.tid()
    if o < NODES * law.sides[k]:
        x = (world[k] - point3(host, at.origin)) / dx
        probed[k, o] = probe(f, body_acceleration, x, normal[k], law.height, o, shape)


@wp.kernel
def set_slips(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    law: WallLaw,
    cell: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    jacobian: wp.array2d(dtype=wp.vec3),
    width: int,
    box_u: wp.array3d(dtype=wp.vec3),
    probed: wp.array2d(dtype=wp.vec3),
    slip: wp.array(dtype=float),
):
    """Computes the slip ratio of marker k in this step."""
    k = wp.tid()
    p, u = cell[k], wp.vec3(0.0, 0.0, 0.0)
    x, y, z = first_cell(p[0], width), first_cell(p[1], width), first_cell(p[2], width)
    for i in range(width):
        for j in range(width):
            for l in range(width):
                u += weight(p, x + i, y + j, z + l, width) * box_u[x + i, y + j, z + l]
    wall = wall_velocity(host, at, jacobian, k)
    outer, inner = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for o in range(NODES):
        outer += probed[k, o]
        inner += probed[k, o + NODES]
    slip[k] = law_slip(law, k, normal[k], u - wall, outer - wall, inner - wall)


for _storage in STORAGE.values():  # beforehand, as the kernels of `kernels.py`
    wp.overload(probe_water, {"f": wp.array(dtype=_storage)})
