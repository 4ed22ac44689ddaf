"""Station holding for thousands of fish at once: a functional environment in JAX over any jit-able engine.

    state = env.reset(key, n);  state = env.step(state, action)

`step` restarts finished episodes by itself; `state.final_obs` is the observation before that restart, for bootstrapping.
The flow is hidden: it is in `state.privileged` (for a critic that trains in simulation only), never in `state.obs`.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fishmj import engines, flow
from fishmj.engines import FishParams, FishState
from fishmj.errors import ConfigError, UnknownName
from fishmj.flow import Current
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import slide
from fishmj.tasks.reference import StepTruth, course_of
from fishmj.tasks.sensing import Sensors, readings
from fishmj.water.choice import in_water


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a training run may change about the task."""

    turbulence: str = "default"
    intensity: tuple[float, float] = (0.0, 0.10)  # TI, drawn uniformly for each episode
    randomisation: float = 1.0
    noise: float = 1.0
    memory: int = 1  # observations (with the actions between them) that the policy sees
    box: str = "train"
    hide: tuple[str, ...] = ()  # observation groups set to zero (ablations), of station_hold.GROUPS
    course: str = "station_hold"  # of tasks.reference, or the text of one's own that was loaded
    effects: tuple[str, ...] = ()  # of the catalogue, drawn in typical sizes for each episode, `randomisation` times as large

    def __post_init__(self):
        low, high = self.intensity
        if not 0 <= low <= high <= 1:
            raise ConfigError(f"task: intensity = {self.intensity}; expected two bounds, 0 <= low <= high <= 1")
        if not (self.memory >= 1 and self.noise >= 0 and self.randomisation >= 0):
            raise ConfigError(
                f"task: memory = {self.memory}, noise = {self.noise}, randomisation = {self.randomisation}; "
                "memory counts observations, 1 at least; the others are not negative"
            )
        for kind, name, known in (("turbulence", self.turbulence, flow.PRESETS), ("box", self.box, flow.BOXES)):
            if name not in known:
                raise UnknownName(kind, name, known)


class EnvState(NamedTuple):
    """Everything about B running episodes."""

    fish: FishState
    params: FishParams
    current: Current
    target: Any  # (B, 2)
    history: Any  # (B, H, 3) poses at bus ticks
    joints: Any  # (B, K, 2 J) older encoder readings, angles and rates; K = 0 unless an effect delays them
    camera: Any  # (B,) int
    command: Any  # (B, J) last bus command, rad
    tick: Any  # (B,) int
    count: Any  # (B,) int, control steps in this episode
    key: Any
    obs: Any  # (B, memory x n_obs + (memory - 1) x J)
    final_obs: Any
    privileged: Any  # (B, n_obs + 2 + 3)
    final_privileged: Any
    reward: Any  # (B,)
    terminated: Any  # (B,) bool, left the domain
    truncated: Any  # (B,) bool, time is up
    distance: Any  # (B,) m, at the end of the step
    diverged: Any  # (B,) bool, episode dropped because of a non-finite state
    launch: Any = None  # how the episodes began, for targets that move; None where they stay as in station holding


