"""Station holding as a stable-baselines3 VecEnv: n fish on a batched engine, seen as the trained policy sees them.

Observations are scaled to order one (`networks.input_scale`), hidden groups are zero, and with memory m > 1 the newest is
followed by m - 1 pairs (action, observation) back in time. An episode whose time is up carries `TimeLimit.truncated`, so that
it bootstraps from `terminal_observation`; one that left the tank does not.
"""

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from fishmj.gym.fish_vector_env import FishVectorEnv
from fishmj.gym.spaces import observation_space
from fishmj.tasks.station_hold import visible
from fishmj.train.build import pick_engine, robot_for
from fishmj.train.networks import scale
from fishmj.train.rollout import StepRecord, metrics_of
from fishmj.train.settings import Settings


class FishVecEnv(VecEnv):
    """n fish with the run's task, reward and engine (any engine, MuJoCo's `batch` too).

    `tally` sums up what happened since it was last emptied: see `metrics`.
    """

    def __init__(self, settings: Settings, n: int, box: str = "train", reward_scale: float = 1.0):
        task, robot = dict(settings.task), robot_for(settings)
        self.memory, hide = task.pop("memory", 1), task.pop("hide", ())
        course = task.pop("course", "station_hold")
        options = {**task, **settings.reward, "robot": robot, "box": box}
        self.fish = FishVectorEnv(n, course, engine=pick_engine(settings.engine), autoreset_mode="SameStep", **options)
        self.joints, self.reward_scale = robot.n_joints, reward_scale
        self.factor = np.array(visible(self.joints, hide), np.float32) / scale(self.joints).astype(np.float32)
        one = observation_space(self.fish.rules).high / scale(self.joints)
        high = np.concatenate([one] + [np.ones(self.joints), one] * (self.memory - 1)).astype(np.float32)
        self.render_mode = None
        super().__init__(n, spaces.Box(-high, high, dtype=np.float32), self.fish.single_action_space)
        self.count, self.gain = np.zeros(n, int), np.zeros(n)
        self.tally: list[StepRecord] = []

    def reset(self) -> np.ndarray:
        """Start all episodes, with the seeds that `seed` set."""
        seeds = None if self._seeds[0] is None else self._seeds
        raw, _ = self.fish.reset(seed=seeds)
        self._reset_seeds()
        self.count[:], self.gain[:] = 0, 0.0
        self.seen = self._start(raw)
        return self.seen

    def seed(self, seed: int | None = None):
        """Seeds of the fish at the next reset, unlike those of any other `seed` (SB3's own are seed, seed + 1, ...)."""
        self._seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(self.num_envs)]
        return self._seeds

    def step_async(self, actions: np.ndarray) -> None:
        """Note the actions (n, J) in [-1, 1]."""
        self._actions = np.asarray(actions, np.float32)

    def step_wait(self):
        """One control step of all fish: (observations, rewards, dones, infos)."""
        raw, reward, terminated, truncated, info = self.fish.step(self._actions)
        over = terminated | truncated
        last = raw
        if over.any():
            last = raw.copy()
            last[over] = np.stack(info["final_obs"][over])
        seen = np.concatenate([last * self.factor, self._actions, self.seen], 1)[:, : self.seen.shape[1]]
        self.count = self.count + 1
        self.gain = self.gain + reward
        infos: list[dict] = [{} for _ in over]
        for i in np.flatnonzero(over):
            infos[i] = {
                "terminal_observation": seen[i].copy(),
                "TimeLimit.truncated": bool(truncated[i]),
                "diverged": bool(info["diverged"][i]),
                "episode": {"r": float(self.gain[i]), "l": int(self.count[i]), "t": 0.0},
            }
        late = (self.count > self.fish.rules.limit // 2) & ~over
        self.tally.append(StepRecord(reward, info["distance"], late, over, terminated, info["diverged"]))
        if over.any():
            seen[over] = self._start(raw)[over]
            self.count[over], self.gain[over] = 0, 0.0
        self.seen = seen
        return seen.copy(), (self.reward_scale * reward).astype(np.float32), over, infos

    def metrics(self) -> dict[str, float]:
        """Metrics of the steps since the last call, as the other learners report them."""
        record = StepRecord(*(np.stack(a) for a in zip(*self.tally, strict=True)))
        self.tally = []
        return metrics_of(np, record)

    def _start(self, raw: np.ndarray) -> np.ndarray:
        """The input at the start of an episode: as if the fish had always been here, at rest."""
        sight = raw * self.factor
        pair = np.concatenate([np.zeros((self.num_envs, self.joints), np.float32), sight], 1)
        return np.concatenate([sight] + [pair] * (self.memory - 1), 1)

    def close(self) -> None:
        """Free the environment."""
        self.fish.close()

    def get_attr(self, attr_name: str, indices=None) -> list:
        """The attribute of the shoal, once for each fish asked for."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value, indices=None) -> None:
        """Set an attribute of the shoal: the fish have none of their own."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list:
        """Call a method of the shoal once."""
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """No: these are no gymnasium environments, but `infos` has the episodes as SB3's Monitor writes them."""
        return [False] * len(list(self._get_indices(indices)))
