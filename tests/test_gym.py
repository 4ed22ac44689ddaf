"""Gymnasium: the checkers, ends and resets, one trajectory on every road, pictures, faults."""

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import fishmj.tasks.gym
from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.tasks import env as functional
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import Draws
from fishmj.tasks.gym.fish_env import FishEnv, FishRenderer, FishVectorEnv

ROOT = Path(__file__).resolve().parent.parent
IDS = sorted(fishmj.tasks.gym.IDS)
ID = "fishmj/StationHold-v0"


@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_checker_finds_nothing_to_warn_of(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"fishmj.tasks.gym:{name}").unwrapped)


@pytest.mark.sb3
@pytest.mark.parametrize("name", IDS)
def test_stable_baselines_checker_passes(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gymnasium.make(f"fishmj.tasks.gym:{name}").unwrapped)


def test_the_name_with_its_module_works_in_a_fresh_process():
    code = (
        "import gymnasium, sys\n"
        f"env = gymnasium.make('fishmj.tasks.gym:{ID}'); vec = gymnasium.make_vec('{ID}', num_envs=2)\n"
        "print(env.spec.id, type(vec).__name__)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == [ID, "FishVectorEnv"]


@pytest.mark.parametrize(
    "imports", ["import fishmj, gymnasium", "import gymnasium, fishmj", "import fishmj.base.names; from gymnasium import vector"]
)
def test_the_plain_name_is_there_once_both_are_imported_in_any_order(imports):
    code = f"{imports}\nimport gymnasium, sys\nprint(gymnasium.spec('{ID}').id, 'mujoco' in sys.modules, 'jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == [ID, "False", "False"]


def test_importing_fishmj_imports_no_gymnasium():
    code = "import fishmj, sys; print('gymnasium' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"


def test_registering_twice_changes_nothing():
    before = dict(gymnasium.registry)
    fishmj.tasks.gym.register()
    assert dict(gymnasium.registry) == before


# ---- one trajectory on every road ----


@pytest.fixture(scope="module")
def reference():
    """20 steps of the functional JAX environment, 4 randomised fish in turbulence: (draws, actions, looks, rewards, ends)."""
    env = functional.StationHold(mjcf.load_robot("fish"), "planar", functional.Options(noise=0.0, intensity=(0.05, 0.05)))
    key, n = jax.random.PRNGKey(5), 4
    state = env.reset(key, n)
    keys = jax.random.split(jax.random.split(key, 3)[1], 4)
    sizes = (task.N_START, task.N_FLOW + 1, task.n_fish(env.robot))
    draws = Draws(*(np.asarray(jax.random.uniform(k, (n, size)), float) for k, size in zip(keys[:3], sizes, strict=True)))
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (20, n, 3)).astype(np.float32)
    looks, rewards, ends = [np.asarray(state.obs)], [], []
    for action in actions:
        state = env.step(state, jnp.asarray(action))
        looks.append(np.asarray(state.final_obs))
        rewards.append(np.asarray(state.reward))
        ends.append(np.asarray(state.terminated | state.truncated))
    assert not np.any(ends)  # no fish restarts under way
    return draws, actions, np.array(looks), np.array(rewards), np.array(ends)


TOLERANCE = 1e-4  # float32 against float64 over 20 steps of swimming; largest seen 1.2e-5, in a yaw rate [rad/s]


