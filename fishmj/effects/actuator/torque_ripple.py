"""The torque of a motor varies with its angle."""

from math import cos, pi, sin

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def law(joint, memory, sine, cosine, period):
    """The same at every turn of the motor."""
    phase = 2.0 * pi * joint.angle / period
    return sine * sin(phase) + cosine * cos(phase), 0.0


EFFECT = Effect(
    name="torque_ripple",
    stage="actuator",
    about="poles and slots of a motor attract each other (cogging), or a gear runs out of round: a torque periodic in the angle",
    formula="tau = a sin(2 pi q / P) + b cos(2 pi q / P)",
    source="direct and quasi-direct drives: 1 to 10 % of the rated torque, 6 to 60 periods a turn of the joint",
    robot=RobotForm(
        site="joint",
        scale=("torque", "torque", ""),
        parameters=(
            Parameter(name="sine", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),
            Parameter(name="cosine", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),
            Parameter(name="period", unit="rad", null=0.5, low=0.05, high=1.6, typical=(0.1, 1.2), shape=True, fine=True),
        ),
        law=law,
        confusions=(Confusion("torque_offset", "has one sign: turn the joint by half a period"),),
    ),
)
