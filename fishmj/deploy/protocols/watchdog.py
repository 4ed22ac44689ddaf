"""The watchdog in the robot's firmware, for a lost host. The C code in `firmware/watchdog.c` equals it.

    IDLE -- arm --> ARMED -- no command for `hold` s --> HOLD -- none for `neutral` s --> NEUTRAL
                      ^------------- a command ------------'
    ARMED, HOLD -- fault --> NEUTRAL          any state -- disarm --> IDLE

The host cannot protect a fish that it cannot reach, so the robot counts for itself: from the moment it was armed, and from each
accepted command. In HOLD the target stays. In NEUTRAL joints go to zero at a limited rate, then lose their
torque, and commands are refused; only DISARM ends it. The torque goes off if

    all targets are zero, and each joint is within `near` of it,   or   `rest` s have passed in NEUTRAL:

otherwise a fish whose host died would stay under torque until its battery is flat. The target that `step` returns

    moves     by at most rate dt, from its last value (from the measured joint at the moment of arming)
    leads     the measured joint by at most `lead`: a stuck servo that comes free does not jump
    stays     within +- servo_range

in this order, so that the last always holds. dt is the time since the last step, at most 0.1 s: a late loop is not caught up.

Time is that of the caller's clock, in s, and counted in whole microseconds like a microcontroller's. Nothing here reads a clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fishmj.base.errors import ConfigError
from fishmj.deploy.protocols.messages import RobotState

LONGEST = 2.0  # s without a command that a robot may be asked to bear; the fish drifts 0.6 m in that time at 0.3 m/s
LATE = 100_000  # us, the longest dt
AT_ZERO = 1e-3  # rad, a quarter of a servo's count: what rounding leaves of a target that is on its way to zero


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits in a robot's firmware.

    Attributes:
        servo_range: rad, targets stay within +- this. rate: rad/s, of targets that follow commands. neutral_rate: rad/s, of
            joints on their way to zero. lead: rad, of the target before the measured joint. near: rad, largest distance of a
            joint that counts as arrived. rest: s in NEUTRAL after which the torque goes off wherever the joints are.

        The default rate is a LX-824's no-load speed (0.2 s for 60 deg). `lead` is the motion of such a servo in 0.1 s, five bus
        ticks: a reading is one or two ticks old, and a shorter lead would take torque from a healthy servo. `near` is eight
        counts: a geared servo under load stops some counts short. From 60 deg a healthy joint is at zero after 1 s; `rest` gives
        it five times as long, and a joint that is stuck or silent gets no more than that.
    """

    servo_range: float = math.radians(60.0)
    rate: float = math.radians(300.0)
    neutral_rate: float = math.radians(60.0)
    lead: float = math.radians(30.0)
    near: float = math.radians(2.0)
    rest: float = 5.0

    def __post_init__(self) -> None:
        bounds = (self.servo_range, self.rate, self.neutral_rate, self.lead, self.near, self.rest)
        if not all(math.isfinite(value) and value > 0 for value in bounds):
            names = "servo_range, rate, neutral_rate, lead, near and rest"
            raise ConfigError(f"limits {bounds}; expected {names} above 0, in rad, rad/s and s")


def microseconds(seconds: float) -> int:
    """Converts a time in s to whole microseconds, as the firmware counts."""
    return round(seconds * 1e6)


