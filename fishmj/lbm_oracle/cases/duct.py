"""A sphere on the axis of a long duct, solved by another method: the reference for the sinking spheres.

Of the solver only the table of velocities is used. In the frame of the sphere, all faces of the duct move with the stream U; by
symmetry a quarter of the duct is enough. Lattice units, populations less those of water at rest.

    collision   two rates, (1 / omega_even - 1/2) (1 / omega_odd - 1/2) = 3/16: steady walls stay in place at any viscosity
    faces       f_i(x, t + 1) = f_-i(x) + 6 w_i c_i . U                      halfway between the nodes
    sphere      f_i(x, t + 1) = f_-i(x) + k (f_-i(x + c_i) - f_i(x)),        k = (1 - 2 q) / (1 + 2 q), surface at x - q c_i
    drag        sum over the links of the sphere of -c_i (f_-i(x) + f_i(x, t + 1))

Sources: Ginzburg, d'Humieres 2003, Phys. Rev. E 68:066614 (rates and sphere); He, Luo 1997, J. Stat. Phys. 88:927 (density held
constant in the momentum); Ladd 1994, J. Fluid Mech. 271:285 (faces and drag).
"""

from math import pi

import numpy as np

from fishmj.base.units import G
from fishmj.lbm_oracle.cases import about, register, reported, sphere
from fishmj.lbm_oracle.cases.settling import BOX, DENSITY, DIAMETER, OILS, retraction
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES as C
from fishmj.lbm_oracle.fluid.lattice import WEIGHTS as W
from fishmj.lbm_oracle.fluid.lattice import Q

MAGIC, STREAM, WIDTH = 3 / 16, 0.1, BOX[0] / DIAMETER
AHEAD, BEHIND = 0.675, 1.05  # widths of the duct to its ends
NUMBER = np.zeros((3, 3, 3), int)
NUMBER[tuple(C.T + 1)] = np.arange(Q)


def drag(reynolds: float, cells: int, *, width: float = WIDTH, slip: bool = False, steady: float = 2e-4, longest=30.0) -> float:
    """C_D of a sphere of `cells` cells in a duct `width` diameters wide; `slip`: its four sides are frictionless.

    It is read once it changes by less than `steady` over three half diameters of travel, at the latest after `longest` diameters.
    """
    ahead, side = round(AHEAD * width * cells), round(width * cells / 2)
    shape = (side, side, ahead + round(BEHIND * width * cells))
    even = 1 / (0.5 + 3 * STREAM * cells / reynolds)
    odd = 1 / (0.5 + MAGIC / (1 / even - 0.5))
    links = DuctLinks(shape, cells / 2, ahead - 0.5, slip)
    held = np.zeros((Q, *(n + 2 for n in shape)), np.float32)  # one layer of nodes outside, for what comes from there
    inside = held[:, 1:-1, 1:-1, 1:-1]
    f = np.broadcast_to((3 * W * C[:, 2] * STREAM)[:, None, None, None], (Q, *shape)).astype(np.float32)
    window, found = round(cells / STREAM / 2), []
    while len(found) < 2 * longest and not has_settled(found, steady):
        total = 0.0
        for _ in range(window):
            collide(f, even, odd)
            inside[:] = f
            total += links.fill(held.reshape(-1))
            for i, c in enumerate(C):
                part = tuple(slice(1 - a, 1 - a + n) for a, n in zip(c, shape, strict=True))
                f[i] = held[i][part]
        found.append(4 * total / window / (STREAM**2 * pi * cells**2 / 8))
    return float(np.mean(found[-8:]))


def has_settled(found: list[float], steady: float) -> bool:
    """Returns True if the last three half diameters of travel agree."""
    return len(found) > 6 and max(abs(found[-1] / value - 1) for value in found[-3:]) < steady


def collide(f: np.ndarray, even: float, odd: float) -> None:
    """Relaxes the even and the odd half of every pair, (19, x, y, z), in place."""
    rho, u = f.sum(0), np.tensordot(C.T.astype(f.dtype), f, 1)
    square = 1.5 * (u * u).sum(0)
    f[0] -= even * (f[0] - W[0] * (rho - square))
    for i in range(1, Q, 2):
        along = sum(c * part for c, part in zip(C[i], u, strict=True) if c)
        whole = even / 2 * (f[i] + f[i + 1]) - even * W[i] * (rho + 4.5 * along**2 - square)
        apart = odd / 2 * (f[i] - f[i + 1]) - 3 * odd * W[i] * along
        f[i] -= whole + apart
        f[i + 1] -= whole - apart


