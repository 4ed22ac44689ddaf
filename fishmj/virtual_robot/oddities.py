"""Effects that no catalogue holds: a workflow that is given one of these should say that it does not know.

Families differ in kind: memory, coupling, asymmetry, place, time, timing, sensing.
"""

from fishmj.virtual_robot.catalogue import ALL, BODY, SERVO, _keep, _one
from fishmj.virtual_robot.effect import Effect

_ROWS: list[tuple] = [
    (
        "bouc_wen_skin",
        (*_one("torque", "N m", "odd.bouc_torque", 0.1, 0.4), _keep("angle", "rad", "odd.bouc_angle", 0.1)),
        SERVO,
        ("slow_triangle", "hold_angles"),
    ),
    (
        "tail_yaw_cross_force",
        _one("coefficient", "N s2", "odd.cross_force", 0.005, 0.03, signed=True),
        BODY,
        ("gait_fast", "turn_left"),
    ),
    ("asymmetric_thrust", _one("gain", "1", "odd.asymmetry", 0.1, 0.5, signed=True), BODY, ("gait", "gait_mirrored")),
    ("cubic_joint_spring", _one("stiffness", "N m/rad3", "odd.cubic", 0.6, 2.5), SERVO, ("hold_angles", "gait")),
    (
        "pulsing_current",
        (*_one("speed", "m/s", "odd.pulse", 0.015, 0.06), _keep("period", "s", "odd.pulse_period", 6.0)),
        ("position",),
        ("drift_north", "gait"),
    ),
    ("encoder_harmonic", _one("angle", "rad", "odd.eccentric", 0.01, 0.04, signed=True), SERVO, ("staircase", "slow_triangle")),
    (
        "mass_shift",
        (*_one("distance", "m", "odd.shift", 0.01, 0.04), _keep("time", "s", "odd.shift_time", 6.0)),
        BODY,
        ("spin", "gait"),
    ),
    ("cable_crosstalk", _one("gain", "1", "odd.crosstalk", 0.1, 0.4, signed=True), SERVO, ("flap", "steps")),
    (
        "gear_tooth",
        (*_one("torque", "N m", "odd.tooth", 0.1, 0.5), _keep("angle", "rad", "odd.tooth_angle", 0.15)),
        SERVO,
        ("slow_triangle", "gait"),
    ),
    ("camera_parallax", _one("shift", "m", "odd.parallax", 0.01, 0.04, signed=True), ("position",), ("turn_left", "spin")),
    (
        "tail_resonance",
        (*_one("gain", "1", "odd.resonance", 0.3, 1.5), _keep("rate", "rad/s", "odd.resonance_rate", 7.0, 1.3)),
        ("position",),
        ("gait", "gait_fast"),
    ),
    ("busy_bus", _one("delay", "s2/rad", "odd.busy", 0.004, 0.02), ALL, ("gait_fast", "chirp")),
    (
        "firmware_reset",
        (*_one("pause", "s", "odd.reset", 0.1, 0.4), _keep("current", "A", "odd.reset_current", 0.8, 1.1)),
        SERVO,
        ("gait_fast", "steps"),
    ),
    (
        "weed_on_tail",
        (*_one("drag", "N s2/m2", "odd.weed", 1.0, 5.0), _keep("time", "s", "odd.weed_time", 5.0)),
        BODY,
        ("gait", "turn_right"),
    ),
]
ODDITIES: dict[str, Effect] = {
    name: Effect(name=name, stage="odd", parameters=parameters, shows=shows, runs=runs, catalogued=False)
    for name, parameters, shows, runs in _ROWS
}
