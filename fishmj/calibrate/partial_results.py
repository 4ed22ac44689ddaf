"""Finished parts of a long calibration (swims of the solver, robots drawn anew), kept: the same command goes on with the rest.

One JSON file a part, written when it is finished. A part of other settings or another version of this package is done again.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from fishmj import interrupt
from fishmj.errors import StoreError
from fishmj.source import package_sha256
from fishmj.store import plain, read_json, write_json


class PartialResults:
    """The parts of one command. folder: where they are; about: what all of them depend on, besides the package's own code."""

    def __init__(self, folder: Path, about: dict):
        self.folder = folder
        self.key = hashlib.sha256(json.dumps(plain([about, package_sha256()]), sort_keys=True).encode()).hexdigest()

    def find(self, name: str) -> Any:
        """What a finished part gave, as JSON has it; None where it is not finished."""
        path = self.folder / f"{name}.json"
        try:
            row = read_json(path) if path.is_file() else {}
        except StoreError:  # damaged: done again
            return None
        return row.get("found") if isinstance(row, dict) and row.get("key") == self.key else None

    def keep(self, name: str, found: Any) -> Any:
        """Write what a part gave; returns it as `find` would."""
        write_json(self.folder / f"{name}.json", {"key": self.key, "found": found})
        return self.find(name)

    def words(self, names: list[str], what: str) -> str:
        """What an interrupted command says. names: of all its parts; what: they are."""
        done = sum(self.find(name) is not None for name in names)
        return f"{self.folder} holds {done} of {len(names)} {what}; {interrupt.again()}"
