"""Commands come in coarse steps."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command(xp, p, value, memory, h):
    """c' = q floor(c / q + 1/2)."""
    size = xp.where(p.step > 0.0, p.step, 1.0)
    return xp.where(p.step > 0.0, size * xp.floor(value / size + 0.5), value), memory


def robot_command(p, t, c):
    """c' = q round(c / q), for a whole record."""
    return t, p.step * np.floor(c / p.step + 0.5)


EFFECT = Effect(
    name="command_quantisation",
    stage="actuator",
    about="counts are coarser than the model's: slow motion goes in steps",
    formula="c' = q round(c/q)",
    source="open hardware: 240 deg over 1000 counts; one degree where firmware sends whole degrees",
    parameters=(Parameter(name="step", unit="rad", low=0.0, high=0.2, typical=(0.01, 0.035), fine=True),),
    shows=("joint", "power"),
    confusions=(
        Confusion("servo_deadband", "width of the stairs against a constant error", ("slow_triangle", "staircase")),
        Confusion("gear_backlash", "stairs all along the way, not only at reversals", ("slow_triangle",)),
    ),
    command=command,
    robot=RobotForm(
        site="actuator",
        scale="command",
        parameters=(Parameter(name="step", unit="N m or rad", low=0.0, high=2.0, typical=(0.05, 0.3), fine=True),),
        command=robot_command,
    ),
    rank=1,
)
