"""The position controller ignores small errors."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EDGE = 0.002  # rad, half a count of the servo: width over which the controller wakes up


def servo(xp, p, s, memory, h):
    """e' = e for |e| >= d, 0 for |e| <= d - EDGE, in between linear in |e|: finite slope, full torque outside."""
    awake = xp.minimum(xp.maximum((xp.abs(s.error) - p.deadband) / EDGE + 1.0, 0.0), 1.0)
    return s._replace(error=s.error * awake), memory


EFFECT = Effect(
    name="servo_deadband",
    stage="actuator",
    about="no torque while the error is small, so a joint stops short of its command, whatever the load",
    formula="e' = 0 where |e| < d",
    source="bus servos: one or two counts of 0.24 deg, hobby servos up to 2 deg",
    parameters=(Parameter(name="deadband", unit="rad", low=0.0, high=0.2, typical=(0.005, 0.035)),),
    shows=("joint", "power"),
    confusions=(
        Confusion(
            "coulomb_friction",
            "a dead band's error does not depend on load or on the direction of approach",
            ("staircase", "slow_triangle"),
        ),
        Confusion("joint_zero_offset", "the error changes sign with the direction of approach", ("staircase",)),
        Confusion(
            "command_quantisation",
            "a staircase of fine steps: quantisation skips steps, a dead band trails by a constant",
            ("staircase", "slow_triangle"),
        ),
    ),
    servo=servo,
)
