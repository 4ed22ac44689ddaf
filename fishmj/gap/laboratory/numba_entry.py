"""Compiles a blind robot's water with numba: NaN propagates, entry points are cached on disk under a hash of their sources."""

import hashlib
import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from fishmj.base.errors import MissingExtra


def compilers(needed_for: str, files: Iterable[str], math: dict[str, Any], **inlining: Any) -> tuple[Callable, Callable]:
    """Returns the decorators of one robot: (inlined functions, entry points that Python calls).

    All functions are inlined into the cached entry points. numba detects a change of an entry point's own file only, so its
    cached name includes a hash of `files`, which hold the inlined functions. Raises MissingExtra: no numba for `needed_for`.
    """
    try:
        from numba import njit
    except ImportError as error:
        raise MissingExtra("numba", "fast", needed_for) from error
    math = {"error_model": "numpy", **math}

    def entry(function):
        """Compiles and caches a function that Python calls."""
        sources = (*files, __file__, inspect.getfile(function))
        digest = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources)).hexdigest()[:16]
        function.__qualname__ = f"{function.__qualname__}_{digest}"
        return njit(cache=True, nogil=True, **math)(function)

    return njit(**inlining, **math), entry
