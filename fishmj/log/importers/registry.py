"""The formats by name, `read`, which detects the format, and `trial_of`, the final checks of every reader."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import plugins
from fishmj.base.errors import FishmjError, LogError, OwnCodeError
from fishmj.base.names import is_name, nearest
from fishmj.log.trial import Table, Trial
from fishmj.log.trial_check import Implausible, Place, bounds_of, check_counts, check_table
from fishmj.log.unread_rows import UNREAD, left_out


@dataclass(frozen=True)
class Importer:
    """A format: a module with `sniff(path) -> bool`, cheap, never raising on foreign bytes, and `read(path) -> {name: Trial}`.

    A new format is one such file and one row below. topics: `read` takes a topic mapping and what is left out, too.
    """

    name: str
    about: str
    module: str
    topics: bool = False

    @property
    def sniff(self) -> Callable[[Path], bool]:
        """The module's `sniff(path) -> bool`."""
        return import_module(self.module).sniff

    @property
    def read(self) -> Callable[..., dict[str, Trial]]:
        """The module's `read(path) -> {name: Trial}`."""
        return import_module(self.module).read


_HERE, _STUDIES = "fishmj.log.importers", "fishmj.log.published_logs"
FORMATS: dict[str, Importer] = {
    importer.name: importer
    for importer in (
        Importer("mcap", "MCAP recording, JSON or ROS 2 messages (extra: logs)", f"{_HERE}.mcap", topics=True),
        Importer("rosbag2", "ROS 2 bag, SQLite or MCAP (extra: logs)", f"{_HERE}.rosbag2", topics=True),
        Importer("servo_xl330", "XL330 servo on a pendulum, JSON of Rhoban's bam", f"{_STUDIES}.servo_xl330"),
        Importer("tail_fish", "tail-actuated fish of Mamakoukas et al., STATES*.txt", f"{_STUDIES}.tail_fish"),
        Importer("tendon_fish_markers", "marker tracks of the tendon-driven fish", f"{_STUDIES}.tendon_fish_markers"),
        Importer("usv_coastdown", "twin-hull boat, semicolon rows", f"{_STUDIES}.usv_coastdown"),
        Importer("flat_csv", "our flat samples.csv on a common clock", f"{_HERE}.flat_csv"),
    )
}
PUBLISHED = tuple(
    name for name, importer in FORMATS.items() if importer.module.startswith(_STUDIES)
)  # one laboratory's layout each


def published(path: Path) -> str:
    """Name of the published data set whose layout a file or folder has; "" for none, so that it is read by its columns."""
    try:
        return next((name for name in PUBLISHED if FORMATS[name].sniff(path)), "")
    except OSError:
        return ""


def each(path: Path, name: str) -> tuple[dict[str, Trial], dict[str, str]]:
    """Trials of a folder in one format, its files read one by one, and the errors of the others."""
    trials: dict[str, Trial] = {}
    bad: dict[str, str] = {}
    for file in sorted(p for p in path.rglob("*") if p.is_file() and not p.name.startswith(".")):
        try:
            if FORMATS[name].sniff(file):
                trials = FORMATS[name].read(file) | trials  # the first of two files of one trial stays
        except FishmjError as error:
            bad[str(file)] = str(error)
    return trials, bad


def sniff(path: str | Path) -> str:
    """The name of the format that `path` is in.

    Raises LogError: there is no such file or folder, or no format fits; the formats are listed.
    """
    path = Path(path)
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    for name, importer in FORMATS.items():
        try:
            if importer.sniff(path):
                return name
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    text = "; ".join(f"{name}: {importer.about}" for name, importer in FORMATS.items())
    raise LogError(f"{path}: none of the known formats ({text}). Say which with --format, or write a trial folder")


Advised = Callable[[str, Implausible], str]  # (table, doubt) -> one line
Format = str | Callable[[Path], "dict[str, Trial] | Trial"] | None


