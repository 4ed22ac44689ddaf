"""The tasks as pure functions: reward, observation and starts by hand; what the fish must never see; late cameras."""

import re
from dataclasses import fields, replace
from inspect import signature
from math import pi, radians
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raft import KEY, Raft

from fishmj import engines, mjcf, suite
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.tasks import station_hold as task
from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.episode import Episodes, TaskOptions, TaskSpec
from fishmj.tasks.gym.fish_env import LARGEST, FishEnv, FishVectorEnv
from fishmj.tasks.reference import COURSES, EpisodeStart, FigureEightReference, eight, path_length

ROBOT = mjcf.load_robot("fish")
QUIET = dict(noise=0.0, turbulence="none")


def still(n=1, **setting):
    """(rules, scenario) of n nominal fish in still water."""
    rules = TaskSpec("station_hold", TaskOptions(**{**QUIET, "randomisation": 0.0, "flow_speed": 0.0, **setting}))
    return rules, rules.scenario(rules.draws(np.random.default_rng(1), n))


# ---- reward ----


def test_half_the_goal_reward_is_left_at_the_arrival_radius():
    rest = np.zeros((3, 10, 3))
    np.testing.assert_allclose(task.reward(np, np.array([0.0, 0.1, 0.9]), rest), [1.0, 0.5, 0.1], atol=1e-12)


def test_a_cruise_at_1_hz_and_30_degrees_costs_0_08_a_step():
    t = np.arange(50) * 0.02
    rates = radians(30) * 2 * pi * np.cos(2 * pi * t)[None, :, None] * np.ones(3)
    cost = 1.0 - task.reward(np, np.zeros(1), rates)
    np.testing.assert_allclose(cost, 0.005 * 1.5 * (radians(30) * 2 * pi) ** 2, rtol=1e-12)
    assert 0.080 < cost[0] < 0.083


def test_the_reward_weights_are_the_ones_given():
    rates = np.full((1, 4, 3), 2.0)
    np.testing.assert_allclose(task.reward(np, np.array([0.2]), rates, wG=2.0, wD=5.0, wS=0.01), 2.0 / 2.0 - 0.01 * 12.0)


# ---- observation, action, end ----


def test_the_observation_by_hand():
    """Heading north at (1, 2), 0.5 m/s north, turning at 0.2 rad/s; the target is 1 m ahead and 0.5 m to the left."""
    t = (np.arange(task.history_length(ROBOT)) - task.history_length(ROBOT) + 1) * 0.02
    history = np.stack([np.full_like(t, 1.0), 2.0 + 0.5 * t, pi / 2 + 0.2 * t], -1)[None]
    joint, rate = np.array([[0.1, 0.2, 0.3]]), np.array([[1.0, 2.0, 3.0]])
    seen = task.observe(np, ROBOT, history, np.array([0]), joint, rate, np.array([[0.5, 3.0]]), np.zeros((1, 11)))
    np.testing.assert_allclose(seen[0], [1.0, 0.5, 0.5, 0.0, 0.2, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0], atol=1e-12)


def test_noise_has_the_scale_of_each_sensor():
    history = np.zeros((1, task.history_length(ROBOT), 3))
    zero, target = np.zeros((1, 3)), np.zeros((1, 2))
    seen = task.observe(np, ROBOT, history, np.array([0]), zero, zero, target, np.ones((1, 11)))[0]
    np.testing.assert_allclose(seen, [0.005, 0.005, 0.02, 0.02, 0.05, *[radians(0.3)] * 3, 0.1, 0.1, 0.1])


@pytest.mark.parametrize(("path", "first"), [("linear", 0.1), ("move_time", 0.1), ("hold", 1.0)])
def test_an_action_becomes_ten_bus_commands(path, first):
    robot = TaskOptions(command_path=path).fish()
    commands = task.chunk(np, robot, np.zeros((1, 3)), np.array([[1.0, -0.5, 7.0]]))
    assert commands.shape == (1, 10, 3)
    np.testing.assert_allclose(commands[0, -1], [pi / 3, -pi / 6, pi / 3])
    np.testing.assert_allclose(commands[0, 0, 0], first * pi / 3)


