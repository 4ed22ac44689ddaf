"""Session with an articulated robot: reference motions, host controller, command channel, encoders and logs.

    reference   sums of sines about each joint's middle; with a torque motor the host closes the loop on the encoders
    commands    delayed, held, lost or rounded; the last one holds until the next
    encoders    scale, zero, noise, counts, delay; one stamp for commands and readings, as a host writes its log
    servos      (BAM) use at most 85 % of their voltage or stall torque, within the described law
    disturbance random torques, redrawn every 60 ms, as large as data/calib/robot.toml allows for a healthy robot

`visibility` measures the hidden effects: healthy robots replay the logged commands, restarted every 0.3 s from the logged state.
The mean square of the difference is divided by noise and the scatter of healthy robots; the largest over the joints counts.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np

from fishmj.gap.laboratory.articulated.hidden_faults import Hidden, UsualMotion, placed, with_hidden
from fishmj.gap.laboratory.articulated.robot_plan import ANGLE, RobotPlan, carried_inertia, mjcf, tolerances, within_tolerance

SEGMENT = 0.3  # s
HEALTHY = 3  # robots for the scatter
SLOW = 0.02  # largest relative error of a log's clock
FAR = 25.0  # rad, largest angle of a valid log
TONES = (0.25, 1.6)  # Hz
SPENT = 0.85  # largest share of a servo's voltage or stall torque
LOOP = 9.0  # rad/s, of the host's position loop


class Stand(NamedTuple):
    """Host and sensors. tick: s. counts: of an encoder per turn. noise: rad."""

    tick: float
    counts: float
    noise: float
    seconds: float
    logs: int


class LogRun(NamedTuple):
    """One log: stamps (K,) s, commands (K, J), readings (K, J) rad; clean: readings without noise; true states."""

    t: np.ndarray
    commands: np.ndarray
    readings: np.ndarray
    clean: np.ndarray
    states: np.ndarray  # (K, 2, J) angle and rate behind the clean readings


Plant = Callable[[RobotPlan, Hidden], Any]


def draw_stand(rng: np.random.Generator, logs: int, seconds: float) -> Stand:
    """Draws a host at 100 to 250 Hz with encoders of 4096 to 65536 counts."""
    tick = float(rng.choice((0.004, 0.005, 0.01)))
    return Stand(tick, float(rng.choice((4096, 16384, 65536))), float(rng.uniform(5e-5, 3e-4)), seconds, logs)


class SwingReference:
    """Reference angles and rates of one log: sums of sines that start at rest in the middle. `at(t)` -> (J,), (J,), (J,)."""

    def __init__(self, plan: RobotPlan, rng: np.random.Generator, reach: float = 1.0):
        n = len(plan.limbs)
        swing = plan.column("swing")
        self.middle = swing[:, 0]
        self.pulse = 2.0 * np.pi * rng.uniform(*TONES, (n, 4))
        share = rng.dirichlet(np.ones(4), n)
        self.size = 1.5 * reach * swing[:, 1:] * share * np.minimum(1.0, 2.0 * np.pi * 0.9 / self.pulse)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (n, 4))

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles, rates and accelerations."""
        arc = self.pulse * t + self.phase
        wave, slope, bend = np.sin(arc), np.cos(arc) * self.pulse, -np.sin(arc) * self.pulse**2
        ramp = min(t / 0.5, 1.0)  # the start is at rest
        sums = [np.sum(self.size * part, 1) for part in (wave, slope, bend)]
        return self.middle + ramp * sums[0], ramp * sums[1] + (sums[0] / 0.5 if ramp < 1.0 else 0.0), ramp * sums[2]


def references(plan: RobotPlan, seed: int, logs: int) -> list[SwingReference]:
    """Reference of each log of a session."""
    reaches = np.linspace(0.6, 1.1, logs)
    return [SwingReference(plan, np.random.default_rng([seed, 31, i]), reach) for i, reach in enumerate(reaches)]


def usual_motion(plan: RobotPlan, seed: int, stand: Stand) -> UsualMotion:
    """90th percentiles of torques (inverse dynamics of the described robot), rates and commands of a session's references."""
    m = mujoco.MjModel.from_xml_string(mjcf(plan))
    d = mujoco.MjData(m)
    torque, rate, command = [], [], []
    for reference in references(plan, seed, stand.logs):
        for t in np.arange(0.5, stand.seconds, 0.02):
            d.qpos[:], d.qvel[:], d.qacc[:] = reference.at(t)
            mujoco.mj_inverse(m, d)
            torque.append(np.abs(d.qfrc_inverse))
            rate.append(np.abs(d.qvel))
            command.append(np.abs(d.qfrc_inverse if plan.torques else d.qpos - reference.middle))
    return UsualMotion(*(np.percentile(np.array(part), 90, axis=0) for part in (torque, rate, command)))


