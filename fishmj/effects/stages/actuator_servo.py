"""Effects of the stage `actuator` in the servo: encoder, gains, torque, supply."""

from math import copysign, cos, pi, sin

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm
from fishmj.effects.robot_scales import DEFAULT, RobotScales

OFFSETS = ("offset1", "offset2", "offset3")


def offset_of(p, joint: int):
    """Offset of one joint [rad]; joints beyond the third share its value."""
    return getattr(p, OFFSETS[min(joint, len(OFFSETS) - 1)])


def joint_zero_offset_servo(xp, p, s, memory, h):
    """The controller closes its loop on the encoder: e' = e + o."""
    return s._replace(error=s.error + offset_of(p, p.joint)), memory


def joint_zero_offset_measure(xp, p, seen):
    """The log holds the encoder's reading: angle - o."""
    offsets = xp.stack([offset_of(p, j) + 0.0 for j in range(seen.joint.shape[-1])], axis=-1)
    return seen._replace(joint=seen.joint - offsets)


def joint_zero_offset_fields(site, p):
    """A controller in the motor closes its loop on the encoder."""
    if site.actuator >= 0:
        m, a = site.m, site.actuator
        m.actuator_biasprm[a, 0] -= m.actuator_biasprm[a, 1] * m.actuator_gear[a, 0] * p.offset


def joint_zero_offset_reading(p):
    """Encoder: angle - o."""
    return 1.0, p.offset


JOINT_ZERO_OFFSET = Effect(
    name="joint_zero_offset",
    stage="actuator",
    about="a servo horn one tooth off: the fish is bent while its encoders say straight, so it turns",
    formula="hinge angle = encoder angle + o",
    source="paper randomises +-5 deg; open hardware's centre counts are 2.4 to 4.8 deg off",
    parameters=tuple(
        Parameter(name=name, unit="rad", low=-0.2, high=0.2, typical=(0.02, 0.087), joint=joint)
        for joint, name in enumerate(OFFSETS, 1)
    ),
    handed=OFFSETS,
    shows=("position", "heading"),
    native="joint ref",
    confusions=(
        Confusion("steady_current", "an offset turns with the fish, a current does not", ("drift_east", "gait_mirrored")),
        Confusion("camera_yaw", "a turned camera turns straight tracks, an offset bends them", ("gait", "gait_mirrored")),
        Confusion("servo_deadband", "does not change sign with the direction of approach", ("staircase",)),
    ),
    servo=joint_zero_offset_servo,
    measure=joint_zero_offset_measure,
    robot=RobotForm(
        site="joint",
        parameters=(Parameter(name="offset", unit="rad", low=-0.5, high=0.5, typical=(0.01, 0.06)),),
        fields=joint_zero_offset_fields,
        reading=joint_zero_offset_reading,
    ),
)


def servo_damping_gain_fields(site, p):
    """Third number of an actuator's bias."""
    site.m.actuator_biasprm[site.actuator, 2] *= 1.0 + p.gain


SERVO_DAMPING_GAIN = Effect(
    name="servo_damping_gain",
    stage="actuator",
    about="the derivative gain of a position or velocity controller is not what the description says",
    formula="k_v' = (1 + g) k_v",
    source="firmware units of gains are seldom stated: 10 to 50 %",
    native="actuator biasprm",
    robot=RobotForm(
        site="actuator",
        parameters=(Parameter(name="gain", unit="1", low=-0.95, high=5.0, typical=(0.1, 0.5)),),
        fields=servo_damping_gain_fields,
        confusions=(Confusion("viscous_friction", "switch the torque off and let the joint swing"),),
    ),
)


EDGE = 0.002  # rad, half a count of the servo: width over which the controller wakes up


def servo_deadband_servo(xp, p, s, memory, h):
    """e' = e for |e| >= d, 0 for |e| <= d - EDGE, in between linear in |e|: finite slope, full torque outside."""
    awake = xp.minimum(xp.maximum((xp.abs(s.error) - p.deadband) / EDGE + 1.0, 0.0), 1.0)
    return s._replace(error=s.error * awake), memory


