"""Finished runs of a study as rows of a table on disk; the same command does the missing ones."""

import csv
from collections.abc import Callable, Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import read_json, write_json, write_text
from fishmj.lbm_oracle.run.spread import Work, spread

TEXTS = ("what", "status")  # columns that hold no number
OK = "ok"  # status of a run that did all its ticks


class FinishedRows:
    """Rows in a CSV, replaced as a whole with every row, beside the set-up that they share in `setup.json`.

    Args:
        columns: the first `keyed` of them are a row's key. source: command that made the rows.

    Raises ConfigError: the folder holds another set-up; StoreError: a file there is damaged.
    """

    def __init__(self, path: Path, columns: Sequence[str], keyed: int, setup: dict, source: str):
        self.path, self.columns, self.about = path, columns, path.with_name("setup.json")
        self.notes = {"source": f"fishmj.lbm_oracle {source}", "origin": "synthetic", "setup": setup}
        self.rows: dict[tuple, dict] = {}
        if path.exists():
            self._check(setup)
            self.rows = {tuple(row[name] for name in columns[:keyed]): row for row in self._read()}

    def _check(self, setup: dict) -> None:
        before = read_json(self.about).get("setup", {})
        names = [key for key in {**before, **setup} if before.get(key) != setup.get(key)]
        if names:
            other = ", ".join(f"{key} = {before.get(key)} (now {setup.get(key)})" for key in names)
            raise ConfigError(f"{self.path.parent} holds rows of another set-up: {other}. Take another --out")

    def _read(self) -> Iterator[dict]:
        with self.path.open(encoding="utf-8", newline="") as file:
            for number, row in enumerate(csv.DictReader(file), 2):
                try:
                    yield {name: row[name] if name in TEXTS else float(row[name]) for name in self.columns}
                except (KeyError, TypeError, ValueError) as error:
                    raise StoreError(f"{self.path}:{number}: {error!r}; delete the line, its run is then done again") from error

    def add(self, key: Any, found: dict) -> None:
        """Keeps a row; it is on disk before this returns."""
        if not self.rows:
            write_json(self.about, self.notes)
        self.rows[key] = dict(zip(self.columns, key, strict=False)) | found
        text = StringIO()
        writer = csv.DictWriter(text, self.columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows[k] for k in sorted(self.rows))
        write_text(self.path, text.getvalue())


def keep_rows(
    book: FinishedRows, work: Work, left: Sequence, devices: Sequence[str],
    total: float, seconds: Callable[[Any], float], title: str, quiet: bool,
) -> None:  # fmt: skip
    """Does the runs that are left and keeps their (key, row) as they come, with a line of progress in simulated seconds.

    work, left, devices: as of `spread`. total: s of all. seconds: of a key.
    """
    done = 0.0
    with console.Progress(max(total, 1e-9), title, unit="s", every=1e9 if quiet else None) as bar:

        def told(under_way: float) -> bool:
            bar.update(min(done + under_way, total))
            return True

        for key, found in spread(work, left, devices, told):
            book.add(key, found)
            done += seconds(key)
