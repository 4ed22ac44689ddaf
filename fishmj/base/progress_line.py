"""A progress line with the rate and the time left."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any

from fishmj.base import terminal
from fishmj.base.terminal import cell, duration, printable

MEMORY = 30.0  # s of progress that the time left is told from


class Progress:
    """A line with a bar, the rate and the time left; on a file or pipe a plain line now and then.

        with Progress(1_000_000, "train", unit="steps") as bar:
            bar.update(done, reward=0.4)

    The time left comes from the last `MEMORY` seconds of progress. Until the first progress a command may have compiled: no time
    left is shown before the second, and that start no longer counts.
    """

    def __init__(
        self,
        total: float,
        label: str,
        unit: str = "",
        *,
        stream: IO[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        every: float | None = None,
        at_most: bool = False,
    ):
        """at_most: the work may end before `total`, so that the time left is always an upper bound."""
        self.total, self.label, self.unit, self._at_most = total, label, unit, at_most
        self._stream = sys.stderr if stream is None else stream
        self._live = bool(getattr(self._stream, "isatty", lambda: False)())
        self._every = every if every is not None else 0.2 if self._live else 15.0  # s between two lines
        self._clock, self._start = clock, clock()
        self.done_before = 0.0  # by earlier runs, not part of the rate
        self.ahead = 0.0  # s of other work to come, which the rate does not count
        self._most = 0.0  # the greatest that was reported
        self._shown = -math.inf
        self._seen = [(self._start, 0.0)]  # (time [s], done), the last `MEMORY` seconds
        self._named = False  # a stage without a rate is under way
        self._ended = False  # the whole has been shown
        self._starting = True  # the remembered time holds the start, in which a command may have compiled
        self._width = 0

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, kind, error, trace) -> None:
        if self._live and self._width:
            terminal.put("", self._stream)

    def restart(self) -> None:
        """Counts the time from now on."""
        self._start = self._clock()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start

    @property
    def rate(self) -> float:
        """Units a second over the remembered time; 0 before the first update."""
        (t0, d0), (t1, d1) = self._seen[0], self._seen[-1]
        return (d1 - d0) / (t1 - t0) if t1 > t0 else 0.0

    @property
    def left(self) -> float:
        """Seconds left at the present rate, and those `ahead`; infinite before the first update."""
        return max(self.total - self._seen[-1][1], 0.0) / self.rate + self.ahead if self.rate > 0 else math.inf

    def update(self, done: float, **fields: Any) -> None:
        """Reports `done` of `total` and any named figures; prints only when a line is due.

        A smaller `done` than before counts as the earlier one: with several processes, a finished one may not have reported yet.
        """
        now, done = self._clock(), max(done, self._most)
        self._most = done
        if self._named:
            self._named, self._starting, self._seen, self._shown = False, False, [], -math.inf
        if self._starting and now > self._seen[-1][0] and self._seen[-1][1] > 0.0 and done > self._seen[-1][1]:
            self._starting, self._seen = False, self._seen[-1:]
        self._seen.append((now, done))
        while len(self._seen) > 2 and now - self._seen[1][0] > MEMORY:
            self._seen.pop(0)
        if (done < self.total or self._ended) and (now - self._shown < self._every or not self.rate):
            return
        self._shown, self._ended = now, done >= self.total
        self._show(self.line(**fields))

    def stage(self, text: str) -> None:
        """Names work that the rate does not count, such as `compiling ...`, at once.

        The time left restarts with the next update.
        """
        self._named = True
        self._show(f"{self.label}: {text}")

    @contextmanager
    def aside(self, text: str = "") -> Iterator[None]:
        """Context for side work, such as an assessment: names it at once and leaves its time out of the rate."""
        began = self._clock()
        if text:
            self._show(f"{self.label}: {text}")
        yield
        self._seen = [(t + self._clock() - began, done) for t, done in self._seen]

    def _show(self, line: str) -> None:
        line = printable(line)
        if self._live:
            terminal.put("\r" + line.ljust(self._width), self._stream, end="")
            self._width = len(line)
        else:
            terminal.put(line, self._stream)

    def line(self, **fields: Any) -> str:
        """Text of the current progress line."""
        done = self._seen[-1][1]
        part = min(done / self.total, 1.0) if self.total else 1.0
        rate = self.rate or ((done - self.done_before) / self.elapsed if part == 1 and self.elapsed > 0 else 0.0)  # too short
        left = math.inf if self._starting else self.left
        bound = "at most " if self._at_most and math.isfinite(left) else ""
        ahead = f"{bound}{duration(left)} left" if part < 1 else f"took {duration(self.elapsed)}"
        figures = "".join(f"  {name} {cell(value)}" for name, value in fields.items())
        return f"{self.label} [{'#' * int(20 * part):<20}] {100 * part:3.0f} %  {_short(rate)} {self.unit}/s  {ahead}{figures}"


def _short(number: float) -> str:
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(number) >= scale:
            return f"{number / scale:.3g}{letter}"
    return f"{number:.3g}"
