"""The servo's firmware walks to each new command in a fixed time."""

from fishmj.effects.effect import Confusion, Effect, Parameter

BUCKETS = 6  # in which the past is kept; a step's ramp is straight but for its last sixth, which is rounded a little


def command(xp, p, value, memory, h):
    """c' = mean of c over the last T_m: the ramp of each command, run into the next ones.

    memory: time since the last bucket was closed [s], what has come in since [rad s], what the buckets hold, newest first.
    """
    since, open_, *closed = memory
    length = xp.maximum(-h * xp.floor(-p.move_time / (BUCKETS * h)), h)  # of a bucket: whole steps
    full = since + 0.5 * h > length  # half a step of grace for round-off
    closed = [xp.where(full, before, held) for before, held in zip([open_, *closed], closed, strict=False)]
    since, open_ = xp.where(full, 0.0, since) + h, xp.where(full, 0.0, open_) + h * value
    taken = lambda k: xp.minimum(xp.maximum((p.move_time - since) / length - k, 0.0), 1.0)  # noqa: E731  share of bucket k
    total = open_ + sum(taken(k) * held for k, held in enumerate(closed))
    mean = total / xp.maximum(p.move_time, since)
    return xp.where(p.move_time > 0.0, mean, value), (since, open_, *closed)


EFFECT = Effect(
    name="move_time_ramp",
    stage="actuator",
    about="commands become ramps: half the move time as a delay, and a slope in proportion to the step",
    formula="c' = mean of c over the last T_m",
    source="bus servo protocol, move with time, as a running mean; 20 to 100 ms",
    parameters=(Parameter(name="move_time", unit="s", low=0.0, high=0.3, typical=(0.02, 0.1)),),
    shows=("joint", "position", "heading", "power"),
    confusions=(
        Confusion(other="command_latency", separates="a ramp starts at once, with finite slope", excitations=("steps", "square")),
        Confusion(other="rate_limit", separates="the slope grows with the size of the step", excitations=("staircase", "steps")),
        Confusion(other="servo_gain", separates="steps of different sizes end at the same time", excitations=("steps",)),
    ),
    memory=(0.0,) * (2 + BUCKETS),
    command=command,
    rank=2,
)
