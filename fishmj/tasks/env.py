"""Station holding as a functional, batched JAX environment for thousands of fish, with any jit-able engine.

    state = env.reset(key, n);  state = env.step(state, action)

`step` resets finished episodes by itself; `state.final_obs` is the observation before that reset, for bootstrapping.
The flow is hidden: it is in `state.privileged` (for a critic that trains in simulation only), never in `state.obs`.
"""

from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked, checked_kind, checked_name, checked_names, shown_value
from fishmj.engines import FishParams, FishState
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot, with_timing
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import DrawOptions, slide
from fishmj.tasks.reference import StepTruth, begun_at_target, course_of, episode_lengths
from fishmj.tasks.sensing import Sensors, readings
from fishmj.water import flow
from fishmj.water.choice import in_water
from fishmj.water.flow import Current

MEMORY = 1000  # largest number of observations in a policy's input
ARGUMENTS = ("robot", "engine", "options", "water", "control_dt", "command_path")  # of StationHold, besides reward weights


@dataclass(frozen=True, kw_only=True)
class Options(DrawOptions):
    """Options of the task in a training run."""

    memory: int = 1  # number of observations (with the actions between them) in the policy's input
    hide: tuple[str, ...] = ()  # observation groups set to zero (ablations), of station_hold.GROUPS
    course: str = "station_hold"  # name in tasks.reference, or reference of the user's own task that was loaded

    def __new__(cls, *given, **options):
        """Raises ConfigError if an option is an argument of `StationHold`, or as the base class does."""
        if elsewhere := [name for name in options if name in (*ARGUMENTS, *task.WEIGHTS)]:
            raise ConfigError(f"task: {elsewhere[0]} is an argument, not an option: StationHold(.., {elsewhere[0]}=..)")
        return super().__new__(cls, *given, **options)

    def __post_init__(self):
        super().__post_init__()
        checked("task: memory", self.memory, 1, MEMORY, whole=True)
        self.begins(self.course)
        for name in checked_names("task: hide", self.hide):
            checked_name("observation group", name, task.GROUPS)
        if set(self.hide) == set(task.GROUPS):
            raise ConfigError(f"task: hide = {', '.join(self.hide)}, all groups: the policy would see nothing; leave one out")


class EnvState(NamedTuple):
    """State of B running episodes."""

    fish: FishState
    params: FishParams
    current: Current
    target: Any  # (B, 2)
    history: Any  # (B, H, 3) poses at bus ticks
    joints: Any  # (B, K, 2 J) older encoder readings, angles and rates; K = 0 unless an effect delays them
    camera: Any  # (B,) int
    command: Any  # (B, J) last bus command, rad
    tick: Any  # (B,) int
    count: Any  # (B,) int, control steps of this episode, plus those by which it is shorter than others
    key: Any
    obs: Any  # (B, memory x n_obs + (memory - 1) x J)
    final_obs: Any
    privileged: Any  # (B, n_obs + 5): columns `station_hold.privileged_spans`
    final_privileged: Any
    reward: Any  # (B,)
    terminated: Any  # (B,) bool, left the domain
    truncated: Any  # (B,) bool, time is up
    distance: Any  # (B,) m, at the end of the step
    diverged: Any  # (B,) bool, episode dropped because of a non-finite state or action
    launch: Any = None  # starts of the episodes, for moving targets; None for fixed ones


def layout_of(state: EnvState, fish: Any, shared: Any) -> EnvState:
    """Tree like a state, with `fish` for arrays with one row per fish, and `shared` for the others."""
    made = jax.tree.map(lambda _: fish, state)
    return made._replace(key=shared, current=made.current._replace(table=shared, cell=shared))


