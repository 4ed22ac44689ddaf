"""Types of command-line options (numbers of a range, lists, names, outputs checked before the work) and checks of call arguments.

Each type is the `type=` of an argparse option. A refused value raises an `ArgumentTypeError` that says what was expected. A
command takes them from `fishmj.base.console`, which offers them all. A dataclass declares options by `setting`. `checked` and
its relatives check arguments of Python calls.
"""

import argparse
import math
import re
import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import Field, dataclass, field, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from fishmj.base.errors import ConfigError, UnknownName, closest_name
from fishmj.base.names import is_name, nearest

_RANGE = re.compile(r"(\d*\.?\d+) *(?:-|\u2013|:|\.{2,3}|to) *(\d*\.?\d+)")
SHOWN = 60  # characters of an argument that an error repeats


def shown(text: str, most: int = SHOWN) -> str:
    """Shortened argument for an error message."""
    return repr(text if len(text) <= most else f"{text[: most - 3]}...")


def unlisted(text: str, known: Sequence[str], listed: str = "") -> str:
    """Message for a value that is none of `known`, with the nearest of them; listed: what there is, in other words."""
    near = closest_name(text, known)
    hint = f" Did you mean {near!r}?" if near else ""
    return f"got {shown(text)}.{hint} Known: {listed or ', '.join(known)}"


@dataclass(frozen=True)
class Number:
    """The `type=` of an option that takes a finite number of a range; `whole` and `number` make it."""

    low: float
    high: float
    above: bool = False  # beyond `low`
    whole: bool = False

    def __call__(self, text: str) -> Any:
        try:
            value = int(text) if self.whole else float(text)
        except ValueError:
            value = math.nan  # of no range
        if not self.holds(value):
            raise argparse.ArgumentTypeError(f"got {shown(text)}, expected {self.expected}")
        return value

    def holds(self, value: Any) -> bool:
        """Returns True for a number of the range; False for a truth value."""
        kind: Any = Integral if self.whole else Real
        if isinstance(value, bool) or not isinstance(value, kind):
            return False
        finite = isinstance(value, Integral) or math.isfinite(value)  # an integer may be too long for a float
        return finite and self.low <= value <= self.high and not (self.above and value == self.low)

    @property
    def expected(self) -> str:
        """The range in words."""
        show = (lambda x: f"{x:.0f}") if self.whole else (lambda x: f"{x:g}")
        head = f"a {'whole ' if self.whole else ''}number {'above' if self.above else 'from'} {show(self.low)}"
        return head + (f" to {show(self.high)}" if self.high < math.inf else "" if self.above else " up")


def checked(where: str, value: Any, low: float = -math.inf, high: float = math.inf, *, whole: bool = False) -> Any:
    """Returns `value`, an argument of a Python call, if it is a finite number from `low` to `high`.

    Raises ConfigError: it is not; begins with `where`, the name of the argument.
    """
    given = value.item() if getattr(value, "shape", None) == () else value  # NumPy's and JAX's scalars
    kind = int if whole else int | float
    if isinstance(given, bool) or not isinstance(given, kind) or not math.isfinite(given) or not low <= given <= high:
        expected = "a finite number" if (low, high) == (-math.inf, math.inf) else Number(low, high, whole=whole).expected
        raise ConfigError(f"{where} = {shown_value(given)}; expected {expected}")
    return given


def checked_bounds(where: str, value: Any, low: float, high: float) -> tuple[float, float]:
    """Returns the bounds of a draw, (value, value) of a single number. Raises ConfigError, as `checked`."""
    pair = (value, value) if getattr(value, "ndim", 0) == 0 and not isinstance(value, list | tuple) else tuple(value)
    try:
        first, last = (checked(where, bound, low, high) for bound in pair)
    except ValueError:  # ConfigError is one, too
        first, last = 1, 0
    if first > last:
        raise ConfigError(
            f"{where} = {shown_value(value)}; expected a number from {low:g} to {high:g}, or two bounds of a draw, (low, high)"
        )
    return first, last


def checked_array(where: str, value: Any, shape: tuple[int, ...]) -> Any:
    """Returns an argument of a Python call as a float64 NumPy array.

    Raises ConfigError: another shape, or not all finite; tells the shape, or the place of the first such number.
    """
    import numpy as np

    try:
        given = None if np.iscomplexobj(value) else np.asarray(value, float)
    except (TypeError, ValueError):
        given = None
    if given is not None and given.shape == shape and np.isfinite(given).all():
        return given
    told = shown_value(value)
    if given is not None and given.shape != shape:
        told += f" of shape {given.shape}" if given.shape else ""
    elif given is not None and shape:
        place = np.argwhere(~np.isfinite(given))[0].tolist()
        where, told = f"{where}{place}", str(given[tuple(place)])
    raise ConfigError(f"{where} = {told}; expected finite numbers of shape {shape}")