SERVO_DEADBAND = Effect(
    name="servo_deadband",
    stage="actuator",
    about="no torque while the error is small, so a joint stops short of its command, whatever the load",
    formula="e' = 0 where |e| < d",
    source="bus servos: one or two counts of 0.24 deg, hobby servos up to 2 deg",
    parameters=(Parameter(name="deadband", unit="rad", low=0.0, high=0.2, typical=(0.005, 0.035)),),
    shows=("joint", "power"),
    confusions=(
        Confusion(
            "coulomb_friction",
            "a dead band's error does not depend on load or on the direction of approach",
            ("staircase", "slow_triangle"),
        ),
        Confusion("joint_zero_offset", "the error changes sign with the direction of approach", ("staircase",)),
        Confusion(
            "command_quantisation",
            "a staircase of fine steps: quantisation skips steps, a dead band trails by a constant",
            ("staircase", "slow_triangle"),
        ),
    ),
    servo=servo_deadband_servo,
)


def servo_gain_servo(xp, p, s, memory, h):
    """k_p' = (1 + g) k_p, k_v' = (1 + g) k_v."""
    return s._replace(kp=(1.0 + p.gain) * s.kp, kv=(1.0 + p.gain) * s.kv), memory


def servo_gain_fields(site, p):
    """Gain and bias of the actuator, a constant force of it aside."""
    site.m.actuator_gainprm[site.actuator, 0] *= 1.0 + p.gain
    site.m.actuator_biasprm[site.actuator, 1:3] *= 1.0 + p.gain


SERVO_GAIN = Effect(
    name="servo_gain",
    stage="actuator",
    about="bandwidth of the joint is off: amplitude and phase change with frequency",
    formula="(k_p, k_v)' = (1 + g) (k_p, k_v)",
    source="spread of gains between servos of one type: 10 to 30 %",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.3)),),
    shows=("joint", "position", "power"),
    native="actuator gainprm, biasprm",
    confusions=(
        Confusion("command_latency", "amplitude changes too; two frequencies a decade apart", ("chirp", "staircase")),
        Confusion("skin_stiffness", "power needed to hold a constant angle", ("hold_angles", "staircase")),
        Confusion("viscous_friction", "error of a held angle under load", ("hold_angles", "chirp")),
    ),
    servo=servo_gain_servo,
    robot=RobotForm(
        site="actuator",
        parameters=(Parameter(name="gain", unit="1", low=-0.9, high=2.0, typical=(0.08, 0.3)),),
        fields=servo_gain_fields,
    ),
)


def speed_limit_gear(xp, p, g, memory, h):
    """Torque after back-EMF, drive - k_b w, along the motion <= limit (1 - s |w|). A line above the model's own has no effect.

    On the line its slope is taken implicitly: a damping, and a torque that makes up for it at the present rate.
    """
    ahead = xp.where(g.drive >= 0.0, 1.0, -1.0)
    steeper = xp.maximum(p.slowness * g.limit - g.kb, 0.0)  # N m s/rad, than back-EMF
    line = xp.maximum(g.limit - steeper * xp.maximum(g.rate * ahead, 0.0), 0.0)
    over = g.drive * ahead >= line
    slope = xp.where(over, steeper, 0.0)
    drive = xp.where(over, ahead * line, g.drive)
    return g._replace(drive=drive, torque=g.torque + slope * g.rate, resist=g.resist + slope), memory


def speed_limit_law(joint, memory, slowness):
    """Torque beyond the line is taken off. Its slope is a damping, so the excess is that at the end of the step."""
    ahead = copysign(1.0, joint.drive)
    line = max(joint.limit * (1.0 - slowness * max(ahead * joint.rate, 0.0)), 0.0)
    over = max(ahead * joint.drive - line, 0.0)
    return -ahead * over / (1.0 + joint.step * joint.limit * slowness / joint.inertia), 0.0


SPEED_LIMIT = Effect(
    name="speed_limit",
    stage="actuator",
    about="a steeper torque-speed line: fast joints lose torque, a large fast sine becomes a triangle",
    formula="torque <= limit (1 - s |w|) along the motion; 1/s is the speed at which nothing is left",
    source="paper: 0.2 s per 60 deg without load; low voltage and stiff grease halve it",
    parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=2.0, typical=(0.21, 0.5), of="slowness"),),
    shows=("joint", "position", "power"),
    native="actuator dcmotor",
    confusions=(
        Confusion("torque_saturation", "a speed limit is the same in air and in water", ("square", "chirp")),
        Confusion("rate_limit", "load dependent: same move in air and water", ("steps", "square")),
        Confusion(
            "move_time_ramp", "the same slope for every step size; a ramp's slope grows with the step", ("steps", "staircase")
        ),
    ),
    gear=speed_limit_gear,
    robot=RobotForm(
        site="actuator",
        scale="time",
        parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=4.0, typical=(0.2, 0.8)),),
        law=speed_limit_law,
        confusions=(
            Confusion("torque_saturation", "cuts off at speed only: stall the joint, then move it fast"),
            Confusion("viscous_friction", "acts near the limit only: move fast with a small torque"),
        ),
    ),
)


