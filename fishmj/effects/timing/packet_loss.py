"""Some commands never arrive."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command(p, t, c):
    """Mean over the losses: c'_k = (1 - p) c_k + p c'_{k-1}. A row with the command before is no packet."""
    from scipy.signal import lfilter

    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    return t, lfilter([1.0 - p.probability], [1.0, -p.probability], c, zi=[p.probability * c[0]])[0]


def drawn_commands(rng, p, t, c):
    """Each command but the first is lost with the probability p: the one before it holds."""
    new = np.append(True, np.diff(c) != 0.0)
    t, c = t[new], c[new]
    kept = rng.uniform(size=len(t)) >= p.probability
    kept[:1] = True
    return t, c[np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))]


EFFECT = Effect(
    name="packet_loss",
    stage="timing",
    about="a lost command leaves the one before it standing: plateaus in the joints",
    formula="c'_k = c_k with probability 1 - p, else c'_{k-1}",
    source="wireless links: 0.1 to 5 %",
    parameters=(Parameter(name="probability", unit="1", low=0.0, high=0.9, typical=(0.005, 0.05)),),
    shows=("joint", "position", "heading"),
    confusions=(
        Confusion("latency_jitter", "isolated plateaus of whole packets", ("sine",)),
        Confusion("command_quantisation", "plateaus at random times, also in fast motion", ("sine",)),
    ),
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="probability", unit="1", low=0.0, high=0.9, typical=(0.02, 0.3)),),
        command=command,
        scatter=drawn_commands,
        confusions=(
            Confusion("command_latency", "plateaus at random times: compare the stamps at both ends"),
            Confusion("command_hold", "plateaus at random times: compare the stamps at both ends"),
        ),
    ),
    stream="command",
)
