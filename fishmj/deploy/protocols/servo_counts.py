"""Conversion of servo counts to SI: the one place for units and offsets. `LX` is the default scale.

    angle = (counts - 500 - zero) x 0.24 deg          0..1000 counts <-> 0..240 deg
    trim  = offset x 0.24 deg                            -125..125 counts <-> -30..30 deg, kept in the servo itself
    time in ms, temperature in deg C

`zero` is the position of a straight joint, counted from the middle: assembly leaves an offset, and each joint has its own.
"""

import math

from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.mjcf.servo_buses import LX, Scale

SPAN, _, RAD_PER_COUNT = LX  # counts of the whole range
MOST_OFFSET = 125  # counts, 30 deg
MOST_TIME = 30_000  # ms, of one move
VOLTAGE = (4500, 12_000)  # mV, bounds of a voltage limit


def counts(angle: float, zero: float = 0.0, scale: Scale = LX) -> int:
    """The servo position nearest to a joint angle.

    Args:
        angle: rad, 0 = straight. zero: servo angle from its middle for a straight joint, rad.
        scale: of the servo.
    Returns: 0 to `scale.span`; clamped beyond the servo's range.
    Raises: ProtocolError if the sum is not finite.
    """
    if not math.isfinite(angle + zero):
        raise ProtocolError(f"joint angle {angle} rad, zero {zero} rad; expected finite numbers")
    exact = scale.centre + (angle + zero) / scale.step
    return round(max(0.0, min(float(scale.span), exact)))


def angle(position: int, zero: float = 0.0, scale: Scale = LX) -> float:
    """The joint angle, rad, of a position in counts; servos may report counts below 0 and above their span, too."""
    return (position - scale.centre) * scale.step - zero


def move_time(distance: float, speed: float) -> int:
    """Duration of a move over `distance`, rad, at `speed`, rad/s, in ms; at most 30 s, the longest that a servo counts.

    Raises ProtocolError if the speed is not positive, or a value not finite.
    """
    if not (math.isfinite(distance) and math.isfinite(speed) and speed > 0):
        raise ProtocolError(f"move over {distance} rad at {speed} rad/s; expected finite numbers and a speed above 0")
    return round(min(float(MOST_TIME), abs(distance) / speed * 1000))
