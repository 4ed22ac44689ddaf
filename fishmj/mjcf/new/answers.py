"""The eight questions about a fish, each with an option, a default and a plausible range, repeated until the answer is valid."""

import argparse
import re
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from fishmj.base import names
from fishmj.base.calib import read_toml, resolve, shipped
from fishmj.base.errors import ConfigError, FishmjError, UnknownName, UsageError
from fishmj.mjcf.description import RigSpec
from fishmj.mjcf.new.quantity import quantity
from fishmj.mjcf.new.shape import LINKS, Outline, joints_of, typical
from fishmj.mjcf.servo_buses import BUSES
from fishmj.mjcf.servos import SHELF, DataSheet

LENGTH = (0.05, 5.0)  # m
HEIGHT, WIDTH, TAIL = (0.03, 0.6), (0.02, 0.6), (0.02, 0.8)  # over the length
TALL, WIDE, FIN = 0.18, 0.66, 1.25  # by default: height over length, width over height, tail fin over height
COUNT = re.compile(r"\s*[0-9]{1,3}\s*")  # a number of links in place of the joints' stations
FLOATS = (0.5, 2.0)  # mass over what the hull displaces; further off it is another fish


class Figure(NamedTuple):
    """A figure of a servo's data sheet: a key of its TOML file, an option, a field of `DataSheet`."""

    kind: str  # of quantity
    low: float  # SI
    high: float
    text: str

    @property
    def parse(self) -> Callable[[str], float]:
        """Parser of the option, its `type=`."""
        return quantity(self.kind, self.low, self.high)


SHEET = {
    "stall_torque": Figure("torque", 0.005, 300.0, "17kgcm, 1.67Nm, 236ozin"),
    "no_load_speed": Figure("rate", 0.1, 100.0, "0.2s/60deg, 50rpm, 5.2rad/s"),
    "voltage": Figure("voltage", 1.0, 60.0, "of the others"),
    "stall_current": Figure("current", 0.01, 100.0, "checks the others"),
}
NEEDED = tuple(f.name for f in fields(DataSheet) if f.name in SHEET and f.default is MISSING)
Known = dict[str, Any]


@dataclass(frozen=True)
class Question:
    """One of the eight questions. `parse` and `default` receive the earlier answers; parse raises argparse.ArgumentTypeError."""

    key: str
    option: str
    text: str
    parse: Callable[[str, Known], Any]
    default: Callable[[Known], str]
    expected: Callable[[Known], str]


def links(text: str, known: Known) -> list[float]:
    """Stations of the joints from the nose, m, from `5` (links) or `0.2,0.3,0.4`."""
    length = known["length"]
    if COUNT.fullmatch(text):
        n = int(text)
        if not LINKS[0] <= n <= LINKS[1]:
            raise argparse.ArgumentTypeError(f"got {text.strip()!r}, expected {LINKS[0]} to {LINKS[1]} links")
        return joints_of(length, n, known.get("head"))
    return joints(text, length)


def joints(text: str, length: float) -> list[float]:
    """Stations from `0.2,0.3,0.4` or `20 cm, 30 cm`, m."""
    parse, parts = quantity("length", 0.0, length), text.split(",")
    if not LINKS[0] <= len(parts) + 1 <= LINKS[1]:
        raise argparse.ArgumentTypeError(f"got {len(parts)} joints, expected {LINKS[0] - 1} to {LINKS[1] - 1}")
    found = [parse(part) for part in parts]
    if any(b <= a for a, b in zip([0.0, *found], [*found, length], strict=True)):
        raise argparse.ArgumentTypeError(
            f"got {text[:60]!r}, expected joints that rise from the nose to the tail at {length:g} m"
        )
    return found


def servo(text: str, _known: Known) -> DataSheet:
    """A shipped servo by name, or one from a TOML file with its data sheet."""
    text = text.strip()
    if text.endswith(".toml"):
        return sheet_file(Path(text))
    if text.lower() not in SHELF:
        unknown = UnknownName("servo", text[:40], [*SHELF, "FILE.toml"])
        raise argparse.ArgumentTypeError(f"{unknown} Or state its data sheet with --stall-torque, --no-load-speed, --voltage")
    return SHELF[text.lower()]


def sheet_file(path: Path) -> DataSheet:
    """Reads a servo's data sheet from a TOML file.

    Keys: `stall_torque = "17 kg cm"`, `no_load_speed = "0.2 s/60deg"`, `voltage = 7.4`, `stall_current = 2.5`. The key `bus`, one
    of servo_buses.BUSES, is optional.

    Raises ConfigError: a key is missing, unknown or no quantity of its kind; UnknownName: no such bus.
    """
    table = read_toml(path)
    unknown, missing = set(table) - {*SHEET, "name", "bus"}, set(NEEDED) - set(table)
    if unknown or missing:
        raise ConfigError(
            f"{path}: unknown {sorted(unknown)}, missing {sorted(missing)}; a servo has {', '.join(('name', 'bus', *SHEET))}"
        )
    if (bus := str(table.get("bus", RigSpec.bus))) not in BUSES:
        raise UnknownName("servo bus", bus[:40], BUSES)
    values: dict[str, float] = {}
    for key, figure in SHEET.items():
        if key in table:
            try:
                values[key] = figure.parse(str(table[key]))
            except argparse.ArgumentTypeError as error:
                raise ConfigError(f"{path}: {key}: {error}") from error
    return DataSheet(
        name=names.checked(table.get("name", path.stem), "servo", str(path)),
        source=f"data sheet in {names.nearest(path.name)}",
        bus=bus,
        **values,
    )


