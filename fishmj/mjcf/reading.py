"""Reads a robot from its TOML file, a parsed table or dataclasses built by hand, and checks it.

    robot = load_robot("fish")          # a shipped name, a path or a `Robot`

The dataclasses are in `description`, the rules in `validation` and `relations`.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fishmj.base import console
from fishmj.base.calib import calib_folder, read_toml, resolve, shown_path
from fishmj.base.errors import ConfigError, DescriptionError
from fishmj.base.names import nearest
from fishmj.base.options import checked_name
from fishmj.mjcf.description import COMMAND_PATHS, WATER_NEEDS, Fin, Link, RigSpec, Robot, Servo, Timing

if TYPE_CHECKING:
    from fishmj.effects.effect_calibration import FittedEffect


def load_robot(source: "str | Path | Robot" = "fish") -> Robot:
    """Reads a robot from a TOML path or a shipped name (`fish`, `tendon_fish`), or checks one that was built by hand.

    Notes on defaults and on unlikely values are printed once on stderr, and kept in `Robot.notes`.

    Raises:
        DescriptionError: something is missing, unknown or impossible; lists everything with file, block, key, got, expected.
        ConfigError: the file cannot be read. UnknownName: no such shipped description.
    """
    if isinstance(source, Robot):
        return checked(source)
    path = resolve(source, robot=True)
    return robot_from_dict({"name": _name_of(path)} | read_toml(path), shown_path(path))


def robot_from_dict(table: Mapping[str, Any], where: str) -> Robot:
    """Builds and checks a robot from a parsed TOML table; `where`, its file, begins messages. Raises as `load_robot`."""
    table = {"name": _name_of(Path(where))} | dict(table)
    notes = _examined(table, where)
    servo = _in_radians(table.get("servo", {}))
    links = tuple(Link(**_tuples(entry)) for entry in table["link"])
    water, assumed = _water(table.get("water", {}), links, where)
    notes += [
        *assumed,
        *_defaults("servo", Servo(), servo, where),
        *_defaults("timing", Timing(), table.get("timing", {}), where),
    ]
    if "schema" not in table:
        notes.append(f'{where}: no schema, read as fishmj.fish/1; put schema = "fishmj.fish/1" into its first line')
    robot = Robot(
        name=table["name"],
        title=table.get("title", ""),
        links=links,
        fins=tuple(Fin(**_tuples(entry)) for entry in table.get("fin", [])),
        servo=Servo(**servo),
        timing=Timing(**table.get("timing", {})),
        rig=RigSpec(**_tuples(_in_radians(table.get("rig", {})))),
        water=water,
        density_water=float(table.get("body", {}).get("density_water", 1000.0)),
        hull=table.get("body", {}).get("hull", "turbulent"),
        effects=_effects(dict(table), where),
        file=where,
        notes=tuple(notes),
    )
    return _sound(robot)


def _name_of(path: Path) -> str:
    """Name for a robot whose description has none."""
    return nearest(path.stem) or "fish"


def checked(robot: Robot) -> Robot:
    """Checks a robot that was built by hand by the rules of a file; returns one that was checked before at once.

    Raises DescriptionError: as `load_robot`.
    """
    if _SOUND in vars(robot):
        return robot
    where = f"robot {str(robot.name)[:64]!r}"
    for kind, name, parts in ((Link, "links", robot.links), (Fin, "fins", robot.fins)):
        if not isinstance(parts, tuple | list) or not all(isinstance(part, kind) for part in parts):
            raise DescriptionError([f"{where} {name}: got {str(parts)[:60]}, expected a tuple of {kind.__name__}"])
    kinds = (("servo", Servo), ("timing", Timing), ("rig", RigSpec), ("water", Mapping))
    if not all(isinstance(getattr(robot, name), kind) for name, kind in kinds):
        raise DescriptionError([f"{where}: expected servo, a Servo, timing, a Timing, rig, a RigSpec, and water, a dict"])
    chosen = ("own", "model") if "own" in robot.water else ()  # by water.choice, which no file states
    table = {
        "name": robot.name,
        "title": robot.title,
        "body": {"density_water": robot.density_water, "hull": robot.hull},
        "link": [_plain(vars(link)) for link in robot.links],
        "fin": [_plain(vars(fin)) for fin in robot.fins],
        "servo": _plain(vars(robot.servo)),
        "timing": _plain(vars(robot.timing)),
        "rig": _plain(vars(robot.rig)),
        "water": _plain({key: value for key, value in robot.water.items() if key not in chosen}),
    }
    notes = _examined(table, where)
    water, assumed = _water(robot.water, robot.links, where)
    if assumed:
        robot = replace(robot, water=water)
    object.__setattr__(robot, "notes", (*robot.notes, *notes, *assumed))
    return _sound(robot)


_SOUND = "_sound"  # attribute of a robot that passed; `dataclasses.replace` leaves it behind


def _sound(robot: Robot) -> Robot:
    object.__setattr__(robot, _SOUND, True)
    for note in robot.notes:
        # without where it was read: a copy of a robot has the same to say
        console.warn_once(note, (robot.name, note.partition(" [")[2]))
    return robot


def _examined(table: Mapping[str, Any], where: str) -> list[str]:
    """Notes on a sound table; loads pydantic at the first description.

    A computer beside the tank lacks pydantic (deploy/host_requirements.txt): shipped files were checked before, another file gets
    a note.
    """
    try:
        from fishmj.mjcf.validation import examine
    except ModuleNotFoundError as error:
        if error.name != "pydantic":
            raise
        shipped = where in {shown_path(path) for path in calib_folder().glob("*.toml")}
        return [] if shipped else [f"{where}: not examined, pydantic is missing; open it once where all of fishmj is installed"]
    errors, notes = examine(table, where)
    if errors:
        raise DescriptionError(errors)
    return notes


def _in_radians(block: Mapping[str, Any]) -> dict[str, Any]:
    """Converts the angles of a block to rad; their keys end in _deg in the file."""
    turned = lambda value: [radians(v) for v in value] if isinstance(value, list) else radians(value)
    plain = {key: value for key, value in block.items() if not key.endswith("_deg")}
    return plain | {key.removesuffix("_deg"): turned(value) for key, value in block.items() if key.endswith("_deg")}


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    """One [[link]], [[fin]] or [rig] with tuples for lists, as the dataclasses hold them."""
    frozen = dict(entry)
    for key in ("com", "colour"):
        if key in frozen:
            frozen[key] = tuple(float(v) for v in frozen[key])
    for key in ("sections", "red", "yellow"):
        if key in frozen:
            frozen[key] = tuple(tuple(float(v) for v in row) for row in frozen[key])
    return {key: tuple(value) if isinstance(value, list) else value for key, value in frozen.items()}


def _plain(value: Any) -> Any:
    """Converts a value to TOML's types: lists for tuples and arrays, Python's numbers for NumPy's, no key for None."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _defaults(block: str, default: "Servo | Timing", given: Mapping[str, Any], where: str) -> list[str]:
    """Note on the keys that a block leaves out, in one line."""
    left = {key: value for key, value in vars(default).items() if key not in given}
    if not left:
        return []
    values = ", ".join(f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}" for key, value in left.items())
    return [
        f"{where} [{block}]: not given, taken from the default fish: {values} (SI, rad);"
        " state your own (docs/simulate/your_own_fish.md)"
    ]


