"""The background flow on the device: the same table, slice, offset and rotation that `flow.Flow.at` reads.

U(x, t) = U_mean + u'(x - U_mean t)     trilinear in the periodic box; a gust is linear in time and uniform in space
"""

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.in_kernels import wrap
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.water.flow import LENGTH, TICK, Flow, solenoidal_box, table_of

STEADY, FROZEN, GUST = 0, 1, 2


@wp.struct
class Inflow:
    """A `Flow` in lattice units; `offset` and `scale` in cells of the table, axis order of the table (z, x, y)."""

    kind: int
    mean: wp.vec3
    rms: float
    corner: wp.vec3  # position of node (0, 0, 0), cells
    cos: float
    sin: float
    offset: wp.vec3
    scale: float  # cells of the table a cell; for gusts ticks a step
    table: wp.array3d(dtype=wp.vec3)


def inflow_of(flow: Flow, lattice: Lattice, device) -> Inflow:
    """Uploads a background flow. `flow.Flow` has checked its own numbers."""
    c = flow.current()
    made = Inflow()
    made.mean = wp.vec3(*(flow.mean / lattice.velocity))
    made.rms = flow.rms / lattice.velocity
    made.corner = wp.vec3(*(np.asarray(lattice.corner) / lattice.dx))
    made.cos, made.sin = map(float, c.turn[0])
    table, cell = table_of(flow.turbulence, flow.box)
    if flow.turbulence == "none" or flow.rms == 0:
        made.kind, table = STEADY, np.zeros((1, 1, 1, 3), np.float32)
    elif flow.turbulence == "gust":
        made.kind, made.scale = GUST, lattice.dt / TICK
        made.offset = wp.vec3(0.0, 0.0, float(int(c.offset[0, 0])))
        table = _in_three(table[c.row[0]][None, None])
    else:
        made.kind, made.scale = FROZEN, lattice.dx / cell
        made.offset = wp.vec3(float(c.row[0]), *map(float, c.offset[0]))
        solid = flow.turbulence in ("default", "fine")
        table = solenoidal_box(LENGTH[flow.turbulence], flow.box) if solid else _in_three(table)
    made.table = wp.array(table, dtype=wp.vec3, device=device)
    return made


def _in_three(planar):
    """Adds a vertical component of zero: (..., 2) -> (..., 3)."""
    return np.concatenate([planar, np.zeros((*planar.shape[:-1], 1), np.float32)], -1)


@wp.func
def background(flow: Inflow, node: wp.vec3, step: int):
    """Velocity of the undisturbed water at a node's coordinates and a step, lattice units."""
    if flow.kind == STEADY:
        return flow.mean
    t = float(step)
    g = flow.offset
    if flow.kind == FROZEN:
        r = flow.corner + node - flow.mean * t
        g += flow.scale * wp.vec3(r[2], flow.cos * r[0] + flow.sin * r[1], flow.cos * r[1] - flow.sin * r[0])
    else:
        g += wp.vec3(0.0, 0.0, flow.scale * t)
    i, j, k = int(wp.floor(g[0])), int(wp.floor(g[1])), int(wp.floor(g[2]))
    a, b, c = g[0] - float(i), g[1] - float(j), g[2] - float(k)
    i0, i1 = wrap(i, flow.table.shape[0]), wrap(i + 1, flow.table.shape[0])
    j0, j1 = wrap(j, flow.table.shape[1]), wrap(j + 1, flow.table.shape[1])
    k0, k1 = wrap(k, flow.table.shape[2]), wrap(k + 1, flow.table.shape[2])
    low = wp.lerp(
        wp.lerp(flow.table[i0, j0, k0], flow.table[i0, j0, k1], c), wp.lerp(flow.table[i0, j1, k0], flow.table[i0, j1, k1], c), b
    )
    high = wp.lerp(
        wp.lerp(flow.table[i1, j0, k0], flow.table[i1, j0, k1], c), wp.lerp(flow.table[i1, j1, k0], flow.table[i1, j1, k1], c), b
    )
    u = flow.rms * wp.lerp(low, high, a)
    return flow.mean + wp.vec3(flow.cos * u[0] - flow.sin * u[1], flow.sin * u[0] + flow.cos * u[1], u[2])
