"""Effects in the calibration file of a fish: an ordered list of `[[effect]]` blocks, each with values and their intervals.

    [[effect]]
    name = "coulomb_friction"
    provenance = "12 logs of 3 June, pool"
    hash = "sha256 of the evidence"
    parameters.torque = { value = 0.081, low = 0.074, high = 0.089 }

The effects act in the order of the file. A file without blocks is the nominal robot.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import parse_toml, read_toml, resolve
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_text
from fishmj.effects import EffectStack, RobotScales, get

KEYS = ("name", "parameters", "provenance", "hash")


class Interval(NamedTuple):
    """A value and its interval; low = high = value if the interval is unknown."""

    value: float
    low: float
    high: float


class FittedEffect(NamedTuple):
    """One effect of a calibration. parameters: {name: Interval}; parameters that are left out have their null values."""

    name: str
    parameters: dict[str, Interval]
    provenance: str = ""
    hash: str = ""  # of the evidence


def read(source: "str | Path") -> tuple[FittedEffect, ...]:
    """The effects of a fish TOML (path or shipped name), checked.

    Raises ConfigError: unknown effect, parameter or key (with the nearest one), value outside its bounds, an effect listed twice.
    """
    path = resolve(source)
    return parse(read_toml(path), str(path))


def parse(table: dict, where: str) -> tuple[FittedEffect, ...]:
    """Effects of a parsed TOML table, checked; `where` begins the error messages. Raises ConfigError: as `read`."""
    blocks = table.get("effect", [])
    if not isinstance(blocks, list) or not all(isinstance(block, dict) for block in blocks):
        raise ConfigError(f"{where}: effects are blocks [[effect]], got {str(blocks)[:80]}")
    robot = RobotScales.of_table(table)
    listed = tuple(block_of(block, f"{where} [[effect]] {i}", robot=robot) for i, block in enumerate(blocks, 1))
    names = [fitted.name for fitted in listed]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{where}: effect {name!r} is listed {names.count(name)} times; keep one block")
    return listed


def write(path: "str | Path", effects: "tuple[FittedEffect, ...] | list[FittedEffect]") -> Path:
    """Replaces the effect blocks of the TOML at `path` by `effects`, atomically; everything else stays.

    Raises ConfigError: as `read`; nothing is written then.
    """
    path = resolve(Path(path))
    kept = without_tables(path.read_text(encoding="utf-8"), "[[effect]]", "[effect.", "[[effect.")
    text = "\n\n".join([kept, *(_text(fitted) for fitted in effects)]) + "\n"
    parse(parse_toml(text, str(path)), str(path))
    return write_text(path, text)


def activate(effects, joints: int, robot: RobotScales | None = None) -> tuple[EffectStack, np.ndarray]:
    """(EffectStack, its parameter row (P,)) of a calibration, for a fish with `joints` joints and these constants."""
    active = EffectStack([get(fitted.name) for fitted in effects], joints, robot or RobotScales())
    values = {fitted.name: {name: interval.value for name, interval in fitted.parameters.items()} for fitted in effects}
    return active, np.array(active.flat(values))


def fitted(active: EffectStack, row, low=None, high=None, provenance: str = "", hash: str = "") -> tuple[FittedEffect, ...]:  # noqa: A002
    """A calibration from a stack and rows (P,) of values and, if known, of the ends of their intervals."""
    low, high = row if low is None else low, row if high is None else high
    intervals = {key: Interval(*map(float, x)) for key, *x in zip(active.names, row, low, high, strict=True)}
    named = lambda e: {p.name: intervals[e.name, p.name] for p in e.parameters}
    return tuple(FittedEffect(e.name, named(e), provenance, hash) for e in active.effects)


def block_of(block: dict, where: str, joints: int | None = None, robot: RobotScales | None = None) -> FittedEffect:
    """One block [[effect]], if given of a fish with that many joints, and with these constants; raises as `read`."""
    for key in block:
        if key not in KEYS:
            raise ConfigError(f"{where}: {UnknownName('key', key, KEYS)}")
    try:
        effect = get(str(block.get("name", ""))[:64])
    except UnknownName as error:
        raise ConfigError(f"{where}: {error}") from error
    where = f"{where} {effect.name}"
    effect = (effect if joints is None else effect.on_joints(joints)).on_robot(robot or RobotScales())
    given = block.get("parameters", {})
    if not isinstance(given, dict):
        raise ConfigError(f"{where}: parameters must be a table of name = {{ value, low, high }}, got {str(given)[:80]}")
    found = {}
    for name, entry in given.items():
        try:
            parameter = effect.parameter(name)
        except UnknownName as error:
            raise ConfigError(f"{where}: {error}") from error
        found[name] = _interval(entry, parameter, f"{where} {name}")
    return FittedEffect(effect.name, found, str(block.get("provenance", "")), str(block.get("hash", "")))


def _interval(entry, parameter, where: str) -> Interval:
    entry = entry if isinstance(entry, dict) else {"value": entry}
    values = {key: entry.get(key, entry.get("value")) for key in Interval._fields}
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values.values())
    if not numbers or set(entry) - set(values):
        raise ConfigError(f"{where}: needs {{ value, low, high }} in {parameter.unit}, finite numbers; got {str(entry)[:80]}")
    found = Interval(**{key: float(v) for key, v in values.items()})
    if not parameter.low <= found.value <= parameter.high:
        raise ConfigError(
            f"{where}: {found.value:g} {parameter.unit} lies outside the bounds {parameter.low:g} to {parameter.high:g};"
            f" check the unit, the null is {parameter.null:g}"
        )
    if not found.low <= found.value <= found.high:
        raise ConfigError(f"{where}: value {found.value:g} must lie in its interval {found.low:g} to {found.high:g}")
    return found


def _text(fitted: FittedEffect) -> str:
    quoted = lambda text: '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
    lines = ["[[effect]]", *(f"{key} = {quoted(getattr(fitted, key))}" for key in ("name", "provenance", "hash"))]
    for name, x in fitted.parameters.items():
        lines.append(f"parameters.{name} = {{ value = {float(x.value)!r}, low = {float(x.low)!r}, high = {float(x.high)!r} }}")
    return "\n".join(lines)


def without_tables(text: str, *heads: str) -> str:
    """TOML text without the tables whose heads begin in one of these ways; each ends at the next table of another."""
    kept, inside = [], False
    for line in text.splitlines():
        if line.strip().startswith("["):
            inside = line.strip().startswith(heads)
        if not inside:
            kept.append(line)
    return "\n".join(kept).rstrip("\n")
