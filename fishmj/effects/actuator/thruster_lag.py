"""A thruster's force follows its command late and smoothly: the rotor has to speed up."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command(p, t, c):
    """Mean of the lagged command over each hold: T dy/dt = c - y, exact for commands that hold; it begins settled."""
    h = np.append(np.diff(t), t[-1] - t[-2])
    kept = np.exp(-h / p.time)
    begin = np.empty(len(c))
    y = c[0]
    for k, (asked, share) in enumerate(zip(c.tolist(), kept.tolist(), strict=True)):
        begin[k] = y
        y = asked + (y - asked) * share
    return t, c + (begin - c) * p.time / h * (1.0 - kept)


EFFECT = Effect(
    name="thruster_lag",
    stage="actuator",
    about="rotor and propeller take time to speed up: force follows its command as a first-order lag",
    formula="T dF/dt = F_c - F",
    source="propellers of 0.1 to 0.3 m: 15 to 80 ms",
    native="actuator dyntype filter",
    robot=RobotForm(
        site="thrusters",
        parameters=(Parameter(name="time", unit="s", low=0.0, high=0.5, typical=(0.01, 0.06)),),
        command=command,
        confusions=(Confusion("command_latency", "a lag is smooth: command a step and read the acceleration"),),
    ),
)
