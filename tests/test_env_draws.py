"""The functional environment: every draw fills its range and no more, and the policy sees what the task says."""

from dataclasses import dataclass
from functools import partial
from math import pi, radians

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from raft import KEY, ROBOT, environment, push, raft

from fishmj import engines, suite
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.units import wrap
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import TaskOptions, TaskSpec
from fishmj.tasks.gym.fish_env import FishVectorEnv
from fishmj.tasks.reference import StationHoldReference

LIMIT = constant("task", "episode_steps")
ROUGH = dict(noise=1.0, turbulence="default", intensity=(0.02, 0.08))


# ---- what is drawn ----


@pytest.fixture(scope="module")
def crowd():
    """20 000 first states, fully randomised, with noise."""
    return environment(**ROUGH).reset(KEY, 20000)


def uniform(values, low, high):
    """Ten equal bins hold a tenth each, within 4.5 sigma, and nothing lies outside."""
    values = np.asarray(values, float).ravel()
    slack = 1e-6 * max(abs(low), abs(high))
    assert low - slack <= values.min() and values.max() <= high + slack
    share = len(values) / 10
    np.testing.assert_allclose(np.histogram(values, 10, (low, high))[0], share, atol=4.5 * np.sqrt(0.9 * share))


def test_starts_fill_the_papers_ranges(crowd):
    arena = constant("task", "arena")
    for values in (crowd.fish.q[:, 0], crowd.fish.q[:, 1], crowd.target[:, 0], crowd.target[:, 1]):
        uniform(values, -arena, arena)
    uniform(crowd.fish.q[:, 2], -pi, pi)
    uniform(np.arctan2(crowd.current.mean[:, 1], crowd.current.mean[:, 0]), -pi, pi)
    speed = np.linalg.norm(crowd.current.mean, axis=1)
    uniform(speed, *constant("task", "flow_speed"))
    uniform(crowd.current.rms / speed, 0.02, 0.08)
    assert not np.any(crowd.fish.v) and not np.any(crowd.fish.buffer)
    np.testing.assert_allclose(crowd.distance, np.linalg.norm(crowd.fish.q[:, :2] - crowd.target, axis=1), atol=1e-6)


def test_a_share_of_the_starts_is_at_the_target_and_the_others_fill_the_range(crowd):
    state, arena = environment(at_target=0.25, **ROUGH).reset(KEY, 20000), constant("task", "arena")
    there = np.asarray(state.distance) == 0
    assert there.mean() == pytest.approx(0.25, abs=0.015)
    mean, same = np.asarray(state.current.mean), np.asarray(state.fish.q[:, 2] == crowd.fish.q[:, 2])
    off = wrap(np, np.asarray(state.fish.q[:, 2]) - np.arctan2(mean[:, 1], mean[:, 0]))  # from downstream
    assert same[~there].all() and same[there].mean() == pytest.approx(0.5, abs=0.03)
    uniform(off[~same], -pi / 4, pi / 4)
    uniform(state.fish.q[there & same, 2], -pi, pi)
    assert np.abs(state.fish.q[:, 2]).max() <= np.float32(pi)
    for values in (state.target[there], state.target[~there, 0], state.target[~there, 1]):
        uniform(values, -arena, arena)
    np.testing.assert_array_equal(state.fish.q[:, :2], crowd.fish.q[:, :2])
    np.testing.assert_array_equal(LIMIT - state.count, np.where(there, 40, LIMIT))
    with pytest.raises(ConfigError, match="at_target = 0.5 of the task figure_eight"):
        environment(at_target=0.5, course="figure_eight")


def test_an_exponent_draws_slow_streams_more_often(crowd):
    given = {"flow_speed": (0.0, 0.4), "flow_exponent": 2.0}
    rules = TaskSpec("station_hold", TaskOptions(**given))
    flow = environment(**{**ROUGH, **given}).reset(KEY, 20000).current.mean
    drawn = rules.scenario(rules.draws(np.random.default_rng(3), 20000)).launch.start.speed
    for speeds in (np.linalg.norm(flow, axis=1), drawn):
        uniform(np.sqrt(speeds / 0.4), 0.0, 1.0)
    with pytest.raises(ConfigError, match="flow_exponent = 0"):
        TaskOptions(flow_exponent=0.0)


