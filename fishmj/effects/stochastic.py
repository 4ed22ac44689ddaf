"""What is drawn once a run: packets that come late or not at all, gusts, sensor noise. The effects that are `stochastic`.

They leave the mean of replicates where it is (jitter shifts it by its own mean) and widen their scatter, so no site of the
physics holds them; a generator or a randomised training run draws them here, each with its own random numbers.
"""

import numpy as np

from fishmj.effects.sites import Measured
from fishmj.effects.stack import EffectStack


def arrivals(active: EffectStack, parameters, t, commands, rng) -> tuple[np.ndarray, np.ndarray]:
    """(t (T,) s, commands (T, J) rad) as they arrive, sent at the times t with one parameter row (P,)."""
    record = np.asarray(t, float), np.asarray(commands, float)
    for effect, p in active.drawn(parameters, "command"):
        record = effect.scatter(rng, p, record)
    return record


def gusts(active: EffectStack, parameters, t, rng) -> np.ndarray:
    """(T, 2) m/s, world frame: what turbulence adds to the water's velocity at the rising times t (T,) s."""
    t = np.asarray(t, float)
    total = np.zeros((len(t), 2))
    for effect, p in active.drawn(parameters, "flow"):
        total = total + effect.scatter(rng, p, t)
    return total


def noise(active: EffectStack, parameters, seen: Measured, sigma: Measured, rng) -> Measured:
    """`seen` with the noise beyond that of the data sheets; sigma has their standard deviations, one number a channel."""
    for effect, p in active.drawn(parameters, "seen"):
        seen = effect.scatter(rng, p, (seen, sigma))
    return seen
