"""Gymnasium environments: one fish on any engine, and many fish as a vector environment.

terminated    the reference point left |x|, |y| <= 2 m
truncated     time limit (150 steps of 0.2 s), or the physics diverged, then info["diverged"] is True
info          distance [m] to the target, power [W] of the servos, diverged; never the flow

The vector environment returns the same numbers as a `SyncVectorEnv` of single ones, in every autoreset mode, but faster.
"""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces, vector
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, ResetNeeded
from fishmj.base.options import checked, shown_value
from fishmj.engines import name_of
from fishmj.mjcf.description import Robot
from fishmj.mjcf.from_above import FromAbove, coarse_skin
from fishmj.tasks.episode import LARGEST as LARGEST_OPTIONS
from fishmj.tasks.episode import Draws, EpisodeDraw, Episodes, StepResult, TaskSpec, options_for
from fishmj.tasks.reference import named
from fishmj.tasks.station_hold import input_scale, spans

SIDE = 480  # pixels
# Bounds of the observations, which must be finite: several times the values inside the domain, so that they never clip a sound
# simulation. Target m, velocity m/s, yaw rate rad/s, joint rad, joint rate rad/s.
LARGEST = (20.0, 10.0, 50.0, np.pi, 50.0)


class FishRenderer:
    """Draws one fish in the task's tank, as replay videos do, without a display. Raises MissingExtra without OpenCV."""

    def __init__(self, robot: Robot):
        self.view = FromAbove((SIDE, SIDE), (0.0, 0.0), SIDE / (2 * constant("task", "bound")), (SIDE / 2, SIDE / 2))
        self.skin, self.still = coarse_skin(robot), self.view.water()

    def draw(self, q, target) -> np.ndarray:
        """The fish at q (nv,) and its target (2,), seen from above."""
        image = self.still.copy()
        self.view.swimmer(image, np.asarray(q, float), np.asarray(target, float), self.skin)
        return np.ascontiguousarray(image[:, :, ::-1])


def rules_of(task: Any, options: dict) -> TaskSpec:
    """`TaskSpec` from the keyword arguments of `gymnasium.make`: fields of `TaskOptions` and of the task's course.

    task: a name, or your own as `module:Name`, `file.py:Name` or class; loading it runs it.

    Raises ConfigError, UnknownName: an option or a task that does not exist.
    """
    task = named(task)
    general, special = options_for(task, options)
    return TaskSpec(task, general, **special)


def observation_space(rules: TaskSpec) -> spaces.Box:
    """(11,) float32: target, velocity, yaw rate, joints, joint rates."""
    high = np.repeat(np.array(LARGEST, np.float32), [*spans(rules.n_act).values()])
    return spaces.Box(-high, high, dtype=np.float32)


def clipped(seen, space: spaces.Box) -> np.ndarray:
    """Observations as float32, clipped to the bounds of the space."""
    return np.clip(seen, space.low, space.high).astype(np.float32)


def action_space(rules: TaskSpec) -> spaces.Box:
    """(3,) in [-1, 1]: desired joint angles over the servo's range."""
    return spaces.Box(-1.0, 1.0, (rules.n_act,), np.float32)


def fixed_by(rules: TaskSpec, options: dict | None, n: int) -> dict:
    """Values fixed by `reset(options=...)`, as arrays: pose (n, 3), target (n, 2), flow speed (n,) and direction (n,).

    Raises ConfigError: an option that does not exist, has the wrong shape, or is set by the task itself; a pose or target outside
    the domain.
    """
    widths = {"pose": (3,), "target": (2,), "speed": (), "direction": ()}
    own = getattr(rules.course, "decides", ())
    fixed = {}
    if not isinstance(options or {}, dict):
        raise ConfigError(f"reset: options = {shown_value(options)}; expected a dict with some of {', '.join(widths)}")
    for name, value in (options or {}).items():
        if name not in widths:
            raise ConfigError(f"reset: unknown option {name!r}; known: {', '.join(widths)}")
        if name in own:
            raise ConfigError(f"reset: the task {rules.name} sets {name} itself; give its options to gymnasium.make")
        try:
            fixed[name] = np.broadcast_to(np.asarray(value, float), (n, *widths[name])).copy()
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"reset: option {name} = {shown_value(value)}; expected shape {widths[name]} or {(n, *widths[name])}"
            ) from error
        if not np.isfinite(fixed[name]).all():
            raise ConfigError(f"reset: option {name} = {shown_value(value)} is not finite")
    for name in ("pose", "target"):
        if name in fixed and np.any(rules.outside(np, np.pad(fixed[name], [(0, 0), (0, 3 - widths[name][0])]))):
            place = shown_value(fixed[name].tolist())
            raise ConfigError(f"reset: option {name} = {place}; expected a position inside the task's domain")
    for speed in fixed.get("speed", ()):
        checked("reset: option speed", speed, 0, LARGEST_OPTIONS["flow_speed"])
    return fixed


