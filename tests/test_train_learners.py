"""PPO and SAC, term by term: against sums written out, densities and targets computed by hand, and a task with a known answer."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import EDGE, Point

from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.station_hold import spans
from fishmj.train import ppo, sac
from fishmj.train.off_policy import ReplayBuffer, Transition
from fishmj.train.training_run import arrays_of

SMALL = {"hidden": (16,), "envs": 8}


@cache
def ppo_learner(poisoned=None, **config):
    return ppo.PPO(
        Point(poisoned), ppo.PPOConfig(**{**SMALL, "horizon": 16, "minibatches": 2, "learning_rate": 3e-3, **config}), 10_000
    )


@cache
def sac_learner(poisoned=None, **config):
    return sac.SAC(
        Point(poisoned),
        sac.SACConfig(**{**SMALL, "block": 8, "batch": 16, "warmup": 64, "learning_rate": 3e-3, **config}),
        10_000,
    )


def numpy_mlp(layers, x, activation):
    """The network again, in float64."""
    x = np.asarray(x, float)
    for i, (w, b) in enumerate(layers):
        x = x @ np.asarray(w, float) + np.asarray(b, float)
        x = activation(x) if i < len(layers) - 1 else x
    return x


@pytest.mark.parametrize("privileged", [False, True])
def test_ppo_advantages_are_the_sum_of_discounted_errors(privileged):
    """A_t = sum_k (gamma lambda)^k delta_{t+k} up to the end of the episode; time limits bootstrap, leaving does not."""
    learner = ppo_learner(privileged=privileged, sigma=3.0)
    c, t = learner.config, learner.init(jax.random.key(1))
    _, batch, record = learner.collect(t)
    reward, done, left = (np.asarray(a) for a in (record.reward, record.done, record.terminated))
    state, next_value, scale = t.env_state, [], np.asarray(learner.obs_scale)
    for u in batch.u:
        state = learner.env.step(state, jnp.tanh(u))
        x = np.asarray(state.final_obs) / scale
        x = np.concatenate([x, np.asarray(state.final_privileged) / np.asarray(learner.privileged_scale)], 1) if privileged else x
        next_value.append(numpy_mlp(t.critic, x, np.tanh)[:, 0] * ~np.asarray(state.terminated))
    value = np.asarray(batch.value, float)
    delta = c.reward_scale * reward.astype(float) + c.gamma * np.array(next_value) - value
    expected = np.zeros_like(delta)
    for i in range(c.horizon):
        for fish in range(c.envs):
            for k in range(c.horizon - i):
                expected[i, fish] += (c.gamma * c.lam) ** k * delta[i + k, fish]
                if done[i + k, fish]:
                    break
    assert left.sum() > 0 and (done & ~left).sum() > 0  # both kinds of end were there
    np.testing.assert_allclose(batch.advantages, expected, atol=2e-5)
    np.testing.assert_allclose(batch.returns, expected + value, atol=2e-5)


def test_ppo_stores_the_log_density_of_what_it_did():
    """log pi(u) before the first update, so that the first ratio is 1; a second look at the same u by hand."""
    learner = ppo_learner(privileged=True, sigma=3.0)
    t = learner.init(jax.random.key(1))
    _, b, _ = learner.collect(t)
    z = (np.asarray(b.u, float) - numpy_mlp(t.actor, b.obs, np.tanh)) / 3.0
    np.testing.assert_allclose(b.log_prob, (-0.5 * z**2 - np.log(3.0) - 0.5 * np.log(2 * np.pi)).sum(-1), atol=1e-5)


def test_a_policy_pays_for_the_side_it_prefers():
    """The loss with weight 2 against a sum written out; a policy that mirrors pays nothing."""
    learner = ppo_learner()
    signs = np.where(np.arange(learner.env.n_input) % 2, -1.0, 1.0)
    learner.env.mirror_signs = signs
    asked = ppo.PPO(learner.env, replace(learner.config, mirror=2.0), 1)
    t = learner.init(jax.random.key(2))
    batch = jax.tree.map(lambda a: a.reshape((-1,) + a.shape[2:]), learner.collect(t)[1])
    networks = t.actor, t.log_sigma, t.critic
    rows = np.asarray(batch.obs)[::4]
    both = numpy_mlp(t.actor, rows, np.tanh) + numpy_mlp(t.actor, rows * signs, np.tanh)
    more = float(asked.loss(networks, batch)[0] - learner.loss(networks, batch)[0])
    assert more == pytest.approx(2.0 * (both**2).sum(1).mean(), rel=1e-3) and more > 0
    (w, b), *others = t.actor
    even = [(jnp.asarray(w) * (signs[:, None] < 0), jnp.zeros_like(b)), *((w, jnp.zeros_like(b)) for w, b in others)]
    odd = even, t.log_sigma, t.critic  # it sees what turns alone, and tanh is odd
    assert float(asked.loss(odd, batch)[0]) == pytest.approx(float(learner.loss(odd, batch)[0]), abs=1e-6)


def test_mirror_signs_turn_what_a_fish_sees_into_what_its_mirror_image_sees():
    env = StationHold("fish", None, Options(memory=2))
    sight = {"target": [1, -1], "velocity": [1, -1], "yaw_rate": [-1], "joint": [-1] * 3, "joint_rate": [-1] * 3}
    one = sum((sight[group] for group in spans(3)), [])
    assert env.mirror_signs.tolist() == [*one, -1, -1, -1, *one] and env.mirror_signs.shape == (env.n_input,)


def test_dropped_step_has_no_ppo_advantage_and_is_not_in_the_sac_buffer():
    """Fault 2 at the learners: the poisoned point's reward of 777 is nowhere."""
    learner = ppo_learner(poisoned=3)
    _, batch, record = learner.collect(learner.init(jax.random.key(0)))
    diverged = record.diverged
    assert diverged[:, 3].all() and not diverged[:, :3].any()
    np.testing.assert_array_equal(batch.advantages[:, 3], 0.0)
    learner = sac_learner(poisoned=0)
    t, metrics = learner.iterate(learner.init(jax.random.key(0)))
    assert metrics["diverged"] == 8 and t.replay.size == 64
    assert t.replay.data.reward[:64].max() <= 0


