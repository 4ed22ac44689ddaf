"""Atomic writes: the old file or the new one, never a part.

A write goes to a temporary file in the target's folder, is flushed and fsynced, renamed over the target in one step
(POSIX rename is atomic) and the folder is fsynced. Every failure is a `StoreError` that names the file and what to do;
a full disk also says how many bytes were needed.
"""

import errno
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from fishmj.base import interrupt
from fishmj.base.console import plain
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store.temporary import temporary_beside

_FULL = (errno.ENOSPC, errno.EDQUOT)


def write_bytes(path: str | Path, data: bytes) -> Path:
    """Replaces `path` by `data` atomically; parent folders are made.

    Raises StoreError: could not be written; `errno` is kept, the old file is untouched, no temporary file stays.
    """
    path = Path(path)
    temporary = temporary_beside(path)
    with interrupt.writing:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            sync_folder(path.parent)
        except OSError as error:
            raise _write_error(path, error, len(data)) from error
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | Path, text: str) -> Path:
    """Replaces a UTF-8 text file atomically."""
    try:
        return write_bytes(path, text.encode("utf-8"))
    except UnicodeEncodeError as error:
        raise StoreError(f"{path}: text is not valid Unicode ({error}); remove lone surrogates") from error


def write_json(path: str | Path, value) -> Path:
    """Replaces a JSON file atomically. NumPy values become plain ones, NaN and infinity become null."""
    return write_text(path, json.dumps(plain(value), indent=1, ensure_ascii=False) + "\n")


def clear(folder: Path, *patterns: str) -> None:
    """Removes the results of an earlier run from `folder`: files and folders whose names match one of the globs, nothing else.

    Raises StoreError: one cannot be removed.
    """
    for path in [path for pattern in patterns for path in folder.glob(pattern)]:
        try:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        except OSError as error:
            raise StoreError(f"{path}: of an earlier run, cannot be removed ({error.strerror}); choose another folder") from error


def put_in_place(temporary: Path, place: Path) -> None:
    """Renames a finished file or folder to `place`; an existing folder is moved aside, and put back if the rename fails."""
    old = temporary_beside(place, ".old")
    if place.is_dir():
        os.rename(place, old)
    try:
        os.replace(temporary, place)
    except OSError:
        if old.exists():
            with suppress(OSError):
                os.rename(old, place)
        raise
    shutil.rmtree(old, ignore_errors=True)
    sync_folder(place.parent)


def sync_folder(folder: Path) -> None:
    """Makes renames inside `folder` durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_json(path: str | Path):
    """Parses one JSON file. Raises StoreError: missing, no plain file, or not JSON."""
    if why := why_unreadable(path):
        raise StoreError(f"{path}: {why}")
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path}: not valid JSON: {error}; write it again from its source") from error


def same_as_begun(path: Path, options: dict) -> None:
    """Keeps the options in `path`. Raises ConfigError: its folder was begun with others, whose results would be mixed."""
    if path.is_file() and (other := differing(plain(options), read_json(path), "{key} {theirs}, got {mine}")):
        raise ConfigError(f"{path.parent} was begun with {other}; repeat the options to go on, or take another --out")
    write_json(path, options)


def differing(mine: dict, theirs: Any, form: str, free: Sequence[str] = ()) -> str:
    """Text of the first three values that differ between two nested tables, and how many more; "" if none does.

    form: format of one, with {key}, {mine} and {theirs}. free: names that may differ.
    """
    a, b = dict(leaves(mine)), dict(leaves(theirs))
    other = [key for key in {**b, **a} if a.get(key) != b.get(key) and key not in free]
    shown = lambda value: "not set" if value is None else f"{value!s:.40}"
    each = [form.format(key=key, mine=shown(a.get(key)), theirs=shown(b.get(key))) for key in other[:3]]
    return "; ".join(each) + (f" and {len(other) - 3} more" if len(other) > 3 else "")


def leaves(table: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yields names and values of a nested table: `{"task": {"memory": 8}}` has `task.memory`."""
    for key, value in table.items() if isinstance(table, dict) else [("", table)]:
        yield from leaves(value, f"{name}{key}.") if isinstance(value, dict) else [(f"{name}{key}", value)]


def _write_error(path: Path, error: OSError, needed: int) -> StoreError:
    if error.errno in _FULL:
        free = shutil.disk_usage(path.parent).free if path.parent.is_dir() else 0
        text = f"{path}: disk full: needs {needed} bytes, {free} free; the old file is untouched; free some space and save again"
    else:
        text = f"{path}: could not be written ({error.strerror or error}); needs {needed} bytes; the old file is untouched"
    failure = StoreError(text)
    failure.errno = error.errno
    return failure