def read(
    path: str | Path, format: Format = None, *, topics: str | Path | None = None, skip: Collection[str] = ()
) -> dict[str, Trial]:
    """Trials by name from a file or folder in a foreign format.

    Args:
        format: one of `FORMATS`; the user's own reader, `function(path)` or, as typed, module:function, file.py:function or an
            entry point of fishmj.importers (docs/simulate/your_own_code.md); detected if None.
        topics: for "mcap" and "rosbag2": the TOML that maps topics to tables.
        skip: for these: topics to leave out, and fields that tell robots apart and are ignored.

    Raises:
        LogError: nothing there, unknown format, or a breach of it at file:line:column with the fix.
        MissingExtra: the format needs a package that is not installed.
    """
    path = Path(path)
    if callable(format) or (format is not None and format not in FORMATS):
        return _own(path, format, topics or skip)
    name = format or sniff(path)
    if (topics or skip) and not FORMATS[name].topics:
        raise LogError(f"{path}: a topic mapping or skip is for MCAP and rosbag2 recordings only, this is {name}; leave it out")
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    trials = FORMATS[name].read(path, topics, skip) if FORMATS[name].topics else FORMATS[name].read(path)
    if not trials:
        raise LogError(f"{path}: nothing in format {name} ({FORMATS[name].about}) found there")
    return trials


def _own(path: Path, format: Any, topics) -> dict[str, Trial]:
    """Trials from the user's own reader."""
    what = f"importer {format if isinstance(format, str) else getattr(format, '__name__', format)}"
    reader = plugins.load("importer", format, FORMATS) if isinstance(format, str) else format
    plugins.takes(what, reader, "read(path)", 1)
    if topics:
        raise LogError(f"{path}: a topic mapping or skip is for MCAP and rosbag2 recordings only; leave it out")
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    found = plugins.call(f"{what} on {path}", reader, path)
    trials = {nearest(path.stem) or "trial": found} if isinstance(found, Trial) else found
    if not isinstance(trials, dict) or not trials:
        raise OwnCodeError(
            f"{what}: gave {type(found).__name__} for {path}; expected a Trial, or a dict of name -> Trial with one at least"
        )
    checked = {}
    for name, trial in trials.items():
        if not (is_name(name) and isinstance(trial, Trial)):
            raise OwnCodeError(
                f"{what}: gave {name!r}: {type(trial).__name__}; expected names of letters, digits, '_', '.', '-', and Trials"
            )
        tables = {key: (columns, _place(f"{path}: {name}", key)) for key, columns in trial.tables.items()}
        checked[name] = trial_of(name, trial.meta, tables, trial.notes)
    return checked


def _place(where: str, table: str) -> Callable[[int, str], str]:
    return lambda row, column: f"{where}: table {table} row {row}: {column}"


def trial_of(
    name: str, meta: dict, tables: Mapping[str, tuple[Table, Place]], notes: Sequence[str] = (), advised: Advised | None = None
) -> Trial:
    """Checks every table and makes a trial of them; `meta` gets `origin = "measured"` unless it has another.

    Args:
        advised: advice for an implausible value of a table whose source columns can be corrected.

    Raises LogError: a table breaks the schema; the message begins with the place in the source file.
    """
    found, bounds, tables = list(notes), bounds_of(meta, name), dict(tables)
    for table in (table for table in UNREAD if table in tables):
        bad, told = left_out(table, tables[table][0], bounds)
        tables[table], found = (_kept(*tables[table], ~bad) if told else tables[table]), [*found, *told]
    for table, (columns, place) in tables.items():
        try:
            found += check_table(table, columns, place, bounds)
        except Implausible as doubt:
            raise doubt if advised is None else LogError(advised(table, doubt)) from doubt
    kept = {table: columns for table, (columns, _) in tables.items()}
    return Trial({"origin": "measured", **meta}, kept, name=name, notes=tuple([*found, *check_counts(kept, meta)]))


def _kept(columns: Table, place: Place, rows: np.ndarray) -> tuple[Table, Place]:
    """Selected rows of a table, with their places in the source."""
    at = np.flatnonzero(rows)
    return {name: values[rows] for name, values in columns.items()}, lambda row, column: place(int(at[row]), column)


def renamed(place: Place, names: Mapping[str, str]) -> Place:
    """Place function for the schema's column names: schema column -> column of the source."""
    return lambda row, column: place(row, names.get(column, column))
