"""Warm motors are weaker."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def servo(xp, p, s, memory, h):
    """(limit, k_p, k_v)' = (limit, k_p, k_v) e^(-a t)."""
    left = xp.exp(-p.rate * s.time)
    return s._replace(limit=left * s.limit, kp=left * s.kp, kv=left * s.kv), memory


EFFECT = Effect(
    name="thermal_derating",
    stage="actuator",
    about="torque fades over a session as the windings warm up",
    formula="torque' = torque e^(-a t)",
    source="copper 0.4 %/K; an XL330 warms by 11 K in two minutes",
    parameters=(Parameter(name="rate", unit="1/s", low=0.0, high=0.2, typical=(3e-4, 5e-3)),),
    planted="ten times as fast: it must show within a run of some ten seconds",
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("voltage_sag", "minutes against milliseconds", ("gait", "steps")),
        Confusion("torque_saturation", "the first run of a session against the last", ("gait",)),
        Confusion("servo_gain", "the first run of a session against the last", ("chirp", "gait")),
    ),
    servo=servo,
)
