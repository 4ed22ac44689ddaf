"""What a robotic fish is, in plain numbers: links, fins, servos, timing. SI units, radians.

A description is a TOML file (`data/calib/fish.toml` is the paper's fish) or these dataclasses built by hand. Links are
listed from nose to tail; each hangs on the rear end of the one before it by a servo hinge about the vertical axis.
"""

from dataclasses import dataclass, field, fields
from math import pi, radians
from pathlib import Path
from typing import TYPE_CHECKING

from fishmj.calib import read_toml, resolve
from fishmj.errors import ConfigError

if TYPE_CHECKING:
    from fishmj.effects.calibration import Fitted

COMMAND_PATHS = ("linear", "hold", "move_time")


@dataclass(frozen=True, kw_only=True)
class Link:
    """One rigid link. Sections and com are measured from the link's front end, backwards."""

    name: str
    length: float  # m
    mass: float  # kg
    sections: tuple[tuple[float, float, float], ...]  # (station, height, width) m, elliptical
    com: tuple[float, float, float] | None = None  # (back from the front, left, up) m; None = centroid
    fin_from: float | None = None  # behind this station the section is a plate, m
    colour: tuple[float, float, float] | None = None  # RGB 0..1; None = of the palette, by index (mjcf.drawing)


@dataclass(frozen=True, kw_only=True)
class Fin:
    """A fixed pair of horizontal plates (damps roll)."""

    name: str
    link: str
    station: tuple[float, float]  # front and rear edge from the link's front, m
    span: float  # of each plate, m
    count: int = 2


@dataclass(frozen=True, kw_only=True)
class Servo:
    """A position servo: torque = clip(kp e - kv w, +-torque) - kb w, the torque-speed line of a DC motor.

    kb = torque / speed_no_load is the back-EMF slope, kv = kd - kb what the controller adds. [N m/rad, N m s/rad, N m, rad/s]
    """

    kp: float = 8.0
    kd: float = 0.32
    torque: float = 1.667
    speed_no_load: float = 5.236
    voltage: float = 7.4
    resistance: float = 6.27
    constant: float = 1.413
    range: float = pi / 3  # rad, commands are clamped to +-range
    resolution: float = radians(0.24)  # rad
    idle_power: float = 1.5  # W, whole robot

    @property
    def kb(self) -> float:
        """Back-EMF damping seen at the output shaft, N m s/rad."""
        return self.torque / self.speed_no_load

    @property
    def kv(self) -> float:
        """Damping that the position controller adds to the back-EMF, N m s/rad."""
        return self.kd - self.kb


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Steps and delays of the robot and its host, s."""

    physics_dt: float = 0.004
    bus_dt: float = 0.02
    control_dt: float = 0.2
    command_path: str = "linear"
    command_latency: float = 0.06
    camera_latency: float = 0.065
    velocity_window: int = 6  # frames


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A complete description: what `mjcf.build` and the water are made from."""

    name: str
    links: tuple[Link, ...]
    servo: Servo = field(default_factory=Servo)
    fins: tuple[Fin, ...] = ()
    timing: Timing = field(default_factory=Timing)
    water: dict = field(default_factory=dict)
    title: str = ""
    density_water: float = 1000.0  # kg/m3
    effects: "tuple[Fitted, ...]" = field(default=(), repr=False)  # what calibration added, in the order in which it acts

    @property
    def n_joints(self) -> int:
        return len(self.links) - 1

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return sum(link.mass for link in self.links)

    @property
    def length(self) -> float:
        """Straight length, m."""
        return sum(link.length for link in self.links)


def load_robot(source: "str | Path | Robot" = "fish") -> Robot:
    """Read a robot from a TOML path or a shipped name (`fish`, `tendon_fish`).

    Raises:
        ConfigError: a key is missing, unknown or impossible; names file, block, got and expected.
    """
    if isinstance(source, Robot):
        return source
    path = resolve(source)
    return robot_from_dict(read_toml(path), str(path))


