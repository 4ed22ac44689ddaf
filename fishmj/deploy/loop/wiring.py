"""Opens the devices that the options name: link, camera, tracker, and the loopback robot as a process of its own.

--link    loopback | udp://HOST[:PORT] | serial:DEVICE        --camera    loopback | shm:NAME | NUMBER | FILE
"""

import json
import os
import re
import shlex
import shutil
import sys
import tempfile
from argparse import ArgumentTypeError
from cmath import rect
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from math import degrees, inf, radians
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.processes import end_command, last_words, start_command
from fishmj.base.store import temporary_beside
from fishmj.deploy.camera.cameras import Camera, Device, SharedFrames, VideoFile
from fishmj.deploy.camera.localiser import InProcess, Localiser
from fishmj.deploy.link.links import RobotLink, datagram_link
from fishmj.deploy.link.servo_bus_link import ServoBusLink
from fishmj.deploy.link.transports import UdpTransport, open_serial
from fishmj.deploy.loop.clock import Clock, MonotonicClock
from fishmj.deploy.loop.watch import Thresholds
from fishmj.deploy.protocols import PROTOCOLS, SERVO_BUS, mish
from fishmj.deploy.protocols.servo_bus import BUSES
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.deploy.tracker.colour import PAPER_FISH, Bands, ColourTracker, Paint
from fishmj.deploy.tracker.fix import Tracker
from fishmj.mjcf import geometry_of, servo_buses
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

PORTS = {"fishmj-1": 2334}  # of the robot where the link names none; mish has its own
OF_HOST = {"--protocol": "--protocol", "--model": "--robot", "--marks": "--tracker", "--parent": "", "--write-calibration": ""}
STARTS = 60.0  # s that the loopback robot may take: it compiles its water at its first start
ENDS = 5.0  # s that it may take to end
NEAR = 0.005  # m that a painted band may stand off the head link, by the ruler
WIDER = 1.25  # times the head's width: a round hull, painted down its sides
WAIT = 0.002  # s that a read of the servo bus waits


@dataclass(frozen=True)
class Wired:
    """Opened devices for `swim`. loopback: the robot is simulated. calibration: of the camera, None without one."""

    link: RobotLink
    localiser: Localiser
    clock: Clock
    loopback: bool
    calibration: Calibration | None = None


@dataclass(frozen=True)
class Loopback:
    """A running loopback robot: its ports, the name of its frames, the file of its calibration.

    device: serial line of its servos, in place of the ports.
    """

    port: int
    host_port: int
    frames: str | None
    calibration: Path
    device: str = ""


def link_options(parser: console.Parser) -> None:
    """Adds the options for the link to the robot."""
    add, ports = parser.add_argument, f"{PORTS[PROTOCOLS[0]]}; of mish {mish.ROBOT_PORT}"
    link = f"loopback, serial:DEVICE, or udp://HOST[:PORT] (default port {ports})"
    add("--link", type=link_text, default="loopback", metavar="LINK", help=link)
    protocol = "of the datagrams; servo-bus with loopback: to its servos, as serial: does"
    add("--protocol", choices=PROTOCOLS, default=PROTOCOLS[0], help=protocol)
    add("--host-port", type=console.whole(0, 65535), help="of this computer, which the robot sends to (default 6060 of mish)")
    rig = "; default as the description's [rig] has it"
    add("--servo-ids", type=whole_numbers, metavar="A,B,..", help=f"on the servo bus, from the head to the tail{rig}")
    add("--servo-zeros-deg", type=numbers, metavar="A,B,..", help=f"of each servo with its joint straight{rig}")
    add("--servo-signs", type=whole_numbers, metavar="A,B,..", help=f"-1 for a servo that turns the other way{rig}")
    add("--baud", type=console.whole(9600, 4_500_000), help=f"of the servo bus{rig}")


def camera_options(parser: console.Parser) -> None:
    """Adds the options for camera and tracker."""
    camera = "loopback, shm:NAME, a camera's number, or a video file (default: the loopback's)"
    parser.add_argument("--camera", type=console.text, metavar="CAMERA", help=camera)
    tracker_options(parser)