def test_gymnasium_s_episodes_begin_at_the_target_as_often():
    rules = TaskSpec("station_hold", TaskOptions(at_target=0.25, flow_direction=3.0))
    draws = rules.draws(np.random.default_rng(3), 20000)
    scenario = rules.scenario(draws)
    start = scenario.launch.start
    there = (start.pose[:, :2] == start.target).all(-1)
    assert there.mean() == pytest.approx(0.25, abs=0.015)
    np.testing.assert_array_equal(rules.lengths(scenario), np.where(there, 40, LIMIT))
    off = wrap(np, start.pose[there, 2] - 3.0)  # half of them, and a quarter of the other headings
    assert (np.abs(off) < pi / 4).mean() == pytest.approx(0.5 + 0.5 / 4, abs=0.03)
    placed = rules.scenario(draws, target=np.zeros((20000, 2)))
    assert (rules.lengths(placed) == LIMIT).all()  # these do not begin at the target
    with pytest.raises(ConfigError, match="at_target = 0.5 of the task figure_eight"):
        TaskSpec("figure_eight", TaskOptions(at_target=0.5))


@pytest.mark.parametrize(("seconds", "steps"), [(4.0, [20]), (60.0, [40, 300])])
def test_episodes_at_the_target_are_never_longer_than_asked_for(seconds, steps):
    given = {"at_target": 0.5, "seconds": seconds}
    rules, env = TaskSpec("station_hold", TaskOptions(**given)), environment(**given)
    scenario = rules.scenario(rules.draws(np.random.default_rng(3), 100))
    assert np.unique(rules.lengths(scenario)).tolist() == steps
    assert np.unique(env.limit - env.reset(KEY, 100).count).tolist() == steps


def test_randomised_fish_fill_the_papers_ranges(crowd):
    get, servo = partial(constant, "randomisation"), engines.nominal_params(ROBOT, 1)
    for j in range(ROBOT.n_joints):
        uniform(crowd.params.kp[:, j] / servo.kp[0, j], 1 - get("kp"), 1 + get("kp"))
        uniform(crowd.params.kb[:, j] / servo.kb[0, j], 1 - get("kd"), 1 + get("kd"))
        uniform(crowd.params.zero[:, j], -radians(get("zero_deg")), radians(get("zero_deg")))
    for i in range(len(ROBOT.links)):
        uniform(crowd.params.mass[:, i], 1 - get("mass"), 1 + get("mass"))
    np.testing.assert_array_equal(crowd.fish.q[:, 3:], crowd.params.zero)  # encoders read zero at the start
    correlation = np.corrcoef(np.concatenate([crowd.params.mass, crowd.params.kp, crowd.params.zero], 1).T)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 0.04


def test_latencies_are_uniform_on_their_grids(crowd):
    """Commands: 20 to 120 ms in 4 ms steps, half a share at both ends. Camera: 30 to 100 ms, rounded up to bus ticks."""
    delay = np.bincount(np.asarray(crowd.params.delay), minlength=32) / 20000
    expected = np.zeros(32)
    expected[5:31], expected[[5, 30]] = 1 / 25, 1 / 50
    np.testing.assert_allclose(delay, expected, atol=0.007)
    camera = np.bincount(np.asarray(crowd.camera), minlength=7) / 20000
    np.testing.assert_allclose(camera, [0, 0, 1 / 7, 2 / 7, 2 / 7, 2 / 7, 0], atol=0.015)


def test_strength_zero_is_the_nominal_fish():
    _, state = raft(50, noise=0.0, turbulence="none", randomisation=0.0)
    for got, want in zip(state.params, engines.nominal_params(ROBOT, 50), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-6)
    assert set(np.asarray(state.camera).tolist()) == {4}  # 65 ms, rounded up


def test_noise_has_the_scale_of_each_sensor(crowd):
    clean = environment(**{**ROUGH, "noise": 0.0}).reset(KEY, 20000)
    np.testing.assert_array_equal(clean.fish.q, crowd.fish.q)
    scale, error = task.noise_scale(ROBOT), np.asarray(crowd.obs - clean.obs)
    np.testing.assert_allclose(error.std(0), scale, rtol=0.025)
    assert (np.abs(error.mean(0)) < 0.04 * scale).all()


# ---- what the policy sees ----


def test_the_observation_is_task_observe_by_hand():
    """Same numbers as the NumPy function on the recorded poses, with the noise of the step's own key."""
    env, state = raft(**ROUGH)
    poses = [np.repeat(np.asarray(state.fish.q)[:, None, :3], env.length, 1)]
    rng = np.random.default_rng(0)
    for _ in range(3):
        action = jnp.asarray(rng.uniform(-0.02, 0.02, (6, 3)).astype(np.float32))
        noise = jax.random.normal(jax.random.split(state.key, 3)[1], (6, 11))
        commands = task.chunk(np, ROBOT, np.asarray(state.command), np.asarray(action))
        _, trace = env.engine.advance(state.fish, jnp.asarray(commands), state.params, state.current, state.tick)
        poses.append(np.asarray(trace.pose))
        state = env.step(state, action)
        history = np.concatenate(poses, 1)[:, -env.length :]
        seen = task.observe(
            np, ROBOT, history, np.asarray(state.camera), commands[:, -1], 0.5 * commands[:, -1],
            np.asarray(state.target), np.asarray(noise),
        )  # fmt: skip
        np.testing.assert_allclose(state.obs, seen, atol=2e-4)
        np.testing.assert_allclose(state.reward, task.reward(np, np.asarray(state.distance), np.asarray(trace.rate)), rtol=1e-5)
    assert not np.any(state.terminated)


