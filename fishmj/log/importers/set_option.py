"""The option --set: the user's statements of places, units and scales of columns, and of what to leave out."""

from collections.abc import Collection, Iterable
from pathlib import Path

from fishmj.base.errors import LogError, UnknownName, closest_name
from fishmj.log.importers.column_map import is_column
from fishmj.log.importers.column_units import unit_of
from fishmj.log.importers.sheet import DATE
from fishmj.log.limits import quoted
from fishmj.log.trial import TABLES, table_spec

UNUSED = {  # where a statement has no effect; {} is the file of the map
    "columns": "files that --columns maps; state it in {}",
    "topics": "a recording that is read by its topics; --format table reads it by its columns, or write a mapping (--topics)",
    "folders": "trial folders, which are copied; leave it out",
}


def overrides(texts: Iterable[str]) -> dict[str, tuple[str, str, float]]:
    """Parses `servo1=cmd.c1:deg`, `u=pose.x:px*0.0012`, `foo=skip` to {column: (place, unit, scale)}.

    Raises LogError: no such table, column or unit, with the nearest.
    """
    out = {}
    for text in texts:
        column, mark, target = text.rpartition("=")
        place, _, rest = target.partition(":")
        unit, _, factor = rest.partition("*")
        where = f"--set {quoted(text)}"
        if not mark or not column.strip():
            raise LogError(f"{where}: expected COLUMN=TABLE.COLUMN:UNIT, for example servo1=cmd.c1:deg, or COLUMN=skip")
        if place not in ("t", "skip"):
            table, _, ours = place.partition(".")
            if table not in TABLES:
                raise UnknownName(f"table in {where}:", table[:40], TABLES)
            if ours == "t":
                place = "t"
            elif not is_column(table_spec(table), ours):
                raise LogError(f"{where}: table {table!r} has no column {quoted(ours)}; expected {table_spec(table).describe()}")
        if unit and unit != DATE and not unit_of(unit):
            raise LogError(f"{where}: unit {quoted(unit)} is not known")
        try:
            scale = float(factor) if factor else 1.0
        except ValueError:
            scale = 0.0
        if not 0 < scale < 1e12:
            raise LogError(f"{where}: scale {quoted(factor)}; expected a positive number, such as px*0.0012")
        out[column.strip()] = (place, DATE if unit == DATE else unit_of(unit), scale)
    return out


def refuse_unknown(path: Path, skip: Collection[str], known: Collection[str], what: str) -> None:
    """Raises LogError if a name in `skip` is none of the known names of `what`."""
    if unknown := sorted(set(skip).difference(known)):
        near = closest_name(unknown[0], known)
        hint = f"; did you mean {quoted(near)}?" if near else ""
        has = ", ".join(map(quoted, sorted(known)))[:300] or "none"
        raise LogError(f"{path}: skip: no {what} is called {quoted(unknown[0])}{hint}; expected of {has}. Mend it or take it out")
