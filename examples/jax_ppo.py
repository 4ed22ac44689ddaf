"""PPO in one file on the JAX environment, in the manner of CleanRL and PureJaxRL: rollout and updates are one jitted function.

    python examples/jax_ppo.py                     learns to swim to its target and stay: 1.5 million steps
    python examples/jax_ppo.py --steps 100000      a look at it
    fishmj evaluate jax_ppo.safetensors            judges it

Nothing of fishmj.train is used: the environment is a function of (state, action), and the rest stands here, to be changed.
The actor sees the 11 egocentric numbers, the critic also the stream, which exists in simulation only. Needs jax, optax, numba.
"""

import argparse
import time
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fishmj.policy import Policy
from fishmj.tasks.env import Options, StationHold

ENVS, HORIZON, EPOCHS, MINIBATCHES = 256, 32, 4, 8
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, RATE = 0.99, 0.95, 0.2, 0.002, 0.5, 1e-3
REWARD_SCALE = 0.1  # returns of order one suit the critic
HIDDEN = (64, 64)


class Learner(NamedTuple):
    """State of a training between iterations."""

    weights: Any
    moments: Any  # of Adam
    env: Any
    gain: Any  # (B,) return of the running episodes
    key: Any


class Row(NamedTuple):
    """One control step of B fish."""

    obs: Any
    seen: Any  # by the critic
    u: Any
    log_prob: Any
    value: Any
    target: Any  # r + gamma V(s')
    reward: Any
    done: Any


def network(key, sizes, last):
    """Orthogonal weights, zero biases."""
    gains = [np.sqrt(2.0)] * (len(sizes) - 2) + [last]
    keys = jax.random.split(key, len(gains))
    make_layer = lambda k, g, a, b: (jax.nn.initializers.orthogonal(g)(k, (a, b)), jnp.zeros(b))
    return [make_layer(*row) for row in zip(keys, gains, sizes[:-1], sizes[1:], strict=True)]


def forward(layers, x):
    """tanh between the layers."""
    for w, b in layers[:-1]:
        x = jnp.tanh(x @ w + b)
    return x @ layers[-1][0] + layers[-1][1]


def log_density(u, mean, log_sigma):
    """Log density of N(mean, sigma) at u, summed over the joints."""
    return jnp.sum(-0.5 * ((u - mean) * jnp.exp(-log_sigma)) ** 2 - log_sigma - 0.5 * np.log(2 * np.pi), -1)


def mean_of(env, weights, obs):
    """The actor's mean; the action is tanh of it, without exploration."""
    return forward(weights["actor"], obs / env.input_scale)


def value_of(env, weights, obs, privileged):
    """The critic."""
    seen = jnp.concatenate([obs / env.input_scale, privileged / env.privileged_scale], -1)
    return forward(weights["critic"], seen)[..., 0]


def collect(env, learner, keys):
    """A rollout: (environment's state, returns, rows (T, B), ends and sum of finished episodes)."""
    weights = learner.weights

    def step(carry, key):
        state, gain = carry
        mean = mean_of(env, weights, state.obs)
        u = mean + jnp.exp(weights["log_sigma"]) * jax.random.normal(key, mean.shape)
        after = env.step(state, jnp.tanh(u))
        # the environment restarts by itself: V(s') is that of the last observation; a time limit is no end, leaving the tank is
        value = value_of(env, weights, state.obs, state.privileged)
        ahead = jnp.where(after.terminated, 0.0, value_of(env, weights, after.final_obs, after.final_privileged))
        target = jnp.where(after.diverged, value, REWARD_SCALE * after.reward + GAMMA * ahead)
        done = after.terminated | after.truncated | after.diverged
        gain = gain + after.reward
        row = Row(
            state.obs, state.privileged, u, log_density(u, mean, weights["log_sigma"]), value, target,
            jnp.where(done, gain, 0.0), done,
        )  # fmt: skip
        return (after, jnp.where(done, 0.0, gain)), row

    (state, gain), rows = jax.lax.scan(step, (learner.env, learner.gain), keys)
    return state, gain, rows


def advantages_of(rows):
    """GAE, backwards in time."""

    def back(advantage, row):
        advantage = row[0] + GAMMA * LAMBDA * (1.0 - row[1]) * advantage
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros(ENVS), (rows.target - rows.value, rows.done), reverse=True)[1]


