"""Rows on disk while the fish swims: only appended, so the tenth minute costs as much as the first.

    FOLDER/meta.toml            of the trial, as far as it is known; rewritten only if it changed
    FOLDER/journal/layout.json  {"zero": s, "columns": {table: [column, ..]}}
    FOLDER/journal/TABLE.f64    rows of little-endian float64 in the order of the columns

The trial folder replaces all that when the swim ends. If the host was killed, `fishmj deploy recover FOLDER` makes it from the
journal. An incomplete row, as left by a full disk, is dropped.
"""

import fcntl
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import parse_toml
from fishmj.base.errors import StoreError
from fishmj.base.store import read_json, write_json, write_text
from fishmj.log.trial_folder import JOURNAL as NAME
from fishmj.log.trial_folder import META_FILE, checked_meta

LAYOUT, SUFFIX, LOCK = "layout.json", ".f64", "lock"
FLOAT = np.dtype("<f8")


class Left(NamedTuple):
    """Content of a journal. zero: host's time at the trial's time 0, s. columns, rows: of each table, (n, C)."""

    meta: dict[str, Any]
    zero: float
    columns: dict[str, tuple[str, ...]]
    rows: dict[str, np.ndarray]


class Journal:
    """The journal of a running swim.

    Args:
        folder: of the trial; is made. zero: s of the host's clock. columns: of every table.

    Raises StoreError: the disk refuses.
    """

    def __init__(self, folder: Path, zero: float, columns: Mapping[str, Sequence[str]]):
        self.folder, self.zero, self.columns = folder, zero, {name: tuple(names) for name, names in columns.items()}
        self._files: dict[str, Any] = {}
        self._meta: dict[str, Any] = {}
        self._lock: int | None = None
        try:
            (folder / NAME).mkdir(parents=True, exist_ok=True)
            self._lock = _locked(folder)
        except OSError as error:
            raise StoreError(f"{folder}: no journal of the swim: {error.strerror or error}") from error
        write_json(folder / NAME / LAYOUT, {"zero": zero, "columns": self.columns})

    def tell(self, meta: Mapping[str, Any]) -> None:
        """Writes the meta data if they changed. Raises StoreError, LogError."""
        if meta != self._meta:
            write_text(self.folder / META_FILE, checked_meta(self.folder, dict(meta)))
            self._meta = dict(meta)

    def append(self, name: str, rows: np.ndarray) -> None:
        """Appends rows (n, C) of a table: all of them or none. Raises StoreError."""
        try:
            file = self._files.get(name) or self._files.setdefault(name, _opened(self.folder, name))
            begin = file.seek(0, os.SEEK_END)
            try:
                file.write(np.ascontiguousarray(rows, FLOAT).tobytes())
                os.fsync(file.fileno())
            except OSError:
                file.truncate(begin)
                raise
        except OSError as error:
            raise StoreError(f"{self.folder}: rows of {name}: {error.strerror or error}") from error

    def rows(self) -> dict[str, np.ndarray]:
        """All rows so far, (n, C) of each table. Raises StoreError."""
        return _rows(self.folder, self.columns)

    def close(self) -> None:
        """Closes the files, which stay. May be called twice."""
        for file in self._files.values():
            file.close()
        self._files.clear()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def left(folder: Path) -> Left:
    """Reads the journal of a swim in `folder`.

    Raises StoreError: there is no journal, it is damaged, or its host is still running.
    """
    if not (folder / NAME / LAYOUT).is_file():
        whole = f"{folder}: a whole trial; nothing to recover"
        raise StoreError(whole if (folder / META_FILE).is_file() else f"{folder}: no journal of a swim; expected {NAME}/{LAYOUT}")
    try:
        os.close(_locked(folder))
    except OSError as error:
        raise StoreError(f"{folder}: its swim is still under way; the trial is there once it has ended") from error
    layout = read_json(folder / NAME / LAYOUT)
    try:
        zero, columns = float(layout["zero"]), {str(name): tuple(map(str, names)) for name, names in layout["columns"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StoreError(f"{folder / NAME / LAYOUT}: no layout of a journal; expected zero and columns") from error
    meta = folder / META_FILE
    known = parse_toml(meta.read_text(encoding="utf-8"), str(meta)) if meta.is_file() else {}
    return Left(known, zero, columns, _rows(folder, columns))


def _rows(folder: Path, columns: Mapping[str, Sequence[str]]) -> dict[str, np.ndarray]:
    found = {}
    for name, names in columns.items():
        file = folder / NAME / f"{Path(name).name}{SUFFIX}"
        if not file.is_file():
            continue
        try:
            numbers = np.fromfile(file, FLOAT)
        except OSError as error:
            raise StoreError(f"{file}: cannot be read: {error.strerror or error}") from error
        whole = len(numbers) // len(names)
        found[name] = numbers[: whole * len(names)].reshape(whole, len(names)).astype(float)
    return found


def _opened(folder: Path, name: str) -> Any:
    return open(folder / NAME / f"{name}{SUFFIX}", "ab", buffering=0)  # noqa: SIM115  stays open for the swim


def _locked(folder: Path) -> int:
    """Handle that locks the journal for one process, until it ends in any way. Raises OSError if another process holds it."""
    handle = os.open(folder / NAME / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        with suppress(OSError):
            os.close(handle)
        raise
    return handle