def checked_kind(where: str, value: Any, kind: type, *, needed: bool = False) -> Any:
    """Returns `value`, an object of this class, or None unless it is `needed`. Raises ConfigError."""
    if (needed or value is not None) and not isinstance(value, kind):
        raise ConfigError(f"{where} = {shown_value(value)}; expected {kind.__module__}.{kind.__name__}(...)")
    return value


def checked_name(kind: str, value: Any, known: Iterable[str]) -> str:
    """Returns `value` if it is one of the names `known`. Raises UnknownName."""
    if not isinstance(value, str) or value not in known:
        raise UnknownName(kind, value, known)
    return value


def checked_names(where: str, value: Any) -> tuple[str, ...]:
    """Returns several names. Raises ConfigError: not a tuple or list of texts, for example one text."""
    if not isinstance(value, tuple | list) or not all(isinstance(name, str) for name in value):
        raise ConfigError(f"{where} = {shown_value(value)}; expected a tuple of names, (NAME,) of a single one")
    return tuple(value)


def shown_value(value: Any) -> str:
    """One-line text of a value of a Python call, for an error message."""
    line = " ".join(repr(value).split())
    return line if len(line) <= SHOWN else f"{line[: SHOWN - 3]}..."


def number(low: float, high: float = math.inf, *, above: bool = False) -> Number:
    """The `type=` of an option that takes a finite number from `low` (with `above`: beyond it) to `high`."""
    return Number(low, high, above)


def whole(low: int, high: int | None = None) -> Number:
    """The `type=` of an option that takes a whole number from `low` to `high`."""
    return Number(low, math.inf if high is None else high, whole=True)


def angle(text: str) -> float:
    """The `type=` of an option that takes an angle in deg, `180` or `3deg`, and gives rad; refuses a bare one that may be rad."""
    bare = text.strip().removesuffix("deg")
    value = Number(-360, 360)(bare)
    if bare == text.strip() and 0 < abs(value) <= TURN[1]:
        doubt = f"rad, as it was before, would be {math.degrees(value):.4g} deg; if deg is meant, write {bare}deg"
        raise argparse.ArgumentTypeError(f"got {shown(text)}, expected an angle in deg; {doubt}")
    return math.radians(value)


def angle_text(value: float) -> str:
    """An angle, rad, as `angle` reads it."""
    return f"{math.degrees(value):.9g}deg"


def numbers(form: str, *kinds: Any) -> Callable[[str], tuple[float, ...]]:
    """The `type=` of an option `A,B,..`, which gives a tuple. form: what is expected; kinds: of each its bounds or a `type=`."""

    def read(text: str) -> tuple[float, ...]:
        parts = text.split(",")
        if len(parts) != len(kinds):
            raise argparse.ArgumentTypeError(f"got {shown(text)}, expected {form}")
        return tuple((kind if callable(kind) else Number(*kind))(part) for kind, part in zip(kinds, parts, strict=True))

    return read


def pose(reach: float) -> Callable[[str], tuple[float, ...]]:
    """The `type=` of an option X,Y,YAW: within `reach` m, and a heading in deg, which it gives in rad."""
    return numbers("X,Y,YAW such as 0,0,90 (m, m, deg)", (-reach, reach), (-reach, reach), angle)


def flow(fastest: float) -> Callable[[str], tuple[float, ...]]:
    """The `type=` of an option M/S,DEG: of a stream up to `fastest` m/s, and where it moves to, which it gives in rad."""
    return numbers("SPEED,DIRECTION such as 0.2,180 (m/s, deg)", (0, fastest), angle)


TURN = (-6.2832, 6.2832)  # rad: a direction in degrees is mostly beyond
SEED = whole(0, 2**53 - 1)  # of every draw; a whole number that JSON holds exactly


