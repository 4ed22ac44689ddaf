"""The learnt force of a whole batch in one kernel of an NVIDIA GPU, by Pallas and Triton: what XLA makes many of.

    mean, spread, z = mean_step(dt, halves, motion, z)       as `residual_network.mean_step`, float32

In XLA the hidden units of every fish go to memory and back, some three thousand bytes a fish and step; here they stay in
registers and 250 bytes go over the bus. A program takes a block of fish, a thread one or a few; the weights, the same for all,
come from cache. Every sum is in float32. tanh x = 1 - 2 / (1 + exp 2 x), right to 2e-7, saturates without an overflow.

A gradient is that of the same formulas in XLA: the kernel is forward alone.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental import pallas as pl

from fishmj.water import residual_network
from fishmj.water.residual_network import BOUND, WAKES, Halves, Motion

BLOCK, WARPS = 256, 4  # fish a program, a power of two, and warps of 32 threads that share them
HALF = WAKES // 2


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def mean_step(dt: float, weights: Halves, m: Motion, z: list):
    """`residual_network.mean_step` by the kernel on an NVIDIA GPU, by XLA elsewhere; gradients by XLA."""
    return lax.platform_dependent(weights, m, z, cuda=partial(step, dt=dt), default=partial(_plain, dt))


def _plain(dt: float, weights: Halves, m: Motion, z: list):
    return residual_network.mean_by_products(jnp, weights, m, z, dt)


mean_step.defvjp(lambda dt, *given: jax.vjp(partial(_plain, dt), *given), lambda dt, pull, off: pull(off))


def step(weights: Halves, m: Motion, z: list, dt: float, *, interpret: bool = False):
    """`residual_network.mean_step` by the kernel; interpret: in plain JAX, anywhere."""
    links, shape = weights.forward.shape[1], m.speed.shape
    ends = links + 1, HALF  # of the even features, of the even wake states
    ordered = [*m.x[: ends[0]], *z[: ends[1]], *m.x[ends[0] :], *z[ends[1] :], m.speed]
    line = lambda a: jnp.reshape(jnp.asarray(a, jnp.float32), -1)
    given = [line(a) for a in ordered]  # apart: stacked, they would go to memory once more
    count = len(given[0])
    if more := -count % BLOCK:
        given = [jnp.pad(a, (0, more)) for a in given]
    tables = [jnp.asarray(table, jnp.float32) for table in _tables(weights)]
    whole = lambda a: pl.BlockSpec(a.shape, lambda i: (0,) * a.ndim)
    column, results = pl.BlockSpec((BLOCK,), lambda i: (i,)), 3 * links + 1 + WAKES
    out = pl.pallas_call(
        partial(_kernel, dt=dt, links=links, members=len(weights.forward), inputs=len(given)),
        grid=((count + more) // BLOCK,),
        in_specs=[*[column] * len(given), *map(whole, tables)],
        out_specs=[column] * results,
        out_shape=[jax.ShapeDtypeStruct((count + more,), jnp.float32)] * results,
        interpret=interpret,
        **({} if interpret else _compiler()),
    )(*given, *tables)
    out = [jnp.reshape(a[:count], shape) for a in out]
    return [out[links * c : links * (c + 1)] for c in range(3)], out[3 * links], out[3 * links + 1 :]


def _compiler() -> dict[str, Any]:
    from jax.experimental.pallas import triton

    return {"compiler_params": triton.CompilerParams(num_warps=WARPS, num_stages=1)}


def _tables(weights: Halves) -> tuple:
    """Weights in the order in which the kernel reads them: hidden units, members, products, wake states, a row each."""
    members, links, units = weights.forward.shape
    hidden = members * units
    out = jnp.concatenate([weights.forward, weights.aside], 1)  # (E, 3 N, H)
    inner = jnp.concatenate([weights.bias, weights.even, weights.odd], 1)
    return (
        jnp.concatenate([inner[:hidden], jnp.reshape(jnp.swapaxes(out, 1, 2), (hidden, -1))], 1),
        weights.forward_bias[:, :, 0],
        jnp.swapaxes(weights.squares, 0, 1),
        jnp.swapaxes(weights.crossed, 0, 1),
        jnp.concatenate([inner[hidden:], weights.length], 1),
    )


def _tanh(x):
    return 1.0 - 2.0 / (1.0 + jnp.exp(2.0 * x))


def _kernel(*refs, dt: float, links: int, members: int, inputs: int):
    units, biases, squares, crossed, wakes = refs[inputs : inputs + 5]
    out, size = refs[inputs + 5 :], links + 1 + HALF
    given = [ref[...] for ref in refs[:inputs]]
    even, odd, speed = given[:size], given[size:-1], given[-1]
    zero = 0.0 * speed

    def branches(table, at):
        """tanh of one unit in both branches of the mirror."""
        p, q = table[at, 0] + zero, zero
        for j, value in enumerate(even):
            p = p + table[at, 1 + j] * value
        for j, value in enumerate(odd):
            q = q + table[at, 1 + size + j] * value
        return _tanh(p + q), _tanh(p - q)

    ahead, aside = [zero] * links, [zero] * (2 * links)
    e, o = even[: links + 1], odd[: 2 * links]
    for k, value in enumerate(part[i] * other for part in (e, o) for i in range(len(part)) for other in part[i:]):
        ahead = [total + squares[k, j] * value for j, total in enumerate(ahead)]
    for k, value in enumerate(one * other for one in e for other in o):
        aside = [total + crossed[k, j] * value for j, total in enumerate(aside)]
    count, first = units.shape[0] // members, 1 + size + len(odd)

    def member(number, carry):
        mean, square = carry

        def unit(h, sums):
            at = number * count + h
            plus, minus = branches(units, at)
            both = [plus + minus] * links + [plus - minus] * (2 * links)
            return [total + units[at, first + j] * value for j, (total, value) in enumerate(zip(sums, both, strict=True))]

        start = [total + biases[number, j] for j, total in enumerate(ahead)]
        g = [BOUND * _tanh(total / BOUND) for total in lax.fori_loop(0, count, unit, [*start, *aside])]
        # Welford's sums: a variance far smaller than the mean's square keeps its digits
        off = [value - centre for value, centre in zip(g, mean, strict=True)]
        mean = [centre + away / (number + 1.0) for centre, away in zip(mean, off, strict=True)]
        for value, centre, away in zip(g, mean, off, strict=True):
            square = square + (value - centre) * away
        return mean, square

    mean, square = lax.fori_loop(0, members, member, ([zero] * (3 * links), zero))
    for ref, value in zip(out, [*mean, square / (3 * links * max(members - 1, 1))], strict=False):
        ref[...] = value
    for k, before in enumerate([*even[-HALF:], *odd[-HALF:]]):
        plus, minus = branches(wakes, k)
        target = 0.5 * (plus + minus if k < HALF else plus - minus)
        out[3 * links + 1 + k][...] = target + (before - target) * jnp.exp(-dt * speed / wakes[k, first])
