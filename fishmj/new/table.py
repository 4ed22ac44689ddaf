"""An outline from a table of sections: a CSV file with the columns x, height and width, from nose to tail."""

import csv
import math
import re
from pathlib import Path

import numpy as np

from fishmj.errors import ConfigError
from fishmj.names import nearest
from fishmj.new.quantity import KINDS
from fishmj.new.shape import Outline, root_of_fin

COLUMNS = ("x", "height", "width")
LARGEST = 1_000_000  # bytes
ROWS = (3, 500)
SIZE = (0.02, 10.0)  # m, of the whole fish
THINNEST = 1e-5  # m, of a section
UNITS = KINDS["length"].units


def read_sections(path: Path, unit: str | None = None) -> Outline:
    """The outline in a CSV file.

    Args:
        unit: of all columns, m, cm, mm or in; where the header does not say (`x [mm]`, `x_mm`, `x (mm)`). Metres by default.

    Raises:
        ConfigError: with file and line: not a table, a column is missing, a cell is no number, x does not rise from 0, a
            section is not positive, the fish is implausibly small or large.
    """
    text = _text(path)
    first = text.splitlines()[0] if text.strip() else ""
    split = max(",;\t", key=first.count)
    try:
        lines = [row for row in csv.reader(text.splitlines(), delimiter=split, strict=True)]
    except csv.Error as error:
        raise ConfigError(f"{path}: not a CSV table: {error}; expected the columns {', '.join(COLUMNS)}") from error
    columns = _columns(path, lines[0] if lines else [], unit)
    rows = np.array([_row(path, n, row, columns) for n, row in enumerate(lines[1:], 2) if any(cell.strip() for cell in row)])
    if not ROWS[0] <= len(rows) <= ROWS[1]:
        raise ConfigError(f"{path}: {len(rows)} rows of sections; expected {ROWS[0]} to {ROWS[1]} below the header")
    x = rows[:, 0]
    if x[0] != 0 or (np.diff(x) <= 0).any():
        bad = 2 if x[0] != 0 else 3 + int(np.flatnonzero(np.diff(x) <= 0)[0])
        raise ConfigError(f"{path}:{bad}: x = {x[bad - 2]:g} m: x must begin with 0, the nose, and rise towards the tail")
    if not SIZE[0] <= x[-1] <= SIZE[1]:
        raise ConfigError(
            f"{path}: the last x is {x[-1]:g} m; expected a fish of {SIZE[0]:g} to {SIZE[1]:g} m: name the unit, --unit mm"
        )
    if rows[:, 1:].max() > x[-1]:
        raise ConfigError(
            f"{path}: a section of {rows[:, 1:].max():g} m in a fish of {x[-1]:g} m; are all columns in the same unit?"
        )
    return Outline(rows, root_of_fin(x, rows[:, 1]), f"table of sections {nearest(path.name)}")


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST:
            raise ConfigError(f"{path}: {path.stat().st_size} bytes; a table of sections has at most {LARGEST}")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a text file ({error.reason} at byte {error.start}); expected a CSV table") from error


def _columns(path: Path, header: list[str], unit: str | None) -> list[tuple[int, float, str]]:
    """(index in the row, factor to m, name) of x, height, width."""
    found = {}
    for i, cell in enumerate(header):
        parts = re.split(r"[\s\[\]()_/]+", cell.strip().lower())
        if parts[0] in COLUMNS:
            said = next((p for p in parts[1:] if p), unit or "m")
            if said not in UNITS:
                raise ConfigError(f"{path}:1: column {cell.strip()!r}: unit {said!r} is not one of {', '.join(UNITS)}")
            found[parts[0]] = (i, UNITS[said], parts[0])
    missing = [name for name in COLUMNS if name not in found]
    if missing:
        shown = ", ".join(cell.strip() for cell in header)[:80]
        raise ConfigError(f"{path}:1: no column {', '.join(missing)}; got {shown!r}, expected a first line x,height,width")
    return [found[name] for name in COLUMNS]


def _row(path: Path, line: int, row: list[str], columns: list[tuple[int, float, str]]) -> list[float]:
    values = []
    for i, factor, name in columns:
        cell = row[i].strip() if i < len(row) else ""
        try:
            value = float(cell) * factor
        except ValueError:
            value = math.nan
        least = 0.0 if name == "x" else THINNEST
        if not math.isfinite(value) or value < least:
            raise ConfigError(f"{path}:{line}: {name} = {cell[:40]!r}; expected a number of {least:g} m or more")
        values.append(value)
    return values
