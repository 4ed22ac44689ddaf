"""Soft actor-critic on one page. Haarnoja et al. 2018, arXiv 1812.05905; the paper's algorithm.

    y = r + gamma (1 - d) [min_i Q'_i(s', a') - alpha log pi(a'|s')],   a' ~ pi(.|s')
    L_Q = sum_i (Q_i(s, a) - y)^2,   L_pi = alpha log pi(a|s) - min_i Q_i(s, a),   L_alpha = -alpha (log pi + H_target)

d = 1 only where the fish left the tank: the end of an episode's time is no end (Pardo et al. 2018, arXiv 1712.00378).
Actor 11-256-256-3, critics 14-256-256-1, ReLU. One environment step brings `utd` gradient steps a fish (the paper: 1).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.calib import constant
from fishmj.train.networks import check_config, forward, input_scale, mlp


@dataclass(frozen=True, kw_only=True)
class SACConfig:
    """Hyperparameters of SAC; defaults from the paper and, where it is silent, from Haarnoja et al."""

    envs: int = 64
    utd: float = 1.0  # gradient steps for each control step of one fish
    block: int = 16  # environment steps between two reports
    batch: int = 256
    buffer: int = 1_000_000
    warmup: int = 5_000  # control steps of random actions
    learning_rate: float = 3e-4
    gamma: float = 0.99
    tau: float = 0.005
    hidden: tuple[int, ...] = (256, 256)
    activation: str = "relu"
    reward_scale: float = 1.0

    def __post_init__(self):
        check_config("sac", self, positive=("envs", "utd", "block", "batch", "buffer", "learning_rate", "tau"))


class ReplayBuffer(NamedTuple):
    """Ring buffer of transitions."""

    obs: Any
    action: Any
    reward: Any
    ahead: Any  # next observation
    ended: Any  # 1 where the fish left the tank
    size: Any
    head: Any


class SACTrainState(NamedTuple):
    """Everything that a run needs to go on."""

    actor: Any
    critics: Any  # two sets of layers, stacked
    targets: Any
    log_alpha: Any
    optimisers: Any
    memory: ReplayBuffer
    env: Any
    key: Any
    updates: Any


class SAC:
    """`init` makes a Training, `iterate` takes `block` environment steps and learns after each."""

    name = "sac"

    def __init__(self, env, config: SACConfig, steps: int):
        self.env, self.config = env, config
        self.steps_per_iteration = config.envs * config.block
        self.per_step = max(1, round(config.utd * config.envs))
        self.capacity = max(config.envs, min(config.buffer, steps) // config.envs * config.envs)
        self.optimiser = optax.adam(config.learning_rate)
        self.scale = jnp.asarray(input_scale(env.n_act, env.options.memory), jnp.float32)
        self.entropy_target = -float(env.n_act)

    @partial(jax.jit, static_argnums=0)
    def init(self, key) -> SACTrainState:
        keys = jax.random.split(key, 5)
        c, env = self.config, self.env
        actor = mlp(keys[0], [env.n_input, *c.hidden, 2 * env.n_act])
        critics = jax.vmap(lambda k: mlp(k, [env.n_input + env.n_act, *c.hidden, 1], last=1.0))(jax.random.split(keys[1]))
        log_alpha = jnp.float32(np.log(0.2))
        n, rows = env.n_input, self.capacity
        memory = ReplayBuffer(
            jnp.zeros((rows, n)), jnp.zeros((rows, env.n_act)), jnp.zeros(rows), jnp.zeros((rows, n)), jnp.zeros(rows),
            jnp.int32(0), jnp.int32(0),
        )  # fmt: skip
        optimisers = tuple(self.optimiser.init(p) for p in (actor, critics, log_alpha))
        start = env.reset(keys[2], c.envs, True)
        return SACTrainState(actor, critics, critics, log_alpha, optimisers, memory, start, keys[3], jnp.int32(0))

    def act(self, actor, obs):
        """Deterministic action for raw observations."""
        return jnp.tanh(forward(actor, obs / self.scale, self.config.activation)[..., : self.env.n_act])

    def sample(self, actor, obs, key):
        """Random action for scaled observations and its log density."""
        mu, log_sigma = jnp.split(forward(actor, obs, self.config.activation), 2, -1)
        log_sigma = jnp.clip(log_sigma, -10.0, 2.0)
        noise = jax.random.normal(key, mu.shape)
        u = mu + jnp.exp(log_sigma) * noise
        logp = -0.5 * noise**2 - log_sigma - 0.5 * np.log(2 * np.pi) - 2 * (np.log(2) - u - jax.nn.softplus(-2 * u))
        return jnp.tanh(u), logp.sum(-1)

    def q(self, critics, obs, action):
        """Both critics, (2, B)."""
        x = jnp.concatenate([obs, action], -1)
        return jax.vmap(lambda layers: forward(layers, x, self.config.activation)[..., 0])(critics)

    def store(self, m: ReplayBuffer, obs, action, reward, ahead, ended) -> ReplayBuffer:
        """Append one transition a fish."""
        put = lambda a, rows: jax.lax.dynamic_update_slice_in_dim(a, rows, m.head, 0)
        n, size = self.config.envs, self.capacity
        filled = (put(m.obs, obs), put(m.action, action), put(m.reward, reward), put(m.ahead, ahead), put(m.ended, ended))
        return ReplayBuffer(*filled, jnp.minimum(m.size + n, size), (m.head + n) % size)

    def learn(self, m: ReplayBuffer, carry, key):
        """One gradient step on critics, actor and temperature."""
        actor, critics, targets, log_alpha, (opt_actor, opt_critic, opt_alpha) = carry
        c = self.config
        k_rows, k_next, k_now = jax.random.split(key, 3)
        rows = jax.random.randint(k_rows, (c.batch,), 0, m.size)
        obs, action, reward, ahead, ended = (a[rows] for a in m[:5])
        alpha = jnp.exp(log_alpha)
        then, logp = self.sample(actor, ahead, k_next)
        y = c.reward_scale * reward + c.gamma * (1 - ended) * (self.q(targets, ahead, then).min(0) - alpha * logp)

        def critic_loss(p):
            return jnp.square(self.q(p, obs, action) - y).sum(0).mean()

        def actor_loss(p):
            now, logp = self.sample(p, obs, k_now)
            return (alpha * logp - self.q(critics, obs, now).min(0)).mean(), logp.mean()

        critic_value, slope = jax.value_and_grad(critic_loss)(critics)
        change, opt_critic = self.optimiser.update(slope, opt_critic, critics)
        critics = optax.apply_updates(critics, change)
        (_, logp), slope = jax.value_and_grad(actor_loss, has_aux=True)(actor)
        change, opt_actor = self.optimiser.update(slope, opt_actor, actor)
        actor = optax.apply_updates(actor, change)
        slope = -jnp.exp(log_alpha) * (logp + self.entropy_target)  # d L_alpha / d log alpha
        change, opt_alpha = self.optimiser.update(slope, opt_alpha, log_alpha)
        log_alpha = optax.apply_updates(log_alpha, change)
        targets = optax.incremental_update(critics, targets, c.tau)
        return (actor, critics, targets, log_alpha, (opt_actor, opt_critic, opt_alpha)), critic_value

    @partial(jax.jit, static_argnums=0, donate_argnums=1)
    def iterate(self, t: SACTrainState):
        """`block` environment steps, learning after each. Returns (Training, figures as scalars)."""

        def one(t: SACTrainState, _):
            key = jax.random.fold_in(t.key, t.updates)
            k_act, k_free, k_learn = jax.random.split(key, 3)
            obs = t.env.obs / self.scale
            free = jax.random.uniform(k_free, (self.config.envs, self.env.n_act), minval=-1.0)
            warm = t.memory.size < min(self.config.warmup, self.capacity)
            action = jnp.where(warm, free, self.sample(t.actor, obs, k_act)[0])
            env = self.env.step(t.env, action)
            # a dropped step is not remembered: the transition of a sound fish takes its place
            rows = jnp.where(env.diverged, jnp.argmin(env.diverged), jnp.arange(self.config.envs))
            seen = (obs, action, env.reward, env.final_obs / self.scale, env.terminated.astype(jnp.float32))
            m = self.store(t.memory, *(a[rows] for a in seen))
            carry = (t.actor, t.critics, t.targets, t.log_alpha, t.optimisers)  # without m: a branch would copy it
            keys = jax.random.split(k_learn, self.per_step)
            learn = lambda carry: jax.lax.scan(partial(self.learn, m), carry, keys)
            wait = lambda carry: (carry, jnp.zeros(self.per_step))
            (actor, critics, targets, log_alpha, optimisers), loss = jax.lax.cond(warm, wait, learn, carry)
            done = env.terminated | env.truncated | env.diverged
            late = (env.count > self.env.limit // 2) & ~done
            figures = (env.reward, env.distance, late, done, env.terminated, env.diverged, loss.mean())
            return SACTrainState(actor, critics, targets, log_alpha, optimisers, m, env, t.key, t.updates + 1), figures

        t, (reward, distance, late, done, left, diverged, loss) = jax.lax.scan(one, t, None, self.config.block)
        return t, {
            "reward": reward.mean(),
            "late_distance": jnp.sum(distance * late) / jnp.maximum(late.sum(), 1),
            "late_arrived": jnp.sum((distance < 0.1) & late) / jnp.maximum(late.sum(), 1),
            "left_tank": left.sum() / jnp.maximum(done.sum(), 1),
            "episodes": done.sum(),
            "diverged": diverged.sum(),  # episodes dropped
            "alpha": jnp.exp(t.log_alpha),
            "loss": loss.mean(),
        }


def paper_config() -> SACConfig:
    """The paper's networks and budget; its silent hyperparameters are the algorithm's published defaults."""
    get = lambda key: constant("training", key)
    return SACConfig(
        hidden=tuple(get("actor")),
        batch=get("batch"),
        buffer=get("buffer"),
        learning_rate=get("learning_rate"),
        tau=get("tau"),
        gamma=get("gamma"),
    )
