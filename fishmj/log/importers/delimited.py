"""Text tables as laboratories write them: any separator, decimal commas, byte order marks, Latin-1, a row of units, date-times.

What is taken differently from plain UTF-8 with commas is noted. No cell is ever evaluated: it is a number, a date-time, blank or
text. Line numbers are those of the file.
"""

import codecs
import csv
import re
import sys
from array import array
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fishmj import console
from fishmj.errors import LogError
from fishmj.log.importers import joint_names
from fishmj.log.importers.column_units import unit_of
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.limits import COLUMNS, LINE, bare, check_size, quoted, regular

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
BAD_ROWS = 0.01  # share of rows of another length that are left out with a note; more is another format
SOON = 5.0  # s before progress shows
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
_BLANKS = {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a"}
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)", re.ASCII)
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_NAMES = {"utf-8-sig": "UTF-8 with a byte order mark", "utf-16": "UTF-16", "latin-1": "Latin-1"}
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", " ": "blanks"}


def read(path: Path) -> Sheet:
    """One text table.

    Raises:
        LogError: at file:line, what it is and what to do: empty, binary, no header, a name twice, rows of different length.
    """
    regular(path)
    encoding, notes = _encoding(path)
    try:
        with open(path, encoding=encoding, newline=None) as file:
            return _table(path, _lines(path, file), [f"{path.name}: {note}" for note in notes])
    except UnicodeError as error:
        raise LogError(
            f"{path}: damaged {_NAMES.get(encoding, encoding)} text ({error.__class__.__name__}); save it as UTF-8"
        ) from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def _encoding(path: Path) -> tuple[str, list[str]]:
    """By the byte order mark, else UTF-8 where all of it is, else Latin-1; bytes that no text has are refused."""
    with open(path, "rb") as file:
        start = file.read(4)
        for mark, name in _MARKS:
            if start.startswith(mark):
                return name, [f"read as {_NAMES[name]}"]
        file.seek(0)
        decoder, valid, line = codecs.getincrementaldecoder("utf-8")(), True, 1
        while True:
            block = file.read(1 << 20)
            if (at := block.find(b"\0")) >= 0:
                line += block.count(b"\n", 0, at)
                raise LogError(
                    f"{path}:{line}:1: binary data or UTF-16 without its mark (a zero byte); export it as CSV in UTF-8"
                )
            line += block.count(b"\n")
            try:
                valid and decoder.decode(block, final=not block)
            except UnicodeDecodeError:
                valid = False
            if not block:
                break
    return ("utf-8", []) if valid else ("latin-1", ["not UTF-8, read as Latin-1"])


def _lines(path: Path, file) -> Iterator[tuple[int, str]]:
    """(number from 1, text) of every line that is not blank."""
    number, done = 0, 0
    bar = console.Progress(path.stat().st_size, f"read {bare(path.name)}", unit="B")
    while line := file.readline(LINE + 1):
        number += 1
        done += len(line)
        if not number % 50_000 and bar.elapsed > SOON:
            bar.update(min(done, bar.total))
        if len(line) > LINE:
            raise LogError(f"{path}:{number}:1: a line of over {LINE} characters; it is no table, or it is binary")
        if line.strip():
            yield number, line.rstrip("\r\n")


