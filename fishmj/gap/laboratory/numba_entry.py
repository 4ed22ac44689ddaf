"""Compiles the water of a blind robot: numba, NaN stays NaN, entry points cached on disk under a hash of all that is inlined."""

import hashlib
import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from fishmj.base.errors import MissingExtra


def compilers(needed_for: str, files: Iterable[str], math: dict[str, Any], **inlining: Any) -> tuple[Callable, Callable]:
    """(decorator of inlined functions, decorator of the functions that Python calls) of one robot.

    Everything is inlined into the cached entry points. numba would notice a change of an entry point's own file only, so its
    name in the cache holds a hash of `files` too, those with inlined functions. Raises MissingExtra: what is `needed_for` numba.
    """
    try:
        from numba import njit
    except ImportError as error:
        raise MissingExtra("numba", "fast", needed_for) from error
    math = {"error_model": "numpy", **math}

    def entry(function):
        """Compile and cache the function that Python calls."""
        sources = (*files, __file__, inspect.getfile(function))
        digest = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources)).hexdigest()[:16]
        function.__qualname__ = f"{function.__qualname__}_{digest}"
        return njit(cache=True, nogil=True, **math)(function)

    return njit(**inlining, **math), entry