def test_the_domain_ends_at_two_metres():
    poses = np.array([[2.0, -2.0, 9.0], [2.001, 0.0, 0.0], [0.0, -2.001, 0.0]])
    assert task.outside(np, poses).tolist() == [False, True, True]


class Loud:
    """A task whose reward is the largest action that it sees."""

    seconds = 2.0

    def launch(self, xp, uniforms):
        """The paper's starts."""
        return EpisodeStart(task.draw_start(xp, uniforms), 0.0 * uniforms[:, 0])

    def target(self, xp, launch, t):
        """It stays."""
        return launch.start.target + 0.0 * t[:, None]

    def reward(self, xp, step):
        """See above."""
        return xp.max(xp.abs(step.action), -1)


def test_a_reward_sees_the_action_that_acts():
    """Clipped to [-1, 1], in Gymnasium, dm_control and JAX."""
    loud, env, state = np.array([3.0, -5.0, 0.5]), suite.load("fish", Loud), StationHold(ROBOT, Raft(), Options(course=Loud))
    env.reset()
    assert env.step(loud).reward == 1.0
    envs = FishVectorEnv(2, Loud)
    envs.reset(seed=0)
    assert envs.step(np.stack([loud, 0.1 * loud]))[1].tolist() == [1.0, 0.5]
    after = state.step(state.reset(KEY, 2), jnp.asarray(np.stack([loud, 0.1 * loud]), jnp.float32))
    assert np.asarray(after.reward).tolist() == [1.0, 0.5]


# ---- draws ----


@given(st.integers(0, 2**31))
def test_starts_stay_in_the_papers_ranges(seed):
    start = task.draw_start(np, np.random.default_rng(seed).random((50, task.N_START)))
    assert np.abs(start.pose[:, :2]).max() <= 1.5 and np.abs(start.target).max() <= 1.5
    assert np.abs(start.pose[:, 2]).max() <= pi and np.abs(start.direction).max() <= pi
    assert start.speed.min() >= 0.1 and start.speed.max() <= 0.3


def test_randomisation_spans_its_ranges_and_is_nominal_at_zero_strength():
    u = np.random.default_rng(0).random((4000, task.n_fish(ROBOT)))
    fish, camera = task.draw_fish(np, ROBOT, u, 1.0)
    nominal = engines.nominal_params(ROBOT, 1)
    for values, middle, width in ((fish.mass, 1.0, 0.10), (fish.kp, nominal.kp[0, 0], 0.8), (fish.zero, 0.0, radians(5))):
        low, high = values.min() - middle, values.max() - middle
        assert -1.0001 * width <= low < -0.97 * width and 0.97 * width < high <= 1.0001 * width
    assert set(np.unique(fish.delay)) == set(range(5, 31)) and set(np.unique(camera)) == {2, 3, 4, 5}
    plain, _ = task.draw_fish(np, ROBOT, u[:3], 0.0)
    for got, want in zip(plain, engines.nominal_params(ROBOT, 3), strict=True):
        np.testing.assert_allclose(got, want)


# ---- courses ----


def test_the_figure_eight_has_the_papers_length_and_constant_speed():
    assert abs(path_length() - constant("experiments", "figure8_length")) < 5e-4
    course = FigureEightReference()
    launch = course.launch(np, np.full((1, 7), 0.3))
    t = np.linspace(0, course.seconds, 20001)
    points = np.concatenate([course.target(np, launch, np.array([x])) for x in t])
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t), 0.3, rtol=2e-3)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-9)
    assert abs(course.seconds - 61.0) < 0.1


def test_the_direction_of_the_figure_eight_is_its_tangent():
    s = np.linspace(0, path_length(), 300)
    (point, heading), (ahead, _) = eight(np, s), eight(np, s + 1e-3)
    np.testing.assert_allclose((ahead - point) / 1e-3, np.stack([np.cos(heading), np.sin(heading)], -1), atol=5e-3)


