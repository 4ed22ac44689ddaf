"""A segment: one fish in one box of water for some seconds, described by plain numbers, and the `Drive` that moves it.

Servos follow commands, joints or a root follow a path exactly, or a policy steers. A kind of drive is a function
(segment, robot) -> `Drive`, registered by its name in `KINDS`; its keywords are the rest of `segment.drive`. Times count from
the start of the segment, settling included. Angles are rad.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from math import ceil, log, pi
from typing import Any, NamedTuple

import numpy as np

from fishmj import control
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import json_sha256
from fishmj.engines import nominal_params, ticks_per
from fishmj.hydro_fit.segment_dataset import SPLITS
from fishmj.lbm_oracle.run.setup import Gait
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import SensorWindow
from fishmj.tasks.sensing import Sensors
from fishmj.water.flow import Flow

Path = Callable[[float], np.ndarray]
BUSY = 0.85  # of the servo's no-load speed: no wave asks for more, the servo would only be driven into its limit
EASE = 0.25  # s, over which a manoeuvre's frequency, amplitude and bias change


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Run that is kept as one record; plain numbers that can be sent to another machine. SI units, radians.

    episode: segments of one episode share its split; they differ in slip, nudge or time step. drive: kind of `KINDS`
    and its settings. settle: s before the record begins. pose (3,), joints (J,), velocity (3 + J,): at the start, velocity at
    rest when empty. nudge: cells by which the fish is shifted. finer: number of time steps in one of the domain's.
    """

    id: str
    block: str
    episode: str
    split: str
    seconds: float
    drive: dict[str, Any]
    settle: float = 0.0
    slip: float = 1.0
    flow: Flow = field(default_factory=Flow)
    pose: tuple[float, ...] = (0.0, 0.0, 0.0)
    joints: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    nudge: tuple[float, float] = (0.0, 0.0)
    finer: int = 1
    replicate_of: str = ""

    def __post_init__(self):
        if self.split not in SPLITS:
            raise ConfigError(f"segment {self.id}: split = {self.split!r}; expected one of {', '.join(SPLITS)}")
        if not (self.seconds > 0 and self.settle >= 0 and 0 <= self.slip <= 1 and self.finer >= 1):
            got = f"seconds = {self.seconds}, settle = {self.settle}, slip = {self.slip}, finer = {self.finer}"
            raise ConfigError(f"segment {self.id}: {got}; expected > 0 s, >= 0 s, 0 to 1, >= 1")

    @property
    def water(self) -> float:
        """Seconds of water of the segment, in steps of the domain."""
        return (self.settle + self.seconds) * self.finer

    def table(self) -> dict:
        """Segment as plain numbers, for JSON and for other machines."""
        return asdict(self)

    @classmethod
    def of(cls, table: dict) -> "Segment":
        """Inverse of `table`, also after JSON."""
        known = {item.name for item in fields(cls)}
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in table.items() if key in known
        }
        values["flow"] = Flow(**table["flow"])
        return cls(**values)

    @property
    def sha256(self) -> str:
        """sha256 of all settings that determine the segment."""
        return json_sha256(self.table())


class Drive(NamedTuple):
    """command(tick, run) -> (J,) rad; joints, root: paths (J,) rad and (3,) m, m, rad, None if nothing is prescribed."""

    command: Callable[[int, Any], np.ndarray]
    joints: Path | None = None
    root: Path | None = None


def drive(segment: Segment, robot: Robot) -> Drive:
    """Drive of a segment. Raises UnknownName: no such kind; ConfigError: unknown settings."""
    settings = dict(segment.drive)
    kind = str(settings.pop("kind", ""))
    if kind not in KINDS:
        raise UnknownName("kind of drive", kind, KINDS)
    try:
        return KINDS[kind](segment, robot, **settings)
    except TypeError as error:
        raise ConfigError(f"segment {segment.id}: drive {kind!r} with {', '.join(settings)}: {error}") from error


def ticks_of(segment: Segment, robot: Robot) -> tuple[int, int]:
    """Numbers of bus ticks before the record and in all."""
    tick = robot.timing.bus_dt
    before = round(segment.settle / tick)
    return before, before + max(1, round(segment.seconds / tick))


