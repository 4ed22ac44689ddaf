"""Settings of a loopback robot as one value, for the command line, the server and lockstep."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fishmj.base.errors import ConfigError
from fishmj.base.options import SEED, number, setting, text
from fishmj.deploy.loopback import bodies, network_faults
from fishmj.deploy.loopback.camera import CameraTiming
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, FrameOptions
from fishmj.deploy.loopback.faults import LoopbackFault
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.protocols import PROTOCOLS, SERVO_BUS
from fishmj.deploy.tracker.calibration import Calibration, overhead
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow

WATERS = (bodies.VIRTUAL, bodies.FITTED, bodies.STRUCTURED)  # in real time
SIZE, SCALE, HEIGHT = (1280, 720), 2.8e-3, 3.0  # px, m/px and m: the camera over the tank where none is given


@dataclass(frozen=True, kw_only=True)
class LoopbackSettings:
    """One loopback robot.

    Attributes:
        body, robot, effects, noise, nuisance, start, flow, engine, domain: as `bodies.make`.
        protocol, faults, delay, spread, policy_sha256: as `robot.LoopbackRobot`.
        picture: disturbances between the fish and the file.
        calibration: of the drawn camera; None: 1280 x 720 px, 2.8 mm/px, 3 m over the middle of the tank.
    """

    body: str = setting(bodies.VIRTUAL, WATERS, "the second robot, or one fish in this water")
    robot: "str | Robot" = setting("fish", text, "the robot: name or TOML file (default fish)", "--model", "ROBOT")
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    noise: float = setting(1.0, number(0, 100), "factor on the noise of the second robot's sensors")
    nuisance: float = setting(0.1, number(0, 0.5), "relative half width of its unmeasured constants")
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    flow: Flow = Flow()
    engine: str = setting(bodies.MUJOCO, bodies.ENGINES, "of the waters fitted and structured")
    domain: str = "paper"
    protocol: str = setting(PROTOCOLS[0], PROTOCOLS, "of the datagrams; servo-bus: servos on a serial line")
    faults: tuple[LoopbackFault, ...] = ()
    delay: float = setting(network_faults.DELAY, number(0, 1), "of the radio each way, s")
    spread: float = network_faults.SPREAD
    policy_sha256: str = ""
    seed: int = setting(0, SEED, "robot, noise, radio")
    camera_latency: float | None = setting(None, number(0, 1), "s from exposure to frame; default the description's")
    frame_rate: float = setting(50.0, number(1, 500), "frames a second")
    marks: str = setting("colour", ("colour", "tag"), "on the fish: red head and yellow neck, or an AprilTag")
    picture: FrameOptions = FrameOptions()
    calibration: Calibration | None = None

    def __post_init__(self):
        if not 1.0 <= self.frame_rate <= 500.0:
            raise ConfigError(f"loopback: frame_rate = {self.frame_rate}; expected 1 to 500 frames a second")
        if self.camera_latency is not None and not 0.0 <= self.camera_latency <= 1.0:
            raise ConfigError(f"loopback: camera_latency = {self.camera_latency}; expected 0 to 1 s")


def make_robot(settings: LoopbackSettings) -> LoopbackRobot:
    """The robot at its time 0. Raises UnknownName, ConfigError: an unknown name or an impossible combination."""
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


def calibration_of(settings: LoopbackSettings) -> Calibration:
    """Calibration of the drawn camera; the host's tracker needs the same."""
    return settings.calibration or overhead(SIZE, SCALE, HEIGHT)


def artist_of(settings: LoopbackSettings) -> FrameArtist:
    """Artist that draws the robot's frames. Raises MissingExtra without OpenCV."""
    return FrameArtist(calibration_of(settings), FishLook.of(settings.robot, settings.marks), settings.picture)
