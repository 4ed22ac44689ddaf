"""Commands take effect at a slower rate than they are sent."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command(p, t, c):
    """Every `period`, the latest command; between them the earlier one holds."""
    if p.period <= np.median(np.diff(t)):
        return t, c
    ticks = np.arange(t[0], t[-1] + p.period, p.period)
    return ticks, c[np.maximum(np.searchsorted(t, ticks + 1e-9, side="right") - 1, 0)]


EFFECT = Effect(
    name="command_hold",
    stage="timing",
    about="the bus or the firmware takes a command only every so often, and holds it",
    formula="c'(t) = c(T floor(t / T))",
    source="bus servos: 5 to 40 ms",
    parameters=(),
    shows=(),
    native="",
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="period", unit="s", low=0.0, high=0.2, typical=(0.008, 0.04)),),
        command=command,
        confusions=(Confusion("command_latency", "a hold makes steps: command a fast ramp and read the torque"),),
    ),
)
