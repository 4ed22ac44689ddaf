"""Servo buses that a description may name: line speed, servo numbers, and the angle of a servo count in rad.

    bus = BUSES["dynamixel-x"]
    bus.travel                      travel of a servo to either side of its middle, rad

The bytes of each are in `fishmj.deploy.protocols.servo_bus`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple


class Scale(NamedTuple):
    """Counts of one kind of servo. span: the largest. centre: the middle of its travel. step: rad a count."""

    span: int
    centre: int
    step: float


LX = Scale(1000, 500, math.radians(240.0) / 1000)
X = Scale(4095, 2048, 2 * math.pi / 4096)  # Dynamixel X series: one turn
AX = Scale(1023, 512, math.radians(300.0) / 1023)  # Dynamixel AX series: 300 deg


class BusFacts(NamedTuple):
    """A kind of servo bus.

    Attributes:
        name: as in `[rig] bus`. baud: the default. most_id: largest number of a servo. scale: of its counts.
    """

    name: str
    baud: int
    most_id: int
    scale: Scale

    @property
    def travel(self) -> float:
        """Travel of a servo to either side of its middle, rad."""
        return min(self.scale.centre, self.scale.span - self.scale.centre) * self.scale.step


BUSES = {
    facts.name: facts
    for facts in (
        BusFacts("lx", 115_200, 253, LX),
        BusFacts("dynamixel-x", 1_000_000, 252, X),
        BusFacts("dynamixel-ax", 1_000_000, 253, AX),
    )
}

NEARER = "mount its horn nearer to the middle, or give [servo] a smaller range"  # remedy for `beyond_travel`


def beyond_travel(facts: BusFacts, zeros: Sequence[float], reach: float) -> str:
    """Text on the largest of `zeros` and the commands to `reach`, rad, if together they leave the servo's travel; else ""."""
    most = max(map(abs, zeros), default=0.0)
    within = most + reach <= facts.travel + 1e-9
    return "" if within else f"a zero of {math.degrees(most):.3g} deg and commands of +-{math.degrees(reach):.3g} deg"
