"""Commands take effect at a slower rate than they are sent."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

PHASES = 8  # over which a mean is taken


def command(p, t, c):
    """Mean over the moments at which the bus may take a command, which no log tells: each waits from none to a whole period."""
    stamps = t[:, None] + p.period * (np.arange(PHASES) + 0.5) / PHASES
    order = np.argsort(stamps, axis=None, kind="stable")
    jumps = np.repeat(np.diff(c, prepend=c[0]) / PHASES, PHASES)
    return stamps.ravel()[order], c[0] + np.cumsum(jumps[order])


def held_commands(p, t, c, first=0.0):
    """Every `period`, the latest command; between them the earlier one holds. first: when, as a share of the period."""
    if p.period <= 0.1 * np.median(np.diff(t)):
        return t, c
    ticks = np.arange(t[0] + (first - 1.0) * p.period, t[-1] + p.period, p.period)
    return ticks, c[np.maximum(np.searchsorted(t, ticks + 1e-9, side="right") - 1, 0)]


def drawn_commands(rng, p, t, c):
    """One draw for a whole record."""
    return held_commands(p, t, c, rng.uniform())


EFFECT = Effect(
    name="command_hold",
    stage="timing",
    about="the bus or the firmware takes a command only every so often, and holds it",
    formula="c'(t) = c(T floor(t / T))",
    source="bus servos: 5 to 40 ms",
    native="",
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="period", unit="s", low=0.0, high=0.2, typical=(0.008, 0.04)),),
        command=command,
        scatter=drawn_commands,
        simulated=held_commands,
        confusions=(Confusion("command_latency", "a hold makes steps: command a fast ramp and read the torque"),),
    ),
)
