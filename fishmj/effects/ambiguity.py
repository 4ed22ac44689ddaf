"""Effects that no amount of data of a certain kind can tell apart, the reason, and the experiment that separates them.

Until that experiment is done, a verdict must name the class and not a member.
"""

from collections.abc import Iterable
from typing import NamedTuple

from fishmj.effects.effect import kind_of, site_of

SERIES = ("torque_offset", "joint_stiffness")  # tau(q) = o - k (q - q_rest) + ..: a robot's joint, any torque over its angle


class AmbiguityClass(NamedTuple):
    """One class. effects: entries of the catalogue; besides: causes outside the catalogue that look the same."""

    name: str
    effects: tuple[str, ...]
    without: str  # the data that is missing
    reason: str
    splits: str  # what to do
    besides: tuple[str, ...] = ()
    excitations: tuple[str, ...] = ()


CLASSES = (
    AmbiguityClass(
        name="joint_damping",
        effects=("viscous_friction",),
        besides=("damping gain of the servo's controller", "back-EMF slope"),
        without="motion with the torque off",
        reason="all are a torque -D w while the controller is on, and only their sum appears",
        splits="release a bent joint with the torque off: the controller's share is gone",
    ),
    AmbiguityClass(
        name="mass_in_surge",
        effects=("body_mass", "surge_added_mass"),
        without="turns, or a weighing",
        reason="in straight swimming only the sum of mass and added mass acts on the speed",
        splits="weigh the fish dry and flooded; or turn fast, where m u r acts and added mass in surge does not",
        excitations=("turn_left", "turn_right", "twirl"),
    ),
    AmbiguityClass(
        name="thrust_or_drag",
        effects=("quadratic_drag", "tail_normal_force"),
        besides=("form drag", "skin friction"),
        without="coasting",
        reason="a steady speed is set by the ratio of thrust to drag",
        splits="stop the tail at speed and let it coast",
        excitations=("burst_and_coast", "tow_ahead"),
    ),
    AmbiguityClass(
        name="axes",
        effects=("camera_yaw",),
        besides=("heading at the start",),
        without="an outside axis",
        reason="turning the world and turning the fish in it give the same log while the water rests",
        splits="log with a known current, or lay a straight edge into the picture",
        excitations=("drift_east", "drift_north"),
    ),
    AmbiguityClass(
        name="angle_scale",
        effects=("command_gain_error",),
        besides=("scale of the joint's encoder",),
        without="an outside view of the joint",
        reason="a wrong scale of command and encoder together turns the joint further and reports what was asked for",
        splits="a protractor at the joint, or the camera on the tail",
        excitations=("staircase", "hold_angles"),
    ),
    AmbiguityClass(
        name="pose_clock",
        effects=("camera_latency", "clock_offset"),
        without="an event that both clocks see",
        reason="a late camera and a late clock shift the same stamps; drift tells them apart over an hour only",
        splits="a lamp that is switched by the commands' computer in the camera's view, at the start and at the end",
        excitations=("impulse",),
    ),
    AmbiguityClass(
        name="yaw_inertia",
        effects=("yaw_inertia", "yaw_added_mass"),
        without="motion in air",
        reason="both resist the head's yaw acceleration, in the same way",
        splits="hang the fish on two threads in air and time its swing; or flap in air",
        excitations=("flap", "impulse"),
    ),
    AmbiguityClass(
        name="water_at_one_station",
        effects=("steady_current", "current_shear", "swirl"),
        without="a second station",
        reason="at one place of the tank all are a velocity of the water",
        splits="the same run at two stations",
        excitations=("station_left", "station_right"),
    ),
)


def containing(effect: str) -> tuple[AmbiguityClass, ...]:
    """The classes that an effect, also one at a site of a robot, belongs to."""
    return tuple(c for c in CLASSES if kind_of(effect) in c.effects)


def together(one: str, other: str) -> AmbiguityClass | None:
    """The class that holds both effects, or None."""
    return next((c for c in containing(one) if kind_of(other) in c.effects), None) if site_of(one) == site_of(other) else None


def series_at(names: Iterable[str]) -> tuple[str, ...]:
    """The joints at which both first terms of a torque over the angle are among the names.

    A cable that pulls from an angle on, a soft stop and a spring of another rest angle begin alike.
    """
    given = {(site_of(name), kind_of(name)) for name in names}
    return tuple(sorted({site for site, _ in given if all((site, term) in given for term in SERIES)}))
