"""Six faces of the box: periodic, free slip, wall, moving wall or open; and the sponge that lets sound and wakes leave.

slip    specular reflection half a cell outside the last node: f_i(x) = f_mirror(i)(x - tangential part of c_i)
wall    halfway bounce-back:                                   f_i(x) = f_opp(i)(x)
moving  the same off a wall that slides in its own plane:      f_i(x) = f_opp(i)(x) + 6 w_i c_i . u_wall
open    the node takes the moments of its inner neighbour and replaces the incoming sound wave:
            out = c_s drho + (u - u_in).n      kept                               n points outwards
            in  = c_s drho - (u - u_in).n      0
        the tangential velocity is u_in on an inlet (u_in.n < 0) and the neighbour's on an outlet.
sponge  the last `sponge` cells of an open face relax towards density 1 and the background flow with
        sigma = sponge_rate (depth / sponge)^2

A new face is one subclass of `Face` and its entry in `FACES`. `redirect` is called while the kernel's code is generated; `gain`
and `complete` name functions of `in_kernels`, which the kernel calls directly. A face that is not used therefore costs nothing.

Sources: Ladd 1994, J. Fluid Mech. 271:285 (bounce-back); Poinsot and Lele 1992, J. Comput. Phys. 101:104 (characteristics);
Israeli and Orszag 1981, J. Comput. Phys. 41:115 (sponge).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_name, shown_value
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES, mirrored, opposite

SPONGE, RATE = constant("oracle", "sponge"), constant("oracle", "sponge_rate")  # cells, 1


class Axis(NamedTuple):
    """Kinds of the two faces of one axis."""

    low: str
    high: str


class Source(NamedTuple):
    """Node and direction from which a population is pulled when its own path crosses faces."""

    population: int
    stays: tuple[bool, bool, bool]  # axes along which it is taken from the node itself, not from its neighbour
    gain: str = ""  # function of in_kernels (6 w_i, c_i, u_wall): what it gains on the way


class Face:
    """One kind of face: its effect on the step, and the axes on which it is allowed."""

    rank = 0  # of the faces that a population meets at once, in an edge of the box, the highest redirects it; 0: it does not
    wraps = False  # the node across is a neighbour
    complete = ""  # function of in_kernels (drho, u, u_in, n) -> drho, u of an outermost node, from its inner neighbour's

    @staticmethod
    def check(boundaries: "Boundaries", axis: str) -> None:
        """Raises ConfigError if this kind is not allowed on `axis` (`x`, `y` or `z`). The base class allows every axis."""

    @staticmethod
    def redirect(i: int, axes: tuple[int, ...]) -> Source:
        """Source of population i at a node that meets faces of this kind on `axes`, one or two of them."""
        raise NotImplementedError


class Periodic(Face):
    """Periodic face: memory wraps round, the step has nothing to do."""

    wraps = True

    @staticmethod
    def check(boundaries, axis):
        """Raises ConfigError if only one face of the axis is periodic."""
        low, high = getattr(boundaries, axis)
        if low != high:
            raise ConfigError(
                f"boundaries: axis {axis} is {low} at its low end and {high} at its high end; both faces are periodic or none"
            )


class Slip(Face):
    """Free-slip face: specular reflection half a cell outside the last node."""

    rank = 1

    @staticmethod
    def redirect(i, axes):
        """Mirrored population of the node that lies back along the wall."""
        return Source(mirrored(i, *axes), (0 in axes, 1 in axes, 2 in axes))


class Wall(Face):
    """No-slip wall at rest: halfway bounce-back."""

    rank = 3

    @staticmethod
    def redirect(i, axes):
        """Opposite population of the node itself."""
        return Source(opposite(i), (True, True, True))


class Moving(Face):
    """No-slip wall that slides in its own plane.

    It ranks below a wall at rest, which therefore holds the edge between them: a lid that drags its corners along is first order.
    """

    rank = 2

    @staticmethod
    def check(boundaries, axis):
        """Raises ConfigError if the wall's velocity has a component normal to the wall."""
        normal = boundaries.wall_velocity_lu["xyz".index(axis)]
        if normal:
            raise ConfigError(f"boundaries: the moving wall of axis {axis} leaves its plane by {normal}; it can only slide")

    @staticmethod
    def redirect(i, axes):
        """Opposite population of the node itself, plus the momentum of the sliding wall."""
        return Source(opposite(i), (True, True, True), "dragged")


