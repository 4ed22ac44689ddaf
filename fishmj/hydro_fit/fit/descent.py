"""A loop of a fit that goes on where it was broken off: its state is kept now and then, and when the command is interrupted.

    k, state = loop.begin(state)            from its first step, or from where it was broken off
    for k in range(k, steps): ...; loop.after(k + 1, state)

What is kept is every array to the bit, so the end is the one of a loop that nobody broke off.
"""

import time
from pathlib import Path
from threading import Lock
from typing import Any

import jax
import numpy as np

from fishmj.errors import StoreError
from fishmj.store import read_tensors, write_tensors

EVERY = 30.0  # s between two times that the state is written


class Loop:
    """One loop. path: of its file, None keeps nothing. key: of what it depends on; a file of another key is not gone on with."""

    def __init__(self, path: Path | None = None, key: str = ""):
        self.path, self.key = path, key
        self._newest: tuple[int, Any] | None = None
        self._written, self._lock = time.monotonic(), Lock()

    def begin(self, state: Any) -> tuple[int, Any]:
        """Steps done and the state after them; `state` itself where nothing fits."""
        if self.path is None or not self.path.is_file():
            return 0, state
        try:
            arrays, meta = read_tensors(self.path)
        except StoreError:  # damaged: from the first step
            return 0, state
        leaves, tree = jax.tree_util.tree_flatten(state)
        kept = [arrays.get(f"{i}") for i in range(len(leaves))]
        if meta.get("key") != self.key or len(arrays) != len(leaves):
            return 0, state
        if any(a is None or a.dtype != np.asarray(b).dtype for a, b in zip(kept, leaves, strict=True)):
            return 0, state
        return int(meta["step"]), jax.tree_util.tree_unflatten(tree, kept)

    def after(self, step: int, state: Any) -> None:
        """`step` steps are done; the state's arrays are never written into again."""
        self._newest = step, state
        if time.monotonic() - self._written > EVERY:
            self.save()

    def save(self) -> None:
        """Write the newest state; from any thread."""
        newest = self._newest
        if self.path is None or newest is None:
            return
        with self._lock:
            step, state = newest
            leaves = jax.tree_util.tree_leaves(state)
            write_tensors(self.path, {f"{i}": np.asarray(a) for i, a in enumerate(leaves)}, {"key": self.key, "step": step})
            self._written = time.monotonic()

    def end(self) -> None:
        """Done: what comes of it is kept elsewhere."""
        self._newest = None
        if self.path is not None:
            self.path.unlink(missing_ok=True)
