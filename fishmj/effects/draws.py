"""Domain randomisation from the catalogue: parameter rows of the size that real robots show."""

import numpy as np

from fishmj.effects.active import Active
from fishmj.effects.effect import Parameter


def draw(active: Active, n: int, rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """(n, P) parameter rows in the order of `active.names`.

    Each value is uniform in its `typical` range, on either side of the null where both make sense, `scale` times as far from
    the null, and inside the bounds. scale = 0 gives null rows. Shape parameters are drawn as they are.
    """
    columns = [_column(p, n, rng, scale) for effect in active.effects for p in effect.parameters]
    return np.stack(columns, 1) if columns else np.zeros((n, 0))


def _column(p: Parameter, n: int, rng: np.random.Generator, scale: float) -> np.ndarray:
    value, side = rng.uniform(*p.typical, n), rng.choice((-1.0, 1.0), n)
    if p.shape:
        return np.clip(value, p.low, p.high)
    away = (value - p.null) * (side if p.signed else 1.0)
    return np.clip(p.null + scale * away, p.low, p.high)
