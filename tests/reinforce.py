"""REINFORCE, an on-policy algorithm by the recipe of CONTRIBUTING.md. Williams 1992, doi 10.1007/BF00992696.

grad J = E [A grad log pi(u|s)], A the reward to go of the rollout less its mean over the fish; the action is tanh(u).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax

from fishmj.base.options import number, whole
from fishmj.train.hyperparameters import Hyperparameters, setting
from fishmj.train.learner import EpisodeTally, PolicyLayers, episode_metrics, metrics_of, record_of
from fishmj.train.networks import forward, mlp
from fishmj.train.ppo import gaussian


@dataclass(frozen=True, kw_only=True)
class ReinforceConfig(Hyperparameters):
    """Hyperparameters."""

    algo: ClassVar[str] = "reinforce"
    rollout: int = setting(10, whole(1, 1000), "control steps of each fish between two updates")
    spread: float = setting(0.5, number(0, 10, above=True), "standard deviation of u")


class ReinforceState(NamedTuple):
    """What a checkpoint keeps."""

    actor: Any
    opt_state: Any
    env_state: Any
    key: Any
    iteration: Any
    tally: Any


class Reinforce:
    """A `learner.Learner`: one gradient step a rollout."""

    name = "reinforce"

    def __init__(self, env, config: ReinforceConfig, steps: int):
        self.env, self.config = env, config
        self.steps_per_iteration = config.envs * config.rollout
        self.optimiser = optax.adam(config.learning_rate)
        self.obs_scale = jnp.asarray(env.input_scale)

    @partial(jax.jit, static_argnums=0)
    def init(self, key) -> ReinforceState:
        k_actor, k_env, key = jax.random.split(key, 3)
        actor = mlp(k_actor, [self.env.n_input, *self.config.hidden, self.env.n_act])
        state, tally = self.env.reset(k_env, self.config.envs, True), EpisodeTally.start(jnp, self.config.envs)
        return ReinforceState(actor, self.optimiser.init(actor), state, key, jnp.int32(0), tally)

    def mean(self, actor, obs):
        return forward(actor, obs / self.obs_scale, self.config.activation)

    def act(self, actor, obs):
        return jnp.tanh(self.mean(actor, obs))

    def policy_layers(self, actor) -> PolicyLayers:
        return PolicyLayers(actor, self.config.activation)

    @partial(jax.jit, static_argnums=0)
    def iterate(self, state: ReinforceState):
        c = self.config

        def step(env_state, key):
            mean = self.mean(state.actor, env_state.obs)
            u = mean + c.spread * jax.random.normal(key, mean.shape)
            after = self.env.step(env_state, jnp.tanh(u))
            return after, (env_state.obs, u, record_of(after, self.env.limit))

        keys = jax.random.split(jax.random.fold_in(state.key, state.iteration), c.rollout)
        env_state, (obs, u, record) = jax.lax.scan(step, state.env_state, keys)

        def to_go(total, row):
            total = row[0] + c.gamma * (1 - row[1]) * total
            return total, total

        _, returns = jax.lax.scan(to_go, jnp.zeros(c.envs), (c.reward_scale * record.reward, 1.0 * record.done), reverse=True)
        advantages = jnp.where(record.diverged, 0.0, returns - returns.mean(1, keepdims=True))
        log_pi = lambda actor: gaussian(u, self.mean(actor, obs), jnp.log(c.spread))
        loss, grads = jax.value_and_grad(lambda actor: -(advantages * log_pi(actor)).mean())(state.actor)
        updates, opt_state = self.optimiser.update(grads, state.opt_state)
        actor, (tally, ended) = optax.apply_updates(state.actor, updates), episode_metrics(state.tally, record)
        state = ReinforceState(actor, opt_state, env_state, state.key, state.iteration + 1, tally)
        return state, {**metrics_of(jnp, record), **ended, "loss": loss}
