"""The pages of docs/ and the changelog: short lines, short cells, history in one place, no name of code that is not there."""

import ast
import re
import runpy
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("*.md"))]
LINE, CELL = 160, 120  # characters
HISTORY = re.compile(r"what was wrong before|(^|[.(] ?)before that\b|by a recipe before|\bas before\b|the search before", re.I)
MODULE = re.compile(r"(?<![\w./<>*-])((?:[\w-]+/)*[\w-]+\.py)\b")
NAME = re.compile(MODULE.pattern[:-2] + r":([A-Za-z_]\w*)")  # module.py:name
YOURS = re.compile(r"(path/to/)?file\.py|my_effects\.py|.*\b(NAME|test_x)\.py")  # what a reader would write


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
    told = [
        f"{page}:{n}: {text.strip()[:80]}" for page, n, text in lines() if HISTORY.search(text) and page.name != "CHANGELOG.md"
    ]
    assert not told, "\n".join(["a page says how it is, CHANGELOG.md how it was", *told])


@cache
def modules() -> dict[str, list[Path]]:
    """Every way to name a file of Python by the end of its path -> those files."""
    found: dict[str, list[Path]] = {}
    for room in ("fishmj", "studies", "tests", "examples", ".ci", "docs"):
        for path in (ROOT / room).rglob("*.py"):
            parts = path.relative_to(ROOT).parts
            for i in range(len(parts)):
                found.setdefault("/".join(parts[i:]), []).append(path)
    return found


@cache
def names_in(path: Path) -> set[str]:
    """Functions, classes and constants that a module defines, those inside others too."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    named = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return named | {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def test_every_module_that_a_page_names_is_there():
    named = [(page, number, name) for page, number, text in lines() for name in MODULE.findall(text)]
    assert len(named) > 100, "the pattern finds the names"
    gone = [f"{page}:{number}: {name}" for page, number, name in named if not (name in modules() or YOURS.fullmatch(name))]
    assert not gone, "\n".join(["no such file", *gone])


def test_every_function_that_a_page_names_is_there():
    named = [(page, number, *found) for page, number, text in lines() for found in NAME.findall(text)]
    assert len(named) > 20, "the pattern finds the names"
    gone = [
        f"{page}:{number}: {module}:{name}"
        for page, number, module, name in named
        if not (YOURS.fullmatch(module) or any(name in names_in(path) for path in modules().get(module, [])))
    ]
    assert not gone, "\n".join(["no such name", *gone])


@cache
def shape() -> dict:
    """Functions of .ci/shape.py, which counts the package's size and language."""
    return runpy.run_path(str(ROOT / ".ci" / "shape.py"))


def sources() -> dict[str, ast.Module]:
    paths = [path for folder in ("fishmj", "studies") for path in sorted((ROOT / folder).rglob("*.py"))]
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def test_docstrings_begin_with_a_verb_or_a_noun():
    """Never with a relative word, which makes the reader guess the subject."""
    assert shape()["riddles"](ast.parse('def f():\n    """What a fish is."""')) == ["What a fish is."]
    found = [f"{name}: {line}" for name, tree in sources().items() for line in shape()["riddles"](tree)]
    assert not found, "\n".join(["begin with a verb in the third person, or the noun that is returned", *found])


def test_public_functions_have_docstrings():
    found = [f"{name}: {each}" for name, tree in sources().items() for each in shape()["undocumented"](tree.body)]
    assert len(found) <= 20, "\n".join(found)
