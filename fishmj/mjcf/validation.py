"""Lists every error of a description in lines that a reader can act on: file, block, key, got, expected, what to do.

    errors, notes = examine(table, "my_fish.toml")

`description_schema.py` holds the rules for a single key, `relations.py` those between keys, and the unlikely values (notes).
"""

from collections.abc import Iterator, Mapping, Sequence
from math import pi, radians
from typing import Any

from pydantic import ValidationError

from fishmj.base import names
from fishmj.base.errors import closest_name
from fishmj.mjcf.description_schema import BLOCKS, FREE, LISTS, SCHEMA, Description, KeyFault, header, keys, line, said, shown
from fishmj.mjcf.relations import relations, servo_of, unlikely

MOST = 100  # errors that are collected: more tell nobody more


def examine(table: Mapping[str, Any], where: str) -> tuple[list[str], list[str]]:
    """(errors, notes), one line each, of a parsed TOML description; `where` begins each line."""
    given = table.get("schema", SCHEMA)
    if given != SCHEMA:  # another format: every other line would be noise
        kind = "a fitted water, for --water" if isinstance(given, str) and given.startswith("fishmj.water/") else "another format"
        finding = KeyFault("", None, "schema", shown(given), repr(SCHEMA), f"this file is {kind}, not a robot")
        return [line(finding, table, where)], []
    if foreign := _foreign(table):
        expected = "a robot: [[link]], [servo], [timing], [water], ..."
        return [line(KeyFault("", None, "", foreign, expected, "this file describes something else"), table, where)], []
    found = list(_single_keys(table))
    bad = {(f.block, f.nth) for f in found} | {(f.block, None) for f in found}
    listed = not any(f.block == "link" and f.nth is None for f in found)
    found += list(relations(table, bad, listed))
    notes = [] if found else [line(note, table, where) for note in unlikely(table)]
    lines = [line(finding, table, where) for finding in sorted(found, key=_order)]
    if len(found) >= MOST:
        lines.append(f"{where}: got {MOST} errors, expected a robot; the rest of the file was not looked at")
    return lines, notes


def _foreign(table: Mapping[str, Any]) -> str:
    """The keys of a table that has no block of a robot, not even a mistyped one; otherwise empty."""
    own = {"schema", *BLOCKS}
    unknown = [key for key in table if key not in keys()]
    if not unknown or own & table.keys() or any(closest_name(key, keys()) for key in unknown):
        return ""
    return shown(", ".join(unknown))


def _order(f: KeyFault) -> tuple:
    """Sorting key: position of a fault in the file's schema."""
    blocks = keys()
    return (blocks.index(f.block) if f.block in blocks else -1, -1 if f.nth is None else f.nth)


# rules for a single key


def _single_keys(table: Mapping[str, Any]) -> Iterator[KeyFault]:
    """Errors from pydantic, at most one for each key."""
    surplus = set([key for key in table if key not in keys()][MOST:])
    try:
        Description.model_validate({key: item for key, item in table.items() if key not in surplus})
    except ValidationError as error:
        faults: dict[tuple, KeyFault] = {}
        entries = error.errors(include_url=False, include_context=False)
        meant = {(*e["loc"][:-1], _nearest(e["loc"])) for e in entries[:MOST] if e["type"] == "extra_forbidden"}
        for entry in entries:
            if entry["type"] == "missing" and entry["loc"] in meant:
                continue  # mistyped, which is another line
            finding = _finding(entry, table)
            faults.setdefault(finding[:3], finding)
            if len(faults) == MOST:
                break
        yield from faults.values()


def _nearest(place: Sequence[Any]) -> str:
    """The known key of a block that an unknown one is nearest to, or ""."""
    block, _, key, _ = _split(place)
    return closest_name(key, keys(block)) if block in BLOCKS and key else ""


def _finding(entry: Mapping[str, Any], table: Mapping[str, Any]) -> KeyFault:
    place, kind, value = entry["loc"], entry["type"], entry["input"]
    block, index, key, inner = _split(place)
    if kind == "extra_forbidden":
        return _unknown(block, index, key, table)
    if kind == "missing" and not key:
        needed = ", ".join(k for k, info in BLOCKS[block].model_fields.items() if info.is_required())
        return KeyFault(block, None, "", "none", said("", block)[2], f"describe the links: add [[{block}]] with {needed}")
    if kind == "missing":
        what, _, expected = said(block, key)
        return KeyFault(block, index, key, "nothing", expected, f"add {key} = ... ({what})")
    if block and not key:  # the block itself is no table, or there are too few or too many
        whole = said("", block)[2]
        got = f"{len(value)} block{'s' * (len(value) != 1)}" if kind in ("too_short", "too_long") else shown(value)
        return KeyFault(block, index, "", got, whole, f"a block begins with {header(block)} on a line of its own")
    if block not in BLOCKS and block:  # [origin], [calibration.servo]
        return KeyFault(block, None, key, shown(value), said("", block)[2], f"({said('', block)[0]})")
    what, unit, expected = said(block, key)
    if (block, key, kind) == ("servo", "kd", "greater_than_equal") and (least := _least_damping(table)):
        expected = f"at least {least:.3g} {unit} = torque / speed_no_load"
    return KeyFault(block, index, key, _got(value, inner), expected, _todo(value, kind, what, unit, key))