class Host:
    """Controller of a log: references to position servos; gravity compensation plus feedback to torque motors."""

    def __init__(self, plan: RobotPlan, reference: SwingReference, tick: float):
        self.plan, self.reference, self.tick = plan, reference, tick
        self.m = mujoco.MjModel.from_xml_string(mjcf(plan))
        self.d = mujoco.MjData(self.m)
        carried = carried_inertia(plan)
        self.stiff, self.damp = carried * LOOP**2, 1.4 * carried * LOOP
        self.last_reading: np.ndarray | None = None
        self.rate = np.zeros(len(plan.limbs))

    def command(self, t: float, read: np.ndarray) -> np.ndarray:
        """Command (J,) at a tick, from its reading."""
        angle, rate, _ = self.reference.at(t)
        if not self.plan.torques:
            return np.clip(angle, -ANGLE, ANGLE)
        if self.last_reading is not None:
            self.rate += 0.3 * ((read - self.last_reading) / self.tick - self.rate)
        self.last_reading = read
        self.d.qpos[:], self.d.qvel[:], self.d.qacc[:] = read, 0.0, 0.0
        mujoco.mj_inverse(self.m, self.d)  # gravity, at the reading
        torque = self.d.qfrc_inverse + self.stiff * (angle - read) + self.damp * (rate - self.rate)
        return np.clip(torque, -self.plan.column("limit"), self.plan.column("limit"))


class StandTiming(NamedTuple):
    """Changes of commands and readings by the hidden effects; s, 1, rad."""

    late: float
    seen_late: float
    period: float
    jitter: float
    loss: float
    rate: float
    step: np.ndarray
    zero: np.ndarray
    scale: np.ndarray


def timing_of(hidden: Hidden, joints: int) -> StandTiming:
    """Timing of a robot."""
    step, zero, scale = np.zeros(joints), np.zeros(joints), np.ones(joints)
    whole = {"command_latency": 0.0, "joint_sensor_delay": 0.0, "command_hold": 0.0, "latency_jitter": 0.0, "packet_loss": 0.0}
    rate = 1.0
    for name, values in hidden.items():
        effect, k = placed(name)
        if effect in whole:
            whole[effect] = next(iter(values.values()))
        elif effect == "clock_drift":
            rate = float(values["rate"])
        elif effect == "command_quantisation":
            step[k] = values["step"]
        elif effect == "joint_zero_offset":
            zero[k] = values["offset"]
        elif effect == "joint_scale":
            scale[k] = 1.0 + values["scale"]
    late, seen_late, period, jitter, loss = whole.values()
    return StandTiming(late, seen_late, period, jitter, loss, rate, step, zero, scale)


class Channel:
    """Command channel to the motors."""

    def __init__(self, timing: StandTiming, rng: np.random.Generator):
        self.timing, self.rng = timing, rng
        self.arrivals: list[float] = []
        self.commands: list[np.ndarray] = []

    def send(self, t: float, u: np.ndarray) -> None:
        """Sends a command (J,) from the host at time t."""
        late = self.timing.late + self.timing.jitter * abs(self.rng.standard_normal())
        lost = self.rng.random() < self.timing.loss and self.commands
        step = self.timing.step
        rounded = np.where(step > 0, step * np.round(u / np.where(step > 0, step, 1.0)), u)
        self.arrivals.append(np.inf if lost else t + late)
        self.commands.append(rounded)

    def delivered(self, t: float) -> np.ndarray:
        """Command (J,) that acts at t: the newest arrived one, or the first one if none has arrived."""
        if self.timing.period:
            t = self.timing.period * np.floor(t / self.timing.period + 1e-9)
        for arrival, u in zip(reversed(self.arrivals[-64:]), reversed(self.commands[-64:]), strict=True):
            if arrival <= t + 1e-9:
                return u
        return self.commands[0]


def run(
    plant: Any,
    plan: RobotPlan,
    described: RobotPlan,
    reference: SwingReference,
    stand: Stand,
    hidden: Hidden,
    push: np.ndarray,
    rng,
) -> LogRun:
    """Simulates one log. plan: true robot. described: nominal robot. push: random torques (n, J), one per spacing.

    Raises FloatingPointError: the state is not finite, the robot ran away, or a servo has no spare voltage.
    """
    joints, h = len(plan.limbs), plant.h
    timing, every = timing_of(hidden, joints), round(stand.tick / h)
    rows = round(stand.seconds / stand.tick)
    ticks = rows + int(SLOW * rows) + 2  # a slow clock's log ends later
    host, channel = Host(described, reference, stand.tick), Channel(timing, rng)
    plant.start(reference.at(0.0)[0], np.zeros(joints))
    states = np.zeros((ticks * every + 1, 2, joints))
    grid = h * np.arange(len(states))
    disturbance = pushes_at(push, grid)
    states[0] = plant.q, plant.v
    noise = stand.noise * rng.standard_normal((ticks, joints))
    shift = timing.zero if not plan.torques else 0.0  # a servo closes its loop on its encoder
    sent = []
    for k in range(ticks):
        t = k * stand.tick
        place = max(0, k * every - round(timing.seen_late / h))
        read = _counted(timing.scale * states[place, 0] - timing.zero + noise[k], stand)
        u = host.command(t, read)
        sent.append(u)
        channel.send(t, u)
        for s in range(every):
            n = k * every + s
            plant.step(channel.delivered(n * h) + shift, disturbance[n])
            states[n + 1] = plant.q, plant.v
        if not np.all(np.abs(plant.q) < FAR):
            raise FloatingPointError("the robot ran away")
    if plant.spent > SPENT:
        raise FloatingPointError(f"a servo asks for {plant.spent:.0%} of its voltage, or gives as much of its stall torque")
    stamps = stand.tick * np.arange(rows)
    when = np.maximum(stamps / timing.rate - timing.seen_late, 0.0)
    angles, rates = (np.stack([np.interp(when, grid, states[:, part, j]) for j in range(joints)], 1) for part in (0, 1))
    clean = timing.scale * angles - timing.zero
    logged = np.stack([clean, timing.scale * rates], 1)
    return LogRun(stamps, np.array(sent[:rows]), _counted(clean + noise[:rows], stand), clean, logged)


