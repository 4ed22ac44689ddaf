"""The clock of the readings runs at another rate than that of the commands."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

EFFECT = Effect(
    name="clock_drift",
    stage="timing",
    about="two computers without a time server stamp commands and readings",
    formula="t_reading = r t",
    source="quartz: 10 to 100 ppm; microcontrollers with a resonator: 0.1 to 0.5 %",
    native="",
    drifts={"joint": "rate"},
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="rate", unit="1", null=1.0, low=0.98, high=1.02, typical=(1.0005, 1.004)),),
        confusions=(Confusion("command_latency", "the delay grows along a record: make it longer"),),
    ),
)
