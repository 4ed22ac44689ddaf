"""Terms outside the catalogue that would improve many fits: a named effect must beat them.

In a short list it is easy to be first. These terms stand beside the catalogue in a search of measured data, in the same form.
"""

from fishmj.effects.effect import Effect, Parameter

SLOW = 0.02  # m/s, below which a constant resistance fades out


def _sway(xp, p, b, memory, h):
    return b._replace(fy=b.fy - b.wet * p.coefficient * b.w), memory


def _across(xp, p, b, memory, h):
    return b._replace(fy=b.fy - b.wet * p.coefficient * xp.abs(b.w) * b.w), memory


def _yaw(xp, p, b, memory, h):
    return b._replace(n=b.n - b.wet * p.coefficient * b.r), memory


def _side(xp, p, b, memory, h):
    return b._replace(fy=b.fy + b.wet * p.coefficient * b.push), memory


def _nothing(xp, p, b, memory, h):
    return b._replace(fy=b.fy + 0.0 * p.coefficient), memory


def _resist(xp, p, b, memory, h):
    return b._replace(fx=b.fx - b.wet * p.coefficient * b.u / xp.sqrt(b.u * b.u + SLOW * SLOW)), memory


def _cubic(xp, p, b, memory, h):
    return b._replace(fx=b.fx - b.wet * p.coefficient * b.u * b.u * b.u), memory


def _rival(name: str, formula: str, unit: str, size: float, body, signed: bool = False) -> Effect:
    low = -50 * size if signed else 0.0
    return Effect(
        name=name,
        stage="hydrodynamics",
        about="stands beside the catalogue when measured data are searched",
        formula=formula,
        source="none: a term that fits much and explains little",
        parameters=(Parameter(name="coefficient", unit=unit, low=low, high=50 * size, typical=(0.2 * size, size)),),
        shows=("position", "heading"),
        body=body,
    )


RIVALS = (
    _rival("linear_sway_damping", "fy = -c w", "N s/m", 1.0, _sway),
    _rival("quadratic_sway_drag", "fy = -c |w| w", "N s2/m2", 40.0, _across),
    _rival("linear_yaw_damping", "n = -c r", "N m s", 0.003, _yaw),
    _rival("tail_side_force", "fy = c A^2 b", "N/rad3", 0.3, _side, signed=True),
    _rival("inert", "nothing", "1", 1.0, _nothing, signed=True),
)
COAST_RIVALS = (
    _rival("constant_resistance", "fx = -c sign(u)", "N", 0.05, _resist),
    _rival("cubic_drag", "fx = -c u^3", "N s3/m3", 2.0, _cubic),
    RIVALS[-1],
)