def _name(text: str, _known: Known) -> str:
    try:
        name = names.checked(text.strip(), "robot")
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    if name in {*shipped(), *(read_toml(resolve(fish)).get("name") for fish in shipped())}:
        raise argparse.ArgumentTypeError(
            f"{name!r} is a shipped fish or calibration, whose water and logs it would mix with; choose another"
        )
    return name


def _size(low: float, high: float) -> tuple[Callable[[str, Known], float], Callable[[Known], str]]:
    """Parser and default of a length of the body, between shares of the fish's length."""
    bounds = lambda known: (low * known["length"], high * known["length"])
    return (
        lambda text, known: quantity("length", *bounds(known))(text),
        lambda known: "{:.3g} to {:.3g} m".format(*bounds(known)),
    )


def hull(known: Known) -> Outline:
    """The outline: measured, or typical for the answers so far."""
    measured = known.get("outline")
    return measured if measured is not None else typical(*(known[k] for k in ("length", "height", "width", "tail_height")))


def _mass_range(known: Known) -> tuple[float, float]:
    floats = hull(known).displaced
    return FLOATS[0] * floats, FLOATS[1] * floats


def _mass(text: str, known: Known) -> float:
    low, high = _mass_range(known)
    try:
        return quantity("mass", low, high)(text)
    except argparse.ArgumentTypeError as error:
        hull_of = hull(known)
        size = " x ".join(f"{x:.3g}" for x in (hull_of.length, *hull_of.body))
        why = f"half to twice what a hull of {size} m (length, height, width) displaces, {hull_of.displaced:.3g} kg"
        raise argparse.ArgumentTypeError(f"{error}: {why}; measure the sizes that you did not give") from error


(_height, _heights), (_width, _widths), (_tail, _tails) = _size(*HEIGHT), _size(*WIDTH), _size(*TAIL)
_fixed = lambda text: lambda _known: text
NAME = Question("name", "NAME", "Name of the fish", _name, _fixed("my_fish"), _fixed("letters, digits, _ . -"))
QUESTIONS = (
    NAME,
    Question(
        "length", "--length", "Length from the nose to the end of the tail fin",
        lambda text, _: quantity("length", *LENGTH)(text), _fixed("0.6"), _fixed("{:g} to {:g} m".format(*LENGTH)),
    ),
    Question(
        "height", "--height", "Greatest height of the body, without fins",
        _height, lambda known: f"{TALL * known['length']:.3g}", _heights,
    ),
    Question(
        "width", "--width", "Greatest width of the body, without fins",
        _width, lambda known: f"{WIDE * known['height']:.3g}", _widths,
    ),
    Question(
        "tail_height", "--tail-height", "Height of the tail fin, tip to tip",
        _tail, lambda known: f"{min(FIN * known['height'], 0.5 * known['length']):.3g}", _tails,
    ),
    Question(
        "mass", "--mass", "Mass as it swims, flooded parts included (default: what this hull displaces)",
        _mass,
        lambda known: f"{hull(known).displaced:.3g}", lambda known: "{:.3g} to {:.3g} kg".format(*_mass_range(known)),
    ),
    Question(
        "joints", "--links or --joints", "Number of rigid links, or the joints' distances from the nose with commas between them",
        links, _fixed("4"), _fixed("{} to {} links".format(*LINKS)),
    ),
    Question(
        "servo", "--servo", "Servo, one kind for all joints: a name, or a FILE.toml with its data sheet's figures",
        servo, _fixed("lx-824"), _fixed(", ".join(SHELF)),
    ),
)  # fmt: skip


def gather(
    known: Known, given: dict[str, str], ask: Callable[[str], str] | None, *, defaults: bool
) -> tuple[Known, dict[str, str]]:
    """All answers, and the origin of each: "given", "asked", "default", or "placed" for joints of which only the number is known.

    Args:
        known: answers from a table or a photo: outline, length, head.
        given: answers on the command line, as text, by key.
        ask: shows a line and returns the typed text; None without a terminal.
        defaults: take the default of every missing answer, and ask nothing.

    Raises UsageError: an answer is not valid, or some are missing and there is no terminal to ask on.
    """
    known, origin = dict(known), {}
    wanted = [q for q in QUESTIONS if q.key not in known]
    missing = [q.option for q in wanted if q.key not in given]
    if missing and ask is None and not defaults:
        raise UsageError(
            f"new: no terminal to ask at, and these are missing: {', '.join(missing)}; give them, or --yes for the defaults;"
            " see fishmj new --help"
        )
    for number, question in enumerate(wanted, 1):
        key = question.key
        if key in given or defaults or ask is None:
            typed, how = (given[key], "given") if key in given else (question.default(known), "default")
            known[key] = _read(question, typed, known)
        else:
            known[key], typed = _asked(question, known, ask, f"{number}/{len(wanted)} ")
            how = "asked" if typed else "default"
        counted = key == "joints" and how != "default" and COUNT.fullmatch(typed)
        origin[key] = "placed" if counted else how
    return known, origin


def _read(question: Question, text: str, known: Known) -> Any:
    try:
        return question.parse(text, known)
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"new: {question.option}: {error}") from error


def _asked(question: Question, known: Known, ask: Callable[[str], str], number: str) -> tuple[Any, str]:
    """Asks until the answer is valid; an empty line takes the default. Returns the answer and the line."""
    default, prefix = question.default(known), ""
    while True:
        try:
            text = ask(f"{prefix}{number}{question.text} ({question.expected(known)}) [{default}]: ")
        except EOFError as error:
            raise UsageError("new: the input ended before all questions were answered; nothing was written") from error
        try:
            return question.parse(text.strip() or default, known), text.strip()
        except (argparse.ArgumentTypeError, FishmjError) as error:
            prefix = f"  {error}\n"
