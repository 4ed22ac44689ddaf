"""Proximal policy optimisation on one page. Schulman et al. 2017, arXiv 1707.06347; GAE: arXiv 1506.02438.

    L = -E min(rho A, clip(rho, 1 - eps, 1 + eps) A) + c_v E (V - R)^2 - c_e H
    A_t = sum_k (gamma lambda)^k delta_{t+k},   delta_t = r_t + gamma V(s'_t) - V(s_t)

The action is tanh(u) with u ~ N(mu(s), sigma); u is stored, so the ratio needs no correction for tanh. An episode that ends
because its time is up bootstraps from the observation before the restart; one that leaves the tank does not.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.errors import ConfigError
from fishmj.train.networks import check_config, forward, input_scale, mlp


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """Hyperparameters of PPO."""

    envs: int = 512
    horizon: int = 32
    epochs: int = 4
    minibatches: int = 8
    learning_rate: float = 1e-3
    final_rate: float = 0.1  # of learning_rate, reached at the end of `steps`, geometric
    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    entropy: float = 0.002
    max_grad_norm: float = 0.5
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    sigma: float = 0.5  # initial standard deviation of u
    privileged: bool = True  # the critic sees the flow; the actor never does
    reward_scale: float = 0.1

    def __post_init__(self):
        check_config("ppo", self, positive=("envs", "horizon", "epochs", "minibatches", "learning_rate", "final_rate", "sigma"))
        if self.envs * self.horizon % self.minibatches:
            raise ConfigError(
                f"ppo: envs x horizon = {self.envs * self.horizon} does not split into {self.minibatches} minibatches"
            )


class PPOTrainState(NamedTuple):
    """Everything that a run needs to go on."""

    actor: Any
    log_sigma: Any
    critic: Any
    optimiser: Any
    env: Any
    key: Any
    updates: Any


class Batch(NamedTuple):
    """One rollout, (T, B, ...)."""

    obs: Any
    seen: Any
    u: Any
    logp: Any
    value: Any
    advantage: Any
    target: Any


class PPO:
    """`init` makes a Training, `iterate` collects one rollout and learns from it."""

    name = "ppo"

    def __init__(self, env, config: PPOConfig, steps: int):
        self.env, self.config = env, config
        self.steps_per_iteration = config.envs * config.horizon
        iterations = max(1, steps // self.steps_per_iteration)
        updates = iterations * config.epochs * config.minibatches
        rate = optax.exponential_decay(config.learning_rate, updates, config.final_rate)
        self.optimiser = optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.adam(rate, eps=1e-5))
        self.scale = jnp.asarray(input_scale(env.n_act, env.options.memory), jnp.float32)
        self.seen_scale = jnp.concatenate([self.scale[: env.n_obs], jnp.asarray([0.3, 0.3, 1.0, 0.1, 0.1])])

    @partial(jax.jit, static_argnums=0)
    def init(self, key) -> PPOTrainState:
        k_actor, k_critic, k_env, key = jax.random.split(key, 4)
        c, env = self.config, self.env
        actor = mlp(k_actor, [env.n_input, *c.hidden, env.n_act])
        critic = mlp(k_critic, [env.n_input + c.privileged * env.n_privileged, *c.hidden, 1], last=1.0)
        log_sigma = jnp.full(env.n_act, np.log(c.sigma))
        optimiser = self.optimiser.init((actor, log_sigma, critic))
        return PPOTrainState(actor, log_sigma, critic, optimiser, env.reset(k_env, c.envs, True), key, jnp.int32(0))

    def value(self, critic, obs, seen):
        """V of scaled inputs; `seen` is what a privileged critic sees besides."""
        x = jnp.concatenate([obs, seen], -1) if self.config.privileged else obs
        return forward(critic, x, self.config.activation)[..., 0]

    def act(self, actor, obs):
        """Deterministic action for raw observations."""
        return jnp.tanh(forward(actor, obs / self.scale, self.config.activation))

    def collect(self, t: PPOTrainState):
        """Roll the policy out; returns the new env state, the batch and figures of the rollout."""
        c = self.config
        sigma = jnp.exp(t.log_sigma)

        def one(env_state, key):
            obs, seen = env_state.obs / self.scale, env_state.privileged / self.seen_scale
            mu = forward(t.actor, obs, c.activation)
            u = mu + sigma * jax.random.normal(key, mu.shape)
            after = self.env.step(env_state, jnp.tanh(u))
            ahead = self.value(t.critic, after.final_obs / self.scale, after.final_privileged / self.seen_scale)
            ahead = jnp.where(after.terminated, 0.0, ahead)
            done = after.terminated | after.truncated | after.diverged
            logp = gaussian(u, mu, t.log_sigma)
            value = self.value(t.critic, obs, seen)
            backup = c.reward_scale * after.reward + c.gamma * ahead
            backup = jnp.where(after.diverged, value, backup)  # no advantage: a dropped end teaches nothing
            late = (after.count > self.env.limit // 2) & ~done
            figures = (after.reward, after.distance, late, done, after.terminated, after.diverged)
            return after, (obs, seen, u, logp, value, backup, done, figures)

        keys = jax.random.split(jax.random.fold_in(t.key, t.updates), c.horizon)
        env_state, (obs, seen, u, logp, value, backup, done, figures) = jax.lax.scan(one, t.env, keys)

        def gae(carry, row):  # delta and decay from the last tick to the first; a restart cuts the sum
            delta, go_on = row
            carry = delta + c.gamma * c.lam * go_on * carry
            return carry, carry

        _, advantage = jax.lax.scan(gae, jnp.zeros(c.envs), (backup - value, 1.0 - done), reverse=True)
        return env_state, Batch(obs, seen, u, logp, value, advantage, advantage + value), figures

    def loss(self, weights, b: Batch):
        c = self.config
        actor, log_sigma, critic = weights
        logp = gaussian(b.u, forward(actor, b.obs, c.activation), log_sigma)
        ratio = jnp.exp(logp - b.logp)
        gain = (b.advantage - b.advantage.mean()) / (b.advantage.std() + 1e-6)
        surrogate = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - c.clip, 1 + c.clip) * gain).mean()
        error = jnp.square(self.value(critic, b.obs, b.seen) - b.target).mean()
        entropy = jnp.sum(log_sigma + 0.5 * np.log(2 * np.pi * np.e))
        return -surrogate + c.value_weight * error - c.entropy * entropy, ((ratio - 1) - jnp.log(ratio)).mean()

    @partial(jax.jit, static_argnums=0, donate_argnums=1)
    def iterate(self, t: PPOTrainState):
        """One rollout, `epochs` passes over it. Returns (Training, figures as scalars)."""
        c = self.config
        env_state, batch, (reward, distance, late, done, left, diverged) = self.collect(t)
        batch = jax.tree.map(lambda a: a.reshape((-1,) + a.shape[2:]), batch)
        size = self.steps_per_iteration // c.minibatches

        def minibatch(carry, rows):
            weights, optimiser = carry
            (loss, kl), grads = jax.value_and_grad(self.loss, has_aux=True)(weights, jax.tree.map(lambda a: a[rows], batch))
            change, optimiser = self.optimiser.update(grads, optimiser, weights)
            return (optax.apply_updates(weights, change), optimiser), (loss, kl)

        def epoch(carry, key):
            order = jax.random.permutation(key, self.steps_per_iteration)
            return jax.lax.scan(minibatch, carry, order.reshape(c.minibatches, size))

        keys = jax.random.split(jax.random.fold_in(t.key, t.updates + 1_000_000_000), c.epochs)
        start = ((t.actor, t.log_sigma, t.critic), t.optimiser)
        ((actor, log_sigma, critic), optimiser), (loss, kl) = jax.lax.scan(epoch, start, keys)
        figures = {
            "reward": reward.mean(),
            "late_distance": jnp.sum(distance * late) / jnp.maximum(late.sum(), 1),
            "late_arrived": jnp.sum((distance < 0.1) & late) / jnp.maximum(late.sum(), 1),
            "left_tank": left.sum() / jnp.maximum(done.sum(), 1),
            "episodes": done.sum(),
            "diverged": diverged.sum(),  # episodes dropped
            "sigma": jnp.exp(log_sigma).mean(),
            "kl": kl.mean(),
            "loss": loss.mean(),
        }
        return PPOTrainState(actor, log_sigma, critic, optimiser, env_state, t.key, t.updates + 1), figures


def gaussian(u, mu, log_sigma):
    """Log density of u under N(mu, exp(log_sigma)), summed over the action."""
    z = (u - mu) * jnp.exp(-log_sigma)
    return jnp.sum(-0.5 * z * z - log_sigma - 0.5 * np.log(2 * np.pi), -1)
