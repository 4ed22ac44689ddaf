"""Readers of binary tables: Parquet (extra `logs`), and `.npz` archives or tensors of one array a column.

Their unpacked size is checked first.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.base.store import read_npz
from fishmj.log.importers import table_forms
from fishmj.log.importers.column_units import UNITS
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.importers.torch_tensors import read_tensors
from fishmj.log.limits import COLUMNS, DAMAGE, check_size, listed, quoted, regular
from fishmj.log.trial import Table

PARQUET = (".parquet", ".pq")
NPZ = (".npz",)
TORCH = (".pt", ".pth")


def read_parquet(path: Path) -> list[Sheet]:
    """Reads the columns of numbers, truth values, time stamps, or lists of numbers of one length; other columns are noted.

    A list becomes a column for each of its elements, named as in the meta/info.json of a LeRobot data set. A file with a column
    `episode_index` becomes a sheet for each episode.

    Raises LogError: damaged, no rows, too many columns, or larger unpacked than the limit. MissingExtra: pyarrow is absent.
    """
    regular(path)
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns, units, notes, texts = {}, {}, [], {}
    try:
        with pq.ParquetFile(path) as file:
            metadata = file.metadata
            schema = file.schema_arrow
            if len(schema) > COLUMNS or metadata.num_columns > COLUMNS:
                raise LogError(f"{path}: {metadata.num_columns} columns; at most {COLUMNS} are read")
            unpacked = sum(max(metadata.row_group(i).total_byte_size, 0) for i in range(metadata.num_row_groups))
            check_size(path, max(unpacked, 8.0 * metadata.num_rows * max(metadata.num_columns, 1)), "unpacks to")
            names = [name.strip() for name in schema.names]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise LogError(f"{path}: column {quoted(twice)} appears twice; rename or remove one of them")
            for name, column in zip(names, schema, strict=True):
                kind = column.type
                if _is_list(pa, kind):
                    batches = file.iter_batches(columns=[column.name], batch_size=1 << 16)
                    matrix = _matrix(pa, path, name, [batch.column(0) for batch in batches])
                    elements = _element_names(path, name, matrix.shape[1])
                    columns |= {element: matrix[:, k].copy() for k, element in enumerate(elements)}
                    notes.append(f"{path.name}: list column {quoted(name)} read as {listed(elements)}")
                    continue
                if not (
                    pa.types.is_integer(kind) or pa.types.is_floating(kind) or _is_stamp(pa, kind) or pa.types.is_boolean(kind)
                ):
                    if table_forms.may_tell_apart(name) and len(told := _texts(pa, file, column)):
                        texts[name], columns[name] = told, np.full(len(told), np.nan)
                    else:
                        notes.append(f"{path.name}: column {quoted(name)} holds {quoted(kind)}; left out")
                    continue
                batches = file.iter_batches(columns=[column.name], batch_size=1 << 16)
                parts = [_numbers(pa, batch.column(0)) for batch in batches]
                columns[name] = np.concatenate(parts) if parts else np.zeros(0)
                if _is_stamp(pa, kind):
                    units[name] = DATE if pa.types.is_timestamp(kind) else "s"
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
    shown = {name: next(filter(None, told), "") for name, told in texts.items()}
    return _episodes(checked(Sheet(path, path.name, columns, units, text=shown, notes=tuple(notes))), texts)


def _episodes(sheet: Sheet, texts: dict[str, np.ndarray]) -> list[Sheet]:
    """The sheet, or one for each number in its column of episodes, with what its columns of text (T,) tell apart."""
    apart = lambda rows: table_forms.told_apart({column: told[rows] for column, told in texts.items()})
    number = sheet.columns.get("episode_index")
    if number is None or not np.isfinite(number).all():
        return [replace(sheet, apart=apart(slice(None)))]
    out, episodes = [], np.unique(number)
    if len(episodes) > COLUMNS:
        raise LogError(f"{sheet.where}: {len(episodes)} episodes; at most {COLUMNS} are read from one file")
    for episode in episodes:
        rows = number == episode
        columns = {name: values[rows] for name, values in sheet.columns.items() if name != "episode_index"}
        out.append(replace(sheet, columns=columns, apart=apart(rows), episode=int(episode)))
    return out


def _is_list(pa, kind) -> bool:
    """Returns True for lists of numbers."""
    if not (pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind)):
        return False
    return pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type)


def _texts(pa, file, column) -> np.ndarray:
    """Texts (T,) of a column, "" for a blank; none of values that are no texts."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return np.zeros(0, object)
    batches = file.iter_batches(columns=[column.name], batch_size=1 << 16)
    return np.array([sys.intern((text or "").strip()) for batch in batches for text in batch.column(0).to_pylist()], object)


