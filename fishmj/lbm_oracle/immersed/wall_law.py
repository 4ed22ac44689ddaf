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

The water takes the force along the wall at the heights y = (i + 1/2) H / m, i < m, m: H rounded up to cells, in shares that fall
as 1 - y / H: the stress falls as (1 - y / H)^2 from tau at the wall to zero at H. In a real layer eddies carry it that far, and
these cells resolve none. With all of it in the kernel at the wall the water there stops, the sooner the finer the cells are. The
body takes its force at the marker: linear momentum is kept, the moment of a wall with water on one side differs by tau H / 3.
"""

from math import ceil
from typing import Any

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.in_kernels import wrap
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
    points: int  # m, on each side
    outer: wp.array(dtype=float)  # share of the stress outside, of both
    last: wp.array2d(dtype=wp.vec3i)  # first node of the eight round each point, outside first, that got the last force


def law_of(markers: Markers, dx: float, nu: float, device) -> WallLaw:
    """Law for the markers on cells of `dx` m, with the viscosity `nu` in lattice units; without `law_height` an empty one."""
    made, off = WallLaw(), markers.law_height is None
    made.height, made.nu = 0.0 if off else max(STANDOFF, markers.law_height / dx), nu
    count = 0 if off else len(markers)
    nose = np.zeros(len(markers)) if markers.from_nose is None else markers.from_nose / dx
    made.sides = wp.array((1 + markers.sheet[:count]).astype(np.int32), dtype=wp.int32, device=device)
    made.from_nose = wp.array(nose[:count].astype(np.float32), dtype=wp.float32, device=device)
    made.points = ceil(made.height)
    made.outer = wp.zeros(count, dtype=wp.float32, device=device)
    made.last = wp.zeros((count, 2 * made.points), dtype=wp.vec3i, device=device)
    return made


@wp.func
def wall_stress(speed: float, height: float, nu: float, from_nose: float) -> float:
    """Stress over density of water that passes at `speed` a height off the wall; `from_nose` > 0: of a laminar layer."""
    viscous = nu * speed / height
    if from_nose > 0.0:
        return wp.max(viscous, BLASIUS * speed * wp.sqrt(nu * speed / from_nose))
    return wp.max(viscous, wp.pow(speed / FACTOR * wp.pow(nu / height, POWER), 1.75))


@wp.func
def off_wall(x: wp.vec3d, normal: wp.vec3, height: float) -> wp.vec3d:
    """Point `height` cells off the wall; x is in cells of the world."""
    return x + wp.float64(height) * wp.vec3d(wp.float64(normal[0]), wp.float64(normal[1]), wp.float64(normal[2]))


@wp.func
def node_below(p: wp.vec3d) -> wp.vec3i:
    """First of the eight nodes round a point."""
    return wp.vec3i(int(wp.floor(p[0])), int(wp.floor(p[1])), int(wp.floor(p[2])))


@wp.func
def node_of(low: wp.vec3i, o: int) -> wp.vec3i:
    """Node o % 8 of the eight from `low` on."""
    return wp.vec3i(low[0] + (o // 4) % 2, low[1] + (o // 2) % 2, low[2] + o % 2)


@wp.func
def node_share(p: wp.vec3d, node: wp.vec3i) -> float:
    """Trilinear weight of one of the eight nodes round a point."""
    far = wp.vec3(float(p[0] - wp.float64(node[0])), float(p[1] - wp.float64(node[1])), float(p[2] - wp.float64(node[2])))
    return (1.0 - wp.abs(far[0])) * (1.0 - wp.abs(far[1])) * (1.0 - wp.abs(far[2]))


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
    p = off_wall(x, normal, wp.where(o < NODES, height, -height))
    node = node_of(node_below(p), o)
    rho, m = pulled_moments(f, node[0], node[1], node[2], shape)
    return node_share(p, node) * (m / rho + body_acceleration)


@wp.func
def push_layer(
    law: WallLaw,
    f: wp.array(dtype=Any),
    k: int,
    o: int,
    x: wp.vec3d,
    normal: wp.vec3,
    push: wp.vec3,
    shape: wp.vec3i,
    acceleration: wp.array3d(dtype=wp.vec3),
):
    """Gives node o % 8 round point o // 8 of marker k its share of the force `push` along the wall; x: its place, cells."""
    point, share = o // NODES, float(law.outer[k])
    part = (float(point % law.points) + 0.5) / float(law.points)  # of H
    height = part * law.height
    if point >= law.points:
        height, share = -height, 1.0 - share
    p = off_wall(x, normal, height)
    low = node_below(p)
    node = node_of(low, o)
    rho, m = pulled_moments(f, node[0], node[1], node[2], shape)
    share *= 2.0 * (1.0 - part) / float(law.points) * node_share(p, node) / rho
    wp.atomic_add(acceleration, wrap(node[0], shape[0]), wrap(node[1], shape[1]), wrap(node[2], shape[2]), share * push)
    if o % NODES == 0:
        law.last[k, point] = low


