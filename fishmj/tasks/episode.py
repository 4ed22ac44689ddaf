"""Episodes in NumPy: the task functions put together once, for dm_control and for Gymnasium.

    rules = Rules("station_hold", Setting(turbulence="gust"))
    scenario = rules.scenario(rules.draws(rng, n=4))            # everything random about 4 episodes
    episodes = Episodes(rules, engine="batch", n=4)
    episodes.begin(scenario);  seen = episodes.look(noise);  outcome = episodes.step(action)

The functional JAX environment (`tasks.env`) is made from the same functions; a test holds all of them equal.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fishmj import engines, flow
from fishmj.engines import FishParams, FishState
from fishmj.errors import ConfigError, SimDiverged, UnknownName
from fishmj.flow import Current
from fishmj.mjcf.description import Robot, check_timing, load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.own_task import course_of
from fishmj.tasks.reference import EpisodeStart, StepTruth
from fishmj.tasks.sensing import Sensors, readings

WEIGHTS = ("wG", "wD", "wS")  # of the paper's reward
LARGEST = {
    "intensity": 1,
    "flow_speed": 5,
    "randomisation": 10,
    "noise": 100,
    "seconds": 1e6,
}  # beyond them it is a slip of the pen


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """What a user may change about a task; None keeps the robot's or the task's own value."""

    robot: Any = "fish"  # Robot, TOML path or shipped name
    control_dt: float | None = None  # s
    command_path: str | None = None  # linear, hold or move_time
    turbulence: str = "default"
    intensity: Any = (0.0, 0.10)  # TI, a number or the bounds of a draw for each episode
    flow_speed: Any = None  # m/s, a number or the bounds of a draw
    flow_direction: float | None = None  # rad, where the water moves to
    randomisation: float = 1.0  # 0 nominal fish, 1 the paper's ranges
    noise: float = 1.0  # of the sensors, 1 the paper's
    seconds: float | None = None  # length of an episode
    box: str = "train"  # which turbulence table: train, tune or judge
    effects: tuple[str, ...] = ()  # of the catalogue, drawn in typical sizes for each episode
    wG: float | None = None  # noqa: N815  (the paper's symbols)
    wD: float | None = None  # noqa: N815
    wS: float | None = None  # noqa: N815

    def __post_init__(self):
        if self.turbulence not in flow.PRESETS:
            raise UnknownName("turbulence", self.turbulence, flow.PRESETS)
        if self.box not in flow.BOXES:
            raise UnknownName("box", self.box, flow.BOXES)
        for name, high in LARGEST.items():
            value = getattr(self, name)
            bounds = np.atleast_1d(np.asarray(0.0 if value is None else value, float))
            if len(bounds) > 2 or not (np.isfinite(bounds).all() and bounds.min() >= 0 and bounds.max() <= high):
                raise ConfigError(f"task: {name} = {value!r}; expected a number, or two bounds, from 0 to {high}")

    def fish(self) -> Robot:
        """The robot with this setting's timing."""
        robot = load_robot(self.robot)
        wanted = {k: v for k in ("control_dt", "command_path") if (v := getattr(self, k)) is not None}
        timing = replace(robot.timing, **wanted)
        check_timing(timing, "task")
        return engines.with_effects(replace(robot, timing=timing), self.effects)


class Draws(NamedTuple):
    """Uniform numbers in [0, 1) behind B episodes."""

    start: np.ndarray  # (B, 7)
    flow: np.ndarray  # (B, 5)
    fish: np.ndarray  # (B, n_fish)


class EpisodeDraw(NamedTuple):
    """Everything about B episodes that is settled before the first step."""

    launch: EpisodeStart
    current: Current
    params: FishParams
    camera: np.ndarray  # (B,) int, camera latency in bus ticks


