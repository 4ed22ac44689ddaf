"""Rows of a benchmark on disk, one JSON object a line: finished work is never repeated."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fishmj.base import console, cost, interrupt
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.base.workers import ask_all
from fishmj.gap import progress

ROUNDED = 1e-9  # relative; two draws of one effect differ by far more


def read_rows(path: Path) -> list[dict]:
    """Complete rows of a file; a truncated line is dropped, so that its case is repeated."""
    if not path.is_file():
        return []
    out = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            out.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return out


def finished_rows(out: Path | None) -> dict[str, dict]:
    """Existing rows by id."""
    return {row["id"]: row for row in read_rows(out / "rows.jsonl")} if out else {}


def rows_of_folders(folders: Iterable[Path], decided: Sequence[str]) -> list[dict]:
    """The rows of several folders, a case that two of them hold once.

    Raises ConfigError: two rows of one id differ in a `decided` entry, so that they are of two benchmarks.
    """
    rows: dict[str, dict] = {}
    for folder in folders:
        for row in read_rows(folder / "rows.jsonl"):
            other = rows.setdefault(row["id"], row)
            if not all(same(other.get(key), row.get(key)) for key in decided):
                where = f"--score {folder}: row {row['id']} is another case elsewhere"
                raise ConfigError(f"gap bench: {where}; score one benchmark at a time")
    return list(rows.values())


def refuse_other(row: dict, begun: Mapping[str, Any], folder: Path | None, option: str) -> None:
    """Raises ConfigError if a kept row differs from what its case begins with. option: what names another folder."""
    if differs := [key for key, value in begun.items() if not same(row.get(key), value)]:
        what = f"row {row['id']} differs in {', '.join(differs)}"
        raise ConfigError(f"gap bench: {folder} holds another benchmark: {what}; take another {option}, or the options of before")


def agree_to_time(seconds: float, left: int, jobs: int, agreed: bool, smaller: str = "--small") -> None:
    """Asks for agreement to weeks of work. seconds: of one core; smaller: the option that makes cases shorter.

    Raises TooMuch: not agreed.
    """
    less = f"take fewer --cases, {smaller}, more --jobs, or --shard I/N for several machines"
    cost.time("gap bench", seconds / min(jobs, usable_cores()), f"{left} cases", instead=less, flag="--yes", agreed=agreed)


def same(one: Any, other: Any) -> bool:
    """Returns True for equal entries of two rows; drawn numbers to `ROUNDED`, since processors differ in their last digits."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=ROUNDED)
    return one == other


def keep(path: Path, row: dict) -> None:
    """Appends a row, on a line of its own even after a truncated one."""
    with path.open("ab+") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 1, 0))
        whole = file.read() in (b"", b"\n")
        file.write((b"" if whole else b"\n") + json.dumps(row).encode() + b"\n")


def judge_cases(todo: list, out: Path | None, ask: Callable, jobs: int = 1, what: str = "bench") -> list[dict]:
    """Rows of all cases; those in `out` are read from there. what: name of the work, for the bar."""
    rows = finished_rows(out)
    if out:
        out.mkdir(parents=True, exist_ok=True)
    with interrupt.keeping(lambda: words(out, len(rows), len(todo))), progress.terminal_bar(len(todo), what, "cases") as bar:
        waiting = [one for one in todo if one.id not in rows]
        for i, row in enumerate(map(console.plain, ask_all(waiting, ask, jobs)), len(todo) - len(waiting) + 1):
            rows[row["id"]] = row
            if out:
                keep(out / "rows.jsonl", row)
            bar.update(i)
    return [rows[one.id] for one in todo]


def words(out: Path | None, done: int, of: int) -> str:
    """Message of an interrupted benchmark."""
    if out is None:
        return "nothing was kept: with --out DIR every finished case is"
    return f"{out} holds {done} of {of} cases; {interrupt.again()}"
