"""A loss on several devices: its batch is sharded in equal parts, values and gradients are averaged.

gradient_of = sharded(loss, devices)     value, gradient = gradient_of(net, *stacked(batches)), a batch for each device
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from fishmj.cores import usable_cores

MOST = 8  # devices: a batch of fewer than eight swims takes as long as one of eight


def several() -> None:
    """Let the CPU be as many devices as this process may use cores; nothing changes once JAX has begun."""
    try:
        jax.config.update("jax_num_cpu_devices", min(MOST, usable_cores()))
    except RuntimeError:  # a backend is up already
        return


def devices(*sizes: int) -> list:
    """As many of this process's devices as divide all sizes."""
    available = jax.devices()[:MOST]
    return available[: next(n for n in range(len(available), 0, -1) if not any(size % n for size in sizes))]


@cache
def quick(platform: str) -> dict | None:
    """Compiler options for a long loop of short operations; None where there are none, or this JAX knows them no longer.

    JAX 0.10: compiled in 17 s in place of 42, a step takes 125 ms in place of 203. JAX 0.11 is as fast without.
    """
    if platform != "cpu":
        return None
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return None
    return options


def sharded(loss: Callable, shards: Sequence) -> Callable:
    """(net, *arrays with one row a device) -> mean value and gradient of loss(net, *rows)."""

    def mean(net, *batch):
        return lax.pmean(jax.value_and_grad(loss)(net, *jax.tree.map(lambda a: a[0], batch)), "devices")

    mesh = Mesh(np.array(shards), ("devices",))

    def gradient_of(net, *batches):
        specs = (PartitionSpec(), *[PartitionSpec("devices")] * len(batches))
        return jax.shard_map(mean, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(), check_vma=False)(net, *batches)

    return gradient_of


def stacked(batches: Sequence[tuple]) -> tuple[Any, ...]:
    """Trees of arrays, one tuple a device, as one tuple of trees with a row for each."""
    return jax.tree.map(lambda *rows: np.stack(rows), *batches)
