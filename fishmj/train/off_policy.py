"""Common part of off-policy algorithms: replay buffer, loop, metrics. sac.py and this sketch show how to use it:

    class TD3(OffPolicy):
        name = "td3"
        def init_agent(self, k_actor, k_critics): ..    -> a NamedTuple of networks, with `actor`
        def explore(self, agent, obs, key): ..          -> actions (B, J) in [-1, 1] for scaled observations
        def update(self, replay, agent, key): ..        -> (agent after one gradient step, loss)

Each environment step is followed by `utd` gradient steps for each fish, after `warmup` control steps of random actions.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from fishmj.train.hyperparameters import OffPolicyConfig
from fishmj.train.learner import EpisodeTally, PolicyLayers, episode_metrics, metrics_of, record_of
from fishmj.train.networks import forward


class Transition(NamedTuple):
    """One control step of each of B fish, with scaled observations."""

    obs: Any
    action: Any
    reward: Any
    next_obs: Any  # before a reset
    terminated: Any  # 1 where the fish left the tank; 0 at a time limit


class ReplayBuffer(NamedTuple):
    """Ring buffer of transitions, (capacity, ...) each."""

    data: Transition
    size: Any
    head: Any

    @classmethod
    def empty(cls, capacity: int, n_obs: int, n_act: int) -> "ReplayBuffer":
        """Buffer with room for `capacity` transitions."""
        shapes = Transition((capacity, n_obs), (capacity, n_act), capacity, (capacity, n_obs), capacity)
        return cls(Transition(*map(jnp.zeros, shapes)), jnp.int32(0), jnp.int32(0))

    def add(self, transition: Transition) -> "ReplayBuffer":
        """Buffer with B new transitions, which replace the oldest if it is full; the capacity is a multiple of B."""
        put = lambda array, rows: jax.lax.dynamic_update_slice_in_dim(array, rows, self.head, 0)
        n, capacity = len(transition.reward), len(self.data.reward)
        data = jax.tree.map(put, self.data, transition)
        return ReplayBuffer(data, jnp.minimum(self.size + n, capacity), (self.head + n) % capacity)

    def sample(self, key, n: int) -> Transition:
        """Draws n transitions uniformly, with replacement."""
        rows = jax.random.randint(key, (n,), 0, self.size)
        return jax.tree.map(lambda array: array[rows], self.data)


class OffPolicyTrainState(NamedTuple):
    """Complete state of a run."""

    agent: Any  # the algorithm's own: networks and the state of their optimisers
    replay: ReplayBuffer
    env_state: Any
    key: Any
    env_steps: Any
    tally: Any  # EpisodeTally

    @property
    def actor(self):
        """Network of the policy, which is assessed and exported."""
        return self.agent.actor


class OffPolicy:
    """Loop of a `learner.Learner` with a replay buffer: `block` environment steps an iteration, learning after each."""

    name: str
    init_agent: Callable[..., Any]  # these three belong to the algorithm
    explore: Callable[..., Any]
    update: Callable[..., Any]

    def __init__(self, env, config: OffPolicyConfig, steps: int):
        self.env, self.config = env, config
        self.steps_per_iteration = config.envs * config.block
        self.updates_per_step = max(1, round(config.utd * config.envs))
        self.capacity = max(config.envs, min(config.buffer, steps) // config.envs * config.envs)
        self.optimiser = optax.adam(config.learning_rate)
        self.obs_scale = jnp.asarray(env.input_scale)

    def diagnostics(self, agent) -> dict:
        """Additional metrics of the algorithm."""
        return {}

    @partial(jax.jit, static_argnums=0)
    def init(self, key) -> OffPolicyTrainState:
        """Fresh train state: networks, empty buffer, environments at random times of their episodes."""
        k_actor, k_critics, k_env, key, _ = jax.random.split(key, 5)
        agent = self.init_agent(k_actor, k_critics)
        replay = ReplayBuffer.empty(self.capacity, self.env.n_input, self.env.n_act)
        n = self.config.envs
        return OffPolicyTrainState(agent, replay, self.env.reset(k_env, n, True), key, jnp.int32(0), EpisodeTally.start(jnp, n))

    def act(self, actor, obs):
        """Deterministic actions (B, J) for raw observations."""
        layers, activation = self.policy_layers(actor)
        return jnp.tanh(forward(layers, obs / self.obs_scale, activation))

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers of the whole actor, for an actor with one output for each joint."""
        return PolicyLayers(actor, self.config.activation)

    @partial(jax.jit, static_argnums=0, donate_argnums=1)
    def iterate(self, state: OffPolicyTrainState):
        """Does `block` environment steps, learning after each. Returns (train state, metrics as scalars)."""
        state, (record, loss) = jax.lax.scan(self._step, state, None, self.config.block)
        tally, ended = episode_metrics(state.tally, record)
        return state._replace(tally=tally), {
            **metrics_of(jnp, record),
            **ended,
            **self.diagnostics(state.agent),
            "loss": loss.mean(),
        }

    def _step(self, state: OffPolicyTrainState, _):
        c = self.config
        # keys follow from the count of steps alone: a resumed run has the random draws of an uninterrupted one
        k_explore, k_random, k_update = jax.random.split(jax.random.fold_in(state.key, state.env_steps), 3)
        obs = state.env_state.obs / self.obs_scale
        warming_up = state.replay.size < min(c.warmup, self.capacity)
        random = jax.random.uniform(k_random, (c.envs, self.env.n_act), minval=-1.0)
        action = jnp.where(warming_up, random, self.explore(state.agent, obs, k_explore))
        after = self.env.step(state.env_state, action)
        # the transition of a fish that diverged is replaced by that of a sound fish, so that B rows are always written
        rows = jnp.where(after.diverged, jnp.argmin(after.diverged), jnp.arange(c.envs))
        terminated = after.terminated.astype(jnp.float32)  # a time limit is no end: it bootstraps (arXiv 1712.00378)
        transition = Transition(obs, action, after.reward, after.final_obs / self.obs_scale, terminated)
        replay = state.replay.add(jax.tree.map(lambda a: a[rows], transition))
        keys = jax.random.split(k_update, self.updates_per_step)
        # a closure, not an operand of `cond`, whose branches would copy the whole buffer at every step
        learn = lambda agent: jax.lax.scan(partial(self.update, replay), agent, keys)
        wait = lambda agent: (agent, jnp.zeros(self.updates_per_step))
        agent, loss = jax.lax.cond(warming_up, wait, learn, state.agent)
        state = state._replace(agent=agent, replay=replay, env_state=after, env_steps=state.env_steps + 1)
        return state, (record_of(after, self.env.limit), loss.mean())
