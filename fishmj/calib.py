"""Calibration files: `data/calib/*.toml`, the one place where a number of the paper or of a ruler lives."""

import tomllib
from functools import cache
from pathlib import Path

from fishmj.errors import ConfigError, UnknownName

_ROOT = Path(__file__).resolve().parent
FOLDERS = (_ROOT.parent / "data" / "calib", _ROOT / "_data" / "calib")  # checkout first, then the installed wheel


def calib_folder() -> Path:
    """The folder that holds the shipped calibration (checkout or wheel)."""
    for folder in FOLDERS:
        if (folder / "paper.toml").is_file():
            return folder
    raise ConfigError(f"no calibration found: looked for paper.toml in {', '.join(map(str, FOLDERS))}; reinstall fishmj")


def read_toml(path: str | Path) -> dict:
    """Read one TOML file; a syntax error names file and line."""
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


def resolve(name: str | Path) -> Path:
    """A TOML path, or the name of a shipped one: `fish` -> data/calib/fish.toml."""
    path = Path(name)
    if path.suffix == ".toml":
        if not path.is_file():
            raise ConfigError(f"{path}: no such file; shipped ones go by name: {', '.join(shipped())}")
        return path
    if path.suffix == ".xml":
        raise ConfigError(
            f"{path}: a MuJoCo model does not say what the water needs; describe the fish in a .toml (docs/your_own_fish.md)"
        )
    if str(name) not in shipped():
        raise UnknownName("calibration file", str(name), shipped())
    return calib_folder() / f"{name}.toml"


def shipped() -> list[str]:
    """Names of the shipped calibration files."""
    return sorted(p.stem for p in calib_folder().glob("*.toml"))


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
