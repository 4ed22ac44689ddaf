"""What a joint's sensor may read beside its angle, as a curve with one coefficient.

    r = a + c f(a)      r' = (1 + c f'(a)) a'      the servo turns the joint until r, not a, is what was commanded

Whose sensor it is decides what the log shows:

    servo reading     its own sensor errs, the log has the joint's angle from another one
    encoder reading   one sensor for both: the log has r

and the curves are those that sensors are known for:

    f = a               counts per turn; the first harmonic as far as a joint turns (sin a is a to within 6 % up to 35 degrees)
    f = a^2, a^3        a potentiometer or a linkage with a bent characteristic
    f = sin k a         a magnet off its axis, sine and cosine of unequal size, a field that is no pure sine: k = 2, 3, 4
"""

from collections.abc import Callable
from typing import NamedTuple


class ReadingCurve(NamedTuple):
    """f. value, slope: from the array namespace and the angle [rad]. parity: +1 even. size: usual in a session."""

    name: str
    value: Callable
    slope: Callable
    parity: int
    size: float


def harmonic(k: int) -> ReadingCurve:
    """The sine of k times the angle."""
    return ReadingCurve(f"sine of {k} x angle", lambda xp, a: xp.sin(k * a), lambda xp, a: k * xp.cos(k * a), -1, 0.7)


CURVES = (
    ReadingCurve("angle", lambda xp, a: a, lambda xp, a: 1.0, -1, 0.4),
    ReadingCurve("angle squared", lambda xp, a: a * a, lambda xp, a: 2.0 * a, 1, 0.16),
    ReadingCurve("angle cubed", lambda xp, a: a * a * a, lambda xp, a: 3.0 * a * a, -1, 0.064),
    *(harmonic(k) for k in (2, 3, 4)),
)


def in_the_loop(curve: ReadingCurve) -> dict[str, Callable]:
    """The sites of a servo reading."""

    def servo(xp, p, s, memory, h):
        error = s.error - p.coefficient * curve.value(xp, s.angle)
        return s._replace(error=error, rate=s.rate * (1.0 + p.coefficient * curve.slope(xp, s.angle))), memory

    return {"servo": servo}


def in_the_log_too(curve: ReadingCurve) -> dict[str, Callable]:
    """The sites of an encoder reading."""

    def measure(xp, p, seen):
        if not xp.any(p.coefficient):  # whole records of many fish, nearly all of which have another term
            return seen
        more = xp.expand_dims(p.coefficient + 0.0, -1) * curve.value(xp, seen.joint)
        return seen._replace(joint=seen.joint + more)

    return in_the_loop(curve) | {"measure": measure}