def loss_of(weights, env, batch):
    """The clipped surrogate, the critic's error, the entropy."""
    rows, advantage, returns = batch
    ratio = jnp.exp(log_density(rows.u, mean_of(env, weights, rows.obs), weights["log_sigma"]) - rows.log_prob)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-6)
    surrogate = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage).mean()
    error = jnp.square(value_of(env, weights, rows.obs, rows.seen) - returns).mean()
    return -surrogate + VALUE * error - ENTROPY * weights["log_sigma"].sum()


@partial(jax.jit, static_argnums=(0, 1))
def iterate(env, optimiser, learner):
    """One rollout and the updates on it: (learner, mean return of the finished episodes, how many)."""
    key, k_act, k_shuffle = jax.random.split(learner.key, 3)
    state, gain, rows = collect(env, learner, jax.random.split(k_act, HORIZON))
    advantage = advantages_of(rows)
    batch = jax.tree.map(lambda a: a.reshape((-1,) + a.shape[2:]), (rows, advantage, advantage + rows.value))

    def update(carry, rows):
        weights, moments = carry
        gradient = jax.grad(loss_of)(weights, env, jax.tree.map(lambda a: a[rows], batch))
        step, moments = optimiser.update(gradient, moments)
        return (optax.apply_updates(weights, step), moments), None

    orders = [jax.random.permutation(k, ENVS * HORIZON) for k in jax.random.split(k_shuffle, EPOCHS)]
    parts = jnp.concatenate(orders).reshape(EPOCHS * MINIBATCHES, -1)
    (weights, moments), _ = jax.lax.scan(update, (learner.weights, learner.moments), parts)
    count = rows.done.sum()
    return Learner(weights, moments, state, gain, key), rows.reward.sum() / count, count


@partial(jax.jit, static_argnums=0)
def judge(env, weights, key):
    """128 whole episodes without exploration on other flows: (mean return, RMS distance of the last 10 s in m)."""

    def step(carry, _):
        state, alive = carry
        after = env.step(state, jnp.tanh(mean_of(env, weights, state.obs)))
        alive = alive & ~(after.terminated | after.diverged)
        return (after, alive), (after.reward * alive, jnp.where(alive, after.distance, 2.0))

    _, (reward, distance) = jax.lax.scan(step, (env.reset(key, 128, False), jnp.ones(128, bool)), None, env.limit)
    return reward.sum(0).mean(), jnp.sqrt(jnp.square(distance[-50:]).mean())


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--steps", type=int, default=1_500_000, help="control steps, all fish together")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", default="jax_ppo.safetensors", help="the policy file")
    args = p.parse_args()
    env, tune = (StationHold("fish", options=Options(turbulence="gust", box=box)) for box in ("train", "tune"))
    iterations = max(1, args.steps // (ENVS * HORIZON))
    rate = optax.linear_schedule(RATE, 0.1 * RATE, iterations * EPOCHS * MINIBATCHES)
    optimiser = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(rate, eps=1e-5))
    k_actor, k_critic, k_env, key = jax.random.split(jax.random.key(args.seed), 4)
    weights = {
        "actor": network(k_actor, [env.n_input, *HIDDEN, env.n_act], 0.01),
        "critic": network(k_critic, [env.n_input + env.n_privileged, *HIDDEN, 1], 1.0),
        "log_sigma": jnp.full(env.n_act, np.log(0.5)),
    }
    learner = Learner(weights, optimiser.init(weights), env.reset(k_env, ENVS, True), jnp.zeros(ENVS), key)
    before, began = judge(tune, weights, jax.random.key(1)), time.monotonic()
    for i in range(iterations):
        learner, mean, count = iterate(env, optimiser, learner)
        if i % max(1, iterations // 20) == 0 and count > 0:
            took = time.monotonic() - began
            print(f"{(i + 1) * ENVS * HORIZON:>9,} steps, {took:5.0f} s: return of finished episodes {mean:.1f}", flush=True)
    after = judge(tune, learner.weights, jax.random.key(1))
    for name, (gain, held) in (("untrained", before), ("trained", after)):
        print(f"{name}: return {gain:.1f} of at most {env.limit}, RMS distance of the last 10 s {held:.3f} m")
    layers = [(w.T, b) for w, b in learner.weights["actor"]]  # a file has (out, in)
    policy = Policy.of(env, layers, activation="tanh", algorithm="jax_ppo", seed=args.seed, steps=iterations * ENVS * HORIZON)
    print(f"fishmj evaluate {policy.save(args.out)}")


if __name__ == "__main__":
    main()
