"""From columns to a checked trial: the schema's own checks, with places in the foreign file."""

from collections.abc import Callable, Mapping

import numpy as np

from fishmj.log import check
from fishmj.log.plausible import of_meta
from fishmj.log.trial import Table, Trial

Place = Callable[[int, str], str]


def trial_of(name: str, meta: dict, tables: Mapping[str, tuple[Table, Place]], notes: tuple[str, ...] | list[str] = ()) -> Trial:
    """Check every table and put them together; `meta` gets `origin = "measured"` unless it says otherwise.

    Raises:
        LogError: a table breaks the schema; the message begins with the place in the source file.
    """
    found, bounds = list(notes), of_meta(meta, name)
    for table, (columns, place) in tables.items():
        found += check.check_table(table, columns, place, bounds)
    kept = {table: columns for table, (columns, _) in tables.items()}
    return Trial({"origin": "measured", **meta}, kept, name=name, notes=tuple([*found, *check.check_counts(kept)]))


def renamed(place: Place, names: Mapping[str, str]) -> Place:
    """A place function that knows the schema's column names: schema column -> column of the source."""
    return lambda row, column: place(row, names.get(column, column))


def jumps(values: np.ndarray, limit: float) -> int:
    """How many steps between neighbouring rows are larger than `limit`."""
    return int(np.sum(np.abs(np.diff(values)) > limit))
