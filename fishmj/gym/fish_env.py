"""One fish as a Gymnasium environment, on any engine, and many fish as one vector environment.

terminated    the reference point left |x|, |y| <= 2 m
truncated     the time is up (150 steps of 0.2 s); or the physics diverged, then info["diverged"] is True
info          distance [m] to the target, power [W] of the servos, diverged; never the flow
"""

from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces, vector
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fishmj.calib import constant
from fishmj.errors import ConfigError
from fishmj.mjcf.description import Robot
from fishmj.mjcf.from_above import FromAbove, coarse_skin
from fishmj.tasks.episode import Draws, EpisodeDraw, Episodes, TaskOptions, TaskSpec
from fishmj.tasks.reference import named, options_of
from fishmj.tasks.station_hold import spans

SIDE = 480  # pixels
# Bounds of the observations, which Gymnasium wants finite: several times what a fish reaches inside the domain, so the clip
# to them never acts on a sound simulation. Target m, velocity m/s, yaw rate rad/s, joint rad, joint rate rad/s.
LARGEST = (20.0, 10.0, 50.0, np.pi, 50.0)


class Picture:
    """Draws one fish in the task's tank, as a film of its replay does; needs no screen. Raises MissingExtra without OpenCV."""

    def __init__(self, robot: Robot):
        self.view = FromAbove((SIDE, SIDE), (0.0, 0.0), SIDE / (2 * constant("task", "bound")), (SIDE / 2, SIDE / 2))
        self.skin, self.still = coarse_skin(robot), self.view.water()

    def draw(self, q, target) -> np.ndarray:
        """The fish at q (nv,) and its target (2,), seen from above."""
        image = self.still.copy()
        self.view.swimmer(image, np.asarray(q, float), np.asarray(target, float), self.skin)
        return np.ascontiguousarray(image[:, :, ::-1])


def rules_of(task: Any, options: dict) -> TaskSpec:
    """Rules from the keyword arguments of `gymnasium.make`: fields of `TaskOptions` and of the task's course.

    task: a name, or one's own as `module:Name`, `file.py:Name` or class; loading it runs it.

    Raises:
        ConfigError, UnknownName: an option or a task that does not exist.
    """
    task = named(task)
    general = {f.name for f in fields(TaskOptions)}
    special = options_of(task) - general
    unknown = sorted(set(options) - general - special)
    if unknown:
        raise ConfigError(f"gym: unknown option {unknown[0]!r}; known: {', '.join(sorted(general | special))}")
    pick = lambda names: {k: v for k, v in options.items() if k in names}
    return TaskSpec(task, TaskOptions(**pick(general)), **pick(special))


def observation_space(rules: TaskSpec) -> spaces.Box:
    """(11,) float32: target, velocity, yaw rate, joints, joint rates."""
    high = np.repeat(np.array(LARGEST, np.float32), [*spans(rules.n_act).values()])
    return spaces.Box(-high, high, dtype=np.float32)


def clipped(seen, space: spaces.Box) -> np.ndarray:
    """Observations as the space declares them: float32, inside its bounds."""
    return np.clip(seen, space.low, space.high).astype(np.float32)


def action_space(rules: TaskSpec) -> spaces.Box:
    """(3,) in [-1, 1]: desired joint angles over the servo's range."""
    return spaces.Box(-1.0, 1.0, (rules.n_act,), np.float32)


def fixed_by(rules: TaskSpec, options: dict | None, n: int) -> dict:
    """What `reset(options=...)` fixes of n starts, as arrays: pose (n, 3), target (n, 2), flow speed (n,) and direction (n,).

    Raises:
        ConfigError: an option that does not exist, of the wrong shape, or that this task decides by itself.
    """
    widths = {"pose": (3,), "target": (2,), "speed": (), "direction": ()}
    own = getattr(rules.course, "decides", ())
    fixed = {}
    for name, value in (options or {}).items():
        if name not in widths:
            raise ConfigError(f"reset: unknown option {name!r}; known: {', '.join(widths)}")
        if name in own:
            raise ConfigError(f"reset: {rules.name} decides {name} by itself; its own options go to gymnasium.make")
        try:
            fixed[name] = np.broadcast_to(np.asarray(value, float), (n, *widths[name])).copy()
        except ValueError as error:
            raise ConfigError(
                f"reset: option {name} = {value!r}; expected shape {widths[name]} or {(n, *widths[name])}"
            ) from error
        if not np.isfinite(fixed[name]).all():
            raise ConfigError(f"reset: option {name} = {value!r} is not finite")
    return fixed