class TaskSpec:
    """One task with its setting. name: of COURSES, or of one's own (tasks.own). Raises UnknownName, ConfigError, OwnCodeError."""

    def __init__(self, name: Any, setting: TaskOptions, **course):
        self.course = course_of(name, **course)
        self.name = getattr(self.course, "name", name)
        self.setting, self.robot = setting, setting.fish()
        self.outside = getattr(self.course, "outside", task.outside)
        if getattr(self.course, "reward", None) is not None and (
            given := [w for w in WEIGHTS if getattr(setting, w) is not None]
        ):
            raise ConfigError(f"task {self.name}: has a reward of its own, without {', '.join(given)}; leave the weights out")
        self.steps, self.ticks = engines.ticks_per(self.robot)
        self.dt = self.robot.timing.control_dt
        self.limit = task.control_steps(self.course.seconds if setting.seconds is None else setting.seconds, self.robot)
        if self.limit < 1:
            raise ConfigError(f"task: seconds = {setting.seconds} is less than one control step of {self.dt} s")
        self.table, self.cell = flow.table_of(setting.turbulence, flow.BOXES[setting.box])
        self.history, self.sensors = task.history_length(self.robot), Sensors(self.robot)
        self.n_obs, self.n_act = 5 + 2 * self.robot.n_joints, self.robot.n_joints

    def draws(self, rng, n: int) -> Draws:
        """Draws for n episodes from a NumPy Generator or RandomState."""
        sizes = (task.N_START, task.N_FLOW + 1, task.n_fish(self.robot, self.setting.effects))
        return Draws(*(rng.random((n, k)) for k in sizes))

    def scenario(self, draws: Draws, **fixed) -> EpisodeDraw:
        """What these draws mean; `fixed` replaces pose (B, 3), target (B, 2), speed (B,) or direction (B,) of the start."""
        s, launch = self.setting, self.course.launch(np, draws.start)
        start, u = launch.start, draws.flow
        if s.flow_speed is not None:
            low, high = np.broadcast_to(np.asarray(s.flow_speed, float), 2)
            start = start._replace(speed=low + (high - low) * draws.start[:, 5])
        direction = fixed.pop("direction", s.flow_direction)
        if direction is not None:
            if self.name == "angle_of_attack":  # the heading is given against the flow: it turns along
                turned = (direction - start.direction)[:, None] * np.array([0.0, 0.0, 1.0])
                start = start._replace(pose=start.pose + turned)
            start = start._replace(direction=direction + 0.0 * start.direction)
        start = start._replace(**fixed)
        low, high = np.broadcast_to(np.asarray(s.intensity, float), 2)
        intensity = low + (high - low) * u[:, 4]
        current = flow.draw(np, s.turbulence, self.table, self.cell, start.speed, start.direction, intensity, u)
        params, camera = task.draw_fish(np, self.robot, draws.fish, s.randomisation, s.effects)
        return EpisodeDraw(launch._replace(start=start), current, params, camera)

    def target(self, scenario: EpisodeDraw, count) -> np.ndarray:
        """Targets (B, 2) m after `count` (B,) control steps."""
        return self.course.target(np, scenario.launch, np.asarray(count) * self.dt)

    def reward(self, step: StepTruth) -> np.ndarray:
        """Reward (B,) of a control step: the task's own, or the paper's."""
        if getattr(self.course, "reward", None) is not None:
            return self.course.reward(np, step)
        s = self.setting
        return task.reward(np, step.distance, step.trace.rate, s.wG, s.wD, s.wS)

    def noise(self, normals) -> np.ndarray:
        """Standard normals (B, n_obs) at the strength of this setting."""
        return self.setting.noise * normals


class StepResult(NamedTuple):
    """One control step of B episodes."""

    reward: np.ndarray  # (B,)
    terminated: np.ndarray  # (B,) bool, left the domain
    truncated: np.ndarray  # (B,) bool, time is up, or dropped because the physics diverged
    distance: np.ndarray  # (B,) m, at the end of the step
    power: np.ndarray  # (B,) servos, W, mean over the step
    diverged: np.ndarray  # (B,) bool