@pytest.mark.parametrize("engine", ["batch", "compiled"])
def test_the_vector_environment_equals_the_functional_one(reference, engine):
    if engine == "compiled":
        pytest.importorskip("numba")
    draws, actions, looks, rewards, ends = reference
    envs = FishVectorEnv(4, engine=engine, noise=0.0, intensity=0.05)
    envs.reset(seed=0)
    envs.episodes.begin(envs.rules.scenario(draws))
    np.testing.assert_allclose(envs.episodes.observation(np.zeros((4, 11))), looks[0], rtol=0, atol=1e-5)
    for k, action in enumerate(actions):
        seen, reward, terminated, truncated, _ = envs.step(action)
        np.testing.assert_allclose(seen, looks[k + 1], rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(reward, rewards[k], rtol=0, atol=TOLERANCE)
        np.testing.assert_array_equal(terminated | truncated, ends[k])


def test_the_single_environment_equals_the_functional_one(reference):
    draws, actions, looks, rewards, _ = reference
    env = FishEnv(engine="batch", noise=0.0, intensity=0.05)
    env.reset(seed=0)
    for fish in (0, 3):
        env.begin(env.rules.scenario(Draws(*(a[fish : fish + 1] for a in draws))))
        for k, action in enumerate(actions[:, fish]):
            seen, reward, *_ = env.step(action)
            np.testing.assert_allclose(seen, looks[k + 1, fish], rtol=0, atol=TOLERANCE)
            assert reward == pytest.approx(rewards[k, fish], abs=TOLERANCE)


def test_vector_env_row_equals_the_single_env_with_the_same_seed():
    """Noise, draws and restarts included."""
    envs = gymnasium.make_vec(ID, num_envs=3, seconds=1.0)
    rows, _ = envs.reset(seed=7)
    env = gymnasium.make(ID, seconds=1.0)
    seen, _ = env.reset(seed=9)
    np.testing.assert_array_equal(rows[2], seen)
    rng, restart = np.random.default_rng(0), False
    for _ in range(12):
        actions = rng.uniform(-1, 1, (3, 3)).astype(np.float32)
        rows, reward, terminated, truncated, _ = envs.step(actions)
        if restart:
            (seen, _), value, end = env.reset(), 0.0, (False, False)
        else:
            seen, value, *end, _ = env.step(actions[2])
        np.testing.assert_allclose(rows[2], seen, rtol=0, atol=1e-6)
        assert reward[2] == pytest.approx(value, abs=1e-9) and (terminated[2], truncated[2]) == tuple(end)
        restart = any(end)


# ---- ends and resets ----


def test_time_up_truncates_after_150_steps_and_leaving_terminates():
    env = gymnasium.make(ID, engine="batch", flow_speed=0.0)
    env.reset(seed=0, options={"pose": (0.0, 0.0, 0.0)})
    ends = [env.step(np.zeros(3, np.float32))[2:4] for _ in range(150)]
    assert ends == [(False, False)] * 149 + [(False, True)]
    env.reset(seed=0, options={"pose": (1.95, 0.0, 0.0), "speed": 0.3, "direction": 0.0})
    for _ in range(50):
        *_, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        if terminated:
            break
    assert terminated and not truncated and info["distance"] > 0.4 and env.unwrapped.episodes.fish.q[0, 0] > 2.0


def shortened(mode):
    """Three fish, one of which leaves the domain in the first second, all of which end after two."""
    envs = FishVectorEnv(3, engine="batch", seconds=2.0, autoreset_mode=mode, turbulence="none", noise=0.0)
    envs.reset(seed=1, options={"pose": [(0, 0, 0), (1.98, 0, 0), (0, 0, 0)], "speed": 0.3, "direction": 0.0})
    return envs


def run(envs, steps):
    return [envs.step(np.zeros((3, 3), np.float32)) for _ in range(steps)]


def test_fish_that_restart_make_no_strips_of_their_robot(monkeypatch):
    """They took a millisecond for each drawn fish, more than half of a step of many fish in a water with a learnt force."""
    envs = FishVectorEnv(4, engine="compiled", water="fitted")
    made = []
    monkeypatch.setattr(engines.extensions.chain, "chain_of", lambda robot: made.append(robot))
    first, _ = envs.reset(seed=0)
    second, _ = envs.reset(seed=1)
    assert not made and not np.array_equal(first, second)


def test_next_step_autoreset_restarts_in_the_step_after_the_end():
    envs = shortened(AutoresetMode.NEXT_STEP)
    steps = run(envs, 12)
    first = next(k for k, s in enumerate(steps) if s[2][1])
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP and first < 9
    after = steps[first + 1]
    assert after[1][1] == 0.0 and not after[2][1] and not after[3][1]
    assert np.abs(after[0][1] - steps[first][0][1]).max() > 0.05  # a fresh episode is seen
    assert steps[9][3].tolist() == [True, False, True] and envs.episodes.count.tolist() == [1, 12 - first - 2, 1]


def test_same_step_autoreset_hands_over_the_last_observation():
    envs = shortened("SameStep")
    for step in run(envs, 10):
        seen, _, terminated, truncated, info = step
        over = terminated | truncated
        assert ("final_obs" in info) == over.any()
        if over.any():
            assert info["_final_obs"].tolist() == over.tolist()
            for i in np.flatnonzero(over):
                assert info["final_obs"][i].shape == (11,) and np.abs(info["final_obs"][i] - seen[i]).max() > 0.05
                assert info["final_info"]["distance"][i] != info["distance"][i] and info["power"][i] == 0
    assert truncated.tolist() == [True, False, True] and envs.episodes.count[0] == 0


def test_without_autoreset_a_mask_restarts_the_chosen_fish():
    envs = shortened("Disabled")
    run(envs, 1)
    mask = np.array([True, False, False])
    seen, _ = envs.reset(seed=[4, None, None], options={"reset_mask": mask})
    assert envs.episodes.count.tolist() == [0, 1, 1] and envs.single_observation_space.contains(seen[0])


def test_reset_options_place_the_fish_the_target_and_the_flow():
    env = FishEnv(engine="batch", noise=0.0, turbulence="none")
    seen, info = env.reset(
        seed=0, options={"pose": (0.5, 0.0, np.pi), "target": (0.0, 0.1), "speed": 0.25, "direction": np.pi / 2}
    )
    np.testing.assert_allclose(seen[:2], [0.5, -0.1], atol=1e-6)
    assert info["distance"] == pytest.approx(np.hypot(0.5, 0.1))
    np.testing.assert_allclose(env.episodes.scenario.current.mean, [[0.0, 0.25]], atol=1e-12)


def test_info_and_observation_say_nothing_of_the_flow():
    env = FishEnv(engine="batch")
    _, info = env.reset(seed=0)
    assert set(info) == {"distance", "power", "diverged"} == set(env.step(np.zeros(3))[4])


# ---- wrong use, and faults ----


def test_wrong_use_is_one_clear_error():
    with pytest.raises(ConfigError, match="unknown option 'turbulance'"):
        FishEnv(turbulance="gust")
    with pytest.raises(UnknownName, match="station_hold"):
        FishEnv(task="station")
    with pytest.raises(ConfigError, match="autoreset_mode = 'never'"):
        FishVectorEnv(2, autoreset_mode="never")
    env = FishEnv(engine="batch")
    with pytest.raises(ConfigError, match="unknown option 'position'"):
        env.reset(options={"position": (0, 0)})
    with pytest.raises(ConfigError, match=r"pose = \(0, 0\); expected shape \(3,\)"):
        env.reset(options={"pose": (0, 0)})
    with pytest.raises(ConfigError, match="sets target itself"):
        FishEnv(task="figure_eight", engine="batch").reset(options={"target": (0, 0)})
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="expected finite"):
        env.step(np.array([0.0, np.nan, 0.0]))


