"""Text tables of laboratories: any separator, decimal commas, byte order marks, Latin-1, a row of units, date-times.

Every deviation from plain UTF-8 with commas is noted. No cell is ever evaluated: it is a number, a date-time, blank or text. Line
numbers are those of the file.
"""

import codecs
import re
import sys
from array import array
from bisect import bisect_left
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np

from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.log.importers import cells, header, joint_names, layout, motive, table_forms
from fishmj.log.importers.cells import CellReading
from fishmj.log.importers.layout import HEAD
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.limits import LINE, bare, check_size, quoted, regular
from fishmj.log.trial import Table

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".tab", ".lvm", ".log")
PROSE, LETTER = ("", ".txt", ".log"), 1 << 16  # ends of names of what may be prose, and bytes of it at most
BAD_ROWS = 0.01  # share of rows of another length that are left out with a note; more is another format
SOON = 5.0  # s before progress shows
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_NAMES = {"utf-8-sig": "UTF-8 with a byte order mark", "utf-16": "UTF-16", "latin-1": "Latin-1"}
_ARROW = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}\.\d{3}) -> ?", re.ASCII)  # as the serial monitor of Arduino stamps a line
_SEP = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # the first line that Excel reads a separator from
_QUANTITY = re.compile(r"[^\w#/]?[\d.,]*\d[\d.,]*\W{0,2}[a-zA-Z°%]{0,5}\W?")  # (1.9), 1.9-, 3 deg, 01. Mai: no code, no error
_COMMENTS = ("#", "%", "//")


def read(path: Path) -> Sheet:
    """Reads one text table.

    Raises LogError: at file:line, with the fault and the fix: empty, binary, no header, a name twice, rows of different length.
    """
    regular(path)
    encoding, notes = _encoding(path)
    notes = [f"{path.name}: {note}" for note in notes]
    try:
        try:
            return _table(path, encoding, notes, careful=False)
        except _TwoReadings:
            return _table(path, encoding, notes, careful=True)
    except UnicodeError as error:
        raise LogError(
            f"{path}: damaged {_NAMES.get(encoding, encoding)} text ({error.__class__.__name__}); save it as UTF-8"
        ) from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def is_prose(path: Path) -> bool:
    """Returns True for a short text without a table of numbers, such as notes beside the recordings."""
    if path.suffix.lower() not in PROSE or not path.is_file() or not 0 < path.stat().st_size <= LETTER:
        return False
    try:
        lines = path.read_text(_encoding(path)[0]).splitlines()
    except (LogError, OSError, UnicodeError):  # the reader says why
        return False
    return any(map(str.strip, lines)) and not layout.holds_values([line for line in lines if not line.startswith(_COMMENTS)])


def _encoding(path: Path) -> tuple[str, list[str]]:
    """Encoding by the byte order mark, else UTF-8 if the whole file is valid, else Latin-1; non-text bytes are refused."""
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


def _table(path: Path, encoding: str, notes: list[str], *, careful: bool) -> Sheet:
    with open(path, encoding=encoding, newline=None) as file:
        return _read(path, _lines(path, file), notes, careful)


def _read(path: Path, lines: Iterator[tuple[int, str]], notes: list[str], careful: bool) -> Sheet:
    comment, comments, said, head = "", 0, "", []
    for number, line in lines:
        if (found_mark := _SEP.fullmatch(line)) and not head:
            said = found_mark[1]
        elif line.lstrip().startswith(_COMMENTS):
            comment, comments = (comment, comments + 1) if head else (line.lstrip("#%/ \t"), 0)
        else:
            head.append((number, line))
            if len(head) == HEAD:
                break
    if not head:
        raise LogError(f"{path}:1:1: no rows, only comments or blank lines; record it again or remove it")
    if told := table_forms.pairs([line for _, line in head]):
        raise LogError(f"{path}:{head[0][0]}:1: {told}")
    arrows = all(_ARROW.match(line) for _, line in head)
    plain = [(number, _ARROW.sub("", line, count=1)) for number, line in head] if arrows else head
    found = layout.find(path, plain, comment, said)
    reader = _Reader(path, found, careful, arrows)
    reader.comments = comments
    for number, line in chain(head[found.above :], lines):
        reader.add(number, line)
    sheet = reader.sheet([*notes, *(f"{path.name}: {note}" for note in found.notes)])
    return checked(motive.in_plane(sheet, found.settings) if found.settings else sheet)


