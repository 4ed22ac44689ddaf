"""The servo gives less than its stall torque."""

from fishmj.base.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

STALL = constant("servo", "torque")  # N m, of the paper's servo: the null, at which any servo keeps its own limit


def servo(xp, p, s, memory, h):
    """limit' = min(limit, tau_max) where tau_max is below the paper's stall torque."""
    return s._replace(limit=xp.where(p.limit < STALL, xp.minimum(s.limit, p.limit), s.limit)), memory


def fields(site, p):
    """Range of the actuator's force; a narrower one that the description states stays."""
    m, a = site.m, site.actuator
    limit = p.limit / abs(site.gear)
    stated = m.actuator_forcerange[a] if m.actuator_forcelimited[a] else (-limit, limit)
    m.actuator_forcelimited[a] = 1
    m.actuator_forcerange[a] = max(stated[0], -limit), min(stated[1], limit)


EFFECT = Effect(
    name="torque_saturation",
    stage="actuator",
    about="torque is cut off earlier: brown-out, firmware limit, worn battery",
    formula="|drive| <= tau_max",
    source="paper: 17 kg cm at 7.4 V; 0.8 to 1.2 N m in a brown-out",
    parameters=(Parameter(name="limit", unit="N m", null=STALL, low=0.02, high=STALL, typical=(0.8, 1.2)),),
    shows=("joint", "position", "power"),
    native="actuator forcerange",
    confusions=(
        Confusion(
            "speed_limit", "saturation scales with inertia, air against water; a speed limit does not", ("square", "chirp")
        ),
        Confusion("voltage_sag", "does not depend on the other joints", ("steps", "gait")),
        Confusion("thermal_derating", "the same from the first second", ("gait", "burst_and_coast")),
    ),
    servo=servo,
    robot=RobotForm(
        site="actuator",
        scale="torque",
        parameters=(Parameter(name="limit", unit="N m", null=6.0, low=0.05, high=6.0, typical=(0.5, 1.0)),),
        fields=fields,
    ),
)
