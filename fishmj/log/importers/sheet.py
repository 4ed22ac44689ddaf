"""Common result of the readers of foreign files: columns of numbers under the lab's own names."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.limits import bare, quoted
from fishmj.log.trial import Table

DATE = "date"  # the unit of date-time stamps, which readers give as s since 1970
EPOCH = 3e8  # s; stamps that begin beyond (nine years and a half) count from 1970, not from a start


@dataclass(frozen=True)
class Sheet:
    """Columns of a file: name -> (T,) float64, NaN for a cell without a number. The file itself is never changed."""

    path: Path
    name: str  # of the file, or the topic of a recording
    columns: Table
    units: dict[str, str] = field(default_factory=dict)  # column -> unit, where the file itself says it
    lines: np.ndarray | None = None  # (T,) line of each row, from 1
    text: dict[str, str] = field(default_factory=dict)  # column -> a cell of it that is no number
    notes: tuple[str, ...] = ()
    doubts: dict[str, str] = field(default_factory=dict)  # column -> why the user decides on it
    apart: dict[str, str] = field(default_factory=dict)  # column of text -> the robots or trials that it tells apart
    episode: int | None = None  # of a file that holds several trials

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
        """Copy of the sheet with further notes."""
        return replace(self, notes=(*self.notes, *notes))


def checked(sheet: Sheet) -> Sheet:
    """Sheet with infinite values blanked and noted. Raises LogError: no rows, or no column of numbers."""
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
