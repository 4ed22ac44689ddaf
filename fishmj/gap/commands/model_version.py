"""Versions of a model: a fish TOML with effects, and a table of their origin.

    [version]
    number = 2
    parent = "fish"                 shipped name or file; parent_sha256 its hash: versions form a chain
    effects = ["coulomb_friction"]  effects that this version added or changed
    data, data_sha256, judged       data set, hash of its manifest, and the records that judge the version
    gap_before, gap_after           |z|^2 / m of the searched records, from the verdict: healthy robots leave about 1
    judged_gap                      the same, before and after, of the records `judged`
    [version.null], [version.gates], rivals

The blocks [[effect]] below it are `fishmj.effects.effect_calibration`'s. The parent's text is kept beside the version.
"""

from pathlib import Path

from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError
from fishmj.base.store import sha256, write_text
from fishmj.effects import effect_calibration, get
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.log.toml import dumps
from fishmj.mjcf.reading import load_robot, robot_from_dict


def digest(path: "str | Path") -> str:
    """sha256 of a model's text."""
    return sha256(resolve(path))


def facts(path: "str | Path") -> dict:
    """The table [version] of a model; {} for a first one. Raises ConfigError: it is no table, or its number is invalid."""
    version = read_toml(resolve(path)).get("version", {})
    if not isinstance(version, dict) or not isinstance(version.get("number", 1), int):
        raise ConfigError(f"{path}: [version] was not written by gap apply: it needs a whole number; use the parent model")
    return version


def found(verdict: dict, provenance: str, evidence: str) -> list[FittedEffect]:
    """The effects of a verdict as calibration blocks, in the catalogue's order. Raises ConfigError: bounds, unknown effects."""
    blocks = []
    for effect in verdict["effects"]:
        bounds = {p.name: (p.low, p.high) for p in get(effect["name"]).parameters}
        intervals = {}
        for name, v in effect["parameters"].items():
            low, high = bounds.get(name, (v["low"], v["high"]))
            inside = lambda x: min(max(float(x), low), high)  # noqa: B023, E731  used at once
            value = inside(v["value"])
            intervals[name] = Interval(value, min(inside(v["low"]), value), max(inside(v["high"]), value))
        blocks.append(FittedEffect(effect["name"], intervals, provenance, evidence))
    return blocks


def merged(parent: "tuple[FittedEffect, ...]", new: list[FittedEffect]) -> list[FittedEffect]:
    """The parent's effects with the new ones appended; an existing one gets the new values."""
    fresh = {fitted.name: fitted for fitted in new}
    return [fresh.pop(old.name, old) for old in parent] + list(fresh.values())


def write(parent: "str | Path", out: Path, effects: list[FittedEffect], version: dict, *, keep: bool = True) -> Path:
    """Writes a version: the parent's text, the table [version], the blocks; checked before it is written.

    keep: also put the parent's text beside it, which `revert` needs.
    """
    source = resolve(parent)
    text = source.read_text(encoding="utf-8")
    if out.resolve() == source.resolve():
        raise ConfigError(f"{out}: a version must not replace its parent; choose another name")
    number = number_of(parent) + 1
    table = {"number": number, "parent": str(parent), "parent_sha256": digest(parent), **version}
    if keep:
        table["parent_text"] = beside(out).name
        write_text(beside(out), text)
    body = effect_calibration.without_tables(text, "[version]", "[version.") + "\n\n" + dumps({"version": table})
    write_text(out, body)
    effect_calibration.write(out, merged(load_robot(parent).effects, effects))
    robot_from_dict(read_toml(out), str(out))
    return out


def revert(model: Path) -> Path:
    """Restores the parent's text in place of `model`, bit for bit; the version moves to MODEL.reverted-<hash>.toml.

    Raises ConfigError: a first version, or the parent's text is missing or changed.
    """
    version = facts(model)
    if not version:
        raise ConfigError(f"{model}: no table [version]: this is a first version, there is nothing to revert")
    kept = parent_of(model, version)
    if not kept.is_file() or digest(kept) != version.get("parent_sha256"):
        raise ConfigError(f"{model}: its parent {kept} is missing or changed; expected sha256 {version.get('parent_sha256')}")
    aside = Path(model).with_name(f"{Path(model).stem}.reverted-{digest(model)[:12]}.toml")
    write_text(aside, Path(model).read_text(encoding="utf-8"))
    write_text(Path(model), kept.read_text(encoding="utf-8"))
    return aside


def parent_of(model: "str | Path", version: dict) -> Path:
    """Path of the parent's text from a version's table: beside it, nowhere else. Raises ConfigError."""
    name = version.get("parent_text", "")
    if not isinstance(name, str) or name in ("", ".", "..") or Path(name).name != name or "\0" in name:
        raise ConfigError(f"{model} [version]: parent_text = {str(name)[:60]!r}; expected the name of a file beside the version")
    return Path(model).with_name(name)


def number_of(model: "str | Path") -> int:
    """Number of a version; 1 for a first one. Raises ConfigError if its table states none."""
    number = facts(model).get("number", 1)
    if not isinstance(number, int) or isinstance(number, bool) or number < 1:
        raise ConfigError(f"{model} [version]: number = {str(number)[:40]!r}; expected a whole number from 1 up")
    return number


def next_name(parent: "str | Path", folder: Path) -> Path:
    """Name of the version after `parent`: `<fish>.v<N>.toml`."""
    stem = resolve(parent).stem.split(".v")[0]
    return folder / f"{stem}.v{number_of(parent) + 1}.toml"


def beside(out: Path) -> Path:
    """Path of the parent's text beside a version."""
    return out.with_name(f"{out.stem}.parent.toml")
