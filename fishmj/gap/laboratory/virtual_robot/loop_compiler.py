"""Compiles the loops of this package: vectorised sums; NaN propagates.

The loops allocate nothing, so reference counting (`_nrt`) is off. With it, passing the array groups between functions takes five
times as long as the physics.
"""

from pathlib import Path

from fishmj.gap.laboratory.numba_entry import compilers

INLINED = ("chain", "constant_groups", "loop", "loop_compiler", "servo", "water")  # files with compiled functions or their tuples
FILES = [str(Path(__file__).with_name(f"{name}.py")) for name in INLINED]
MATH = {"fastmath": {"contract", "nsz", "reassoc", "arcp"}, "_nrt": False}
compiled, entry = compilers("the virtual robot", FILES, MATH, forceinline=True)
