"""The command path of one fish, from the bus to the servos; the same in MuJoCo and in the flow solver."""

from collections.abc import Sequence

import numpy as np

from fishmj.mjcf.description import Servo


def on_the_bus(servo: Servo, command: np.ndarray) -> np.ndarray:
    """What the servos make of a command (J,) rad: clamped to the range, rounded to the resolution."""
    clamped = np.minimum(np.maximum(command, -servo.range), servo.range)
    return np.rint(clamped / servo.resolution) * servo.resolution


def arrived(commands: Sequence[np.ndarray], step: int, delay: int, steps: int, ramp: bool) -> np.ndarray:
    """What the servos aim at in physics step `step`, (J,) rad: the newest command that is `delay` steps old.

    Args:
        commands: all so far, one a bus tick of `steps` steps; number 0 was on the bus before t = 0.
        ramp: the servo moves evenly from one command to the next in one tick (the path "move_time").
    """
    whole, part = divmod(step - delay, steps)
    newest = commands[max(whole + 1, 0)]
    if not ramp:
        return newest
    before = commands[max(whole, 0)]
    return before + (part + 1) / steps * (newest - before)
