"""What is said of a recording on the command line: robot, experiment, where the fish was put, bounds on magnitude."""

from argparse import ArgumentTypeError, Namespace
from pathlib import Path

from fishmj import calib, console, names
from fishmj.errors import FishmjError
from fishmj.log import plausible


def of_options(args: Namespace) -> dict:
    meta: dict = {
        key: value for key in ("excitation", "medium", "origin", "licence", "start") if (value := getattr(args, key)) is not None
    }
    if args.excitation is not None:
        names.checked(args.excitation, "excitation", "--excitation")
    if args.robot is not None:
        meta["robot"], joints = robot_of(args.robot)
        meta |= {"joints": joints} if joints else {}
    if args.plausible:
        meta[plausible.KEY] = args.plausible
    return meta


def robot_of(text: str) -> tuple[str, int]:
    """Name and number of joints (0: not known) of a robot: its TOML, a shipped one's file or its own name, or any name.

    Raises:
        ConfigError: no such file, not TOML, or no name that may stand in a path.
    """
    path = None
    if text.endswith(".toml"):
        path = Path(text)
    else:
        for name in calib.shipped():
            shipped = calib.calib_folder() / f"{name}.toml"
            if str(calib.read_toml(shipped).get("schema", "")).startswith("fishmj.fish") and text in (
                name,
                calib.read_toml(shipped).get("name"),
            ):
                path = shipped
    if path is None:
        return names.checked(text, "robot", "--robot"), 0
    table = calib.read_toml(path)
    links = table.get("link")
    said = table.get("name", table.get("robot", {}).get("name") if isinstance(table.get("robot"), dict) else None)
    return names.checked(said, "robot", str(path)), max(len(links) - 1, 0) if isinstance(links, list) else 0


def start(text: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != 3:
        raise ArgumentTypeError(f"got {text[:40]!r}, expected three numbers x,y,yaw [m, m, rad], such as 0,0,1.57")
    reach = plausible.shipped().start
    return [console.number(-reach, reach)(part) for part in parts[:2]] + [console.number(-6.3, 6.3)(parts[2])]


def bounds(text: str) -> dict[str, float]:
    try:
        return plausible.told(text)
    except FishmjError as error:
        raise ArgumentTypeError(str(error)) from error