def tracker_options(parser: console.Parser) -> None:
    """Adds the options for the tracked marks and the camera's calibration."""
    add = parser.add_argument
    add("--calibration", type=console.path, metavar="FILE", help="of the camera over the tank; needed but with loopback")
    add("--tracker", choices=("tag", "colour"), default="tag", help="AprilTag, or red head and yellow neck")
    tag_options(parser)
    mount = "its middle in the body frame, m, and the turn of its x axis from the nose, deg"
    add("--tag-mount", type=console.pose(1000), default=(0.06, 0.0, 0.0), metavar="X,Y,DEG", help=mount)
    add("--tag-height", type=console.number(-1, 1), default=0.03, help="over the water, m")
    painted = "x:width of the {} paint, m, body frame, from the rear to the front; default as the description's [rig] has it"
    for name in ("red", "yellow"):
        add(f"--{name}", type=bands, metavar="X:W,X:W", help=painted.format(name))
    add("--paint-height", type=console.number(-1, 1), help="of the paint over the water, m; default of [rig], else -0.005")


def tag_options(parser: console.Parser) -> None:
    """Adds the options for the tag's family, number and size."""
    add = parser.add_argument
    add("--tag-family", choices=("36h11", "16h5"), default="36h11", help="of the tag")
    add("--tag-number", type=console.whole(0, 586), default=0, help="of the tag")
    add("--tag-size", type=console.number(0.005, 1), default=0.06, help="outer side of its black border, m")


def loopback_options(parser: console.Parser) -> None:
    """Adds the options for the loopback robot."""
    about = "options of fishmj deploy loopback as one text, such as '--body fitted --fault loss=0.02' (default none)"
    parser.add_argument("--loopback", type=console.text, metavar="OPTIONS", help=about)


def parsed(made: console.Parser, argv: list[str]) -> Any:
    """Arguments of a command that opens a robot; `flow` of a loopback robot is its own.

    Raises ConfigError: an option that its link, camera or tracker does not heed.
    """
    args = made.parse_args(argv)
    ours, line = args.link == "loopback", args.link.startswith("serial:")
    bus, seen = line or args.protocol == SERVO_BUS, not ours or args.camera not in (None, "loopback")
    tag, paint = ("tag-family", "tag-number", "tag-size", "tag-mount", "tag-height"), ("red", "yellow", "paint-height")
    needs = {
        "--link serial:DEVICE or --protocol servo-bus": (bus, ("servo-ids", "servo-zeros-deg", "servo-signs", "baud")),
        "--link loopback": (ours, ("loopback",)),
        "--link udp://HOST": (not bus, ("host-port",)),
        "--link udp://HOST or loopback": (not line or args.protocol == SERVO_BUS, ("protocol",)),
        "--tracker tag": (args.tracker == "tag", tag),
        "--tracker colour": (args.tracker == "colour", paint),
        "a camera other than the loopback's, which draws its own marks": (seen, (*tag, *paint)),
    }
    prog = made.prog.removeprefix("fishmj ")
    console.refuse_unheeded(prog, args, made, needs)
    for option in re.findall(r"(?<!\S)--[a-z-]+", args.loopback or ""):
        if (own := OF_HOST.get(option)) is not None:
            renamed = f", {own}" * (own != option)
            beside = f"is an option of {prog} itself{renamed}: give it beside --loopback"
            todo = beside if own else f"is set by {prog}: leave it out"
            raise ConfigError(f"{prog}: --loopback: {option} {todo}")
    if ours and hasattr(args, "flow") and (theirs := _loopback_flow(args.loopback)) is not None:
        mine = args.flow = theirs if args.flow is None else args.flow
        if abs(rect(*mine) - rect(*theirs)) > 1e-6:
            stated, its = (f"{speed:g},{degrees(to):g}" for speed, to in (mine, theirs))
            both = f"--flow {stated} beside a loopback robot in a stream of {its}"
            raise ConfigError(f"{both}: the log would state another stream than the robot's; give --loopback the same --flow")
    return args


def _loopback_flow(words: str | None) -> tuple[float, ...] | None:
    """Stream, m/s and rad, of the loopback robot: still water unless its options state another; None: they are wrong."""
    if not words or "--flow" not in words:
        return 0.0, 0.0
    stated = re.findall(r"--flow[=\s]+['\"]?([-+.,\w]+)", words)
    try:
        return console.flow(inf)(stated[-1])
    except (IndexError, ArgumentTypeError):
        return None