class StationHold:
    """The batched environment. `reset` and `step` are pure; jit them or call them inside a scan.

    Args:
        engine: a name, or an engine of this very robot. water: for an engine by name, as `fishmj.water.choice` names it.
    """

    def __init__(self, robot: Robot, engine="planar", options: Options = Options(), *, water=None, **reward):  # noqa: B008  (frozen)
        if isinstance(engine, str):  # else the engine's fish is in its water already
            robot = in_water(robot, water, who="the environment in JAX")
        self.robot = robot = engines.with_effects(robot, options.effects)
        self.engine = engines.make(engine, robot) if isinstance(engine, str) else engine
        if getattr(self.engine, "robot", robot).effects != robot.effects:
            raise ConfigError(
                f"task: the engine's robot lacks {', '.join(options.effects)}; make it from engines.with_effects(robot, ..)"
            )
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
            raise ConfigError(
                f"task {options.course}: has a reward of its own, without {', '.join(reward)}; leave the weights out"
            )
        self.limit = task.control_steps(self.course.seconds, robot)
        self.mask = jnp.asarray(task.visible(robot.n_joints, options.hide), jnp.float32)

    @property
    def n_input(self) -> int:
        """Width of the policy's input."""
        m = self.options.memory
        return m * self.n_obs + (m - 1) * self.n_act

    @property
    def n_privileged(self) -> int:
        """Width of what a privileged critic sees besides the policy's input."""
        return self.n_obs + 5

    @partial(jax.jit, static_argnums=(0, 2, 3))
    def reset(self, key, n: int, stagger: bool = False) -> EnvState:
        """n fresh episodes; with `stagger` their clocks start anywhere in the episode, so that they do not end together."""
        key, k_start, k_clock = jax.random.split(key, 3)
        state = self._fresh(k_start, n)
        if stagger:
            state = state._replace(count=jax.random.randint(k_clock, (n,), 0, self.limit))
        return state._replace(key=key)

    @partial(jax.jit, static_argnums=0)
    def step(self, state: EnvState, action) -> EnvState:
        """One control step of 0.2 s with action (B, J) in [-1, 1]."""
        n = action.shape[0]
        key, k_noise, k_fresh = jax.random.split(state.key, 3)
        action = jnp.where(jnp.isfinite(action), action, 0.0)
        commands = task.chunk(jnp, self.robot, state.command, action)
        fish, trace = self.engine.advance(state.fish, commands, state.params, state.current, state.tick)
        bad = ~(jnp.all(jnp.isfinite(fish.q), -1) & jnp.all(jnp.isfinite(fish.v), -1))
        history = jnp.where(bad[:, None, None], 0.0, slide(jnp, state.history, trace.pose))
        tick = state.tick + commands.shape[1]
        target = self._target(state.launch, tick) if self.moves else state.target
        distance = jnp.linalg.norm(trace.pose[:, -1, :2] - target, axis=-1)
        gain = self._gain(trace, target, distance, action, tick)
        terminated = (self.outside or task.outside)(jnp, trace.pose[:, -1]) & ~bad
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
        """Targets (B, 2) m at bus ticks (B,) since the episodes began; a staggered clock does not move them."""
        return jnp.asarray(self.course.target(jnp, launch, tick * self.robot.timing.bus_dt), jnp.float32)

    def _gain(self, trace, target, distance, action, tick):
        """Reward (B,)."""
        if self.own_reward is None:
            return task.reward(jnp, distance, trace.rate, **self.weights)
        return self.own_reward(jnp, StepTruth(trace, target, distance, action, tick * self.robot.timing.bus_dt))

    def _fresh(self, key, n: int) -> EnvState:
        """n new episodes at rest over ground."""
        keys = jax.random.split(key, 4)
        launch = self.course.launch(jnp, jax.random.uniform(keys[0], (n, task.N_START)))
        launch = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), launch)
        start = launch.start
        u = jax.random.uniform(keys[1], (n, task.N_FLOW + 1))
        low, high = self.options.intensity
        intensity = low + (high - low) * u[:, 4]
        cell = jnp.float32(self.cell)
        current = flow.draw(jnp, self.options.turbulence, self.table, cell, start.speed, start.direction, intensity, u)
        draws = jax.random.uniform(keys[2], (n, task.n_fish(self.robot, self.options.effects)))
        params, camera = task.draw_fish(jnp, self.robot, draws, self.options.randomisation, self.options.effects)
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
        state = EnvState(
            fish=fish, params=params, current=current, target=target, history=history, camera=camera, command=joints,
            joints=jnp.zeros((n, self.sensors.behind, 2 * self.n_act)),
            tick=jnp.zeros((n,), jnp.int32), count=jnp.zeros((n,), jnp.int32), key=key, obs=blank, final_obs=blank,
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
        """Noise-free target and flow in the true body frame, true velocity and the time left: for critics only."""
        q, v = state.fish.q, state.fish.v
        c, s = jnp.cos(q[:, 2]), jnp.sin(q[:, 2])
        body = lambda x, y: jnp.stack([c * x + s * y, c * y - s * x], -1)
        goal = body(*(state.target - q[:, :2]).T)
        here = jnp.concatenate([goal, body(v[:, 0], v[:, 1]), v[:, 2:3], q[:, 3:], v[:, 3:]], -1)
        left = (self.limit - state.count)[:, None] / self.limit
        stream = body(state.current.mean[:, 0], state.current.mean[:, 1])
        return jnp.nan_to_num(jnp.concatenate([here, stream, left, goal], -1))