def gentle(robot: Robot, frequency, amplitude):
    """Amplitude, lowered if the servo could not follow: A 2 pi f <= `BUSY` of its no-load speed."""
    return np.minimum(amplitude, BUSY * robot.servo.speed_no_load / (2 * pi * np.asarray(frequency)))


def hold(segment: Segment, robot: Robot, *, rate: float = 0.0) -> Drive:
    """Held in the stream, joints as at the start; the heading turns at `rate` rad/s once settled."""
    start, joints = np.array(segment.pose), _joints(segment, robot)

    turned = lambda t: np.array([0.0, 0.0, rate * max(t - segment.settle, 0.0)])
    return Drive(lambda tick, run: joints, lambda t: joints, lambda t: start + turned(t))


def shake(segment: Segment, robot: Robot, *, along: str, amplitude: float, frequency: float) -> Drive:
    """Forced oscillation along `x`, `y`, `yaw` or a joint `j1`, .. of an otherwise held fish; m or rad."""
    start, joints = np.array(segment.pose), _joints(segment, robot)
    names = ("x", "y", "yaw", *(f"j{i + 1}" for i in range(robot.n_joints)))
    if along not in names:
        raise UnknownName("coordinate", along, names)
    root_share, joint_share = (np.array([float(name == along) for name in part]) for part in (names[:3], names[3:]))
    wave = Gait(joints=1, frequency=frequency, amplitude=amplitude, ramp=1 / frequency)
    return Drive(lambda tick, run: joints, lambda t: joints + joint_share * wave(t)[0], lambda t: start + root_share * wave(t)[0])


def chirp(
    segment: Segment, robot: Robot, *, low: float, high: float, amplitude: float, ratio: float, lag: float, held: bool
) -> Drive:
    """Joints sweep from `low` to `high` Hz, each next one `ratio` times as fast; held and exact, or free by the servos.

    phi = 2 pi low T / k (exp(k t / T) - 1),  k = ln(high / low)
    """
    whole, k = segment.settle + segment.seconds, log(high / low)
    speeds, lags = ratio ** np.arange(robot.n_joints), lag * np.arange(robot.n_joints)
    joints, start = _joints(segment, robot), np.array(segment.pose)

    def wave(t: float) -> np.ndarray:
        rate = low * np.exp(k * t / whole) * speeds
        phase = 2 * pi * low * whole / k * (np.exp(k * t / whole) - 1) * speeds - lags
        return joints + min(t, 1.0) * gentle(robot, rate, amplitude) * np.sin(phase)

    if held:
        return Drive(lambda tick, run: joints, wave, lambda t: start)
    return Drive(lambda tick, run: wave(tick * robot.timing.bus_dt))


def gait(
    segment: Segment, robot: Robot, *, frequency: float, amplitude, lag: float, bias: float, ramp: float = 1.0, held: bool = False
) -> Drive:
    """Travelling wave by the servos, or held and exact.

    `bias`: sum over joints, `amplitude`: one number, or one for each joint.
    """
    n = robot.n_joints
    wanted = tuple(gentle(robot, frequency, np.broadcast_to(amplitude, n)).tolist())
    made = Gait(joints=n, frequency=frequency, amplitude=wanted, lag=lag, bias=bias / n, ramp=ramp)

    def wave(t: float) -> np.ndarray:
        still = np.broadcast_to(made.bias, n)
        return min(t / 0.5, 1.0) * still + (made(t) - still)  # the bias, too, comes in gradually

    start = np.array(segment.pose)
    command = lambda tick, run: wave(tick * robot.timing.bus_dt)
    return Drive(command, wave, lambda t: start) if held else Drive(command)