def test_the_privileged_view_is_the_truth_of_this_moment():
    """Target, velocity, yaw rate, joints, rates, flow, time left and target, in the true body frame, without noise."""
    env, state = raft(**ROUGH)
    state = env.step(state, push(f0=(0.01, 0.02, 0.1)))
    q, v = np.asarray(state.fish.q, float), np.asarray(state.fish.v, float)
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    body = lambda a: np.stack([c * a[:, 0] + s * a[:, 1], c * a[:, 1] - s * a[:, 0]], -1)
    goal = body(np.asarray(state.target) - q[:, :2])
    left = np.full((6, 1), (LIMIT - 1) / LIMIT)
    expected = [goal, body(v[:, :2]), v[:, 2:3], q[:, 3:], v[:, 3:], body(np.asarray(state.current.mean)), left, goal]
    np.testing.assert_allclose(state.privileged, np.concatenate(expected, -1), atol=1e-5)
    assert state.privileged.shape == (6, env.n_privileged)


def test_memory_is_newest_first_with_the_actions_between():
    """[o_t, a_t-1, o_t-1, a_t-2, o_t-2]; a fresh episode repeats its first look, with no action before it."""
    env, state = raft(memory=3, noise=0.0, turbulence="none")
    assert env.n_input == 3 * 11 + 2 * 3 == state.obs.shape[1]
    looks, actions = [np.asarray(state.obs)[:, :11]], []
    np.testing.assert_array_equal(
        state.obs, np.concatenate([looks[0], 0 * looks[0][:, :3], looks[0]] + [0 * looks[0][:, :3], looks[0]], -1)
    )
    rng = np.random.default_rng(1)
    for _ in range(4):
        actions.append(rng.uniform(-0.02, 0.02, (6, 3)).astype(np.float32))
        state = env.step(state, jnp.asarray(actions[-1]))
        looks.append(np.asarray(state.obs)[:, :11])
    assert not np.any(state.terminated)
    np.testing.assert_array_equal(state.obs, np.concatenate([looks[4], actions[3], looks[3], actions[2], looks[2]], -1))
    after = env.step(state, push(f2=(1, 0, 0)))
    first = np.asarray(after.obs)[2, :11]
    np.testing.assert_array_equal(after.obs[2], np.concatenate([first, np.zeros(3), first, np.zeros(3), first]))
    np.testing.assert_array_equal(after.final_obs[2, 11:14], [1, 0, 0])
    np.testing.assert_array_equal(after.final_obs[2, 14:25], looks[4][2])


@pytest.mark.parametrize(("hidden", "blank"), [(("velocity",), [2, 3]), (("yaw_rate", "joint_rate"), [4, 8, 9, 10])])
def test_hidden_groups_are_zero_and_the_others_are_not(hidden, blank):
    _, state = raft(hide=hidden, turbulence="none")
    assert np.flatnonzero(~np.asarray(state.obs).any(0)).tolist() == blank


@dataclass(frozen=True, kw_only=True)
class Brief(StationHoldReference):
    """Episodes of which those with the least of the fourth draw last 0.6 s."""

    seconds: float = 2.0

    def launch(self, xp, uniforms):
        return super().launch(xp, uniforms)._replace(seconds=xp.where(uniforms[:, 3] < 0.5, 0.6, self.seconds))


def test_episodes_of_an_own_task_end_after_their_own_seconds():
    env, action, ends = environment(course=Brief), np.zeros((64, 3)), []
    envs = FishVectorEnv(64, task=Brief, engine="batch")
    state, step = env.reset(KEY, 64), jax.jit(env.step)
    envs.reset(seed=0)
    short = envs.episodes.scenario.launch.seconds == 0.6
    for _ in range(10):
        state = step(state, action)
        ends.append((int(state.truncated.sum()), envs.step(action)[3]))
    assert not ends[1][0] and 16 < ends[2][0] < 48 and 16 < short.sum() < 48
    assert not ends[1][1].any() and (ends[2][1] == short).all() and ends[9][1][~short].all()
    timed = suite.load("fish", Brief, task_kwargs={"random": 1})
    lasted = set()
    for _ in range(8):
        timed.reset()
        steps = 1 + next(k for k in range(20) if timed.step(np.zeros(3)).last())
        lasted.add((steps, float(timed.task.scenario.launch.seconds[0])))
    assert lasted == {(3, 0.6), (10, 2.0)}
