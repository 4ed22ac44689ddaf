"""Sensors are noisier than believed."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter


def scatter(rng, p, record):
    """Adds white noise so that the deviation of each channel becomes factor times sigma. record = (Measured, sigmas)."""
    seen, sigma = record
    more = np.sqrt(np.maximum(p.factor**2 - 1.0, 0.0))
    noisy = {
        name: getattr(seen, name) + more * getattr(sigma, name) * rng.standard_normal(np.shape(getattr(seen, name)))
        for name in ("x", "y", "yaw", "joint", "power")
    }
    return seen._replace(**noisy)


EFFECT = Effect(
    name="noise_level",
    stage="measurement",
    about="white noise of all sensors is a factor above what their data sheet says",
    formula="sigma' = factor sigma",
    source="colour tracking: 1 to 3 mm, 0.5 to 1.5 deg",
    parameters=(Parameter(name="factor", unit="1", null=1.0, low=1.0, high=10.0, typical=(1.5, 3.0)),),
    unplanted="its sensors have noise of their own, for all runs alike",
    shows=("joint", "position", "heading", "power"),
    confusions=(Confusion("turbulence", "a resting log shows it", ("idle", "drift_east")),),
    stochastic=True,
    stream="seen",
    scatter=scatter,
)
