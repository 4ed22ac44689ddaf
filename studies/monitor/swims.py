"""Swims of the second robot from target to target under a policy: healthy, or with an effect that comes in mid-swim.

Every target is held for a minute; targets and first pose are drawn. The tables are those of a host's log.
"""

import heapq
from collections.abc import Callable, Mapping

import numpy as np

from fishmj.control.learned import LearnedController
from fishmj.gap.laboratory.virtual_robot import ClosedLoopRobot, plant
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.sensing import estimate

HOLD = 60.0  # s, at each target
ARENA = 1.0  # m, half width in which targets lie
READINGS = 5  # encoder readings in the slope that gives joint rates
Effects = Mapping[str, Mapping[str, float]]
Tables = dict[str, dict[str, np.ndarray]]
HEALTHY: Effects = {}


class ChangingRobot(ClosedLoopRobot):
    """Second robot whose constants may change during a swim. robot_seed: its constants; seed: its noise."""

    def __init__(self, robot_seed: int, seed: int, start: tuple[float, float, float], flow: tuple[float, float]):
        super().__init__({}, seed=seed, start=start, flow=flow)
        self.robot_seed, self.stream = robot_seed, flow
        self.change(HEALTHY)

    def change(self, effects: Effects) -> None:
        """Gives the robot these effects from now on."""
        self.plant = plant(effects, self.robot_seed, flow=self.stream)
        self._radio.network, self._radio.odd = self.plant.network, self.plant.odd

    def send_all(self, times: np.ndarray, commands: np.ndarray) -> None:
        """Sends commands (K, J) that leave at `times` (K,): those of a control step are known at its start, saving 10 calls."""
        for t, command in zip(times, commands, strict=True):
            arrival = self._radio.arrival(float(t), command)
            if arrival is not None:
                heapq.heappush(self._queue, (arrival, next(self._order), command))


def swim(
    robot_seed: int, seed: int, seconds: float, effects: Effects = HEALTHY, at: float = 0.0, speed: float = 0.2,
    direction: float = np.pi, policy: str = "station", told: Callable[[float], None] = lambda t: None,
) -> Tables:  # fmt: skip
    """Tables cmd, joint, pose, power and truth (t, x, y, yaw, tx, ty) of one swim; `effects` from `at` s on.

    robot_seed: of the robot's unmeasured constants. seed: of noise, first pose and targets. speed, direction: of the stream.
    """
    robot = load_robot("fish")
    draw = np.random.default_rng([seed, 22])
    fish = ChangingRobot(robot_seed, seed, (*draw.uniform(-ARENA, ARENA, 2), draw.uniform(-np.pi, np.pi)), (speed, direction))
    controller = LearnedController(robot, policy)
    controller.reset(1)
    dt, step = robot.timing.bus_dt, robot.timing.control_dt
    rows: dict[str, list] = {name: [] for name in ("cmd", "joint", "pose", "power", "truth")}
    target, changed = draw.uniform(-ARENA, ARENA, 2), False
    chunk = np.zeros((round(step / dt), robot.n_joints))
    for k in range(round(seconds / step)):
        now = fish.time
        if not changed and effects and now >= at:
            fish.change(effects)
            changed = True
        if k and k % round(HOLD / step) == 0:
            target = draw.uniform(-ARENA, ARENA, 2)
        if len(rows["pose"]) >= robot.timing.velocity_window:
            chunk = controller(_observed(rows, target, robot.timing.velocity_window, dt))[0]
        times = now + dt * np.arange(len(chunk))
        fish.send_all(times, chunk)
        rows["cmd"] += np.column_stack([times, chunk]).tolist()
        rows["truth"].append((now, *fish.truth()[:3], *target))
        for name, table in fish.advance(step).items():
            rows[name] += np.stack([table[c] for c in table], 1).tolist()
        told(now)
    names = {"cmd": ["c1", "c2", "c3"], "joint": ["j1", "j2", "j3"], "pose": ["x", "y", "yaw"], "power": ["V", "I"]}
    names["truth"] = ["x", "y", "yaw", "tx", "ty"]
    return {name: dict(zip(["t", *columns], np.array(rows[name]).T, strict=True)) for name, columns in names.items()}


def _observed(rows: dict[str, list], target: np.ndarray, window: int, dt: float) -> np.ndarray:
    """Observations (1, 11) of the host."""
    poses = np.array(rows["pose"][-window:])[:, 1:]
    poses[:, 2] = np.unwrap(poses[:, 2])
    pose, velocity = estimate(np, poses, dt)
    recent = np.array(rows["joint"][-READINGS:])
    _, rate = estimate(np, recent[:, 1:], dt)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turned = lambda a: (c * a[0] + s * a[1], c * a[1] - s * a[0])
    return np.array([[*turned(target - pose[:2]), *turned(velocity), velocity[2], *recent[-1, 1:], *rate]])