def wire(args: Any, robot: Robot, stack: ExitStack) -> Wired:
    """Opens all devices that the options name; `stack` closes them.

    Raises ConfigError: a device is missing, or options contradict each other. MissingExtra: a package is not installed.
    """
    clock = MonotonicClock()
    if args.link.startswith("serial:") or args.protocol == SERVO_BUS:
        servo_link(args, robot, clock, partial(open_serial, "", WAIT))  # refuses numbers that cannot be before a robot is started
    fish = _loopback(args, robot, stack) if args.link == "loopback" else None
    camera = camera_of(args.camera, fish)
    link, calibration = make_link(args, robot, clock, fish), calibration_of(args, fish)
    localiser = InProcess(tracker_words(args, camera, fish, robot))
    for part in (link, localiser):
        part.open()
        stack.callback(part.close)
    return Wired(link, localiser, clock, fish is not None, calibration)


def make_link(args: Any, robot: Robot, clock: Clock, fish: Loopback | None) -> RobotLink:
    """The link that the options name, not opened yet."""
    kind, _, where = args.link.partition(":")
    if kind == "serial" or (fish is not None and fish.device):
        opened = partial(open_serial, fish.device if fish is not None else where, WAIT)
        return servo_link(args, robot, clock, opened, 0.0 if fish is None else Thresholds().silent)
    if args.protocol == SERVO_BUS and fish is None:
        raise ConfigError(f"--protocol {SERVO_BUS} --link {args.link}: a servo bus is a line; take serial:DEVICE or loopback")
    if fish is not None:
        host, port, listen = "127.0.0.1", fish.port, fish.host_port
    else:
        is_mish = args.protocol != PROTOCOLS[0]
        host, port = address(mish.ROBOT_PORT if is_mish else PORTS[args.protocol])(where.removeprefix("//"))
        listen = mish.HOST_PORT if is_mish else 0
    transport = UdpTransport(host, port, clock, args.host_port if args.host_port is not None else listen)
    if args.protocol != PROTOCOLS[0] and robot.n_joints != mish.JOINTS:
        raise ConfigError(f"{args.protocol} carries {mish.JOINTS} joints, {robot.name} has {robot.n_joints}; take fishmj-1")
    return datagram_link(args.protocol, transport)


def servo_link(args: Any, robot: Robot, clock: Clock, opened: Callable[[int], Any], patience: float = 0.0) -> ServoBusLink:
    """The robot's servo bus, from the options, else from the description's rig.

    Args:
        opened: makes the serial line at a baud rate. patience: s, as of `ServoBusLink`.

    Raises ConfigError: another count of numbers than joints; errors of `ServoBusLink`.
    """
    rig = robot.rig
    zeros = tuple(map(radians, args.servo_zeros_deg)) if args.servo_zeros_deg else rig.zeros
    ids, signs = args.servo_ids or robot.servo_ids, args.servo_signs or rig.signs
    for name, given in (("--servo-ids", ids), ("--servo-zeros-deg", zeros), ("--servo-signs", signs)):
        if given is not None and len(given) != robot.n_joints:
            joints = f"{robot.n_joints} joint{'s' * (robot.n_joints > 1)}"
            raise ConfigError(f"{name}: {len(given)} number{'s' * (len(given) > 1)}; {robot.name} has {joints}")
    bus, facts = BUSES[rig.bus], servo_buses.BUSES[rig.bus]
    if got := servo_buses.beyond_travel(facts, zeros or (), robot.servo.range):
        turns, remedy = degrees(facts.travel), servo_buses.NEARER
        raise ConfigError(f"servo bus: {got}; a servo of {bus.name} turns +-{turns:.3g} deg: {remedy}")
    lasting = robot.timing.bus_dt if robot.timing.command_path == "move_time" else 0.0
    baud = args.baud or rig.baud or bus.baud
    return ServoBusLink(
        partial(opened, baud), clock, ids, zeros, signs, lasting, bus=bus, baud=baud, tick=robot.timing.bus_dt, patience=patience
    )


