"""Effects that no catalogue holds: a workflow that is given one of these should say that it does not know.

Families differ in kind: memory, coupling, asymmetry, place, time, timing, sensing.
"""

from fishmj.virtual_robot.catalogue import ALL, BODY, SERVO, _keep, _one
from fishmj.virtual_robot.catalogue_entry import CatalogueEntry

_ROWS: list[tuple] = [
    ("bouc_wen_skin", "skin with rate-independent hysteresis (Bouc-Wen)",
        (*_one("torque", "N m", "odd.bouc_torque", 0.1, 0.4), _keep("angle", "rad", "odd.bouc_angle", 0.1)), SERVO,
        ("slow_triangle", "hold_angles")),
    ("tail_yaw_cross_force", "side force on the head in proportion to tail rate times yaw rate",
        _one("coefficient", "N s2", "odd.cross_force", 0.005, 0.03, signed=True), BODY, ("gait_fast", "turn_left")),
    ("asymmetric_thrust", "the tail sucks more on strokes to one side",
        _one("gain", "1", "odd.asymmetry", 0.1, 0.5, signed=True), BODY, ("gait", "gait_mirrored")),
    ("cubic_joint_spring", "skin that hardens with the cube of the angle",
        _one("stiffness", "N m/rad3", "odd.cubic", 0.6, 2.5), SERVO, ("hold_angles", "gait")),
    ("pulsing_current", "a current along x that comes and goes, its phase new in every trial",
        (*_one("speed", "m/s", "odd.pulse", 0.015, 0.06), _keep("period", "s", "odd.pulse_period", 6.0)), ("position",),
        ("drift_north", "gait")),
    ("encoder_harmonic", "the servos' sensors err with the third harmonic of the angle",
        _one("angle", "rad", "odd.eccentric", 0.01, 0.04, signed=True), SERVO, ("staircase", "slow_triangle")),
    ("mass_shift", "ballast slides forward in the middle of a trial",
        (*_one("distance", "m", "odd.shift", 0.01, 0.04), _keep("time", "s", "odd.shift_time", 6.0)), BODY, ("spin", "gait")),
    ("cable_crosstalk", "a part of each motor's drive reaches its neighbours",
        _one("gain", "1", "odd.crosstalk", 0.1, 0.4, signed=True), SERVO, ("flap", "steps")),
    ("gear_tooth", "a bad tooth: the joint snaps into one angle",
        (*_one("torque", "N m", "odd.tooth", 0.1, 0.5), _keep("angle", "rad", "odd.tooth_angle", 0.15, least=-1.0)), SERVO,
        ("slow_triangle", "gait")),
    ("camera_parallax", "the marker's image moves with the heading",
        _one("shift", "m", "odd.parallax", 0.01, 0.04, signed=True), ("position",), ("turn_left", "spin")),
    ("tail_resonance", "thrust bursts near one beat rate",
        (*_one("gain", "1", "odd.resonance", 0.3, 1.5), _keep("rate", "rad/s", "odd.resonance_rate", 7.0, 1.3)), ("position",),
        ("gait", "gait_fast")),
    ("busy_bus", "commands wait longer the faster they change", _one("delay", "s2/rad", "odd.busy", 0.004, 0.02), ALL,
        ("gait_fast", "chirp")),
    ("firmware_reset", "a current peak makes the firmware restart, motors off",
        (*_one("pause", "s", "odd.reset", 0.1, 0.4), _keep("current", "A", "odd.reset_current", 0.8, 1.1)), SERVO,
        ("gait_fast", "steps")),
    ("weed_on_tail", "weed gets caught: drag on strokes to one side from one moment on",
        (*_one("drag", "N s2/m2", "odd.weed", 1.0, 5.0), _keep("time", "s", "odd.weed_time", 5.0)), BODY,
        ("gait", "turn_right")),
]  # fmt: skip
ODDITIES: dict[str, CatalogueEntry] = {
    name: CatalogueEntry(name=name, stage="odd", about=about, parameters=parameters, shows=shows, runs=runs, catalogued=False)
    for name, about, parameters, shows, runs in _ROWS
}
