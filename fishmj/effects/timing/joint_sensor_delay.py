"""Encoder readings arrive late."""

from fishmj.effects.effect import Confusion, Effect, Parameter

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
        Confusion(other="command_latency", separates="the body does not lag", excitations=("chirp", "turn_left")),
        Confusion(other="viscous_friction", separates="phase grows with frequency, power is the same", excitations=("chirp",)),
        Confusion(other="clock_offset", separates="camera and power keep their phase to the commands", excitations=("impulse",)),
    ),
    delays={"joint": "delay"},
)
