"""Swimming figures of the second robot, for docs/search/virtual_robot.md.

python -m fishmj.gap.laboratory.virtual_robot.virtual_robot_figures
"""

import time

import numpy as np

from fishmj.base import console
from fishmj.gap.laboratory.swim_figures import SETTLE, gait_figures, gait_row, time_to_slow
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.simulate import at_rest, run
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.log import excitation

STRAIGHT = ((0.5, 60.0), (1.0, 60.0), (1.5, 60.0), (2.0, 60.0), (0.5, 0.0), (1.0, 0.0), (1.5, 0.0))  # Hz, lag in deg
GAITS = (*((f, lag, 0.0) for f, lag in STRAIGHT), *((1.0, 60.0, bias) for bias in (10.0, 20.0, 30.0)))  # and bias in deg


def steady(
    made: RobotConstants, frequency: float, amplitude: float, lag: float, bias: float = 0.0, watch: float = 4.0
) -> dict[str, float]:
    """Speed from beat to beat, turning rate, servo power of a gait [Hz, rad, rad, rad] in still water, without latency."""
    commands = excitation.gait(frequency, amplitude, lag, bias, SETTLE + watch)
    times = np.arange(len(commands)) * excitation.PERIOD
    record = run(made, at_rest((0.0, 0.0, 0.0), 0.0 * made.zero, made.motor.voltage), times, commands, times[-1])
    volts, amps = record.at(record.t, "V", "I").T
    return gait_figures(record.t, record.at(record.t, "x", "y", "yaw"), volts * amps - made.motor.idle, frequency)


def tow(made: RobotConstants, speed: float = 0.3) -> float:
    """Axial drag of the straight fish, N."""
    skin = made.water.friction * float(made.body.wetted.sum()) * speed**1.8
    return made.water.head_forward * speed**2 + skin


def coast(made: RobotConstants, speed: float = 0.3) -> float:
    """Time until a straight fish that was let go at `speed` [m/s] is half as fast, s."""
    record = run(made, at_rest((0.0, 0.0, 0.0), 0.0 * made.zero, made.motor.voltage, (speed, 0.0, 0.0)), [], [], 15.0)
    return time_to_slow(record.t, record.at(record.t, "vx")[:, 0], speed / 2)


def main(argv: list[str]) -> int:
    """Prints the figures. Returns the exit code."""
    console.parser("virtual_robot.figures", "Steady gaits of the second robot.", json=False).parse_args(argv)
    made, degree = plant({}, nuisance=0.0), np.pi / 180
    rows = [
        gait_row(frequency, lag, bias, steady(made, frequency, 30 * degree, lag * degree, bias * degree))
        for frequency, lag, bias in GAITS
    ]
    console.say(console.table(rows))
    body = made.body
    sway = ", ".join(f"{m:.2f}" for m in body.sway[:, 0])
    console.say(f"added mass sideways {body.sway[:, 0].sum():.2f} kg, links {sway}; along {body.surge.sum():.3f} kg")
    console.say(f"tow drag at 0.3 m/s {tow(made):.3f} N; glide from 0.3 to 0.15 m/s {coast(made):.1f} s")
    commands = excitation.gait(1.0, 30 * degree, 60 * degree, seconds=19.4)
    best = np.inf
    for _ in range(20):
        state, begin = at_rest((0.0, 0.0, 0.0), 0.0 * made.zero, made.motor.voltage), time.process_time()
        run(made, state, np.arange(len(commands)) * excitation.PERIOD, commands, 20.0)
        best = min(best, time.process_time() - begin)
    console.say(f"20 s of swimming take {1e3 * best:.1f} ms of one core")
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