def _counted(angles: np.ndarray, stand: Stand) -> np.ndarray:
    """Angles rounded to encoder counts."""
    count = 2.0 * np.pi / stand.counts
    return count * np.round(angles / count)


def pushes(usual: UsualMotion, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Random torques (n, J) of a healthy robot, one per spacing."""
    sigma = tolerances()
    n = int(1.1 * seconds / sigma["spacing"]) + 2
    return sigma["torque"] * usual.torque * rng.standard_normal((n, len(usual.torque)))


def pushes_at(push: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Interpolates torques (n, J), one per spacing, at times (T,) s: (T, J)."""
    knots = tolerances()["spacing"] * np.arange(len(push))
    return np.stack([np.interp(times, knots, column) for column in push.T], 1)


def replay(plant: Any, log: Any, stand: Any, push: np.ndarray, split: Callable = tuple) -> np.ndarray:
    """Angles (K, J), or poses (K, 7), under the logged commands; each segment starts from the logged state.

    split: a row of `log.states` -> places and rates.
    """
    every, length = round(stand.tick / plant.h), round(SEGMENT / stand.tick)
    disturbance = pushes_at(push, plant.h * np.arange(len(log.t) * every))
    out = np.empty_like(log.clean)
    for k in range(len(log.t)):
        if k % length == 0:
            plant.start(*split(log.states[k]), log.t[k])
        out[k] = plant.q
        for n in range(k * every, (k + 1) * every):
            plant.step(log.commands[k], disturbance[n])
    return out


def session(build: Plant, described: RobotPlan, hidden: Hidden, stand: Stand, usual: UsualMotion, seed: int) -> list[LogRun]:
    """Logs of a robot drawn within the tolerances of `described`, with `hidden` in it. Raises FloatingPointError."""
    true = with_hidden(within_tolerance(described, np.random.default_rng([seed, 32])), hidden)
    plant = build(true, hidden)
    out = []
    for i, reference in enumerate(references(described, seed, stand.logs)):
        rng = np.random.default_rng([seed, 33, i])
        out.append(run(plant, true, described, reference, stand, hidden, pushes(usual, stand.seconds, rng), rng))
    return out


def visibility(
    build: Plant, described: RobotPlan, hidden: Hidden, stand: Stand, usual: UsualMotion, seed: int, logs: list[LogRun]
) -> float:
    """Mean square of the hidden effects over noise and the scatter of healthy robots; largest over the joints."""
    if not hidden:
        return 0.0
    noise = stand.noise**2 + (2.0 * np.pi / stand.counts) ** 2 / 12.0
    replayed = lambda plan, log, push: replay(build(plan, {}), log, stand, push)
    return over_scatter(replayed, np.subtract, noise, described, stand.seconds, usual, seed, logs)


def over_scatter(
    replayed: Callable[..., np.ndarray], apart: Callable[..., np.ndarray], noise, described: RobotPlan, seconds: float,
    usual: UsualMotion, seed: int, logs: list,
) -> float:  # fmt: skip
    """Mean square of the hidden effects over noise and the scatter of healthy robots; largest over the coordinates.

    replayed(plan, log, push) -> readings of a robot without effects. apart(one, other) -> (K, n) their difference. noise: (n,).
    """
    same = within_tolerance(described, np.random.default_rng([seed, 32]))
    squares, scatter, count = 0.0, 0.0, 0
    for i, log in enumerate(logs[:2]):
        healthy = replayed(same, log, pushes(usual, seconds, np.random.default_rng([seed, 33, i])))
        off = [np.zeros_like(apart(healthy, healthy))]
        for n in range(HEALTHY):
            rng = np.random.default_rng([seed, 34, n, i])
            off.append(apart(replayed(within_tolerance(described, rng), log, pushes(usual, seconds, rng)), healthy))
        squares = squares + np.sum(apart(log.clean, healthy) ** 2, 0)
        scatter = scatter + np.sum(np.var(np.stack(off), 0, ddof=1), 0)
        count += len(log.t)
    return float(np.max(squares / count / (scatter / count + noise)))