class StationHold:
    """Batched environment. `reset` and `step` are pure functions for use with jit and scan.

    Args:
        robot: a description, a TOML path or a shipped name.
        engine: "compiled" (extra `fast`, CPU), "planar" (gradients, GPU), "mjx", or an engine of this same robot. None takes
            "compiled" on a CPU with numba, else "planar"; `fishmj.engines.name_of(env.engine)` is its name.
        water: name in `fishmj.water.choice`, for an engine given by name.
        control_dt, command_path: time between two decisions, s, and path of commands between them; by default the robot's.
        reward: weights of the paper's reward, wG, wD [1/m], wS [s2/rad2].

    Raises ConfigError, UnknownName: an invalid argument. MissingExtra: "compiled" without numba.
    """

    def __init__(
        self, robot: "Robot | str" = "fish", engine: Any = None, options: Options | None = None, *,
        water=None, control_dt: float | None = None, command_path: str | None = None, **reward,
    ):  # fmt: skip
        if isinstance(engine, Options):
            raise ConfigError("task: got options as the engine; write StationHold(robot, options=Options(..))")
        options = checked_kind("task: options", options, Options) or Options()
        for name, weight in reward.items():
            if name in {one.name for one in fields(Options)}:
                raise ConfigError(f"task: {name} is an option: StationHold(.., options=Options({name}=..))")
            checked(f"task: {checked_name('argument of StationHold', name, (*ARGUMENTS, *task.WEIGHTS))}", weight, 0)
        robot = with_timing(load_robot(robot), control_dt, command_path, "task")
        if engine is None:
            engine = engines.fastest() if jax.default_backend() == "cpu" else "planar"
        if isinstance(engine, str):
            robot = in_water(robot, water, who="the environment in JAX")
        elif water is not None:
            raise ConfigError(f"task: water = {water!r} with an engine object, which already has a water; leave it out")
        robot = engines.with_effects(robot, options.effects)
        self.engine = engines.of(engine, robot)
        if not getattr(self.engine, "jittable", False):
            raise ConfigError(
                f"task: the engine {engines.name_of(self.engine)} cannot run inside jax.jit; choose compiled, planar or mjx"
            )
        self.robot = getattr(self.engine, "robot", robot)  # in its water
        if self.robot.effects != robot.effects:
            raise ConfigError(
                f"task: the engine's robot lacks {', '.join(options.effects)}; make it from engines.with_effects(robot, ..)"
            )
        if self.robot.timing != robot.timing:
            raise ConfigError(
                "task: the engine's robot has another timing; give control_dt and command_path only with an engine's name"
            )
        robot = self.robot
        self.sensors = Sensors(robot)
        self.options = options
        self.weights = reward
        self.n_obs, self.n_act = 5 + 2 * robot.n_joints, robot.n_joints
        table, self.cell = flow.table_of(options.turbulence, flow.BOXES[options.box])
        self.table = jnp.asarray(table)
        self.length = task.history_length(robot)
        self.course = course_of(options.course)
        self.moves = options.course != "station_hold"
        self.outside, self.own_reward = (getattr(self.course, name, None) for name in ("outside", "reward"))
        if self.own_reward is not None and reward:
            raise ConfigError(f"task {options.course}: has its own reward, without weights {', '.join(reward)}; leave them out")
        task.warn_of_streams(robot, self.course, options.flow_bounds, options.randomisation)
        self.limit = task.episode_steps(options.seconds, self.course, robot)
        self.mask = jnp.asarray(task.visible(robot.n_joints, options.hide), jnp.float32)

    @property
    def n_input(self) -> int:
        """Width of the policy's input."""
        m = self.options.memory
        return m * self.n_obs + (m - 1) * self.n_act

    @property
    def n_privileged(self) -> int:
        """Width of a privileged critic's additional input."""
        return self.n_obs + 5

    @property
    def input_scale(self) -> np.ndarray:
        """Divisors (n_input,) of the policy's input in fishmj's own trainings; `Policy.of` expects them."""
        return task.input_scale(self.n_act, self.options.memory).astype(np.float32)

    @property
    def mirror_signs(self) -> np.ndarray:
        """Signs (n_input,) of the policy's input for the fish's mirror image; the mirror image of an action is its negative."""
        return task.mirror_signs(self.n_act, self.options.memory).astype(np.float32)

    @property
    def privileged_scale(self) -> np.ndarray:
        """Divisors (n_privileged,) of the privileged input."""
        return task.privileged_scale(self.n_act).astype(np.float32)

    def reset(self, key, n: int, stagger: bool = False) -> EnvState:
        """Starts n fresh episodes from a key of `jax.random`.

        Raises ConfigError if `key` is not a key, or n not a whole number >= 1.

        With `stagger` their clocks start at random times, so that the episodes do not end at the same time.
        """
        n = checked("reset: n", n, 1, whole=True)
        kind, shape = getattr(key, "dtype", float), getattr(key, "shape", None)
        if not (shape == () and jnp.issubdtype(kind, jax.dtypes.prng_key)) and not (shape == (2,) and kind == jnp.uint32):
            raise ConfigError(f"reset: key = {shown_value(key)}; expected jax.random.key(SEED)")
        return self._reset(key, n, bool(stagger))

    @partial(jax.jit, static_argnums=(0, 2, 3))
    def _reset(self, key, n: int, stagger: bool) -> EnvState:
        key, k_start, k_clock = jax.random.split(key, 3)
        state = self._fresh(k_start, n)
        if stagger:
            state = state._replace(count=jax.random.randint(k_clock, (n,), 0, self.limit))
        return state._replace(key=key)

    def step(self, state: EnvState, action) -> EnvState:
        """Does one control step with actions (B, J), clipped to [-1, 1].

        An episode whose action is not finite, or whose physics diverges, is marked `diverged`, and a new one begins.
        Raises ConfigError if `state` is not from `reset` or `step`, or `action` is not a numeric array of this shape.
        """
        n = len(checked_kind("task: state", state, EnvState, needed=True).count)
        kind = getattr(action, "dtype", None)
        real = kind is not None and any(jnp.issubdtype(kind, of) for of in (jnp.floating, jnp.integer, jnp.bool_))
        if not real or action.shape != (n, self.n_act):
            raise ConfigError(f"task: action {shown_value(action)}; expected an array ({n}, {self.n_act}), one row for each fish")
        return self._step(state, action)

    @partial(jax.jit, static_argnums=0)
    def _step(self, state: EnvState, action) -> EnvState:
        n = len(state.count)
        key, k_noise, k_fresh = jax.random.split(state.key, 3)
        sane = jnp.all(jnp.isfinite(action), -1)
        action = jnp.clip(jnp.where(sane[:, None], action, 0.0), -1.0, 1.0)
        commands = task.chunk(jnp, self.robot, state.command, action)
        fish, trace = self.engine.advance(state.fish, commands, state.params, state.current, state.tick)
        bad = ~(sane & jnp.all(jnp.isfinite(fish.q), -1) & jnp.all(jnp.isfinite(fish.v), -1))
        history = jnp.where(bad[:, None, None], 0.0, slide(jnp, state.history, trace.pose))
        tick = state.tick + commands.shape[1]
        target = self._target(state.launch, tick) if self.moves else state.target
        distance = jnp.linalg.norm(trace.pose[:, -1, :2] - target, axis=-1)
        gain = self._gain(trace, target, distance, action, tick)
        out = (self.outside or task.outside)(jnp, trace.pose[:, -1])
        if left := getattr(self.engine, "left", None):  # tanks of the flow solver are smaller than the task's domain
            out = out | left(fish)
        terminated = out & ~bad
        truncated = (state.count + 1 >= self.limit) & ~terminated & ~bad
        moved = state._replace(
            fish=fish, history=history, command=commands[:, -1], tick=tick, target=target, count=state.count + 1, key=key
        )
        recent = jnp.concatenate([state.joints, readings(jnp, trace.joint, trace.rate)], 1)[:, -self.sensors.behind - 1 :]
        moved = moved._replace(joints=jnp.where(bad[:, None, None], 0.0, recent[:, 1:]))
        obs_now = self._observe(moved, recent, k_noise)
        obs = self._stack_memory(state.obs, action, obs_now)
        fresh = self._fresh(k_fresh, n)
        moved = moved._replace(
            obs=obs, privileged=self._privileged(moved, obs_now), reward=gain, terminated=terminated, truncated=truncated,
            distance=distance, diverged=bad,
        )  # fmt: skip
        done = terminated | truncated | bad
        keep = ("current", "key", "reward", "terminated", "truncated", "distance", "diverged", "final_obs", "final_privileged")
        pick = lambda new, old: jnp.where(done.reshape((n,) + (1,) * (old.ndim - 1)), new, old)
        mixed = {f: jax.tree.map(pick, getattr(fresh, f), getattr(moved, f)) for f in EnvState._fields if f not in keep}
        own = Current._fields[:5]  # not the shared table
        each = {f: pick(getattr(fresh.current, f), getattr(moved.current, f)) for f in own}
        finite = lambda a: jnp.where(bad[:, None], 0.0, a)
        return moved._replace(
            **mixed, current=moved.current._replace(**each), final_obs=finite(obs), final_privileged=finite(moved.privileged),
            reward=jnp.where(bad, 0.0, gain), distance=jnp.where(bad, 0.0, distance),
        )  # fmt: skip

    def _target(self, launch, tick):
        """Targets (B, 2) m at bus ticks (B,) since the start of each episode, without the stagger."""
        return jnp.asarray(self.course.target(jnp, launch, tick * self.robot.timing.bus_dt), jnp.float32)

    def _gain(self, trace, target, distance, action, tick):
        """Reward (B,) of a control step."""
        if self.own_reward is None:
            return task.reward(jnp, distance, trace.rate, **self.weights)
        return self.own_reward(jnp, StepTruth(trace, target, distance, action, tick * self.robot.timing.bus_dt))

    def _fresh(self, key, n: int) -> EnvState:
        """n new episodes at rest over ground."""
        keys = jax.random.split(key, 4)
        draws = task.skewed(jnp, jax.random.uniform(keys[0], (n, task.N_START)), self.options.flow_exponent)
        launch = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), self.course.launch(jnp, draws))
        if self.options.flow_bounds is not None:
            slow, fast = self.options.flow_bounds
            launch = launch._replace(start=launch.start._replace(speed=slow + (fast - slow) * draws[:, 5]))
        if self.options.at_target:
            longest = self.limit * self.robot.timing.control_dt
            launch = begun_at_target(jnp, launch, draws, self.options.at_target, longest)
        start = launch.start
        u = jax.random.uniform(keys[1], (n, task.N_FLOW + 1))
        low, high = self.options.intensity_bounds
        intensity = low + (high - low) * u[:, 4]
        cell = jnp.float32(self.cell)
        current = flow.draw(jnp, self.options.turbulence, self.table, cell, start.speed, start.direction, intensity, u)
        draws = jax.random.uniform(keys[2], (n, task.n_fish(self.robot, self.options.effects)))
        params, camera = task.draw_fish(jnp, self.robot, draws, self.options.randomisation, self.options.effects, start.speed)
        params = jax.tree.map(lambda a: a if a.dtype == jnp.int32 else a.astype(jnp.float32), params)
        zero, joints = jnp.zeros((n,)), jnp.zeros((n, self.n_act))
        q = jnp.concatenate([start.pose, params.zero], -1)
        rest = jax.tree.map(jnp.float32, engines.at_rest(self.robot, np.zeros((1, 3))))
        spread = lambda a: jnp.tile(a, (n,) + (1,) * (a.ndim - 1))
        fish = FishState(q, jnp.zeros_like(q), zero + 0.5, spread(rest.buffer), spread(rest.memory))
        history = jnp.repeat(start.pose[:, None], self.length, 1)
        no = jnp.zeros((n,), bool)
        blank = jnp.zeros((n, self.n_input))
        target = self._target(launch, jnp.zeros((n,), jnp.int32)) if self.moves else start.target
        count = self.limit - episode_lengths(jnp, launch, self.limit, self.robot.timing.control_dt)
        state = EnvState(
            fish=fish, params=params, current=current, target=target, history=history, camera=camera, command=joints,
            joints=jnp.zeros((n, self.sensors.behind, 2 * self.n_act)),
            tick=jnp.zeros((n,), jnp.int32), count=count, key=key, obs=blank, final_obs=blank,
            privileged=None, final_privileged=None, reward=zero, terminated=no, truncated=no,
            distance=jnp.linalg.norm(start.pose[:, :2] - target, axis=-1), diverged=no,
            launch=launch if self.moves else None,
        )  # fmt: skip
        obs_now = self._observe(state, jnp.zeros((n, self.sensors.behind + 1, 2 * self.n_act)), keys[3])
        privileged = self._privileged(state, obs_now)
        return state._replace(obs=self._stack_memory(None, None, obs_now), privileged=privileged, final_privileged=privileged)

    def _observe(self, state: EnvState, recent, key):
        noise = self.options.noise * jax.random.normal(key, (state.target.shape[0], self.n_obs))
        senses = (state.history, state.camera, recent, state.target, noise)
        return self.mask * task.observe_with_sensors(jnp, self.robot, self.sensors, state.params, *senses)

    def _stack_memory(self, obs, action, obs_now):
        """Policy input: the newest observation first, then (action, observation) pairs back in time."""
        if self.options.memory == 1:
            return obs_now
        if obs is None:
            rest = jnp.concatenate([jnp.zeros_like(obs_now[:, : self.n_act]), obs_now], -1)
            return jnp.concatenate([obs_now] + [rest] * (self.options.memory - 1), -1)
        return jnp.concatenate([obs_now, action, obs], -1)[:, : self.n_input]

    def _privileged(self, state: EnvState, obs_now):
        """The columns of `task.privileged_spans`, noise-free and in the true body frame: for critics only."""
        q, v = state.fish.q, state.fish.v
        c, s = jnp.cos(q[:, 2]), jnp.sin(q[:, 2])
        body = lambda x, y: jnp.stack([c * x + s * y, c * y - s * x], -1)
        goal = body(*(state.target - q[:, :2]).T)
        here = jnp.concatenate([goal, body(v[:, 0], v[:, 1]), v[:, 2:3], q[:, 3:], v[:, 3:]], -1)
        left = (self.limit - state.count)[:, None] / self.limit
        stream = body(state.current.mean[:, 0], state.current.mean[:, 1])
        return jnp.nan_to_num(jnp.concatenate([here, stream, left, goal], -1))
