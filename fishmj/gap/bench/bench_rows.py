"""Rows of a benchmark on disk, one JSON object a line: finished work is never repeated."""

import json
from pathlib import Path


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


def keep(path: Path, row: dict) -> None:
    """Appends a row, on a line of its own even after a truncated one."""
    with path.open("ab+") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 1, 0))
        whole = file.read() in (b"", b"\n")
        file.write((b"" if whole else b"\n") + json.dumps(row).encode() + b"\n")
