"""Which solver made a segment: the sha256 of the code of its physics, comments and docstrings left out.

Segments of two solvers do not belong into one data set: a repair of the collision moves every force.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

from fishmj import lbm_oracle

PHYSICS = (
    *("body", "boundaries", "boundary", "collide", "coupling", "delta", "fluid", "immersed", "inflow", "lattice", "markers"),
    *("solve", "stream", "substep", "units"),
)


@cache
def solver_sha256() -> str:
    """Of the modules in `PHYSICS`."""
    folder = Path(str(lbm_oracle.__file__)).parent
    total = hashlib.sha256()
    for name in PHYSICS:
        total.update(f"\0{name}\0{code_of((folder / f'{name}.py').read_text(encoding='utf-8'))}".encode())
    return total.hexdigest()


def code_of(source: str) -> str:
    """A module's source without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree)
