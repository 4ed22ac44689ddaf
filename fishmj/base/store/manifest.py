"""`manifest.json`: the sha256 of every file of a folder, to name changed or missing ones; and the paths of shipped files.

Shipped files lie in `data/` of a checkout, or in `_data` of an installed package, which holds those that verbs open on their own.
"""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from fishmj.base.calib import FOLDERS, ROOTS
from fishmj.base.errors import StoreError
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store.atomic import read_json, write_json

MANIFEST = "manifest.json"
SOURCES = "in a checkout or the source distribution (sdist)"


def sha256(path: str | Path) -> str:
    """Hex digest of a file's bytes."""
    if why := why_unreadable(path):
        raise StoreError(f"{path}: {why}")
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error


def json_sha256(value: Any) -> str:
    """Hex digest of a value as JSON with its keys sorted; what JSON does not know counts as its text."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


@dataclass(frozen=True)
class Change:
    """One file that differs from the manifest. `got` is None if it is missing."""

    path: str
    expected: str
    got: str | None

    def __str__(self) -> str:
        return f"{self.path}: expected sha256 {self.expected}, got {self.got or 'no such file'}"


@dataclass(frozen=True)
class Manifest:
    """sha256 of every file of a folder (`manifest.json` itself and hidden files left out), with free-form `meta`."""

    files: dict[str, str]
    meta: dict = field(default_factory=dict)

    @classmethod
    def of(cls, folder: str | Path, meta: dict | None = None) -> "Manifest":
        """Hashes the present files of `folder`."""
        folder = Path(folder)
        names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
        kept = [n for n in names if n != MANIFEST and not any(part.startswith(".") for part in PurePosixPath(n).parts)]
        return cls({name: sha256(folder / name) for name in kept}, dict(meta or {}))

    @classmethod
    def read(cls, folder: str | Path) -> "Manifest":
        """Reads `folder/manifest.json`; paths that leave the folder are refused."""
        path = Path(folder) / MANIFEST
        table = read_json(path)
        files = table.get("files") if isinstance(table, dict) else None
        if not isinstance(files, dict) or not all(isinstance(v, str) for v in files.values()):
            raise StoreError(
                f'{path}: expected {{"files": {{path: sha256}}}}; write it again with Manifest.of(folder).write(folder)'
            )
        for name in files:
            if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                raise StoreError(f"{path}: {name!r} points outside the folder")
        meta = table.get("meta")
        return cls(dict(files), meta if isinstance(meta, dict) else {})

    def write(self, folder: str | Path) -> Path:
        """Writes `folder/manifest.json` atomically."""
        return write_json(Path(folder) / MANIFEST, {"meta": self.meta, "files": self.files})

    def check(self, folder: str | Path) -> list[Change]:
        """Missing and changed files, in the manifest's order; empty if nothing changed."""
        changes = []
        for name, expected in self.files.items():
            path = Path(folder) / name
            got = sha256(path) if path.is_file() else None
            if got != expected:
                changes.append(Change(name, expected, got))
        return changes

    def verify(self, folder: str | Path) -> None:
        """Raises one `StoreError` that lists every change."""
        if changes := self.check(folder):
            lines = "\n  ".join(map(str, changes))
            count = f"{len(changes)} of {len(self.files)} files"
            raise StoreError(f"{folder}: {count} missing or changed:\n  {lines}\n  restore them or write them again")


def shipped(path: str | Path) -> Path:
    """A path such as `data/gap/lbm/nulls`: in the working directory, else in the shipped data, else as given."""
    path = Path(path)
    below = path.parts[1:] if path.parts[:1] == ("data",) and not path.exists() else ()
    return next((root.joinpath(*below) for root in ROOTS if below and root.joinpath(*below).exists()), path)


def left_out(path: str | Path) -> str:
    """End of an error message: source of the `data/` that the package leaves out; "" in a checkout, or for other paths."""
    if FOLDERS[0].is_dir() or Path(path).parts[:1] != ("data",):
        return ""
    return f"; fishmj's own data/ is whole {SOURCES} only"
