"""Tables on disk.

CSV     UTF-8, comma between columns, point in numbers, one header row; every error names line and column
.npz    each column in the smallest float type that keeps its signal
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fishmj.base.calib import parse_toml
from fishmj.base.errors import ConfigError, LogError
from fishmj.base.store import read_npz, write_npz, write_text
from fishmj.log.limits import quoted, regular
from fishmj.log.trial import Table

HALF_ERROR = 1e-3  # largest float16 rounding error, relative to the column's standard deviation
SINGLE_ERROR = 1e-6
_MARKS = {b"\xef\xbb\xbf": "UTF-8", b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)


def read_text(path: Path) -> str:
    """Text of the file. Raises LogError for a pipe, a byte order mark, another encoding, or an empty file."""
    regular(path, empty=True)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not raw.strip():
        raise LogError(f"{path}:1:1: the file is empty; record it again or remove it (any table may be missing)")
    for mark, encoding in _MARKS.items():
        if raw.startswith(mark):
            raise LogError(f"{path}:1:1: starts with a byte order mark ({encoding}); save it as plain UTF-8 without BOM")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise LogError(
            f"{path}:{line}:{column}: byte 0x{raw[error.start]:02x} is not UTF-8; save the file as plain UTF-8"
        ) from error


def read_toml(path: Path) -> dict:
    """Values of a TOML file. Raises LogError: at file:line:column, no text or no TOML."""
    text = read_text(path)
    try:
        return parse_toml(text, str(path))
    except ConfigError as error:
        message = str(error).removeprefix(f"{path}: ")
        found = re.search(r"\(at line (\d+), column (\d+)\)", message) or re.search(r"(?:^|TOML: )line (\d+)()", message)
        at = f":{found[1]}:{found[2] or 1}" if found else ":1:1"
        fix = "; text needs quotes, numbers a decimal point" if message.startswith("not valid TOML") else ""
        raise LogError(f"{path}{at}: {message}{fix}") from error


def read_csv(path: Path) -> tuple[Table, Callable[[int, str], str]]:
    """Columns as float64 arrays, and a function from (row, column) to file:line:column for later checks.

    Raises LogError: at file:line:column, with the fix.
    """
    lines = read_text(path).split("\n")
    header_line = next(i for i, line in enumerate(lines) if line.strip())
    _check_separator(path, header_line, lines[header_line])
    names = [name.strip().strip('"') for name in lines[header_line].split(",")]
    for k, name in enumerate(names):
        where = f"{path}:{header_line + 1}:{_character(lines[header_line], k)}"
        if not name:
            raise LogError(f"{where}: column {k + 1} has no name; the first row must name every column")
        if name in names[:k]:
            raise LogError(f"{where}: column {quoted(name)} appears twice; remove one of them")
    if all(NUMBER.fullmatch(name) for name in names):
        raise LogError(
            f"{path}:{header_line + 1}:1: the first row holds numbers; write the column names there, such as t,j1,j2,j3"
        )
    numbers, rows = [i for i in range(header_line + 1, len(lines)) if lines[i].strip()], []
    for i in numbers:
        rows.append(_row(path, i, lines[i], names))

    def place(row: int, column: str) -> str:
        line = numbers[row] if 0 <= row < len(numbers) else header_line
        field = names.index(column) if column in names else 0
        return f"{path}:{line + 1}:{_character(lines[line], field)}"

    values = np.array(rows, dtype=float).reshape(len(rows), len(names))
    return {name: values[:, k].copy() for k, name in enumerate(names)}, place


def write_csv(path: Path, table: Table) -> None:
    """Writes one header row and the shortest decimals that read back to the same float64."""
    columns = [[_decimal(v) for v in np.asarray(values).tolist()] for values in table.values()]
    lines = [",".join(table), *(",".join(row) for row in zip(*columns, strict=True))]
    write_text(path, "\n".join(lines) + "\n")


def _decimal(value) -> str:
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def _character(line: str, field: int) -> int:
    """1-based character at which comma-separated field number `field` starts."""
    return sum(len(part) + 1 for part in line.split(",")[:field]) + 1


def _check_separator(path: Path, line: int, header: str) -> None:
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header:
            raise LogError(
                f"{path}:{line + 1}:{header.index(mark) + 1}: columns are separated by {word} (as spreadsheets with "
                "decimal commas do); save with commas between columns and points in numbers"
            )


def _row(path: Path, i: int, line: str, names: list[str]) -> list[float]:
    fields = line.split(",")
    if len(fields) != len(names):
        hint = "decimal commas? Write 0.02, not 0,02" if len(fields) > len(names) else "is the row cut off? Remove or complete it"
        at = _character(line, min(len(fields), len(names)))
        raise LogError(f"{path}:{i + 1}:{min(at, len(line) + 1)}: {len(fields)} values in a row of {len(names)} columns; {hint}")
    out = []
    for k, text in enumerate(fields):
        text = text.strip().strip('"')
        if not NUMBER.fullmatch(text):
            what = "is blank" if not text else f"{text[:30]!r} is not a number"
            raise LogError(
                f"{path}:{i + 1}:{_character(line, k)}: column {quoted(names[k])} {what}; write a plain decimal number, "
                "or leave the row or the column out"
            )
        out.append(float(text))
    return out


def row_place(label) -> Callable[[int, str], str]:
    """(row, column) -> label:row:column, rows counted from 1 below the header, as a CSV of the same table would."""
    return lambda row, column: f"{label}:{row + 2 if row >= 0 else 1}:{column or 1}"


def read_archive(path: Path) -> tuple[Table, Callable[[int, str], str]]:
    """Columns as float64 arrays, whatever their stored type."""
    place, table = row_place(path), {}
    for name, values in read_npz(path, widened=True).items():
        if values.dtype.kind not in "fiub":
            raise LogError(f"{place(-1, name)}: column {name!r} has dtype {values.dtype}; expected numbers")
        table[name] = values.astype(float)
    return table, place


def write_archive(path: Path, table: Table, precision: str = "auto") -> None:
    """Writes time stamps as float64 and other columns by `narrow`, or all as `precision` ("float32", "float64")."""
    kinds = {"auto": narrow, "float32": lambda v: v.astype(np.float32), "float64": lambda v: v.astype(float)}
    if precision not in kinds:
        raise LogError(f"precision = {precision!r}; expected one of {', '.join(kinds)}")
    kept = {name: values.astype(float) for name, values in table.items() if name in ("t", "t_rx")}
    write_npz(path, {name: kept[name] if name in kept else kinds[precision](values) for name, values in table.items()})


def narrow(values: np.ndarray) -> np.ndarray:
    """float16 if its largest rounding error is below 0.1 % of the standard deviation, else float32, else float64.

    The measure is the deviation and not the value: an offset (a fish 50 m down the tank) must not hide the signal.
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
