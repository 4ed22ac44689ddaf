"""Resumable training loops, optionally data-parallel over devices.

    k, state = loop.begin(state)            from its first step, or from the kept one
    for k in range(k, steps): ...; loop.after(k + 1, state)

The state is kept at intervals, and when the command is interrupted. Every array is kept to the bit, so a resumed loop ends like
an uninterrupted one. On several devices a loss's batch is sharded in equal parts, values and gradients are averaged:

    gradient_of = sharded(loss, devices)    value, gradient = gradient_of(net, *stacked(batches)), a batch for each device
    state = replicated(state, devices)      before the first step: on all devices, as the state after every step
"""

import os
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from fishmj.base.cores import usable_cores
from fishmj.base.errors import StoreError
from fishmj.base.store import read_tensors, write_tensors

EVERY = 30.0  # s between two times that the state is written
EXTRA = "--xla_backend_extra_options"  # in XLA_FLAGS: an environment that has it keeps its own
JOINED = "xla_cpu_use_multi_output_fusion"
MOST = 8  # devices: a batch of fewer than eight swims takes as long as one of eight


class Loop:
    """One loop. path: of its file, None keeps nothing. key: hash of its inputs; a file of another key is not resumed."""

    def __init__(self, path: Path | None = None, key: str = ""):
        self.path, self.key = path, key
        self._newest: tuple[int, Any] | None = None
        self._written, self._lock = time.monotonic(), Lock()

    def begin(self, state: Any) -> tuple[int, Any]:
        """Number of steps done and the state after them; 0 and `state` itself without a matching file."""
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
        """Notes that `step` steps are done; the state's arrays must not be written again."""
        self._newest = step, state
        if time.monotonic() - self._written > EVERY:
            self.save()

    def save(self) -> None:
        """Writes the newest state; may be called from any thread."""
        newest = self._newest
        if self.path is None or newest is None:
            return
        with self._lock:
            step, state = newest
            leaves = jax.tree_util.tree_leaves(state)
            write_tensors(self.path, {f"{i}": np.asarray(a) for i, a in enumerate(leaves)}, {"key": self.key, "step": step})
            self._written = time.monotonic()

    def end(self) -> None:
        """Removes the kept state of a finished loop, whose result is kept elsewhere."""
        self._newest = None
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def use_cores_as_devices() -> None:
    """Uses the CPU's cores as devices, and lets XLA join operations there; has no effect once JAX has started.

    A step of a swim is some 850 operations on a few fish: its cost is their number. On request (`JOINED`) XLA joins those that
    share their inputs: a gradient step takes less than half of the time, its compilation 0.7.
    """
    try:
        jax.config.update("jax_num_cpu_devices", min(MOST, usable_cores()))
    except RuntimeError:  # a backend is up already
        return
    flags = os.environ.get("XLA_FLAGS", "")
    if EXTRA not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {EXTRA}={JOINED}".strip()


def devices(*sizes: int) -> list:
    """Devices of this process, as many as divide all sizes."""
    available = jax.devices()[:MOST]
    return available[: next(n for n in range(len(available), 0, -1) if not any(size % n for size in sizes))]


@cache
def short_op_compiler_options(platform: str) -> dict | None:
    """Compiler options for a long loop of short operations; None if there are none, or this JAX no longer has them.

    JAX 0.10: compiled in 17 s in place of 42, a step takes 125 ms in place of 203. JAX 0.11 is as fast without, and so are both
    if operations are joined (`several`).
    """
    if platform != "cpu" or JOINED in os.environ.get("XLA_FLAGS", ""):
        return None
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return None
    return options


def mesh_of(shards: Sequence) -> Mesh:
    """Mesh of the devices side by side."""
    return Mesh(np.array(shards), ("devices",))


def replicated(tree: Any, shards: Sequence) -> Any:
    """Arrays of a tree, whole, on every device.

    The result of a step on a mesh lies there; a first step with its state elsewhere would be another program, compiled
    separately.
    """
    return jax.device_put(tree, NamedSharding(mesh_of(shards), PartitionSpec()))


def sharded(loss: Callable, shards: Sequence) -> Callable:
    """Returns the function (net, *arrays with one row a device) -> mean value and gradient of loss(net, *rows)."""

    def mean(net, *batch):
        return lax.pmean(jax.value_and_grad(loss)(net, *jax.tree.map(lambda a: a[0], batch)), "devices")

    mesh = mesh_of(shards)

    def gradient_of(net, *batches):
        specs = (PartitionSpec(), *[PartitionSpec("devices")] * len(batches))
        return jax.shard_map(mean, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(), check_vma=False)(net, *batches)

    return gradient_of


def stacked(batches: Sequence[tuple]) -> tuple[Any, ...]:
    """Trees of arrays, one tuple a device, joined to one tuple of trees with a row for each."""
    return jax.tree.map(lambda *rows: np.stack(rows), *batches)