class Open(Face):
    """Open face with a sponge: the incoming sound wave is set to zero."""

    complete = "characteristic"

    @staticmethod
    def check(boundaries, axis):
        """Raises ConfigError on the z axis."""
        if axis == "z":
            raise ConfigError("boundaries: an open face at the top or bottom; z takes slip, wall or periodic")


FACES: dict[str, type[Face]] = {"periodic": Periodic, "slip": Slip, "wall": Wall, "moving": Moving, "open": Open}


@dataclass(frozen=True, kw_only=True)
class Boundaries:
    """Kinds of the faces of each axis. `wall_velocity_lu` (3,) is the velocity of the moving walls, in lattice units.

    Raises:
        UnknownName: a kind that does not exist.
        ConfigError: a kind that is not allowed there: only one face of an axis is periodic; a face above or below is open; a wall
            moves out of its plane; no wall moves.
    """

    x: Axis = Axis("periodic", "periodic")
    y: Axis = Axis("periodic", "periodic")
    z: Axis = Axis("periodic", "periodic")
    wall_velocity_lu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sponge: int = 0
    sponge_rate: float = RATE

    def __post_init__(self):
        for name in "xyz":
            faces = getattr(self, name)
            if not isinstance(faces, tuple | list) or len(faces) != 2:
                raise ConfigError(f"boundaries: {name} = {shown_value(faces)}; expected Axis(low, high), its two faces")
            object.__setattr__(self, name, Axis(*(checked_name("kind of face", kind, FACES) for kind in faces)))
        numbers("boundaries: wall_velocity_lu", self.wall_velocity_lu, (3,))
        whole_numbers("boundaries: sponge", self.sponge, low=0)
        numbers("boundaries: sponge_rate", self.sponge_rate, low=0.0, high=1.0)
        for name in "xyz":
            for kind in getattr(self, name):
                FACES[kind].check(self, name)
        if any(self.wall_velocity_lu) and "moving" not in self.kinds:
            raise ConfigError(
                f"boundaries: wall_velocity_lu = {self.wall_velocity_lu} and no face is `moving`; make one of them so"
            )

    def check_room(self, shape: Sequence[int]) -> None:
        """Raises ConfigError if the sponges of the open faces leave no water between them in a box of `shape` (3,) cells."""
        for name, axis, n in zip("xyz", self.axes, shape, strict=True):
            if self.sponge and self.sponge * sum(completes(axis)) >= n:
                raise ConfigError(
                    f"fluid: {n} cells along {name} and a sponge of {self.sponge} behind each open face; expected water between"
                    " them: enlarge the box, or take a thinner sponge"
                )

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """Faces of x, y and z."""
        return self.x, self.y, self.z

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of all six faces: x, y, z, each low then high."""
        return self.x + self.y + self.z


PERIODIC = Boundaries()


def channel(*, bottom: str = "slip", sponge: int = SPONGE) -> Boundaries:
    """Faces of the tank and of the window: open sides, a free surface without waves on top, free slip or a no-slip wall below."""
    side = Axis("open", "open")
    return Boundaries(x=side, y=side, z=Axis(bottom, "slip"), sponge=sponge)


def sources(faces: tuple[Axis, Axis, Axis], i: int) -> dict[int, Source]:
    """Sources of population i, keyed by the faces that it meets at once: bit a of the key is set if it meets a face of axis a."""
    velocity = VELOCITIES[i]
    met = {a: FACES[faces[a].low if velocity[a] > 0 else faces[a].high] for a in range(3) if velocity[a]}
    redirecting = [a for a in met if met[a].rank]
    found = {}
    for meeting in [*combinations(redirecting, 1), *combinations(redirecting, 2)]:  # no D3Q19 velocity has a third component
        top = max((met[a] for a in meeting), key=lambda face: face.rank)
        found[sum(1 << a for a in meeting)] = top.redirect(i, tuple(a for a in meeting if met[a] is top))
    return found


def completes(axis: Axis) -> tuple[bool, bool]:
    """Returns, for the low and the high face of an axis, True if the face completes its nodes behind a sponge."""
    return bool(FACES[axis.low].complete), bool(FACES[axis.high].complete)