class Watchdog:
    """The watchdog of one robot, as described at the top. J joints, from the head to the tail.

    Args:
        joints: J. limits: see `Limits`. hold, neutral: s, the values in INFO before the first request.

    Attributes:
        state: of the robot. target: rad, (J,), the last result of `step`. rested: NEUTRAL has switched the torque off.
        hold, neutral: s, the times in force.
    """

    def __init__(self, joints: int = 3, limits: Limits | None = None, *, hold: float = 0.1, neutral: float = 0.3):
        if not 1 <= joints <= 8:
            raise ConfigError(f"watchdog of {joints} joints; expected 1 to 8")
        if not times_are_sound(hold, neutral):
            raise ConfigError(f"watchdog times hold {hold} s, neutral {neutral} s; expected 0 < hold < neutral <= {LONGEST} s")
        self.limits = limits or Limits()
        self.state = RobotState.IDLE
        self.target: tuple[float, ...] = (0.0,) * joints
        self.rested = False
        self._neutral_since: int | None = None  # us, of the first step in NEUTRAL
        self._hold, self._neutral = microseconds(hold), microseconds(neutral)
        self._goal, self._speed = self.target, (self.limits.rate,) * joints
        self._heard = self._stepped = 0  # us: of the newest command, of the newest step

    @property
    def hold(self) -> float:
        """Time without a command until HOLD, s."""
        return self._hold / 1e6

    @property
    def neutral(self) -> float:
        """Time without a command until NEUTRAL, s."""
        return self._neutral / 1e6

    def arm(self, now: float, hold: float, neutral: float, measured: Sequence[float]) -> bool:
        """IDLE -> ARMED, with the target at the measured joints, rad, (J,). Returns True if the robot armed.

        It refuses, and nothing changes, in any other state; with times that are not 0 < hold < neutral <= LONGEST; if a joint was
        not measured (nan); and if one is beyond the range by more than `near`: its zero is wrong, or it was bent, and the way
        back into the range would be a jump.
        """
        if self.state is not RobotState.IDLE or not times_are_sound(hold, neutral):
            return False
        if len(measured) != len(self.target) or not all(math.isfinite(angle) for angle in measured):
            return False
        most = self.limits.servo_range
        if max(map(abs, measured)) > most + self.limits.near:
            return False
        self._hold, self._neutral = microseconds(hold), microseconds(neutral)
        self.target = self._goal = tuple(_within(angle, -most, most) for angle in measured)
        self._speed = (self.limits.rate,) * len(self.target)
        self._heard = self._stepped = microseconds(now)
        self.rested, self._neutral_since = False, None
        self.state = RobotState.ARMED
        return True

    def disarm(self) -> None:
        """Any state -> IDLE."""
        self.state = RobotState.IDLE

    def fault(self) -> None:
        """ARMED, HOLD -> NEUTRAL, on a fault that the firmware found."""
        if self.state in (RobotState.ARMED, RobotState.HOLD):
            self.state = RobotState.NEUTRAL

    def command(self, now: float, joint: Sequence[float], speed: Sequence[float] | None = None) -> bool:
        """Takes a command: joint angles in rad, (J,), and the largest speed of each, rad/s (None: the limit).

        Returns: True if it was taken. It is refused in IDLE and NEUTRAL, and with another number of joints. A value that is not
        finite, or a speed that is not positive, is a fault.
        """
        self._expire(microseconds(now))
        if self.state not in (RobotState.ARMED, RobotState.HOLD) or len(joint) != len(self.target):
            return False
        most, rate = self.limits.servo_range, self.limits.rate
        speeds = (rate,) * len(joint) if speed is None else tuple(speed)
        fine = len(speeds) == len(joint) and all(math.isfinite(x) for x in (*joint, *speeds)) and min(speeds) > 0
        if not fine:
            self.fault()
            return False
        self._goal = tuple(_within(angle, -most, most) for angle in joint)
        self._speed = tuple(min(rate, value) for value in speeds)
        self._heard = microseconds(now)
        self.state = RobotState.ARMED
        return True

    def step(self, now: float, measured: Sequence[float]) -> tuple[float, ...] | None:
        """Targets of the servos now, rad, (J,); None in IDLE and at the end of NEUTRAL: the torque goes off.

        Args:
            measured: rad, (J,); nan for a joint that did not answer: its target is bound neither to it nor to an impossible angle
                (beyond +- pi).
        """
        at = microseconds(now)
        self._expire(at)
        dt = _within(at - self._stepped, 0, LATE) / 1e6
        self._stepped = at
        if self.state is RobotState.IDLE:
            return None
        limits, count = self.limits, len(self.target)
        goals, speeds = self._goal, self._speed
        if self.state is RobotState.HOLD:
            goals = self.target
        elif self.state is RobotState.NEUTRAL:
            goals, speeds = (0.0,) * count, (limits.neutral_rate,) * count
            self._rest(at, measured)
        if self.rested:
            return None
        self.target = tuple(self._towards(k, goals[k], speeds[k] * dt, measured[k]) for k in range(count))
        return self.target

    def _rest(self, at: int, measured: Sequence[float]) -> None:
        """Updates `rested`: True once NEUTRAL has reached zero or its time limit, until the next arming."""
        since = self._neutral_since = at if self._neutral_since is None else self._neutral_since
        there = all(abs(angle) <= AT_ZERO for angle in self.target)
        there = there and all(abs(angle) <= self.limits.near for angle in measured)  # nan is not
        self.rested = self.rested or there or at - since >= microseconds(self.limits.rest)

    def _towards(self, k: int, goal: float, most: float, measured: float) -> float:
        before, limits = self.target[k], self.limits
        angle = before + _within(goal - before, -most, most)
        if abs(measured) <= math.pi:  # nan is not
            angle = _within(angle, measured - limits.lead, measured + limits.lead)
        return _within(angle, -limits.servo_range, limits.servo_range)

    def _expire(self, at: int) -> None:
        """ARMED -> HOLD -> NEUTRAL after the times without a command."""
        silent = at - self._heard
        if self.state in (RobotState.ARMED, RobotState.HOLD):
            if silent >= self._neutral:
                self.state = RobotState.NEUTRAL
            elif silent >= self._hold:
                self.state = RobotState.HOLD


def times_are_sound(hold: float, neutral: float) -> bool:
    """Returns True if a firmware accepts these watchdog times, in s."""
    finite = math.isfinite(hold) and math.isfinite(neutral)
    return finite and 0 < microseconds(hold) < microseconds(neutral) <= microseconds(LONGEST)


def _within(value: float, low: float, high: float) -> float:
    return max(low, min(high, value))