@dataclass(frozen=True)
class Listed:
    """The `type=` of an option that takes 1 to `most` values with commas between them, none of them twice.

    `same` maps a value to a key; two values with one key count as the same. `rising`: bounds, of which none is below the one
    before it.
    """

    item: Any  # the `type=` of each
    most: int = 100
    distinct: bool = True
    same: Callable[[Any], Any] = lambda value: value
    rising: bool = False

    def __call__(self, text: str) -> list:
        parts = [part.strip() for part in text.split(",")]
        if not all(parts) or len(parts) > self.most:
            raise argparse.ArgumentTypeError(f"got {shown(text)}, expected 1 to {self.most} values with commas between them")
        values = [self._one(part) for part in parts]
        if self.rising and values != sorted(values):
            raise argparse.ArgumentTypeError(f"got {shown(text)}, expected the smaller number first")
        kinds = [self.same(value) for value in values]
        twice = next((i for i, kind in enumerate(kinds) if kind in kinds[:i]), None)
        if twice is not None and self.distinct:
            first = parts[kinds.index(kinds[twice])]
            also = f"{parts[twice]} stands there twice" if first == parts[twice] else f"{first} and {parts[twice]} are the same"
            raise argparse.ArgumentTypeError(f"got {shown(text)}: {also}; name each value once")
        return values

    def _one(self, part: str) -> Any:
        try:
            return self.item(part)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{error}{self._as_list(part)}") from error

    def _as_list(self, part: str) -> str:
        """Hint on how a range of numbers, such as `0-0.04`, is written; "" of any other part."""
        if found := _RANGE.fullmatch(part):
            low, high = found.groups()
            for example in (f"{low},{(float(low) + float(high)) / 2:g},{high}", f"{low},{high}"):
                with suppress(argparse.ArgumentTypeError):
                    self(example)
                    return f"; a range is written as a list, such as {example}"
        return ""

    def holds(self, value: Any) -> bool:
        """True for a list or tuple of 1 to `most` values that `item` holds."""
        return isinstance(value, list | tuple) and 1 <= len(value) <= self.most and all(map(self.item.holds, value))

    @property
    def expected(self) -> str:
        """The values in words."""
        return f"1 to {self.most} values, each {self.item.expected}"


def setting(default: Any, kind: Any, about: str, option: str = "", metavar: str | None = None) -> Any:
    """A field of a dataclass that is declared once for Python and for the command line.

    Args:
        kind: the `type=` of the option, a tuple of names to choose from, or None for a flag, `--no-name` of a True default.
        about: its meaning, the help of the option. option: its name on the command line where that is not the field's.
    """
    return field(default=default, metadata={"kind": kind, "about": about, "option": option, "metavar": metavar})


def declared(config: type) -> dict[str, Field]:
    """The fields of a dataclass that `setting` declared, by name."""
    return {one.name: one for one in fields(config) if "kind" in one.metadata}


def option_of(one: Field) -> str:
    """The command-line option of a field, `--learning-rate`."""
    negated = one.metadata["kind"] is None and one.default
    return one.metadata["option"] or f"--{'no-' if negated else ''}{one.name.replace('_', '-')}"


def add_settings(parser: argparse.ArgumentParser, config: type, *names: str) -> None:
    """Adds the options of some fields of a dataclass to a parser, in this order."""
    for one in map(declared(config).__getitem__, names):
        kind, how = one.metadata["kind"], {"default": one.default, "metavar": one.metadata["metavar"]}
        how = {"action": "store_true"} if kind is None else how | {"choices" if isinstance(kind, tuple) else "type": kind}
        parser.add_argument(option_of(one), help=one.metadata["about"], **how)


def settings_of(args: argparse.Namespace, config: type) -> dict[str, Any]:
    """Values of a dataclass's fields that the command line has options for, by the name of the field."""
    places = {name: option_of(one)[2:].replace("-", "_") for name, one in declared(config).items()}
    given = {name: (place, getattr(args, place)) for name, place in places.items() if place in args}
    return {name: not value if place.startswith("no_") else value for name, (place, value) in given.items()}


class Distinct(argparse.Action):
    """The `action=` of an option with several values, none of them twice."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        twice = [value for i, value in enumerate(values) if value in values[:i]]
        if twice:
            raise argparse.ArgumentError(self, f"{twice[0]} stands there twice; name each value once")
        setattr(namespace, self.dest, values)


def refuse_unheeded(where: str, args: argparse.Namespace, parser: argparse.ArgumentParser, needs: dict) -> None:
    """Refuses options that have no effect beside the others.

    Args:
        needs: what heeds them, in words -> (True where that is chosen, the options without their dashes).
    Raises ConfigError: one is stated that nothing heeds.
    """
    for what, (chosen, names) in needs.items():
        stated = [name for name in names if getattr(args, key := name.replace("-", "_")) != parser.get_default(key)]
        if stated and not chosen:
            raise ConfigError(f"{where}: --{stated[0]} has an effect with {what} only; leave it out, or take {what}")


def text(text: str) -> str:
    """The `type=` of an option that takes a name, or a file whose name may begin with ~."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a name or a file")
    return str(Path(text).expanduser()) if text.startswith("~") else text


