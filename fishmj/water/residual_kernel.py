"""One GPU kernel for the learnt force of a batch, by Pallas and Triton, for NVIDIA GPUs; XLA would use many kernels.

    mean, spread, z = mean_step(dt, halves, motion, z)       as `residual_step.mean_step`, float32

XLA writes the hidden units of every fish to memory, some 3 kB for each fish and step. Here they stay in registers, and 250 bytes
are transferred. A program handles a block of fish, a thread one or a few; the weights, equal for all, come from cache. Sums are
in float32. tanh x = 1 - 2 / (1 + exp 2 x), accurate to 2e-7, saturates without overflow.

The kernel computes the forward pass only; gradients use the same formulas in XLA. On a GPU that does not support such kernels
(`usable`) XLA's products replace them, with one warning.
"""

from functools import cache, partial
from math import gcd
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental import pallas as pl

from fishmj.base import console
from fishmj.water import residual_network
from fishmj.water.residual_network import BOUND, WAKES, Halves, MotionFeatures

BLOCK, WARPS = 512, 16  # fish of a program, a power of two, and its warps of 32 threads
HALF = WAKES // 2


@cache
def usable() -> bool:
    """Returns True if this machine's GPU supports such kernels; the first call compiles a small one, and warns if that fails."""
    try:
        probe.lower(*[jax.ShapeDtypeStruct((BLOCK, 4), jnp.float32)] * 2).compile()
    except Exception as error:  # noqa: BLE001  after any error of driver or compiler, XLA computes the same water
        text = " ".join(str(error).split())[:200]
        console.warn(
            f"this GPU does not support the kernels of the fitted water ({type(error).__name__}: {text}). Matrix products replace"
            " them: the same swim, but slower. The kernels need an NVIDIA GPU of compute capability 8.0 or more"
        )
        return False
    return True


@jax.jit
def probe(rows, weights):
    """Small test kernel with the constructs of the large ones: a loop over rows of weights, splits, joins, tanh."""

    def kernel(rows, weights, out):
        tanh = tanh_of(False)
        first, *others = (jnp.reshape(column, BLOCK) for column in jnp.split(rows[...], 4, 1))
        total = lax.fori_loop(0, BLOCK, lambda k, total: total + tanh(weights[k, 0] * first), sum(others))
        out[...] = jnp.reshape(jnp.stack([first, total], -1), (BLOCK, 2))

    return pl.pallas_call(kernel, out_shape=jax.ShapeDtypeStruct((BLOCK, 2), jnp.float32), **compiler(WARPS))(rows, weights)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def mean_step(dt: float, weights: Halves, m: MotionFeatures, z: list):
    """Computes `residual_step.mean_step` by the kernel on an NVIDIA GPU, by XLA elsewhere; gradients by XLA."""
    return lax.platform_dependent(weights, m, z, cuda=partial(step, dt=dt), default=partial(_plain, dt))


def _plain(dt: float, weights: Halves, m: MotionFeatures, z: list):
    return residual_network.mean_by_products(jnp, weights, m, z, dt)


mean_step.defvjp(lambda dt, *given: jax.vjp(partial(_plain, dt), *given), lambda dt, pull, off: pull(off))


