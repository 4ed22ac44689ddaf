"""Calibration files `data/calib/*.toml`: the only place for constants of the paper and for measured lengths."""

import codecs
import os
import re
import tomllib
from functools import cache
from pathlib import Path

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.plain_file import ABSENT, why_unreadable
from fishmj.base.toml_errors import explained

LARGEST = 1_000_000  # bytes; the largest file of ours, a fitted water, has 20 kB
DEEPEST = 24  # tables and lists inside one another; ours have 5
MODELS = {".xml": "a MuJoCo model"} | dict.fromkeys((".urdf", ".xacro"), "a URDF") | {".sdf": "an SDF model"}
_ROOT = Path(__file__).resolve().parents[1]
ROOTS = (_ROOT.parent / "data", _ROOT / "_data")  # what comes with fishmj: checkout first, then the installed wheel
FOLDERS = tuple(root / "calib" for root in ROOTS)
OWN = Path("data")  # of the working directory, as runs/: where verbs put what they fit and collect
WATERS = (OWN / "water", *(root / "water" for root in ROOTS))
FAMILY = "-family"  # end of the name of a family of waters


def calib_folder() -> Path:
    """The folder that holds the shipped calibration (checkout or wheel)."""
    for folder in FOLDERS:
        if (folder / "paper.toml").is_file():
            return folder
    raise ConfigError(f"no calibration found: looked for paper.toml in {', '.join(map(str, FOLDERS))}; reinstall fishmj")


def read_toml(path: str | Path) -> dict:
    """Reads one TOML file of unknown origin.

    Raises ConfigError: no such file, a folder, not readable, larger than 1 MB, not UTF-8, not TOML (says line, text, block and
    what to do), or nested deeper than any description is.
    """
    return parse_toml(_text(Path(path)), shown_path(path))


def parse_toml(text: str, where: str) -> dict:
    """Parses a TOML text into a dictionary; `where` begins the error messages. Raises ConfigError: as `read_toml`."""
    if len(text) > LARGEST:
        raise ConfigError(f"{where}: larger than {LARGEST / 1e6:g} MB, expected a TOML file of a few kB; is this the right file?")
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise ConfigError(
            f"{where}: line {line}: a key of more than {_PARTS} parts with dots between, expected {DEEPEST} at most"
        )
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise ConfigError(f"{where}: lists or tables nested too deep to read, expected {DEEPEST} levels at most") from None
    except ValueError as error:  # also an integer of more than 4300 digits
        raise ConfigError(f"{where}: not valid TOML: {explained(text, error)}") from error
    _check_values(table, where)
    return table


_PARTS = 64
_PART = r"""(?:[A-Za-z0-9_-]{1,99}|"[^"\n]{0,99}"|'[^'\n]{0,99}')"""
_LONG_KEY = re.compile(rf"(?:\.[ \t]{{0,9}}{_PART}[ \t]{{0,9}}){{{_PARTS}}}")  # tomllib takes time by the square of a key's parts


def _text(path: Path) -> str:
    """Text of a file, at most 1 MB of UTF-8."""
    shown = shown_path(path)
    if wrong := why_unreadable(path, "a TOML file"):
        raise ConfigError(f"{shown}: {wrong}")
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"{shown}: cannot be read: {error.strerror or error}") from error
    if len(raw) > LARGEST:
        raise ConfigError(f"{shown}: larger than {LARGEST / 1e6:g} MB, expected a TOML file of a few kB; is this the right file?")
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ConfigError(f"{shown}: is UTF-16 text, not UTF-8; expected TOML: save it again with the encoding UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{shown}: byte {error.start} (line {line}) is not UTF-8 text: a binary file, or text saved in another encoding;"
            " expected TOML; save it again with the encoding UTF-8"
        ) from error


def _check_values(table: dict, where: str) -> None:
    """Checks the nesting depth and that integers fit 64 bits. Uses no recursion, so that no file can exhaust the stack."""
    waiting = [("", table, 1)]
    while waiting:
        key, item, level = waiting.pop()
        if isinstance(item, dict | list):
            if level > DEEPEST:
                raise ConfigError(f"{where}: lists or tables nested deeper than the {DEEPEST} levels that may be")
            inside = item.items() if isinstance(item, dict) else ((key, inner) for inner in item)
            waiting += [(name, inner, level + 1) for name, inner in inside]
        elif isinstance(item, int) and not -(2**63) <= item < 2**63:
            raise ConfigError(f"{where}: {key[:64]!r}: an integer of {item.bit_length()} bits, expected 64 bits at most")


