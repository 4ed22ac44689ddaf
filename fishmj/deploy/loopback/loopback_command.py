"""`fishmj deploy loopback`: a robot without a fish, in real time behind UDP on this machine."""

from functools import partial
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.deploy.loopback import bodies, faults
from fishmj.deploy.loopback.camera_frames import FrameOptions
from fishmj.deploy.loopback.loopback_server import ServeOptions, serve
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, calibration_of
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.gap.laboratory.virtual_robot.hidden_dataset import parse
from fishmj.water.flow import PRESETS, Flow

FASTEST, FAR = 1.0, 10.0  # m/s, m
EXAMPLES = """examples:
  fishmj deploy loopback --seed 3 --flow 0.2,180 --marks tag
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
    robot, server = (partial(console.add_settings, parser, config) for config in (LoopbackSettings, ServeOptions))
    robot("body", "engine", "robot", "protocol")
    effect = "hide one in the second robot; may be repeated (default none)"
    fault = "one of the list below; may be repeated (default none)"
    add("--effect", type=console.text, action="append", default=[], metavar="NAME[:p=v]", help=effect)
    add("--fault", type=console.text, action="append", default=[], metavar="FAULT", help=fault)
    robot("seed", "noise", "nuisance")
    start = "x, y [m] and yaw [deg] at the start"
    add("--start", type=console.pose(FAR), default="0,0,0", metavar="X,Y,DEG", help=start)
    flow = "stream, m/s and where it moves to, deg"
    add("--flow", type=console.flow(FASTEST), default="0,0", metavar="M/S,DEG", help=flow)
    add("--turbulence", choices=PRESETS, default="none", help="of the stream; the second robot takes none and gust")
    server("port", "host_port")
    robot("delay")
    server("camera")
    robot("camera_latency", "frame_rate", "marks")
    console.add_settings(parser, FrameOptions, "glare", "ripple", "occlusion", "decoy")
    camera = "calibration of the drawn camera, TOML; default 2.8 mm/px over the middle of the tank"
    add("--calibration", type=console.text, metavar="FILE", help=camera)
    add("--write-calibration", type=console.out_file, metavar="FILE", help="write it, for the tracker (default: not)")
    server("seconds", "parent")
    return parser


def served(args) -> ServeOptions:
    """Options of the server from the arguments.

    Raises UnknownName, ConfigError: unknown or impossible names, faults or effects.
    """
    if args.effect and args.body != bodies.VIRTUAL:
        raise ConfigError(f"--effect {args.effect[0][:60]}: effects hide in the second robot alone; take --body {bodies.VIRTUAL}")
    picture = FrameOptions(seed=args.seed, **console.settings_of(args, FrameOptions))
    flow = Flow(speed=args.flow[0], direction=args.flow[1], turbulence=args.turbulence, seed=args.seed)
    settings = LoopbackSettings(
        effects=parse(args.effect, args.seed), start=args.start, flow=flow, faults=faults.parse(args.fault), picture=picture,
        calibration=Calibration.read(Path(args.calibration)) if args.calibration else None,
        **console.settings_of(args, LoopbackSettings),
    )  # fmt: skip
    return ServeOptions(settings=settings, **console.settings_of(args, ServeOptions))


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
