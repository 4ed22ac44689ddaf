"""The effects of the catalogue, planted by this room's own code. One row each: parameters, where they show, what shows them.

Units are SI, nulls 0 unless the row says otherwise. Delays come on top of the nominal ones in the fish description.
"""

import numpy as np

from fishmj.virtual_robot.catalogue_entry import CatalogueEntry, EntryParameter

SERVO, BODY, ALL = ("joint",), ("position", "heading"), ("joint", "position", "heading")
_SWIM, _TURN = ("gait", "turn_left"), ("turn_left", "spin")


def _one(name, unit, field, low, high, *, null=0.0, signed=False, least=None, most=np.inf) -> tuple[EntryParameter, ...]:
    """The main parameter. What is not signed is not negative, except inertia and water: there may be less than believed."""
    if least is None:
        least = -np.inf if signed or field.startswith(("hull.", "water.")) else 0.0
    return (
        EntryParameter(name=name, unit=unit, field=field, typical=(low, high), null=null, signed=signed, least=least, most=most),
    )


def _keep(name, unit, field, value, spread=1.5, least=1e-3) -> EntryParameter:
    """A second parameter that means nothing while the first is null."""
    return EntryParameter(
        name=name, unit=unit, field=field, typical=(value / spread, value * spread), null=value, default=True, least=least
    )


