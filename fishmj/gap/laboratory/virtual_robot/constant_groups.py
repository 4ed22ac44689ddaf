"""Constants of the second robot, in groups; read from `data/calib/virtual_robot.toml`.

A group is a NamedTuple of floats, so that compiled code reads `motor.gain` by name. A field whose comment begins with *effect*
is null unless the effect is planted; null fields leave the results unchanged to the last bit.
"""

from typing import NamedTuple


class HullConstants(NamedTuple):
    """Additions to the described fish, at the reference point; all are effects."""

    mass: float = 0.0  # kg
    com: float = 0.0  # m, forward shift of the head's centre of mass
    inertia: float = 0.0  # kg m2
    surge: float = 0.0  # kg, added mass along the head
    sway: float = 0.0  # kg, across
    yaw: float = 0.0  # kg m2


class WaterConstants(NamedTuple):
    """Water around the links. Forces per station are precomputed in `rigid_body.RigidBody`."""

    active: float  # 1 in water, 0 in air
    friction: float  # of the 1/5-power law: Cf = friction Re^-0.2
    head_forward: float  # N s2/m2, form drag of the head
    head_backward: float
    oblique: float  # share of u2 added under the root of the cross-flow drag
    edge_mass: float  # kg/m, added mass shed at the trailing edge
    edge_height: float  # m
    wagner_start: float  # initial share of the circulation
    wagner_lengths: float  # time constant of the rest, in trailing-edge heights travelled
    stall_slope: float  # tangent of the stall angle
    linear_surge: float = 0.0  # effect, N s/m
    quadratic_surge: float = 0.0  # effect, N s2/m2
    crossflow: float = 0.0  # effect, gain
    yaw_drag: float = 0.0  # effect, N m s2
    lift: float = 0.0  # effect, N s2/m2
    munk: float = 0.0  # effect, gain
    tail: float = 0.0  # effect, gain
    memory: float = 0.0  # effect, s
    surface: float = 0.0  # effect, N s2/m2
    wall: float = 0.0  # effect, gain
    joint: float = 0.0  # effect, N m s2


class MotorConstants(NamedTuple):
    """One bus servo: firmware, bridge, motor, gears; and the battery that all of them share."""

    gain: float  # N m/rad
    rate_gain: float  # N m s/rad, of the firmware alone; the back-EMF of the motor adds to it
    torque: float  # N m, stall at the nominal voltage
    resistance: float  # ohm
    constant: float  # V s/rad = N m/A
    inductive_time: float  # s, L/R
    voltage: float  # V, battery at the start
    nominal_voltage: float  # V
    droop: float  # V, open-circuit voltage lost from full to empty
    capacity: float  # A s
    idle: float  # W
    armature: float  # kg m2, rotor seen at the horn
    dry: float  # N m, friction of a good gearbox
    viscous: float  # N m s/rad
    period: float  # s, of the firmware
    step: float  # rad, potentiometer and command counts
    range: float  # rad
    deadband: float = 0.0  # effect, rad
    half_gap: float = 0.0  # effect, rad
    coulomb: float = 0.0  # effect, N m
    damping: float = 0.0  # effect, N m s/rad
    stribeck: float = 0.0  # effect, N m
    stribeck_speed: float = 0.1  # effect, rad/s
    load: float = 0.0  # effect, ratio
    limit: float = 1.667  # effect, N m
    slowness: float = 0.0  # effect, s/rad
    move_time: float = 0.0  # effect, s
    gain_error: float = 0.0  # effect
    source_resistance: float = 0.0  # effect, ohm
    derating: float = 0.0  # effect, 1/s
    zero1: float = 0.0  # effect, rad
    zero2: float = 0.0  # effect, rad
    zero3: float = 0.0  # effect, rad
    skin: float = 0.0  # effect, N m/rad
    branch: float = 0.0  # effect, N m/rad
    branch_time: float = 0.5  # effect, s
    command_gain: float = 0.0  # effect
    command_step: float = 0.0  # effect, rad
    command_slowness: float = 0.0  # effect, s/rad


