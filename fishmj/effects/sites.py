"""Data that an effect reads at each site, and changes with `_replace`. Scalars or equal-shaped arrays, SI."""

from typing import Any, NamedTuple


class ServoDrive(NamedTuple):
    """One joint before the drive torque is formed: drive = clip(kp error - kv rate, -limit, limit)."""

    error: Any  # commanded minus measured angle, rad
    angle: Any  # hinge angle, rad
    rate: Any  # rad/s
    kp: Any  # N m/rad
    kv: Any  # N m s/rad, damping added by the controller
    kb: Any  # N m s/rad, back-EMF slope
    limit: Any  # N m, stall torque
    current: Any  # A, what all servos together drew from the supply one step ago
    time: Any  # s since the session began
    supply: Any = 1.0  # voltage over the nominal one; kp, kv and limit have this factor already


class Gear(NamedTuple):
    """One joint after the drive.

    torque is added explicitly. resist is a damping [N m s/rad] taken implicitly, so friction written as the secant
    F(|rate|)/|rate| is stable at any step.
    """

    drive: Any  # N m, may be changed
    angle: Any
    rate: Any
    torque: Any  # N m
    resist: Any  # N m s/rad, >= 0
    wet: Any  # 1 in water, 0 in air
    kb: Any  # N m s/rad, back-EMF slope, part of the joint's damping already
    limit: Any  # N m, stall torque


class JointMotion(NamedTuple):
    """One joint of a robot described in MJCF, at the start of a step."""

    angle: float  # rad or m
    rate: float  # rad/s
    drive: float  # N m, of its actuator
    limit: float  # N m, of its actuator at rest
    inertia: float  # kg m2, that it moves in the pose at zero
    armature: float  # kg m2, of it
    damping: float  # N m s/rad, of the joint
    time: float  # s since the start
    step: float  # s


class Constants(NamedTuple):
    """Masses and coefficients of the planar chain, changed before anything is computed from them."""

    chain: Any  # dynamics.planar_chain.Chain
    swimmer: Any  # dynamics.planar_chain.Swimmer


class FlowAt(NamedTuple):
    """Water at one place of the tank, world frame."""

    x: Any  # m
    y: Any  # m
    time: Any  # s
    u: Any  # m/s
    v: Any  # m/s


class BodyMotion(NamedTuple):
    """The whole body at its reference point, head axes. Forces and added masses add up over the effects.

    The added mass of a moving ideal fluid also carries Kirchhoff's velocity terms; the effect adds them to the forces.
    """

    u: Any  # surge relative to the water, m/s
    w: Any  # sway relative to the water, m/s
    r: Any  # yaw rate, rad/s
    heading: Any  # rad
    x: Any  # m, world
    y: Any  # m, world
    time: Any  # s
    tail: Any  # normal velocity of the tail tip relative to the water, m/s
    sway_mass: Any  # kg, added mass that the base model has in sway, 0 in air
    drag: Any  # N s2/m2, surge drag of the base model over u^2, ahead
    wet: Any  # 1 in water, 0 in air
    fx: Any  # N, ahead
    fy: Any  # N, to the left
    n: Any  # N m
    mx: Any  # kg
    my: Any  # kg
    mn: Any  # kg m2
    added: Any  # 1, share of the base model's added mass that comes on top of it
    bend: Any = 0.0  # rad, the tail's angle to the head
    swing: Any = 0.0  # rad/s, its rate


class LocalWater(NamedTuple):
    """Forces of the water on the links, except those proportional to their acceleration; lists, one entry a link.

    forces - instant is the part from vortices, drag and the trailing edge: a wake may delay it and a wall may raise it.
    """

    forces: Any  # [(F_t N, F_n N, moment N m about the link's origin)]
    u: Any  # [m/s] relative to the water, along the link
    w: Any  # [m/s] across it
    omega: Any  # [rad/s]
    x: Any  # m, reference point, world
    y: Any  # m
    time: Any  # s
    instant: Any  # part of the forces that belongs to the added mass and follows the motion at once, same form


class SensorReadings(NamedTuple):
    """Sensor readings at the times of one record, arrays (..., T); joints (..., T, J)."""

    t: Any  # s
    x: Any  # m
    y: Any  # m
    yaw: Any  # rad
    joint: Any  # rad
    power: Any  # W
