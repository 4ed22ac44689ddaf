"""Many fish as one Gymnasium vector environment, on a batched engine.

Each fish has its own random numbers: fish i of `reset(seed=s)` lives the episodes of a single environment with
`reset(seed=s + i)`.

    autoreset_mode    "NextStep" (Gymnasium's default: the step after an end resets), "SameStep" (the last observation is in
                      info["final_obs"]), "Disabled" (call reset with options={"reset_mask": (n,) bool})
"""

from typing import Any

import numpy as np
from gymnasium import vector
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fishmj.errors import ConfigError
from fishmj.gym import spaces
from fishmj.gym.picture import Picture
from fishmj.tasks.episode import Draws, Episodes


class FishVectorEnv(vector.VectorEnv):
    """See `docs/guide/tasks.md`. Arguments as `single.FishEnv`, and num_envs, autoreset_mode."""

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
        self.rules = spaces.rules_of(task, options)
        self._bounds = self.single_observation_space = spaces.observation_space(self.rules)
        self.single_action_space = spaces.action_space(self.rules)
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
        self.episodes.begin(self.rules.scenario(draws, **spaces.fixed_by(self.rules, options, len(rows))), rows)

    def _observe(self, rows=None) -> np.ndarray:
        """Observations (n, n_obs) float32; only fish `rows` draw sensor noise."""
        normals = np.zeros((self.num_envs, self.rules.n_obs))
        for i in range(self.num_envs) if rows is None else rows:
            normals[i] = self._rngs[i].standard_normal(self.rules.n_obs)
        return spaces.clipped(self.episodes.observation(normals), self._bounds)

    def _info(self, distance, power, diverged) -> dict:
        every = np.ones(self.num_envs, bool)
        info = {"distance": distance.copy(), "power": power.copy(), "diverged": diverged.copy()}
        return {**info, **{f"_{k}": every.copy() for k in info}}
