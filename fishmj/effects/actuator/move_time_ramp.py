"""The servo's firmware walks to each new command in a fixed time."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def command(xp, p, value, memory, h):
    """c' = c_0 + (c - c_0) min(1, t / T_m), restarted from where it is at each new command. Exact for steps."""
    start, target, clock = memory
    safe = xp.where(p.move_time > 0.0, p.move_time, 1.0)
    reached = lambda since: xp.where(since < p.move_time, since / safe, 1.0)
    fresh = xp.abs(value - target) > 0.0
    start = xp.where(fresh, start + (target - start) * reached(clock), start)
    clock = xp.minimum(xp.where(fresh, h, clock + h), 10.0)  # s; a ramp is over long before
    moved = xp.where(clock < p.move_time, start + (value - start) * reached(clock), value)
    return moved, (start, value + 0.0 * clock, clock)


EFFECT = Effect(
    name="move_time_ramp",
    stage="actuator",
    about="commands become ramps: half the move time as a delay, and a slope in proportion to the step",
    formula="c' = c_0 + (c - c_0) min(1, t/T_m) after each new command",
    source="bus servo protocol, move with time; 20 to 100 ms",
    parameters=(Parameter(name="move_time", unit="s", low=0.0, high=0.3, typical=(0.02, 0.1)),),
    shows=("joint", "position", "heading", "power"),
    confusions=(
        Confusion("command_latency", "a ramp starts at once, with finite slope", ("steps", "square")),
        Confusion("rate_limit", "the slope grows with the size of the step", ("staircase", "steps")),
        Confusion("servo_gain", "steps of different sizes end at the same time", ("steps",)),
    ),
    memory=(0.0, 0.0, 10.0),
    command=command,
    rank=2,
)
