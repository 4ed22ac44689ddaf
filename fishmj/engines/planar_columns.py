"""State of a batch of fish as columns, one array a component: what the physics steps of `planar` carry."""

import jax.numpy as jnp

from fishmj.engines import FishState


def columns(a) -> tuple:
    """(B, C) as C columns, of an array or of a kernel's reference to one."""
    return tuple(a[:, i] for i in range(a.shape[1]))


def pairs(flow) -> list:
    """(B, N, 2) as N pairs of columns."""
    return [(flow[:, i, 0], flow[:, i, 1]) for i in range(flow.shape[1])]


def begun(state: FishState) -> tuple:
    """What a physics step hands to the next one, in columns: q, v, attachment, memory, power so far."""
    attached = state.attached[...]
    return columns(state.q), columns(state.v), attached, columns(state.memory), jnp.zeros_like(attached)
