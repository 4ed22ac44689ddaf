"""Size and shape of the package in figures: `python .ci/shape.py [FOLDER]`; FOLDER is a checkout, this one when none is given.

lines       of fishmj/, blank lines and docstrings included
entries     of `ls fishmj`
floors      longest chain of imports inside the package; a circle is one floor
doubled     names of files, and of public classes, that occur more than once
docstrings  that begin with a relative word (`RELATIVE`); public functions and classes without one
words       of README, CONTRIBUTING and docs/
"""

import ast
import json
import statistics
import sys
from collections import Counter
from pathlib import Path

RELATIVE = ("What", "Of", "Whether", "Where", "How", "As")  # first words of a docstring that make a riddle of it


def modules(root: Path) -> dict[str, ast.Module]:
    """Dotted name -> syntax tree, of every module of the package."""
    found = {}
    for path in sorted((root / "fishmj").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def riddles(tree: ast.AST) -> list[str]:
    """First lines of docstrings that begin with a word of `RELATIVE`."""
    told = [
        text.strip().partition("\n")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node))
    ]
    return [line for line in told if line.split()[0].rstrip(",:") in RELATIVE]


def undocumented(body: list[ast.stmt]) -> list[str]:
    """Public functions and classes without a docstring, methods included."""
    found = []
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            found += [] if ast.get_docstring(node) else [node.name]
            found += undocumented(node.body) if isinstance(node, ast.ClassDef) else []
    return found


def imports(name: str, tree: ast.Module, known: set[str]) -> set[str]:
    """Modules of the package that one imports when it is imported; what its functions import does not count."""
    found = set()
    inside = {n for f in ast.walk(tree) if isinstance(f, ast.FunctionDef | ast.Lambda) for n in ast.walk(f)}
    for node in ast.walk(tree):
        if node in inside:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {part if part in known else node.module for part in parts}
    return (found & known) - {name}


def components(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components, importers last (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    done: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for there in sorted(graph[name]):
            if there not in index:
                visit(there)
                low[name] = min(low[name], low[there])
            elif there in stack:
                low[name] = min(low[name], index[there])
        if low[name] == index[name]:
            at = stack.index(name)
            done.append(stack[at:])
            del stack[at:]

    for name in graph:
        if name not in index:
            visit(name)
    return done


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """Floor of each module: 1 imports nothing of the package."""
    floor: dict[str, int] = {}
    for group in components(graph):
        below = [floor[there] for name in group for there in graph[name] if there not in group]
        floor |= dict.fromkeys(group, 1 + max(below, default=0))
    return floor


def defined(node: ast.stmt) -> list[str]:
    """Names that a statement at the top of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def shape(root: Path) -> dict:
    """The figures of a checkout."""
    trees = modules(root)
    graph = {name: imports(name, tree, set(trees)) for name, tree in trees.items()}
    functions = {
        f"{name}:{f.name}": (f.end_lineno or 0) - f.lineno + 1
        for name, tree in trees.items()
        for f in ast.walk(tree)
        if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    classes = [c.name for tree in trees.values() for c in ast.walk(tree) if isinstance(c, ast.ClassDef)]
    public = [name for tree in trees.values() for node in tree.body for name in defined(node) if not name.startswith("_")]
    files = list((root / "fishmj").rglob("*.py"))
    stems = Counter(path.stem for path in files if not path.stem.startswith("__"))
    rooms = sorted(path.name for path in (root / "fishmj").iterdir() if (path / "__init__.py").exists())
    room_count = Counter((path.relative_to(root).parts[1], path.stem) for path in files if not path.stem.startswith("__"))
    pages = [*(root / "docs").rglob("*.md"), root / "README.md", root / "CONTRIBUTING.md"]
    floor = floors(graph)
    longest = max(functions, key=lambda key: functions[key])
    return {
        "lines": sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files),
        "entries": len([path for path in (root / "fishmj").iterdir() if path.name != "__pycache__"]),
        "words": sum(len(path.read_text(encoding="utf-8").split()) for path in pages),
        "docstrings_relative": sum(len(riddles(tree)) for tree in trees.values()),
        "public_without_docstring": sum(len(undocumented(tree.body)) for tree in trees.values()),
        "files": len(files),
        "classes": len(classes),
        "public_names": len(public),
        "function_median": statistics.median(functions.values()),
        "function_longest": [longest, functions[longest]],
        "functions_over_80": sum(length > 80 for length in functions.values()),
        "floors": max(floor.values()),
        "floors_by_room": {room: len({floor[m] for m in trees if m.split(".")[1:2] == [room]}) for room in rooms},
        "circles": [sorted(group) for group in components(graph) if len(group) > 1],
        "doubled_files": {stem: count for stem, count in sorted(stems.items()) if count > 1},
        "doubled_files_in_one_room": {f"{room}/{stem}": n for (room, stem), n in sorted(room_count.items()) if n > 1},
        "doubled_classes": {name: n for name, n in sorted(Counter(classes).items()) if n > 1 and not name.startswith("_")},
    }


if __name__ == "__main__":
    print(json.dumps(shape(Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()), indent=1))
