"""The position controller is stiffer or softer than the model's."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def servo(xp, p, s, memory, h):
    """k_p' = (1 + g) k_p, k_v' = (1 + g) k_v."""
    return s._replace(kp=(1.0 + p.gain) * s.kp, kv=(1.0 + p.gain) * s.kv), memory


def fields(site, p):
    """Gain and bias of the actuator, a constant force of it aside."""
    site.m.actuator_gainprm[site.actuator, 0] *= 1.0 + p.gain
    site.m.actuator_biasprm[site.actuator, 1:3] *= 1.0 + p.gain


EFFECT = Effect(
    name="servo_gain",
    stage="actuator",
    about="bandwidth of the joint is off: amplitude and phase change with frequency",
    formula="(k_p, k_v)' = (1 + g) (k_p, k_v)",
    source="spread of gains between servos of one type: 10 to 30 %",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.3)),),
    shows=("joint", "position", "power"),
    native="actuator gainprm, biasprm",
    confusions=(
        Confusion("command_latency", "amplitude changes too; two frequencies a decade apart", ("chirp", "staircase")),
        Confusion("skin_stiffness", "power needed to hold a constant angle", ("hold_angles", "staircase")),
        Confusion("viscous_friction", "error of a held angle under load", ("hold_angles", "chirp")),
    ),
    servo=servo,
    robot=RobotForm(
        site="actuator", parameters=(Parameter(name="gain", unit="1", low=-0.9, high=2.0, typical=(0.08, 0.3)),), fields=fields
    ),
)
