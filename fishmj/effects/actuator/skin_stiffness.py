"""The skin over a joint is a spring."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def gear(xp, p, g, memory, h):
    """tau = -k (angle + h w'), the spring at the end of the step: the part h k w' is taken implicitly."""
    return g._replace(torque=g.torque - p.stiffness * g.angle, resist=g.resist + h * p.stiffness), memory


EFFECT = Effect(
    name="skin_stiffness",
    stage="actuator",
    about="a silicone skin pulls joints straight: droop and holding power in proportion to the angle",
    formula="tau = -k angle",
    source="silicone tube of this size: 0.2 to 1.5 N m/rad",
    parameters=(Parameter(name="stiffness", unit="N m/rad", low=0.0, high=6.0, typical=(0.2, 1.0)),),
    stores=True,
    shows=("joint", "position", "power"),
    native="joint stiffness",
    confusions=(
        Confusion("servo_gain", "power to hold a constant angle", ("hold_angles", "staircase")),
        Confusion("command_gain_error", "droop needs power to hold, a wrong gain does not", ("hold_angles", "staircase")),
        Confusion("skin_hysteresis", "does not relax with time", ("hold_angles", "slow_triangle")),
    ),
    gear=gear,
)
