"""Evaluation of the learnt force by matrix products, or for many fish on an NVIDIA GPU by one kernel.

`residual_network.mean_by_products` is the reference for the kernel.
"""

from collections.abc import Callable

import numpy as np

from fishmj.water.residual_network import Halves, MotionFeatures, Net, halves, mean_by_products

kernel = True  # False: matrix products on every device
# minimal number of fish for the kernel. On an H200, products and kernel do 0.27 and 0.21 million control steps/s with 1,003 fish,
# 4.1 and 13.0 with 65,536; by interpolation both are equally fast at 6,000
FEWEST = 4096


def mean_step(xp, net: "Net | Halves | Callable[..., tuple]", m: MotionFeatures, z: list, dt: float) -> tuple:
    """Computes `mean_by_products`, for a large batch in single precision on an NVIDIA GPU by one kernel.

    net: weights, or a function of (m, z, dt) with the same result.
    """
    if callable(net):
        return net(m, z, dt)
    if getattr(xp, "__name__", "") == "jax.numpy" and takes_kernel(m.speed):
        from fishmj.water import residual_kernel

        return residual_kernel.mean_step(dt, halves(xp, net), MotionFeatures(m.x, m.speed, [], [], []), z)
    return mean_by_products(xp, net, m, z, dt)


def takes_kernel(a) -> bool:
    """Returns True if the kernel handles this batch (one number for each fish): large, single precision, on a suitable GPU."""
    if not kernel or np.size(a) < FEWEST or a.dtype != np.float32:
        return False
    import jax

    if jax.default_backend() != "gpu":
        return False
    from fishmj.water import residual_kernel  # imported here, because a CPU needs no Pallas

    return residual_kernel.usable()