class DuctLinks:
    """Links that pull from outside the water: indices into the flat populations, sphere first."""

    def __init__(self, shape, radius: float, centre: float, slip: bool):
        node = np.indices(shape).reshape(3, -1).T
        from_centre = np.array([0.5, 0.5, -centre])
        solid = np.linalg.norm(node + from_centre, axis=1) < radius
        self.solid = _slot(shape, 0, node[solid])
        rows, node = [], node[~solid]
        for i in range(1, Q):
            x, c = node + from_centre, C[i]
            source = node - c
            hit = np.linalg.norm(x - c, axis=1) < radius
            touched = hit | ((source < 0) | (source >= shape)).any(1)
            x, source, hit, near = x[touched], source[touched], hit[touched], node[touched]
            mirror, image = _this_side(i, source, shape, slip)
            face = ~hit & ((image < 0) | (image >= shape)).any(1)
            back = NUMBER[tuple(1 - c)]
            far, beyond = _this_side(back, np.where(hit[:, None], near + c, near), shape, slip)
            own, b = _slot(shape, back, near), x @ c
            q = (b - np.sqrt(np.maximum(b * b - c @ c * ((x * x).sum(1) - radius**2), 0.0))) / (c @ c)
            q = np.where(hit, q, 0.5)
            start = np.where(hit | face, own, _slot(shape, mirror, np.where(face[:, None], near, image)))
            lift = np.where(face, 6 * W[i] * c[2] * STREAM, 0.0)
            weight = np.where(hit, -c[2], 0)
            to, opposite, here = _slot(shape, i, source), _slot(shape, far, beyond), _slot(shape, i, near)
            rows.append((to, start, opposite, here, (1 - 2 * q) / (1 + 2 * q), lift, weight, hit))
        *columns, hit = (np.concatenate(column) for column in zip(*rows, strict=True))
        first = np.argsort(~hit, kind="stable")
        self.to, self.start, self.far, self.near, self.k, self.lift, self.weight = (column[first] for column in columns)
        self.sphere = slice(0, int(hit.sum()))
        self.step = np.prod([n + 2 for n in shape])

    def fill(self, flat: np.ndarray) -> float:
        """Writes the populations that the nodes will pull; returns the force on this quarter of the sphere, along the stream."""
        flat[self.solid[:, None] + self.step * np.arange(Q)] = 0.0
        s = self.sphere
        value = flat[self.start] + self.lift
        value[s] += self.k[s] * (flat[self.far[s]] - flat[self.near[s]])
        flat[self.to] = value
        return float(self.weight[s] @ (flat[self.start[s]] + value[s]))


def _this_side(i: int, at: np.ndarray, shape, slip: bool) -> tuple[np.ndarray, np.ndarray]:
    """Image of velocity i at nodes (N, 3) that may lie beyond a reflecting plane: its velocity and its node."""
    across = np.array([True, True, False])
    below, above = across & (at < 0), across & slip & (at >= shape)
    c = np.where(below | above, -C[i], C[i])
    return NUMBER[tuple(c.T + 1)], np.where(below, -1 - at, np.where(above, 2 * np.array(shape) - 1 - at, at))


def _slot(shape, i, at: np.ndarray) -> np.ndarray:
    """Index of velocity i at nodes (N, 3) in the flat populations, which have one layer outside."""
    x, y, z = (n + 2 for n in shape)
    return ((i * x + at[:, 0] + 1) * y + at[:, 1] + 1) * z + at[:, 2] + 1


def drag_over_weight(name: str, cells: int) -> float:
    """Share of its weight that a sphere in this oil has as drag at the speed noted in `OILS` for an endless duct."""
    oil = OILS[name]
    nu = oil.viscosity / oil.density
    reynolds = oil.endless * DIAMETER / nu
    return drag(reynolds, cells) * reynolds**2 / (4 / 3 * (DENSITY / oil.density - 1) * G * DIAMETER**3 / nu**2)


@register(
    "duct",
    rung=9.5,
    grid="40 x 40 x 69, D = 6 and 80 x 80 x 92, D = 8",
    source="the same at D = 12 to 18; Clift et al. 1978",
    cost="2 min",
)
def duct(device):
    """A sphere in a duct by bounce-back, in NumPy; and the immersed one that is towed there."""
    narrow, wide = (drag(20.0, 8, width=w, slip=True, longest=12.0) for w in (7.0, 10.0))
    yield reported("C_D at Re 20 between frictionless sides 7 D apart, D = 8", narrow)
    yield about(
        "C_D at Re 20 in open water, from sides 7 and 10 D apart", (100 * wide - 49 * narrow) / 51, sphere.clift(20.0), 0.03
    )
    for name in ("E1", "E2", "E3"):
        yield about(f"{name}: drag over weight at the noted speed, D = 6", drag_over_weight(name, 6), 1.0, 0.03)
    box, inset = ((AHEAD + BEHIND) * WIDTH, WIDTH, WIDTH), retraction(6, sphere.STREAM * 6 / 11.1)
    towed = sphere.drag(11.1, 6, device, box=box, times=6.0, towed=True, sides="wall", hydro_offset=inset)
    yield about("C_D at Re 11.1, immersed over bounce-back, D = 6", towed / drag(11.1, 6), 1.0, 0.03)
