"""How a stage of a search tells how far it is: a bar on a command line, nothing from Python.

with bars(96, "null runs", "runs") as bar:
    bar.update(1)

A search may end before its last round: `at_most` says so of the time left.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol

from fishmj.base import console


class Bar(Protocol):
    """What a stage reports to."""

    def update(self, done: float, **fields: Any) -> None:
        """Report `done` of the total that the stage was announced with."""


Bars = Callable[..., AbstractContextManager[Bar]]  # (total, what is done, its unit, at_most: whether it may end before)


class Quiet:
    """A bar that nobody sees."""

    def update(self, done: float, **fields: Any) -> None:
        """Nothing."""


def silent(total: float, label: str, unit: str = "", at_most: bool = False) -> AbstractContextManager[Bar]:
    """For callers from Python."""
    return nullcontext(Quiet())


def shown(total: float, label: str, unit: str = "", at_most: bool = False) -> console.Progress:
    """For a command line: there from the start, at nothing done."""
    bar = console.Progress(total, label, unit, at_most=at_most)
    bar.update(0)
    return bar
