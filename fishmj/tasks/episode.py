"""Episodes in NumPy, made of the task functions, for dm_control and Gymnasium.

    rules = TaskSpec("station_hold", TaskOptions(turbulence="gust"))
    scenario = rules.scenario(rules.draws(rng, n=4))            # random draws of 4 episodes
    episodes = Episodes(rules, engine="batch", n=4)
    episodes.begin(scenario);  obs = episodes.observation(normals);  result = episodes.step(action)

`ControlLoop` is the sense-and-act loop of all callers that use an engine:

    loop = ControlLoop(robot, "batch")
    loop.start(pose, scenario)
    obs = loop.observe(target, noise)          with latency and noise, as from camera and encoders
    trace = loop.act(commands)                 one control step of bus commands (B, T, J) rad

dm_control's physics and the flow solver, which advance the fish themselves, use only `SensorWindow`.
The functional JAX environment (`tasks.env`) is made from the same functions; a test holds all of them equal.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from fishmj import engines
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.options import checked, checked_array, checked_bounds, checked_name, checked_names, shown_value
from fishmj.engines import FishParams, FishState, Steps, Trace
from fishmj.mjcf.description import COMMAND_PATHS, Robot
from fishmj.mjcf.reading import load_robot, with_timing
from fishmj.tasks import station_hold as task
from fishmj.tasks.reference import COURSES, EpisodeStart, StepTruth, begun_at_target, course_of, episode_lengths, options_of
from fishmj.tasks.sensing import Sensors, readings
from fishmj.water import flow
from fishmj.water.choice import LBM, SELF_MADE, in_water, label
from fishmj.water.flow import Current

# larger values are probably typing errors; with randomisation above 1 a latency could be negative
LARGEST = {"intensity": 1, "flow_speed": 5, "randomisation": 1, "noise": 100, "seconds": 1e6}


class SensorWindow(NamedTuple):
    """Last bus ticks of B fish, newest last, as long as latency, velocity filter and delayed encoders need."""

    pose: np.ndarray  # (B, H, 3) m, rad
    joint: np.ndarray  # (B, K + 1, 2 J) angles and rates, rad, rad/s

    @classmethod
    def at_rest(cls, robot: Robot, sensors: Sensors, pose) -> "SensorWindow":
        """Window of straight fish that have rested at poses (B, 3)."""
        poses = np.repeat(pose[:, None], task.history_length(robot), 1)
        return cls(poses, np.zeros((len(pose), sensors.behind + 1, 2 * robot.n_joints)))

    def after(self, pose, joint, rate) -> "SensorWindow":
        """Window T bus ticks later: pose (B, T, 3), joint and rate (B, T, J)."""
        return SensorWindow(slide(np, self.pose, pose), slide(np, self.joint, readings(np, joint, rate)))


def slide(xp, window, rows):
    """Appends rows (B, T, C) to a window (B, W, C) and drops its oldest."""
    return xp.concatenate([window, rows], 1)[:, -window.shape[1] :]


class Scenario(NamedTuple):
    """Constants and flow of B fish, drawn before the first step."""

    params: FishParams
    camera: np.ndarray  # (B,) int, camera latency in bus ticks
    current: Current


class ControlLoop:
    """Sense-and-act loop of B fish on an engine, given as an object or by name; None: `engines.fastest`.

    Attributes:
        scenario: as given to `start`. fish: state of the fish. window: memory of the sensors. count: (B,) control steps so far.
    """

    scenario: Any
    fish: FishState

    def __init__(self, robot: Robot, engine):
        self.robot = robot
        self.sensors = Sensors(robot)
        self.engine = engines.of(engine, robot)
        theirs, ours = label(getattr(self.engine, "robot", robot)), label(robot)
        if theirs != ours:
            raise ConfigError(
                f"the engine's fish swims in water {theirs!r}, the task's in {ours!r}; make the engine from the task's robot"
            )
        self.ticks = engines.ticks_per(robot)[1]

    def start(self, pose, scenario) -> None:
        """Starts at rest over ground at poses (B, 3) [m, rad], encoders at zero; scenario: has the fields of `Scenario`."""
        self.scenario = scenario
        self.fish = engines.at_rest(self.robot, pose)
        self.fish.q[:, 3:] = scenario.params.zero
        self.window = SensorWindow.at_rest(self.robot, self.sensors, pose)
        self.count = np.zeros(len(pose), np.int64)

    def observe(self, target, noise) -> np.ndarray:
        """Observations (B, 5 + 2 J) of targets (B, 2) m; noise: standard normal draws times the noise strength, same shape."""
        now = self.scenario
        senses = (self.window.pose, now.camera, self.window.joint)
        return task.observe_with_sensors(np, self.robot, self.sensors, now.params, *senses, target, noise)

    def inform(self, controller) -> None:
        """Passes the true flow (B, 2) m/s at each reference point, in body axes, to a controller with `set_flow`."""
        if (told := getattr(controller, "set_flow", None)) is None:
            return
        q = self.fish.q
        (u, v), c, s = self._flow_at(q[:, :2]).T, np.cos(q[:, 2]), np.sin(q[:, 2])
        told(np.stack([c * u + s * v, c * v - s * u], -1))

    def _flow_at(self, place) -> np.ndarray:
        return flow.sample(np, self.scenario.current, place[:, None], self.count * self.ticks)[0][:, 0]

    def act(self, commands) -> Trace:
        """Swims one control step of bus commands (B, T, J) rad. Raises SimDiverged."""
        self.fish, trace = self.advance(self.fish, commands)
        return self._seen(trace)

    def acting(self, commands) -> Steps[Trace]:
        """Does `act` as a generator, which yields while the engine waits for a device, so that other loops can continue."""
        advancing = getattr(self.engine, "advancing", None)
        if advancing is None:
            return self.act(commands)
        now = self.scenario
        self.fish, trace = yield from advancing(self.fish, commands, now.params, now.current, self.count * self.ticks)
        return self._seen(Trace(*(np.asarray(a, float) for a in trace)))

    def _seen(self, trace: Trace) -> Trace:
        """Adds a control step to the sensors' memory."""
        self.window = self.window.after(trace.pose, trace.joint, trace.rate)
        self.count = self.count + 1
        return trace

    def advance(self, fish: FishState, commands) -> tuple[FishState, Trace]:
        """Does the engine's step from `fish`, without changing this object; returns state and trace as float64 NumPy."""
        now = self.scenario
        fish, trace = self.engine.advance(fish, commands, now.params, now.current, self.count * self.ticks)
        return fish, Trace(*(np.asarray(a, float) for a in trace))


