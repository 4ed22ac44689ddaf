"""Twin delayed DDPG, by the recipe of CONTRIBUTING.md. Fujimoto et al. 2018, arXiv 1802.09477.

y = r + gamma (1 - d) min_i Q'_i(s', clip(mu'(s') + clip(eps, -c, c), -1, 1)),   eps ~ N(0, target_noise)
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax

from fishmj.train.networks import forward, mlp
from fishmj.train.off_policy import OffPolicy, OffPolicyConfig


@dataclass(frozen=True, kw_only=True)
class TD3Config(OffPolicyConfig):
    """Hyperparameters; the paper's."""

    algo: ClassVar[str] = "td3"
    noise: float = 0.1
    target_noise: float = 0.2
    noise_clip: float = 0.5
    policy_delay: int = 2


class TD3Agent(NamedTuple):
    """Networks, their targets, the state of their optimisers."""

    actor: Any
    critics: Any
    target_actor: Any
    target_critics: Any
    opt_states: Any
    count: Any


class TD3(OffPolicy):
    """Deterministic policy, two critics, the actor updated every second step."""

    name = "td3"

    def init_agent(self, k_actor, k_critics):
        n_input, n_act, hidden = self.env.n_input, self.env.n_act, self.config.hidden
        actor = mlp(k_actor, [n_input, *hidden, n_act])
        critics = jax.vmap(lambda k: mlp(k, [n_input + n_act, *hidden, 1], last=1.0))(jax.random.split(k_critics))
        return TD3Agent(actor, critics, actor, critics, tuple(map(self.optimiser.init, (actor, critics))), jnp.int32(0))

    def explore(self, agent, obs, key):
        action = self.mu(agent.actor, obs)
        return jnp.clip(action + self.config.noise * jax.random.normal(key, action.shape), -1, 1)

    def mu(self, actor, obs):
        return jnp.tanh(forward(actor, obs, self.config.activation))

    def q(self, critics, obs, action):
        x = jnp.concatenate([obs, action], -1)
        return jax.vmap(lambda layers: forward(layers, x, self.config.activation)[..., 0])(critics)

    def update(self, replay, agent, key):
        c = self.config
        k_batch, k_noise = jax.random.split(key)
        b = replay.sample(k_batch, c.batch)
        noise = jnp.clip(c.target_noise * jax.random.normal(k_noise, b.action.shape), -c.noise_clip, c.noise_clip)
        next_action = jnp.clip(self.mu(agent.target_actor, b.next_obs) + noise, -1, 1)
        next_q = self.q(agent.target_critics, b.next_obs, next_action).min(0)
        y = c.reward_scale * b.reward + c.gamma * (1 - b.terminated) * next_q
        loss, grads = jax.value_and_grad(lambda p: jnp.square(self.q(p, b.obs, b.action) - y).sum(0).mean())(agent.critics)
        updates, opt_critics = self.optimiser.update(grads, agent.opt_states[1], agent.critics)
        critics = optax.apply_updates(agent.critics, updates)
        grads = jax.grad(lambda p: -self.q(critics, b.obs, self.mu(p, b.obs))[0].mean())(agent.actor)
        updates, opt_actor = self.optimiser.update(grads, agent.opt_states[0], agent.actor)
        new = (optax.apply_updates(agent.actor, updates), opt_actor)
        now = agent.count % c.policy_delay == 0
        actor, opt_actor = jax.tree.map(lambda a, b: jnp.where(now, a, b), new, (agent.actor, agent.opt_states[0]))
        targets = optax.incremental_update((actor, critics), (agent.target_actor, agent.target_critics), c.tau)
        return TD3Agent(actor, critics, *targets, (opt_actor, opt_critics), agent.count + 1), loss
