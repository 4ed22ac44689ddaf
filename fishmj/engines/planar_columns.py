"""State of a batch of fish as columns, one array for each component, for the physics steps of `planar`."""

import jax.numpy as jnp

from fishmj.engines import FishState


def columns(a) -> tuple:
    """Splits (B, C) into C columns, for an array or a kernel's reference to one."""
    return tuple(a[:, i] for i in range(a.shape[1]))


def pairs(flow) -> list:
    """Splits (B, N, 2) into N pairs of columns."""
    return [(flow[:, i, 0], flow[:, i, 1]) for i in range(flow.shape[1])]


def initial_carry(state: FishState) -> tuple:
    """Initial carry of the physics steps, in columns: q, v, attachment, memory, power so far."""
    attached = state.attached[...]
    return columns(state.q), columns(state.v), attached, columns(state.memory), jnp.zeros_like(attached)
