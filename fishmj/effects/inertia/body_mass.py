"""The fish is heavier: trapped water, payload."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """m_i' = m_i (1 + dm / sum m), inertia alike."""
    share = 1.0 + p.mass / sum(c.chain.mass)
    return c._replace(swimmer=c.swimmer._replace(mass=[share * m for m in c.swimmer.mass]))


EFFECT = Effect(
    name="body_mass",
    stage="inertia",
    about="mass spread over the links by their share: water under the skin",
    formula="m_i' = m_i (1 + dm/m)",
    source="a flooded skin holds 0.05 to 0.3 kg",
    parameters=(Parameter(name="mass", unit="kg", low=-0.5, high=1.5, typical=(0.05, 0.3)),),
    shows=("position", "heading", "joint"),
    native="body mass",
    confusions=(
        Confusion(
            other="surge_added_mass",
            separates="weigh it; a fast turn needs m u r, added mass in surge does not",
            excitations=("burst_and_coast", "turn_left"),
        ),
        Confusion(other="quadratic_drag", separates="steady speed is the same", excitations=("gait", "burst_and_coast")),
    ),
    fish=fish,
)
