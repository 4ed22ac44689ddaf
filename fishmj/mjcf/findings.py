"""One thing that is wrong with a description, and the line that tells it: file, block, key, got, expected, what to do."""

from collections.abc import Mapping
from datetime import date, time
from typing import Any, NamedTuple

from fishmj import names
from fishmj.mjcf import description_schema


class Fault(NamedTuple):
    """One thing that is wrong. block: "link"; nth: which of several, from 0; key: "mass", or "" for the whole block."""

    block: str
    nth: int | None
    key: str
    got: str
    expected: str
    todo: str = ""


def line(f: Fault, table: Mapping[str, Any], where: str) -> str:
    """`FILE [[link]] 2 'body1' mass: got nan, expected a number above 0 kg; what to do`."""
    place = ""
    if f.block:
        place = f" [[{f.block}]]" if f.block in description_schema.LISTS else f" [{f.block}]"
    if f.nth is not None:
        entry = table[f.block][f.nth]
        label = entry.get("name") if isinstance(entry, Mapping) else None
        place += f" {f.nth + 1}" + (f" {label!r}" if names.is_name(label) else "")
    key = (f" {f.key}" if f.key.isprintable() and len(f.key) <= 64 else f" {shown(f.key)}") if f.key else ""
    if not f.expected:  # the catalogue of effects words its own
        return f"{where}{place}{key}: {f.got}"
    return f"{where}{place}{key}: got {f.got}, expected {f.expected}" + (f"; {f.todo}" if f.todo else "")


def shown(value: Any, most: int = 60) -> str:
    """A value for a message: short, on one line, and safe whatever it holds."""
    if isinstance(value, bool):
        text = str(value).lower()  # as TOML spells it
    elif isinstance(value, int) and value.bit_length() > 128:
        text = f"an integer of {value.bit_length()} bits"
    elif isinstance(value, str):
        text = repr(value[:most])
        if len(value) > most or len(text) > most + 2:
            text = f"{text[: most - 4]}...{text[0]}"
    elif isinstance(value, Mapping):
        text = f"a block of {len(value)} keys"
    elif isinstance(value, date | time):
        text = f"the {'time' if isinstance(value, time) else 'date'} {value.isoformat()}"
    elif isinstance(value, list):
        text = f"[{', '.join(shown(item, 20) for item in value[:6])}{', ...' * (len(value) > 6)}]"
    else:
        text = repr(value)
    return text if len(text) <= most + 2 else text[: most - 3] + "..."


__all__ = ["Fault", "line", "shown"]