class FishEnv(gymnasium.Env):
    """See `docs/guide/tasks.md`.

    Args:
        task: station_hold, figure_eight, angle_of_attack, or one's own (docs/guide/your_own_code.md).
        engine: "batch" (MuJoCo C), "compiled" or "planar" (closed form, ten times faster), or an engine.
        render_mode: None or "rgb_array".
        options: fields of `tasks.episode.TaskOptions` and of the task's course.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}

    def __init__(self, task: Any = "station_hold", engine="batch", render_mode: str | None = None, **options):
        self.rules = rules_of(task, options)
        self._bounds = self.observation_space = observation_space(self.rules)
        self.action_space = action_space(self.rules)
        self.episodes = Episodes(self.rules, engine, 1)
        self.render_mode, self._picture = render_mode, None
        self.metadata = {**self.metadata, "render_fps": round(1 / self.rules.dt)}

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Start an episode; options may fix pose (x, y, yaw), target (x, y), flow speed [m/s] and direction [rad]."""
        super().reset(seed=seed)
        fixed = fixed_by(self.rules, options, 1)
        return self.begin(self.rules.scenario(self.rules.draws(self.np_random, 1), **fixed))

    def begin(self, scenario: EpisodeDraw):
        """Start this very episode; what `reset` does with a drawn one."""
        self.episodes.begin(scenario)
        distance = np.linalg.norm(scenario.launch.start.pose[0, :2] - self.episodes.target[0])
        return self._observe(), {"distance": float(distance), "power": 0.0, "diverged": False}

    def step(self, action):
        """One control step."""
        out = self.episodes.step(np.asarray(action, float)[None])
        info = {"distance": float(out.distance[0]), "power": float(out.power[0]), "diverged": bool(out.diverged[0])}
        return self._observe(), float(out.reward[0]), bool(out.terminated[0]), bool(out.truncated[0]), info

    def render(self):
        """A picture (480, 480, 3) uint8 from above, or None without a render mode."""
        if self.render_mode is None:
            return None
        if self._picture is None:
            self._picture = Picture(self.rules.robot)
        return self._picture.draw(self.episodes.fish.q[0], self.episodes.target[0])

    def _observe(self) -> np.ndarray:
        obs = self.episodes.observation(self.np_random.standard_normal((1, self.rules.n_obs)))[0]
        return clipped(obs, self._bounds)


