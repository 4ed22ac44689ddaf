"""From columns to a checked trial: the schema's own checks, with places in the foreign file."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fishmj.errors import LogError
from fishmj.log import trial_check
from fishmj.log.plausible import of_meta
from fishmj.log.trial import Table, Trial

Place = Callable[[int, str], str]
Advised = Callable[[str, trial_check.Implausible], str]  # (table, doubt) -> one line


def trial_of(
    name: str, meta: dict, tables: Mapping[str, tuple[Table, Place]], notes: Sequence[str] = (), advised: Advised | None = None
) -> Trial:
    """Check every table and put them together; `meta` gets `origin = "measured"` unless it says otherwise.

    Args:
        advised: what to say of a table's implausible value where the source's own columns can be mended.
    Raises:
        LogError: a table breaks the schema; the message begins with the place in the source file.
    """
    found, bounds = list(notes), of_meta(meta, name)
    for table, (columns, place) in tables.items():
        try:
            found += trial_check.check_table(table, columns, place, bounds)
        except trial_check.Implausible as doubt:
            raise doubt if advised is None else LogError(advised(table, doubt)) from doubt
    kept = {table: columns for table, (columns, _) in tables.items()}
    return Trial({"origin": "measured", **meta}, kept, name=name, notes=tuple([*found, *trial_check.check_counts(kept)]))


def renamed(place: Place, names: Mapping[str, str]) -> Place:
    """A place function that knows the schema's column names: schema column -> column of the source."""
    return lambda row, column: place(row, names.get(column, column))


def jumps(values: np.ndarray, limit: float) -> int:
    """How many steps between neighbouring rows are larger than `limit`."""
    return int(np.sum(np.abs(np.diff(values)) > limit))