class Episodes:
    """n running episodes on a batched engine. Ends are reported, never acted on: call `begin` with the rows to restart."""

    def __init__(self, rules: TaskSpec, engine, n: int):
        self.rules, self.n = rules, n
        self.engine = engines.make(engine, rules.robot) if isinstance(engine, str) else engine
        self.begin(rules.scenario(rules.draws(np.random.default_rng(0), n)))

    def begin(self, scenario: EpisodeDraw, rows=slice(None)) -> None:
        """Start the episodes `rows` (index array; all by default) at rest over ground, as many as `scenario` has."""
        robot, first = self.rules.robot, scenario.launch.start
        n = len(first.pose)
        fish = engines.at_rest(robot, first.pose)
        fish = fish._replace(q=np.concatenate([first.pose, scenario.params.zero], -1))
        history = np.repeat(first.pose[:, None], self.rules.history, 1)
        recent = np.zeros((n, self.rules.sensors.behind + 1, 2 * robot.n_joints))
        fresh = (scenario, fish, history, recent[:, 0, : robot.n_joints], recent, np.zeros(n, np.int64))
        if isinstance(rows, slice):
            running = fresh
        else:
            old = (self.scenario, self.fish, self.history, self.command, self.recent, self.count)
            running = _merged(old, fresh, np.asarray(rows))
        self.scenario, self.fish, self.history, self.command, self.recent, self.count = running

    def step(self, action) -> StepResult:
        """One control step with action (n, J) in [-1, 1].

        Raises:
            ConfigError: the action has the wrong shape or is not finite.
        """
        rules, action = self.rules, np.asarray(action, float)
        if action.shape != (self.n, rules.n_act) or not np.isfinite(action).all():
            raise ConfigError(f"{rules.name}: action of shape {action.shape}; expected finite ({self.n}, {rules.n_act})")
        commands = task.chunk(np, rules.robot, self.command, action)
        fish, trace, diverged = self._advance(commands)
        self.fish, self.command, self.count = fish, commands[:, -1], self.count + 1
        self.history = np.concatenate([self.history, trace.pose], 1)[:, -rules.history :]
        late = rules.sensors.behind
        self.recent = np.concatenate([self.recent, readings(np, trace.joint, trace.rate)], 1)[:, -late - 1 :]
        distance = np.linalg.norm(trace.pose[:, -1, :2] - self.target, axis=-1)
        terminated = rules.outside(np, trace.pose[:, -1]) & ~diverged
        stride = StepTruth(trace, self.target, distance, action, self.count * rules.dt)
        return StepResult(
            reward=np.where(diverged, 0.0, rules.reward(stride)),
            terminated=terminated,
            truncated=((self.count >= rules.limit) & ~terminated) | diverged,
            distance=distance,
            power=trace.power.mean(-1),
            diverged=diverged,
        )

    def look(self, normals) -> np.ndarray:
        """Observations (n, n_obs) now; normals: (n, n_obs) standard normal draws of the sensors' noise."""
        rules, now = self.rules, self.scenario
        seen = (self.history, now.camera, self.recent, self.target, rules.noise(normals))
        return task.observe_with_sensors(np, rules.robot, rules.sensors, now.params, *seen)

    @property
    def target(self) -> np.ndarray:
        """Targets (n, 2) m, now."""
        return self.rules.target(self.scenario, self.count)

    def _advance(self, commands) -> tuple[FishState, engines.Trace, np.ndarray]:
        """The engine's step; fish that diverge are frozen at rest where they were, and flagged."""
        tick = self.count * self.rules.ticks
        go = lambda fish: self.engine.advance(fish, commands, self.scenario.params, self.scenario.current, tick)
        numpy = lambda out: type(out)(*(np.asarray(a, float) for a in out))
        diverged = np.zeros(self.n, bool)
        try:
            fish, trace = go(self.fish)
        except SimDiverged as error:
            if error.states is None:
                raise
            diverged[np.asarray(error.states)] = True
            fish, trace = go(_at_rest(self.fish, diverged))
        fish, trace = numpy(fish), numpy(trace)
        lost = ~(np.isfinite(fish.q).all(-1) & np.isfinite(fish.v).all(-1))
        if lost.any():
            fish = FishState(*(_pick(lost, b, a) for a, b in zip(fish, _at_rest(self.fish, lost), strict=True)))
            still = {name: _pick(lost, 0.0, value) for name, value in trace._asdict().items() if name != "pose"}
            trace = engines.Trace(pose=_pick(lost, self.history[:, -1:], trace.pose), **still)
        return fish, trace, diverged | lost


def _at_rest(fish: FishState, rows) -> FishState:
    """The same fish with `rows` (bool) stopped, straight, and all their commands at zero."""
    straight = np.concatenate([fish.q[:, :3], np.zeros_like(fish.q[:, 3:])], -1)
    calm = FishState(straight, 0.0, 0.5, 0.0, 0.0)
    return FishState(*(_pick(rows, new, old) for new, old in zip(calm, fish, strict=True)))


def _pick(rows, new, old):
    return np.where(np.reshape(rows, (len(rows),) + (1,) * (np.ndim(old) - 1)), new, old)


def _merged(old, new, rows):
    """Trees of arrays (n, ...) with `rows` replaced; what the batch shares (flow table, cell) stays."""
    if isinstance(old, Current):
        parts = [_merged(a, b, rows) for a, b in zip(old[:5], new[:5], strict=True)]
        return Current(*parts, *old[5:])
    if isinstance(old, tuple):
        parts = [_merged(a, b, rows) for a, b in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    out = np.array(old)
    out[rows] = new
    return out
