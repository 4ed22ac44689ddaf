"""A column's guessed meaning, and the files that share their columns."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fishmj.log.importers.sheet import Sheet

TAKEN, UNCLEAR, LEFT = "taken", "unclear", "left out"
ROWS = 200_000  # of one file that the statistics look at


@dataclass(frozen=True)
class Guess:
    """Guessed meaning of one column of one kind of file."""

    kind: int
    column: str
    state: str = LEFT
    places: tuple[str, ...] = ()  # "cmd.c1"; "t" for stamps; several where it is unclear which
    unit: str = ""
    scale: float = 1.0
    why: str = ""
    said: bool = False  # by the user
    fits: tuple[str, ...] = ()  # units that its values allow, where its name says another

    @property
    def place(self) -> str:
        """First place of the guess, such as "cmd.c1"; "" without one."""
        return self.places[0] if self.places else ""

    @property
    def table(self) -> str:
        """Table of the first place."""
        return self.place.partition(".")[0]

    def left(self, why: str) -> "Guess":
        """Copy of the guess, left out."""
        return replace(self, state=LEFT, places=(), why=why)

    def unclear(self, why: str, **changes: Any) -> "Guess":
        """Copy of the guess, left to the user."""
        return replace(self, state=UNCLEAR, why=why, **changes)


@dataclass(frozen=True)
class FileKind:
    """Files with the same columns and names of the same meaning."""

    sheets: tuple[Sheet, ...]
    pattern: str  # of their names

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.sheets[0].columns)

    def called(self, name: str) -> bool:
        """Returns True if `name` is one of its columns, or a file or topic of it."""
        return name in self.sheets[0].columns or any(name == sheet.name for sheet in self.sheets)

    def doubt(self, column: str) -> str:
        """Reason from the file that the user must decide on a column; "" without one."""
        return next((sheet.doubts[column] for sheet in self.sheets if column in sheet.doubts), "")

    def values(self, column: str) -> np.ndarray:
        """Values of a column (T,), all files one after the other."""
        return np.concatenate([sheet.columns[column][:ROWS] for sheet in self.sheets[:16]])
