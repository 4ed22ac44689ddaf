"""Compiles the loops of this room: vectorised sums, NaN stays NaN.

The loops allocate nothing, so reference counting is off (`_nrt`): with it, handing the groups of arrays from function to function
costs five times the physics.
"""

from pathlib import Path

from fishmj.gap.laboratory.numba_entry import compilers

INLINED = ("chain", "constants", "loop", "loop_compiler", "servo", "water")  # files with compiled functions or their tuples
FILES = [str(Path(__file__).with_name(f"{name}.py")) for name in INLINED]
MATH = {"fastmath": {"contract", "nsz", "reassoc", "arcp"}, "_nrt": False}
compiled, entry = compilers("the virtual robot", FILES, MATH, forceinline=True)