def targets(segment: Segment, robot: Robot, *, amplitude: float, path: str, seed: int) -> Drive:
    """New random joint angles within +-amplitude every control step, held or reached in a straight line."""
    timing = robot.timing
    every = round(timing.control_dt / timing.bus_dt)
    rng = np.random.default_rng([7, seed])
    goals = rng.uniform(-amplitude, amplitude, (ticks_of(segment, robot)[1] // every + 2, robot.n_joints))
    goals[0] = _joints(segment, robot)
    if path not in ("hold", "linear"):
        raise UnknownName("path", path, ("hold", "linear"))

    def command(tick: int, run) -> np.ndarray:
        step, part = divmod(tick, every)
        share = 1.0 if path == "hold" else (part + 1) / every
        return goals[step] + share * (goals[step + 1] - goals[step])

    return Drive(command)


def manoeuvre(segment: Segment, robot: Robot, *, phases, lag: float) -> Drive:
    """Phases of (seconds, frequency, amplitude, bias over all joints) of one wave, which stays continuous."""
    tick = robot.timing.bus_dt
    ends = np.cumsum([row[0] for row in phases])
    time = np.arange(ticks_of(segment, robot)[1] + 1) * tick
    wanted = np.array([row[1:] for row in phases], float)[np.minimum(np.searchsorted(ends, time, "right"), len(phases) - 1)]
    eased, now = [], np.array([wanted[0, 0], 0.0, 0.0])
    for row in wanted:
        now = now + (row - now) * min(1.0, tick / EASE)
        eased.append(now)
    frequency, amplitude, bias = np.array(eased).T
    phase = 2 * pi * tick * np.cumsum(frequency)[:, None] - lag * np.arange(robot.n_joints)
    wave = gentle(robot, np.maximum(frequency, 1e-3), amplitude)[:, None] * np.sin(phase) + bias[:, None] / robot.n_joints
    return Drive(lambda tick, run: wave[min(tick, len(wave) - 1)])


class ClosedLoop:
    """A controller that steers a segment: it gets its usual observations, noisy and late, every control step.

    Called as (tick, run) once every bus tick, in order; returns the command (J,) rad.

    Raises UnknownName, ConfigError: no such controller, or none for this robot.
    """

    def __init__(self, segment: Segment, robot: Robot, controller: str, target, seed: int, noise: float):
        # A segment serves the fit of a water, so it is the swim of the nominal body; its identity (`segment_dataset.fingerprint`)
        # leaves effects out. With effects on the sensors, one segment would be two swims.
        self.robot = replace(robot, effects=())
        self.target = np.asarray(target, float)[None]
        self.controller = control.make(controller, self.robot)
        self.controller.reset(1)
        self.ticks = ticks_per(robot)[1]
        self.sensors, self.params = Sensors(self.robot), nominal_params(self.robot, 1)
        self.camera = np.array([ceil(robot.timing.camera_latency / robot.timing.bus_dt - 1e-6)])
        self.rng, self.noise = np.random.default_rng([11, seed]), noise
        self.window = SensorWindow.at_rest(self.robot, self.sensors, np.asarray(segment.pose, float)[None])

    def __call__(self, tick: int, run) -> np.ndarray:
        pose = run.pose[None, None, :3] if tick else self.window.pose[:, -1:]  # the camera has not seen how the fish was nudged
        self.window = self.window.after(pose, run.angles()[None, None], run.rates()[None, None])
        step = tick % self.ticks
        if step == 0:
            noise = self.noise * self.rng.standard_normal((1, 5 + 2 * self.robot.n_joints))
            senses = (self.window.pose, self.camera, self.window.joint)
            obs = task.observe_with_sensors(np, self.robot, self.sensors, self.params, *senses, self.target, noise)
            self.commands = np.asarray(self.controller(obs), float)[0]
        return self.commands[step]


def policy(
    segment: Segment, robot: Robot, *, controller: str, target, sha256: str = "", seed: int = 0, noise: float = 1.0
) -> Drive:
    """A controller or policy file that steers for `target` (2,) m, with the sensors' noise and latency.

    Raises ConfigError: the policy here is not the one with this sha256.
    """
    closed = ClosedLoop(segment, robot, controller, target, seed, noise)
    if sha256 and (got := getattr(closed.controller, "sha256", "")) != sha256:
        raise ConfigError(
            f"segment {segment.id}: policy {controller}: expected sha256 {sha256}, got {got}; plan again with this file"
        )
    return Drive(closed)


def _joints(segment: Segment, robot: Robot) -> np.ndarray:
    joints = np.array(segment.joints or np.zeros(robot.n_joints), float)
    if joints.shape != (robot.n_joints,):
        raise ConfigError(f"segment {segment.id}: {len(joints)} joint angles; {robot.name} has {robot.n_joints} joints")
    return joints


KINDS: dict[str, Callable[..., Drive]] = {
    "hold": hold,
    "shake": shake,
    "chirp": chirp,
    "gait": gait,
    "targets": targets,
    "manoeuvre": manoeuvre,
    "policy": policy,
}
