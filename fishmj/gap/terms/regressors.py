"""What a term may be made of: quantities of the motion with their dimension, their mirror parity and their usual size.

dimension   power of 1/s once lengths are taken out by the fish's length L: an inertial force rho L^n x product needs two
parity      +1 even, -1 odd when port and starboard are exchanged
"""

from collections.abc import Callable
from typing import NamedTuple

from fishmj.gap.thresholds import thresholds


class Factor(NamedTuple):
    """One quantity. value: from the array namespace and a `BodyMotion`, `Gear` or `LocalWater`. size: usual in a session, SI."""

    name: str
    value: Callable
    per_second: int
    parity: int
    size: float


SURGE = Factor("surge speed", lambda xp, b: b.u, 1, 1, 0.2)
SWAY = Factor("sway speed", lambda xp, b: b.w, 1, -1, 0.06)
YAW = Factor("yaw rate", lambda xp, b: b.r, 1, -1, 0.6)
TAIL = Factor("tail rate", lambda xp, b: b.swing, 1, -1, 4.0)
BEND = Factor("tail angle", lambda xp, b: b.bend, 0, -1, 0.8)
MOTION = (SURGE, SWAY, YAW, TAIL)

ANGLE = Factor("angle", lambda xp, g: g.angle, 0, -1, 0.4)
RATE = Factor("rate", lambda xp, g: g.rate, 1, -1, 2.5)
LOAD = Factor("motor torque", lambda xp, g: g.drive, 0, -1, 0.4)

TIP = thresholds().library.trailing_edge
SLIP = Factor("tail speed sideways", lambda xp, k: k.w[-1] + k.omega[-1] * TIP, 1, -1, 0.3)
AHEAD = Factor("tail speed ahead", lambda xp, k: k.u[-1], 1, 1, 0.2)

X = Factor("place x", lambda xp, b: b.x, 0, 0, 1.0)  # parity 0: the tank has no mirror
Y = Factor("place y", lambda xp, b: b.y, 0, 0, 1.0)
TIME = Factor("session time", lambda xp, b: b.time, 0, 1, 8.0)


def signed(f: Factor) -> Factor:
    """The square with the sign of its root: f |f|."""
    return Factor(
        f"{f.name} squared, signed", lambda xp, b: f.value(xp, b) * xp.abs(f.value(xp, b)), 2 * f.per_second, f.parity, f.size**2
    )


def product(*factors: Factor) -> Factor:
    """All of them multiplied; equal ones are written as a power."""
    names: dict[str, int] = {}
    for f in factors:
        names[f.name] = names.get(f.name, 0) + 1
    words = {1: "", 2: " squared", 3: " cubed"}

    def value(xp, b):
        out = factors[0].value(xp, b)
        for f in factors[1:]:
            out = out * f.value(xp, b)
        return out

    parity = 1
    size = 1.0
    for f in factors:
        parity *= f.parity
        size *= f.size
    name = " x ".join(name + words[n] for name, n in names.items())
    return Factor(name, value, sum(f.per_second for f in factors), parity, size)
