"""Faults that the robot's firmware finds in its servos and its battery, as bits. The C code in `firmware/guard.c` equals it.

    STUCK     a joint under torque has been further than `far` from its target for `stuck` s and moved less than `still`
    HOT       a servo is at `hot` deg C or above
    VOLTAGE   each reading of the battery has been below `low` for `sag` s; all joints get the bit

It only reports. The host decides which fault ends a swim, because it knows the fish's next motion. A robot whose
host is gone ends in NEUTRAL without torque, whatever its faults are (`fishmj.deploy.protocols.watchdog`).
Time is that of the caller's clock, in s, and counted in whole microseconds like a microcontroller's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fishmj.base.errors import ConfigError
from fishmj.deploy.protocols.messages import ServoFault
from fishmj.deploy.protocols.watchdog import microseconds


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Thresholds of the faults.

    Attributes:
        far, still: rad. stuck: s. hot: deg C; LX servos let go at 85. low: V, two LiPo cells at 3.2 V under load. sag: s; a
            kick of the tail lowers the voltage for less.
    """

    far: float = math.radians(10.0)
    still: float = math.radians(1.0)
    stuck: float = 0.3
    hot: float = 75.0
    low: float = 6.4
    sag: float = 1.0

    def __post_init__(self) -> None:
        bounds = (self.far, self.still, self.stuck, self.hot, self.low, self.sag)
        if not all(math.isfinite(value) and value > 0 for value in bounds):
            raise ConfigError(f"bounds {bounds}; expected far, still, stuck, hot, low and sag above 0, in rad, s, deg C and V")


class Guard:
    """Guard of a robot, as described at the top. Args: joints: J, 1 to 8. Raises: ConfigError for another number."""

    def __init__(self, joints: int, bounds: Bounds | None = None):
        if not 1 <= joints <= 8:
            raise ConfigError(f"guard of {joints} joints; expected 1 to 8")
        self.bounds = bounds or Bounds()
        self._away: list[tuple[int, float] | None] = [None] * joints  # since when (us), and where (rad) a joint is off its target
        self._low: int | None = None  # us, since when the battery is low

    def check(
        self, now: float, target: Sequence[float] | None, measured: Sequence[float],
        temperature: Sequence[float] | None = None, voltage: float | None = None,
    ) -> tuple[ServoFault, ...]:  # fmt: skip
        """Faults of each joint, (J,); call it once for each reading of the servos.

        Args:
            target: servos' targets, rad, (J,); None: they have no torque. measured: rad, (J,), nan for a silent servo.
            temperature: deg C, (J,). voltage: V, of the battery. None: not read.
        """
        at = microseconds(now)
        if voltage is None or not voltage < self.bounds.low:
            self._low = None
        elif self._low is None:
            self._low = at
        low = self._low is not None and at - self._low >= microseconds(self.bounds.sag)
        found = []
        for k, angle in enumerate(measured):
            fault = ServoFault.VOLTAGE if low else ServoFault.NONE
            if temperature is not None and temperature[k] >= self.bounds.hot:
                fault |= ServoFault.HOT
            if self._is_stuck(k, at, None if target is None else target[k], angle):
                fault |= ServoFault.STUCK
            found.append(fault)
        return tuple(found)

    def _is_stuck(self, k: int, at: int, target: float | None, angle: float) -> bool:
        away = self._away[k]
        if target is None or not abs(target - angle) > self.bounds.far:  # a silent servo is not known to be far
            self._away[k] = None
        elif away is None or abs(angle - away[1]) > self.bounds.still:
            self._away[k] = at, angle
        away = self._away[k]
        return away is not None and at - away[0] >= microseconds(self.bounds.stuck)
