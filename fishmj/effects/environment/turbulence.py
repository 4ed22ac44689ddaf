"""Water that never does the same twice."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter


def scatter(rng, p, t):
    """(T, 2) m/s: velocity added to both components at the times t [s], Gauss-Markov of deviation sigma and memory tau."""
    drawn = rng.standard_normal((len(t), 2))
    out, step = p.sigma * drawn, np.diff(t)
    for k, h in enumerate(step, 1):
        stay = np.exp(-h / p.time)
        out[k] = stay * out[k - 1] + np.sqrt(1.0 - stay * stay) * out[k]
    return out


EFFECT = Effect(
    name="turbulence",
    stage="environment",
    about="gusts that differ between replicates: scatter, not a bias",
    formula="du = -u/tau dt + sigma sqrt(2/tau) dW, both components",
    source="paper, drift of a floating marker; 5 to 15 % of the current, 0.3 to 2 s",
    parameters=(
        Parameter(name="sigma", unit="m/s", low=0.0, high=0.2, typical=(0.005, 0.03)),
        Parameter(name="time", unit="s", null=1.0, low=0.05, high=10.0, typical=(0.3, 2.0), shape=True),
    ),
    shows=("position", "heading"),
    confusions=(
        Confusion("steady_current", "three replicates: the mean vanishes", ("drift_east",)),
        Confusion("noise_level", "grows with time, a resting log does not", ("idle", "drift_east")),
    ),
    stochastic=True,
    stream="flow",
    scatter=scatter,
)
