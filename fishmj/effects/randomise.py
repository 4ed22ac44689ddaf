"""Domain randomisation from the catalogue: parameter rows of the size that real robots show."""

import numpy as np

from fishmj.effects.effect import Parameter
from fishmj.effects.stack import EffectStack


def draw(active: EffectStack, n: int, rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """(n, P) parameter rows in the order of `active.names`.

    Each value is uniform in its `typical` range, on either side of the null if the parameter is signed, `scale` times as far from
    the null, and inside the bounds. scale = 0 gives null rows. Shape parameters are drawn unscaled.
    """
    columns = [_column(p, n, rng, scale) for effect in active.effects for p in effect.parameters]
    return np.stack(columns, 1) if columns else np.zeros((n, 0))


def _column(p: Parameter, n: int, rng: np.random.Generator, scale: float) -> np.ndarray:
    value, side = rng.uniform(*p.typical, n), rng.choice((-1.0, 1.0), n)
    if p.shape:
        return np.clip(value, p.low, p.high)
    away = (value - p.null) * (side if p.signed else 1.0)
    return np.clip(p.null + scale * away, p.low, p.high)


def width(active: EffectStack, names) -> int:
    """Number of uniform draws that `drawn` needs for the effects `names`."""
    return 2 * sum(len(effect.parameters) for effect in active.effects if effect.name in names)


def drawn(xp, active: EffectStack, rows, names, uniforms, scale: float = 1.0):
    """Parameter rows (B, P) with those of the effects `names` drawn as by `draw`, from uniforms (B, width) in [0, 1).

    One definition serves NumPy and JAX: the uniform draws are passed in.
    """
    columns, k = [], 0
    for i, (name, parameter) in enumerate(active.names):
        if name not in names:
            columns.append(rows[:, i] + 0.0 * uniforms[:, 0])
            continue
        p = active.effect(name).parameter(parameter)
        value, side = p.typical[0] + (p.typical[1] - p.typical[0]) * uniforms[:, k], uniforms[:, k + 1]
        k += 2
        if not p.shape:
            away = (value - p.null) * (xp.where(side < 0.5, -1.0, 1.0) if p.signed else 1.0)
            value = p.null + scale * away
        columns.append(xp.minimum(xp.maximum(value, p.low), p.high))
    return xp.stack(columns, -1)
