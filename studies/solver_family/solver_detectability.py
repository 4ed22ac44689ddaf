"""Visible size of a hidden effect in the solver's own swims: the formula of `generators.detectability`, without a search.

    s   the swims of one robot with the effect less those without it, measured without noise
    d   standard deviation of the healthy robots of its model in that experiment, measured without noise

All robots are placed alike in an experiment, with the same packet delays, so neither enters s or d.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fishmj.gap.laboratory.generators.detectability import NOTHING, SensedChannels, at, channels, mean_squares
from fishmj.log import Trial

SHORT = 0.1  # s: a healthy robot whose swim ended earlier than another's by more tells nothing of its end
FEWEST = 2  # healthy robots of an experiment


def detectable(
    effects: Mapping[str, Mapping[str, float]], hidden: Mapping[str, Trial], plain: Mapping[str, Trial],
    healthy: Mapping[str, Sequence[Trial]], sigma: Mapping[str, float],
) -> dict:  # fmt: skip
    """Mean squares as of `generators.detectable`; of one effect, or of several together.

    Args:
        hidden, plain: the robot's swims with and without the hidden effects, by experiment, without noise. healthy: of robots of
            its model, itself among them. sigma: noise of each column.
    """
    if not effects:
        return dict(NOTHING)
    with_, without, spread = [], [], []
    fewest = min((len(healthy[name]) for name in hidden if name in plain), default=0)
    for name in hidden:
        if name not in plain:
            continue
        others = [channels(trial, sigma) for trial in healthy[name]]
        for i, (h, p) in enumerate(zip(channels(hidden[name], sigma), channels(plain[name], sigma), strict=True)):
            p = until(p, float(h.t[-1]))
            with_.append(h)
            without.append(p)
            spread.append(variance([seen[i] for seen in others], p))
    if not with_:
        return dict(NOTHING)
    told = {name: dict(values) for name, values in effects.items()}
    found = mean_squares(lambda asked: with_ if asked else without, spread, dict([next(iter(told.items()))]), fewest)
    both = {key: dict.fromkeys(told, found[alone]) for key, alone in (("each", "all"), ("each_noise_only", "noise_only"))}
    return found | both


def until(seen: SensedChannels, end: float) -> SensedChannels:
    """Measurements before `end` [s]."""
    rows = seen.t <= end
    return seen._replace(t=seen.t[rows], values=seen.values[rows])


def variance(others: Sequence[SensedChannels], plain: SensedChannels) -> np.ndarray:
    """(K, C) variance of those that swam as long as `plain`, at its stamps; zero if they are too few."""
    whole = [at(other, plain.t) for other in others if other.t[-1] >= plain.t[-1] - SHORT]
    if len(whole) < FEWEST:
        return np.zeros_like(plain.values)
    return np.var(whole, axis=0, ddof=1)
