"""Constants of one virtual robot: description, own constants, nuisance draw and planted effects."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import pi, radians, tan
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError
from fishmj.base.units import G
from fishmj.gap.laboratory.virtual_robot import constant_groups as groups
from fishmj.gap.laboratory.virtual_robot.rigid_body import RigidBody, alike, body_of
from fishmj.mjcf.description import Robot, Servo

CONSTANTS = "virtual_robot"
ROUNDED = 1e-3  # relative
LINKS = 2, 8  # fewest and most of a chain
FIRMWARE_WAIT = 0.5  # firmware periods from arrival to the next tick, on average; part of the nominal latency


@dataclass(frozen=True, kw_only=True)
class RobotConstants:
    """Groups of constants (`constant_groups.py`) and the inputs of the body."""

    robot: Robot
    sections: dict  # table [water] of the constants after the nuisance draw
    placing: groups.StartScatter
    air: np.ndarray  # (4,) thread: stiffness N/m, damping N s/m, twist N m/rad, twist damping N m s/rad
    hull: groups.HullConstants
    water: groups.WaterConstants
    motor: groups.MotorConstants
    tank: groups.TankConstants
    network: groups.NetworkConstants
    camera: groups.CameraConstants
    meter: groups.MeterConstants
    odd: groups.UncataloguedEffects

    def with_fields(self, values: dict[str, float]) -> "RobotConstants":
        """A copy with dotted fields set: {"motor.deadband": 0.02}."""
        groups: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            group, _, key = name.partition(".")
            groups.setdefault(group, {})[key] = float(value)
        return replace(self, **{group: getattr(self, group)._replace(**fields) for group, fields in groups.items()})

    @cached_property
    def body(self) -> RigidBody:
        """Arrays of the links."""
        return body_of(self.robot, self.sections, self.hull)

    @property
    def zero(self) -> np.ndarray:
        """Hinge angle at which each servo reads zero (J,), rad; joints beyond the third share its value."""
        zeros = (self.motor.zero1, self.motor.zero2, self.motor.zero3)
        return np.array([zeros[min(j, len(zeros) - 1)] for j in range(self.robot.n_joints)])


def buildable(robot: Robot, whose: object = "") -> None:
    """Raises ConfigError, with an alternative, if the second simulator cannot represent `robot`. whose: its name for the user."""
    few, most = LINKS
    name, links = f"virtual robot: {str(whose or robot.name)[-80:]}", len(robot.links)
    if not few <= links <= most:
        works = "fishmj calibrate, train and replay take any number of links"
        raise ConfigError(f"{name} has {links} links; it is a chain of {few} to {most} ({works})")
    servo, period = robot.servo, read_toml(resolve(CONSTANTS))["motor"]["period"]
    stiff = servo.kp * period / (servo.kb + servo.kv)
    if stiff > 1.0:
        most_kp = (servo.kb + servo.kv) / period
        loop = f"its firmware closes the loop every {1e3 * period:g} ms, which does not hold kp = {servo.kp:g} N m/rad"
        raise ConfigError(
            f"{name}: {loop} against a damping of {servo.kb + servo.kv:.3g} N m s/rad; kp up to {most_kp:.3g} works"
        )


class WaterScales(NamedTuple):
    """Factors on the water of virtual_robot.toml: added mass, cross-flow drag, friction and form drag, edge momentum."""

    mass: float = 1.0
    cross: float = 1.0
    drag: float = 1.0
    edge: float = 1.0

    def of(self, wet: dict) -> dict:
        """The table [water] times these factors."""
        out = dict(wet)
        out["sections"] = [self.mass * k for k in wet["sections"]]
        for keys, scale in ((CROSS, self.cross), (ALONG, self.drag), (("edge",), self.edge)):
            out |= {key: scale * wet[key] for key in keys}
        return out


AS_IT_IS = WaterScales()
CROSS, ALONG = ("drag_round", "drag_flat"), ("friction", "head_forward", "head_backward")


def nominal(
    robot: Robot,
    medium: str = "water",
    nuisance: float = 0.0,
    rng: np.random.Generator | None = None,
    scales: WaterScales = AS_IT_IS,
) -> RobotConstants:
    """Constants of the robot without effects. nuisance: relative half width of the draw of unmeasured constants.

    Water coefficients and friction have the whole width, servo gain and motor resistance a fifth.
    """
    table = read_toml(resolve(CONSTANTS))

    def drawn(value, part=1.0):
        return value if rng is None else value * (1.0 + part * nuisance * rng.uniform(-1.0, 1.0))

    wet = scales.of(table["water"])
    scale = drawn(1.0)
    wet["sections"] = [scale * k for k in wet["sections"]]
    wet["surge"] = [drawn(1.0) * m for m in alike(wet["surge"], len(robot.links)).tolist()]
    for key in ("drag_round", "drag_flat", "friction", "head_forward", "head_backward", "edge", "wagner_lengths"):
        wet[key] = drawn(wet[key])
    rho, edge_height = robot.density_water, robot.links[-1].sections[-1][1]
    frontal = max(pi / 4 * h * w for link in robot.links for _, h, w in link.sections)
    head = 0.5 * rho * frontal * wet["head_forward"]
    water = groups.WaterConstants(
        active=float(medium == "water"),
        friction=wet["friction"],
        head_forward=head,
        head_backward=0.5 * rho * frontal * wet["head_backward"],
        oblique=wet["oblique"],
        edge_mass=wet["edge"] * rho * pi / 4 * edge_height**2,
        edge_height=edge_height,
        wagner_start=wet["wagner_start"],
        wagner_lengths=wet["wagner_lengths"],
        stall_slope=tan(radians(wet["stall_angle_deg"])),
    )
    servo, timing, raw = robot.servo, robot.timing, dict(table["motor"])
    resistance, constant = electrical(servo)
    motor = groups.MotorConstants(
        gain=drawn(servo.kp, 0.2),
        rate_gain=servo.kv,
        torque=servo.torque,
        resistance=drawn(resistance, 0.2),
        constant=constant,
        voltage=servo.voltage,
        nominal_voltage=servo.voltage,
        idle=servo.idle_power,
        step=servo.resolution,
        range=servo.range,
        limit=servo.torque,
        **{**raw, "dry": drawn(raw["dry"]), "viscous": drawn(raw["viscous"])},
    )
    latency = timing.command_latency - FIRMWARE_WAIT * motor.period
    network = groups.NetworkConstants(period=timing.bus_dt, latency=latency, **table["network"])
    vision = {"latency": timing.camera_latency, "window": float(timing.velocity_window)}
    air = table["air"]
    return RobotConstants(
        robot=robot,
        sections=wet,
        placing=groups.StartScatter(**table["placing"]),
        air=np.array([robot.mass * G / air["thread"], air["damping"], air["twist"], air["twist_damping"]]),
        hull=groups.HullConstants(),
        water=water,
        motor=motor,
        tank=groups.TankConstants(half=1.8),
        network=network,
        camera=groups.CameraConstants(**vision, **table["camera"]),
        meter=groups.MeterConstants(**table["meter"]),
        odd=groups.UncataloguedEffects(),
    )


def electrical(servo: Servo) -> tuple[float, float]:
    """(resistance [ohm], constant [V s/rad]) of the motor behind a servo's torque-speed line.

    The line determines both: constant = voltage / speed_no_load, resistance = constant voltage / torque. Described values are
    used if they give the same damping within data-sheet rounding; a calibration changes only the line.
    """
    if abs(servo.constant**2 / servo.resistance / servo.kb - 1.0) <= ROUNDED:
        return servo.resistance, servo.constant
    constant = servo.voltage / servo.speed_no_load
    return constant * servo.voltage / servo.torque, constant
