"""SAC and PPO of stable-baselines3 (extra `sb3`), with the same fish and the same policy file.

`StableLearner` gives SB3's learners fishmj's interface (`init`, `iterate`, `act`), so that `TrainingRun` runs them with progress
line, assessment, export, Ctrl-C and full-disk handling. SB3's own checkpoints are pickles; here a checkpoint holds only tensors:
networks, optimisers, temperature. It does NOT hold the fish: a resumed run begins new episodes, and differs from an uninterrupted
one. It does not hold SAC's replay buffer either: a resumed run first collects `warmup` steps without learning.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from fishmj.base import console
from fishmj.engines import fastest
from fishmj.tasks.gym.fish_env import FishVectorEnv, observation_space
from fishmj.tasks.station_hold import input_scale, visible
from fishmj.train.build import config_of, environment, robot_for
from fishmj.train.hyperparameters import PlainPPOConfig, SACConfig
from fishmj.train.learner import PolicyLayers, StepRecord, metrics_of, warn_of_rounding
from fishmj.train.networks import forward
from fishmj.train.settings import ALGORITHMS, Settings, change, referred
from fishmj.train.training_run import Assessment, TrainingRun

ENDS = {"return": "r", "length": "l"}  # keys of an ended episode in SB3's Monitor
UPDATES = 256  # approximate number of gradient steps between two reports
SATURATED = 10.0  # SB3 needs a finite bound on u; tanh(10) is 1 in float32, so this bound changes no action


class FishVecEnv(VecEnv):
    """n fish with the run's task, reward and engine (`auto`: the fastest on a CPU), with the policy's input as observation.

    Observations are scaled to order one (`station_hold.input_scale`), hidden groups are zero, and with memory m > 1 the newest is
    followed by m - 1 pairs (action, observation) back in time. At a time limit `TimeLimit.truncated` is set, so that SB3
    bootstraps from `terminal_observation`; if the fish leaves the tank it is not. `tally`: steps since the last `metrics`.
    """

    def __init__(self, settings: Settings, n: int, box: str = "train", reward_scale: float = 1.0):
        task, robot = dict(settings.task), robot_for(settings)
        self.robot, self.memory, self.hide = robot, task.pop("memory", 1), task.pop("hide", ())
        course = task.pop("course", "station_hold")
        options = {**task, **settings.reward, "robot": robot, "box": box}
        self.fish = FishVectorEnv(n, course, engine=engine_of(settings), autoreset_mode="SameStep", **options)
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
        """Sets the fish's seeds for the next reset: no two values of `seed` share one, unlike SB3's seed, seed + 1, ..."""
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
        """Policy input at the start of an episode: the memory is filled as if the fish had rested at the start pose."""
        sight = raw * self.factor
        pair = np.concatenate([np.zeros((self.num_envs, self.joints), np.float32), sight], 1)
        return np.concatenate([sight] + [pair] * (self.memory - 1), 1)

    def close(self) -> None:
        """Frees the environment."""
        self.fish.close()

    def get_attr(self, attr_name: str, indices=None) -> list:
        """Value of an attribute of the environment, repeated for each requested fish."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value, indices=None) -> None:
        """Sets an attribute of the environment; single fish have no attributes."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list:
        """Calls a method of the whole environment once."""
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """Returns False for each fish: single fish are no Gymnasium environments. `infos` has the episodes as SB3's Monitor."""
        return [False] * len(list(self._get_indices(indices)))


def engine_of(settings: Settings) -> str:
    """Name of the engine; `auto` is the fastest on a CPU, because the environment runs there whichever device learns."""
    return fastest() if settings.engine == "auto" else settings.engine