def thermal_derating_servo(xp, p, s, memory, h):
    """(limit, k_p, k_v)' = (limit, k_p, k_v) e^(-a t)."""
    left = xp.exp(-p.rate * s.time)
    return s._replace(limit=left * s.limit, kp=left * s.kp, kv=left * s.kv), memory


THERMAL_DERATING = Effect(
    name="thermal_derating",
    stage="actuator",
    about="torque fades over a session as the windings warm up",
    formula="torque' = torque e^(-a t)",
    source="copper 0.4 %/K; an XL330 warms by 11 K in two minutes",
    parameters=(Parameter(name="rate", unit="1/s", low=0.0, high=0.2, typical=(3e-4, 5e-3)),),
    planted="ten times as fast: it must show within a run of some ten seconds",
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("voltage_sag", "minutes against milliseconds", ("gait", "steps")),
        Confusion("torque_saturation", "the first run of a session against the last", ("gait",)),
        Confusion("servo_gain", "the first run of a session against the last", ("chirp", "gait")),
    ),
    servo=thermal_derating_servo,
)


def thrust_loss_fields(site, p):
    """Gain of every actuator that acts on a site."""
    site.m.actuator_gainprm[site.thrusters, 0] *= 1.0 - p.share


THRUST_LOSS = Effect(
    name="thrust_loss",
    stage="actuator",
    about="an empty battery, thin air or worn propellers: every thruster gives the same share less, or more",
    formula="F' = (1 - s) F",
    source="a lithium cell falls from 4.2 to 3.5 V: up to 30 % of the thrust",
    native="actuator gainprm",
    robot=RobotForm(
        site="thrusters",
        parameters=(Parameter(name="share", unit="1", low=-1.0, high=0.9, typical=(0.04, 0.2)),),
        fields=thrust_loss_fields,
        confusions=(Confusion("body_mass", "weigh the robot: a free body shows force over mass only"),),
    ),
)


def torque_offset_fields(site, p):
    """Constant force of an actuator with affine bias; b0 / gear."""
    m, a = site.m, site.actuator
    m.actuator_biastype[a] = max(m.actuator_biastype[a], 1)
    m.actuator_biasprm[a, 0] += p.torque / site.gear


TORQUE_OFFSET = Effect(
    name="torque_offset",
    stage="actuator",
    about="the current sensor's zero is off, or a cable pulls: a torque that is there without a command",
    formula="tau' = tau + o",
    source="quasi-direct drive of a pendulum: -0.076 N m (torque_limited_simple_pendulum)",
    native="actuator biasprm",
    robot=RobotForm(
        site="actuator",
        scale="torque",
        parameters=(Parameter(name="torque", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),),
        fields=torque_offset_fields,
        confusions=(Confusion("joint_zero_offset", "a wrong zero turns gravity: an offset is the same at every angle"),),
    ),
)


def torque_ripple_law(joint, memory, sine, cosine, period):
    """The same at every turn of the motor."""
    phase = 2.0 * pi * joint.angle / period
    return sine * sin(phase) + cosine * cos(phase), 0.0


TORQUE_RIPPLE = Effect(
    name="torque_ripple",
    stage="actuator",
    about="poles and slots of a motor attract each other (cogging), or a gear runs out of round: a torque periodic in the angle",
    formula="tau = a sin(2 pi q / P) + b cos(2 pi q / P)",
    source="direct and quasi-direct drives: 1 to 10 % of the rated torque, 6 to 60 periods a turn of the joint",
    robot=RobotForm(
        site="joint",
        scale=("torque", "torque", ""),
        parameters=(
            Parameter(name="sine", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),
            Parameter(name="cosine", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),
            Parameter(name="period", unit="rad", null=0.5, low=0.05, high=1.6, typical=(0.1, 1.2), shape=True, fine=True),
        ),
        law=torque_ripple_law,
        confusions=(Confusion("torque_offset", "has one sign: turn the joint by half a period"),),
    ),
)