def _table(path: Path, lines: Iterator[tuple[int, str]], notes: list[str]) -> Sheet:
    comment, said, head = "", "", []
    for number, line in lines:
        if line.lower().startswith("sep=") and len(line) == 5:
            said = line[4]
        elif line.lstrip().startswith(("#", "%", "//")) and not head:
            comment = line.lstrip("#%/ \t")
        else:
            head.append((number, line))
            if len(head) == 8:
                break
    if not head:
        raise LogError(f"{path}:1:1: no rows, only comments or blank lines; record it again or remove it")
    mark = said or _separator(path, head, comment)
    if titles := _titles(head, mark):
        notes.append(f"{path.name}: {titles} row(s) of titles above the names of the columns left out")
        head = head[titles:]
    names = [name.strip() for name in _split(head[0][1], mark)]
    if 2 * sum(map(_is_number, names)) >= sum(map(bool, names)):
        named = [name.strip() for name in _split(comment, mark)] if comment else []
        if len(named) != len(names) or all(_is_number(name) for name in named):
            raise LogError(
                f"{path}:{head[0][0]}:1: the first row holds numbers; write the names of the columns there, such "
                "as time_s,servo1_deg"
            )
        names, body = named, head
    else:
        body = head[1:]
    names, found = _checked_names(path, head[0][0], names)
    notes += [f"{path.name}: {note}" for note in found]
    units = {}
    if body and (told := _unit_row(body[0][1], mark, names)):
        units, body = told, body[1:]
    if mark != ",":
        notes.append(f"{path.name}: columns are separated by {_SEPARATORS.get(mark, quoted(mark))}")
    reader = _Reader(path, names, mark)
    for rows in (body, lines):
        for number, line in rows:
            reader.add(number, line)
    return reader.sheet(units, notes)


class _Reader:
    """Rows, one at a time; remembers what was no number."""

    def __init__(self, path: Path, names: list[str], mark: str):
        self.path, self.names, self.mark = path, names, mark
        self.values, self.lines = array("d"), array("q")
        self.odd: list[tuple[int, int]] = []  # (line, fields) of rows of another length
        self.text: dict[str, str] = {}
        self.joints: dict[str, list[str]] = {name: [] for name in names if joint_names.holds_names(name)}
        self.counts = dict.fromkeys(names, 0)  # of cells that are text
        self.dates: dict[str, None] = {}
        self.commas = False

    def add(self, number: int, line: str) -> None:
        fields = _split(line, self.mark)
        if len(fields) == len(self.names) + 1 and not fields[-1].strip():
            fields.pop()
        if len(fields) != len(self.names):
            self.odd.append((number, len(fields)))
            if len(self.odd) > 1000:
                self._refuse_odd()
            return
        try:
            if "_" in line or not line.isascii():
                raise ValueError
            row = [float(text) for text in fields]
        except ValueError:
            row = [self._cell(text.strip(), name) for text, name in zip(fields, self.names, strict=True)]
        self.values.extend(row)
        self.lines.append(number)
        if self.joints:
            told = dict(zip(self.names, fields, strict=True))
            for column, cells in self.joints.items():
                cells.append(sys.intern(told[column].strip()))
        if not len(self.lines) % 100_000:
            check_size(self.path, 8 * len(self.values), "as numbers is more than")

    def _cell(self, text: str, name: str) -> float:
        if _NUMBER.fullmatch(text):
            return float(text.replace("D", "e").replace("d", "e"))
        if self.mark != "," and _COMMA.fullmatch(text):
            self.commas = True
            return float(text.replace(",", "."))
        if text.lower() in _BLANKS:
            return np.nan
        stamp = _date(text)
        if stamp is not None:
            self.dates[name] = None
            return stamp
        if text.lower().lstrip("+-") in ("inf", "infinity"):
            return np.inf
        self.text.setdefault(name, text)
        self.counts[name] += 1
        return np.nan

    def _refuse_odd(self) -> None:
        number, count = self.odd[0]
        commas = "decimal commas between comma-separated columns? Save with points or with semicolons"
        hint = commas if self.mark == "," else "another separator?"
        raise LogError(
            f"{self.path}:{number}:1: {count} values in a row of {len(self.names)} columns, as in {len(self.odd)} "
            f"row(s); is the row cut off, or {hint}"
        )

    def sheet(self, units: dict[str, str], notes: list[str]) -> Sheet:
        if len(self.odd) > max(1, BAD_ROWS * len(self.lines)) or (self.odd and not self.lines):
            self._refuse_odd()
        name = self.path.name
        if self.odd:
            notes.append(f"{name}:{self.odd[0][0]}: {len(self.odd)} row(s) of another length left out (cut off?)")
        if self.commas:
            notes.append(f"{name}: decimal commas read as points")
        values = np.array(self.values, float).reshape(len(self.lines), len(self.names))
        columns = {column: values[:, k].copy() for k, column in enumerate(self.names)}
        named = {column: cells for column, cells in self.joints.items() if self.counts[column] or column.lower().endswith("id")}
        columns = joint_names.by_name(str(self.path), columns, named)
        for column, count in self.counts.items():
            if column in columns and count and np.isfinite(columns[column]).any():
                notes.append(
                    f"{name}: column {quoted(column)}: {count} cell(s) of text, such as "
                    f"{quoted(self.text[column])}, taken for blanks"
                )
        units = {column: unit for column, unit in {**units, **dict.fromkeys(self.dates, DATE)}.items() if column in columns}
        return checked(Sheet(self.path, name, columns, units, np.array(self.lines, int), dict(self.text), tuple(notes)))


