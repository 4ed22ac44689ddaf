"""Sensors are noisier than believed."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EFFECT = Effect(
    name="noise_level",
    stage="measurement",
    about="white noise of all sensors is a factor above what their data sheet says",
    formula="sigma' = factor sigma",
    source="colour tracking: 1 to 3 mm, 0.5 to 1.5 deg",
    parameters=(Parameter(name="factor", unit="1", null=1.0, low=1.0, high=10.0, typical=(1.5, 3.0)),),
    unplanted="its sensors have noise of their own, for all runs alike",
    shows=("joint", "position", "heading", "power"),
    confusions=(Confusion("turbulence", "a resting log shows it", ("idle", "drift_east")),),
    stream="seen",
)