STALL = DEFAULT.torque  # N m, the null


def torque_saturation_servo(xp, p, s, memory, h):
    """limit' = min(limit, tau_max) where tau_max is below the servo's stall torque, the null."""
    return s._replace(limit=xp.where(p.limit < p.robot.torque, xp.minimum(s.limit, p.limit), s.limit)), memory


def torque_saturation_fields(site, p):
    """Range of the actuator's force; a narrower one that the description states stays."""
    m, a = site.m, site.actuator
    limit = p.limit / abs(site.gear)
    stated = m.actuator_forcerange[a] if m.actuator_forcelimited[a] else (-limit, limit)
    m.actuator_forcelimited[a] = 1
    m.actuator_forcerange[a] = max(stated[0], -limit), min(stated[1], limit)


TORQUE_SATURATION = Effect(
    name="torque_saturation",
    stage="actuator",
    about="torque is cut off earlier: brown-out, firmware limit, worn battery",
    formula="|drive| <= tau_max",
    source="paper: 17 kg cm at 7.4 V; 0.8 to 1.2 N m in a brown-out",
    parameters=(Parameter(name="limit", unit="N m", null=STALL, low=0.02, high=STALL, typical=(0.8, 1.2), of="torque"),),
    shows=("joint", "position", "power"),
    native="actuator forcerange",
    confusions=(
        Confusion(
            "speed_limit", "saturation scales with inertia, air against water; a speed limit does not", ("square", "chirp")
        ),
        Confusion("voltage_sag", "does not depend on the other joints", ("steps", "gait")),
        Confusion("thermal_derating", "the same from the first second", ("gait", "burst_and_coast")),
    ),
    servo=torque_saturation_servo,
    robot=RobotForm(
        site="actuator",
        scale="torque",
        parameters=(Parameter(name="limit", unit="N m", null=6.0, low=0.05, high=6.0, typical=(0.5, 1.0)),),
        fields=torque_saturation_fields,
    ),
)


LEAST = 0.3  # of the voltage is left: boards switch off below


def boards(robot: RobotScales) -> float:
    """Current that the boards draw at rest, A."""
    return robot.idle_power / robot.voltage


def voltage_sag_servo(xp, p, s, memory, h):
    """(limit, k_p, k_v)' = (limit, k_p, k_v) V / V_oc, V = V_oc - R I: the controller sets a duty, the supply the voltage.

    The no-load speed limit / k_b falls with it. I = sum d i is the current of motors (one step ago) and boards: the
    motor's current i falls with V, the duty d does not.
    """
    share = xp.maximum(1.0 - p.resistance * (s.current + boards(p.robot)) / p.robot.voltage, LEAST)
    return s._replace(limit=share * s.limit, kp=share * s.kp, kv=share * s.kv, supply=share * s.supply), memory


def voltage_sag_measure(xp, p, seen):
    """P' = P - I_b (V_oc - V): the boards draw I_b at any voltage. P = V (I + I_b) + I_b (V_oc - V) determines V."""
    idle, whole = boards(p.robot), p.robot.voltage
    motors = seen.power - idle * whole
    unloaded = whole - p.resistance * idle
    volts = (unloaded + xp.sqrt(xp.maximum(unloaded * unloaded - 4.0 * p.resistance * motors, 0.0))) / 2.0
    return seen._replace(power=seen.power - idle * (whole - xp.maximum(volts, LEAST * whole)))


VOLTAGE_SAG = Effect(
    name="voltage_sag",
    stage="actuator",
    about="battery and leads have a resistance: everything is weaker and slower while several joints work",
    formula="torque' = torque (V_oc - R I) / V_oc, I the supply's current",
    source="two cells and leads: 60 to 150 mohm fresh; worn, cold or through thin wire up to an ohm",
    parameters=(Parameter(name="resistance", unit="ohm", low=0.0, high=6.0, typical=(0.1, 1.0), of="resistance"),),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("torque_saturation", "one joint alone against all together", ("steps", "gait")),
        Confusion("thermal_derating", "milliseconds against minutes", ("gait", "burst_and_coast")),
        Confusion("load_friction", "vary speed at equal load", ("chirp", "hold_angles")),
    ),
    servo=voltage_sag_servo,
    measure=voltage_sag_measure,
)
