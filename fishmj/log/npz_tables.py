"""Binary tables: `.npz`, each column in the smallest float type that keeps its signal."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fishmj.errors import LogError
from fishmj.log.trial import Table
from fishmj.store import read_npz, write_npz

HALF_ERROR = 1e-3  # largest float16 rounding error, relative to the column's standard deviation
SINGLE_ERROR = 1e-6


def row_place(label) -> Callable[[int, str], str]:
    """(row, column) -> label:row:column, rows counted from 1 below the header, as a CSV of the same table would."""
    return lambda row, column: f"{label}:{row + 2 if row >= 0 else 1}:{column or 1}"


def read_archive(path: Path) -> tuple[Table, Callable[[int, str], str]]:
    """Columns as float64 arrays (whatever they were stored as)."""
    place, table = row_place(path), {}
    for name, values in read_npz(path, widened=True).items():
        if values.dtype.kind not in "fiub":
            raise LogError(f"{place(-1, name)}: column {name!r} has dtype {values.dtype}; expected numbers")
        table[name] = values.astype(float)
    return table, place


def write_archive(path: Path, table: Table, precision: str = "auto") -> None:
    """Time stamps stay float64; other columns are stored by `narrow`, or all as `precision` ("float32", "float64")."""
    kinds = {"auto": narrow, "float32": lambda v: v.astype(np.float32), "float64": lambda v: v.astype(float)}
    if precision not in kinds:
        raise LogError(f"precision = {precision!r}; expected one of {', '.join(kinds)}")
    kept = {name: values.astype(float) for name, values in table.items() if name in ("t", "t_rx")}
    write_npz(path, {name: kept[name] if name in kept else kinds[precision](values) for name, values in table.items()})


def narrow(values: np.ndarray) -> np.ndarray:
    """float16 where its largest rounding error is below 0.1 % of the standard deviation, else float32, else float64.

    The deviation and not the value is the yardstick: an offset (a fish 50 m down the tank) must not hide the signal.
    """
    values = np.asarray(values, dtype=float)
    with np.errstate(over="ignore"):
        spread = float(np.std(values))
    for kind, allowed in ((np.float16, HALF_ERROR * spread), (np.float32, max(SINGLE_ERROR, HALF_ERROR * spread))):
        if np.max(np.abs(values)) > np.finfo(kind).max:
            continue
        short = values.astype(kind)
        if np.max(np.abs(short.astype(float) - values)) <= allowed:
            return short
    return values
