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
# hashes of later code -> that of the code which made the shipped segments: all results are equal to the bit on a CPU, with three
# exceptions. `SECTORS` in refined water: nodes have other numbers and markers their round-off, 1e-9. From `SHORT` on: the eddy
# viscosity reads rounded velocities, 5e-6 of a wrench, 1e-7 of a velocity after 200 steps, as much as on another device. And
# `STAYING`
SHIPPED = "0dab6aa94d79eb497cd8e8f0b49aca3effdda76c17720fbef289d83c3ccb22d5"
REBUILT = "5b74e20cd51e912ce1b0b1c66d25d332fdae82f16d3b82799695029cd466b422"
ANY_LINKS = "5990401b1fdb88dc638e8c5d6e7d9e0ff001677f372f9dc87b5aa1155fa9f9a2"  # one solve for any number of links
TWO_LEVELS = "e9b7b5df01ae327b9c422e7ca271641f62f2db389de9f6afc2d157063a79f5ea"  # ticks done again, on two levels too
QUICKER = "0e63acdfdad8f2d9bac570118892d127a48684438947c61699655a92137077b1"  # two cells a thread, a tick in one graph
AHEAD = "6cb595be3e1f8b9a4770058ae4507856de4f514bf90aee8b3ac81a473a83b584"  # a tick ahead of the host, on a GPU
LISTED = "27ff9448df17743150b4eafb663e9f9264b8bf567b43721429792f6ba33006f8"  # lists of what levels exchange, short sums on a GPU
SECTORS = "6a3e1a55735965626466d32617474f2f2124ef1cb8d3bb52d46916a3841214b0"  # rows of a box in whole sectors of the memory
SHORT = "c63b5116c9559a46382897a7ee2f9759b3ea29edb743ac06f51b4422d0969719"  # velocities in 16 bits; a held fish on the device
STREAMS = "0b62f72826c3f69cffcc5e1ec632c483d844b5ee2ad952876fb6f311a6f29445"  # a tick done again waits for its own tank only
EDGED = "8d1566379f522052afc1869614e2bd3c600135bae1a091e6c0ef7b90241a1b46"  # an option, edges of hulls; the rest to the bit
TREES = "a49ee31bb533b9700cbc0e882b344be74349a904f5cbd0fa116445696fbb3cc3"  # bodies of any shape, checks; a fish to the bit
CHECKED = "3f5d5c786db440eda181170c089b18802b7fee14a50425a13bee6734b368ec5e"  # every object and number is checked; to the bit
ROOMS = "e9e86576e9e2d74b532ae597dde80d9adbc213fc0e50627dc4d6cc974ec94984"  # imports of moved modules, no other line
# one generator for a coupled step, one class of run for all levels, one subgrid model, plain names; to the bit on a CPU
ONE_LOOP = "3fe611ac37e302d67b2ecb0e893490b86e9764493a8878f400bbcfcd5a9525ba"
# an option, a law of the wall; blocks of rows on a CPU; the rest to the bit
WALLS = "d878cfcd8e5cf6f0a8932c30321d06243572905713901643aa403a3dc090b236"
LAYERS = "40b752a4b504c515a2b77bae0882d6b4f2c55536e0accb47bb0f314f7c3a6c87"  # an option, layers on sheets; the rest to the bit
# kernels of other widths, and another law of the wall (`SAME_LAW`); the rest to the bit
SPREAD = "3cf54951701cf4e9b94d0421e003b02d83bd3b8c60d8d8f147a58ccd5ad0c93a"
STRIPS = "fd800b9bc1b98f70f59f79be8e3c77f6c132131a16b94082d36bf562966f3e89"  # boxes in water one cell deep; the rest to the bit
ADVISED = "d891ef68f617eff224cdc76b455da9562231f5ad7e356bf55490d2a9bce79424"  # words of an error alone
# the slip length of hulls where water sticks; the rest to the bit
STICKING = "0f32fa9ac2aaf1fcf024c955ada5ea1525658a38fbafa98338a9f26b52017787"
# a repeated tick knows where its box of finer cells has moved; water without such a box to the bit
PLACED = "6278da82b0cfd38aa97e99455988d4276d925aa281d59f6b3bf7b59194f82cae"
# a tick that needs finer steps gives them to the second after it, too: a hard gait swims 2 % faster than in shipped segments, of
# which a tenth of all ticks had them; runs without such ticks to the bit
STAYING = "89c1f6dd28639777ed1da185fc0b75be3d5063c3a70769e710669c82e747bf12"
LATER = (REBUILT, ANY_LINKS, TWO_LEVELS, QUICKER, AHEAD, LISTED, SECTORS, SHORT, STREAMS, EDGED, TREES, CHECKED, ROOMS, ONE_LOOP)
SAME = dict.fromkeys((*LATER, WALLS, LAYERS, SPREAD, STRIPS, ADVISED, STICKING, PLACED, STAYING), SHIPPED)
# of segments with a law of the wall; SPREAD gives the water its force over a layer
SAME_LAW = {LAYERS: WALLS, STRIPS: SPREAD, ADVISED: SPREAD, STICKING: SPREAD, PLACED: SPREAD, STAYING: SPREAD}
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