def step(weights: Halves, m: MotionFeatures, z: list, dt: float, *, interpret: bool = False):
    """Computes `residual_step.mean_step` by the kernel; interpret: in plain JAX, on any machine."""
    links, shape = weights.forward.shape[1], m.speed.shape
    line = lambda a: jnp.reshape(jnp.asarray(a, jnp.float32), -1)
    given = [line(a) for a in (*m.x, *z, m.speed)]  # separate arrays, because stacking would copy them
    count = len(given[0])
    if more := -count % BLOCK:
        given = [jnp.pad(a, (0, more)) for a in given]
    tables = tables_of(weights)
    column, results = pl.BlockSpec((BLOCK,), lambda i: (i,)), 3 * links + 1 + WAKES
    out = pl.pallas_call(
        partial(_kernel, dt=dt, inputs=len(given), links=links, tanh=tanh_of(interpret)),
        grid=((count + more) // BLOCK,),
        in_specs=[*[column] * len(given), *map(whole, tables)],
        out_specs=[column] * results,
        out_shape=[jax.ShapeDtypeStruct((count + more,), jnp.float32)] * results,
        interpret=interpret,
        **({} if interpret else compiler(WARPS)),
    )(*given, *tables)
    out = [jnp.reshape(a[:count], shape) for a in out]
    return [out[links * c : links * (c + 1)] for c in range(3)], out[3 * links], out[3 * links + 1 :]


def whole(a) -> pl.BlockSpec:
    """Block spec of an array that every program reads completely."""
    return pl.BlockSpec(a.shape, lambda *_: (0,) * a.ndim)


def compiler(warps: int) -> dict[str, Any]:
    """Options of `pl.pallas_call` for a program with this number of warps."""
    from jax.experimental.pallas import triton

    return {"compiler_params": triton.CompilerParams(num_warps=warps, num_stages=1)}


def tables_of(weights: Halves, together: int = 1) -> tuple:
    """Weights in the order in which a kernel reads them: hidden units, biases, even and odd products, wake states.

    A row holds what one iteration of a loop reads: `together` hidden units (or a smaller divisor of their number), a member's
    biases, all products, or all wake states. Columns are compile-time constants.
    """
    members, links, units = weights.forward.shape
    hidden = members * units
    out = jnp.concatenate([weights.forward, weights.aside], 1)  # (E, 3 N, H)
    inner = jnp.concatenate([weights.bias, weights.even, weights.odd], 1)
    tables = (
        jnp.concatenate([inner[:hidden], jnp.reshape(jnp.swapaxes(out, 1, 2), (hidden, -1))], 1),
        weights.forward_bias[:, :, 0],
        jnp.swapaxes(weights.squares, 0, 1),
        jnp.swapaxes(weights.crossed, 0, 1),
        jnp.concatenate([inner[hidden:], weights.length], 1),
    )
    rows = hidden // gcd(units, together), members, 1, 1, 1
    return tuple(jnp.reshape(jnp.asarray(table, jnp.float32), (count, -1)) for table, count in zip(tables, rows, strict=True))


def tanh_of(interpret: bool):
    """Returns tanh for use inside a kernel, by the device's fast exponential and reciprocal: as accurate, and faster."""
    if interpret:
        return lambda x: 1.0 - 2.0 / (1.0 + jnp.exp(2.0 * x))
    from jax.experimental.pallas import triton

    # 0f..: 2 / ln 2, 1, -2; an exponential that overflows gives 1, one that vanishes -1
    steps = "mul.f32 t, $1, 0f4038AA3B; ex2.approx.ftz.f32 t, t; add.f32 t, t, 0f3F800000; rcp.approx.ftz.f32 t, t;"
    asm = "{ .reg .f32 t; " + steps + " fma.rn.f32 $0, t, 0fC0000000, 0f3F800000; }"
    shape = lambda x: [jax.ShapeDtypeStruct(x.shape, x.dtype)]
    return lambda x: triton.elementwise_inline_asm(asm, args=[x], constraints="=f,f", pack=1, result_shape_dtypes=shape(x))[0]


def _kernel(*refs, dt: float, inputs: int, links: int, tanh):
    *x, speed = (ref[...] for ref in refs[:inputs])
    m = MotionFeatures(x[:-WAKES], speed, [], [], [])
    coefficients, apart, wakes = network(refs[inputs : inputs + 5], links, m, x[-WAKES:], dt, tanh)
    for ref, value in zip(refs[inputs + 5 :], [*sum(coefficients, []), apart, *wakes], strict=True):
        ref[...] = value


def network(tables, links: int, m: MotionFeatures, z: list, dt: float, tanh, none=0) -> tuple:
    """Computes `residual_step.mean_step` inside a kernel.

    Args:
        tables: references to the result of `tables_of`. links: of the fish.
        none: 0; in a loop of steps, a zero that the compiler cannot see. Else it would load the thousand weights, equal in every
            step, into registers before the loop, and spill.
    """
    units, biases, squares, crossed, wakes = tables
    members, zero = biases.shape[0], 0.0 * m.speed
    even, odd = [*m.x[: links + 1], *z[:HALF]], [*m.x[links + 1 :], *z[HALF:]]
    size, first = len(even), 1 + len(even) + len(odd)  # a unit has `first` numbers, then those of its results
    width = first + 3 * links
    rounds = units.shape[0] // members

    def branches(table, row, at):
        """tanh of the unit at column `at` in both branches of the mirror."""
        p, q = table[row, at] + zero, zero
        for j, value in enumerate(even):
            p = p + table[row, at + 1 + j] * value
        for j, value in enumerate(odd):
            q = q + table[row, at + 1 + size + j] * value
        return tanh(p + q), tanh(p - q)

    ahead, aside = [zero] * links, [zero] * (2 * links)
    e, o = even[: links + 1], odd[: 2 * links]
    for k, value in enumerate(part[i] * other for part in (e, o) for i in range(len(part)) for other in part[i:]):
        ahead = [total + squares[none, links * k + j] * value for j, total in enumerate(ahead)]
    for k, value in enumerate(one * other for one in e for other in o):
        aside = [total + crossed[none, 2 * links * k + j] * value for j, total in enumerate(aside)]

    def member(number, carry):
        mean, square = carry

        def round_of(k, sums):
            row = number * rounds + k
            for at in range(0, units.shape[1], width):
                plus, minus = branches(units, row, at)
                both = [plus + minus] * links + [plus - minus] * (2 * links)
                ours = range(at + first, at + width)
                sums = [total + units[row, j] * value for j, total, value in zip(ours, sums, both, strict=True)]
            return sums

        start = [total + biases[number, j] for j, total in enumerate(ahead)] + aside
        g = [BOUND * tanh(total / BOUND) for total in lax.fori_loop(0, rounds, round_of, start)]
        # Welford's sums are accurate even if the variance is far smaller than the squared mean
        off = [value - centre for value, centre in zip(g, mean, strict=True)]
        mean = [centre + away / (number + 1.0) for centre, away in zip(mean, off, strict=True)]
        for value, centre, away in zip(g, mean, off, strict=True):
            square = square + (value - centre) * away
        return mean, square

    mean, square = lax.fori_loop(0, members, member, ([zero] * (3 * links), zero))
    later = []
    for k, before in enumerate([*even[-HALF:], *odd[-HALF:]]):
        plus, minus = branches(wakes, none, k * (first + 1))
        target = 0.5 * (plus + minus if k < HALF else plus - minus)
        later.append(target + (before - target) * jnp.exp(-dt * m.speed / wakes[none, k * (first + 1) + first]))
    return [mean[links * c : links * (c + 1)] for c in range(3)], square / (3 * links * max(members - 1, 1)), later
