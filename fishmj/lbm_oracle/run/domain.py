"""The box of water: a fixed tank, or a window that follows the fish.

A window moves by whole cells. Its velocities are those of the world: there is no fictitious force and no interpolation. The fish
keeps `lead` of the window's length ahead of it; the lead turns with the heading no faster than `TURN`.

Both are centred: the tank's middle is the world's origin, mid-depth is z = 0, the plane in which the fish swims.
"""

from dataclasses import dataclass, replace
from math import ceil, cos, sin
from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_name
from fishmj.base.units import WATER_VISCOSITY, wrap
from fishmj.lbm_oracle.fluid.domain_faces import SPONGE, Axis, Boundaries, channel
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.fluid.lattice import RATIO, Lattice

TURN = 0.5  # rad/s, greatest rate at which the window's lead follows the heading
LEAD = 0.15  # of the window's length: the fish sits this far behind the middle and leaves its wake the longer part
BOTTOMS = ("slip", "wall")
SIDES = ("open", "wall", "slip", "periodic")
AROUND = {  # m, box of finer cells round a fish of 0.54 m at any heading
    "paper": (1.0, 1.0, 0.4),
    "forcemap": (1.0, 1.0, 0.4),
    "window": (1.0, 0.8, 0.4),
    "window_coarse": (1.0, 1.0, 0.4),
    "laptop": (0.72, 0.72, 0.32),
}
TWICE = ("paper", "forcemap", "window", "window_coarse")  # of these also with a box of still finer cells in the first
CLOSE = (0.72, 0.72, 0.28)  # m, the second box
SMALL = ("paper", "window_coarse")  # of these also with both boxes as small as a fish of 0.54 m allows
SMALL_AROUND, SMALL_CLOSE = (0.8, 0.8, 0.32), (0.64, 0.64, 0.24)  # m
THRICE = ("window_coarse",)  # of these also with a third, to look at what half the cell of the second changes
CLOSEST = (0.64, 0.64, 0.2)  # m
BOXES = {  # end of a name: the first box of each domain, and those in it
    "_refined": (AROUND, ()),
    "_refined_twice": ({name: AROUND[name] for name in TWICE}, (CLOSE,)),
    "_refined_twice_small": (dict.fromkeys(SMALL, SMALL_AROUND), (SMALL_CLOSE,)),
    "_refined_thrice": ({name: AROUND[name] for name in THRICE}, (CLOSE, CLOSEST)),
}


