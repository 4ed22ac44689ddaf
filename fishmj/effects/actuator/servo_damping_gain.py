"""The controller's damping gain is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """Third number of an actuator's bias."""
    site.m.actuator_biasprm[site.actuator, 2] *= 1.0 + p.gain


EFFECT = Effect(
    name="servo_damping_gain",
    stage="actuator",
    about="the derivative gain of a position or velocity controller is not what the description says",
    formula="k_v' = (1 + g) k_v",
    source="firmware units of gains are seldom stated: 10 to 50 %",
    native="actuator biasprm",
    robot=RobotForm(
        site="actuator",
        parameters=(Parameter(name="gain", unit="1", low=-0.95, high=5.0, typical=(0.1, 0.5)),),
        fields=fields,
        confusions=(Confusion("viscous_friction", "switch the torque off and let the joint swing"),),
    ),
)
