"""Compilation of this room's loops: numba, vectorised sums, NaN stays NaN, the entry point cached on disk.

The loops allocate nothing, so reference counting is off (`_nrt`). With it, passing the groups of arrays from function to function
costs five times the physics. Everything is inlined into the one cached entry point. numba would notice a change of that one file
only, so the entry point's cache name holds a hash of all inlined code.
"""

import hashlib
from pathlib import Path
from typing import Any

from numba import njit

_MATH: dict[str, Any] = {"fastmath": {"contract", "nsz", "reassoc", "arcp"}, "error_model": "numpy", "_nrt": False}
INLINED = ("chain", "loop", "numba_entry", "servo", "water")  # files with compiled functions
compiled = njit(forceinline=True, **_MATH)


def entry(function):
    """Compiles and caches the function that Python calls."""
    here = Path(__file__).resolve().parent
    digest = hashlib.sha256(b"".join((here / f"{name}.py").read_bytes() for name in INLINED)).hexdigest()[:16]
    function.__qualname__ = f"{function.__qualname__}_{digest}"
    return njit(cache=True, nogil=True, **_MATH)(function)
