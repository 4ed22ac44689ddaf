"""Compilation of this room's water: numba, NaN stays NaN, the entry points kept on disk under a hash of all inlined code."""

import hashlib
from pathlib import Path
from typing import Any

from numba import njit

_MATH: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}
inlined = njit(**_MATH)


def entry(function):
    """Compiles and keeps the function that Python calls; numba itself would notice a change of that one file only."""
    here = Path(__file__).resolve().parent
    names = ("compiled", "chain", function.__module__.rpartition(".")[2])
    digest = hashlib.sha256(b"".join((here / f"{name}.py").read_bytes() for name in names)).hexdigest()[:16]
    function.__qualname__ = f"{function.__qualname__}_{digest}"
    return njit(cache=True, nogil=True, **_MATH)(function)
