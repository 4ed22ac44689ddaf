"""Soft actor-critic on one page. Haarnoja et al. 2018, arXiv 1812.05905; the paper's algorithm.

    y = r + gamma (1 - d) [min_i Q'_i(s', a') - alpha log pi(a'|s')],   a' ~ pi(.|s')
    L_Q = sum_i (Q_i(s, a) - y)^2,   L_pi = alpha log pi(a|s) - min_i Q_i(s, a),   L_alpha = -alpha (log pi + H_target)

d = 1 only if the fish left the tank: a time limit is not an end (Pardo et al. 2018, arXiv 1712.00378).
Actor 11-256-256-3, critics 14-256-256-1, ReLU. Buffer and loop are those of off_policy.py.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.train.hyperparameters import SACConfig
from fishmj.train.learner import PolicyLayers
from fishmj.train.networks import forward, mlp
from fishmj.train.off_policy import OffPolicy, ReplayBuffer

LOG_SIGMA = (-10.0, 2.0)  # bounds of the actor's log sigma


class SACAgent(NamedTuple):
    """Networks, temperature and the state of their optimisers."""

    actor: Any
    critics: Any  # two sets of layers, stacked
    target_critics: Any
    log_alpha: Any
    opt_states: Any  # of actor, critics, temperature


class SAC(OffPolicy):
    """SAC as a `learner.Learner`."""

    name = "sac"
    config: SACConfig

    def init_agent(self, k_actor, k_critics) -> SACAgent:
        """Fresh networks, temperature and optimisers."""
        n_input, n_act, hidden = self.env.n_input, self.env.n_act, self.config.hidden
        actor = mlp(k_actor, [n_input, *hidden, 2 * n_act])  # mean and log sigma of u
        critics = jax.vmap(lambda k: mlp(k, [n_input + n_act, *hidden, 1], last=1.0))(jax.random.split(k_critics))
        log_alpha = jnp.float32(np.log(self.config.initial_alpha))
        opt_states = tuple(self.optimiser.init(p) for p in (actor, critics, log_alpha))
        return SACAgent(actor, critics, critics, log_alpha, opt_states)

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers of the mean of u: the last layer without its half for log sigma."""
        n_act = self.env.n_act
        w, b = actor[-1]
        return PolicyLayers([*actor[:-1], (w[:, :n_act], b[:n_act])], self.config.activation)

    def explore(self, agent: SACAgent, obs, key):
        """Random actions (B, J) of the policy."""
        return self.sample(agent.actor, obs, key)[0]

    def sample(self, actor, obs, key):
        """Random actions for scaled observations, and their log density."""
        mu, log_sigma = jnp.split(forward(actor, obs, self.config.activation), 2, -1)
        log_sigma = jnp.clip(log_sigma, *LOG_SIGMA)
        noise = jax.random.normal(key, mu.shape)
        u = mu + jnp.exp(log_sigma) * noise
        # log N(u) - log(1 - tanh(u)^2), the latter written so that it stays finite if tanh(u) rounds to 1
        log_prob = -0.5 * noise**2 - log_sigma - 0.5 * np.log(2 * np.pi) - 2 * (np.log(2) - u - jax.nn.softplus(-2 * u))
        return jnp.tanh(u), log_prob.sum(-1)

    def q(self, critics, obs, action):
        """Values of both critics, (2, B)."""
        x = jnp.concatenate([obs, action], -1)
        return jax.vmap(lambda layers: forward(layers, x, self.config.activation)[..., 0])(critics)

    def update(self, replay: ReplayBuffer, agent: SACAgent, key):
        """Does one gradient step on critics, actor and temperature, in this order. Returns (agent, critics' loss)."""
        c = self.config
        k_batch, k_next, k_now = jax.random.split(key, 3)
        b = replay.sample(k_batch, c.batch)
        alpha = jnp.exp(agent.log_alpha)
        opt_actor, opt_critics, opt_alpha = agent.opt_states

        # minimum of the two target critics: it reduces the overestimation of bootstrapped values
        next_action, next_log_prob = self.sample(agent.actor, b.next_obs, k_next)
        next_q = self.q(agent.target_critics, b.next_obs, next_action).min(0)
        y = c.reward_scale * b.reward + c.gamma * (1 - b.terminated) * (next_q - alpha * next_log_prob)

        def critic_loss(critics):
            return jnp.square(self.q(critics, b.obs, b.action) - y).sum(0).mean()

        critics_loss, grads = jax.value_and_grad(critic_loss)(agent.critics)
        updates, opt_critics = self.optimiser.update(grads, opt_critics, agent.critics)
        critics = optax.apply_updates(agent.critics, updates)

        def actor_loss(actor):
            # new actions, not the buffer's: the gradient passes through the sample to the actor (reparameterisation)
            action, log_prob = self.sample(actor, b.obs, k_now)
            return (alpha * log_prob - self.q(critics, b.obs, action).min(0)).mean(), log_prob.mean()

        (_, log_prob), grads = jax.value_and_grad(actor_loss, has_aux=True)(agent.actor)
        updates, opt_actor = self.optimiser.update(grads, opt_actor, agent.actor)
        actor = optax.apply_updates(agent.actor, updates)

        # d L_alpha / d log alpha, by hand
        grads = -jnp.exp(agent.log_alpha) * (log_prob + c.target_entropy * self.env.n_act)
        updates, opt_alpha = self.optimiser.update(grads, opt_alpha, agent.log_alpha)
        log_alpha = optax.apply_updates(agent.log_alpha, updates)
        target_critics = optax.incremental_update(critics, agent.target_critics, c.tau)
        return SACAgent(actor, critics, target_critics, log_alpha, (opt_actor, opt_critics, opt_alpha)), critics_loss

    def diagnostics(self, agent: SACAgent) -> dict:
        """Temperature as a metric."""
        return {"alpha": jnp.exp(agent.log_alpha)}
