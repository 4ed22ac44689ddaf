"""`fishmj deploy doctor`: checks this computer for a swim: packages, serial lines, cameras, the loop's own timing."""

import time
from pathlib import Path
from typing import Any

from fishmj.base import console, source
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.deploy.camera.cameras import Device
from fishmj.deploy.link.transports import serial_devices
from fishmj.deploy.loop.clock import MonotonicClock, first_in_line
from fishmj.deploy.loop.ticker import LATE, Ticker

LIST = Path(__file__).resolve().parents[1] / "host_requirements.txt"
OPTIONAL = {"mcap": "logs", "roslibpy": "ros"}
CAMERAS = 4  # numbers that are tried
STARTS = 3.0  # s that a camera may take to its first picture
RIGHT = "the loop waits its turn; on Linux a line '<your name> - rtprio 10' in /etc/security/limits.conf lets it go first"
EXAMPLES = """example:
  fishmj deploy doctor --camera --seconds 10"""


def main(argv: list[str]) -> int:
    """The command. Exit code 1 if a package that a swim needs is missing."""
    parser = console.parser(
        "deploy doctor", "What is plugged in, what is installed, how evenly this computer ticks.", examples=EXAMPLES
    )
    parser.add_argument("--camera", action="store_true", help="open every camera as a swim does: its size and rate")
    parser.add_argument("--seconds", type=console.number(0.5, 3600), default=2.0, help="of ticks at 50 Hz to measure")
    args = parser.parse_args(argv)
    installed = {name: version(name) for name in (*required(), *OPTIONAL)}
    rows = [{"package": name, "version": found or "missing"} for name, found in installed.items()]
    result: dict[str, Any] = {"packages": installed, "serial": _tried(serial_devices), "ticks": ticks(args.seconds)}
    result["cameras"] = _tried(cameras) if args.camera else None
    console.say(console.table(rows), "")
    console.say(f"serial devices: {_listed(result['serial'])}")
    console.say(f"cameras: {_listed(result['cameras'])}" if args.camera else "cameras: not opened; --camera does")
    even = result["ticks"]
    console.say(
        f"ticks: {even['ticks']} at 50 Hz, late by {even['p50_ms']:.2f} ms (median), {even['p99_ms']:.2f} ms (99 %), "
        f"{even['worst_ms']:.2f} ms (worst); {even['late']} later than {1e3 * LATE:g} ms, {even['dropped']} dropped"
    )
    console.say("the loop goes before other programs" if even["first_in_line"] else RIGHT)
    missing = [name for name in required() if installed[name] is None]
    for name in missing:
        console.warn(f"{name} is missing: pip install -r {LIST}")
    if args.json:
        console.emit_json(result)
    return console.FAILED_CHECK if missing else console.OK


def required() -> list[str]:
    """Names of the packages of host_requirements.txt."""
    lines = [line.partition("#")[0].strip() for line in LIST.read_text(encoding="utf-8").splitlines()]
    return [line.partition(">")[0] for line in lines if line]


def version(package: str) -> str | None:
    """Version of an installed package, or None; OpenCV counts under any of its names."""
    names = (package, "opencv-python", "opencv-contrib-python") if package.startswith("opencv") else (package,)
    return next((found for name in names if (found := source.version(name))), None)


def cameras() -> list[str]:
    """Cameras that open, with the size that they deliver for a swim's settings, and the measured rate."""
    found = []
    for number in range(CAMERAS):
        camera = Device(number)
        try:
            camera.open()
        except ConfigError:
            continue
        try:
            found.append(f"{number}: {_measured(camera)}")
        finally:
            camera.close()
    return found


def _measured(camera: Device) -> str:
    """Size and rate of an opened camera."""
    if not (frames := camera.wait(STARTS)):
        return f"no picture in {STARTS:g} s"
    height, width = frames[-1][1].shape[:2]
    begin, count = time.monotonic(), 0
    while time.monotonic() - begin < 1.0:
        count += len(camera.wait(0.1))
    wanted = camera.size
    note = "" if (width, height) == wanted else f" (a swim asks for {wanted[0]} x {wanted[1]})"
    return f"{width} x {height}, {count} frames in 1 s{note}"


def ticks(seconds: float) -> dict[str, float]:
    """Timing of an empty loop at 50 Hz over `seconds` s with a swim's priority: the best that this computer can do."""
    with first_in_line() as first:
        ticker = Ticker(MonotonicClock(), 0.02)
        while ticker.count < seconds * 50:
            ticker.wait()
    return ticker.figures() | {"first_in_line": first}


def _tried(look) -> list[str] | str:
    try:
        return look()
    except FishmjError as error:
        return str(error)


def _listed(found: list[str] | str) -> str:
    return found if isinstance(found, str) else ", ".join(found) or "none"