def _least_damping(table: Mapping[str, Any]) -> float:
    """torque / speed_no_load if both are sound; 0 otherwise."""
    servo = servo_of(table["servo"])
    torque, speed = servo["torque"], servo["speed_no_load"]
    sound = all(isinstance(v, int | float) and 1e-4 <= v <= 1e5 for v in (torque, speed))
    return torque / speed if sound else 0.0


def _split(place: Sequence[Any]) -> tuple[str, int | None, str, list[Any]]:
    """Splits pydantic's place into (block, index, key, place within the value)."""
    parts = [str(p) if not isinstance(p, int) else p for p in place]
    first = str(parts[0])
    if first in LISTS:
        index = parts[1] if len(parts) > 1 and isinstance(parts[1], int) else None
        return first, index, str(parts[2]) if len(parts) > 2 else "", parts[3:]
    if first in BLOCKS or first in ("calibration", *FREE):
        return first, None, str(parts[1]) if len(parts) > 1 else "", parts[2:]
    return "", None, first, parts[1:]


def _got(value: Any, inner: Sequence[Any]) -> str:
    """The value, and its place in the list that holds it."""
    numbers = [i + 1 for i in inner if isinstance(i, int)]
    spot = "" if not numbers else f" in row {numbers[0]}" if len(numbers) > 1 else f" at number {numbers[0]}"
    length = f" ({len(value)} characters)" if isinstance(value, str) and len(value) > 60 else ""
    length = f" ({len(value)} of them)" if isinstance(value, list) else length
    return shown(value) + length + spot


def _todo(value: Any, kind: str, what: str, unit: str, key: str) -> str:
    """Advice on one key."""
    if key == "name" and isinstance(value, str) and names.nearest(value):
        return f"for example {names.nearest(value)[:24]!r}"
    if isinstance(value, str) and kind in ("float_type", "int_type"):
        return "write the number without quotes"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal") and unit:
        turned = kind == "less_than_equal" and unit in ("rad", "rad/s") and isinstance(value, int | float)
        deg = f": {value:g} {unit.replace('rad', 'deg')} is {radians(value):.4g} {unit}" if turned else ""
        rpm = f", {value:g} rpm is {value * pi / 30:.4g} {unit}" if turned and unit == "rad/s" else ""
        return f"check the number and its unit, {unit}{deg}{rpm} ({what})"
    return f"correct it ({what})"


def _unknown(block: str, index: int | None, key: str, table: Mapping[str, Any]) -> KeyFault:
    """An unknown key or block, with the nearest known one."""
    name, own = shown(key)[1:-1], "your own notes go into [notes], [origin] or [measured]"
    if block:
        known = keys(block)
        near, home = closest_name(key, known), _home(key, block)
        todo = f"it belongs under {home}; a key belongs to the last [block] above it" if home and not near else own
        return KeyFault(block, index, name, "an unknown key", _one_of(near, known), todo)
    blocks = [k for k in keys() if k not in ("schema", "name", "title")]
    if not isinstance(table[key], Mapping | list):
        near, home = closest_name(key, keys()), _home(key)
        if home and not near:
            return KeyFault("", None, name, "a key at the top of the file", f"it under {home}", "move it below that line")
        return KeyFault("", None, name, "an unknown key", _one_of(near, ["schema", "name", "title", "notes"]), own)
    near = closest_name(key, blocks)
    expected = _one_of(near and header(near), [header(k) for k in blocks], quote=False)
    return KeyFault("", None, f"[{name}]", "an unknown block", expected, own)


def _one_of(near: str, known: Sequence[str], *, quote: bool = True) -> str:
    """Known names in words, the nearest first."""
    others = ", ".join(k for k in known if k != near)
    return f"{repr(near) if quote else near} or another of {others}" if near else f"one of {others}"


def _home(key: str, but: str = "") -> str:
    """Header of another block that has this key; "" if there is none."""
    return next((header(b) for b in BLOCKS if b != but and key in keys(b)), "")
