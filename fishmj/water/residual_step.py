"""One step of the learnt force: by matrix products, or for many fish on an NVIDIA GPU by one kernel.

`residual_network.mean_by_products` is the plain form and the test of the kernel.
"""

from collections.abc import Callable

import numpy as np

from fishmj.water.residual_network import Halves, MotionFeatures, Net, halves, mean_by_products

kernel = True  # False: matrix products on every device
# fish that a kernel is for. On an H200, M control steps/s by products and by the kernel of a tick: 0.27 and 0.21 with 1,003 fish,
# 4.1 and 13.0 with 65,536; by a straight line between them as many at 6,000
FEWEST = 4096


def mean_step(xp, net: "Net | Halves | Callable[..., tuple]", m: MotionFeatures, z: list, dt: float) -> tuple:
    """Results of `mean_by_products`; a batch in single precision on an NVIDIA GPU goes through one kernel.

    net: weights, or a function of (m, z, dt) that has them and returns the same.
    """
    if callable(net):
        return net(m, z, dt)
    if getattr(xp, "__name__", "") == "jax.numpy" and takes_kernel(m.speed):
        from fishmj.water import residual_kernel

        return residual_kernel.mean_step(dt, halves(xp, net), MotionFeatures(m.x, m.speed, [], [], []), z)
    return mean_by_products(xp, net, m, z, dt)


def takes_kernel(a) -> bool:
    """Returns True if a batch, one number a fish, goes through a kernel: large, single precision, on a suitable GPU."""
    if not kernel or np.size(a) < FEWEST or a.dtype != np.float32:
        return False
    import jax

    if jax.default_backend() != "gpu":
        return False
    from fishmj.water import residual_kernel  # here: a CPU needs no Pallas

    return residual_kernel.usable()
