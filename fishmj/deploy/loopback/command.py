"""`fishmj deploy loopback`: a robot without a fish, in real time behind UDP on this machine."""

from argparse import ArgumentTypeError
from math import pi
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.deploy.loopback import bodies, faults, network_faults
from fishmj.deploy.loopback.camera_frames import FrameOptions
from fishmj.deploy.loopback.firmware import PROTOCOLS
from fishmj.deploy.loopback.server import LOCAL, ServeOptions, serve
from fishmj.deploy.loopback.settings import Settings, calibration_of
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.gap.laboratory.virtual_robot.hidden_dataset import parse
from fishmj.water.flow import PRESETS, Flow

FASTEST, FAR = 1.0, 10.0  # m/s, m
EXAMPLES = """examples:
  fishmj deploy loopback --seed 3 --flow 0.2,3.14 --marks tag
  fishmj deploy loopback --fault loss=0.02 --fault brown_out@30 --effect command_latency:delay=0.15
  fishmj deploy loopback --protocol mish-0.1.0 --no-camera

faults, NAME[:up|:down][=VALUE][@T0[-T1]], T in s since the start:
"""


def options() -> console.Parser:
    """The arguments of `deploy loopback`."""
    about = "  " + "\n  ".join(faults.described())
    summary = "The loopback robot: it speaks the robot's protocols on 127.0.0.1, swims, draws frames, and fails when told to."
    parser = console.parser("deploy loopback", summary, examples=EXAMPLES + about)
    add = parser.add_argument
    waters = (bodies.VIRTUAL, bodies.FITTED, bodies.STRUCTURED)
    add("--body", choices=waters, default=bodies.VIRTUAL, help="the second robot, or one fish in this water")
    add("--engine", choices=bodies.ENGINES, default=bodies.MUJOCO, help="of the waters fitted and structured")
    add("--model", type=console.text, default="fish", metavar="ROBOT", help="the robot: name or TOML file (default fish)")
    add("--protocol", choices=PROTOCOLS, default=PROTOCOLS[0], help="of the datagrams; servo-bus: servos on a serial line")
    effect = "hide one in the second robot; may be repeated (default none)"
    fault = "one of the list below; may be repeated (default none)"
    add("--effect", type=console.text, action="append", default=[], metavar="NAME[:p=v]", help=effect)
    add("--fault", type=console.text, action="append", default=[], metavar="FAULT", help=fault)
    add("--seed", type=console.SEED, default=0, help="robot, noise, radio")
    add("--noise", type=console.number(0, 100), default=1.0, help="factor on the noise of the second robot's sensors")
    add("--nuisance", type=console.number(0, 0.5), default=0.1, help="relative half width of its unmeasured constants")
    start = "x, y [m] and yaw [rad] at the start"
    add("--start", type=numbers((-FAR, FAR), (-FAR, FAR), (-2 * pi, 2 * pi)), default="0,0,0", metavar="X,Y,YAW", help=start)
    flow = "stream, m/s and where it moves to, rad"
    add("--flow", type=numbers((0, FASTEST), (-2 * pi, 2 * pi)), default="0,0", metavar="SPEED,DIRECTION", help=flow)
    add("--turbulence", choices=PRESETS, default="none", help="of the stream; the second robot takes none and gust")
    add("--port", type=console.whole(0, 65535), help="of the robot; default 2333 of mish, else the system's choice")
    host = "of the host, before it has sent anything; default 6060 of mish, else none"
    add("--host-port", type=console.whole(0, 65535), help=host)
    add("--delay", type=console.number(0, 1), default=network_faults.DELAY, help="of the radio each way, s")
    add("--no-camera", action="store_true", help="draw no frames")
    add("--camera-latency", type=console.number(0, 1), help="s from exposure to frame; default the description's")
    add("--frame-rate", type=console.number(1, 500), default=50.0, help="frames a second")
    add("--marks", choices=("colour", "tag"), default="colour", help="on the fish: red head and yellow neck, or an AprilTag")
    add("--glare", type=console.number(0, 3), default=0.0, help="0 none, 1 glints over some percent of the tank")
    add("--ripple", type=console.number(0, 20), default=0.0, help="px, by which waves shift the image")
    add("--occlusion", type=console.number(0, 1), default=0.0, help="share of the head that something covers")
    add("--decoy", action="store_true", help="a second red object")
    camera = "calibration of the drawn camera, TOML; default 2.8 mm/px over the middle of the tank"
    add("--calibration", type=console.text, metavar="FILE", help=camera)
    add("--write-calibration", type=console.out_file, metavar="FILE", help="write it, for the tracker (default: not)")
    add("--seconds", type=console.number(0.1, 1e6), help="end after this time; default never")
    add("--parent", type=console.whole(1, 2**31), metavar="PID", help="end with this process (default: none)")
    return parser


def numbers(*ranges: tuple[float, float]):
    """The type of an option `A,B,..` with one number a range; its values as a tuple.

    Raises:
        ArgumentTypeError: another count, or a number out of its range.
    """

    def read(text: str) -> tuple[float, ...]:
        parts = text.split(",")
        if len(parts) != len(ranges):
            raise ArgumentTypeError(f"got {text[:40]!r}, expected {len(ranges)} numbers with commas")
        return tuple(console.number(*bounds)(part) for bounds, part in zip(ranges, parts, strict=True))

    return read


def served(args) -> ServeOptions:
    """Options of the server from the arguments.

    Raises:
        UnknownName, ConfigError: unknown or impossible names, faults or effects.
    """
    if args.effect and args.body != bodies.VIRTUAL:
        raise ConfigError(f"--effect {args.effect[0][:60]}: effects hide in the second robot alone; take --body {bodies.VIRTUAL}")
    picture = FrameOptions(glare=args.glare, ripple=args.ripple, occlusion=args.occlusion, decoy=args.decoy, seed=args.seed)
    flow = Flow(speed=args.flow[0], direction=args.flow[1], turbulence=args.turbulence, seed=args.seed)
    settings = Settings(
        body=args.body, engine=args.engine, robot=args.model, effects=parse(args.effect, args.seed), noise=args.noise,
        nuisance=args.nuisance, start=args.start, flow=flow,
        protocol=args.protocol, faults=faults.parse(args.fault), delay=args.delay, seed=args.seed,
        camera_latency=args.camera_latency, frame_rate=args.frame_rate, marks=args.marks, picture=picture,
        calibration=Calibration.read(Path(args.calibration)) if args.calibration else None,
    )  # fmt: skip
    return ServeOptions(
        settings=settings, address=LOCAL, port=args.port, host_port=args.host_port, camera=not args.no_camera,
        seconds=args.seconds, parent=args.parent,
    )  # fmt: skip


def main(argv: list[str]) -> int:
    """The command `deploy loopback`. Returns the exit code."""
    args = options().parse_args(argv)
    wanted = served(args)
    if args.write_calibration:
        calibration_of(wanted.settings).write(args.write_calibration)
    figures = serve(wanted)
    if args.json:
        console.emit_json(figures)
    return console.OK
