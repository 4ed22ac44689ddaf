"""Parameters of a generator's robot (body, servos, network, sensors, tank), and the hidden effects that change them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import Parameter
from fishmj.gap.laboratory.generators.family import Family, RobotWater, drawn
from fishmj.gap.laboratory.random_streams import generators_stream
from fishmj.mjcf.description import Robot

TOLERANCE = {"kp": 0.02, "kb": 0.03, "armature": 0.1, "friction": 0.3}  # relative half widths at nuisance 0.1, of one type
ARMATURE = 4e-4  # kg m2, rotor at the horn (chosen)
FRICTION = 0.006  # N m, dry, of a good gear train (chosen)


@dataclass
class RadioAndBus:
    """Radio and bus, s."""

    period: float
    latency: float  # from sending to the servo
    jitter: float = 0.001  # mean of an exponential, part of the nominal latency
    late: float = 0.0  # effect: mean of a further exponential
    loss: float = 0.0  # effect: probability
    angle_noise: float = 0.002  # rad (chosen)
    angle_step: float = 0.00209  # rad, of a 12-bit potentiometer over 490 deg (chosen)
    reading_delay: float = 0.0  # effect


@dataclass
class TankTracker:
    """The tracker above the tank."""

    latency: float  # s from exposure to the stamp
    period: float = 0.02  # s
    jitter: float = 0.0005  # s
    position_noise: float = 0.0015  # m (chosen)
    heading_noise: float = 0.010  # rad (chosen)
    offset: float = 0.0  # effect, s
    drift: float = 1.0  # effect
    scale: float = 0.0  # effect
    turned: float = 0.0  # effect, rad
    heading: float = 0.0  # effect, rad
    marker: float = 0.0  # effect, m
    lens: float = 0.0  # effect, 1/m2


@dataclass
class BatteryMeter:
    """Voltage and current of the battery lead."""

    period: float = 0.02  # s, also the averaging time
    voltage_noise: float = 0.01  # V (chosen)
    current_noise: float = 0.02  # A (chosen)
    offset: float = 0.0  # effect, W


@dataclass
class ServoFirmware:
    """Processing of commands in the servo, at 250 Hz."""

    period: float = 0.004  # s (chosen)
    step: float = 0.0  # rad, counts
    range: float = np.pi  # rad
    gain: float = 0.0  # effect
    coarse: float = 0.0  # effect, rad
    deadband: float = 0.0  # effect, rad
    slowness: float = 0.0  # effect, s/rad
    move_time: float = 0.0  # effect, s


@dataclass
class RobotParameters:
    """Robot before it is built. Arrays per joint (J,) or link (N,), SI. `each_step`, `specs`, `seen`, `read`: code of faults.

    each_step: f(run, t) before every physics step; specs: f(MuJoCo spec) before compilation;
    seen: f(camera's t, x, y, yaw, recording) -> (x, y, yaw); read: f(t, angles (K, J)) -> angles.
    """

    robot: Robot
    family: Family
    coefficients: dict[str, float]
    kp: np.ndarray
    kv: np.ndarray
    kb: np.ndarray
    torque: np.ndarray
    friction: np.ndarray
    armature: np.ndarray
    network: RadioAndBus
    camera: TankTracker
    firmware: ServoFirmware
    meter: BatteryMeter = field(default_factory=BatteryMeter)
    spring: np.ndarray = field(default_factory=lambda: np.zeros(0))
    zero: np.ndarray = field(default_factory=lambda: np.zeros(0))
    mass: np.ndarray = field(default_factory=lambda: np.zeros(0))  # kg on top of each link
    com: float = 0.0  # m, forward shift of the head's centre of mass
    inertia: float = 0.0  # kg m2 more in the head
    added: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))  # more added mass at the reference point
    drag: np.ndarray = field(default_factory=lambda: np.zeros(4))  # on the head: linear, quadratic, turning, lift
    tether: np.ndarray = field(default_factory=lambda: np.zeros(3))  # N/m, m, m
    flow: np.ndarray = field(default_factory=lambda: np.zeros(8))  # `chain.move`
    resistance: float = 0.0  # ohm, of the supply
    derating: float = 0.0  # 1/s
    each_step: list[Callable] = field(default_factory=list)
    specs: list[Callable] = field(default_factory=list)
    seen: list[Callable] = field(default_factory=list)
    read: list[Callable] = field(default_factory=list)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.robot.n_joints

    def water(self) -> RobotWater:
        """Water of the robot, with the effects' additions."""
        made = self.family.build(self.robot, self.coefficients)
        added = made.added.copy()
        added[0] += self.added
        return made._replace(added=added)


def healthy(
    robot: Robot, family: Family, seed: int, nuisance: float = 0.1, flow: tuple[float, float] = (0.0, 0.0)
) -> RobotParameters:
    """Robot without hidden effects; the seed draws its unmeasured constants. flow: set stream, m/s, m/s."""
    rng, servo, j = generators_stream(seed, "constants"), robot.servo, robot.n_joints
    coefficients = drawn(family, nuisance, rng)

    def each(value: float, key: str) -> np.ndarray:
        return value * (1.0 + nuisance / 0.1 * TOLERANCE[key] * rng.uniform(-1.0, 1.0, j))

    timing = robot.timing
    firmware = ServoFirmware(step=servo.resolution, range=servo.range)
    fish = RobotParameters(
        robot=robot,
        family=family,
        coefficients=coefficients,
        kp=each(servo.kp, "kp"),
        kv=np.full(j, servo.kv),
        kb=each(servo.kb, "kb"),
        torque=np.full(j, servo.torque),
        friction=each(FRICTION, "friction"),
        armature=each(ARMATURE, "armature"),
        network=RadioAndBus(timing.bus_dt, timing.command_latency - firmware.period / 2),  # mean wait for the next tick
        camera=TankTracker(timing.camera_latency),
        firmware=firmware,
        spring=np.zeros(j),
        zero=np.zeros(j),
        mass=np.zeros(len(robot.links)),
    )
    fish.flow[:2] = flow
    return fish


class HiddenEntry(NamedTuple):
    """Effect or fault to hide. act(fish, **values) changes the robot's constants."""

    name: str
    parameters: tuple[Parameter, ...]
    act: Callable
    catalogued: bool
    about: str

    @property
    def nulls(self) -> dict[str, float]:
        """Parameter values without effect."""
        return {p.name: p.null for p in self.parameters}

    def draw(self, rng: np.random.Generator, strength: float = 1.0) -> dict[str, float]:
        """Draws values of typical size: log-uniform distance from the null, times strength; random side if signed."""
        out = {}
        for p in self.parameters:
            low, high = (t - p.null for t in p.typical)
            if p.shape or low * high <= 0.0:
                out[p.name] = float(rng.uniform(*p.typical))
                continue
            near, far = sorted((abs(low), abs(high)))
            size = float(np.exp(rng.uniform(np.log(near), np.log(far)))) * strength * np.sign(high)
            side = -1.0 if p.signed and rng.random() < 0.5 else 1.0
            out[p.name] = float(np.clip(p.null + side * size, p.low, p.high))
        return out

    def put(self, fish: RobotParameters, values: Mapping[str, float]) -> None:
        """Hides the effect in a robot; missing parameters stay at their null.

        Raises UnknownName: no such parameter; ConfigError: a value that is no number or outside its bounds.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise UnknownName(f"parameter of {self.name}", name, known)
            p = known[name]
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not p.low <= value <= p.high:
                raise ConfigError(f"{self.name}: {name} = {value!r}; expected {p.low:g} to {p.high:g} {p.unit}")
        self.act(fish, **(self.nulls | {k: float(v) for k, v in values.items()}))
