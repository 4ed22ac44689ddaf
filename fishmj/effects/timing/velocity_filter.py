"""Logged velocities are smoothed, so they lag."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EFFECT = Effect(
    name="velocity_filter",
    stage="timing",
    about="velocities come from a longer filter than the model's: a group delay that only feedback and logged velocities feel",
    formula="velocity_log(t) = velocity(t - time)",
    source="straight-line fits and low passes on camera poses: 40 to 150 ms of group delay",
    parameters=(Parameter(name="time", unit="s", low=0.0, high=0.5, typical=(0.04, 0.15)),),
    confusions=(
        Confusion("camera_latency", "logged velocity against the differences of logged poses", ("burst_and_coast", "turn_left")),
    ),
    delays={"velocity": "time"},
)
