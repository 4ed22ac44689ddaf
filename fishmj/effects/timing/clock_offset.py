"""The camera's computer has another clock."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EFFECT = Effect(
    name="clock_offset",
    stage="timing",
    about="poses are stamped by a clock that is off and drifts against that of the commands",
    formula="t_stamp = t + offset + (drift - 1) t",
    source="computers without a time server: 0 to 50 ms, 10 to 40 ppm",
    parameters=(
        Parameter(name="offset", unit="s", low=-0.2, high=0.2, typical=(0.01, 0.05)),
        Parameter(name="drift", unit="1", null=1.0, low=0.999, high=1.001, typical=(1.00001, 1.00004), about="rate of the clock"),
    ),
    shows=("position", "heading"),
    confusions=(
        Confusion(
            "camera_latency", "only an event seen by both clocks; drift shows from start to end of a session", ("impulse",)
        ),
        Confusion("joint_sensor_delay", "joints keep their phase to the commands", ("chirp",)),
    ),
    delays={"pose": "offset"},
    drifts={"pose": "drift"},
)
