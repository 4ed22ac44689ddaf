"""Encoder readings arrive late."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

EFFECT = Effect(
    name="joint_sensor_delay",
    stage="timing",
    about="joint angles are read over a slow bus: the joint channel lags, the body does not",
    formula="joint_log(t) = joint(t - delay)",
    source="half duplex bus at 115200 baud: 5 to 60 ms",
    parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.25, typical=(0.01, 0.06)),),
    shows=("joint",),
    native="sensor delay",
    confusions=(
        Confusion("command_latency", "the body does not lag", ("chirp", "turn_left")),
        Confusion("viscous_friction", "phase grows with frequency, power is the same", ("chirp",)),
        Confusion("clock_offset", "camera and power keep their phase to the commands", ("impulse",)),
    ),
    delays={"joint": "delay"},
    robot=RobotForm(site="robot", parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.2, typical=(0.003, 0.03)),)),
)