def path(text: str) -> Path:
    """The `type=` of an option that takes a file or folder to read."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a file or folder")
    return Path(text).expanduser() if text.startswith("~") else Path(text)


@dataclass(frozen=True)
class OneOf:
    """The `type=` of one value of a list of known names, for `Listed`; elsewhere `choices=` does it."""

    known: tuple[str, ...]

    def __call__(self, text: str) -> str:
        if text not in self.known:
            raise argparse.ArgumentTypeError(unlisted(text, self.known))
        return text

    def holds(self, value: Any) -> bool:
        """True for a known name."""
        return value in self.known

    @property
    def expected(self) -> str:
        """The names in words."""
        return f"one of {', '.join(self.known)}"


def name(text: str) -> str:
    """The `type=` of an option that takes a name which stands in paths and pages (`fishmj.base.names`)."""
    if not is_name(text):
        near = f", for example {nearest(text)!r}" if nearest(text) else ""
        raise argparse.ArgumentTypeError(f"got {shown(text)}, expected 1 to 64 letters, digits, '_', '.' or '-'{near}")
    return text


DEVICE_HELP = "auto, cpu, cuda or cuda:N"
DEVICES_HELP = "auto, cpu, cuda, cuda:N, or several: cuda:all, cuda:0,cuda:1; default auto, one of them"
_DEVICE = r"(auto|cpu|cuda(:\d{1,3})?)"
_DEVICES = r"cuda:all|cpu(,cpu)+|cuda(:\d{1,3})?(,cuda(:\d{1,3})?)+"


def device(text: str) -> str:
    """The `type=` of an option that names the device of the computation: auto, cpu, cuda or cuda:N."""
    if re.fullmatch(_DEVICES, text):
        raise argparse.ArgumentTypeError(f"got {shown(text)}, several devices; expected one: auto, cpu, cuda or cuda:N")
    return _device(text, "auto, cpu, cuda, cuda:N")


def devices(text: str) -> str:
    """The `type=` of an option that names one device or several: also cuda:all, or a list such as cuda:0,cuda:1 or cpu,cpu."""
    return text if re.fullmatch(_DEVICES, text) else _device(text, "auto, cpu, cuda, cuda:N, cuda:all, cuda:0,cuda:1, cpu,cpu")


def _device(text: str, known: str) -> str:
    if not re.fullmatch(_DEVICE, text):
        raise argparse.ArgumentTypeError(unlisted(text, ("auto", "cpu", "cuda"), known))
    return text


def out_file(text: str) -> Path:
    """The `type=` of an option that names a file to write; a place that cannot be written is refused before the work starts."""
    where = path(text)
    if _is(where, Path.is_dir):
        raise argparse.ArgumentTypeError(f"{where}: is a folder; name a file to write")
    _writable(where, where.parent)
    return where


def out_folder(text: str) -> Path:
    """The `type=` of an option that names a folder to write into; an unwritable one is refused before the work starts."""
    where = path(text)
    if _is(where, Path.exists) and not _is(where, Path.is_dir):
        raise argparse.ArgumentTypeError(f"{where}: is a file; name a folder to write into")
    _writable(where, where)
    return where


def _is(where: Path, what: Callable[[Path], bool]) -> bool:
    try:
        return what(where)
    except OSError as error:  # a name too long, or one that the file system cannot hold
        raise argparse.ArgumentTypeError(f"{shown(str(where))}: {error.strerror}; choose another name") from error


def _writable(where: Path, folder: Path) -> None:
    """Raises ArgumentTypeError if no file can be made in `folder`, which may not exist yet; leaves no file behind."""
    _is(where, Path.exists)
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if _is(p, Path.exists))
    if not there.is_dir():
        raise argparse.ArgumentTypeError(f"{where}: {there} is a file, so nothing can be written below it; choose another place")
    try:
        with tempfile.TemporaryFile(dir=there) as file:  # tried: permissions say nothing to root or of /proc, nor of a full disk
            file.write(bytes(2**16))
    except OSError as error:
        message = f"{where}: {there} cannot be written ({error.strerror}); choose another place"
        raise argparse.ArgumentTypeError(message) from error