class SquashedVecEnv(VecEnvWrapper):
    """`FishVecEnv` with u as action: the fish get tanh(u), as a policy file does.

    SB3's PPO clips its Gaussian actions instead; a policy file of fishmj cannot express clipping.
    """

    def __init__(self, shoal: FishVecEnv):
        super().__init__(shoal, action_space=spaces.Box(-SATURATED, SATURATED, (shoal.joints,), np.float32))

    def reset(self) -> np.ndarray:
        """Starts all episodes."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Stores tanh of the actions (n, J) for `step_wait`."""
        self.venv.step_async(np.tanh(actions))

    def step_wait(self):
        """Does one control step of all fish, as FishVecEnv."""
        return self.venv.step_wait()


def train_sb3(settings: Settings, folder, *, resume: bool = False, quiet: bool = False, command: str | None = None) -> dict:
    """Trains with stable-baselines3; returns the summary of `TrainingRun`. Arguments and errors as there."""
    settings = change(settings, engine=engine_of(settings))
    config = config_of(settings)
    shoal = FishVecEnv(settings, config.envs, reward_scale=config.reward_scale)
    learner = referred(ALGORITHMS[settings.algo].learner)(shoal, config, settings.steps)
    warn_of_rounding(learner, settings.steps)
    judge = change(settings, engine="planar" if settings.engine == "batch" else settings.engine)  # an assessment runs inside JAX
    assess = Assessment(environment(judge, "tune"), learner.act, settings.assess_episodes)
    run = TrainingRun(settings, folder, resume=resume, quiet=quiet, learner=(shoal, learner, assess), command=command)
    if resume:
        console.warn(learner.on_resume)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # a second thread slows networks this small, up to ten times on a busy machine
    try:
        return run.go()
    finally:
        torch.set_num_threads(threads)


class SB3TrainState(NamedTuple):
    """State stored in a checkpoint."""

    actor: list  # (weights (in, out), bias) of the mean of u
    tensors: dict  # all tensors of SB3's learner, by name


