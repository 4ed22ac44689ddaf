"""Limits on foreign files: their kind, their unpacked size, and the length of their text in messages."""

import os
import re
import shlex
import struct
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from fishmj.base.errors import ConfigError, LogError
from fishmj.base.plain_file import why_unreadable

VARIABLE = "FISHMJ_IMPORT_GB"  # raises the limit
DEFAULT_GB = 2.0
LINE = 1 << 20  # characters of one line of text
COLUMNS = 4096
DAMAGE = (  # what a damaged file raises in a library that reads it, besides the library's own errors
    *(struct.error, OSError, ValueError, TypeError, AttributeError, AssertionError, LookupError, ArithmeticError),
    *(EOFError, MemoryError, RuntimeError),
)


def most_bytes() -> int:
    """Largest number of bytes of one recording, on disk or unpacked; set by an environment variable in gigabytes.

    Raises ConfigError: the variable is no positive number.
    """
    text = os.environ.get(VARIABLE, "")
    try:
        gb = float(text) if text else DEFAULT_GB
    except ValueError:
        gb = 0.0
    if not 0 < gb < 1e6:
        raise ConfigError(f"{VARIABLE} = {quoted(text)}: expected gigabytes, for example 8")
    return int(gb * 1e9)


def check_size(path: Path, size: float, what: str = "is") -> None:
    """Raises LogError for `size` bytes beyond the limit."""
    if size > most_bytes():
        raise LogError(
            f"{path}: {what} {size / 1e9:.3g} GB, the limit is {most_bytes() / 1e9:g} GB; if you trust the file "
            f"set {VARIABLE}={int(size / 1e9) + 1}"
        )


def regular(path: Path, *, empty: bool = False) -> int:
    """Size of a plain file [bytes].

    Args:
        empty: accept an empty file.

    Raises LogError: no such file, a pipe, a device or a folder, empty, or beyond the limit.
    """
    if why := why_unreadable(path):
        raise LogError(f"{path}: {why}")
    size = path.stat().st_size
    if not size and not empty:
        raise LogError(f"{path}: the file is empty; record it again or remove it")
    check_size(path, size)
    return size


def listed(names: Iterable[object]) -> str:
    """Names of columns for a message, with commas between them and shortened: a foreign file's first line is not repeated."""
    clean = "".join(c if c.isprintable() else "?" for c in ", ".join(map(str, names)))
    return clean if len(clean) <= 60 else clean[:58] + ".."


def quoted(text: object, most: int = 40) -> str:
    """`text` in quotes for a message: control characters out, shortened."""
    clean = "".join(c if c.isprintable() else "?" for c in str(text)[: most + 1])
    return repr(clean if len(clean) <= most else clean[: most - 2] + "..")


def bare(text: object, most: int = 40) -> str:
    """`text` for a message without quotes: control characters out, shortened."""
    return quoted(text, most)[1:-1]


def typed(text: object) -> str:
    """`text` as it is typed on a command line: in quotes where it has blanks or other marks of the shell."""
    return shlex.quote(bare(text))


def kinds_first(lines: Iterable[str]) -> list[str]:
    """Lines, each once, in the order of: the first of each kind, the second, ..; one kind differs in numbers and paths only."""
    seen: Counter[str] = Counter()
    ranked = []
    for line in dict.fromkeys(lines):
        kind = re.sub(r"^\S+:|\S*[\d/]\S*", "#", line)  # a file or trial comes first
        seen[kind] += 1
        ranked.append((seen[kind], line))
    return [line for _, line in sorted(ranked, key=lambda found: found[0])]
