"""Derives the supervisor's conditions from packets and fixes: every threshold of the host, each with its reason.

Ages are taken at every tick. The loop adds the operator's requests and the policy's answer.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, pi

import numpy as np

from fishmj.deploy.loop.observation import ObservationBuilder
from fishmj.deploy.loop.supervisor import NONE, Condition, SwimState
from fishmj.deploy.protocols.messages import RobotState, ServoFault, Telemetry


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds at which a measurement becomes a condition. s, V, deg C, rad."""

    quiet: float = 0.1  # five packets missing
    silent: float = 0.3  # a step of the policy and a half
    pose_old: float = 0.2  # one step of the policy
    pose_lost: float = 0.5
    settle: float = 0.5  # after arming, until commands must be echoed: more than any radio's way there and back
    battery_low: float = 6.4  # two LiPo cells at 3.2 V under load; a swim takes its robot's (`Robot.low_voltage`)
    sag: float = 1.0  # the battery is low when no reading of this time is above: a sag under a kick is none
    hot: float = 75.0  # LX servos switch off by themselves at 85
    stuck_after: float = 0.6  # that joint and commands are watched for
    stuck_answer: float = 0.15  # that a joint has to follow a step, besides the command's latency
    stuck_asked: float = 0.3  # rad that commands move meanwhile,
    stuck_share: float = 0.15  # of which a stuck joint follows less: healthy ones 0.27 and more in 90 s of loopback swims
    stuck_moved: float = 0.05  # rad; or it moves less than this,
    stuck_off: float = 0.25  # rad away from the commands on average: at 0.21 rad the servo already pulls with all its torque
    wildest: float = pi  # rad; no joint turns further
    absent: float = 3.0  # s after which a measurement that came once and comes no more counts as none


