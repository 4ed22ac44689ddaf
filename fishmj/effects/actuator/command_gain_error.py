"""Commands are scaled on their way."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def command(xp, p, value, memory, h):
    """c' = (1 + g) c."""
    return (1.0 + p.gain) * value, memory


EFFECT = Effect(
    name="command_gain_error",
    stage="actuator",
    about="counts per degree are wrong: every angle comes out in proportion too large or small",
    formula="c' = (1 + g) c",
    source="open hardware's first firmware: 0.96 by integer division; 1 to 5 % is usual",
    parameters=(Parameter(name="gain", unit="1", low=-0.3, high=0.3, typical=(0.01, 0.05)),),
    shows=("joint", "position", "heading", "power"),
    native="actuator gear",
    confusions=(
        Confusion("skin_stiffness", "no power is needed to hold", ("hold_angles", "staircase")),
        Confusion("servo_gain", "the same at every frequency", ("chirp", "staircase")),
        Confusion("tail_normal_force", "shows in the joints", ("gait", "staircase")),
    ),
    command=command,
)
