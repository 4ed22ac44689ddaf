"""Decoy terms outside the catalogue that improve many fits: a named effect must beat them.

In a short list of candidates one easily comes first by chance. A search of measured data therefore includes these terms.
"""

from collections.abc import Callable

from fishmj.effects.effect import Effect, Parameter

SLOW = 0.02  # m/s, below which a constant resistance fades out


def _rival(name: str, formula: str, unit: str, size: float, act: Callable, signed: bool = False) -> Effect:
    """A rival. act: (namespace of arrays, body, coefficient) -> the changed forces on the body, by field."""
    low = -50 * size if signed else 0.0
    return Effect(
        name=name,
        stage="hydrodynamics",
        about="an alternative to the catalogue in searches of measured data",
        formula=formula,
        source="none: a term that fits many data sets and explains little",
        parameters=(Parameter(name="coefficient", unit=unit, low=low, high=50 * size, typical=(0.2 * size, size)),),
        shows=("position", "heading"),
        body=lambda xp, p, b, memory, h: (b._replace(**act(xp, b, p.coefficient)), memory),
    )


def _resistance(xp, b, c) -> dict:
    return {"fx": b.fx - b.wet * c * b.u / xp.sqrt(b.u * b.u + SLOW * SLOW)}


RIVALS = (
    _rival("linear_sway_damping", "fy = -c w", "N s/m", 1.0, lambda xp, b, c: {"fy": b.fy - b.wet * c * b.w}),
    _rival(
        "quadratic_sway_drag", "fy = -c |w| w", "N s2/m2", 40.0, lambda xp, b, c: {"fy": b.fy - b.wet * c * xp.abs(b.w) * b.w}
    ),
    _rival("linear_yaw_damping", "n = -c r", "N m s", 0.003, lambda xp, b, c: {"n": b.n - b.wet * c * b.r}),
    _rival("tail_side_force", "fy = c A^2 b", "N/rad3", 0.3, lambda xp, b, c: {"fy": b.fy + b.wet * c * b.push}, signed=True),
    _rival("inert", "nothing", "1", 1.0, lambda xp, b, c: {"fy": b.fy + 0.0 * c}, signed=True),
)
COAST_RIVALS = (
    _rival("constant_resistance", "fx = -c sign(u)", "N", 0.05, _resistance),
    _rival("cubic_drag", "fx = -c u^3", "N s3/m3", 2.0, lambda xp, b, c: {"fx": b.fx - b.wet * c * b.u * b.u * b.u}),
    RIVALS[-1],
)