@dataclass(frozen=True, kw_only=True)
class DrawOptions:
    """Ranges of the random draws of episodes; base of `TaskOptions` and of `tasks.env.Options`."""

    turbulence: str = "default"
    intensity: Any = (0.0, 0.10)  # TI, a number, or bounds of a draw for each episode
    randomisation: float = 1.0  # 0: nominal fish, 1: the paper's ranges
    noise: float = 1.0  # factor on the sensor noise, 1: the paper's
    flow_speed: Any = None  # m/s, a number, or bounds of a draw for each episode; None: the task's own
    flow_exponent: float = 1.0  # e of speed = low + (high - low) u^e, u uniform: 2 draws slow streams more often
    seconds: float | None = None  # length of an episode; None: the task's own
    box: str = "train"  # which turbulence table: train, tune or judge
    effects: tuple[str, ...] = ()  # drawn in typical sizes times `randomisation` for each episode
    at_target: float = 0.0  # share of episodes that start at the target and last 8 s, half of them headed downstream

    def __new__(cls, *given, **options):
        """Raises ConfigError or UnknownName for wrong arguments, instead of Python's TypeError."""
        if given:
            raise ConfigError(f"task: {cls.__name__} got {shown_value(given[0])} without its name; write {cls.__name__}(NAME=..)")
        for name in options:
            checked_name(f"option of {cls.__name__}", name, [one.name for one in fields(cls)])
        return super().__new__(cls)

    def __post_init__(self):
        checked_name("turbulence", self.turbulence, flow.PRESETS)
        checked_name("box", self.box, flow.BOXES)
        self.intensity_bounds, self.flow_bounds  # noqa: B018  (checks them)
        if self.turbulence == "none" and self.intensity_bounds[0] > 0:
            raise ConfigError(
                f"task: intensity = {self.intensity} with turbulence none, which has no eddies; leave one of them out"
            )
        if self.seconds is not None:
            checked("task: seconds", self.seconds, 0, LARGEST["seconds"])
        for name in ("randomisation", "noise"):
            checked(f"task: {name}", getattr(self, name), 0, LARGEST[name])
        checked_names("task: effects", self.effects)
        checked("task: at_target", self.at_target, 0, 1)
        checked("task: flow_exponent", self.flow_exponent, 0.1, 10)
        if self.flow_exponent != 1 and self.flow_bounds is not None and self.flow_bounds[0] == self.flow_bounds[1]:
            one = f"flow_speed = {self.flow_bounds[0]}, a constant"
            raise ConfigError(f"task: flow_exponent = {self.flow_exponent} with {one}; leave it out, or give (low, high)")

    def begins(self, course: str) -> None:
        """Raises ConfigError for `at_target` with a course other than station_hold."""
        if self.at_target and course != "station_hold":
            raise ConfigError(f"task: at_target = {self.at_target} of the task {course}; expected station_hold, or 0")

    @property
    def intensity_bounds(self) -> tuple[float, float]:
        """Bounds of the draw of the turbulence intensity."""
        return checked_bounds("task: intensity", self.intensity, 0, LARGEST["intensity"])

    @property
    def flow_bounds(self) -> tuple[float, float] | None:
        """Bounds of the draw of the stream's speed, m/s; None: the task's own."""
        return None if self.flow_speed is None else checked_bounds("task: flow_speed", self.flow_speed, 0, LARGEST["flow_speed"])


