"""The supply sags under the current of all servos."""

from fishmj.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter

OPEN = constant("robot", "battery_voltage")  # V, at which the stall torque is quoted
LEAST = 0.3  # of it is left: boards switch off below


def servo(xp, p, s, memory, h):
    """limit' = limit V / V_oc, V = V_oc - R I; the no-load speed limit / k_b falls with it. I is that of one step ago."""
    share = xp.maximum(1.0 - p.resistance * s.current / OPEN, LEAST)
    return s._replace(limit=share * s.limit), memory


EFFECT = Effect(
    name="voltage_sag",
    stage="actuator",
    about="battery and leads have a resistance: everything is weaker and slower while several joints work",
    formula="limit' = limit (V_oc - R I) / V_oc, I the current of all servos",
    source="two cells and leads: 60 to 150 mohm fresh, 0.5 ohm worn and cold",
    parameters=(Parameter(name="resistance", unit="ohm", low=0.0, high=2.0, typical=(0.1, 0.5)),),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion(other="torque_saturation", separates="one joint alone against all together", excitations=("steps", "gait")),
        Confusion(other="thermal_derating", separates="milliseconds against minutes", excitations=("gait", "burst_and_coast")),
        Confusion(other="load_friction", separates="vary speed at equal load", excitations=("chirp", "hold_angles")),
    ),
    servo=servo,
)
