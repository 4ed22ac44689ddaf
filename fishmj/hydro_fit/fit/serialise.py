"""A residual as named arrays, for the files of a fit's stages."""

import numpy as np

from fishmj.errors import ConfigError
from fishmj.water import residual_hooks, residual_network


def packed(learnt: residual_hooks.Residual) -> dict:
    """A residual with a range as named arrays."""
    if learnt.reach is None:
        raise ConfigError("a residual without a range is for learning only; expected one with learned.Range")
    net = {f"net.{key}": np.asarray(value) for key, value in learnt.net._asdict().items()}
    return net | {f"range.{key}": np.asarray(value) for key, value in learnt.reach._asdict().items()}


def unpacked(state: dict) -> residual_hooks.Residual | None:
    """The residual of a state, if there is one."""
    if "net.reach" not in state:
        return None
    net = residual_network.Net(*(state[f"net.{key}"] for key in residual_network.Net._fields))
    return residual_hooks.Residual(net, residual_hooks.Range(*(state[f"range.{key}"] for key in residual_hooks.Range._fields)))
