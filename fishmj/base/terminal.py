"""Output to the terminal: safe text, a reader that may close the pipe, tables, durations."""

import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import IO, Any

readers_gone: list[int] = []  # descriptors whose reader left while this command ran

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """`text` without control characters and marks of writing direction: text of a file is shown, never obeyed."""
    return _CONTROL.sub("", text)


def put(text: str, stream: IO[str], end: str = "\n") -> None:
    """Prints at once. If the reader leaves (`| head`), the output is dropped and the command goes on in silence."""
    try:
        print(text, end=end, file=stream, flush=True)
    except BrokenPipeError:
        silence(stream)


def silence(stream: IO[str]) -> None:
    """Sends all further output of a stream nowhere, child processes included."""
    number = stream.fileno()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)
    readers_gone.append(number)


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> str:
    """Rows as a Markdown table that also reads well in a terminal: numbers to the right, floats to 4 digits, NaN as `-`."""
    names = list(columns if columns is not None else rows[0] if rows else [])
    cells = [[cell(row.get(name)).replace("|", "\\|") for name in names] for row in rows]
    wide = [max([len(name), 3, *(len(row[i]) for row in cells)]) for i, name in enumerate(names)]
    right = [bool(rows) and all(_is_number(row.get(name)) for row in rows) for name in names]

    def line(values: Sequence[str]) -> str:
        return "| " + " | ".join(v.rjust(w) if r else v.ljust(w) for v, w, r in zip(values, wide, right, strict=True)) + " |"

    rule = "|" + "|".join("-" * (w + 1) + (":" if r else "-") for w, r in zip(wide, right, strict=True)) + "|"
    return "\n".join([line(names), rule, *map(line, cells)])


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def cell(value: Any) -> str:
    """A value of a table as one line of text: floats to 4 digits, NaN and None as `-`."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else " ".join(printable(str(value)).split("\n"))


def duration(seconds: float) -> str:
    """A duration in words: `7.2 s`, `3 min 05 s`, `2 h 10 min`, `12 days`, `37 years`."""
    if not math.isfinite(seconds):
        return "?"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 48 * 60:
        return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
    days = minutes / 1440
    return f"{days:.0f} days" if days < 1000 else f"{days / 365.25:,.0f} years"