@dataclass(frozen=True, kw_only=True)
class TaskOptions(DrawOptions):
    """Options of a task; None keeps the robot's or the task's own value."""

    robot: Any = "fish"  # Robot, TOML path or shipped name
    water: Any = None  # of fishmj.water.choice; None: fitted where the robot has one
    control_dt: float | None = None  # s
    command_path: str | None = None  # linear, hold or move_time
    flow_direction: float | None = None  # rad, where the water moves to
    wG: float | None = None  # noqa: N815  (the paper's symbols)
    wD: float | None = None  # noqa: N815
    wS: float | None = None  # noqa: N815

    def __post_init__(self):
        super().__post_init__()
        if self.command_path is not None:
            checked_name("command path", self.command_path, COMMAND_PATHS)
        bounds = {"control_dt": (0, LARGEST["seconds"]), "flow_direction": flow.TURN}
        for name in (*bounds, *task.WEIGHTS):
            if getattr(self, name) is not None:
                checked(f"task: {name}", getattr(self, name), *bounds.get(name, (0,)))

    def fish(self) -> Robot:
        """The robot with this setting's timing."""
        can = (*SELF_MADE, LBM) if self.water is None else SELF_MADE  # lbm: already chosen by a caller that has the tanks
        robot = in_water(load_robot(self.robot), self.water, can=can, who="this environment")
        return engines.with_effects(with_timing(robot, self.control_dt, self.command_path, "task"), self.effects)


def options_for(task: Any, given: dict, also: Iterable[str] = ()) -> tuple[TaskOptions, dict]:
    """Splits keyword arguments into `TaskOptions` and the options of the task's course.

    Args:
        task: as `course_of` takes it. also: options of other objects, for the message.

    Raises ConfigError, UnknownName: an option that does not exist or is invalid.
    """
    general = {f.name for f in fields(TaskOptions)}
    special = options_of(task) - general
    unknown = sorted(set(given) - general - special)
    if unknown:
        raise ConfigError(f"task: unknown option {unknown[0]!r}; known: {', '.join(sorted({*general, *special, *also}))}")
    own = {name: value for name, value in given.items() if name in special and (value is not None or task not in COURSES)}
    return TaskOptions(**{name: value for name, value in given.items() if name in general}), own


class Draws(NamedTuple):
    """Uniform draws in [0, 1) that determine B episodes."""

    start: np.ndarray  # (B, 7)
    flow: np.ndarray  # (B, 5)
    fish: np.ndarray  # (B, n_fish)


class EpisodeDraw(NamedTuple):
    """Draws of B episodes that are fixed before the first step."""

    launch: EpisodeStart
    current: Current
    params: FishParams
    camera: np.ndarray  # (B,) int, camera latency in bus ticks