def test_courses_are_the_same_in_numpy_and_jax():
    u = np.random.default_rng(3).random((64, task.N_START))
    for kind in COURSES.values():
        course, t = kind(), np.linspace(0, 40, 64)
        with jax.enable_x64(True):
            there = course.launch(jnp, jnp.asarray(u))
            moved = np.asarray(course.target(jnp, there, jnp.asarray(t)))
        here = course.launch(np, u)
        np.testing.assert_allclose(here.start.pose, there.start.pose, atol=1e-9)
        np.testing.assert_allclose(course.target(np, here, t), moved, atol=1e-9)


@pytest.mark.parametrize("angle", [-pi, -pi / 2, 0.0, pi / 2])
@pytest.mark.parametrize("direction", [None, 0.7])
def test_the_angle_of_attack_is_measured_from_upstream(angle, direction):
    rules = TaskSpec("angle_of_attack", TaskOptions(flow_direction=direction), angle=angle)
    start = rules.scenario(rules.draws(np.random.default_rng(0), 9)).launch.start
    upstream = start.direction + pi
    np.testing.assert_allclose(np.exp(1j * (start.pose[:, 2] - upstream)), np.exp(1j * angle), atol=1e-12)
    np.testing.assert_allclose(start.pose[:, :2], start.target)
    np.testing.assert_allclose(start.speed, 0.2)


@pytest.mark.parametrize("control_dt", [0.2, 0.1, 0.04, 0.02])
def test_an_episode_lasts_30_s_at_every_control_step(control_dt):
    rules = TaskSpec("station_hold", TaskOptions(control_dt=control_dt))
    assert rules.limit * control_dt == pytest.approx(30.0) and rules.ticks == round(control_dt / 0.02)


def test_a_setting_that_cannot_be_is_one_clear_error():
    with pytest.raises(UnknownName, match="Did you mean 'gust'"):
        TaskOptions(turbulence="gusts")
    with pytest.raises(ConfigError, match="flow_speed = -0.1"):
        TaskOptions(flow_speed=-0.1)
    with pytest.raises(ConfigError, match="nearest valid control_dt: 0.04"):
        TaskSpec("station_hold", TaskOptions(control_dt=0.05))
    with pytest.raises(UnknownName, match="station_hold"):
        TaskSpec("station_hol", TaskOptions())


# ---- what the fish must never see ----