class _TwoReadings(Exception):
    """Signals a cell with two readings, so that the file is read again with both."""


class _Reader:
    """Collects rows, one at a time, and the cells that are no numbers. A careful reader keeps both readings of a cell."""

    def __init__(self, path: Path, found: layout.Layout, careful: bool, arrows: bool):
        self.path, self.layout, self.careful, self.arrows = path, found, careful, arrows
        self.names = ["clock", *found.names] if arrows else found.names
        self.values, self.seconds, self.lines = array("d"), array("d"), array("q")
        self.odd: list[tuple[int, int]] = []  # (line, fields) of rows of another length
        self.text: dict[str, str] = {}
        kept = {name for name in self.names if joint_names.holds_names(name, self.names) or table_forms.may_tell_apart(name)}
        self.joints: dict[str, list[str]] = {name: [] for name in self.names if name in kept}
        self.counts = dict.fromkeys(self.names, 0)  # of cells that are text
        self.dates: dict[str, None] = {}
        self.grouped = False
        self.again: list[int] = []  # lines that repeat the names
        self.comments = 0

    def add(self, number: int, line: str) -> None:
        """Adds a line.

        Raises:
            _TwoReadings: a cell has two, and the reader is not careful.
        """
        if line.lstrip().startswith(_COMMENTS):
            self.comments += 1
            return
        clock = []
        if self.arrows and (stamp := _ARROW.match(line)):
            clock, line = [stamp[1]], line[stamp.end() :]
        fields = [*clock, *self.layout.cut(line)]
        if len(fields) != len(self.names):
            self.odd.append((number, len(fields)))
            if len(self.odd) > 1000:
                self._refuse_odd()
            return
        try:
            if self.careful or "_" in line or not line.isascii():
                raise ValueError
            self.values.extend([float(text) for text in fields])
        except ValueError:
            if [text.strip() for text in fields[len(clock) :]] == self.layout.names:
                self.again.append(number)
                return
            if self.lines and self._names_others(fields[len(clock) :]):
                others = ", ".join(bare(text.strip()) for text in fields[len(clock) :][:6])
                raise LogError(
                    f"{self.path}:{number}:1: other names of columns in the middle of the file ({others}), expected "
                    f"{', '.join(map(bare, self.layout.names[:6]))} to its end; split the file there"
                ) from None
            row = [self._cell(text.strip(), name) for text, name in zip(fields, self.names, strict=True)]
            if not self.careful and any(cell.two for cell in row):
                raise _TwoReadings from None
            self.values.extend(cell.first for cell in row)
            self.seconds.extend(cell.second for cell in row if self.careful)
        self.lines.append(number)
        if self.joints:
            told = dict(zip(self.names, fields, strict=True))
            for column, names in self.joints.items():
                names.append(sys.intern(told[column].strip()))
        if not len(self.lines) % 100_000:
            check_size(self.path, 8 * len(self.values), "as numbers is more than")

    def _names_others(self, fields: list[str]) -> bool:
        """Returns True for a row of names that are not those of the columns: most of them mean something in a log."""
        texts = [text.strip() for text in fields]
        if len(texts) < 2 or any(text.lower() in cells.BLANKS or cells.is_value(text) for text in texts):
            return False
        known = [text in self.layout.names or bool(header.role(header.parse(text), set()).places) for text in texts]
        return 2 * sum(known) > len(texts) and len(set(texts)) == len(texts)

    def _cell(self, text: str, name: str) -> CellReading:
        if found := cells.read(text):
            self.grouped |= found.grouped and not found.two
            if found.date:
                self.dates[name] = None
            return found
        if text.lower() in cells.BLANKS:
            return CellReading(np.nan, np.nan)
        if text.lower().lstrip("+-") in ("inf", "infinity"):
            return CellReading(np.inf, np.inf)
        self.text.setdefault(name, text)
        self.counts[name] += 1
        return CellReading(np.nan, np.nan)

    def _refuse_odd(self) -> None:
        number, count = self.odd[0]
        commas = "decimal commas between comma-separated columns? Save with points or with semicolons"
        hint = commas if self.layout.mark == "," else "another separator?"
        raise LogError(
            f"{self.path}:{number}:1: {count} values in a row of {len(self.names)} columns, as in {len(self.odd)} "
            f"row(s); is the row cut off, or {hint}"
        )

    def sheet(self, notes: list[str]) -> Sheet:
        """The sheet of all rows. Raises LogError: too many rows of another length, or a column of numbers with two readings."""
        if len(self.odd) > max(1, BAD_ROWS * len(self.lines)) or (self.odd and not self.lines):
            self._refuse_odd()
        name = self.path.name
        if self.odd:
            notes.append(f"{name}:{self.odd[0][0]}: {len(self.odd)} row(s) of another length left out (cut off?)")
        if self.again:
            notes.append(
                f"{name}:{self.again[0]}: the names of the columns again, {len(self.again)} time(s): files put together?"
            )
        notes += [f"{name}: {self.comments} line(s) of comment among the rows left out"] if self.comments else []
        columns = self._columns(self.values)
        if self.careful:
            columns, unclear, told = cells.decided(columns, self._columns(self.seconds), self.dates)
            for column, row in unclear.items():
                self._refuse_two(column, int(self.lines[row]))
            notes += [f"{name}: {note}" for note in told]
        else:
            for column in (c for c, values in columns.items() if c not in self.dates and cells.may_hide_thousands(values)):
                texts = [self._cell_of(line, column) for line in self._lines_again()]
                if (row := cells.hidden_thousands(texts)) >= 0:
                    self._refuse_two(column, int(self.lines[row]))
        marks = f"{name}: marks between thousands left out"
        notes += [marks] if self.grouped and marks not in notes else []
        apart = table_forms.told_apart({column: told for column, told in self.joints.items() if self.counts[column]})
        named = {
            column: told
            for column, told in self.joints.items()
            if joint_names.holds_names(column, self.names) and (self.counts[column] or column.lower().endswith("id"))
        }
        columns = joint_names.by_name(str(self.path), columns, named)
        for column, count in self.counts.items():
            if column in columns and count and np.isfinite(columns[column]).any():
                notes.append(
                    f"{name}: column {quoted(column)}: {count} cell(s) of text, such as "
                    f"{quoted(self.text[column])}, taken for blanks"
                )
        doubts = {
            column: f"{count} of {len(self.lines)} cells, such as {quoted(self.text[column])}, are no plain numbers: write "
            "them so, or lose their rows with --set"
            for column, count in self.counts.items()
            if column in columns and count > BAD_ROWS * len(self.lines) and _QUANTITY.fullmatch(self.text[column])
        }
        doubts |= {column: doubt for column in self.dates if (doubt := cells.frame_doubt(columns.get(column, np.zeros(0))))}
        for column in (c for c, values in columns.items() if c in self.layout.names and cells.may_lack_zeros(values)):
            if doubt := cells.unpadded([self._cell_of(line, column) for line in self._lines_again()]):
                doubts[column] = doubt
        units = {**self.layout.units, **dict.fromkeys(self.dates, DATE)}
        units = {column: unit for column, unit in units.items() if column in columns}
        return Sheet(self.path, name, columns, units, np.array(self.lines, int), dict(self.text), tuple(notes), doubts, apart)

    def _columns(self, values: array) -> Table:
        both = np.array(values, float).reshape(len(self.lines), len(self.names))
        return {column: both[:, k].copy() for k, column in enumerate(self.names)}

    def _lines_again(self, first: int = 0) -> Iterator[str]:
        """The lines of the rows, read again from line number `first` on."""
        wanted = set(self.lines[bisect_left(self.lines, first) :])
        with open(self.path, encoding=_encoding(self.path)[0], newline=None) as file:
            yield from (line.rstrip("\r\n") for n, line in enumerate(file, start=1) if n in wanted)

    def _cell_of(self, line: str, column: str) -> str:
        return self.layout.cut(_ARROW.sub("", line, count=1) if self.arrows else line)[self.layout.names.index(column)].strip()

    def _refuse_two(self, column: str, number: int) -> NoReturn:
        text = self._cell_of(next(self._lines_again(number)), column)
        found = cells.read(text) or CellReading(np.nan, np.nan)
        may = "day and month, or month and day" if found.date else f"{found.first:g} or {found.second:g}"
        form = "the year first" if found.date else "decimal points and no marks between thousands"
        raise LogError(
            f"{self.path}:{number}:{bare(column)}: {quoted(text)} may be {may}, and no other cell of the column or file tells "
            f"which; save the file with {form}"
        )
