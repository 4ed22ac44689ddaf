"""Effects that a virtual robot can hide: each parameter is a field of `constant_groups.py`.

`CATALOGUE` holds effects of the catalogue, `ODDITIES` effects outside it, which a search should leave unexplained. A row has
parameters, affected channels and revealing experiments. Units are SI, nulls 0 unless the row states another. Delays add
to the nominal ones of the fish description.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName


@dataclass(frozen=True, kw_only=True)
class EntryParameter:
    """Parameter, SI. typical: (low, high) magnitude; signed: values on both sides of the null; least, most: possible range."""

    name: str
    unit: str
    field: str  # "motor.deadband"
    typical: tuple[float, float]
    null: float = 0.0
    signed: bool = False
    least: float = -np.inf
    most: float = np.inf
    default: bool = False  # secondary: no effect while the first is null; null is its usual value


@dataclass(frozen=True, kw_only=True)
class CatalogueEntry:
    """Effect to hide. shows: channels in which it must be visible; runs: experiments that reveal it well."""

    name: str
    stage: str
    parameters: tuple[EntryParameter, ...]
    shows: tuple[str, ...]
    runs: tuple[str, ...]
    stochastic: bool = False  # differs between replicates
    catalogued: bool = True
    about: str = ""  # of effects outside the catalogue

    @property
    def nulls(self) -> dict[str, float]:
        """Parameter values without effect."""
        return {p.name: p.null for p in self.parameters}

    @property
    def typical(self) -> dict[str, float]:
        """Larger typical magnitudes; secondary parameters at their usual value."""
        return {p.name: p.null if p.default else p.typical[1] for p in self.parameters}

    def draw(self, rng: np.random.Generator, strength: float = 1.0) -> dict[str, float]:
        """Draws values of typical size: log-uniform between low and high, times `strength`, with random sign if signed."""
        values = {}
        for p in self.parameters:
            low, high = sorted(p.typical)
            size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
            sign = -1.0 if p.signed and rng.random() < 0.5 else 1.0
            if p.default:
                values[p.name] = sign * size
            elif p.null:
                values[p.name] = p.null + (size - p.null) * strength
            else:
                values[p.name] = sign * size * strength
            values[p.name] = float(np.clip(values[p.name], p.least, p.most))
        return values

    def fields(self, values: Mapping[str, float]) -> dict[str, float]:
        """Fields for given parameter values, as {"motor.deadband": 0.01}; missing parameters stay at their null.

        Raises UnknownName: no such parameter; ConfigError: a value that is no number or out of range.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise UnknownName(f"parameter of {self.name}", name, known)
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not np.isfinite(value):
                raise ConfigError(f"effect {self.name}: {name} = {value!r}; expected a finite number in {known[name].unit}")
            least, most = known[name].least, known[name].most
            if not least <= value <= most:
                bounds = f"from {least:g}" + (f" to {most:g}" if np.isfinite(most) else "")
                raise ConfigError(f"effect {self.name}: {name} = {value!r}; expected a number {bounds}, unit {known[name].unit}")
        return {p.field: float(values.get(p.name, p.null)) for p in self.parameters}


SERVO, BODY, ALL = ("joint",), ("position", "heading"), ("joint", "position", "heading")
_SWIM, _TURN = ("gait", "turn_left"), ("turn_left", "spin")


def _one(name, unit, field, low, high, *, null=0.0, signed=False, least=None, most=np.inf) -> tuple[EntryParameter, ...]:
    """Main parameter. An unsigned one is not negative, except for inertia and water, which may be smaller than described."""
    if least is None:
        least = -np.inf if signed or field.startswith(("hull.", "water.")) else 0.0
    return (
        EntryParameter(name=name, unit=unit, field=field, typical=(low, high), null=null, signed=signed, least=least, most=most),
    )


def _keep(name, unit, field, value, spread=1.5, least=1e-3) -> EntryParameter:
    """Secondary parameter, without effect while the first is null."""
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
_DRAWN = ("latency_jitter", "packet_loss", "turbulence")
CATALOGUE: dict[str, CatalogueEntry] = {
    name: CatalogueEntry(name=name, stage=stage, parameters=parameters, shows=shows, runs=runs, stochastic=name in _DRAWN)
    for name, stage, parameters, shows, runs in _ROWS
}
# families differ in kind: memory, coupling, asymmetry, place, time, timing, sensing
_ODD_ROWS: list[tuple] = [
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
    for name, about, parameters, shows, runs in _ODD_ROWS
}