@dataclass(frozen=True, kw_only=True)
class Domain:
    """Cells (nx, ny, nz) of dx [m], time step dt [s]; `follows` makes it a window. `bottom`: `slip` or `wall`.

    `sides`: kind of the four side faces, `open` for a current, `wall` for a basin. `fine` [m]: size of a box round the fish with
    cells and steps half as large (`refined`); None: no such box. `finer`: further boxes, each inside the one before. `nu`
    [m2/s]: kinematic viscosity.
    """

    name: str
    shape: tuple[int, int, int]
    dx: float
    dt: float
    follows: bool = False
    bottom: str = "slip"
    sides: str = "open"
    sponge: int = SPONGE
    fine: tuple[float, float, float] | None = None
    finer: tuple[tuple[float, float, float], ...] = ()
    nu: float = WATER_VISCOSITY

    def __post_init__(self):
        """Raises ConfigError for an invalid number, UnknownName for an unknown kind of face."""
        what = f"domain {self.name}"
        whole_numbers(f"{what}: shape", self.shape, (3,), low=1)
        numbers(f"{what}: dx", self.dx, low=1e-300), numbers(f"{what}: dt", self.dt, low=1e-300)
        numbers(f"{what}: nu", self.nu, low=1e-300)
        checked_name("kind of bottom", self.bottom, BOTTOMS)
        checked_name("kind of side", self.sides, SIDES)
        for name, size in (("fine", self.fine), *(("finer", size) for size in self.finer)):
            if size is not None:
                numbers(f"{what}: {name}", size, (3,), low=1e-300)
        if self.finer and self.fine is None:
            raise ConfigError(f"{what}: finer boxes in no box; give the size of the first as fine, (3,) m")
        self.boundaries  # noqa: B018  (checks the sponge)
        if self.follows and self.sides != "open":
            raise ConfigError(f"domain {self.name}: a window moves through open water; sides = {self.sides!r}, expected 'open'")

    @property
    def size(self) -> tuple[float, float, float]:
        """Size of the box, m."""
        x, y, z = (n * self.dx for n in self.shape)
        return x, y, z

    @property
    def lattice(self) -> Lattice:
        """Lattice of this box."""
        x, y, z = (-(n - 1) / 2 * self.dx for n in self.shape)
        return Lattice(dx=self.dx, dt=self.dt, corner=(x, y, z), nu=self.nu)

    @property
    def fine_cells(self) -> tuple[int, int, int]:
        """Size of the finer box, in cells of this water."""
        x, y, z = (ceil(round(s / self.dx, 6)) for s in self.fine or (0.0, 0.0, 0.0))
        return x, y, z

    @property
    def levels(self) -> tuple["Domain", ...]:
        """This water alone, then each finer box as a domain of its own, the finest last."""
        alone = replace(self, fine=None, finer=())
        if self.fine is None:
            return (alone,)
        x, y, z = (RATIO * n for n in self.fine_cells)
        fine, finer = (self.finer[0] if self.finer else None), self.finer[1:]
        box = replace(self, shape=(x, y, z), dx=self.dx / RATIO, dt=self.dt / RATIO, fine=fine, finer=finer)
        return alone, *box.levels

    @property
    def boxes(self) -> list[tuple[int, int, int]]:
        """Size of each finer box in cells of the water round it; the finest last."""
        found = []
        for level in self.levels[1:]:
            x, y, z = (n // RATIO for n in level.shape)
            found.append((x, y, z))
        return found

    @property
    def body_level(self) -> "Domain":
        """Water in which the body swims: this one, or the finest box as a domain of its own."""
        return self.levels[-1]

    @property
    def boundaries(self) -> Boundaries:
        """Faces of this box."""
        if self.sides == "open":
            return channel(bottom=self.bottom, sponge=self.sponge)
        side = Axis(self.sides, self.sides)
        return Boundaries(x=side, y=side, z=Axis(self.bottom, "slip"))

    def changed(self, *, depth: float | None = None, dx: float | None = None, dt: float | None = None, **more: Any) -> "Domain":
        """The same box with another depth [m], cell [m] or time step [s], each as it is if None.

        A new cell keeps the size and, unless dt is given, dx / dt. Raises ConfigError: a length that is not positive.
        """
        given = {"depth": depth, "dx": dx, "dt": dt}
        length = {name: float(numbers(f"domain: {name}", v, low=1e-300)) for name, v in given.items() if v is not None}
        dx_new, (x, y, z) = length.get("dx", self.dx), self.size
        nx, ny, nz = (max(1, round(s / dx_new)) for s in (x, y, length.get("depth", z)))
        return replace(self, shape=(nx, ny, nz), dx=dx_new, dt=length.get("dt", self.dt * dx_new / self.dx), **more)

    def with_cells(self, dx: float | None) -> "Domain":
        """The same box with cells of dx [m]; None: as it is.

        The time step is nearest to the same dx / dt, divides a bus tick and is no longer than the robot's.
        """
        if dx is None:
            return self
        tick, longest = constant("timing", "bus_dt"), constant("timing", "physics_dt")
        return self.changed(dx=dx, dt=tick / max(round(tick / longest), round(tick * self.dx / (dx * self.dt))))


def tank(name: str, size, dx: float, dt: float, **more: Any) -> Domain:
    """Fixed box of `size` (3,) m. Raises ConfigError for a length that is not positive."""
    numbers("domain: size", size, (3,), low=1e-300), numbers("domain: dx", dx, low=1e-300)
    return Domain(name=name, shape=tuple(round(s / dx) for s in size), dx=dx, dt=dt, **more)


def _presets() -> dict[str, Domain]:
    dx, dt = constant("oracle", "dx"), constant("oracle", "dt")
    return {
        "paper": tank("paper", constant("oracle", "domain"), dx, dt),
        "forcemap": tank("forcemap", constant("oracle", "domain_force_map"), dx, dt),
        "flow_tank": tank("flow_tank", constant("tank", "size"), dx, dt),
        "window": Domain(name="window", shape=(192, 128, 80), dx=0.01, dt=0.002, follows=True),
        "window_fine": Domain(name="window_fine", shape=(384, 256, 160), dx=0.005, dt=0.001, follows=True),
        "window_coarse": Domain(name="window_coarse", shape=(112, 80, 50), dx=dx, dt=dt, follows=True),
        "laptop": Domain(name="laptop", shape=(80, 56, 30), dx=0.02, dt=0.004, follows=True),
    }


def _refined() -> dict[str, Domain]:
    """Presets with boxes of finer cells, under names that end as `BOXES` says."""
    plain, made = _presets(), {}
    for ending, (around, more) in BOXES.items():
        for name, first in around.items():
            made[name + ending] = replace(plain[name], name=name + ending, fine=first, finer=more)
    return made


PREVIEWS = ("laptop",)  # too coarse for a judgement
NAMES = ("paper", "forcemap", "flow_tank", "window", "window_fine", "window_coarse", "laptop")
REFINED = tuple(name + ending for ending, (around, _) in BOXES.items() for name in around)
EVERY = NAMES + REFINED


def preset(name: str) -> Domain:
    """Box by name: paper, forcemap, flow_tank, window, window_fine, window_coarse, laptop; paper_refined, paper_refined_twice
    and so on. Raises UnknownName: no box of that name.
    """
    table = _presets() | _refined()
    return table[checked_name("domain", name, table)]


class Follower:
    """Decides when a window moves."""

    def __init__(self, domain: Domain, heading: float = 0.0):
        self.domain, self.heading = domain, float(heading)

    def follow(self, fluid, position, heading: float) -> bool:
        """Moves the window by whole cells so that the fish at `position` (3,) m with `heading` rad keeps its place in it.

        Returns True if it moved, by a quarter of the window at most; most calls do not move it.
        """
        if not self.domain.follows:
            return False
        most = TURN * self.domain.dt
        self.heading += float(np.clip(wrap(np, heading - self.heading), -most, most))
        ahead = LEAD * np.array([self.domain.size[0] * cos(self.heading), self.domain.size[1] * sin(self.heading), 0.0])
        middle = fluid.lattice.to_si(fluid.origin_lu + (np.array(fluid.shape) - 1) / 2)
        off = (np.asarray(position, float) + ahead - middle) / self.domain.dx
        x, y = np.trunc(off).astype(int)[:2].tolist()
        if not (x or y):
            return False
        fluid.shift(tuple(int(np.clip(b, -(n // 4), n // 4)) for b, n in zip((x, y, 0), fluid.shape, strict=True)))
        return True


def margin(fluid, low, high) -> float:
    """Least distance in cells between a box of points, low and high (3,) m, and the faces of the fluid; negative outside."""
    dx, room = fluid.lattice.dx, float("inf")
    sides = zip(low, high, fluid.lattice.corner, fluid.origin_lu.tolist(), fluid.extent, strict=True)
    for a, b, corner, first, n in sides:  # plain numbers: a handful is faster so than in NumPy
        room = min(room, (a - corner) / dx - first, first + n - 1 - (b - corner) / dx)
    return float(room)
