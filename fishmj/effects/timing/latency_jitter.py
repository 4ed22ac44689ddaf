"""Commands arrive after times that vary from packet to packet."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command(p, t, c):
    """Mean over the delays: the mean of copies of the record, each with another quantile of the delay.

    P(delay < x) = prod_j (1 - exp(-(x + j T) / sigma)): packets T apart stay in order. A row with the command before is none.
    """
    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    copies, apart = 8, max(np.median(np.diff(t)), 0.01 * p.sigma) if len(t) > 1 else 1.0
    x = p.sigma * np.linspace(0.0, 12.0, 600)
    below = np.prod(-np.expm1(-(x[:, None] + apart * np.arange(min(8.0 * p.sigma / apart, 800.0) + 1)) / p.sigma), 1)
    stamps = t[:, None] + np.interp((np.arange(copies) + 0.5) / copies, below, x)
    order = np.argsort(stamps, axis=None, kind="stable")
    jumps = np.repeat(np.diff(c, prepend=c[0]) / copies, copies)
    return stamps.ravel()[order], c[0] + np.cumsum(jumps[order])


def drawn_commands(rng, p, t, c):
    """t'_k = max(t_k + d_k, t'_{k-1}), d_k exponential of mean sigma: late, never early, in order."""
    new = np.append(True, np.diff(c) != 0.0)
    return np.maximum.accumulate(t[new] + p.sigma * rng.standard_exponential(new.sum())), c[new]


EFFECT = Effect(
    name="latency_jitter",
    stage="timing",
    about="each packet has its own delay: scatter between replicates that grows with the speed of the command",
    formula="t_arrival = t + delay + d, d exponential of mean and deviation sigma",
    source="wireless links: 2 to 20 ms with a long tail",
    parameters=(Parameter(name="sigma", unit="s", low=0.0, high=0.1, typical=(0.002, 0.02)),),
    shows=("joint", "position", "heading"),
    confusions=(
        Confusion("packet_loss", "no plateaus; stamps at both ends", ("sine",)),
        Confusion("turbulence", "shows in the joints", ("sine", "gait")),
    ),
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="sigma", unit="s", low=0.0, high=0.1, typical=(0.003, 0.03)),),
        command=command,
        scatter=drawn_commands,
        confusions=(
            Confusion("command_latency", "commands spread, too: compare the stamps at both ends"),
            Confusion("packet_loss", "no plateaus: compare the stamps at both ends"),
            Confusion("joint_sensor_delay", "commands spread, too: compare the stamps at both ends"),
        ),
    ),
    stream="command",
)
