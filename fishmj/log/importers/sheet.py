"""What every reader of a foreign file gives: columns of numbers under the names that the lab chose."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fishmj.errors import LogError
from fishmj.log.limits import quoted
from fishmj.log.trial import Table

DATE = "date"  # the unit of date-time stamps, which readers give as s since 1970


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
        return f"{self.where}:{line}:{quoted(column)[1:-1]}"

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
