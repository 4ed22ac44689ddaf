"""A medium round the robot that the description leaves out."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """Density of MuJoCo's medium, which drags at the box of each body's inertia."""
    site.m.opt.density += p.density


EFFECT = Effect(
    name="air_drag",
    stage="environment",
    about="air or water drags at fast links, with the square of their speed",
    formula="F = -rho/2 C A |v| v",
    source="air 1.2 kg/m3; sails and covers act like several times that",
    native="option density",
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="density", unit="kg/m3", low=0.0, high=1500.0, typical=(1.2, 60.0)),),
        fields=fields,
        confusions=(Confusion("quadratic_friction", "move one joint after the other"),),
    ),
)
