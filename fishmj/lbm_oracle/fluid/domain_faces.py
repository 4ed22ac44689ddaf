"""Six faces of the box: periodic, free slip, wall or open; and the sponge that lets sound and wakes leave.

slip   specular reflection half a cell outside the last node: f_i(x) = f_mirror(i)(x - tangential part of c_i)
wall   halfway bounce-back:                                   f_i(x) = f_opp(i)(x) + 6 w_i c_i . u_wall
open   the node takes the moments of its inner neighbour and replaces the incoming sound wave:
           out = c_s drho + (u - u_in).n      kept                               n points outwards
           in  = c_s drho - (u - u_in).n      0
       the tangential velocity is u_in on an inlet (u_in.n < 0) and the neighbour's on an outlet.
sponge the last `sponge` cells of an open face relax towards density 1 and the background flow with
       sigma = sponge_rate (depth / sponge)^2

Sources: Ladd 1994, J. Fluid Mech. 271:285 (bounce-back); Poinsot and Lele 1992, J. Comput. Phys. 101:104 (characteristics);
Israeli and Orszag 1981, J. Comput. Phys. 41:115 (sponge).
"""

from dataclasses import dataclass
from typing import NamedTuple

import warp as wp

from fishmj.calib import constant
from fishmj.errors import ConfigError, UnknownName
from fishmj.lbm_oracle.fluid.lattice import CS

SPONGE, RATE = constant("oracle", "sponge"), constant("oracle", "sponge_rate")  # cells, 1
KINDS = ("periodic", "slip", "wall", "open")


class Axis(NamedTuple):
    """The two faces of one axis."""

    low: str
    high: str


@dataclass(frozen=True, kw_only=True)
class Boundaries:
    """Kinds of the faces of each axis. `slide_lu` is the velocity of the wall at high y (a lid), in lattice units.

    Raises:
        UnknownName: a kind that does not exist.
        ConfigError: one face of an axis periodic and the other not; an open face above or below.
    """

    x: Axis = Axis("periodic", "periodic")
    y: Axis = Axis("periodic", "periodic")
    z: Axis = Axis("periodic", "periodic")
    slide_lu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sponge: int = 0
    sponge_rate: float = RATE

    def __post_init__(self):
        for name in "xyz":
            axis = getattr(self, name)
            for kind in axis:
                if kind not in KINDS:
                    raise UnknownName("kind of face", kind, KINDS)
            if ("periodic" in axis) and axis.low != axis.high:
                raise ConfigError(
                    f"boundaries: axis {name} is {axis.low} below and {axis.high} above; both faces are periodic or none"
                )
        if "open" in self.z:
            raise ConfigError("boundaries: an open face at the top or bottom; z takes slip, wall or periodic")
        if self.sponge < 0 or not 0 <= self.sponge_rate <= 1:
            raise ConfigError(f"boundaries: sponge = {self.sponge} cells (>= 0), sponge_rate = {self.sponge_rate} (0 to 1)")

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        return self.x, self.y, self.z

    @property
    def is_open(self) -> bool:
        return any("open" in axis for axis in self.axes)


PERIODIC = Boundaries()


def channel(*, bottom: str = "slip", sponge: int = SPONGE) -> Boundaries:
    """Open sides, free surface without waves on top, free slip or a no-slip wall below: the tank's and the window's faces."""
    side = Axis("open", "open")
    return Boundaries(x=side, y=side, z=Axis(bottom, "slip"), sponge=sponge)


_CS = wp.constant(CS)


@wp.func
def through(drho: float, u: wp.vec3, target: wp.vec3, n: wp.vec3):
    """Density and velocity of an open node with outward normal n from those of its inner neighbour."""
    away = u - target
    normal = wp.dot(away, n)
    leaving = 0.5 * (_CS * drho + normal)
    if wp.dot(target, n) < 0.0:
        return leaving / _CS, target + leaving * n
    return leaving / _CS, u + (leaving - normal) * n


@wp.func
def ramp(position: int, size: int, width: int):
    """0 in the interior, up to 1 at the last node of an axis."""
    depth = wp.max(width - position, position - (size - 1 - width))
    s = wp.clamp(float(depth) / float(width), 0.0, 1.0)
    return s * s
