"""Swimming figures of the generators' robots, for docs/search/generators.md.

python -m fishmj.gap.laboratory.generators.generator_figures [--model FISH]
"""

import time

import numpy as np

from fishmj.base import console
from fishmj.gap.laboratory.generators import NAMES
from fishmj.gap.laboratory.generators.generator_trials import record, robot_of
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters
from fishmj.gap.laboratory.swim_figures import SETTLE, gait_figures, gait_row, time_to_slow
from fishmj.log import excitation
from fishmj.log.excitation import Excitation

WATCH = 4.0  # s
GAITS = ((0.5, 60.0, 0.0), (1.0, 60.0, 0.0), (1.5, 60.0, 0.0), (1.0, 0.0, 0.0), (1.0, 60.0, 20.0))  # Hz, lag and bias in deg


def steady(fish: RobotParameters, frequency: float, lag: float, bias: float) -> dict[str, float]:
    """Speed m/s, turning rad/s and servo power W of 30 deg on all joints in still water; Hz, deg, deg."""
    commands = excitation.gait(frequency, np.radians(30.0), np.radians(lag), np.radians(bias), SETTLE + WATCH)
    motion = record(fish, Excitation(id="steady", commands=commands, about="a steady gait"), 0, 0, 0.0)
    return gait_figures(motion.t, motion.q[:, :3], motion.volts * motion.amps - fish.robot.servo.idle_power, frequency)


def coast(fish: RobotParameters, speed: float = 0.3) -> float:
    """Time until a straight fish that was let go at `speed` [m/s] is half as fast, s."""
    still = np.zeros((1500, fish.joints))
    motion = record(fish, Excitation(id="coast", commands=still, about="let go", push=(speed, 0.0, 0.0)), 0, 0, 0.0)
    return time_to_slow(motion.t, motion.rate[:, 0], speed / 2)


def main(argv: list[str]) -> int:
    """Prints the figures. Returns the exit code."""
    parser = console.parser("generators.figures", "Steady gaits of the robots of every generator.", json=False)
    parser.add_argument("--model", type=console.text, default="fish", help="the robot: name or TOML file (default fish)")
    args = parser.parse_args(argv)
    rows: list[dict] = []
    for name in NAMES:
        fish = robot_of(name, {}, 0, nuisance=0.0, robot=args.model)
        fish.network.latency = 0.0  # what was sent is there at the next tick
        rows += [{"generator": name, **gait_row(*gait, steady(fish, *gait))} for gait in GAITS]
    console.say(console.table([row | {"turn deg/s": row["turn deg/s"] + 0.0} for row in rows]))  # 0, not -0
    for name in NAMES:
        fish = robot_of(name, {}, 0, nuisance=0.0, robot=args.model)
        added = fish.water().added
        along, across = added[:, 0, 0].sum(), added[:, 1, 1].sum()
        begin = time.process_time()
        motion = [record(fish, excitation.get(run), 0, 0, 0.0) for run in excitation.DESIGNED]
        took, seconds = time.process_time() - begin, sum(m.t[-1] for m in motion)
        carried = f"added mass {along:.2f} kg along, {across:.2f} kg across"
        glide = f"glides from 0.3 to 0.15 m/s in {coast(fish):.1f} s"
        console.say(f"{name}: {carried}; {glide}; {len(motion)} records of {seconds:.0f} s in {took:.1f} s of one core")
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
