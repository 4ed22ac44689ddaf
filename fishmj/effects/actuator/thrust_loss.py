"""All thrusters push less than described."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """Gain of every actuator that acts on a site."""
    site.m.actuator_gainprm[site.thrusters, 0] *= 1.0 - p.share


EFFECT = Effect(
    name="thrust_loss",
    stage="actuator",
    about="an empty battery, thin air or worn propellers: every thruster gives the same share less, or more",
    formula="F' = (1 - s) F",
    source="a lithium cell falls from 4.2 to 3.5 V: up to 30 % of the thrust",
    native="actuator gainprm",
    robot=RobotForm(
        site="thrusters",
        parameters=(Parameter(name="share", unit="1", low=-1.0, high=0.9, typical=(0.04, 0.2)),),
        fields=fields,
        confusions=(Confusion("body_mass", "weigh the robot: a free body shows force over mass only"),),
    ),
)