def robot_from_dict(table: dict, where: str) -> Robot:
    """Build and check a robot from a parsed TOML table."""
    if not table.get("link"):
        raise ConfigError(f"{where}: no [[link]] block; a fish needs at least two, nose first")
    links = tuple(_link(entry, f"{where} [[link]] {i}") for i, entry in enumerate(table["link"], 1))
    if len(links) < 2:
        raise ConfigError(f"{where}: {len(links)} [[link]] block; a swimming fish needs at least two")
    names = [link.name for link in links]
    if len(set(names)) != len(names):
        raise ConfigError(f"{where}: link names must differ, got {names}")
    fins = tuple(_checked(Fin, entry, f"{where} [[fin]]") for entry in table.get("fin", []))
    for fin in fins:
        if fin.link not in names:
            raise ConfigError(f"{where} [[fin]] {fin.name}: link {fin.link!r} does not exist; links: {names}")
    servo = dict(table.get("servo", {}))
    for key in ("range", "resolution"):
        if f"{key}_deg" in servo:
            servo[key] = radians(servo.pop(f"{key}_deg"))
    timing = _checked(Timing, table.get("timing", {}), f"{where} [timing]")
    check_timing(timing, f"{where} [timing]")
    robot = Robot(
        name=table.get("name", Path(where).stem),
        title=table.get("title", ""),
        links=links,
        fins=fins,
        servo=_checked(Servo, servo, f"{where} [servo]"),
        timing=timing,
        water=dict(table.get("water", {})),
        density_water=float(table.get("body", {}).get("density_water", 1000.0)),
        effects=_effects(table, where),
    )
    total = table.get("body", {}).get("mass_total")
    if total is not None and abs(robot.mass - total) > 1e-9:
        raise ConfigError(f"{where}: link masses add up to {robot.mass:.4f} kg, mass_total says {total} kg; mend one of them")
    return robot


def check_timing(timing: Timing, where: str) -> None:
    """Steps must nest: physics into bus into control; names the nearest valid value otherwise."""
    for small, large in (("physics_dt", "bus_dt"), ("bus_dt", "control_dt")):
        a, b = getattr(timing, small), getattr(timing, large)
        if a <= 0 or b <= 0:
            raise ConfigError(f"{where}: {small} = {a} s and {large} = {b} s must be positive")
        n = max(1, round(b / a))
        if abs(b / a - n) > 1e-6:
            raise ConfigError(
                f"{where}: {large} = {b} s is not a multiple of {small} = {a} s; nearest valid {large}: {n * a:g} s"
            )
    if timing.command_path not in COMMAND_PATHS:
        raise ConfigError(f"{where}: command_path = {timing.command_path!r}; choose one of {', '.join(COMMAND_PATHS)}")


def _effects(table: dict, where: str) -> "tuple[Fitted, ...]":
    """The blocks [[effect]]; the catalogue is loaded only for a fish that has some."""
    if not table.get("effect"):
        return ()
    from fishmj.effects.calibration import parse

    return parse(table, where)


def _link(entry: dict, where: str) -> Link:
    entry = dict(entry)
    entry["sections"] = tuple(tuple(float(v) for v in row) for row in entry.get("sections", ()))
    for key in ("com", "colour"):
        if key in entry:
            entry[key] = tuple(float(v) for v in entry[key])
    link = _checked(Link, entry, where)
    stations = [row[0] for row in link.sections]
    if len(link.sections) < 2 or any(len(row) != 3 for row in link.sections):
        raise ConfigError(f"{where} {link.name}: sections need at least two rows [station, height, width], got {link.sections}")
    if stations != sorted(stations) or stations[0] != 0 or abs(stations[-1] - link.length) > 1e-9:
        raise ConfigError(f"{where} {link.name}: section stations must rise from 0 to length = {link.length}, got {stations}")
    if link.mass <= 0 or link.length <= 0:
        raise ConfigError(f"{where} {link.name}: mass and length must be positive, got {link.mass} kg and {link.length} m")
    return link


def _checked(kind, table: dict, where: str):
    known = {f.name: f for f in fields(kind)}
    unknown = set(table) - set(known)
    if unknown:
        raise ConfigError(f"{where}: unknown key {sorted(unknown)[0]!r}; known: {', '.join(known)}")
    try:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
        return kind(**values)
    except TypeError as error:
        raise ConfigError(f"{where}: {error}") from error
