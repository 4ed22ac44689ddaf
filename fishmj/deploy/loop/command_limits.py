"""Limits of a joint command: the servo's range, and the distance that the joint can turn before the command arrives.

    c' = clip(c, +-range),   |c' - j| <= rate (min(age, oldest) + ahead)

j is the measured joint, `age` s old. `oldest` is the age at which the link counts as silent and steering stops. `ahead` is the
time until the command acts: latency and one tick. So neither a jump of the policy nor a joint that was pushed aside without
commands ever causes a faster motion than the servo's own 5.2 rad/s.
"""

import numpy as np

RATE = 5.2  # rad/s, an LX-824 without load at 7.4 V (0.2 s for 60 degrees)
HOME_RATE = 1.047  # rad/s on the way to zero, as the firmware's own: 60 degrees in 1 s


class Limiter:
    """Limits of one robot.

    Args:
        reach: commands stay within +- this, rad. ahead: time until a command that is sent now acts, s. rate: rad/s. oldest: s.

    Attributes:
        acted: number of changed commands so far.
    """

    def __init__(self, reach: float, ahead: float, rate: float = RATE, oldest: float = 0.3):
        self.range, self.ahead, self.rate, self.oldest, self.acted = reach, ahead, rate, oldest, 0

    def __call__(self, wanted: np.ndarray, measured: np.ndarray, age: float) -> np.ndarray:
        """The nearest allowed command (J,) rad; `measured` (J,) rad, `age` s old."""
        far = self.rate * (min(max(age, 0.0), self.oldest) + self.ahead)
        measured = np.where(np.isfinite(measured), measured, 0.0)  # a bad reading ends the swim; until then, near the middle
        allowed = np.clip(np.clip(wanted, measured - far, measured + far), -self.range, self.range)
        self.acted += bool(np.any(np.abs(allowed - wanted) > 1e-9))
        return allowed


def towards_zero(last: np.ndarray, dt: float) -> np.ndarray:
    """The next command (J,) rad on the way from `last` to zero, `dt` s later."""
    return last - np.clip(last, -HOME_RATE * dt, HOME_RATE * dt)