def resolve(name: str | Path, *, robot: bool = False) -> Path:
    """A TOML path, or the name of a shipped one: `fish` -> data/calib/fish.toml. robot: robots alone.

    Raises ConfigError: no such file, or a folder; UnknownName: neither a TOML path nor a shipped name.
    """
    known = list(robots()) if robot else shipped()
    if not isinstance(name, str | Path) or not str(name):
        raise ConfigError(f"got {name!r:.80}, expected the path of a TOML file or a shipped name: {', '.join(known)}")
    path = Path(name)
    shown = shown_path(path)
    if model := MODELS.get(path.suffix.lower()):
        raise ConfigError(
            f"{shown}: {model} does not say what the water needs; describe the fish in a .toml, which fishmj new writes "
            "(docs/simulate/your_own_fish.md)"
        )
    if path.suffix == ".toml":
        wrong = why_unreadable(path, "a TOML file")
        if wrong == ABSENT:
            raise ConfigError(f"{shown}: {ABSENT}; shipped ones go by name: {', '.join(known)}")
        if wrong:
            raise ConfigError(f"{shown}: {wrong}")
        return path
    if str(name) not in (known if robot else shipped()):
        if os.path.exists(beside := Path(f"{path}.toml")):  # a text that can be no path does not exist
            raise ConfigError(f"{shown}: expected a shipped name ({', '.join(known)}) or a .toml file; did you mean {beside}?")
        if os.path.exists(path):
            kind = why_unreadable(path, "") or "is a file whose name does not end in .toml"
            raise ConfigError(f"{shown}: {kind}; expected a .toml file, or a shipped name: {', '.join(known)}")
        near = next((key for key, own in robots().items() if own == str(name)), "") if robot else ""
        raise UnknownName("robot" if robot else "calibration file", str(name)[:100], known, near=near)
    return calib_folder() / f"{name}.toml"


def shown_path(path: str | Path) -> str:
    """Printable form of a path for a message, at most 300 characters."""
    text = "".join(c if c.isprintable() else "?" for c in str(path)[:300])
    return text if len(str(path)) <= 300 else f"{text}..."


def shipped() -> list[str]:
    """Names of the shipped calibration files."""
    return sorted(p.stem for p in calib_folder().glob("*.toml"))


def waters() -> list[str]:
    """Names of the fitted waters that come with fishmj."""
    return [name for name in _in_waters() if not name.endswith(FAMILY)]


@cache
def families() -> list[str]:
    """Names of the families of fitted waters that come with fishmj."""
    return [name for name in _in_waters() if name.endswith(FAMILY)]


def _in_waters() -> list[str]:
    return sorted({path.stem for folder in WATERS if folder.is_dir() for path in folder.glob("*.toml")})


@cache
def robots() -> dict[str, str]:
    """Names of the shipped robots, each with the robot's name in its description."""
    texts = {name: (calib_folder() / f"{name}.toml").read_text(encoding="utf-8") for name in shipped()}
    own = {name: _ROBOT.search(text) for name, text in texts.items()}
    return {name: found[1] for name, found in own.items() if found}


def robot_called(name: object) -> str:
    """Shipped description of a robot by the file's name or the robot's own; "" if there is none."""
    return next((file for file, own in robots().items() if name in (file, own)), "")


_ROBOT = re.compile(r'^schema = "fishmj\.fish/1"\nname = "([^"]*)"', re.MULTILINE)  # parsing them all takes longer than a fish


@cache
def paper() -> dict:
    """`paper.toml`: every constant quoted from the paper as {value, unit, source}, by section."""
    return read_toml(calib_folder() / "paper.toml")


def constant(section: str, key: str):
    """The value of one constant of the paper, for example `constant("reward", "wD")`."""
    table = paper()
    if section not in table:
        raise UnknownName("section of paper.toml", section, table)
    if key not in table[section]:
        raise UnknownName(f"constant in [{section}] of paper.toml", key, table[section])
    return table[section][key]["value"]