def test_sac_buffer_stores_time_limits_as_non_terminal_with_final_obs():
    learner = sac_learner(warmup=10_000)
    t = learner.init(jax.random.key(0))
    for _ in range(8):
        t, _ = learner.iterate(t)
    stored, n = t.replay.data, int(t.replay.size)
    scale = np.asarray(learner.obs_scale)
    x, next_x = (np.asarray(a[:n]) @ np.eye(7)[0] * scale[0] for a in (stored.obs, stored.next_obs))
    np.testing.assert_allclose(next_x, x + 0.3 * np.asarray(stored.action[:n, 0]), atol=1e-6)  # a restart would be elsewhere
    np.testing.assert_array_equal(stored.terminated[:n] == 1, np.abs(next_x) > EDGE)
    assert n == 512 and 0 < stored.terminated[:n].sum() < n / 10  # 51 time limits at least, none of them an end


@pytest.mark.parametrize("terminated", [0.0, 1.0])
def test_sac_critic_loss_is_the_squared_distance_to_the_bellman_target(terminated):
    """y = r + gamma (1 - d) min_i Q'_i(s', a') with alpha -> 0 and a policy without noise, both critics, by hand."""
    learner = sac_learner()
    agent = learner.init(jax.random.key(3)).agent
    actor = [(0 * w, 0 * b) for w, b in agent.actor]
    actor[-1] = (actor[-1][0], jnp.array([0.4, -20.0]))  # mu = 0.4, sigma = e^-10
    rng = np.random.default_rng(0)
    obs, next_obs = rng.normal(size=(2, 1, 7)).astype(np.float32)
    one = Transition(obs, np.array([[0.7]], np.float32), np.array([1.5]), next_obs, np.array([terminated]))
    replay = ReplayBuffer(one, jnp.int32(1), jnp.int32(0))
    targets = jax.tree.map(lambda a: a + 0.1, agent.critics)
    relu = lambda x: np.maximum(x, 0)
    q = lambda critics, i, s, a: numpy_mlp([(w[i], b[i]) for w, b in critics], np.append(s, a)[None], relu)[0, 0]
    y = 1.5 + 0.99 * (1 - terminated) * min(q(targets, i, next_obs, np.tanh(0.4)) for i in (0, 1))
    expected = sum((q(agent.critics, i, obs, 0.7) - y) ** 2 for i in (0, 1))
    agent = agent._replace(actor=actor, target_critics=targets, log_alpha=jnp.float32(-40.0))
    after, loss = jax.jit(learner.update)(replay, agent, jax.random.key(0))
    assert loss == pytest.approx(expected, rel=1e-3)
    follows = lambda new, old, target: (target - (old + 0.005 * (new - old))).max()
    off = jax.tree.map(follows, after.critics, targets, after.target_critics)
    assert max(abs(v) for v in jax.tree.leaves(off)) < 1e-6  # targets follow by tau


def test_sac_density_of_an_action_is_the_gaussians_through_tanh():
    """log pi(a) = log N(u; mu, sigma) - log(1 - tanh(u)^2), u = artanh(a)."""
    learner = sac_learner()
    actor = learner.init(jax.random.key(5)).actor
    obs = jax.random.normal(jax.random.key(6), (200, 7))
    action, logp = learner.sample(actor, obs, jax.random.key(7))
    mu, log_sigma = np.split(numpy_mlp(actor, obs, lambda x: np.maximum(x, 0)), 2, -1)
    action = np.asarray(action, float)
    u, sigma = np.arctanh(action), np.exp(log_sigma)
    expected = -0.5 * ((u - mu) / sigma) ** 2 - log_sigma - 0.5 * np.log(2 * np.pi) - np.log(1 - action**2)
    np.testing.assert_allclose(logp, expected[:, 0], atol=2e-3)


@pytest.mark.parametrize("make", [ppo_learner, sac_learner], ids=["ppo", "sac"])
def test_learners_find_the_way_to_zero(make):
    """The best action is -x / 0.3, clipped; after 4,000 steps the actor comes close to it."""
    learner = make()
    t, x = learner.init(jax.random.key(0)), np.linspace(-1, 1, 21)
    best = np.clip(-x / 0.3, -1, 1)
    miss = lambda t: np.abs(learner.act(t.actor, Point().see(jnp.asarray(x)))[:, 0] - best).mean()
    before = miss(t)
    for _ in range(4000 // learner.steps_per_iteration):
        t, _ = learner.iterate(t)
    assert before > 0.6 and miss(t) < 0.25


@pytest.mark.parametrize("make", [ppo_learner, sac_learner], ids=["ppo", "sac"])
def test_one_seed_gives_one_result_to_the_bit(make):
    learner = make()

    def train(seed):
        t = learner.init(jax.random.key(seed))
        for _ in range(12):
            t, metrics = learner.iterate(t)
        return arrays_of(t), {k: float(v) for k, v in metrics.items()}

    (first, a), (again, b), (other, _) = train(0), train(0), train(1)
    assert a == b
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name], err_msg=name)
    assert any(not np.array_equal(value, other[name]) for name, value in first.items() if ".actor[" in name)
