"""Hash of the solver that made a segment: the sha256 of the code of its physics, without comments and docstrings.

A data set must not mix segments of two solvers: a fix of the collision changes every force.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

from fishmj import lbm_oracle
from fishmj.lbm_oracle.immersed.markers import PLAIN, Sharpness
from fishmj.lbm_oracle.run.domain import Domain

PHYSICS = (
    *("fluid/collide", "fluid/domain_faces", "fluid/fluid", "fluid/inflow", "fluid/lattice", "fluid/pairs", "fluid/rows"),
    *("fluid/slabs", "fluid/step", "fluid/storage", "immersed/articulated_body", "immersed/body", "immersed/boundary"),
    *("immersed/coupling", "immersed/device_body", "immersed/device_steps", "immersed/early_water", "immersed/fsi_solve"),
    *("immersed/kernels", "immersed/marker_warps", "immersed/markers", "refined/crossings", "refined/exchange"),
    *("immersed/wall_law", "refined/refined_fluid", "refined/refined_structure", "run/time_refinement"),
)
# The present code has the results of the code that made the shipped segments, to the bit on a CPU, but for three things. The eddy
# viscosity reads velocities rounded to 16 bits: 5e-6 of a wrench, 1e-7 of a velocity after 200 steps, as much as on another
# device. Nodes of refined water have other numbers, and markers their round-off, 1e-9. And a tick that needs finer steps gives
# them to the second after it, too: a hard gait swims 2 % faster than in shipped segments, of which a tenth of all ticks had them
SHIPPED = "0dab6aa94d79eb497cd8e8f0b49aca3effdda76c17720fbef289d83c3ccb22d5"
# of segments with a law of the wall, since it gives the water its force over a layer
SPREAD = "3cf54951701cf4e9b94d0421e003b02d83bd3b8c60d8d8f147a58ccd5ad0c93a"
PRESENT = "89c1f6dd28639777ed1da185fc0b75be3d5063c3a70769e710669c82e747bf12"
# hash of the present code -> that of the code whose results it has; a change that changes no result replaces `PRESENT`
SAME = {PRESENT: SHIPPED}
SAME_LAW = {PRESENT: SPREAD}  # of segments with a law of the wall
SAME_REFINED: dict[str, str] = {}  # of water with boxes of finer cells


@cache
def solver_sha256(domain: Domain | None = None, sharpness: Sharpness = PLAIN) -> str:
    """sha256 of the modules in `PHYSICS`; if no result changed, still that of the code before the change.

    domain, sharpness: of the water; the results of boxes of finer cells and of laws of the wall changed where others' did not.
    """
    folder = Path(str(lbm_oracle.__file__)).parent
    total = hashlib.sha256()
    for name in PHYSICS:
        total.update(f"\0{name}\0{code_of((folder / f'{name}.py').read_text(encoding='utf-8'))}".encode())
    refined, law = domain is not None and domain.fine is not None, sharpness.law_height is not None
    return (SAME_REFINED if refined else SAME_LAW if law else SAME).get(total.hexdigest(), total.hexdigest())


def code_of(source: str) -> str:
    """Source of a module without comments, docstrings and layout; the same under every version of Python.

    `ast.unparse` and `ast.dump` are not: one writes f-strings another way, the other names new, empty fields.
    """
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return repr(_plain(tree))


def _plain(node):
    """Syntax tree as nested tuples, without empty fields."""
    if isinstance(node, ast.AST):
        fields = ((name, _plain(value)) for name, value in ast.iter_fields(node) if name not in ("ctx", "kind"))
        return (type(node).__name__, *((name, value) for name, value in fields if value not in (None, ())))
    if isinstance(node, list):
        return tuple(_plain(item) for item in node)
    return node
