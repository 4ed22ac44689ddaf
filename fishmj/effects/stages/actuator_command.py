"""Effects of the stage `actuator` on commands: gain, counts, ramps, rate limits, lag of thrusters."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def command_gain_error_command(xp, p, value, memory, h):
    """c' = (1 + g) c."""
    return (1.0 + p.gain) * value, memory


COMMAND_GAIN_ERROR = Effect(
    name="command_gain_error",
    stage="actuator",
    about="counts per degree are wrong: every angle comes out in proportion too large or small",
    formula="c' = (1 + g) c",
    source="open hardware's first firmware: 0.96 by integer division; 1 to 5 % is usual",
    parameters=(Parameter(name="gain", unit="1", low=-0.3, high=0.3, typical=(0.01, 0.05)),),
    shows=("joint", "position", "heading", "power"),
    native="actuator gear",
    confusions=(
        Confusion("skin_stiffness", "no power is needed to hold", ("hold_angles", "staircase")),
        Confusion("servo_gain", "the same at every frequency", ("chirp", "staircase")),
        Confusion("tail_normal_force", "shows in the joints", ("gait", "staircase")),
    ),
    command=command_gain_error_command,
)


def command_quantisation_command(xp, p, value, memory, h):
    """c' = q floor(c / q + 1/2)."""
    size = xp.where(p.step > 0.0, p.step, 1.0)
    return xp.where(p.step > 0.0, size * xp.floor(value / size + 0.5), value), memory


def command_quantisation_of_record(p, t, c):
    """c' = q round(c / q), for a whole record."""
    return t, p.step * np.floor(c / p.step + 0.5)


COMMAND_QUANTISATION = Effect(
    name="command_quantisation",
    stage="actuator",
    about="counts are coarser than the model's: slow motion goes in steps",
    formula="c' = q round(c/q)",
    source="open hardware: 240 deg over 1000 counts; one degree where firmware sends whole degrees",
    parameters=(Parameter(name="step", unit="rad", low=0.0, high=0.2, typical=(0.01, 0.035), fine=True),),
    shows=("joint", "power"),
    confusions=(
        Confusion("servo_deadband", "width of the stairs against a constant error", ("slow_triangle", "staircase")),
        Confusion("gear_backlash", "stairs all along the way, not only at reversals", ("slow_triangle",)),
    ),
    command=command_quantisation_command,
    robot=RobotForm(
        site="actuator",
        scale="command",
        parameters=(Parameter(name="step", unit="N m or rad", low=0.0, high=2.0, typical=(0.05, 0.3), fine=True),),
        command=command_quantisation_of_record,
    ),
    rank=1,
)


def move_time_ramp_command(xp, p, value, memory, h):
    """c' = c_0 + (c - c_0) min(1, t / T_m), restarted from where it is at each new command. Exact for steps."""
    start, target, clock = memory
    safe = xp.where(p.move_time > 0.0, p.move_time, 1.0)
    reached = lambda since: xp.where(since < p.move_time, since / safe, 1.0)
    fresh = xp.abs(value - target) > 0.0
    start = xp.where(fresh, start + (target - start) * reached(clock), start)
    clock = xp.minimum(xp.where(fresh, h, clock + h), 10.0)  # s; a ramp is over long before
    moved = xp.where(clock < p.move_time, start + (value - start) * reached(clock), value)
    return moved, (start, value + 0.0 * clock, clock)


MOVE_TIME_RAMP = Effect(
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
    command=move_time_ramp_command,
    rank=2,
)


def rate_limit_command(xp, p, value, memory, h):
    """|c'_k - c'_{k-1}| <= h / s."""
    (last,) = memory
    most = h / xp.where(p.slowness > 0.0, p.slowness, 1.0)
    near = last + xp.minimum(xp.maximum(value - last, -most), most)
    moved = xp.where(p.slowness > 0.0, near, value)
    return moved, (moved,)


RATE_LIMIT = Effect(
    name="rate_limit",
    stage="actuator",
    about="large moves become ramps of one slope, whatever the load",
    formula="|dc'/dt| <= 1/s",
    source="servo firmware: 2 to 8 rad/s",
    parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=2.0, typical=(0.15, 0.5), of="slowness"),),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("speed_limit", "does not depend on load, air against water", ("square", "steps")),
        Confusion("move_time_ramp", "one slope for every step size", ("staircase", "steps")),
        Confusion("torque_saturation", "small fast moves stay whole", ("steps", "chirp")),
    ),
    memory=(0.0,),
    command=rate_limit_command,
    rank=3,
)


def thruster_lag_command(p, t, c):
    """Mean of the lagged command over each hold: T dy/dt = c - y, exact for commands that hold; it begins settled."""
    h = np.append(np.diff(t), t[-1] - t[-2])
    kept = np.exp(-h / p.time)
    begin = np.empty(len(c))
    y = c[0]
    for k, (asked, share) in enumerate(zip(c.tolist(), kept.tolist(), strict=True)):
        begin[k] = y
        y = asked + (y - asked) * share
    return t, c + (begin - c) * p.time / h * (1.0 - kept)


THRUSTER_LAG = Effect(
    name="thruster_lag",
    stage="actuator",
    about="rotor and propeller take time to speed up: force follows its command as a first-order lag",
    formula="T dF/dt = F_c - F",
    source="propellers of 0.1 to 0.3 m: 15 to 80 ms",
    native="actuator dyntype filter",
    robot=RobotForm(
        site="thrusters",
        parameters=(Parameter(name="time", unit="s", low=0.0, high=0.5, typical=(0.01, 0.06)),),
        command=thruster_lag_command,
        confusions=(Confusion("command_latency", "a lag is smooth: command a step and read the acceleration"),),
    ),
)
