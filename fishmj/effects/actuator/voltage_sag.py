"""The supply sags under the current of all servos."""

from fishmj.base.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter

OPEN = constant("robot", "battery_voltage")  # V, at which the stall torque is quoted
BOARDS = constant("servo", "idle_power") / constant("servo", "voltage")  # A, drawn at rest
LEAST = 0.3  # of it is left: boards switch off below


def servo(xp, p, s, memory, h):
    """(limit, k_p, k_v)' = (limit, k_p, k_v) V / V_oc, V = V_oc - R I: the controller sets a duty, the supply the voltage.

    The no-load speed limit / k_b falls with it. I = sum d i is the current of motors (one step ago) and boards: the
    motor's current i falls with V, the duty d does not.
    """
    share = xp.maximum(1.0 - p.resistance * (s.current + BOARDS) / OPEN, LEAST)
    return s._replace(limit=share * s.limit, kp=share * s.kp, kv=share * s.kv, supply=share * s.supply), memory


def measure(xp, p, seen):
    """P' = P - I_b (V_oc - V): the boards draw I_b at any voltage. P = V (I + I_b) + I_b (V_oc - V) determines V."""
    motors = seen.power - BOARDS * OPEN
    unloaded = OPEN - p.resistance * BOARDS
    volts = (unloaded + xp.sqrt(xp.maximum(unloaded * unloaded - 4.0 * p.resistance * motors, 0.0))) / 2.0
    return seen._replace(power=seen.power - BOARDS * (OPEN - xp.maximum(volts, LEAST * OPEN)))


EFFECT = Effect(
    name="voltage_sag",
    stage="actuator",
    about="battery and leads have a resistance: everything is weaker and slower while several joints work",
    formula="torque' = torque (V_oc - R I) / V_oc, I the supply's current",
    source="two cells and leads: 60 to 150 mohm fresh; worn, cold or through thin wire up to an ohm",
    parameters=(Parameter(name="resistance", unit="ohm", low=0.0, high=6.0, typical=(0.1, 1.0)),),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("torque_saturation", "one joint alone against all together", ("steps", "gait")),
        Confusion("thermal_derating", "milliseconds against minutes", ("gait", "burst_and_coast")),
        Confusion("load_friction", "vary speed at equal load", ("chirp", "hold_angles")),
    ),
    servo=servo,
    measure=measure,
)
