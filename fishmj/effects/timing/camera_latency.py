"""Poses arrive later than the model believes."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EFFECT = Effect(
    name="camera_latency",
    stage="timing",
    about="exposure, transfer and tracking take longer: position and heading lag, the joints do not",
    formula="pose_log(t) = pose(t - delay)",
    source="paper, calibration of latency; cameras over USB have 30 to 100 ms",
    parameters=(Parameter(name="delay", unit="s", low=0.0, high=0.25, typical=(0.02, 0.1)),),
    shows=("position", "heading"),
    native="sensor delay",
    confusions=(
        Confusion("clock_offset", "only an event seen by both clocks", ("impulse",)),
        Confusion("marker_offset", "a marker's error goes with heading, not with rate", ("spin",)),
        Confusion("command_latency", "the joints do not lag", ("chirp", "turn_left")),
    ),
    delays={"pose": "delay"},
)