class Breaking:
    """An engine whose fish number 1 leaves the finite numbers in its second step."""

    def __init__(self):
        self.inner, self.calls = engines.make("batch", engines.in_water(mjcf.load_robot("fish"))), 0

    def advance(self, state, *rest):
        self.calls += 1
        fish, trace = self.inner.advance(state, *rest)
        if self.calls == 2:
            fish.q[1] = trace.pose[1] = trace.rate[1] = np.nan
        return fish, trace


@pytest.mark.parametrize("engine", ["nan", "batch"])
def test_fault_01_a_diverged_fish_is_dropped_and_the_others_swim_on(engine):
    envs = FishVectorEnv(3, engine=Breaking() if engine == "nan" else engine, turbulence="none")
    twin = FishVectorEnv(3, engine="batch" if engine == "nan" else engine, turbulence="none")
    actions = np.full((3, 3), 0.3, np.float32)
    for e in (envs, twin):
        e.reset(seed=3)
        e.step(actions)
    if engine == "batch":
        envs.episodes.fish.v[1] = 1e12
    seen, reward, terminated, truncated, info = envs.step(actions)
    want, *_ = twin.step(actions)
    assert info["diverged"].tolist() == truncated.tolist() == [False, True, False] and not terminated.any()
    assert np.isfinite(seen).all() and reward[1] == 0.0
    np.testing.assert_allclose(seen[[0, 2]], want[[0, 2]], rtol=0, atol=1e-4)
    after = [envs.step(actions) for _ in range(3)][-1]
    assert not after[4]["diverged"].any() and np.isfinite(after[0]).all()


# ---- pictures ----


def test_a_picture_shows_fish_target_and_tank_where_they_are():
    pytest.importorskip("cv2")
    env = FishEnv(engine="batch", render_mode="rgb_array", turbulence="none")
    env.reset(seed=0, options={"pose": (-1.0, 1.0, 0.0), "target": (1.0, -1.0)})
    image = env.render()
    assert image.shape == (480, 480, 3) and image.dtype == np.uint8
    assert image[360, 360, 0] > 200 > image[360, 360, 2]  # the target, red, south-east
    assert np.ptp(image[100:140, 80:160].reshape(-1, 3), axis=0).max() > 80  # the fish, north-west
    water = image[340:380, 80:160].reshape(-1, 3).astype(int)  # south-west: tiles only
    assert (np.ptp(water, axis=0) < 90).all() and (water[:, 2] > water[:, 0] + 50).all()
    envs = FishVectorEnv(2, engine="batch", render_mode="rgb_array")
    envs.reset(seed=0)
    assert [frame.shape for frame in envs.render()] == [(480, 480, 3)] * 2


def test_a_running_episode_is_drawn_as_a_film_of_it_is():
    """The same water, target and fish, pixel by pixel, as a film at this scale and place; trail, flow and words left out."""
    pytest.importorskip("cv2")
    from synthetic import swim

    from fishmj.view.replay.video import TopView

    film, drawn = TopView([swim(2.0)]), FishRenderer(mjcf.load_robot("fish"))
    film.view, film.still = drawn.view, drawn.view.water()
    for extra in ("_trail", "_wind", "_chart", "_words"):
        setattr(film, extra, lambda *_: None)
    track = film.tracks[0]
    assert np.array_equal(drawn.draw(track.q[50], track.target[50]), film.frame(1.0)[..., ::-1])
    there, away = (drawn.draw([0.5, y, 0, 0, 0, 0], np.array([0.5, 0.0])) for y in (0.05, 0.5))
    assert there[240, 300 + 12, 1] > 180 > away[240, 300 + 12, 1], "the ring is green around a fish that has arrived"