_ANCHOR = tuple(
    EntryParameter(name=a, unit="m", field=f"tank.tether_{a}", typical=(0.1, 1.0), signed=True, default=True) for a in "xy"
)
_ROWS: list[tuple] = [
    # name, stage, parameters, shows, runs
    ("servo_deadband", "actuator", _one("deadband", "rad", "motor.deadband", 0.01, 0.035), SERVO,
        ("slow_triangle", "gait_small")),
    ("gear_backlash", "actuator", _one("half_gap", "rad", "motor.half_gap", 0.01, 0.035), SERVO,
        ("slow_triangle", "gait_small")),
    ("coulomb_friction", "actuator", _one("torque", "N m", "motor.coulomb", 0.03, 0.2), SERVO, ("slow_triangle", "gait_small")),
    ("viscous_friction", "actuator", _one("damping", "N m s/rad", "motor.damping", 0.03, 0.3), SERVO, ("chirp", "steps")),
    ("stribeck", "actuator",
        (*_one("torque", "N m", "motor.stribeck", 0.05, 0.2), _keep("speed", "rad/s", "motor.stribeck_speed", 0.1)), SERVO,
        ("creep", "slow_triangle")),
    ("load_friction", "actuator", _one("ratio", "1", "motor.load", 0.1, 0.3), SERVO, ("gait_fast", "steps")),
    ("torque_saturation", "actuator", _one("limit", "N m", "motor.limit", 1.0, 0.4, null=1.667, least=0.05, most=1.667), SERVO,
        ("gait_fast", "steps")),
    ("speed_limit", "actuator", _one("slowness", "s/rad", "motor.slowness", 0.25, 0.5), SERVO, ("gait_fast", "steps")),
    ("move_time_ramp", "actuator", _one("move_time", "s", "motor.move_time", 0.02, 0.1), SERVO, ("steps", "chirp")),
    ("servo_gain", "actuator", _one("gain", "1", "motor.gain_error", 0.1, 0.3, signed=True, least=-0.9), SERVO,
        ("gait_fast", "chirp")),
    ("voltage_sag", "actuator", _one("resistance", "ohm", "motor.source_resistance", 0.3, 1.5), ("joint", "power"),
        ("gait_fast", "flap")),
    ("thermal_derating", "actuator", _one("rate", "1/s", "motor.derating", 0.01, 0.05), SERVO, ("gait_fast", "chirp")),
    ("joint_zero_offset", "actuator",
        tuple(p for j in (1, 2, 3) for p in _one(f"offset{j}", "rad", f"motor.zero{j}", 0.02, 0.087, signed=True)),
        BODY, _SWIM),
    ("skin_stiffness", "actuator", _one("stiffness", "N m/rad", "motor.skin", 0.2, 1.5), SERVO, ("hold_angles", "gait")),
    ("skin_hysteresis", "actuator",
        (*_one("stiffness", "N m/rad", "motor.branch", 0.3, 1.5), _keep("time", "s", "motor.branch_time", 0.5, 2.0)), SERVO,
        ("hold_angles", "steps")),
    ("command_gain_error", "actuator", _one("gain", "1", "motor.command_gain", 0.02, 0.08, signed=True, least=-0.9), SERVO,
        ("staircase", "gait")),
    ("command_quantisation", "actuator", _one("step", "rad", "motor.command_step", 0.01, 0.04), SERVO,
        ("slow_triangle", "creep")),
    ("rate_limit", "actuator", _one("slowness", "s/rad", "motor.command_slowness", 0.25, 0.6), SERVO, ("gait_fast", "steps")),
    ("command_latency", "timing", _one("delay", "s", "network.delay", 0.01, 0.06), ALL, ("chirp", "gait_fast")),
    ("joint_sensor_delay", "timing", _one("delay", "s", "network.joint_delay", 0.01, 0.06), SERVO, ("chirp", "gait_fast")),
    ("latency_jitter", "timing", _one("sigma", "s", "network.sigma", 0.004, 0.02), SERVO, ("gait_fast", "chirp")),
    ("packet_loss", "timing", _one("probability", "1", "network.loss", 0.02, 0.2, most=0.95), SERVO, ("gait_fast", "chirp")),
    ("clock_offset", "timing",
        (*_one("offset", "s", "camera.offset", 0.01, 0.05, signed=True),
            *_one("drift", "1", "camera.drift", 1.00001, 1.00004, null=1.0, least=0.99, most=1.01)),
        BODY, _TURN),
    ("camera_latency", "timing", _one("delay", "s", "camera.delay", 0.01, 0.06), BODY, _TURN),
    ("velocity_filter", "timing", _one("time", "s", "camera.filter", 0.04, 0.15), ("velocity",), _TURN),
    ("body_mass", "inertia", _one("mass", "kg", "hull.mass", 0.05, 0.3), ("position",), ("tow_oblique", "burst_and_coast")),
    ("com_offset", "inertia", _one("x", "m", "hull.com", 0.008, 0.03, signed=True), BODY, ("spin", "gait_fast")),
    ("yaw_inertia", "inertia", _one("inertia", "kg m2", "hull.inertia", 0.003, 0.01), ("heading",), ("spin", "gait_fast")),
    ("surge_added_mass", "inertia", _one("mass", "kg", "hull.surge", 0.1, 0.4), ("position",),
        ("tow_ahead", "burst_and_coast")),
    ("sway_added_mass", "inertia", _one("mass", "kg", "hull.sway", 0.3, 1.2), BODY, ("tow_sideways", "gait")),
    ("yaw_added_mass", "inertia", _one("inertia", "kg m2", "hull.yaw", 0.003, 0.015), ("heading",), ("twirl", "spin")),
    ("linear_surge_drag", "hydrodynamics", _one("coefficient", "N s/m", "water.linear_surge", 0.1, 0.8), ("position",),
        ("tow_ahead", "gait")),
    ("quadratic_drag", "hydrodynamics", _one("coefficient", "N s2/m2", "water.quadratic_surge", 0.4, 3.0), ("position",),
        ("tow_ahead", "gait")),
    ("crossflow_drag", "hydrodynamics", _one("gain", "1", "water.crossflow", 0.15, 0.6, signed=True, least=-0.9), BODY,
        ("tow_sideways", "turn_left")),
    ("yaw_drag", "hydrodynamics", _one("coefficient", "N m s2", "water.yaw_drag", 0.005, 0.05), ("heading",),
        ("twirl", "spin")),
    ("body_lift", "hydrodynamics", _one("coefficient", "N s2/m2", "water.lift", 5.0, 25.0), BODY, ("tow_oblique", "turn_left")),
    ("munk_moment", "hydrodynamics", _one("gain", "1", "water.munk", 0.15, 0.6, signed=True), BODY,
        ("tow_oblique", "turn_left")),
    ("tail_normal_force", "hydrodynamics", _one("gain", "1", "water.tail", 0.1, 0.4, signed=True, least=-0.9), BODY, _SWIM),
    ("wake_memory", "hydrodynamics", _one("time", "s", "water.memory", 0.03, 0.2), BODY, ("gait", "gait_fast")),
    ("free_surface", "hydrodynamics", _one("gain", "N s2/m2", "water.surface", 30.0, 250.0), ("position",),
        ("gait_fast", "tow_ahead")),
    ("wall_effect", "hydrodynamics", _one("gain", "1", "water.wall", 0.3, 1.5), BODY, ("station_left", "tow_sideways")),
    ("joint_hydro_damping", "hydrodynamics", _one("coefficient", "N m s2", "water.joint", 0.01, 0.08), SERVO,
        ("gait_fast", "steps")),
    ("steady_current", "environment",
        tuple(EntryParameter(name=a, unit="m/s", field=f"tank.current_{a}", typical=(0.01, 0.04), signed=True) for a in "xy"),
        ("position",), ("drift_north", "gait")),
    ("current_shear", "environment", _one("rate", "1/s", "tank.shear", 0.02, 0.1, signed=True), BODY,
        ("station_left", "station_right")),
    ("turbulence", "environment", (*_one("sigma", "m/s", "tank.sigma", 0.01, 0.04), _keep("time", "s", "tank.time", 1.0, 2.0)),
        ("position",), ("drift_north", "gait")),
    ("tether", "environment",
        (*_one("stiffness", "N/m", "tank.tether", 0.05, 0.4), *_ANCHOR),
        ("position",), ("out_and_back", "gait")),
    ("swirl", "environment", _one("rate", "rad/s", "tank.swirl", 0.01, 0.05, signed=True), BODY, ("drift_north", "drift_east")),
    ("camera_scale", "measurement", _one("scale", "1", "camera.scale", 0.01, 0.04, signed=True, least=-0.9), ("position",),
        ("gait", "out_and_back")),
    ("camera_yaw", "measurement", _one("angle", "rad", "camera.angle", 0.02, 0.08, signed=True), BODY,
        ("gait", "out_and_back")),
    ("heading_marker_offset", "measurement", _one("angle", "rad", "camera.heading", 0.02, 0.08, signed=True), ("heading",),
        _SWIM),
    ("marker_offset", "measurement", _one("x", "m", "camera.marker", 0.01, 0.04, signed=True), ("position",), _TURN),
    ("lens_distortion", "measurement", _one("k1", "1/m2", "camera.k1", 0.005, 0.02, signed=True), ("position",),
        ("gait", "station_left")),
    ("power_offset", "measurement", _one("power", "W", "meter.offset", 0.1, 0.5, signed=True), ("power",), ("idle", "gait")),
]  # fmt: skip
_KEYS = ("name", "stage", "parameters", "shows", "runs")
CATALOGUE: dict[str, CatalogueEntry] = {
    row[0]: CatalogueEntry(
        **dict(zip(_KEYS, row, strict=True)), stochastic=row[0] in ("latency_jitter", "packet_loss", "turbulence")
    )
    for row in _ROWS
}
