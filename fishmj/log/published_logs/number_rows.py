"""Rows of numbers without a header, as printed by other programs; every error names file, line and column."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.convert import STRAY, strays
from fishmj.log.table_files import NUMBER, read_text


@dataclass(frozen=True)
class NumberRows:
    """`values` (T, K) float64 and their places: `lines` (T,) 1-based, `starts[row][k]` 1-based character."""

    path: Path
    names: tuple[str, ...]
    values: np.ndarray
    lines: tuple[int, ...]
    starts: tuple[tuple[int, ...], ...]

    def place(self, row: int, name: str = "") -> str:
        """file:line:column of one value; the first row and column for an unknown one."""
        row = row if 0 <= row < len(self.lines) else 0
        k = self.names.index(name) if name in self.names else 0
        return f"{self.path}:{self.lines[row]}:{self.starts[row][k]}"

    def column(self, name: str) -> np.ndarray:
        """(T,) values of one column."""
        return self.values[:, self.names.index(name)].copy()

    def keep(self, rows: np.ndarray) -> "NumberRows":
        """The rows of an index or a mask."""
        index = np.arange(len(self.lines))[rows]
        chosen = tuple(self.lines[i] for i in index), tuple(self.starts[i] for i in index)
        return NumberRows(self.path, self.names, self.values[index], *chosen)


def read_rows(path: Path, *layouts: tuple[str, ...], separator: str = "") -> NumberRows:
    """Reads numbers in as many columns as one of `layouts` names, separated by `separator` ("" = blanks).

    Raises LogError: at file:line:column: a number of columns that no layout has, text, a blank, a decimal comma, NaN.
    """
    path = Path(path)
    field = re.compile(rf"[^{re.escape(separator)}]*") if separator else re.compile(r"\S+")
    names: tuple[str, ...] = ()
    values, lines, starts = [], [], []
    for i, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        spans = _spans(field, line.rstrip("\r"), separator)
        names = names or _layout(path, i, len(spans), layouts)
        if len(spans) != len(names):
            at = spans[min(len(spans), len(names)) - 1][0] + 1
            raise LogError(
                f"{path}:{i}:{at}: {len(spans)} values in a row of {len(names)} columns ({', '.join(names)}); "
                "is the row cut off, or a decimal written with a comma? Complete or remove it"
            )
        values.append([_number(path, i, a + 1, text, name) for (a, text), name in zip(spans, names, strict=True)])
        lines.append(i)
        starts.append(tuple(a + 1 for a, _ in spans))
    return NumberRows(path, names, np.array(values, float), tuple(lines), tuple(starts))


def without_strays(rows: NumberRows, stamp: str) -> tuple[NumberRows, list[str]]:
    """Rows without single strays whose stamp falls behind the rows around them, and a note on these.

    Raises LogError: more than one row in a hundred (or the only ones) go back: the clock was set, or the rows are not in order.
    """
    t = rows.column(stamp)
    stray, behind = strays(t)
    if not stray.any():
        return rows, []
    first = int(np.flatnonzero(behind)[0])
    message = f"{rows.place(first, stamp)}: time goes back: {t[first]:.15g} after {t[first - 1]:.15g}"
    if stray.sum() > max(1, STRAY * len(t)) or len(t) - stray.sum() < 2:
        raise LogError(
            f"{message}; {stray.sum()} of {len(t)} rows are out of order. "
            "Sort the rows by time, or split the file where the clock was set"
        )
    return rows.keep(~stray), [f"{message}; {stray.sum()} such row(s) left out"]


def _spans(field: re.Pattern, line: str, separator: str) -> list[tuple[int, str]]:
    """(0-based character, text) of every field of a line."""
    if not separator:
        return [(m.start(), m.group()) for m in field.finditer(line)]
    at, out = 0, []
    for part in line.split(separator):
        out.append((at + len(part) - len(part.lstrip()), part.strip()))
        at += len(part) + len(separator)
    return out


def _layout(path: Path, line: int, count: int, layouts: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    for names in layouts:
        if len(names) == count:
            return names
    message = "; or ".join(f"{len(names)}: {', '.join(names)}" for names in layouts)
    raise LogError(f"{path}:{line}:1: {count} columns; expected {message}. Is it another format, or another separator?")


def _number(path: Path, line: int, character: int, text: str, name: str) -> float:
    where = f"{path}:{line}:{character}: column {name!r}"
    if not NUMBER.fullmatch(text):
        if re.fullmatch(r"[+-]?\d+,\d+", text, re.ASCII):
            raise LogError(f"{where} has a decimal comma, {text!r}; write {text.replace(',', '.')}")
        raise LogError(f"{where} {f'{text[:30]!r} is not a number' if text else 'is blank'}; write a plain decimal number")
    value = float(text)
    if not np.isfinite(value):
        raise LogError(f"{where} is {text[:30]}; values must be finite numbers. Leave the row out")
    return value