def start_distance(episodes: Episodes) -> np.ndarray:
    """Distances (n,) m to the targets at the start of the episodes; valid while they are at their start."""
    return np.linalg.norm(episodes.scenario.launch.start.pose[:, :2] - episodes.target, axis=-1)


def _at_zero(actions: Any, rows: np.ndarray) -> Any:
    """Sets the actions of the fish `rows` (n,) bool to zero; leaves non-numeric values, which `step` refuses."""
    try:
        given = np.asarray(actions, float)
    except (TypeError, ValueError):
        return actions
    return np.where(rows[:, None], 0.0, given) if given.ndim == 2 and len(given) == len(rows) else given


class _Fish:
    """Common part of both environments."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 5}
    rules: TaskSpec
    episodes: Episodes
    _spec: EnvSpec | None = None
    _picture: FishRenderer | None = None

    def _settle(self, task: Any, engine: Any, n: int, render_mode: str | None, options: dict) -> None:
        """Checks the arguments and makes the episodes of n fish."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"gym: render_mode = {render_mode!r}; expected None or 'rgb_array'")
        self.rules, self.render_mode = rules_of(task, options), render_mode
        self.episodes = Episodes(self.rules, engine, n)
        self._bounds = observation_space(self.rules)
        self.metadata = {**self.metadata, "render_fps": round(1 / self.rules.dt)}
        self._begun = False

    @property
    def engine(self) -> str:
        """Name of the engine in use."""
        return name_of(self.episodes.engine)

    @property
    def input_scale(self) -> np.ndarray:
        """Divisors (n_obs,) of the observations in fishmj's own trainings; `Policy.of` expects them."""
        return input_scale(self.rules.n_act).astype(np.float32)

    @property
    def spec(self) -> EnvSpec | None:
        """Spec that `gymnasium.make` sets; `max_episode_steps` is the length of these episodes in control steps."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None if spec is None else replace(spec, max_episode_steps=self.rules.limit)

    def _draw(self, i: int) -> np.ndarray:
        """Image of fish i."""
        self._picture = self._picture or FishRenderer(self.rules.robot)
        return self._picture.draw(self.episodes.fish.q[i], self.episodes.target[i])

    def __getstate__(self) -> dict[str, Any]:
        """State without the renderer, which cannot be copied and is made again on demand."""
        return {**self.__dict__, "_picture": None}

    def _need_reset(self) -> None:
        if not self._begun:
            raise ResetNeeded("gym: step was called before the first reset; call reset()")


class FishEnv(_Fish, gymnasium.Env):
    """One fish as a Gymnasium environment (docs/train/tasks.md). A deep copy or a pickle continues like the original, to the bit.

    Args:
        task: station_hold, figure_eight, angle_of_attack, or your own (docs/simulate/your_own_code.md).
        engine: "compiled" (extra `fast`) or "planar" (closed form), "batch" (MuJoCo C, a tenth as fast), or an engine.
            None takes "compiled" if numba is installed, else "planar"; the attribute `engine` has its name.
        render_mode: None or "rgb_array".
        options: fields of `tasks.episode.TaskOptions` and of the task's course.

    Raises ConfigError, UnknownName: an invalid argument. ResetNeeded: `step` before the first `reset`.
    """

    def __init__(self, task: Any = "station_hold", engine=None, render_mode: str | None = None, **options):
        self._settle(task, engine, 1, render_mode, options)
        self.observation_space, self.action_space = self._bounds, action_space(self.rules)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Starts an episode; options may fix pose (x, y, yaw), target (x, y), flow speed [m/s] and direction [rad]."""
        super().reset(seed=seed)
        fixed = fixed_by(self.rules, options, 1)
        return self.begin(self.rules.scenario(self.rules.draws(self.np_random, 1), **fixed))

    def begin(self, scenario: EpisodeDraw):
        """Starts this episode; `reset` does the same with a drawn one."""
        self._begun = True
        self.episodes.begin(scenario)
        return self._observe(), {"distance": float(start_distance(self.episodes)[0]), "power": 0.0, "diverged": False}

    def step(self, action):
        """Does one control step."""
        self._need_reset()
        out = self.episodes.step(action, alone=True)
        info = {"distance": float(out.distance[0]), "power": float(out.power[0]), "diverged": bool(out.diverged[0])}
        return self._observe(), float(out.reward[0]), bool(out.terminated[0]), bool(out.truncated[0]), info

    def render(self):
        """A picture (480, 480, 3) uint8 from above, or None without a render mode."""
        return None if self.render_mode is None else self._draw(0)

    def _observe(self) -> np.ndarray:
        obs = self.episodes.observation(self.np_random.standard_normal((1, self.rules.n_obs)))[0]
        return clipped(obs, self._bounds)


