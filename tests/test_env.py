"""The functional environment: what restarts when, that one lost fish harms no other, and that it compiles once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from raft import KEY, ROBOT, Raft, push, raft, rows_equal

from fishmj import engines
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.tasks import station_hold as task
from fishmj.tasks.env import EnvState, Options, StationHold

TICKS = engines.ticks_per(ROBOT)[1]
LIMIT = constant("task", "episode_steps")
ROUGH = dict(noise=1.0, turbulence="default", intensity=(0.02, 0.08))


# ---- the end of an episode ----


def test_leaving_the_domain_ends_one_episode_and_starts_another():
    env, before = raft()
    after = env.step(before, push(f2=(1, 0, 0)))
    assert np.asarray(after.terminated).tolist() == [False, False, True, False, False, False]
    assert not np.any(after.truncated) and not np.any(after.diverged)
    assert np.asarray(after.count).tolist() == [1, 1, 0, 1, 1, 1] and np.asarray(after.tick).tolist() == [10, 10, 0, 10, 10, 10]
    start = np.asarray(after.fish.q)[2, :2]
    assert np.abs(start).max() <= 1.5 and not np.allclose(start, before.fish.q[2, :2])
    assert not np.allclose(after.target[2], before.target[2])
    rows_equal(after, env.step(before, push()), [0, 1, 3, 4, 5])


def test_the_final_observation_is_from_before_the_restart():
    """What a critic bootstraps from belongs to the episode that ended; `obs` already to the next one, at rest."""
    env, before = raft()
    after = env.step(before, push(f2=(1, 0, 0)))
    gone = np.asarray(before.fish.q)[2, :2] + [30 * ROBOT.servo.range * 0.02 * 5.5, 0]
    assert after.distance[2] == pytest.approx(np.linalg.norm(gone - np.asarray(before.target)[2]), rel=1e-5)
    assert np.linalg.norm(after.final_obs[2, 2:4]) > 1.0 and np.linalg.norm(after.final_obs[2, 5:8]) > 0.5
    np.testing.assert_allclose(after.obs[2, 2:], 0, atol=1e-5)
    ongoing = [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(np.asarray(after.obs)[ongoing], np.asarray(after.final_obs)[ongoing])
    np.testing.assert_array_equal(np.asarray(after.privileged)[ongoing], np.asarray(after.final_privileged)[ongoing])
    assert after.final_privileged[2, -3] == pytest.approx((LIMIT - 1) / LIMIT) and after.privileged[2, -3] == 1.0


def test_time_up_is_a_truncation_and_leaving_at_that_moment_a_termination():
    env, state = raft()
    state = state._replace(count=jnp.full(6, LIMIT - 1, jnp.int32))
    after = env.step(state, push(f4=(0, -1, 0)))
    assert np.asarray(after.truncated).tolist() == [True, True, True, True, False, True]
    assert np.asarray(after.terminated).tolist() == [False] * 4 + [True, False]
    assert not np.any(after.count)
    early = env.step(state._replace(count=jnp.full(6, LIMIT - 2, jnp.int32)), push())
    assert not np.any(early.truncated) and (early.count == LIMIT - 1).all()


def test_a_lost_fish_is_dropped_without_touching_the_others():
    env, before = raft(**ROUGH)
    after = env.step(before, push(f1=(0.1, 0, 1)))
    assert np.asarray(after.diverged).tolist() == [False, True] + [False] * 4
    assert not np.any(after.terminated) and not np.any(after.truncated)
    for leaf in jax.tree.leaves(after._replace(key=0)):
        assert np.isfinite(leaf).all()
    assert after.reward[1] == 0 and after.distance[1] == 0 and not np.any(after.final_obs[1])
    assert after.count[1] == 0 and np.abs(after.fish.q[1, :2]).max() <= 1.5
    rows_equal(after, env.step(before, push(f1=(0.1, 0, 0))), [0, 2, 3, 4, 5])


@pytest.mark.parametrize("wrong", [(np.nan, 0, 0), (0, 0, np.inf)])
def test_an_action_that_is_not_finite_drops_its_episode_and_says_so(wrong):
    env, before = raft(**ROUGH)
    after = env.step(before, push(f3=wrong))
    assert np.asarray(after.diverged).tolist() == [False, False, False, True, False, False]
    assert not np.any(after.terminated) and not np.any(after.truncated)
    assert after.count[3] == 0 and after.reward[3] == 0 and not np.any(after.final_obs[3])
    for leaf in jax.tree.leaves(after._replace(key=0)):
        assert np.isfinite(leaf).all()
    rows_equal(after, env.step(before, push()), [0, 1, 2, 4, 5])


def test_an_action_beyond_its_range_acts_and_is_remembered_clipped():
    env, state = raft(noise=0.0, turbulence="none", memory=2)
    far, near = (env.step(state, push(f1=(size, -size, 0.1))) for size in (7.0, 1.0))
    rows_equal(far, near, range(6))


def test_episode_keeps_its_flow_and_fish_and_a_restart_redraws_both():
    env, before = raft(**ROUGH)
    after = env.step(before, push(f2=(1, 0, 0)))
    others = [0, 1, 3, 4, 5]
    for name in ("mean", "rms", "row", "offset", "turn"):
        old, new = np.asarray(getattr(before.current, name)), np.asarray(getattr(after.current, name))
        np.testing.assert_array_equal(new[others], old[others])
        assert not np.array_equal(new[2], old[2]), name
    assert not np.array_equal(after.params.mass[2], before.params.mass[2])
    np.testing.assert_array_equal(np.asarray(after.params.mass)[others], np.asarray(before.params.mass)[others])
    assert after.current.table is not None and after.current.table.shape == before.current.table.shape


def test_staggered_clocks_spread_over_the_whole_episode():
    env, _ = raft()
    count = np.asarray(env.reset(KEY, 3000, True).count)
    assert count.min() == 0 and count.max() == LIMIT - 1
    assert np.histogram(count, 10, (0, LIMIT))[0] == pytest.approx(300, abs=75)  # 4.5 sigma of a uniform draw
    assert not np.any(env.reset(KEY, 6).count)


def test_a_key_is_a_run_and_another_key_another():
    env, one = raft(**ROUGH)
    two, other = env.reset(KEY, 6), env.reset(jax.random.PRNGKey(8), 6)
    for _ in range(3):
        one, two = env.step(one, push(f0=(0.1, 0, 0))), env.step(two, push(f0=(0.1, 0, 0)))
    rows_equal(one, two, range(6))
    assert not np.allclose(other.fish.q, env.reset(KEY, 6).fish.q)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (dict(turbulence="gusts"), "Did you mean 'gust'"),
        (dict(box="trian"), "Did you mean 'train'"),
        (dict(intensity=(0.2, 0.1)), "intensity"),
        (dict(memory=0), "memory"),
    ],
)
def test_an_option_that_cannot_be_is_one_clear_error(options, message):
    with pytest.raises((ConfigError, UnknownName), match=message):
        StationHold(ROBOT, Raft(), Options(**options))


# ---- jit ----


def test_one_trace_serves_all_steps():
    env = StationHold(ROBOT, Raft(), Options(noise=0.0, turbulence="none"))
    state = env.reset(KEY, 6)
    for i in range(5):
        state = env.step(state, push(f0=(0.01 * i, 0, 0)))
    assert env.engine.traced == 1
    assert {a.dtype for a in jax.tree.leaves(state._replace(key=None)) if a.dtype.kind == "f"} == {np.dtype(np.float32)}


def test_the_state_keeps_its_shapes_and_types_under_scan():
    env, state = raft(**ROUGH)
    action = push(f0=(0.02, 0, 0), f3=(1, 1, 0))
    by_hand = state
    for _ in range(4):
        by_hand = env.step(by_hand, action)
    scanned, _ = jax.lax.scan(lambda s, _: (env.step(s, action), None), state, None, length=4)
    assert isinstance(scanned, EnvState)
    for a, b in zip(jax.tree.leaves(scanned), jax.tree.leaves(by_hand), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


# ---- over the closed-form fish ----


def test_planar_env_step_equals_the_engine_step_and_isolates_a_nan_fish():
    env = StationHold(ROBOT, "planar", Options(turbulence="default"))
    state = env.reset(KEY, 5)
    for i in range(2):
        action = jax.random.uniform(jax.random.PRNGKey(i), (5, 3), minval=-1.0)
        commands = task.chunk(jnp, ROBOT, state.command, action)
        fish, trace = env.engine.advance(state.fish, commands, state.params, state.current, state.tick)
        state = env.step(state, action)
        for one, two in zip(state.fish, fish, strict=True):
            np.testing.assert_allclose(one, two, atol=1e-4)
        np.testing.assert_allclose(state.history[:, -TICKS:], trace.pose, atol=1e-5)
    sick = state._replace(fish=state.fish._replace(v=state.fish.v.at[3, 4].set(jnp.nan)))
    healthy, after = env.step(state, action), env.step(sick, action)
    assert np.asarray(after.diverged).tolist() == [False, False, False, True, False]
    rows_equal(after, healthy, [0, 1, 2, 4])
    for leaf in jax.tree.leaves(after._replace(key=0)):
        assert np.isfinite(leaf).all()
