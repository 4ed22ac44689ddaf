"""The water inside the hull, measured along each link: a frictionless hull does not take it along.

    s_l = sum_p w_p t_l . u*(x_p)          x_p: points of link l's own volume, t_l: its axis, sum_p w_p = 1

u* is the fluid before any force, between the eight nodes round a point. Across the link the wall is impermeable and its water
moves with it; along it, only as far as friction and the closed ends carry it, which no ratio says beforehand.
"""

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.storage import STORAGE, matrix3, point3
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays, pulled
from fishmj.mjcf.geometry import Geometry

wp.set_module_options({"enable_backward": False, "max_unroll": Q})


class Points(NamedTuple):
    """P points in the volumes of the links, in the links' frames."""

    place: np.ndarray  # (P, 3) m
    link: np.ndarray  # (P,)
    share: np.ndarray  # (P,) of the link's volume; 1 in all for each link

    @classmethod
    def of(cls, g: Geometry) -> "Points":
        """Four a strip, at half the half-axes of its elliptic section: exact for what is quadratic across it."""
        ds = ((g.span[:, 1] - g.span[:, 0]) / g.strip_x.shape[1])[:, None]
        width, height = g.strip_w / ds, g.strip_h / ds
        area = width * height / (width * height).sum(1, keepdims=True)
        place = [  # two by two, not one on the axis: what turns with the link must not look like what slides along it
            np.stack([g.strip_x, side * width / 4, up * height / 4], -1).reshape(-1, 3) for side in (-1, 1) for up in (-1, 1)
        ]
        link = np.repeat(np.arange(g.n_links), g.strip_x.shape[1])
        return cls(np.concatenate(place), np.tile(link, 4), np.tile(area.ravel() / 4, 4))


@wp.kernel
def measure(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    place: wp.array(dtype=wp.vec3d),
    link: wp.array(dtype=int),
    f: wp.array(dtype=Any),
    directions: wp.array(dtype=wp.vec3i),
    body_acceleration: wp.vec3,
    dx: wp.float64,
    shape: wp.vec3i,
    along: wp.array(dtype=float),
):
    """t . u* at every point, lattice units."""
    p = wp.tid()
    frame = at.frame + 12 * link[p]
    rotation = matrix3(host, frame + 3)
    x = (point3(host, frame) + rotation * place[p] - point3(host, at.origin)) / dx
    axis = wp.vec3(float(rotation[0, 0]), float(rotation[1, 0]), float(rotation[2, 0]))
    low = wp.vec3i(int(wp.floor(x[0])), int(wp.floor(x[1])), int(wp.floor(x[2])))
    part = wp.vec3(float(x[0]) - float(low[0]), float(x[1]) - float(low[1]), float(x[2]) - float(low[2]))
    # trilinear: the markers' kernel reaches 1.5 cells, out of a hull that is three cells wide
    total = wp.float32(0.0)
    for o in range(8):
        i, j, k = o // 4, (o // 2) % 2, o % 2
        weight = wp.abs(float(1 - i) - part[0]) * wp.abs(float(1 - j) - part[1]) * wp.abs(float(1 - k) - part[2])
        rho, m = pulled(f, directions, low[0] + i, low[1] + j, low[2] + k, shape)
        total += weight * wp.dot(axis, m / rho + body_acceleration)
    along[p] = total


@wp.kernel
def mean(
    along: wp.array(dtype=float),
    link: wp.array(dtype=int),
    share: wp.array(dtype=float),
    scale: wp.float64,
    speed: wp.array(dtype=wp.float64),
):
    """s_l, m/s."""
    l = wp.tid()  # one thread a link in a fixed order of points: atomics would cost the repetition to the bit
    total = wp.float32(0.0)
    for p in range(along.shape[0]):
        if link[p] == l:
            total += share[p] * along[p]
    speed[l] = scale * wp.float64(total)


for _storage in STORAGE.values():  # beforehand: an overload that comes later reloads the module under captured graphs
    wp.overload(measure, {"f": wp.array(dtype=_storage)})
