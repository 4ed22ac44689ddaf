"""Proximal policy optimisation on one page. Schulman et al. 2017, arXiv 1707.06347; GAE: arXiv 1506.02438.

    L = -E min(rho A, clip(rho, 1 - eps, 1 + eps) A) + c_v E (V - R)^2 - c_e H + c_m E |mu(s) + mu(S s)|^2
    A_t = sum_k (gamma lambda)^k delta_{t+k},   delta_t = r_t + gamma V(s'_t) - V(s_t),   R_t = A_t + V(s_t)

The action is tanh(u) with u ~ N(mu(s), sigma); u is stored, so the ratio needs no correction for tanh. At a time limit the value
is bootstrapped from the observation before the reset; if the fish leaves the tank it is not. The last term is a symmetry loss:
in the mirrored state S s the action should be -mu(s) (Yu et al. 2018, arXiv 1801.08093).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.tasks.env import layout_of
from fishmj.train.hyperparameters import PPOConfig
from fishmj.train.learner import EpisodeTally, PolicyLayers, episode_metrics, metrics_of, record_of
from fishmj.train.networks import forward, mlp
from fishmj.train.sharding import COLUMNS, EACH, ROWS, Shards

FAR = 80.0  # bound on the log ratio: without it, one fish far outside its tank makes exp or log infinite and ends the run
SHUFFLE = 1_000_000_000  # added to the iteration's number, so that minibatches and exploration use different keys


class PPOTrainState(NamedTuple):
    """Complete state of a run."""

    actor: Any
    log_sigma: Any
    critic: Any
    opt_state: Any
    env_state: Any
    key: Any
    iteration: Any
    tally: Any  # EpisodeTally


class Batch(NamedTuple):
    """One rollout, (T, B, ...)."""

    obs: Any
    privileged_obs: Any
    u: Any
    log_prob: Any
    value: Any
    advantages: Any
    returns: Any


class PPO:
    """PPO as a `learner.Learner`: `iterate` collects one rollout and updates the networks `epochs` times over it.

    devices: number of devices that share the fish; it must divide their number (`build.check_devices`).
    moves: False trains the critic only.
    """

    name = "ppo"

    def __init__(self, env, config: PPOConfig, steps: int, devices: int = 1, moves: bool = True):
        self.env, self.config, self.devices, self.shards, self.moves = env, config, devices, Shards(devices), moves
        self.steps_per_iteration = config.envs * config.horizon
        iterations = max(1, steps // self.steps_per_iteration)
        updates = iterations * config.epochs * config.minibatches
        rate = optax.exponential_decay(config.learning_rate, updates, config.final_rate)
        self.optimiser = optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.adam(rate, eps=config.adam_eps))
        self.obs_scale = jnp.asarray(env.input_scale)
        self.privileged_scale = jnp.asarray(env.privileged_scale)
        self.mirror_signs = jnp.asarray(env.mirror_signs) if config.mirror else None

    @partial(jax.jit, static_argnums=0)
    def init(self, key) -> PPOTrainState:
        """Fresh train state: networks, optimiser, environments at random times of their episodes."""
        k_actor, k_critic, k_env, key = jax.random.split(key, 4)
        c, env = self.config, self.env
        actor = mlp(k_actor, [env.n_input, *c.hidden, env.n_act])
        critic = mlp(k_critic, [env.n_input + c.privileged * env.n_privileged, *c.hidden, 1], last=1.0)
        log_sigma = jnp.full(env.n_act, np.log(c.sigma))
        opt_state, tally = self.optimiser.init((actor, log_sigma, critic)), EpisodeTally.start(jnp, c.envs)
        return PPOTrainState(actor, log_sigma, critic, opt_state, env.reset(k_env, c.envs, True), key, jnp.int32(0), tally)

    def act(self, actor, obs):
        """Deterministic actions (B, J) for raw observations."""
        return jnp.tanh(forward(actor, obs / self.obs_scale, self.config.activation))

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers of the actor, whose output is the mean of u."""
        return PolicyLayers(actor, self.config.activation)

    def value(self, critic, obs, privileged_obs):
        """Value V of scaled inputs; a plain critic does not use `privileged_obs`."""
        x = jnp.concatenate([obs, privileged_obs], -1) if self.config.privileged else obs
        return forward(critic, x, self.config.activation)[..., 0]

    @partial(jax.jit, static_argnums=0, donate_argnums=1)
    def iterate(self, state: PPOTrainState):
        """Collects a rollout and updates on it. Returns (train state, metrics as scalars)."""
        learn = self.learn if self.devices == 1 else self.learn_on_each
        env_state, (actor, log_sigma, critic), opt_state, record, (loss, kl) = learn(state)
        tally, ended = episode_metrics(state.tally, record)
        state = PPOTrainState(actor, log_sigma, critic, opt_state, env_state, state.key, state.iteration + 1, tally)
        return self.place(state), {
            **metrics_of(jnp, record),
            **ended,
            "sigma": jnp.exp(log_sigma).mean(),
            "kl": kl.mean(),
            "loss": loss.mean(),
        }

    def layout(self, state: PPOTrainState) -> PPOTrainState:
        """Layout of a train state on the devices: fish and their tallies split, all else whole on each."""
        whole = jax.tree.map(lambda _: EACH, state)
        return whole._replace(env_state=layout_of(state.env_state, ROWS, EACH), tally=jax.tree.map(lambda _: ROWS, state.tally))

    def place(self, state: PPOTrainState) -> PPOTrainState:
        """Train state on the devices of this learner."""
        return state if self.devices == 1 else self.shards.place(state, self.layout(state))

    def learn_on_each(self, state: PPOTrainState):
        """`learn` on each device with its share of the fish and random keys of its own."""
        key, layout, own = state.env_state.key, self.layout(state), self.shards.own

        def work(state):
            return self.learn(state._replace(key=own(state.key), env_state=state.env_state._replace(key=own(key))))

        returned = (layout.env_state, EACH, EACH, COLUMNS, EACH)
        env_state, *learnt = self.shards.split(work, layout, returned)(state)
        return env_state._replace(key=jax.random.fold_in(key, self.devices)), *learnt  # a key that no device drew from

    def learn(self, state: PPOTrainState):
        """Collects and updates. Returns (environment's state, networks, optimiser's state, StepRecord, (losses, KL))."""
        env_state, batch, record = self.collect(state)
        networks, opt_state, diagnostics = self.update(state, batch)
        return env_state, networks, opt_state, record, self.shards.mean(diagnostics)

    def collect(self, state: PPOTrainState):
        """Rolls the policy out for `horizon` steps. Returns (environment's state, Batch, StepRecord)."""
        c = self.config
        sigma = jnp.exp(state.log_sigma)

        def step(env_state, key):
            obs, privileged_obs = env_state.obs / self.obs_scale, env_state.privileged / self.privileged_scale
            mu = forward(state.actor, obs, c.activation)
            u = mu + sigma * jax.random.normal(key, mu.shape)
            after = self.env.step(env_state, jnp.tanh(u))
            # the environment has already reset ended episodes: V(s') needs the observation before the reset
            next_obs, next_privileged_obs = after.final_obs / self.obs_scale, after.final_privileged / self.privileged_scale
            next_value = self.value(state.critic, next_obs, next_privileged_obs)
            # only leaving the tank terminates the task; a time limit does not (arXiv 1712.00378)
            next_value = jnp.where(after.terminated, 0.0, next_value)
            log_prob = gaussian(u, mu, state.log_sigma)
            value = self.value(state.critic, obs, privileged_obs)
            td_target = c.reward_scale * after.reward + c.gamma * next_value
            td_target = jnp.where(after.diverged, value, td_target)  # delta = 0: a diverged step is ignored
            return after, (obs, privileged_obs, u, log_prob, value, td_target, record_of(after, self.env.limit))

        keys = jax.random.split(jax.random.fold_in(state.key, state.iteration), c.horizon)
        env_state, (obs, privileged_obs, u, log_prob, value, td_target, record) = jax.lax.scan(step, state.env_state, keys)

        def gae(advantage, row):  # backwards in time; the sum stops at the end of an episode
            delta, goes_on = row
            advantage = delta + c.gamma * c.lam * goes_on * advantage
            return advantage, advantage

        deltas = (td_target - value, 1.0 - record.done)
        _, advantages = jax.lax.scan(gae, jnp.zeros(value.shape[1]), deltas, reverse=True)
        return env_state, Batch(obs, privileged_obs, u, log_prob, value, advantages, advantages + value), record

    def loss(self, networks, b: Batch):
        """Loss, and KL divergence from the policy that collected the batch."""
        c = self.config
        actor, log_sigma, critic = networks
        mu = forward(actor, b.obs, c.activation)
        log_prob = gaussian(b.u, mu, log_sigma)
        log_ratio = jnp.clip(log_prob - b.log_prob, -FAR, FAR)
        ratio = jnp.exp(log_ratio)
        # advantages are normalised in each minibatch, so that the step size does not depend on the scale of the reward
        mean, std = self.shards.moments(b.advantages)
        advantages = (b.advantages - mean) / (std + 1e-6)
        surrogate = jnp.minimum(ratio * advantages, jnp.clip(ratio, 1 - c.clip, 1 + c.clip) * advantages).mean()
        value_loss = jnp.square(self.value(critic, b.obs, b.privileged_obs) - b.returns).mean()
        entropy = jnp.sum(log_sigma + 0.5 * np.log(2 * np.pi * np.e))
        kl = ((ratio - 1) - log_ratio).mean()  # never negative and of small variance (Schulman 2020)
        loss = -surrogate + c.value_weight * value_loss - c.entropy * entropy
        if c.mirror:
            # every fourth row of a shuffled minibatch is enough
            there = forward(actor, b.obs[::4] * self.mirror_signs, c.activation)
            loss += c.mirror * jnp.square(mu[::4] + there).sum(-1).mean()
        return loss, kl

    def update(self, state: PPOTrainState, batch: Batch):
        """Does `epochs` passes over the batch. Returns ((actor, log_sigma, critic), optimiser's state, (losses, KL))."""
        c = self.config
        batch = jax.tree.map(lambda a: a.reshape((-1,) + a.shape[2:]), batch)  # (T B, ..): the order of rows no longer matters
        count = len(batch.value)  # rows of this device

        def minibatch(carry, rows):
            networks, opt_state = carry
            # one gradient for actor and critic, so that max_grad_norm bounds them together
            (loss, kl), grads = jax.value_and_grad(self.loss, has_aux=True)(networks, jax.tree.map(lambda a: a[rows], batch))
            if not self.moves:
                grads = (*jax.tree.map(jnp.zeros_like, grads[:2]), grads[2])
            updates, opt_state = self.optimiser.update(self.shards.mean(grads), opt_state, networks)
            return (optax.apply_updates(networks, updates), opt_state), (loss, kl)

        def epoch(carry, key):
            order = jax.random.permutation(key, count)
            return jax.lax.scan(minibatch, carry, order.reshape(c.minibatches, -1))

        # keys follow from the iteration's number alone: a resumed run has the random draws of an uninterrupted one
        keys = jax.random.split(jax.random.fold_in(state.key, state.iteration + SHUFFLE), c.epochs)
        start = ((state.actor, state.log_sigma, state.critic), state.opt_state)
        (networks, opt_state), diagnostics = jax.lax.scan(epoch, start, keys)
        return networks, opt_state, diagnostics


def gaussian(u, mu, log_sigma):
    """Log density of u under N(mu, exp(log_sigma)), summed over the action."""
    z = (u - mu) * jnp.exp(-log_sigma)
    return jnp.sum(-0.5 * z * z - log_sigma - 0.5 * np.log(2 * np.pi), -1)
