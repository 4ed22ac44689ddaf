"""How a stage of a search tells how far it is: a bar on a command line, nothing from Python.

with bars(96, "null runs", "runs") as bar:
    bar.update(1)
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol

from fishmj import console


class Bar(Protocol):
    """What a stage reports to."""

    def update(self, done: float, **fields: Any) -> None:
        """Report `done` of the total that the stage was announced with."""


Bars = Callable[[float, str, str], AbstractContextManager[Bar]]  # (total, what is done, its unit)


class Quiet:
    """A bar that nobody sees."""

    def update(self, done: float, **fields: Any) -> None:
        """Nothing."""


def silent(total: float, label: str, unit: str = "") -> AbstractContextManager[Bar]:
    """For callers from Python."""
    return nullcontext(Quiet())


def shown(total: float, label: str, unit: str = "") -> console.Progress:
    """For a command line: there from the start, at nothing done."""
    bar = console.Progress(total, label, unit)
    bar.update(0)
    return bar