class TaskSpec:
    """Task with its options. name: in COURSES, or the user's own. Raises UnknownName, ConfigError, OwnCodeError."""

    def __init__(self, name: Any, setting: TaskOptions, **course):
        self.course = course_of(name, **course)
        self.name = getattr(self.course, "name", name)
        setting.begins(self.name)
        self.setting = setting
        self.robot = setting.fish()
        self.outside = getattr(self.course, "outside", task.outside)
        if getattr(self.course, "reward", None) is not None and (
            given := [w for w in task.WEIGHTS if getattr(setting, w) is not None]
        ):
            raise ConfigError(f"task {self.name}: has its own reward, without weights {', '.join(given)}; leave them out")
        self.steps, self.ticks = engines.ticks_per(self.robot)
        self.dt = self.robot.timing.control_dt
        task.warn_of_streams(self.robot, self.course, setting.flow_bounds, setting.randomisation)
        self.limit = task.episode_steps(setting.seconds, self.course, self.robot)
        self.table, self.cell = flow.table_of(setting.turbulence, flow.BOXES[setting.box])
        self.sensors = Sensors(self.robot)
        self.n_obs, self.n_act = 5 + 2 * self.robot.n_joints, self.robot.n_joints
        self._sizes = (task.N_START, task.N_FLOW + 1, task.n_fish(self.robot, setting.effects))

    def draws(self, rng, n: int) -> Draws:
        """Draws for n episodes from a NumPy Generator or RandomState."""
        return Draws(*(rng.random((n, k)) for k in self._sizes))

    def scenario(self, draws: Draws, **fixed) -> EpisodeDraw:
        """Episodes from draws; fixed: given pose (B, 3), target (B, 2), speed (B,) or direction (B,) of the start."""
        s = self.setting
        draws = draws._replace(start=task.skewed(np, draws.start, s.flow_exponent))
        launch = self.course.launch(np, draws.start)
        start = launch.start
        u = draws.flow
        if s.flow_bounds is not None:
            low, high = s.flow_bounds
            start = start._replace(speed=low + (high - low) * draws.start[:, 5])
        direction = fixed.pop("direction", s.flow_direction)
        if direction is not None:
            if getattr(self.course, "heads_by_flow", False):  # the heading is relative to the flow, and turns with it
                turned = (direction - start.direction)[:, None] * np.array([0.0, 0.0, 1.0])
                start = start._replace(pose=start.pose + turned)
            start = start._replace(direction=direction + 0.0 * start.direction)
        launch = launch._replace(start=start)
        if s.at_target and not fixed.keys() & {"pose", "target"}:
            launch = begun_at_target(np, launch, draws.start, s.at_target, self.limit * self.dt)
        start = launch.start._replace(**fixed)
        low, high = s.intensity_bounds
        intensity = low + (high - low) * u[:, 4]
        current = flow.draw(np, s.turbulence, self.table, self.cell, start.speed, start.direction, intensity, u)
        params, camera = task.draw_fish(np, self.robot, draws.fish, s.randomisation, s.effects, start.speed)
        return EpisodeDraw(launch._replace(start=start), current, params, camera)

    def target(self, scenario: EpisodeDraw, count) -> np.ndarray:
        """Targets (B, 2) m after `count` (B,) control steps."""
        return self.course.target(np, scenario.launch, np.asarray(count) * self.dt)

    def lengths(self, scenario: EpisodeDraw) -> np.ndarray:
        """Returns the lengths (B,) of the episodes in control steps."""
        return episode_lengths(np, scenario.launch, self.limit, self.dt)

    def reward(self, step: StepTruth) -> np.ndarray:
        """Reward (B,) of a control step: the task's own, or the paper's."""
        if getattr(self.course, "reward", None) is not None:
            return self.course.reward(np, step)
        s = self.setting
        return task.reward(np, step.distance, step.trace.rate, s.wG, s.wD, s.wS)


class StepResult(NamedTuple):
    """Result of one control step of B episodes."""

    reward: np.ndarray  # (B,)
    terminated: np.ndarray  # (B,) bool, left the domain
    truncated: np.ndarray  # (B,) bool, time is up, or dropped because the physics diverged
    distance: np.ndarray  # (B,) m, at the end of the step
    power: np.ndarray  # (B,) servos, W, mean over the step
    diverged: np.ndarray  # (B,) bool


