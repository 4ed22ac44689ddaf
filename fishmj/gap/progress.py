"""Progress of the stages of a search: a bar on a command line, none from Python.

with bars(96, "null runs", "runs") as bar:
    bar.update(1)

A search may end before its last round; `at_most` says that the time left is an upper bound.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol

from fishmj.base import console


class Bar(Protocol):
    """Interface of a progress bar."""

    def update(self, done: float, **fields: Any) -> None:
        """Reports `done` of the announced total."""


Bars = Callable[..., AbstractContextManager[Bar]]  # (total, label, unit, at_most: True if the stage may end early)


class QuietBar:
    """An invisible bar."""

    def update(self, done: float, **fields: Any) -> None:
        """Does nothing."""


def silent_bar(total: float, label: str, unit: str = "", at_most: bool = False) -> AbstractContextManager[Bar]:
    """Invisible bar, for callers from Python."""
    return nullcontext(QuietBar())


def terminal_bar(total: float, label: str, unit: str = "", at_most: bool = False) -> console.Progress:
    """Progress bar for a command line, shown from the start at zero."""
    bar = console.Progress(total, label, unit, at_most=at_most)
    bar.update(0)
    return bar