def camera_of(text: str | None, fish: Loopback | None) -> str:
    """The camera that the option names, as `make_camera` takes it. Raises ConfigError."""
    if text is None and fish is None:
        raise ConfigError("deploy: --camera is missing; give a camera's number, a video file, or shm:NAME")
    if text not in (None, "loopback"):
        return str(text)
    if fish is None or fish.frames is None:
        raise ConfigError("--camera loopback: only with --link loopback; of a robot that runs already take shm:NAME")
    return f"shm:{fish.frames}"


def make_camera(text: str, clock: Clock) -> Camera:
    """The camera `shm:NAME`, of a number or in a film, not opened yet."""
    if text.startswith("shm:"):
        return SharedFrames(text.removeprefix("shm:"), clock)
    if re.fullmatch(r"\d{1,2}", text):
        return Device(int(text))
    return VideoFile(text, clock)


def tracker_words(args: Any, camera: str, fish: Loopback | None, robot: Robot) -> list[str]:
    """Command line of the process of camera and tracker, with their options."""
    paint, height = paint_of(args, robot) if args.tracker == "colour" else (PAPER_FISH, 0.0)
    pairs, (x, y, yaw) = lambda values: ",".join(f"{x!r}:{width!r}" for x, width in values), args.tag_mount
    given = {
        "camera": camera, "calibration": fish.calibration if args.calibration is None and fish else args.calibration,
        "tracker": args.tracker, "tag-family": args.tag_family, "tag-number": args.tag_number, "tag-size": repr(args.tag_size),
        "tag-mount": f"{x!r},{y!r},{console.angle_text(yaw)}", "tag-height": repr(args.tag_height), "red": pairs(paint.head),
        "yellow": pairs(paint.neck), "paint-height": repr(height), "parent": os.getpid(),
    }  # fmt: skip
    words = [sys.executable, "-m", "fishmj.deploy.camera.tracker_process"]
    return words + [f"--{name}={value}" for name, value in given.items()]


def calibration_of(args: Any, fish: Loopback | None) -> Calibration:
    """The calibration that the options name; the loopback robot has its own. Raises ConfigError."""
    if args.calibration is not None:
        return Calibration.read(args.calibration)
    if fish is None:
        raise ConfigError("deploy: --calibration is missing; without it pixels are no metres (fishmj deploy calibrate-camera)")
    return Calibration.read(fish.calibration)


def paint_of(args: Any, robot: "str | Robot") -> tuple[Paint, float]:
    """The paint and its height over the water, m, from the options, else from the description's rig.

    Raises ConfigError: the place of the paint is not stated, and the head is not that of the shipped fish.
    """
    red, yellow, height = args.red, args.yellow, args.paint_height
    if red is None or yellow is None or height is None:
        described = load_robot(robot)
        rig = described.rig
        given = red, yellow
        red, yellow = red or rig.red, yellow or rig.yellow
        height = rig.paint_height if height is None else height
        if (red is None or yellow is None) and described.links[0].sections != load_robot("fish").links[0].sections:
            raise ConfigError(
                f"--tracker colour: [rig] of {described.name} does not say where it is painted; write red and yellow there, rows"
                " [x, width] in m, or give --red and --yellow"
            )
        for name, option, rows in zip(("red", "yellow"), given, (red, yellow), strict=True):
            off_the_head(described, f"--{name}" if option else f"[rig] {name}", rows or ())
    return Paint(head=red or PAPER_FISH.head, neck=yellow or PAPER_FISH.neck), height


def off_the_head(robot: Robot, name: str, rows: Bands) -> None:
    """Raises ConfigError if a painted band (x, width), m, is not on the head link, or wider than it."""
    head, hinge = robot.links[0], float(geometry_of(robot).origin[1])
    nose = hinge + head.length
    station, width = ([row[k] for row in head.sections] for k in (0, 2))
    for x, wide in rows:
        if not hinge - NEAR <= x <= nose + NEAR:
            place = f"the head link of {robot.name} lies from {hinge:.3f} to {nose:.3f} m"
            raise ConfigError(f"{name}: paint at x = {x:g} m; {place}, from its hinge to the nose")
        hull = float(np.interp(nose - x, station, width))
        if wide > WIDER * hull + NEAR:
            raise ConfigError(f"{name}: paint of {wide:g} m at x = {x:g} m; {robot.name} is {hull:.3f} m wide there")