def _water(given: Mapping[str, Any], links: tuple[Link, ...], where: str) -> tuple[dict, list[str]]:
    """The water table with the prior's values for the missing keys, and notes on them."""
    missing = [key for key in WATER_NEEDS if key not in given and f"{key}_deg" not in given]
    water = dict(given)
    if not missing:
        return water, []
    from fishmj.mjcf.priors import water_prior

    prior = water_prior(links)
    taken = {key: value for key, value in prior.items() if key.removesuffix("_deg") in missing}
    values = ", ".join(f"{key} = {value}" for key, value in taken.items())
    return {**water, **taken}, [
        f"{where} [water]: not given, estimated from the shape: {values}; not fitted (docs/simulate/water.md)"
    ]


def check_timing(timing: Timing, where: str) -> None:
    """Checks that steps nest: physics into bus into control. Raises ConfigError: they do not; names the nearest valid value."""
    from fishmj.mjcf.relations import timing as findings

    for finding in findings(vars(timing)):
        raise ConfigError(f"{where}: {finding.key} = {finding.got} is not {finding.expected}; {finding.todo}")


def with_timing(robot: Robot, control_dt: float | None, command_path: str | None, where: str) -> Robot:
    """Robot with another time between decisions [s] and another path of commands; None keeps its own.

    Raises UnknownName: no such path; ConfigError: the step does not fit the bus; names the nearest that does.
    """
    if command_path is not None:
        checked_name("command path", command_path, COMMAND_PATHS)
    wanted: dict[str, Any] = {"control_dt": control_dt, "command_path": command_path}
    timing = replace(robot.timing, **{key: value for key, value in wanted.items() if value is not None})
    check_timing(timing, where)
    return replace(robot, timing=timing)


def _effects(table: dict, where: str) -> "tuple[FittedEffect, ...]":
    """Parses the blocks [[effect]]; the catalogue is loaded only for a fish that has some."""
    if not table.get("effect"):
        return ()
    from fishmj.effects.effect_calibration import parse

    return parse(table, where)
