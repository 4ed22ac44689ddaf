"""One GPU kernel for all physics steps of a bus tick, by Pallas and Triton, for NVIDIA GPUs.

    state, power = tick(engine, state, params, targets, flow, ambient)       as `planar.PlanarEngine.physics`, float32

The kernel traces `PlanarEngine.step` on a block of fish, so the physics is not repeated here. Effects are included: Triton
supports all operations that `codegen` supports, and an effect uses no others. Parameters and state of a fish stay in registers;
the weights of the learnt forces come from cache. The kernel computes the forward pass only; gradients use the same steps in XLA.

In a family of waters with several residuals, each block of fish has one program for each residual. A program ends at once if no
fish of its block has its residual, and otherwise writes only the fish that have it. The residual's index is a coordinate of the
program, so that all threads load the same weights.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from fishmj.engines import FishState, swimmer
from fishmj.engines.planar_columns import columns, initial_carry, pairs
from fishmj.water import residual_kernel, residual_network
from fishmj.water.residual_hooks import Residual

BLOCK, WARPS = 128, 4  # fish of a program, a power of two, and its warps of 32 threads
UNITS = 4  # hidden units in one iteration of the loop


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def tick(engine, *given):
    """Computes `engine.physics` by the kernel on an NVIDIA GPU, by XLA elsewhere; gradients by XLA."""
    return lax.platform_dependent(*given, cuda=partial(physics, engine), default=engine.physics)


tick.defvjp(lambda engine, *given: jax.vjp(engine.physics, *given), lambda engine, pull, off: pull(off))


def physics(engine, state, params, targets, flow, ambient, *, interpret: bool = False):
    """Computes `engine.physics` by the kernel; interpret: emulate it in plain JAX, on any machine."""
    count, nets = len(state.attached), engine.added.nets
    # two tables: parameters are constant, so their table can be made once for all ticks
    given = (state, jnp.swapaxes(targets, 0, 1), flow, ambient), params._replace(delay=())
    tables, places = zip(*map(_padded_columns, given), strict=True)
    each = [residual_kernel.tables_of(residual_network.halves(np, one.net), UNITS) for one in nets]
    weights = tuple(jnp.concatenate(tables) for tables in zip(*each, strict=True))
    nones = jnp.zeros(engine.steps, jnp.int32)
    reach = _reach(nets)

    def kernel(net, *refs):
        if len(nets) == 1:
            swim(None, 0, *refs)
        else:  # check this first, because most programs end here
            own = pl.program_id(1)
            mine = net[...] == own
            pl.when(jnp.max(mine.astype(jnp.int32)) > 0)(lambda: swim(mine, own, *refs))

    def swim(mine, own, *refs):
        held = [_column_views(ref[...], numbers) for ref, numbers in zip(refs, places, strict=False)]
        (state, targets, flow, ambient), params = held
        nones, *weights, out = refs[len(held) :]
        fixed = swimmer(params), columns(params.effects), pairs(flow), columns(ambient)
        tanh = residual_kernel.tanh_of(interpret)

        def step(k, carry):
            carry, (target, *later) = carry
            network = partial(residual_kernel.network, weights, engine.chain.n, tanh=tanh, none=nones[k] & 1)
            added = replace(engine.added, nets=(Residual(network, _range_of(reach, own) if len(nets) > 1 else reach[0]),))
            return engine.step(added, *fixed, carry, target), [*later, target]

        _, steps, joints = targets.shape
        commands = [[targets[:, k, j] for j in range(joints)] for k in range(steps)]
        carry, _ = lax.fori_loop(0, steps, step, (initial_carry(state), commands))
        triton.store(
            out, _joined(jax.tree.leaves(carry)), mask=None if mine is None else jnp.broadcast_to(mine[:, None], out.shape)
        )

    # copies of the last fish pad the last block, so that no division fails
    rows = [jnp.pad(table, ((0, -count % BLOCK), (0, 0)), mode="edge") for table in tables]
    net = jnp.pad(jnp.asarray(params.net, jnp.int32), (0, -count % BLOCK), mode="edge")
    ends = np.cumsum([state.q.shape[1], state.v.shape[1], 1, state.memory.shape[1]])  # ends of the outputs' columns, power last
    block = lambda width: pl.BlockSpec((BLOCK, width), lambda i, own: (i, 0))
    of_residual = lambda a: pl.BlockSpec((len(a) // len(nets), a.shape[1]), lambda i, own: (own, 0))
    out = pl.pallas_call(
        kernel,
        grid=(len(rows[0]) // BLOCK, len(nets)),
        in_specs=[
            pl.BlockSpec((BLOCK,), lambda i, own: (i,)),
            *(block(table.shape[1]) for table in rows),
            residual_kernel.whole(nones),
            *map(of_residual, weights),
        ],
        out_specs=block(_power(ends[-1] + 1)),
        out_shape=jax.ShapeDtypeStruct((len(rows[0]), _power(ends[-1] + 1)), jnp.float32),
        interpret=interpret,
        **({} if interpret else residual_kernel.compiler(WARPS)),
    )(net, *rows, nones, *weights)
    q, v, attached, memory, power = jnp.split(out[:count, : ends[-1] + 1], ends, 1)
    return FishState(q, v, attached[:, 0], (), memory), power[:, 0]


def _reach(nets) -> list:
    """Ranges of the residuals as nested lists of numbers, because a kernel cannot capture arrays."""
    return [jax.tree.map(lambda a: np.asarray(a).tolist(), one.reach) for one in nets]


def _range_of(reach: list, own):
    """Range of residual `own`, an index known only when the kernel runs."""
    one_hot = [(own == k).astype(jnp.float32) for k in range(len(reach))]  # Triton cannot select between two scalars
    return jax.tree.map(lambda *each: sum(there * value for there, value in zip(one_hot, each, strict=True)), *reach)


def _power(count: int) -> int:
    """Next power of two, the only shapes that Triton supports; one table compiles faster than many loads and stores."""
    return 1 << (int(count) - 1).bit_length()


def _padded_columns(tree):
    """Joins arrays (B, ..) to one array, padded to a power of two columns; also returns the column indices (1, ..) of each."""
    leaves, shape = jax.tree.flatten(tree)
    ends = np.cumsum([a.size // len(a) for a in leaves])
    numbers = [np.arange(end - a.size // len(a), end).reshape(1, *a.shape[1:]) for a, end in zip(leaves, ends, strict=True)]
    fill = jnp.zeros((len(leaves[0]), _power(ends[-1]) - ends[-1]), jnp.float32)
    return jnp.concatenate([*(jnp.reshape(a, (len(a), -1)) for a in leaves), fill], 1), shape.unflatten(numbers)


class _ColumnView:
    """Array-like view of values in a kernel: a[:, i] or a[:, i, j] is one value for each fish."""

    def __init__(self, numbers, values: list):
        self.numbers, self.values, self.shape = numbers, values, numbers.shape

    def __getitem__(self, at):
        return self.values[self.numbers[at].item()]


def _column_views(rows, numbers):
    """Inverse of `_padded_columns` for a block of rows."""
    values = [jnp.reshape(column, len(rows)) for column in jnp.split(rows, rows.shape[1], 1)]
    return jax.tree.map(lambda place: _ColumnView(place, values), numbers)


def _joined(values: list):
    """Joins values to a block of columns, padded to a power of two, because Triton joins pairs only."""
    values = [*values, *[jnp.zeros_like(values[0])] * (_power(len(values)) - len(values))]
    while half := len(values) // 2:
        values = [jnp.reshape(jnp.stack(pair, -1), (len(pair[0]), -1)) for pair in zip(values[:half], values[half:], strict=True)]
    return values[0]
