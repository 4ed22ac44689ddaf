"""Water that never does the same twice."""

from fishmj.effects.effect import Confusion, Effect, Parameter

EFFECT = Effect(
    name="turbulence",
    stage="environment",
    about="gusts that differ between replicates: scatter, not a bias",
    formula="du = -u/tau dt + sigma sqrt(2/tau) dW, both components",
    source="paper, drift of a floating marker; 5 to 15 % of the current, 0.3 to 2 s",
    parameters=(
        Parameter(name="sigma", unit="m/s", low=0.0, high=0.2, typical=(0.005, 0.03)),
        Parameter(name="time", unit="s", null=1.0, low=0.05, high=10.0, typical=(0.3, 2.0), shape=True),
    ),
    shows=("position", "heading"),
    confusions=(
        Confusion("steady_current", "three replicates: the mean vanishes", ("drift_east",)),
        Confusion("noise_level", "grows with time, a resting log does not", ("idle", "drift_east")),
    ),
    stream="flow",
)