@wp.func
def clear_layer(law: WallLaw, k: int, o: int, shape: wp.vec3i, acceleration: wp.array3d(dtype=wp.vec3)):
    """G = 0 at node o % 8 round point o // 8 of marker k's last force along the wall."""
    node = node_of(law.last[k, o // NODES], o)
    acceleration[wrap(node[0], shape[0]), wrap(node[1], shape[1]), wrap(node[2], shape[2])] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def along_wall(u: wp.vec3, normal: wp.vec3) -> float:
    """Speed of u along the wall."""
    return wp.length(u - wp.dot(u, normal) * normal)


@wp.func
def law_slip(law: WallLaw, k: int, normal: wp.vec3, u: wp.vec3, outer: wp.vec3, inner: wp.vec3) -> wp.vec2:
    """Slip ratio of marker k, and the share of its stress that acts outside.

    Velocities are relative to the wall: at the marker, at X + H n and at X - H n.
    """
    outside = wall_stress(along_wall(outer, normal), law.height, law.nu, law.from_nose[k])
    stress = float(outside)
    if law.sides[k] == 2:
        stress += wall_stress(along_wall(inner, normal), law.height, law.nu, law.from_nose[k])
    share = wp.where(law.sides[k] == 2, outside / wp.max(stress, 1.0e-30), 1.0)
    return wp.vec2(1.0 - wp.min(stress / wp.max(along_wall(u, normal), 1.0e-30), 1.0), share)


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
    """Computes the slip ratio of marker k in this step, and the share of its stress outside."""
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
    found = law_slip(law, k, normal[k], u - wall, outer - wall, inner - wall)
    slip[k] = found[0]
    law.outer[k] = found[1]


@wp.kernel
def take_across(normal: wp.array(dtype=wp.vec3), final: wp.array(dtype=wp.vec3), across: wp.array(dtype=wp.vec3)):
    """Computes the part of each marker's force along its normal."""
    k = wp.tid()
    across[k] = wp.dot(final[k], normal[k]) * normal[k]


@wp.kernel
def push_layers(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    law: WallLaw,
    f: wp.array(dtype=Any),
    world: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3),
    volume: wp.array(dtype=float),
    final: wp.array(dtype=wp.vec3),
    across: wp.array(dtype=wp.vec3),
    dx: wp.float64,
    shape: wp.vec3i,
    acceleration: wp.array3d(dtype=wp.vec3),
):
    """Gives one node round one point of marker k its share of the force along the wall."""
    k, o = wp.tid()
    if o < NODES * law.points * law.sides[k]:
        x = (world[k] - point3(host, at.origin)) / dx
        push_layer(law, f, k, o, x, normal[k], volume[k] * (final[k] - across[k]), shape, acceleration)


@wp.kernel
def clear_layers(law: WallLaw, shape: wp.vec3i, acceleration: wp.array3d(dtype=wp.vec3)):
    """G = 0 at one node that `push_layers` gave a force."""
    k, o = wp.tid()
    if o < NODES * law.points * law.sides[k]:
        clear_layer(law, k, o, shape, acceleration)


for _kernel in (probe_water, push_layers):
    for _storage in STORAGE.values():  # beforehand, as the kernels of `kernels.py`
        wp.overload(_kernel, {"f": wp.array(dtype=_storage)})