def turned(scenario, angle):
    """The same world, turned about its origin."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    start, current = scenario.launch.start, scenario.current
    pose = np.concatenate([start.pose[:, :2] @ turn.T, start.pose[:, 2:] + angle], -1)
    start = start._replace(pose=pose, target=start.target @ turn.T, direction=start.direction + angle)
    current = current._replace(mean=current.mean @ turn.T, turn=current.turn @ turn.T)
    return scenario._replace(launch=scenario.launch._replace(start=start), current=current)


@pytest.mark.parametrize("turbulence", ["default", "gust", "vortex_street"])
@pytest.mark.parametrize("angle", [0.3, pi / 2, -2.5])
def test_turning_the_world_changes_nothing_that_the_policy_sees(turbulence, angle):
    rules = TaskSpec("station_hold", TaskOptions(turbulence=turbulence, intensity=0.1))
    rng = np.random.default_rng(11)
    scenario = rules.scenario(rules.draws(rng, 4))
    here, there = (Episodes(rules, "batch", 4) for _ in range(2))
    here.begin(scenario)
    there.begin(turned(scenario, angle))
    for _ in range(20):
        action, normals = rng.uniform(-1, 1, (4, 3)), rng.standard_normal((4, 11))
        one, two = here.step(action), there.step(action)
        np.testing.assert_allclose(there.observation(normals), here.observation(normals), rtol=0, atol=1e-7)
        np.testing.assert_allclose(two.reward, one.reward, rtol=0, atol=1e-7)
    assert np.abs(there.fish.q[:, :2] - here.fish.q[:, :2]).max() > 0.1  # and yet they are elsewhere


def test_the_flow_reaches_the_observation_only_by_moving_the_fish():
    """At the first look nothing has moved yet: the observation is the same in every flow."""
    looks = []
    for speed, direction in ((0.0, 0.0), (0.3, 1.0), (0.1, -2.0)):
        rules = TaskSpec("station_hold", TaskOptions(flow_speed=speed, flow_direction=direction, noise=0.0, intensity=0.1))
        episodes = Episodes(rules, "batch", 3)
        episodes.begin(rules.scenario(rules.draws(np.random.default_rng(2), 3)))
        looks.append(episodes.observation(np.zeros((3, 11))))
    np.testing.assert_array_equal(looks[0], looks[1])
    np.testing.assert_array_equal(looks[0], looks[2])


def test_camera_jump_appears_after_its_latency_and_the_filter_spreads_it():
    rules, scenario = still(control_dt=0.02)
    late, window = int(scenario.camera[0]), ROBOT.timing.velocity_window
    assert late == 4  # 65 ms, in ticks of 20 ms
    episodes = Episodes(rules, "batch", 1)
    scenario.launch.start.pose[:] = 0.0
    scenario.launch.start.target[:] = [1.0, 0.0]
    episodes.begin(scenario)
    looks = []
    for k in range(20):
        if k == 3:
            episodes.fish.q[:, 0] += 0.1
        episodes.step(np.zeros((1, 3)))
        looks.append(episodes.observation(np.zeros((1, 11)))[0])
    x, vx = np.array(looks)[:, 0], np.array(looks)[:, 2]
    np.testing.assert_allclose(x[: 3 + late], 1.0, atol=1e-9)
    np.testing.assert_allclose(x[3 + late :], 0.9, atol=1e-9)
    moving = np.flatnonzero(np.abs(vx) > 1e-6)
    assert moving.tolist() == list(range(3 + late, 3 + late + window - 1))
    assert vx.sum() * 0.02 == pytest.approx(0.1)  # the filter spreads the jump, and loses nothing of it


# ---- the manual ----

PAGE = (Path(__file__).parent.parent / "docs" / "train" / "tasks.md").read_text(encoding="utf-8")
MANUAL = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_the_table_of_the_manual_is_what_a_learner_sees_and_does():
    """Names, order, columns, noise, bounds and divisors of observation, action and privileged view."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line.startswith("| ")]
    ends = lambda groups: np.cumsum([*groups.values()])
    once = lambda groups, values: [values[end - width] for width, end in zip(groups.values(), ends(groups), strict=True)]
    spans, more = task.spans(3), task.privileged_spans(3)
    expected = {
        "observation": (spans, once(spans, task.noise_scale(ROBOT)), [*LARGEST], once(spans, task.input_scale(3))),
        "action": ({"joint": 3}, [0.0], [1.0], [1.0]),
        "privileged": (more, [0.0] * len(more), [""] * len(more), once(more, task.privileged_scale(3))),
    }
    for vector, (groups, noise, bound, divisor) in expected.items():
        told = [row for row in rows if row[0] == vector]
        assert [row[2].strip("`") for row in told] == [*groups], vector
        first_last = [(end - width, end - 1) for width, end in zip(groups.values(), ends(groups), strict=True)]
        assert [row[1] for row in told] == [f"{a}-{b}" if b > a else f"{a}" for a, b in first_last], vector
        for column, values in ((5, noise), (6, bound), (7, divisor)):
            for row, value in zip(told, values, strict=True):
                assert row[column] == "" if value == "" else float(row[column]) == pytest.approx(value, rel=1e-3), row


def cells_under(heading: str) -> list[list[str]]:
    """Rows of the first table below a heading of the manual."""
    part = PAGE.split(f"{heading}\n", 1)[1].split("\n\n|", 1)[1].split("\n\n", 1)[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in part.splitlines()[2:]]