class FishVectorEnv(_Fish, vector.VectorEnv):
    """Many fish; each has its own random numbers: fish i of `reset(seed=s)` has the episodes of `FishEnv.reset(seed=s + i)`.

    Args:
        num_envs: number of fish. The others as for `FishEnv`.
        autoreset_mode: "NextStep" (Gymnasium's default: the step after an end resets), "SameStep" (the last observation is in
            info["final_obs"]), "Disabled" (call reset with options={"reset_mask": (n,) bool}).
        max_episode_steps: time limit in control steps, if below that of the task; -1 for none.

    Raises:
        ConfigError, UnknownName: an invalid argument.
        ResetNeeded: `step` before the first `reset`, or, with "Disabled", while a fish has ended.
    """

    metadata = {**_Fish.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, task: Any = "station_hold", engine=None, render_mode: str | None = None,
                 autoreset_mode="NextStep", max_episode_steps: int | None = None, **options):  # fmt: skip
        self.num_envs = checked("gym: num_envs", num_envs, 1, whole=True)
        try:
            self.mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            known = ", ".join(m.value for m in AutoresetMode)
            raise ConfigError(f"gym: autoreset_mode = {autoreset_mode!r}; choose one of {known}") from error
        self._settle(task, engine, num_envs, render_mode, options)
        if max_episode_steps not in (None, -1):
            most = checked("gym: max_episode_steps", max_episode_steps, 1, whole=True)
            self.rules.limit = min(self.rules.limit, most)
        self.metadata = {**self.metadata, "autoreset_mode": self.mode}
        self.single_observation_space, self.single_action_space = self._bounds, action_space(self.rules)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs, self._seeds = (list(column) for column in zip(*(seeding.np_random() for _ in range(num_envs)), strict=True))
        self._seen = np.zeros((num_envs, self.rules.n_obs), np.float32)  # the last observations
        self._over = np.zeros(num_envs, bool)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random generator of each fish."""
        return tuple(self._rngs)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each fish."""
        return tuple(self._seeds)

    def reset(self, *, seed=None, options: dict | None = None):
        """Starts all episodes, or those of options["reset_mask"], and leaves the others as they are.

        Args:
            seed: int, or one (or None) for each fish.
            options: further options fix pose, target, speed and direction: one value for all fish, or a row for each of the n.

        Returns:
            Observations (n, 5 + 2 J), for fish that do not restart their last ones; info, in which `_key` is True for fish that
            restart, and the value of the others is 0.
        """
        mask, options = np.ones(self.num_envs, bool), options or {}
        if isinstance(options, dict) and "reset_mask" in options:
            mask = self._mask(options["reset_mask"])
            options = {name: value for name, value in options.items() if name != "reset_mask"}
        fixed = {name: value[mask] for name, value in fixed_by(self.rules, options, self.num_envs).items()}
        for i, one in enumerate(self._seeds_of(seed)):
            if mask[i] and one is not None:
                self._rngs[i], self._seeds[i] = seeding.np_random(one)
        self._begun = True
        self._begin(np.flatnonzero(mask), fixed)
        self._over[mask] = False
        return self._observe(np.flatnonzero(mask)), self._info(mask, mask)

    def step(self, actions):
        """Does one control step of all fish; the actions of fish that restart are ignored."""
        self._need_reset()
        if self.mode is AutoresetMode.DISABLED and self._over.any():
            raise ResetNeeded(
                f"gym: fish {', '.join(map(str, np.flatnonzero(self._over)[:9]))} ended and autoreset_mode is Disabled;"
                ' call reset(options={"reset_mask": terminated | truncated}) before the next step'
            )
        again = self._over if self.mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        out, final, fresh = self.episodes.step(_at_zero(actions, again) if again.any() else actions), {}, None
        reward, terminated, truncated = (np.where(again, a.dtype.type(0), a) for a in (out.reward, out.terminated, out.truncated))
        self._over = terminated | truncated
        if self.mode is AutoresetMode.SAME_STEP and self._over.any():
            again = self._over
            fresh, final = np.flatnonzero(again), self._final(again, out)
        if again.any():
            self._begin(np.flatnonzero(again))
        info = self._info(np.ones(self.num_envs, bool), again, out)
        return self._observe(fresh), reward, terminated, truncated, {**info, **final}

    def render(self):
        """Pictures, one for each fish, or None without a render mode."""
        return None if self.render_mode is None else tuple(self._draw(i) for i in range(self.num_envs))

    def _mask(self, mask) -> np.ndarray:
        """Mask (n,) bool of the fish that a reset starts."""
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ConfigError(
                f"reset: reset_mask of shape {mask.shape}, {mask.dtype}; expected ({self.num_envs},) bool with at least one True"
            )
        if not (self._begun or mask.all()):
            raise ResetNeeded("reset: reset_mask is given before the first reset; reset all fish first")
        return mask

    def _seeds_of(self, seed) -> list:
        """The seed of each fish, or None."""
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, list | tuple | np.ndarray) or len(seed) != self.num_envs:
            raise ConfigError(f"reset: seed = {seed!r}; expected a whole number, None, or a list of {self.num_envs} of these")
        return [one if one is None else checked("reset: seed", one, 0, whole=True) for one in seed]

    def _begin(self, rows, fixed: dict | None = None) -> None:
        each = [self.rules.draws(self._rngs[i], 1) for i in rows]
        draws = Draws(*(np.concatenate(column) for column in zip(*each, strict=True)))
        self.episodes.begin(self.rules.scenario(draws, **(fixed or {})), rows)

    def _final(self, over, out: StepResult) -> dict:
        """`final_obs` and `final_info` of the fish that end; draws the sensor noise of all."""
        seen, final = self._observe(), np.full(self.num_envs, None, object)
        for i in np.flatnonzero(over):
            final[i] = seen[i]
        info = self._info(over, np.zeros_like(over), out)
        return {"final_obs": final, "_final_obs": over.copy(), "final_info": info, "_final_info": over.copy()}

    def _observe(self, rows=None) -> np.ndarray:
        """Observations (n, n_obs) float32; only fish `rows` are observed again, with their own sensor noise."""
        rows = np.arange(self.num_envs) if rows is None else rows
        normals = np.zeros((self.num_envs, self.rules.n_obs))
        for i in rows:
            normals[i] = self._rngs[i].standard_normal(self.rules.n_obs)
        self._seen[rows] = clipped(self.episodes.observation(normals), self._bounds)[rows]
        return self._seen.copy()

    def _info(self, known, fresh, out: StepResult | None = None) -> dict:
        """Info of the fish `known` (n,) bool: of an episode's start if `fresh`, else of the step `out`; 0 for the others."""
        rest = np.zeros(self.num_envs)
        distance, power, diverged = (rest, rest, rest > 0) if out is None else (out.distance, out.power, out.diverged)
        start = start_distance(self.episodes) if fresh.any() else rest
        info = {
            "distance": np.where(known, np.where(fresh, start, distance), 0.0),
            "power": np.where(known & ~fresh, power, 0.0),
            "diverged": known & ~fresh & diverged,
        }
        return {**info, **{f"_{key}": known.copy() for key in info}}
