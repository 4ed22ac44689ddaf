"""Faults of the loopback robot: one table of switches, each with a name, a size and a time.

    NAME[:up|:down][=VALUE][@T0[-T1]]       loss=0.05    delay:down=0.15    silent_radio@10-12    brown_out@30    stuck_servo=2@5

`down` is from host to robot, `up` from robot to host; without either, both. Times are of the robot's clock, s since the start;
without them a fault lasts from the beginning to the end.
"""

import re
from collections.abc import Iterable, Mapping
from math import inf, isnan, nan
from typing import NamedTuple

from fishmj.base.errors import ConfigError, UnknownName

RADIO, ROBOT, CAMERA = "radio", "robot", "camera"
DIRECTIONS = ("down", "up")


class FaultKind(NamedTuple):
    """One row of the table."""

    where: str  # radio, robot or camera
    unit: str  # of the value; "" for one without
    value: float  # where none is said; nan: of the robot, as `about` says
    low: float
    high: float
    about: str
    lasts: float = inf  # s, where no end is said


FAULTS: Mapping[str, FaultKind] = {
    "loss": FaultKind(RADIO, "1", 0.02, 0.0, 1.0, "this share of the datagrams never arrives"),
    "delay": FaultKind(RADIO, "s", 0.1, 0.0, 10.0, "datagrams arrive so much later"),
    "jitter": FaultKind(RADIO, "s", 0.02, 0.0, 10.0, "datagrams arrive later by a random time of this spread, never earlier"),
    "reorder": FaultKind(RADIO, "1", 0.05, 0.0, 1.0, "this share waits for 30 ms, so that the next ones overtake it"),
    "duplicate": FaultKind(RADIO, "1", 0.05, 0.0, 1.0, "this share arrives twice, the copy up to 30 ms later"),
    "corrupt": FaultKind(RADIO, "1", 0.02, 0.0, 1.0, "this share arrives with one to four bits flipped, or cut short"),
    "silent_radio": FaultKind(RADIO, "", 0.0, 0.0, 0.0, "nothing arrives"),
    "brown_out": FaultKind(
        ROBOT, "s", 0.3, 0.0, 60.0, "the supply breaks down for 0.1 s, or from T0 to T1; then it boots for this time", 0.1
    ),
    "stuck_servo": FaultKind(ROBOT, "joint", 2, 1, 7, "the gears of this joint (1 at the head) bind where they are"),
    "hot_servo": FaultKind(ROBOT, "joint", 2, 1, 7, "this joint's servo heats up to 80 deg C, 10 K a second"),
    "silent_servo": FaultKind(ROBOT, "joint", 2, 1, 7, "this joint's servo does not answer; it still goes where it is told"),
    "low_battery": FaultKind(
        ROBOT, "V", nan, 0.1, 1000.0, "the battery has only this open-circuit voltage; default 97 % of the robot's low_voltage"
    ),
    "camera_loss": FaultKind(CAMERA, "", 0.0, 0.0, 0.0, "no frames"),
    "camera_freeze": FaultKind(CAMERA, "", 0.0, 0.0, 0.0, "the same picture again and again, with new stamps"),
    "camera_jump": FaultKind(CAMERA, "m", 0.4, -10.0, 10.0, "the picture is shifted so far along the tank's x, as after a knock"),
}
FORM = re.compile(r"(?P<name>[a-z_]+)(:(?P<direction>\w+))?(=(?P<value>[^@]+))?(@(?P<begin>[^-]+)(-(?P<end>.+))?)?")


class LoopbackFault(NamedTuple):
    """One switch that is set."""

    name: str
    value: float  # nan: of the robot
    begin: float = 0.0  # s
    end: float = inf
    direction: str = ""  # of the radio's; "" both

    def active(self, t: float) -> bool:
        """Returns True if the fault is present at t [s]."""
        return self.begin <= t < self.end


def parse(texts: Iterable[str]) -> tuple[LoopbackFault, ...]:
    """Parses switches of the command line.

    Raises UnknownName: no such fault; ConfigError: not of the form above, or an impossible value or time.
    """
    return tuple(map(_fault, texts))


def _fault(text: str) -> LoopbackFault:
    found = FORM.fullmatch(text)
    if not found:
        raise ConfigError(f"fault {text[:60]!r}; expected NAME[:up|:down][=VALUE][@T0[-T1]] such as loss=0.05 or loss@10-12")
    name, direction = found["name"], found["direction"] or ""
    if name not in FAULTS:
        raise UnknownName("fault", name[:60], FAULTS)
    kind = FAULTS[name]
    if direction and (direction not in DIRECTIONS or kind.where != RADIO):
        raise ConfigError(f"fault {text[:60]!r}: direction {direction[:20]!r}; only faults of the radio have one: up or down")
    if found["value"] is not None and not kind.unit:
        raise ConfigError(f"fault {text[:60]!r}: {name} has no value; write {name} or {name}@T0-T1")
    value = kind.value if found["value"] is None else _number(text, found["value"])
    if not (isnan(value) or kind.low <= value <= kind.high) or (kind.unit == "joint" and value != int(value)):
        raise ConfigError(f"fault {text[:60]!r}: value {value:g}; expected {kind.low:g} to {kind.high:g} {kind.unit}")
    begin = 0.0 if found["begin"] is None else _number(text, found["begin"])
    end = begin + kind.lasts if found["end"] is None else _number(text, found["end"])
    if not 0.0 <= begin < end:
        raise ConfigError(f"fault {text[:60]!r}: from {begin:g} to {end:g} s; expected 0 <= T0 < T1")
    return LoopbackFault(name, value, begin, end, direction)


def _number(text: str, part: str) -> float:
    try:
        number = float(part)
    except ValueError:
        number = inf
    if abs(number) == inf or number != number:
        raise ConfigError(f"fault {text[:60]!r}: {part[:20]!r} is no finite number (SI)")
    return number


def described() -> list[str]:
    """One line a fault, for the help."""
    told = lambda kind: f" [{kind.unit}{'' if isnan(kind.value) else f', {kind.value:g}'}]" if kind.unit else ""
    wide = max(map(len, FAULTS))
    return [f"{name:<{wide}}  {kind.about}{told(kind)}" for name, kind in FAULTS.items()]


def active(faults: Iterable[LoopbackFault], name: str, t: float) -> LoopbackFault | None:
    """The first fault of this name that is present at t [s], or None."""
    return next((fault for fault in faults if fault.name == name and fault.active(t)), None)