class ConditionWatch:
    """State behind the conditions.

    Attributes:
        heard: s, arrival of the newest packet; None before the first. answered: s, when the robot last echoed a new command.
        newest: the newest telemetry. first: s, arrival of the first one.
    """

    def __init__(self, thresholds: Thresholds):
        self.limits = thresholds
        self.heard: float | None = None
        self.newest: Telemetry | None = None
        self.first: float | None = None
        self._told: dict[str, float] = {}
        self.reset()

    def reset(self) -> None:
        """Forgets the data of one swim; the link's stay."""
        self.armed: float | None = None
        self.answered: float | None = None
        self.ever_answered = False
        self._echo: int | None = None
        self._volts: deque[tuple[float, float]] = deque()
        self._motion: deque[tuple[float, np.ndarray, np.ndarray]] = deque()

    def hear(self, t: float, packet: Telemetry, asked: np.ndarray | None) -> None:
        """Adds one packet that arrived at `t`; asked: (J,) the newest command that can have acted by then, None for none."""
        self.heard, self.newest = t, packet
        self.first = t if self.first is None else self.first
        self._told |= {guard: t for guard, told in GUARDS.items() if told(packet)}
        if packet.echo is not None:
            self.ever_answered = True
            if packet.echo != self._echo:
                self._echo, self.answered = packet.echo, t
        if (volts := supply(packet)) is not None:
            self._volts.append((t, volts))
        while self._volts and self._volts[0][0] < t - self.limits.sag:
            self._volts.popleft()
        joint = np.array(packet.joint)
        if self._motion and t - self._motion[-1][0] > self.limits.quiet:
            self._motion.clear()  # a joint that nobody looked at may have moved
        if asked is None or not np.isfinite(joint).all():
            self._motion.clear()
        else:
            self._motion.append((t, joint, np.array(asked)))
            while self._motion and self._motion[0][0] < t - self.limits.stuck_after:
                self._motion.popleft()

    def unguarded(self, now: float) -> tuple[str, ...]:
        """Conditions that cannot become true at `now`, since the robot does not report their inputs, a phrase each."""
        never = -float("inf")
        return tuple(guard for guard in GUARDS if now - self._told.get(guard, never) > self.limits.absent)

    def conditions(self, now: float, state: SwimState, observer: ObservationBuilder) -> Condition:
        """Conditions that are true at `now` [s]."""
        active = state in (SwimState.ARMED, SwimState.SWIMMING)
        if active and self.armed is None:
            self.armed = now
        return self._link(now, active) | self._robot(active) | self._pose(now, state, observer)

    def _link(self, now: float, active: bool) -> Condition:
        limits = self.limits
        silence = now - self.heard if self.heard is not None else float("inf")
        unanswered = 0.0
        if active and self.ever_answered and self.armed is not None:
            begin = self.armed + limits.settle
            unanswered = now - max(begin, self.answered if self.answered is not None else begin)
        worst = max(silence, unanswered)
        found = Condition.HEARD if silence <= limits.quiet else NONE
        found |= Condition.LINK_QUIET if worst > limits.quiet else NONE
        return found | (Condition.LINK_SILENT if worst > limits.silent else NONE)

    def _pose(self, now: float, state: SwimState, observer: ObservationBuilder) -> Condition:
        pose, limits = observer.pose, self.limits
        age = now - pose.t if pose is not None else float("inf")
        if state is SwimState.SWIMMING and observer.changed is not None:  # no fish that swims, and no picture, stays the same
            age = now - observer.changed
        found = Condition.POSE_OLD if age > limits.pose_old else NONE
        found |= Condition.POSE_LOST if age > limits.pose_lost else NONE
        return found | (Condition.POSE_JUMP if observer.jumped else NONE)

    def _robot(self, active: bool) -> Condition:
        packet, limits, found = self.newest, self.limits, NONE
        if packet is None:
            return found
        if not all(isfinite(angle) and abs(angle) <= limits.wildest for angle in packet.joint):
            found |= Condition.READING_BAD
        faults = ServoFault(0)
        for fault in packet.fault or ():
            faults |= fault
        hot = packet.temperature is not None and max(packet.temperature) >= limits.hot
        if hot or ServoFault.HOT in faults:
            found |= Condition.SERVO_HOT
        if ServoFault.NO_REPLY in faults:
            found |= Condition.SERVO_LOST
        if ServoFault.LOCKED in faults or ServoFault.STUCK in faults or self._stuck():
            found |= Condition.SERVO_STUCK
        if ServoFault.VOLTAGE in faults or self._low():
            found |= Condition.BATTERY_LOW
        if active and packet.state in (RobotState.NEUTRAL, RobotState.IDLE):
            found |= Condition.ROBOT_NEUTRAL
        if active and packet.state is RobotState.HOLD:
            found |= Condition.LINK_QUIET
        return found

    def _low(self) -> bool:
        """Returns True if no reading of the last second is above the limit, once there is a second of them."""
        if not self._volts or self._volts[-1][0] - self._volts[0][0] < 0.9 * self.limits.sag:
            return False
        return max(volts for _, volts in self._volts) < self.limits.battery_low

    def undecided(self, now: float) -> bool:
        """Returns True while the newest voltage is too low and the readings are too few to rule out a sag."""
        volts = supply(self.newest) if self.newest is not None else None
        if volts is None or volts >= self.limits.battery_low or self.first is None:
            return False
        return now - self.first < self.limits.sag + self.limits.quiet

    def battery(self) -> str:
        """The newest voltage beside its limit, for a line that names BATTERY_LOW."""
        volts = supply(self.newest) if self.newest is not None else None
        text = f"{volts:.2f} V, " if volts is not None else ""
        return f"{text}low_voltage is {self.limits.battery_low:g} V: charge it, or state the bound of this battery in [rig]"

    def _stuck(self) -> bool:
        """Returns True if a joint hardly moves while its commands do, or stands still away from them."""
        limits, motion = self.limits, self._motion
        if not motion or motion[-1][0] - motion[0][0] < 0.9 * limits.stuck_after:
            return False
        joint, asked = (np.array([row[k] for row in motion]) for k in (1, 2))
        old = np.array([row[0] for row in motion]) <= motion[-1][0] - limits.stuck_answer
        moved, wanted = np.ptp(joint, 0), np.ptp(asked[old], 0)
        away = np.abs(joint - asked).mean(0) > limits.stuck_off
        lags = (wanted > limits.stuck_asked) & (moved < limits.stuck_share * wanted)
        return bool(np.any(lags | (away & (moved < limits.stuck_moved))))


def warmth(packet: Telemetry) -> bool:
    """Returns True if the temperatures of all servos are reported."""
    return packet.temperature is not None and all(map(isfinite, packet.temperature))


def supply(packet: Telemetry) -> float | None:
    """The battery's voltage in V, or the servos' mean; None if the robot reports none."""
    if packet.voltage is not None:
        return packet.voltage
    readings = [volts for volts in packet.servo_voltage or () if volts > 0]
    return sum(readings) / len(readings) if readings else None


GUARDS: dict[str, Callable[[Telemetry], bool]] = {
    "BATTERY_LOW (no voltage)": lambda packet: supply(packet) is not None,
    "SERVO_HOT (no temperatures)": warmth,
    "SERVO_LOST (no servo faults)": lambda packet: packet.fault is not None,
    "ROBOT_NEUTRAL (no state)": lambda packet: packet.state is not None,
}
