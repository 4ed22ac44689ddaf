"""An encoder reads every angle in proportion too large or small."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def reading(p):
    """Encoder: (1 + s) angle."""
    return 1.0 + p.scale, 0.0


EFFECT = Effect(
    name="joint_scale",
    stage="measurement",
    about="counts per turn, or the ratio of the gears behind the encoder, are off",
    formula="reading = (1 + s) q",
    source="potentiometers 1 to 3 %; a wrong gear ratio 5 % and more",
    native="",
    robot=RobotForm(
        site="joint",
        parameters=(Parameter(name="scale", unit="1", low=-0.3, high=0.3, typical=(0.01, 0.06)),),
        reading=reading,
        confusions=(Confusion("servo_gain", "hold known angles and read a protractor"),),
    ),
)