def _is_number(text: str) -> bool:
    return bool(_NUMBER.fullmatch(text.strip()) or _COMMA.fullmatch(text.strip()))


def _split(line: str, mark: str) -> list[str]:
    if mark == " ":
        return line.split()
    if '"' in line:
        try:
            return next(csv.reader([line], delimiter=mark), [])
        except csv.Error:
            return line.split(mark)
    return line.split(mark)


def _separator(path: Path, head: list[tuple[int, str]], comment: str) -> str:
    """The mark that cuts the header and the rows after it into equally many fields, the most of them."""
    first = comment if comment and all(map(_is_number, re.split(r"[;,\t| ]+", head[0][1].strip()))) else head[0][1]
    best, most = "", 1
    for mark in _SEPARATORS:
        counts = [len(_split(line, mark)) for _, line in head[1:] or head]
        fields = len(_split(first, mark))
        if fields > most and sum(count in (fields, fields + 1) for count in counts) * 2 >= len(counts):
            best, most = mark, fields
            if mark in ";\t":
                break
    if best:
        return best
    for mark in _SEPARATORS:
        if mark in first.strip():
            return mark
    raise LogError(
        f"{path}:{head[0][0]}:1: one column only, {quoted(first)}; expected columns separated by commas, "
        "semicolons, tabs or blanks"
    )


def _titles(head: list[tuple[int, str]], mark: str) -> int:
    """How many rows of a spreadsheet's titles, mostly empty cells, stand above the first row of names; 0 where none do."""
    for k, (_, line) in enumerate(head):
        cells = [cell.strip() for cell in _split(line, mark)]
        filled = [cell for cell in cells if cell]
        if len(filled) > 1 and len(filled) == len(cells) and not any(map(_is_number, cells)):
            return k
        if 2 * len(filled) > len(cells) or 2 * sum(map(_is_number, filled)) > len(filled):
            return 0
    return 0


def _checked_names(path: Path, line: int, names: list[str]) -> tuple[list[str], list[str]]:
    while len(names) > 1 and not names[-1]:
        names = names[:-1]
    if len(names) > COLUMNS:
        raise LogError(f"{path}:{line}:1: {len(names)} columns; at most {COLUMNS} are read. Is it a picture or a matrix?")
    out, notes = [], []
    for k, name in enumerate(names):
        if not name:
            name = f"unnamed {k + 1}"
            notes.append(f"column {k + 1} has no name; called {name!r}")
        if name in out:
            raise LogError(f"{path}:{line}:1: column {quoted(name)} appears twice; rename or remove one of them")
        out.append(name)
    return out, notes


def _unit_row(line: str, mark: str, names: list[str]) -> dict[str, str]:
    """{column: unit} where the second row says the units: no number in it, at least half of its cells known units."""
    cells = [cell.strip().strip("[]()") for cell in _split(line, mark)]
    if len(cells) != len(names) or any(_is_number(cell) for cell in cells):
        return {}
    units = {name: unit for name, cell in zip(names, cells, strict=True) if (unit := unit_of(cell))}
    return units if 2 * len(units) >= len(names) else {}


def _date(text: str) -> float | None:
    """Seconds since 1970 of an ISO 8601 date-time (UTC where it names no zone), or of the day for a bare clock time."""
    if len(text) > 40 or ":" not in text:
        return None
    if clock := _CLOCK.fullmatch(text):
        return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3].replace(",", "."))
    try:
        found = datetime.fromisoformat(text.replace(",", "."))
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    except (OverflowError, ValueError):
        return None
