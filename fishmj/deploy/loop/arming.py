"""Conditions for torque: the robot matches the policy, and it has a watchdog.

A robot without a watchdog keeps swimming after the host is gone. It is armed only after a person has confirmed to stand at the
tank.
"""

from collections.abc import Callable, Sequence
from math import degrees, isfinite
from typing import NamedTuple

from fishmj.control.learned import LearnedController
from fishmj.deploy.link.links import RobotLink
from fishmj.deploy.loop.supervisor import NONE, Condition
from fishmj.deploy.loop.watch import Thresholds
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.watchdog import LONGEST as BEARABLE
from fishmj.deploy.protocols.watchdog import Limits, times_are_sound
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import structure_of

LONGEST = 1.0  # s; a firmware that waits longer for a command before it goes to neutral guards nothing
SAME = 1e-3  # of the servo range
QUESTION = "This robot has no watchdog: it keeps moving when the host is gone. Do you stand at the tank, a hand on its switch?"


class Refusal(NamedTuple):
    """Reasons against arming: conditions for the supervisor, and a sentence each for people."""

    conditions: Condition
    reasons: tuple[str, ...]


def examine(
    link: RobotLink, info: RobotInfo | None, robot: Robot, controller: LearnedController | None, at_the_tank: bool
) -> Refusal:  # fmt: skip
    """Compares the robot's identification with the description and the policy (None: no policy).

    Without objection: (NONE, ()).
    """
    found, reasons = NONE, []
    ours = structure_of(robot)["joints"]
    if "joint angles" in link.lacks:
        found |= Condition.POLICY_MISMATCH
        reasons.append(f"{link.name} reports every joint as 0; a policy needs their angles: put fixed firmware on the robot")
    if info is not None:
        if list(info.joints) != ours:
            found |= Condition.POLICY_MISMATCH
            reasons.append(f"the robot's joints are {', '.join(info.joints)}; the policy is for {', '.join(ours)}, in this order")
        if abs(info.servo_range / robot.servo.range - 1) > SAME:
            found |= Condition.POLICY_MISMATCH
            mine = f"{robot.name}'s are +-{robot.servo.range:.4g}"
            reasons.append(f"the robot's servos are bounded to +-{info.servo_range:.4g} rad, {mine}; a policy sees that range")
        if controller is not None and info.policy_sha256 and info.policy_sha256 != controller.sha256:
            found |= Condition.POLICY_MISMATCH
            there, here = info.policy_sha256[:12], controller.sha256[:12]
            reasons.append(
                f"the firmware carries policy {there}, the host {controller.name} {here}; flash one, or load the other"
            )
    timed = info is not None and 0 < info.hold < info.neutral <= LONGEST
    if link.watched and not timed or not link.watched and not at_the_tank:  # nobody stands in for a watchdog that acts wrongly
        found |= Condition.WATCHDOG_MISSING
        if not link.watched:
            reasons.append(f"{link.name} has no watchdog; add --i-am-at-the-tank once a person stands there")
        elif info is not None:
            reasons.append(f"the firmware goes to neutral only after {info.neutral:g} s; expected above 0 to {LONGEST:g} s")
        else:
            reasons.append("the robot has not said when its watchdog acts")
    return Refusal(found, tuple(reasons))


def asked_at_the_tank(link: RobotLink, said: bool, ask: Callable[[str], bool]) -> bool:
    """Returns True if a person stands at the tank: `said` on the command line, or answered now; asks only if it matters."""
    return said or (not link.watched and ask(QUESTION))


FAULTY = {
    ServoFault.NO_REPLY: "does not answer", ServoFault.HOT: "is hot", ServoFault.LOCKED: "is locked", ServoFault.STUCK: "is stuck"
}  # fmt: skip


def servos_at_fault(newest: Telemetry | None, ids: Sequence[int], thresholds: Thresholds) -> str:
    """Text such as `servo 9 (joint 3 from the head) is hot`, "" without a fault; ids: on the bus, from the head to the tail."""
    if newest is None:
        return ""
    found = [(k, what) for k, fault in enumerate(newest.fault or ()) for bit, what in FAULTY.items() if bit in fault]
    found += [(k, f"has {c:.0f} deg C") for k, c in enumerate(newest.temperature or ()) if c >= thresholds.hot]
    found += [(k, f"reports {a:.3g} rad") for k, a in enumerate(newest.joint) if not abs(a) <= thresholds.wildest]
    return ", ".join(f"servo {ids[k] if k < len(ids) else '?'} (joint {k + 1} from the head) {what}" for k, what in sorted(found))


def why_not_armed(newest: Telemetry | None, servo_range: float, hold: float, neutral: float) -> str:
    """Reason that a robot did not arm on request, as the end of a line; "" if it reports nothing about itself.

    The robot answers ARM with INFO and its state, not with a reason. The rules are those of `protocols.watchdog`. Their inputs
    are in the telemetry: state, joints, servos that do not answer.

    Args:
        newest: telemetry. servo_range: rad. hold, neutral: s, the times in the request.
    """
    if newest is None or newest.state is None:
        return ""
    text = f"; it says {newest.state.name}"
    if newest.state is not RobotState.IDLE:
        return text
    if not times_are_sound(hold, neutral):
        return f"{text}: it was asked for hold {hold:g} s, neutral {neutral:g} s; expected 0 < hold < neutral <= {BEARABLE:g} s"
    silent = [k + 1 for k, fault in enumerate(newest.fault or ()) if ServoFault.NO_REPLY in fault]
    silent += [k + 1 for k, angle in enumerate(newest.joint) if not isfinite(angle) and k + 1 not in silent]
    if silent:
        return f"{text}: servo {', '.join(map(str, silent))} (from the head) does not answer; look at its plug"
    most = servo_range + Limits(servo_range=servo_range).near
    far = [f"{k + 1} at {degrees(angle):.1f} deg" for k, angle in enumerate(newest.joint) if abs(angle) > most]
    if far:
        bound = f"beyond the {degrees(most):.0f} deg from which it arms"
        return f"{text}: joint {', '.join(far)} (from the head), {bound}; straighten it, or set the servo's zero"
    return f"{text}, and nothing that it tells speaks against arming; do its packets arrive, and ours there?"
