"""Settings of a loopback robot as one value, for the command line, the server and lockstep."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fishmj.base.errors import ConfigError
from fishmj.deploy.loopback import bodies, network_faults
from fishmj.deploy.loopback.camera import CameraTiming
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, FrameOptions
from fishmj.deploy.loopback.faults import Fault
from fishmj.deploy.loopback.firmware import PROTOCOLS, SERVO_BUS
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.tracker.calibration import Calibration, overhead
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow

SIZE, SCALE, HEIGHT = (1280, 720), 2.8e-3, 3.0  # px, m/px and m: the camera over the tank where none is given


@dataclass(frozen=True, kw_only=True)
class Settings:
    """One loopback robot.

    Attributes:
        body, robot, effects, noise, nuisance, start, flow, engine, domain: as `bodies.make`.
        protocol, faults, delay, spread, policy_sha256: as `robot.LoopbackRobot`.
        seed: of all random numbers.
        camera_latency: time from exposure until a frame is readable, s; None: the description's. frame_rate: 1/s.
        marks: on the drawn fish, "colour" or "tag". picture: disturbances between the fish and the file.
        calibration: of the drawn camera; None: 1280 x 720 px, 2.8 mm/px, 3 m over the middle of the tank.
    """

    body: str = bodies.VIRTUAL
    robot: "str | Robot" = "fish"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    noise: float = 1.0
    nuisance: float = 0.1
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    flow: Flow = Flow()
    engine: str = bodies.MUJOCO
    domain: str = "paper"
    protocol: str = PROTOCOLS[0]
    faults: tuple[Fault, ...] = ()
    delay: float = network_faults.DELAY
    spread: float = network_faults.SPREAD
    policy_sha256: str = ""
    seed: int = 0
    camera_latency: float | None = None
    frame_rate: float = 50.0
    marks: str = "colour"
    picture: FrameOptions = FrameOptions()
    calibration: Calibration | None = None

    def __post_init__(self):
        if not 1.0 <= self.frame_rate <= 500.0:
            raise ConfigError(f"loopback: frame_rate = {self.frame_rate}; expected 1 to 500 frames a second")
        if self.camera_latency is not None and not 0.0 <= self.camera_latency <= 1.0:
            raise ConfigError(f"loopback: camera_latency = {self.camera_latency}; expected 0 to 1 s")


def make_robot(settings: Settings) -> LoopbackRobot:
    """The robot at its time 0.

    Raises:
        UnknownName, ConfigError: an unknown name or an impossible combination.
    """
    s, described = settings, load_robot(settings.robot)
    delay, spread = (0.0, 0.0) if s.protocol == SERVO_BUS else (s.delay, s.spread)
    body = bodies.make(
        s.body, robot=described, effects=s.effects, seed=s.seed, noise=s.noise, nuisance=s.nuisance, start=s.start, flow=s.flow,
        radio=delay, engine=s.engine, domain=s.domain,
    )  # fmt: skip
    latency = described.timing.camera_latency if s.camera_latency is None else s.camera_latency
    timing = CameraTiming(period=1.0 / s.frame_rate, latency=latency)
    return LoopbackRobot(
        body, s.protocol, s.faults, s.seed, delay=delay, spread=spread, camera=timing, policy_sha256=s.policy_sha256
    )


def calibration_of(settings: Settings) -> Calibration:
    """Calibration of the drawn camera; the host's tracker needs the same."""
    return settings.calibration or overhead(SIZE, SCALE, HEIGHT)


def artist_of(settings: Settings) -> FrameArtist:
    """Artist that draws the robot's frames. Raises MissingExtra without OpenCV."""
    return FrameArtist(calibration_of(settings), FishLook.of(settings.robot, settings.marks), settings.picture)
