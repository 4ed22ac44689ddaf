"""A loss on several devices: its batch is dealt out in equal hands, values and slopes are averaged.

slope_of = dealt(loss, devices)          value, slope = slope_of(net, *stacked(hands)), a hand for each device
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from fishmj.cores import usable_cores

MOST = 8  # devices: a hand of fewer than eight swims takes as long as one of eight


def several() -> None:
    """Let the CPU be as many devices as this process may use cores; nothing changes once JAX has begun."""
    try:
        jax.config.update("jax_num_cpu_devices", min(MOST, usable_cores()))
    except RuntimeError:  # a backend is up already
        return


def devices(*sizes: int) -> list:
    """As many of this process's devices as divide all sizes."""
    there = jax.devices()[:MOST]
    return there[: next(n for n in range(len(there), 0, -1) if not any(size % n for size in sizes))]


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


def sharded(loss: Callable, among: Sequence) -> Callable:
    """(net, *arrays with one row a device) -> mean value and slope of loss(net, *rows)."""

    def mean(net, *hand):
        return lax.pmean(jax.value_and_grad(loss)(net, *jax.tree.map(lambda a: a[0], hand)), "devices")

    mesh = Mesh(np.array(among), ("devices",))

    def slope_of(net, *hands):
        specs = (PartitionSpec(), *[PartitionSpec("devices")] * len(hands))
        return jax.shard_map(mean, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(), check_vma=False)(net, *hands)

    return slope_of


def stacked(hands: Sequence[tuple]) -> tuple[Any, ...]:
    """Trees of arrays, one tuple a device, as one tuple of trees with a row for each."""
    return jax.tree.map(lambda *rows: np.stack(rows), *hands)
