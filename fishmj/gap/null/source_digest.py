"""Which code decides a result that is kept on disk: the source of modules and of all of fishmj that they import.

    digest("fishmj.gap.models.swimming_fish")      changes with any of these files

Imports are read off the source, those inside functions too, so that no list has to be kept by hand. A package counts by its
`__init__.py` and by what of it is imported; modules that are found by name at run time (the effects of the catalogue) do not.
"""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import fishmj

ROOT = Path(fishmj.__file__).resolve().parent


@cache
def digest(*modules: str) -> str:
    """Hash of the source of `modules` (dotted names within fishmj) and of everything in fishmj that they import."""
    files = reached(*modules)
    text = b"".join(name.encode() + b"\0" + files[name].read_bytes() + b"\0" for name in sorted(files))
    return hashlib.sha256(text).hexdigest()[:16]


def reached(*modules: str) -> dict[str, Path]:
    """Module -> file, of `modules` and everything in fishmj that they import."""
    todo, found = list(modules), {}
    while todo:
        name = todo.pop()
        path = None if name in found else _file(name)
        if path is not None:
            found[name] = path
            todo += [*_imports(path), name.rpartition(".")[0]]
    return found


def _file(name: str) -> Path | None:
    """Where a module of fishmj lives; None for other names, such as a function of a module."""
    first, *rest = name.split(".")
    place = ROOT.joinpath(*rest)
    files = (place / "__init__.py", place.with_suffix(".py")) if first == "fishmj" else ()
    return next((path for path in files if path.is_file()), None)


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
