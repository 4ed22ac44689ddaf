"""Steady gaits and glides of the robots that stand in for a real one, for `docs/search/virtual_robot.md` and `generators.md`.

python -m studies.steady_gaits [--model FISH]        the second robot, then the robot FISH of every generator
"""

import time

import numpy as np

from fishmj.base import console
from fishmj.gap.laboratory.generators import NAMES
from fishmj.gap.laboratory.generators.generator_trials import record, robot_of
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.simulate import at_rest, run
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.log import excitation
from fishmj.log.excitation import LEAD, Excitation

SETTLE, WATCH = 8.0, 4.0  # s, of a gait until it is steady, and from then on
SWING = np.radians(30.0)  # of all joints
STRAIGHT = ((0.5, 60.0), (1.0, 60.0), (1.5, 60.0), (2.0, 60.0), (0.5, 0.0), (1.0, 0.0), (1.5, 0.0))  # Hz, lag in deg
GAITS = (*((f, lag, 0.0) for f, lag in STRAIGHT), *((1.0, 60.0, bias) for bias in (10.0, 20.0, 30.0)))  # and bias in deg
GAITS_OF_GENERATORS = ((0.5, 60.0, 0.0), (1.0, 60.0, 0.0), (1.5, 60.0, 0.0), (1.0, 0.0, 0.0), (1.0, 60.0, 20.0))


def gait(frequency: float, lag: float, bias: float) -> np.ndarray:
    """(T, J) rad: a gait of 30 deg; Hz, deg, deg."""
    return excitation.gait(frequency, SWING, np.radians(lag), np.radians(bias), SETTLE + WATCH)


def gait_figures(t: np.ndarray, pose: np.ndarray, watts: np.ndarray, frequency: float) -> dict[str, float]:
    """Speed from beat to beat m/s, turning rate rad/s, mean power W of a gait, Hz. t (T,); pose (T, 3) m, m, rad; watts (T,)."""
    begin = LEAD + SETTLE
    beats = begin + np.arange(int((t[-1] - begin) * frequency) + 1) / frequency
    x, y, yaw = (np.interp(beats, t, column) for column in pose.T)
    span, whole = float(beats[-1] - beats[0]), (t >= beats[0]) & (t < beats[-1])
    speed, turn = float(np.hypot(np.diff(x), np.diff(y)).sum()) / span, float(yaw[-1] - yaw[0]) / span
    return {"speed": speed, "turn": turn, "power": float(watts[whole].mean())}


def gait_row(frequency: float, lag: float, bias: float, found: dict[str, float]) -> dict[str, float]:
    """Row of a table: a gait (Hz, deg, deg) and its figures."""
    speed, turn, power = round(found["speed"], 3), round(float(np.degrees(found["turn"])), 1), round(found["power"], 2)
    row = {"Hz": frequency, "lag deg": lag, "bias deg": bias}
    return row | {"speed m/s": speed, "turn deg/s": turn + 0.0, "servo power W": power}  # 0, not -0


def time_to_slow(t: np.ndarray, along: np.ndarray, speed: float) -> float:
    """Seconds until the velocity `along` (T,) is below `speed`, m/s; nan if it stays above."""
    slow = np.flatnonzero(along < speed)
    return float(t[slow[0]]) if len(slow) else float("nan")


# ---- the second robot ----


def steady(made: RobotConstants, frequency: float, lag: float, bias: float = 0.0) -> dict[str, float]:
    """Figures of a gait (Hz, deg, deg) in still water, without latency."""
    commands = gait(frequency, lag, bias)
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


def second_robot() -> None:
    """Prints its figures."""
    made = plant({}, nuisance=0.0)
    console.say(console.table([gait_row(*each, steady(made, *each)) for each in GAITS]))
    body = made.body
    sway = ", ".join(f"{m:.2f}" for m in body.sway[:, 0])
    console.say(f"added mass sideways {body.sway[:, 0].sum():.2f} kg, links {sway}; along {body.surge.sum():.3f} kg")
    console.say(f"tow drag at 0.3 m/s {tow(made):.3f} N; glide from 0.3 to 0.15 m/s {coast(made):.1f} s")
    commands = excitation.gait(1.0, SWING, np.radians(60.0), seconds=19.4)
    best = np.inf
    for _ in range(20):
        state, begin = at_rest((0.0, 0.0, 0.0), 0.0 * made.zero, made.motor.voltage), time.process_time()
        run(made, state, np.arange(len(commands)) * excitation.PERIOD, commands, 20.0)
        best = min(best, time.process_time() - begin)
    console.say(f"20 s of swimming take {1e3 * best:.1f} ms of one core")


# ---- the robots of the generators ----


def steady_of(fish: RobotParameters, frequency: float, lag: float, bias: float) -> dict[str, float]:
    """Figures of a gait (Hz, deg, deg) in still water."""
    motion = record(fish, Excitation(id="steady", commands=gait(frequency, lag, bias), about="a steady gait"), 0, 0, 0.0)
    return gait_figures(motion.t, motion.q[:, :3], motion.volts * motion.amps - fish.robot.servo.idle_power, frequency)


def coast_of(fish: RobotParameters, speed: float = 0.3) -> float:
    """Time until a straight fish that was let go at `speed` [m/s] is half as fast, s."""
    still = np.zeros((1500, fish.joints))
    motion = record(fish, Excitation(id="coast", commands=still, about="let go", push=(speed, 0.0, 0.0)), 0, 0, 0.0)
    return time_to_slow(motion.t, motion.rate[:, 0], speed / 2)


def robots_of_generators(model: str) -> None:
    """Prints the figures of a robot, a name or TOML file, in the water of every generator."""
    rows: list[dict] = []
    for name in NAMES:
        fish = robot_of(name, {}, 0, nuisance=0.0, robot=model)
        fish.network.latency = 0.0  # what was sent is there at the next tick
        rows += [{"generator": name, **gait_row(*each, steady_of(fish, *each))} for each in GAITS_OF_GENERATORS]
    console.say(console.table(rows))
    for name in NAMES:
        fish = robot_of(name, {}, 0, nuisance=0.0, robot=model)
        added = fish.water().added
        along, across = added[:, 0, 0].sum(), added[:, 1, 1].sum()
        begin = time.process_time()
        motion = [record(fish, excitation.get(each), 0, 0, 0.0) for each in excitation.DESIGNED]
        took, seconds = time.process_time() - begin, sum(m.t[-1] for m in motion)
        carried = f"added mass {along:.2f} kg along, {across:.2f} kg across"
        glide = f"glides from 0.3 to 0.15 m/s in {coast_of(fish):.1f} s"
        console.say(f"{name}: {carried}; {glide}; {len(motion)} records of {seconds:.0f} s in {took:.1f} s of one core")


def main(argv: list[str]) -> int:
    """Prints all figures. Returns the exit code."""
    parser = console.parser("steady_gaits", __doc__ or "", json=False)
    parser.add_argument("--model", type=console.text, default="fish", help="robot of the generators: name or TOML file")
    model = parser.parse_args(argv).model
    second_robot()
    robots_of_generators(model)
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
