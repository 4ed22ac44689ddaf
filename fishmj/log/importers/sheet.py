"""What every reader of a foreign file gives: columns of numbers under the names that the lab chose.

Binary tables are read here: Parquet (extra `logs`) and `.npz` archives of one array a column. What they would unpack to is
measured first.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fishmj.errors import LogError, MissingExtra
from fishmj.log.limits import COLUMNS, DAMAGE, bare, check_size, quoted, regular
from fishmj.log.trial import Table
from fishmj.store import read_npz

DATE = "date"  # the unit of date-time stamps, which readers give as s since 1970
EPOCH = 3e8  # s; stamps that begin beyond (nine years and a half) count from 1970, not from a start


@dataclass(frozen=True)
class Sheet:
    """`columns`: name -> (T,) float64, NaN where a cell holds no number; the file stays as it is."""

    path: Path
    name: str  # of the file, or the topic of a recording
    columns: Table
    units: dict[str, str] = field(default_factory=dict)  # column -> unit, where the file itself says it
    lines: np.ndarray | None = None  # (T,) line of each row, from 1
    text: dict[str, str] = field(default_factory=dict)  # column -> a cell of it that is no number
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def place(self, row: int, column: str) -> str:
        """file:line:column, for messages."""
        line = 1 if row < 0 or row >= len(self) else int(self.lines[row]) if self.lines is not None else row + 2
        return f"{self.where}:{line}:{bare(column)}"

    @property
    def where(self) -> str:
        """The file, and the topic in it."""
        return str(self.path) if self.name == self.path.name else f"{self.path}:{self.name}"

    def noted(self, *notes: str) -> "Sheet":
        return replace(self, notes=(*self.notes, *notes))


def checked(sheet: Sheet) -> Sheet:
    """The sheet, infinite values blanked with a note.

    Raises:
        LogError: no rows, or no column of numbers.
    """
    if not len(sheet):
        raise LogError(f"{sheet.where}: column names but no rows; record it again or remove it")
    notes = []
    for name, values in sheet.columns.items():
        if count := int(np.isinf(values).sum()):
            values[np.isinf(values)] = np.nan
            notes.append(f"{sheet.name}: column {quoted(name)}: {count} infinite or too large number(s) taken for blanks")
    if all(np.isnan(values).all() for values in sheet.columns.values()):
        names = ", ".join(quoted(n) for n in list(sheet.columns)[:6])
        raise LogError(f"{sheet.where}: no number in any column ({names}); is it another kind of file, or another separator?")
    return sheet.noted(*notes)


PARQUET = (".parquet", ".pq")
NPZ = (".npz",)


def read_parquet(path: Path) -> Sheet:
    """Every column of numbers, truth values or time stamps; others (text, lists, records) are noted.

    Raises:
        LogError: damaged, no rows, too many columns, or larger unpacked than the limit. MissingExtra: pyarrow is absent.
    """
    regular(path)
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtra("pyarrow", "logs", "Reading Parquet files") from error
    columns, units, notes = {}, {}, []
    try:
        with pq.ParquetFile(path) as file:
            told = file.metadata
            schema = file.schema_arrow
            if len(schema) > COLUMNS or told.num_columns > COLUMNS:
                raise LogError(f"{path}: {told.num_columns} columns; at most {COLUMNS} are read")
            unpacked = sum(max(told.row_group(i).total_byte_size, 0) for i in range(told.num_row_groups))
            check_size(path, max(unpacked, 8.0 * told.num_rows * max(told.num_columns, 1)), "unpacks to")
            names = [name.strip() for name in schema.names]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise LogError(f"{path}: column {quoted(twice)} appears twice; rename or remove one of them")
            for name, column in zip(names, schema, strict=True):
                kind = column.type
                if not (
                    pa.types.is_integer(kind) or pa.types.is_floating(kind) or _is_stamp(pa, kind) or pa.types.is_boolean(kind)
                ):
                    notes.append(f"{path.name}: column {quoted(name)} holds {quoted(kind)}; left out")
                    continue
                batches = file.iter_batches(columns=[column.name], batch_size=1 << 16)
                parts = [_numbers(pa, batch.column(0)) for batch in batches]
                columns[name] = np.concatenate(parts) if parts else np.zeros(0)
                if _is_stamp(pa, kind):
                    units[name] = DATE
    except LogError:
        raise
    except (pa.ArrowException, *DAMAGE) as error:
        raise LogError(
            f"{path}: damaged or no Parquet file ({type(error).__name__}: {quoted(error, 120)}); write it again"
        ) from error
    if not columns:
        raise LogError(f"{path}: no column of numbers; it has {', '.join(map(quoted, names[:8])) or 'none'}")
    if len({len(values) for values in columns.values()}) > 1:
        raise LogError(f"{path}: its columns differ in length; write it again")
    return checked(Sheet(path, path.name, columns, units, notes=tuple(notes)))


def _is_stamp(pa, kind) -> bool:
    return pa.types.is_timestamp(kind) or pa.types.is_duration(kind)


def _numbers(pa, values) -> np.ndarray:
    """float64 with NaN for null; stamps in s (since 1970)."""
    if _is_stamp(pa, values.type):
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[values.type.unit]
        return np.asarray(values.cast(pa.int64()).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float) * scale
    return np.array(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)


def read_table(path: Path) -> Sheet:
    """An `.npz`: arrays (T,) become columns, (T, K) become name_1..name_K; others are noted.

    Raises:
        StoreError: damaged or pickled. LogError: no columns of one length.
    """
    regular(path)
    read = read_npz(path, widened=True)
    arrays = {name: value for name, value in read.items() if value.dtype.kind in "fiub" and value.ndim in (1, 2)}
    lengths = [len(value) for value in arrays.values() if len(value)]
    rows = max(lengths, key=lengths.count, default=0)
    columns, notes = {}, []
    for name, value in arrays.items():
        if len(value) != rows:
            notes.append(f"{path.name}: array {quoted(name)} has {len(value)} rows, not {rows}; left out")
        elif value.ndim == 1:
            columns[name] = value.astype(float)
        elif value.shape[1] <= COLUMNS:
            columns |= {f"{name}_{k + 1}": value[:, k].astype(float) for k in range(value.shape[1])}
    if not columns or len(columns) > COLUMNS:
        raise LogError(f"{path}: {len(columns) or 'no'} columns of numbers of one length; expected 1 to {COLUMNS}")
    return checked(Sheet(path, path.name, columns, notes=tuple(notes)))
