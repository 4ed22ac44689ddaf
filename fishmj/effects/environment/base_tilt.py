"""The robot's base does not stand level."""

from math import cos, sin

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

ANGLES = tuple(Parameter(name=name, unit="rad", low=-0.3, high=0.3, typical=(0.01, 0.05)) for name in ("pitch", "roll"))


def fields(site, p):
    """Gravity turns by -pitch about y, then by -roll about x of the world: as seen from a base that is turned by them."""
    g = site.m.opt.gravity
    x, y, z = g
    x, z = x * cos(p.pitch) - z * sin(p.pitch), x * sin(p.pitch) + z * cos(p.pitch)
    g[:] = x, y * cos(p.roll) + z * sin(p.roll), z * cos(p.roll) - y * sin(p.roll)


EFFECT = Effect(
    name="base_tilt",
    stage="environment",
    about="table or floor is not level: gravity pulls to one side",
    formula="g' = R_x(-roll) R_y(-pitch) g",
    source="tables and floors: 0.2 to 3 deg",
    native="option gravity",
    robot=RobotForm(
        site="base",
        parameters=ANGLES,
        fields=fields,
        confusions=(Confusion("joint_zero_offset", "a zero moves one joint, a tilt all: turn the base by 90 deg"),),
    ),
)
