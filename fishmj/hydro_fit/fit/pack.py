"""A residual as named arrays, for the files of a fit's stages."""

import numpy as np

from fishmj.errors import ConfigError
from fishmj.hydro_fit import learned, residual


def packed(learnt: learned.Residual) -> dict:
    """A residual with a range as named arrays."""
    if learnt.reach is None:
        raise ConfigError("a residual without a range is for learning only; expected one with learned.Range")
    net = {f"net.{key}": np.asarray(value) for key, value in learnt.net._asdict().items()}
    return net | {f"range.{key}": np.asarray(value) for key, value in learnt.reach._asdict().items()}


def unpacked(state: dict) -> learned.Residual | None:
    """The residual of a state, if there is one."""
    if "net.reach" not in state:
        return None
    net = residual.Net(*(state[f"net.{key}"] for key in residual.Net._fields))
    return learned.Residual(net, learned.Range(*(state[f"range.{key}"] for key in learned.Range._fields)))
