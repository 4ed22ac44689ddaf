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
        Confusion(other="clock_offset", separates="only an event seen by both clocks", excitations=("impulse",)),
        Confusion(other="marker_offset", separates="a marker's error goes with heading, not with rate", excitations=("spin",)),
        Confusion(other="command_latency", separates="the joints do not lag", excitations=("chirp", "turn_left")),
    ),
    delays={"pose": "delay"},
)
