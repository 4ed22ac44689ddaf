"""The pages of docs/ and the README: short lines, short cells, history in one place, no module named that is not there."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
LINE, CELL = 160, 120  # characters
HISTORY = re.compile(r"what was wrong before|(^|[.(] ?)before that\b|by a recipe before|\bas before\b|the search before", re.I)
MODULE = re.compile(r"(?<![\w./<>*-])((?:[\w-]+/)*[\w-]+\.py)\b")
YOURS = {"file.py", "path/to/file.py", "my_effects.py"}  # what a reader would write


def lines():
    """(page, number, text) of every line."""
    for page in PAGES:
        for number, text in enumerate(page.read_text(encoding="utf-8").split("\n"), 1):
            yield page.relative_to(ROOT), number, text


def cells(text: str) -> list[str]:
    """Cells of a row of a table, none of another line."""
    row = text.strip()
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", row.strip("|"))] if row.startswith("|") else []


def test_no_line_is_longer_than_a_screen():
    long = [f"{page}:{number}: {len(text)}" for page, number, text in lines() if len(text) > LINE]
    assert not long, "\n".join([f"limit {LINE} characters: make sentences of it", *long])


def test_no_cell_of_a_table_is_a_paragraph():
    long = [f"{page}:{n}: {len(cell)}: {cell[:60]}" for page, n, text in lines() for cell in cells(text) if len(cell) > CELL]
    assert not long, "\n".join([f"limit {CELL} characters: say the rest below the table", *long])


def test_history_stands_in_the_changelog_alone():
    told = [f"{page}:{number}: {text.strip()[:80]}" for page, number, text in lines() if HISTORY.search(text)]
    assert not told, "\n".join(["a page says how it is, CHANGELOG.md how it was", *told])


def test_every_module_that_a_page_names_is_there():
    rooms = [ROOT / name for name in ("fishmj", "tests", "examples", ".ci", "docs")]
    paths = [path.relative_to(ROOT).parts for room in rooms for path in room.rglob("*.py")]
    known = {"/".join(parts[i:]) for parts in paths for i in range(len(parts))}
    named = [(page, number, name) for page, number, text in lines() for name in MODULE.findall(text)]
    assert len(named) > 100, "the pattern finds the names"
    gone = [f"{page}:{number}: {name}" for page, number, name in named if name not in known | YOURS]
    assert not gone, "\n".join(["no such file", *gone])