class StableLearner(ABC):
    """Wraps a learner of SB3 as a `Learner`. Subclasses make the model, and list its tensors and metrics."""

    name: str
    steps_per_iteration: int
    on_resume = "checkpoints do not hold the fish: they begin new episodes"

    def __init__(self, shoal: FishVecEnv, config: Any, steps: int):
        self.shoal, self.config, self.steps = shoal, config, steps
        self.scale = input_scale(shoal.joints, shoal.memory)
        self._now: SB3TrainState | None = None

    def init(self, key) -> SB3TrainState:
        """Fresh learner; its seed is the key's."""
        c = self.config
        activation = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}[c.activation]
        network = {"net_arch": list(c.hidden), "activation_fn": activation}
        self.seed = int(jax.random.key_data(key)[-1])
        self.model = self._make(network, gamma=c.gamma, learning_rate=c.learning_rate, seed=self.seed)
        self.model.set_logger(Logger(folder=None, output_formats=[]))  # the default logger makes a folder for each `learn`
        return self._snapshot()

    def iterate(self, training: SB3TrainState) -> tuple[SB3TrainState, dict]:
        """Does one iteration of SB3's loop. Returns (train state, metrics)."""
        if training is not self._now:
            self._load_state(training)
        # SB3 adds the steps already done to the requested total
        self.model.learn(self.steps_per_iteration, reset_num_timesteps=False, log_interval=None)
        return self._snapshot(), {**self.shoal.metrics(), **self._figures(self.model.logger.name_to_value)}

    def act(self, actor, obs):
        """Deterministic actions (B, J) for raw observations, in JAX."""
        return jnp.tanh(forward(actor, obs / jnp.asarray(self.scale, jnp.float32), self.config.activation))

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers of the actor, which is the mean of u."""
        return PolicyLayers(actor, self.config.activation)

    @abstractmethod
    def _make(self, network: dict, **common) -> Any:
        """SB3's model with this network and these arguments."""

    @abstractmethod
    def _figures(self, said: dict) -> dict[str, float]:
        """Metrics of the algorithm, from SB3's log."""

    @abstractmethod
    def _actor(self) -> tuple:
        """Modules from the input to the mean of u."""

    @abstractmethod
    def _optimisers(self) -> dict[str, Any]:
        """Optimisers of the networks, by their name in a checkpoint."""

    def _extra_tensors(self) -> dict[str, Any]:
        """Tensors for a checkpoint that do not belong to `model.policy`."""
        return {}

    def _snapshot(self) -> SB3TrainState:
        """Copies the learner's state to NumPy arrays."""
        take = lambda t: t.detach().cpu().numpy().copy()
        m = self.model
        tensors = {f"policy.{k}": take(v) for k, v in m.policy.state_dict().items()}
        tensors |= {k: take(v) for k, v in self._extra_tensors().items()} | {"steps": np.array(m.num_timesteps, np.int32)}
        for name, optimiser in self._optimisers().items():
            for i, p in enumerate(optimiser.param_groups[0]["params"]):  # Adam's moments; zero before the first step
                state = optimiser.state.get(p) or {"step": torch.zeros(()), "exp_avg": 0 * p, "exp_avg_sq": 0 * p}
                tensors |= {f"{name}.{i}.{k}": take(v) for k, v in state.items()}
        layers = [layer for layer in self._actor() if isinstance(layer, torch.nn.Linear)]
        self._now = SB3TrainState([(take(layer.weight).T, take(layer.bias)) for layer in layers], tensors)
        return self._now

    def _load_state(self, training: SB3TrainState) -> None:
        """Loads these tensors into the learner and starts new episodes."""
        m = self.model
        tensor = {k: torch.tensor(np.asarray(v), device=m.device) for k, v in training.tensors.items()}
        m.policy.load_state_dict({k.removeprefix("policy."): v for k, v in tensor.items() if k.startswith("policy.")})
        for name, value in self._extra_tensors().items():
            value.data.copy_(tensor[name])
        for name, optimiser in self._optimisers().items():
            table = optimiser.state_dict()
            keys = ("step", "exp_avg", "exp_avg_sq")
            count = len(optimiser.param_groups[0]["params"])
            table["state"] = {i: {k: tensor[f"{name}.{i}.{k}"] for k in keys} for i in range(count)}
            optimiser.load_state_dict(table)
        m.num_timesteps = int(tensor["steps"])
        m.set_random_seed(int(np.random.SeedSequence([self.seed, m.num_timesteps]).generate_state(1)[0]))
        m._last_obs = None  # new episodes


class StablePPO(StableLearner):
    """SB3's PPO; its critic sees what the policy sees."""

    name = "sb3-ppo"

    def __init__(self, shoal: FishVecEnv, config: PlainPPOConfig, steps: int):
        super().__init__(shoal, config, steps)
        self.steps_per_iteration = config.envs * config.horizon

    def _make(self, network: dict, **common) -> PPO:
        c = self.config
        network |= {"log_std_init": float(np.log(c.sigma)), "optimizer_kwargs": {"eps": c.adam_eps}}
        model = PPO(
            "MlpPolicy",
            SquashedVecEnv(self.shoal),
            n_steps=c.horizon,
            batch_size=self.steps_per_iteration // c.minibatches,
            n_epochs=c.epochs,
            gae_lambda=c.lam,
            clip_range=c.clip,
            vf_coef=c.value_weight,
            ent_coef=c.entropy,
            max_grad_norm=c.max_grad_norm,
            rollout_buffer_class=FiniteRolloutBuffer,
            rollout_buffer_kwargs={"shoal": self.shoal},
            policy_kwargs=network,
            device="cpu",  # SB3 recommends it: a GPU is slower with networks this small
            **common,
        )
        # SB3's schedule covers one `learn`, which here is a single iteration
        model.lr_schedule = lambda _: c.learning_rate * c.final_rate ** min(1.0, model.num_timesteps / self.steps)
        return model

    def _figures(self, said: dict) -> dict[str, float]:
        return {
            name: float(said[f"train/{theirs}"]) for name, theirs in (("sigma", "std"), ("kl", "approx_kl"), ("loss", "loss"))
        }

    def _actor(self) -> tuple:
        return *self.model.policy.mlp_extractor.policy_net, self.model.policy.action_net

    def _optimisers(self) -> dict[str, Any]:
        return {"adam": self.model.policy.optimizer}


