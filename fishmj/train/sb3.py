"""Soft actor-critic by stable-baselines3 (extra `sb3`), with the paper's networks, on the same fish, into the same policy file.

`StableSAC` gives SB3's learner the interface of our own (`init`, `iterate`, `act`), so that `TrainingRun` also runs it: progress
line, assessment on the tuning flows, export, Ctrl-C, a full disk. SB3's own checkpoints are pickles; here a checkpoint holds
the tensors only: networks, optimisers, temperature. The replay buffer is NOT kept: a resumed run first refills `warmup` steps
of it with the present policy, without learning. It therefore does not repeat the uninterrupted run to the bit.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from fishmj.base import console
from fishmj.tasks.gym.fish_env import FishVectorEnv, observation_space
from fishmj.tasks.station_hold import input_scale, visible
from fishmj.train.build import config_of, environment, pick_engine, robot_for
from fishmj.train.hyperparameters import SACConfig
from fishmj.train.learner import PolicyLayers, StepRecord, metrics_of
from fishmj.train.networks import forward
from fishmj.train.settings import Settings, change
from fishmj.train.training_run import Assessment, TrainingRun

ENDS = {"return": "r", "length": "l"}  # of an episode, as SB3's Monitor calls them
UPDATES = 256  # gradient steps between two reports, about


class FishVecEnv(VecEnv):
    """n fish with the run's task, reward and engine (any engine, MuJoCo's `batch` too), with the policy's input as observation.

    Observations are scaled to order one (`station_hold.input_scale`), hidden groups are zero, and with memory m > 1 the newest is
    followed by m - 1 pairs (action, observation) back in time. An episode that ends at its time limit has `TimeLimit.truncated`,
    so that it bootstraps from `terminal_observation`; one that left the tank does not. `tally`: steps since the last `metrics`.
    """

    def __init__(self, settings: Settings, n: int, box: str = "train", reward_scale: float = 1.0):
        task, robot = dict(settings.task), robot_for(settings)
        self.robot, self.memory, self.hide = robot, task.pop("memory", 1), task.pop("hide", ())
        course = task.pop("course", "station_hold")
        options = {**task, **settings.reward, "robot": robot, "box": box}
        self.fish = FishVectorEnv(n, course, engine=pick_engine(settings), autoreset_mode="SameStep", **options)
        self.joints, self.reward_scale = robot.n_joints, reward_scale
        scale = input_scale(self.joints)
        self.factor = np.array(visible(self.joints, self.hide), np.float32) / scale.astype(np.float32)
        one = observation_space(self.fish.rules).high / scale
        high = np.concatenate([one] + [np.ones(self.joints), one] * (self.memory - 1)).astype(np.float32)
        self.render_mode = None
        super().__init__(n, spaces.Box(-high, high, dtype=np.float32), self.fish.single_action_space)
        self.count, self.gain = np.zeros(n, int), np.zeros(n)
        self.tally: list[StepRecord] = []
        self.ended: list[dict] = []  # infos of the episodes that ended

    def reset(self) -> np.ndarray:
        """Starts all episodes, with the seeds that `seed` set."""
        seeds = None if self._seeds[0] is None else self._seeds
        raw, _ = self.fish.reset(seed=seeds)
        self._reset_seeds()
        self.count[:], self.gain[:] = 0, 0.0
        self.seen = self._start(raw)
        return self.seen

    def seed(self, seed: int | None = None):
        """Sets the seeds of the fish at the next reset, unlike those of any other `seed` (SB3's own are seed, seed + 1, ...)."""
        self._seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(self.num_envs)]
        return self._seeds

    def step_async(self, actions: np.ndarray) -> None:
        """Stores the actions (n, J) in [-1, 1] for `step_wait`."""
        self._actions = np.asarray(actions, np.float32)

    def step_wait(self):
        """Does one control step of all fish: (observations, rewards, dones, infos)."""
        raw, reward, terminated, truncated, info = self.fish.step(self._actions)
        over = terminated | truncated
        last, ended = raw, info.get("final_info", info)  # of fish that restart, `info` is that of the new episode
        distance, diverged = (np.where(over, ended[name], info[name]) for name in ("distance", "diverged"))
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
                "diverged": bool(diverged[i]),
                "episode": {"r": float(self.gain[i]), "l": int(self.count[i]), "t": 0.0},
            }
            self.ended.append(infos[i])
        late = (self.count > self.fish.rules.limit // 2) & ~over
        self.tally.append(StepRecord(reward, distance, late, over, terminated, diverged))
        if over.any():
            seen[over] = self._start(raw)[over]
            self.count[over], self.gain[over] = 0, 0.0
        self.seen = seen
        return seen.copy(), (self.reward_scale * reward).astype(np.float32), over, infos

    def metrics(self) -> dict[str, float]:
        """Metrics of the steps since the last call, in the form of the other learners."""
        record = StepRecord(*(np.stack(a) for a in zip(*self.tally, strict=True)))
        ended = [one for one in self.ended if not one["diverged"]]
        self.tally, self.ended = [], []
        means = (
            {f"episode_{name}": np.mean([one["episode"][key] for one in ended]) for name, key in ENDS.items()} if ended else {}
        )
        return {**metrics_of(np, record), **means}

    def _start(self, raw: np.ndarray) -> np.ndarray:
        """Input at the start of an episode, as if the fish had always rested here."""
        sight = raw * self.factor
        pair = np.concatenate([np.zeros((self.num_envs, self.joints), np.float32), sight], 1)
        return np.concatenate([sight] + [pair] * (self.memory - 1), 1)

    def close(self) -> None:
        """Frees the environment."""
        self.fish.close()

    def get_attr(self, attr_name: str, indices=None) -> list:
        """Attribute of the whole environment, once for each requested fish."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value, indices=None) -> None:
        """Sets an attribute of the whole environment: the fish have none of their own."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list:
        """Calls a method of the whole environment once."""
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """Returns False for each fish: the fish are not gymnasium environments. `infos` has the episodes as SB3's Monitor."""
        return [False] * len(list(self._get_indices(indices)))


def train_sb3(settings: Settings, folder, *, resume: bool = False, quiet: bool = False, command: str | None = None) -> dict:
    """Trains with stable-baselines3; returns the summary of `TrainingRun`. Arguments and errors as there."""
    config = config_of(settings)
    shoal = FishVecEnv(settings, config.envs, reward_scale=config.reward_scale)
    learner = StableSAC(shoal, config, settings.steps)
    engine = pick_engine(settings)
    judge = change(settings, engine="planar" if engine == "batch" else engine)  # assessments run inside JAX
    assess = Assessment(environment(judge, "tune"), learner.act, settings.assess_episodes)
    run = TrainingRun(settings, folder, resume=resume, quiet=quiet, learner=(shoal, learner, assess), command=command)
    if resume:
        console.warn(f"the replay buffer was not kept: {config.warmup:,} steps of the policy refill it before learning goes on")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # networks this small lose by a second thread, on a busy machine by ten times
    try:
        return run.go()
    finally:
        torch.set_num_threads(threads)


class SB3TrainState(NamedTuple):
    """State that a checkpoint keeps."""

    actor: list  # (weights (in, out), bias) of the mean of u
    tensors: dict  # everything of SB3's, by name


class StableSAC:
    """SB3's SAC behind `init` and `iterate`."""

    name = "sb3-sac"

    def __init__(self, shoal: FishVecEnv, config: SACConfig, steps: int):
        self.shoal, self.config = shoal, config
        self.per_step = max(1, round(config.utd * config.envs))
        self.block = max(1, min(config.block, UPDATES // self.per_step))
        self.steps_per_iteration = config.envs * self.block
        self.capacity = max(config.envs, min(config.buffer, steps))
        self.scale = input_scale(shoal.joints, shoal.memory)
        self._now: SB3TrainState | None = None

    def init(self, key) -> SB3TrainState:
        """Fresh learner; its seed is the key's."""
        c = self.config
        activation = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}[c.activation]
        self.seed = int(jax.random.key_data(key)[-1])
        self.model = RefillCallback(
            "MlpPolicy",
            self.shoal,
            learning_rate=c.learning_rate,
            buffer_size=self.capacity,
            learning_starts=min(c.warmup, self.capacity),
            batch_size=c.batch,
            tau=c.tau,
            gamma=c.gamma,
            gradient_steps=self.per_step,
            replay_buffer_class=FiniteReplayBuffer,
            ent_coef=f"auto_{c.initial_alpha!r}",
            target_entropy=c.target_entropy * self.shoal.joints,
            policy_kwargs={"net_arch": list(c.hidden), "activation_fn": activation},
            seed=self.seed,
        )
        self.model.set_logger(Logger(folder=None, output_formats=[]))  # its own would make a folder for each `learn`
        return self._taken()

    def iterate(self, training: SB3TrainState) -> tuple[SB3TrainState, dict]:
        """Does `block` steps of all fish, learning after each. Returns (train state, metrics)."""
        if training is not self._now:
            self._put(training)
        # SB3 adds the steps already done to the requested total
        self.model.learn(self.steps_per_iteration, reset_num_timesteps=False, log_interval=None)
        said = self.model.logger.name_to_value
        alpha = float(torch.exp(self.model.log_ent_coef.detach()))
        return self._taken(), {**self.shoal.metrics(), "alpha": alpha, "loss": float(said.get("train/critic_loss", 0.0))}

    def act(self, actor, obs):
        """Deterministic actions (B, J) for raw observations, in JAX."""
        return jnp.tanh(forward(actor, obs / jnp.asarray(self.scale, jnp.float32), self.config.activation))

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers of the actor, which is the mean of u."""
        return PolicyLayers(actor, self.config.activation)

    def _optimisers(self) -> dict[str, Any]:
        m = self.model
        return {"actor": m.actor.optimizer, "critic": m.critic.optimizer, "alpha": m.ent_coef_optimizer}

    def _taken(self) -> SB3TrainState:
        """State of the learner as NumPy arrays (copies)."""
        take = lambda t: t.detach().cpu().numpy().copy()
        m, actor = self.model, self.model.actor
        tensors = {f"policy.{k}": take(v) for k, v in m.policy.state_dict().items()}
        tensors["log_alpha"] = take(m.log_ent_coef)
        tensors["steps"] = np.array(m.num_timesteps, np.int32)
        for name, optimiser in self._optimisers().items():
            for i, p in enumerate(optimiser.param_groups[0]["params"]):  # Adam's moments; zero before the first step
                state = optimiser.state.get(p) or {"step": torch.zeros(()), "exp_avg": 0 * p, "exp_avg_sq": 0 * p}
                tensors |= {f"{name}.{i}.{k}": take(v) for k, v in state.items()}
        layers = [layer for layer in (*actor.latent_pi, actor.mu) if isinstance(layer, torch.nn.Linear)]
        self._now = SB3TrainState([(take(layer.weight).T, take(layer.bias)) for layer in layers], tensors)
        return self._now

    def _put(self, training: SB3TrainState) -> None:
        """Continues from these tensors, with an empty replay buffer and fresh episodes."""
        m = self.model
        tensor = {k: torch.tensor(np.asarray(v), device=m.device) for k, v in training.tensors.items()}
        m.policy.load_state_dict({k.removeprefix("policy."): v for k, v in tensor.items() if k.startswith("policy.")})
        m.log_ent_coef.data.copy_(tensor["log_alpha"])
        for name, optimiser in self._optimisers().items():
            table = optimiser.state_dict()
            keys = ("step", "exp_avg", "exp_avg_sq")
            count = len(optimiser.param_groups[0]["params"])
            table["state"] = {i: {k: tensor[f"{name}.{i}.{k}"] for k in keys} for i in range(count)}
            optimiser.load_state_dict(table)
        m.num_timesteps = int(tensor["steps"])
        m.set_random_seed(int(np.random.SeedSequence([self.seed, m.num_timesteps]).generate_state(1)[0]))
        m._last_obs = None  # new episodes
        m.replay_buffer.reset()


class RefillCallback(SAC):
    """SB3's SAC that learns only while its buffer holds `learning_starts` steps: a resumed one refills it first."""

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Trains as SB3's SAC, if the buffer holds enough steps."""
        if self.replay_buffer.size() * self.n_envs >= self.learning_starts:
            super().train(gradient_steps, batch_size)


class FiniteReplayBuffer(ReplayBuffer):
    """A replay buffer without dropped steps: the transition of a sound fish takes the place of one that diverged."""

    def add(self, obs, next_obs, action, reward, done, infos) -> None:
        """Adds transitions as SB3's ReplayBuffer, with those of diverged fish replaced."""
        bad = np.array([info.get("diverged", False) for info in infos])
        if bad.all():
            return
        rows = np.where(bad, np.argmin(bad), np.arange(len(bad)))
        super().add(obs[rows], next_obs[rows], action[rows], reward[rows], done[rows], [infos[i] for i in rows])
