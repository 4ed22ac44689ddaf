"""The robot's base does not stand level."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

ANGLES = tuple(Parameter(name=name, unit="rad", low=-0.3, high=0.3, typical=(0.01, 0.05)) for name in ("pitch", "roll"))


def fields(site, p):
    """Gravity turns by pitch about y and by roll about x of the world; to first order its size stays."""
    g = site.m.opt.gravity
    x, y, z = g
    g[:] = x - z * p.pitch, y + z * p.roll, z + x * p.pitch - y * p.roll


EFFECT = Effect(
    name="base_tilt",
    stage="environment",
    about="table or floor is not level: gravity pulls to one side",
    formula="g' = R_x(roll) R_y(pitch) g, small angles",
    source="tables and floors: 0.2 to 3 deg",
    parameters=(),
    shows=(),
    native="option gravity",
    robot=RobotForm(
        site="base",
        parameters=ANGLES,
        fields=fields,
        confusions=(Confusion("joint_zero_offset", "a zero moves one joint, a tilt all: turn the base by 90 deg"),),
    ),
)