class StableSAC(StableLearner):
    """SB3's SAC, with the paper's networks."""

    name = "sb3-sac"

    def __init__(self, shoal: FishVecEnv, config: SACConfig, steps: int):
        super().__init__(shoal, config, steps)
        self.per_step = max(1, round(config.utd * config.envs))
        self.steps_per_iteration = config.envs * max(1, min(config.block, UPDATES // self.per_step))
        self.on_resume = f"checkpoints do not hold the replay buffer: the policy refills it by {config.warmup:,} steps first"

    def _make(self, network: dict, **common) -> SAC:
        c, capacity = self.config, max(self.config.envs, min(self.config.buffer, self.steps))
        return RefillCallback(
            "MlpPolicy",
            self.shoal,
            buffer_size=capacity,
            learning_starts=min(c.warmup, capacity),
            batch_size=c.batch,
            tau=c.tau,
            gradient_steps=self.per_step,
            replay_buffer_class=FiniteReplayBuffer,
            ent_coef=f"auto_{c.initial_alpha!r}",
            target_entropy=c.target_entropy * self.shoal.joints,
            policy_kwargs=network,
            **common,
        )

    def _figures(self, said: dict) -> dict[str, float]:
        return {"alpha": float(torch.exp(self.model.log_ent_coef.detach())), "loss": float(said.get("train/critic_loss", 0.0))}

    def _actor(self) -> tuple:
        return *self.model.actor.latent_pi, self.model.actor.mu

    def _optimisers(self) -> dict[str, Any]:
        m = self.model
        return {"actor": m.actor.optimizer, "critic": m.critic.optimizer, "alpha": m.ent_coef_optimizer}

    def _extra_tensors(self) -> dict[str, Any]:
        return {"log_alpha": self.model.log_ent_coef}

    def _load_state(self, training: SB3TrainState) -> None:
        super()._load_state(training)
        self.model.replay_buffer.reset()


class RefillCallback(SAC):
    """SB3's SAC that learns only if its buffer holds `learning_starts` steps: a resumed run refills it first."""

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Trains as SB3's SAC, if the buffer holds enough steps."""
        if self.replay_buffer.size() * self.n_envs >= self.learning_starts:
            super().train(gradient_steps, batch_size)


class FiniteReplayBuffer(ReplayBuffer):
    """Replay buffer that replaces the transition of a fish that diverged by that of a sound fish."""

    def add(self, obs, next_obs, action, reward, done, infos) -> None:
        """Adds transitions as SB3's ReplayBuffer does, with those of diverged fish replaced."""
        bad = np.array([info.get("diverged", False) for info in infos])
        if bad.all():
            return
        rows = np.where(bad, np.argmin(bad), np.arange(len(bad)))
        super().add(obs[rows], next_obs[rows], action[rows], reward[rows], done[rows], [infos[i] for i in rows])


class FiniteRolloutBuffer(RolloutBuffer):
    """Rollout buffer that ignores steps of fish that diverged: their return is their value, their advantage 0."""

    def __init__(self, *args, shoal: FishVecEnv, **options):
        super().__init__(*args, **options)
        self.shoal = shoal

    def add(self, obs, action, reward, episode_start, value, log_prob) -> None:
        """Adds transitions as SB3's RolloutBuffer."""
        reward = np.where(self.shoal.tally[-1].diverged, value.numpy().flatten(), reward)
        super().add(obs, action, reward, episode_start, value, log_prob)
