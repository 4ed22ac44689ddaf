"""Data-parallel training on several devices of one machine: each has an equal share of the fish and a copy of the networks.

Each device draws its own random numbers and shuffles its own rows. Every update uses the mean gradient of all devices, so that
the copies stay equal. With one device, results are bit-identical to training without this module.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from fishmj.base.errors import ConfigError

AXIS = "fish"
EACH, ROWS, COLUMNS = PartitionSpec(), PartitionSpec(AXIS), PartitionSpec(None, AXIS)  # whole on each; (B, ..), (T, B, ..) split


def without_empty(like: Any, tree: Any) -> Any:
    """Tree with None where `like` has empty arrays."""
    return jax.tree.map(lambda a, leaf: leaf if a.size else None, like, tree)


def with_empty(like: Any, tree: Any) -> Any:
    """Tree with the empty arrays of `like`."""
    return jax.tree.map(lambda a, leaf: leaf if a.size else jnp.zeros(a.shape, a.dtype), like, tree)


class Shards:
    """Handles the first `count` devices of this machine. Raises ConfigError if there are fewer.

    Call `mean`, `moments` and `own` inside the function that `split` runs, or on one device.
    """

    def __init__(self, count: int):
        there = jax.local_devices()
        if count > len(there):
            seen = f"JAX sees {len(there)} ({there[0].device_kind})"
            raise ConfigError(f"--devices {count}: {seen}; take at most that many, or change CUDA_VISIBLE_DEVICES")
        self.count = count
        self.mesh = Mesh(there[:count], (AXIS,))

    def split(self, work: Callable, given: Any, returned: Any) -> Callable:
        """Returns `work` as a function that runs on every device with its share; given, returned: layouts of input and output.

        Empty arrays are kept out: XLA for GPUs removes them from a split computation, and Shardy then crashes (jaxlib 0.11.2).
        """
        split = partial(jax.shard_map, mesh=self.mesh, check_vma=False)

        def on_each(tree: Any) -> Any:
            layout = jax.tree.broadcast(given, tree)
            share = lambda a, spec: jax.ShapeDtypeStruct(NamedSharding(self.mesh, spec).shard_shape(a.shape), a.dtype)
            here = jax.tree.map(share, tree, layout)
            whole = jax.eval_shape(split(work, in_specs=(layout,), out_specs=returned), tree)
            less = split(
                lambda few: without_empty(whole, work(with_empty(here, few))),
                in_specs=(without_empty(tree, layout),),
                out_specs=without_empty(whole, jax.tree.broadcast(returned, whole)),
            )
            return with_empty(whole, less(without_empty(tree, tree)))

        return on_each

    def place(self, tree: Any, layout: Any) -> Any:
        """Tree, moved to the devices in this layout."""
        # XLA returns an empty array unsplit; another placement would make the second iteration compile again
        where = lambda leaf, spec: NamedSharding(self.mesh, spec if leaf.size else EACH)
        return jax.device_put(tree, jax.tree.map(where, tree, layout))

    def own(self, key):
        """Random key for this device alone, from the common key."""
        return jax.random.fold_in(key, jax.lax.axis_index(AXIS))

    def mean(self, tree: Any) -> Any:
        """Mean over the devices."""
        return tree if self.count == 1 else jax.lax.pmean(tree, AXIS)

    def moments(self, x) -> tuple[Any, Any]:
        """Mean and standard deviation of x over all devices."""
        if self.count == 1:
            return x.mean(), x.std()
        mean, variance = jax.lax.all_gather(jnp.stack([x.mean(), x.var()]), AXIS).T
        return mean.mean(), jnp.sqrt((variance + jnp.square(mean - mean.mean())).mean())