class Episodes(ControlLoop):
    """n running episodes on a batched engine, without automatic reset: call `begin` with the rows to restart.

    Attributes:
        diverged: (n,) bool, the physics of these fish failed in the last step. command: (n, J) last bus command, rad.
    """

    def __init__(self, rules: TaskSpec, engine, n: int):
        super().__init__(rules.robot, engine)
        self.rules, self.n = rules, n
        self.diverged = np.zeros(n, bool)
        self.begin(rules.scenario(rules.draws(np.random.default_rng(0), n)))

    def begin(self, scenario: EpisodeDraw, rows=slice(None)) -> None:
        """Starts the episodes `rows` (index array; all by default) at rest over ground, as many as `scenario` has."""
        before = None if isinstance(rows, slice) else self._running()
        self.start(scenario.launch.start.pose, scenario)
        self.command = np.zeros((len(self.count), self.rules.n_act))
        if before is not None:
            merged = _merged(before, self._running(), np.asarray(rows))
            self.scenario, self.fish, self.window, self.command, self.count = merged

    def step(self, action, alone: bool = False) -> StepResult:
        """Does one control step with actions (n, J), clipped to [-1, 1]; alone: action (J,) of a single fish.

        Raises ConfigError for another shape or non-finite actions.
        """
        rules = self.rules
        shape = (rules.n_act,) if alone else (self.n, rules.n_act)
        action = np.clip(checked_array(f"{rules.name}: action", action, shape), -1.0, 1.0).reshape(self.n, -1)
        commands = task.chunk(np, rules.robot, self.command, action)
        trace = self.act(commands)
        self.command = commands[:, -1]
        distance = np.linalg.norm(trace.pose[:, -1, :2] - self.target, axis=-1)
        terminated = rules.outside(np, trace.pose[:, -1]) & ~self.diverged
        truth = StepTruth(trace, self.target, distance, action, self.count * rules.dt)
        return StepResult(
            reward=np.where(self.diverged, 0.0, rules.reward(truth)),
            terminated=terminated,
            truncated=((self.count >= rules.lengths(self.scenario)) & ~terminated) | self.diverged,
            distance=distance,
            power=trace.power.mean(-1),
            diverged=self.diverged,
        )

    def observation(self, normals) -> np.ndarray:
        """Observations (n, n_obs) now; normals: (n, n_obs) standard normal draws of the sensors' noise."""
        return self.observe(self.target, self.rules.setting.noise * normals)

    @property
    def target(self) -> np.ndarray:
        """Present targets (n, 2) m."""
        return self.rules.target(self.scenario, self.count)

    def advance(self, fish: FishState, commands) -> tuple[FishState, engines.Trace]:
        """Does the engine's step; fish that diverge are frozen at rest at their last pose, and flagged."""
        diverged = np.zeros(self.n, bool)
        try:
            after, trace = super().advance(fish, commands)
        except SimDiverged as error:
            if error.states is None:
                raise
            diverged[np.asarray(error.states)] = True
            after, trace = super().advance(_at_rest(fish, diverged), commands)
        after = FishState(*(np.asarray(a, float) for a in after))
        nonfinite = ~(np.isfinite(after.q).all(-1) & np.isfinite(after.v).all(-1))
        if nonfinite.any():
            after = FishState(*(_pick(nonfinite, b, a) for a, b in zip(after, _at_rest(fish, nonfinite), strict=True)))
            still = {name: _pick(nonfinite, 0.0, value) for name, value in trace._asdict().items() if name != "pose"}
            trace = engines.Trace(pose=_pick(nonfinite, self.window.pose[:, -1:], trace.pose), **still)
        self.diverged = diverged | nonfinite
        return after, trace

    def _running(self) -> tuple:
        return self.scenario, self.fish, self.window, self.command, self.count


def _at_rest(fish: FishState, rows) -> FishState:
    """Fish with `rows` (bool) stopped and straightened, and their commands set to zero."""
    straight = np.concatenate([fish.q[:, :3], np.zeros_like(fish.q[:, 3:])], -1)
    calm = FishState(straight, 0.0, 0.5, 0.0, 0.0)
    return FishState(*(_pick(rows, new, old) for new, old in zip(calm, fish, strict=True)))


def _pick(rows, new, old):
    return np.where(np.reshape(rows, (len(rows),) + (1,) * (np.ndim(old) - 1)), new, old)


def _merged(old, new, rows):
    """Replaces `rows` in trees of arrays (n, ...); arrays shared by the batch (flow table, cell) stay."""
    if isinstance(old, Current):
        parts = [_merged(a, b, rows) for a, b in zip(old[:5], new[:5], strict=True)]
        return Current(*parts, *old[5:])
    if old is None:
        return None
    if isinstance(old, tuple):
        parts = [_merged(a, b, rows) for a, b in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    out = np.array(old)
    out[rows] = new
    return out
