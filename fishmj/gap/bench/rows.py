"""Rows of a benchmark on disk, one JSON object a line: what is done is never done again."""

import json
from pathlib import Path


def kept(path: Path) -> list[dict]:
    """Whole lines of a file; a line that was cut off is done again."""
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
    """Add a row, on a line of its own even where the last one was cut off."""
    with path.open("ab+") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 1, 0))
        whole = file.read() in (b"", b"\n")
        file.write((b"" if whole else b"\n") + json.dumps(row).encode() + b"\n")