def test_the_table_of_options_says_who_takes_which():
    """Every field and argument of the three interfaces, and no other."""
    named = lambda *kinds: {name for kind in kinds for name in signature(kind).parameters if name not in ("options", "reward")}
    shared = {one.name for one in fields(TaskOptions)}
    station, options = named(StationHold) | {*task.WEIGHTS}, {one.name for one in fields(Options)}
    made = named(FishEnv, FishVectorEnv) - {"num_envs", "max_episode_steps", "task"}
    found: dict[str, set] = {"dm_control": set(), "Gymnasium": set(), "StationHold": set(), "Options": set(), "make_vec": set()}
    for names, where, *_ in cells_under("## Options"):
        for place in where.replace("all", "dm_control, Gymnasium").replace("`", "").split(", "):
            found[place] |= {*names.replace("`", "").split(", ")}
    assert found["dm_control"] == shared | {"random", "root", "solver", "hybrid"}
    assert found["Gymnasium"] | found["make_vec"] == shared | made and found["make_vec"] == {"autoreset_mode"}
    assert found["StationHold"] == station and found["Options"] == options


def test_the_table_of_the_randomisation_has_the_constants():
    get = lambda key: constant("randomisation", key)
    spread = lambda key: f"±{100 * get(key):.0f} %"
    span = lambda key: "{:.0f} to {:.0f} ms".format(*(1000 * bound for bound in get(key)))
    assert [row[1] for row in cells_under("### Domain randomisation")] == [
        spread("mass"),
        f"{spread('kp')}, {spread('kd')}",
        f"±{get('zero_deg'):.0f} deg",
        f"{span('command_latency')}, {span('camera_latency')}",
    ]


def test_a_fish_whose_latency_is_not_drawn_draws_about_its_own():
    """Else a judgement of a slow robot would be that of a fast one, and the other way round."""
    drawn = {}
    for own in (0.0, 0.01, 0.06, 0.15):
        robot = replace(ROBOT, timing=replace(ROBOT.timing, command_latency=own, camera_latency=2 * own))
        fish, camera = task.draw_fish(np, robot, np.random.default_rng(0).uniform(size=(500, task.n_fish(robot))))
        delay = fish.delay * robot.timing.physics_dt
        drawn[own] = [round(float(x), 2) for x in (delay.min(), delay.max())], int(camera.min()), int(camera.max())
    paper = ([0.02, 0.12], 2, 5)  # also of 0, which stands for not measured
    assert drawn == {0.0: paper, 0.01: ([0.0, 0.06], 1, 3), 0.06: ([0.02, 0.12], 5, 8), 0.15: ([0.1, 0.2], 14, 17)}


def test_the_privileged_view_has_its_groups_in_their_order():
    env = StationHold(ROBOT, Raft(), Options(noise=0.0, turbulence="none"))
    state = env.step(env.reset(KEY, 2), jnp.asarray([[0.01, 0.02, 0.0]] * 2))
    assert state.privileged.shape == (2, sum(task.privileged_spans(3).values())) == (2, env.n_privileged)
    parts = dict(zip(task.privileged_spans(3), np.split(np.asarray(state.privileged), [2, 4, 5, 8, 11, 13, 14], 1), strict=True))
    np.testing.assert_array_equal(parts["near"], parts["target"])
    np.testing.assert_allclose(parts["time_left"], (env.limit - 1) / env.limit)
    np.testing.assert_allclose(np.hypot(*parts["flow"].T), np.hypot(*np.asarray(state.current.mean).T), rtol=1e-6)
    np.testing.assert_allclose(parts["joint"], state.fish.q[:, 3:])
    np.testing.assert_allclose(np.hypot(*parts["target"].T), state.distance, rtol=1e-5)


@pytest.mark.parametrize("example", MANUAL, ids=["dm_control", "gymnasium", "vector", "jax"])
def test_the_examples_of_the_manual_run(example):
    exec(compile(example, "docs/train/tasks.md", "exec"), {})  # noqa: S102  our own text