class FishVectorEnv(vector.VectorEnv):
    """Many fish; each has its own random numbers: fish i of `reset(seed=s)` lives the episodes of `FishEnv.reset(seed=s + i)`.

    Args:
        num_envs: how many. The others as of `FishEnv`.
        autoreset_mode: "NextStep" (Gymnasium's default: the step after an end resets), "SameStep" (the last observation is in
            info["final_obs"]), "Disabled" (call reset with options={"reset_mask": (n,) bool}).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, task: Any = "station_hold", engine="batch", render_mode: str | None = None,
                 autoreset_mode="NextStep", **options):  # fmt: skip
        self.num_envs, self.render_mode = num_envs, render_mode
        try:
            self.mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            known = ", ".join(m.value for m in AutoresetMode)
            raise ConfigError(f"gym: autoreset_mode = {autoreset_mode!r}; choose one of {known}") from error
        if num_envs < 1:
            raise ConfigError(f"gym: num_envs = {num_envs}; needs at least 1")
        self.rules = rules_of(task, options)
        self._bounds = self.single_observation_space = observation_space(self.rules)
        self.single_action_space = action_space(self.rules)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {**self.metadata, "render_fps": round(1 / self.rules.dt), "autoreset_mode": self.mode}
        self.episodes = Episodes(self.rules, engine, num_envs)
        self._rngs = [seeding.np_random()[0] for _ in range(num_envs)]
        self._over = np.zeros(num_envs, bool)
        self._picture: Picture | None = None

    def reset(self, *, seed=None, options: dict | None = None):
        """Start all episodes, or those of options["reset_mask"]; seed: int, or one (or None) for each fish.

        The other options fix pose, target, speed and direction, for all fish or one row each.
        """
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, bool)), bool)
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ConfigError(f"reset: reset_mask of shape {mask.shape}; expected ({self.num_envs},) with one True at least")
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seed = [int(seed) + i for i in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ConfigError(f"reset: {len(seeds)} seeds for {self.num_envs} fish")
        for i in np.flatnonzero(mask):
            if seeds[i] is not None:
                self._rngs[i] = seeding.np_random(seeds[i])[0]
        rows = np.flatnonzero(mask)
        self._begin(rows, options)
        self._over[rows] = False
        start = self.episodes.scenario.launch.start
        info = self._info(np.linalg.norm(start.pose[:, :2] - self.episodes.target, axis=-1), np.zeros(self.num_envs), self._over)
        return self._observe(rows), info

    def step(self, actions):
        """One control step of all fish."""
        actions = np.asarray(actions, float)
        waiting = self._over if self.mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        out = self.episodes.step(np.where(waiting[:, None], 0.0, actions) if actions.ndim == 2 else actions)
        reward, terminated, truncated = out.reward, out.terminated, out.truncated
        info = self._info(out.distance, out.power, out.diverged)
        if waiting.any():
            self._begin(np.flatnonzero(waiting))
            reward, terminated, truncated = (np.where(waiting, 0, a).astype(a.dtype) for a in (reward, terminated, truncated))
        obs = self._observe()
        over = terminated | truncated
        if self.mode is AutoresetMode.SAME_STEP and over.any():
            obs = self._restart(np.flatnonzero(over), over, obs, info)
        self._over = over
        return obs, reward, terminated, truncated, info

    def render(self):
        """One picture a fish, or None without a render mode."""
        if self.render_mode is None:
            return None
        self._picture = self._picture or Picture(self.rules.robot)
        return tuple(self._picture.draw(q, target) for q, target in zip(self.episodes.fish.q, self.episodes.target, strict=True))

    def _restart(self, rows, over, obs, info):
        """Begin new episodes at once; their last observations and infos go into `info`."""
        final = np.full(self.num_envs, None, object)
        for i in rows:
            final[i] = obs[i].copy()
        info["final_info"] = {k: np.where(over, v, np.zeros_like(v)) for k, v in info.items() if not k.startswith("_")}
        info["final_info"].update({f"_{k}": over.copy() for k in list(info["final_info"])})
        info["final_obs"], info["_final_obs"], info["_final_info"] = final, over.copy(), over.copy()
        self._begin(rows)
        obs = obs.copy()
        obs[rows] = self._observe(rows)[rows]
        return obs

    def _begin(self, rows, options: dict | None = None) -> None:
        each = [self.rules.draws(self._rngs[i], 1) for i in rows]
        draws = Draws(*(np.concatenate(column) for column in zip(*each, strict=True)))
        self.episodes.begin(self.rules.scenario(draws, **fixed_by(self.rules, options, len(rows))), rows)

    def _observe(self, rows=None) -> np.ndarray:
        """Observations (n, n_obs) float32; only fish `rows` draw sensor noise."""
        normals = np.zeros((self.num_envs, self.rules.n_obs))
        for i in range(self.num_envs) if rows is None else rows:
            normals[i] = self._rngs[i].standard_normal(self.rules.n_obs)
        return clipped(self.episodes.observation(normals), self._bounds)

    def _info(self, distance, power, diverged) -> dict:
        every = np.ones(self.num_envs, bool)
        info = {"distance": distance.copy(), "power": power.copy(), "diverged": diverged.copy()}
        return {**info, **{f"_{k}": every.copy() for k in info}}
