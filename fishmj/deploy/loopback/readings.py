"""Sensor readings of the loopback's microcontroller."""

from math import nan
from typing import NamedTuple

from fishmj.deploy.protocols.messages import ServoFault


class Readings(NamedTuple):
    """Readings of the microcontroller's buses. J joints."""

    joint: tuple[float, ...]  # rad, whole counts
    voltage: float  # V, battery lead
    current: float  # A, battery lead
    servo_voltage: tuple[float, ...]  # V
    temperature: tuple[float, ...]  # deg C
    fault: tuple[ServoFault, ...]  # of the servos themselves, and NO_REPLY

    @property
    def measured(self) -> tuple[float, ...]:
        """Joint angles (J,) rad; nan for a servo that did not answer, whose `joint` is an old one."""
        return tuple(nan if flag & ServoFault.NO_REPLY else angle for angle, flag in zip(self.joint, self.fault, strict=True))
