"""One fish as a Gymnasium environment, on any engine.

terminated    the reference point left |x|, |y| <= 2 m
truncated     the time is up (150 steps of 0.2 s); or the physics diverged, then info["diverged"] is True
info          distance [m] to the target, power [W] of the servos, diverged; never the flow
"""

from typing import Any

import gymnasium
import numpy as np

from fishmj.gym import spaces
from fishmj.gym.picture import Picture
from fishmj.tasks.episode import EpisodeDraw, Episodes


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
        self.rules = spaces.rules_of(task, options)
        self._bounds = self.observation_space = spaces.observation_space(self.rules)
        self.action_space = spaces.action_space(self.rules)
        self.episodes = Episodes(self.rules, engine, 1)
        self.render_mode, self._picture = render_mode, None
        self.metadata = {**self.metadata, "render_fps": round(1 / self.rules.dt)}

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Start an episode; options may fix pose (x, y, yaw), target (x, y), flow speed [m/s] and direction [rad]."""
        super().reset(seed=seed)
        fixed = spaces.fixed_by(self.rules, options, 1)
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
        return spaces.clipped(obs, self._bounds)