def _matrix(pa, path: Path, name: str, batches: list) -> np.ndarray:
    """Lists of one length (T, K), NaN for null. Raises LogError: the lists differ in length, or one is absent."""
    from pyarrow import compute

    told = [compute.fill_null(compute.list_value_length(batch), 0) for batch in batches]
    lengths = {int(length) for part in told for length in compute.unique(part).to_pylist()}
    if len(lengths) != 1 or not 0 < min(lengths) <= COLUMNS:
        span = f"{min(lengths, default=0)} to {max(lengths, default=0)}"
        raise LogError(f"{path}: column {quoted(name)} holds lists of {span} numbers; expected one length, up to {COLUMNS}")
    return np.concatenate([_numbers(pa, batch.flatten()) for batch in batches]).reshape(-1, min(lengths))


def _element_names(path: Path, column: str, count: int) -> list[str]:
    """Names of the elements of a list column: `action.tail` by the data set's meta/info.json, else `action.1`, .."""
    for folder in path.resolve().parents[:4]:
        info = folder / "meta" / "info.json"
        if info.is_file() and info.stat().st_size < 1 << 20:
            names = _names_in(info, column)
            if len(names) == count == len(set(names)):
                return [f"{column}.{name}" for name in names]
            break
    return [f"{column}.{k + 1}" for k in range(count)]


def _names_in(info: Path, column: str) -> list[str]:
    """Names in info.json for the elements of a feature; empty without any."""
    try:
        names = json.loads(info.read_text("utf-8"))["features"][column]["names"]
    except (*DAMAGE, RecursionError):
        return []
    while isinstance(names, dict):  # {"motors": [...]}
        names = next(iter(names.values()), [])
    return [str(name)[:80] for name in names] if isinstance(names, list) else []


def _is_stamp(pa, kind) -> bool:
    return pa.types.is_timestamp(kind) or pa.types.is_duration(kind)


def _numbers(pa, values) -> np.ndarray:
    """float64 with NaN for null; stamps in s (since 1970)."""
    if _is_stamp(pa, values.type):
        stamps = values.cast(pa.int64()).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.asarray(stamps, float) * UNITS[values.type.unit][1]
    return np.array(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)


def read_tables(path: Path) -> list[Sheet]:
    """Reads an `.npz`, or tensors of `torch.save`, as a sheet for each length of its arrays.

    Arrays (T,), (T, 1) and (1, T) become columns, (T, K) and (K, T) become name_1..name_K, dates and durations s; texts tell
    robots or trials apart; others are noted.

    Raises StoreError: damaged or pickled; LogError: no columns.
    """
    regular(path)
    read = read_tensors(path) if path.suffix.lower() in TORCH else read_npz(path, widened=True)
    found: dict[int, Table] = {}
    texts: dict[str, np.ndarray] = {}
    notes, units = [], {}
    longest = max((max(value.shape, default=0) for value in read.values()), default=0)
    columnar = lambda value: value.ndim == 2 and 1 in value.shape and value.size == longest  # as MATLAB saves a vector
    read = {name: value.ravel() if columnar(value) else value for name, value in read.items()}
    lengths = {len(value) for value in read.values() if value.ndim == 1}
    for name, value in read.items():
        if value.ndim == 2 and len(value) not in lengths and value.shape[1] in lengths:
            value = value.T
        if value.dtype.kind in "mM":
            units[name] = DATE if value.dtype.kind == "M" else "s"
            value = np.where(np.isnat(value), np.nan, value.astype(f"{value.dtype.kind}8[ns]").astype("int64") * 1e-9)
        if value.dtype.kind in "US" and value.ndim and value.size == len(value) > 1 and table_forms.may_tell_apart(name):
            texts[name] = (value if value.dtype.kind == "U" else np.char.decode(value, errors="replace")).ravel()
        elif value.dtype.kind not in "fiub" or value.ndim not in (1, 2) or len(value) < 2 or value.size > COLUMNS * len(value):
            notes.append(f"{path.name}: array {quoted(name)} of {value.dtype} {value.shape} is no column; left out")
        elif value.ndim == 1:
            found.setdefault(len(value), {})[name] = value.astype(float)
        else:
            columns = {f"{name}_{k + 1}": value[:, k].astype(float) for k in range(value.shape[1])}
            found[len(value)] = found.get(len(value), {}) | columns
    if not found or max(map(len, found.values())) > COLUMNS:
        raise LogError(
            f"{path}: {'more than' if found else 'no columns of numbers; expected 1 to'} {COLUMNS} columns of one length"
        )
    names = [path.name if len(found) == 1 else f"{path.name}, {rows} rows" for rows in found]
    sheets = []
    for name, (rows, columns) in zip(names, found.items(), strict=True):
        told = {c: text.tolist() for c, text in texts.items() if len(text) == rows}
        shown, apart = {c: text[0] for c, text in told.items()}, table_forms.told_apart(told)
        whole, own = columns | {c: np.full(rows, np.nan) for c in told}, {c: unit for c, unit in units.items() if c in columns}
        sheets.append(checked(Sheet(path, name, whole, own, text=shown, apart=apart)))
    return [sheets[0].noted(*notes), *sheets[1:]]