def make_tracker(args: Any, calibration: Calibration, robot: "str | Robot" = "fish") -> Tracker:
    """The tracker that the options name, for this robot's paint. Raises ConfigError, MissingExtra."""
    if args.tracker == "colour":
        return ColourTracker(calibration, *paint_of(args, robot))
    from fishmj.deploy.tracker.apriltag import AprilTagTracker

    return AprilTagTracker(calibration, args.tag_family, args.tag_size, args.tag_mount, args.tag_number, args.tag_height)


def _loopback(args: Any, robot: Robot, stack: ExitStack) -> Loopback:
    """Starts the loopback robot; it ends with the stack, or with this process."""
    folder = temporary_beside(Path(tempfile.gettempdir()) / "fishmj-loopback")
    folder.mkdir(mode=0o700)
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    calibration, errors = folder / "camera.toml", folder / "errors.txt"
    words = [sys.executable, "-m", "fishmj.deploy", "loopback", "--protocol", args.protocol, "--model", args.robot]
    words += ["--parent", str(os.getpid()), "--write-calibration", str(calibration), "--marks", args.tracker]
    words += ["--host-port", str(args.host_port)] if args.host_port is not None else []
    words += ["--calibration", str(args.calibration)] if args.calibration is not None else []
    try:
        words += shlex.split(args.loopback or "")
    except ValueError as error:
        raise ConfigError(f"--loopback {str(args.loopback)[:80]!r}: {error}") from error
    console.warn_once("starting the loopback robot; the first start on a machine compiles its water for up to a minute")
    told = stack.enter_context(open(errors, "w", encoding="utf-8"))
    process = start_command(words, stderr=told, text=True)
    stack.callback(end_command, process, ENDS)
    line = process.stdout.readline() if process.stdout is not None else ""
    try:
        answer = json.loads(line)
        ports = int(answer["robot_port"] or 0), int(answer["host_port"] or 0)
        return Loopback(*ports, answer["frames"], calibration, answer["device"] or "")
    except (ValueError, KeyError, TypeError):
        process.wait(STARTS)
        why = last_words(errors.read_text(encoding="utf-8")) or "it ended without a word"
        raise ConfigError(f"loopback robot: does not start: {why}") from None


def link_text(text: str) -> str:
    """Checks `loopback`, `udp://HOST[:PORT]` or `serial:DEVICE`. Raises ArgumentTypeError."""
    if text == "loopback" or re.fullmatch(r"serial:.{1,200}", text):
        return text
    if text.startswith("udp://"):
        address(1)(text.removeprefix("udp://"))
        return text
    raise ArgumentTypeError(f"got {text[:60]!r}, expected loopback, udp://HOST[:PORT] or serial:DEVICE")


def address(port: int) -> Callable[[str], tuple[str, int]]:
    """The type of an option `HOST[:PORT]` with `port` as default. Raises ArgumentTypeError."""

    def read(text: str) -> tuple[str, int]:
        found = re.fullmatch(r"([A-Za-z0-9._-]{1,253})(?::(\d{1,5}))?", text)
        if not found or not 1 <= int(found[2] or port) <= 65535:
            raise ArgumentTypeError(f"got {text[:60]!r}, expected HOST or HOST:PORT")
        return found[1], int(found[2] or port)

    return read


def numbers(text: str) -> tuple[float, ...]:
    """Parses numbers with commas. Raises ArgumentTypeError."""
    return tuple(console.number(-1000, 1000)(part) for part in text.split(","))


def whole_numbers(text: str) -> tuple[int, ...]:
    """Parses whole numbers with commas, -1 to 253. Raises ArgumentTypeError."""
    return tuple(console.whole(-1, 253)(part) for part in text.split(","))


def bands(text: str) -> Bands:
    """Parses `0.05:0.058,0.175:0.012`: stations and widths, m. Raises ArgumentTypeError."""
    pairs = [part.split(":") for part in text.split(",")]
    if len(pairs) < 2 or any(len(pair) != 2 for pair in pairs):
        raise ArgumentTypeError(f"got {text[:60]!r}, expected X:WIDTH,X:WIDTH such as 0.05:0.058,0.175:0.012 (m)")
    return tuple((console.number(-2, 2)(x), console.number(0, 1)(width)) for x, width in pairs)
