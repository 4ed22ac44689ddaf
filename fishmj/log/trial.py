"""One trial in memory: a dictionary of meta data and event tables, each with its own time stamps."""

import re
from dataclasses import dataclass, field, replace

import numpy as np

from fishmj.errors import ConfigError, LogError
from fishmj.log.table_schema import GAP, look_up, table_spec

Table = dict[str, np.ndarray]  # column name -> (T,) values; "t" is always there


@dataclass(frozen=True)
class Trial:
    """What a simulator, the evaluator or the robot recorded. `notes` are the reader's remarks, one sentence each."""

    meta: dict
    tables: dict[str, Table]
    name: str = ""
    notes: tuple[str, ...] = field(default=())

    def value(self, key: str, default=None):
        """Meta value behind a dotted key: `trial.value("flow.speed")`."""
        return look_up(self.meta, key, default)

    def table(self, name: str) -> Table:
        """Table `name`, or one error that says which tables there are."""
        table_spec(name)
        if name not in self.tables:
            raise LogError(
                f"trial {self.name or '(in memory)'}: no table {name!r}; it has {', '.join(sorted(self.tables)) or 'none'}"
            )
        return self.tables[name]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time stamp over all tables, s."""
        times = [table["t"] for table in self.tables.values() if len(table["t"])]
        if not times:
            raise LogError(f"trial {self.name or '(in memory)'}: no table has a row")
        return float(min(t[0] for t in times)), float(max(t[-1] for t in times))


def numbered(template: str, values) -> Table:
    """Spread `(T, N)` values over columns: `numbered("j#", q)` -> {"j1": (T,), .., "jN": (T,)}."""
    values = np.asarray(values)
    if values.ndim != 2 or template.count("#") != 1:
        raise ConfigError(f"numbered({template!r}): expected (T, N) values and one '#', got shape {values.shape}")
    return {template.replace("#", str(i + 1)): values[:, i] for i in range(values.shape[1])}


def stacked(table: Table, template: str) -> np.ndarray:
    """The inverse of `numbered`: columns j1..jN as one `(T, N)` float64 array; N = 0 when there are none."""
    pattern = re.compile(re.escape(template).replace(r"\#", r"([1-9]\d*)") + r"\Z")
    count = sum(bool(pattern.match(column)) for column in table)
    columns = [np.asarray(table[template.replace("#", str(i + 1))], float) for i in range(count)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(table["t"]), 0))


def gaps(t: np.ndarray, limit: float = GAP) -> np.ndarray:
    """Rows after which the table pauses: longer than `limit` [s] and than 1.5 median steps (slow cameras are no gaps)."""
    step = np.diff(np.asarray(t, float))
    return np.flatnonzero(step > max(limit, 1.5 * float(np.median(step)) if len(step) else 0.0))


def segments(trial: Trial, limit: float = GAP, tables: tuple[str, ...] | None = None) -> list[Trial]:
    """Cut a trial where a continuous table (cmd, joint, pose, truth; or `tables`) pauses for more than `limit` s.

    Each part holds the rows of all tables inside one stretch without a pause; target rows are carried over, since a
    target holds until the next one. A trial without a pause comes back as it is.
    """
    watched = [n for n in trial.tables if (tables is None and table_spec(n).continuous) or n in (tables or ())]
    cuts = []
    for name in watched:
        t = trial.tables[name]["t"]
        cuts += [(float(t[i]), float(t[i + 1])) for i in gaps(t, limit)]
    if not cuts:
        return [trial]
    parts, start = [], -np.inf
    for pause, resume in [*_merged(cuts), (np.inf, np.inf)]:
        rows = {name: _between(name, table, start, pause) for name, table in trial.tables.items()}
        rows = {name: table for name, table in rows.items() if len(table["t"])}
        if any(name in rows for name in watched):
            name = f"{trial.name}.{len(parts) + 1}" if trial.name else ""
            parts.append(replace(trial, tables=rows, name=name))
        start = resume
    return parts


def _merged(cuts: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Overlapping pauses joined, in order of time."""
    out: list[tuple[float, float]] = []
    for pause, resume in sorted(cuts):
        if out and pause < out[-1][1]:
            out[-1] = (out[-1][0], max(out[-1][1], resume))
        else:
            out.append((pause, resume))
    return out


def _between(name: str, table: Table, start: float, end: float) -> Table:
    t = table["t"]
    keep = (t >= start) & (t <= end)
    if name == "target":  # the last target set before the stretch still holds in it
        before = np.flatnonzero(t < start)
        keep[before[-1:]] = True
    return {column: values[keep] for column, values in table.items()}