class TankConstants(NamedTuple):
    """Moving water, a tether, walls at +-half."""

    half: float  # m
    flow_x: float = 0.0  # m/s, set stream
    flow_y: float = 0.0
    current_x: float = 0.0  # effect, m/s
    current_y: float = 0.0  # effect, m/s
    shear: float = 0.0  # effect, 1/s
    swirl: float = 0.0  # effect, rad/s
    sigma: float = 0.0  # effect, m/s
    time: float = 1.0  # effect, s
    tether: float = 0.0  # effect, N/m
    tether_x: float = 0.0  # effect, m
    tether_y: float = 0.0  # effect, m


class StartScatter(NamedTuple):
    """Standard deviations of placing the fish at its start."""

    position: float  # m
    heading: float  # rad


class NetworkConstants(NamedTuple):
    """Radio and bus: arrival of commands, times of angle readings."""

    period: float  # s, between commands and between readings
    latency: float  # s, nominal, from sending to the servo
    jitter: float  # s
    stamp_jitter: float  # s, of the joint telemetry
    angle_noise: float  # rad, of the joint's own sensor
    angle_step: float  # rad
    delay: float = 0.0  # effect, s
    sigma: float = 0.0  # effect, s
    loss: float = 0.0  # effect, probability
    joint_delay: float = 0.0  # effect, s


class CameraConstants(NamedTuple):
    """Tracker above the tank: timing and marker errors."""

    period: float  # s
    latency: float  # s, nominal, from exposure to the stamp
    jitter: float  # s
    position_noise: float  # m
    heading_noise: float  # rad
    window: float  # frames in the velocity fit
    delay: float = 0.0  # effect, s
    offset: float = 0.0  # effect, s
    drift: float = 1.0  # effect, camera seconds per second
    filter: float = 0.0  # effect, s
    scale: float = 0.0  # effect
    angle: float = 0.0  # effect, rad
    heading: float = 0.0  # effect, rad
    marker: float = 0.0  # effect, m
    k1: float = 0.0  # effect, 1/m2


class MeterConstants(NamedTuple):
    """Current and voltage sensor of the battery lead."""

    period: float  # s
    voltage_noise: float  # V
    current_noise: float  # A
    average: float  # s, averaging time
    offset: float = 0.0  # effect, W


class UncataloguedEffects(NamedTuple):
    """Effects outside every catalogue; the defaults have no effect."""

    bouc_torque: float = 0.0  # N m, hysteresis of the skin
    bouc_angle: float = 0.1  # rad, at which it saturates
    cross_force: float = 0.0  # N s2, tail rate times yaw rate
    asymmetry: float = 0.0  # extra suction on strokes to one side
    cubic: float = 0.0  # N m/rad3
    pulse: float = 0.0  # m/s, amplitude of an oscillating current
    pulse_period: float = 6.0  # s
    eccentric: float = 0.0  # rad, encoder magnet off centre
    shift: float = 0.0  # m, ballast slides
    shift_time: float = 6.0  # s, when
    crosstalk: float = 0.0  # a motor's drive leaks to its neighbour
    tooth: float = 0.0  # N m, a bad gear tooth
    tooth_angle: float = 0.15  # rad, where
    parallax: float = 0.0  # m, the marker's image depends on the heading
    resonance: float = 0.0  # gain of the shed momentum near one beat rate
    resonance_rate: float = 7.0  # rad/s
    busy: float = 0.0  # s per rad/s, delay of fast-changing commands
    reset: float = 0.0  # s, length of a brown-out of the firmware
    reset_current: float = 0.8  # A, that triggers it
    weed: float = 0.0  # N s2/m2, caught on the left of the tail
    weed_time: float = 5.0  # s, when
