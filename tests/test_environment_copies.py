"""Copies and pickles of environments in the middle of an episode go on as the original does, to the bit."""

import copy
import multiprocessing
import pickle  # noqa: TID251  in memory, between processes; no file

import gymnasium
import numpy as np
import pytest

from fishmj import engines, suite
from fishmj.base import errors
from fishmj.base.errors import ConfigError, SimDiverged, UnknownName
from fishmj.engines.lbm import LbmEngine as LbmEngine
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.dm_control.physics import SolverPhysics
from fishmj.tasks.gym.fish_env import FishEnv, FishVectorEnv
from fishmj.water.flow import Flow

ID = "fishmj/StationHold-v0"
again = lambda thing: pickle.loads(pickle.dumps(thing))  # noqa: S301  our own
WAYS = {"deepcopy": copy.deepcopy, "pickle": again}
ALL_WAYS = pytest.mark.parametrize("way", WAYS)


def swim(env, steps, seed=0):
    """Observations and rewards under random actions."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(steps):
        seen, reward, terminated, truncated, info = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
        out.append(np.concatenate([np.ravel(seen), np.ravel(reward), np.ravel(info["distance"]), np.ravel(truncated)]))
        if not isinstance(env, FishVectorEnv) and (terminated or truncated):
            out.append(np.concatenate([env.reset()[0], np.zeros(3)]))
    return np.array(out)


@ALL_WAYS
@pytest.mark.parametrize("engine", ["compiled", "batch", pytest.param("planar", marks=pytest.mark.slow)])
def test_a_gymnasium_environment_goes_on_alike(engine, way):
    env = gymnasium.make(ID, engine=engine, seconds=3.0)
    env.reset(seed=3)
    swim(env, 5)
    twin = WAYS[way](env)
    twin_swim = swim(twin, 12)  # alone: the original stays where it is
    np.testing.assert_array_equal(swim(env, 12), twin_swim)


@ALL_WAYS
def test_a_vector_environment_goes_on_alike(way):
    envs = FishVectorEnv(300, seconds=2.0, autoreset_mode="SameStep")  # several threads
    envs.reset(seed=3)
    swim(envs, 5)
    twin = WAYS[way](envs)
    np.testing.assert_array_equal(swim(twin, 7), swim(envs, 7))


@ALL_WAYS
@pytest.mark.parametrize("make", [FishEnv, FishVectorEnv])
def test_environment_that_has_drawn_a_picture_can_be_copied(make, way):
    pytest.importorskip("cv2")
    env = make(engine="batch", render_mode="rgb_array")
    env.reset(seed=1)
    picture = np.asarray(env.render())
    np.testing.assert_array_equal(np.asarray(WAYS[way](env).render()), picture)


@pytest.mark.slow  # compiles
@ALL_WAYS
def test_a_fish_with_effects_goes_on_alike(way):
    env = FishEnv(effects=("tether", "gear_backlash"))
    env.reset(seed=1)
    swim(env, 4)
    twin = WAYS[way](env)
    np.testing.assert_array_equal(swim(twin, 5), swim(env, 5))


@ALL_WAYS
@pytest.mark.parametrize("root", ["planar", "free"])
def test_a_dm_control_environment_goes_on_alike(root, way):
    env = suite.load("fish", "station_hold", {"random": 1, "root": root, "seconds": 1.2}, {"flat_observation": True})
    rng = np.random.default_rng(0)
    env.reset()
    for action in rng.uniform(-1, 1, (3, 3)):
        env.step(action)
    twin = WAYS[way](env)
    actions = rng.uniform(-1, 1, (6, 3))  # over an end and a reset
    alone = [twin.step(action) for action in actions]
    for action, other in zip(actions, alone, strict=True):
        step = env.step(action)
        np.testing.assert_array_equal(step.observation["observations"], other.observation["observations"])
        assert (step.reward, step.discount, step.step_type) == (other.reward, other.discount, other.step_type)
    assert twin.physics.legacy_step is env.physics.legacy_step


@ALL_WAYS
def test_a_tank_of_the_flow_solver_is_not_copied(way):
    robot = engines.in_water(load_robot("fish"), "structured")
    with pytest.raises(ConfigError, match="cannot be copied"):
        WAYS[way](LbmEngine(robot, [Flow()], domain="laptop", device="cpu"))
    with pytest.raises(ConfigError, match="cannot be copied"):
        WAYS[way](SolverPhysics.of(robot))


def _serve(pipe):
    env = pipe.recv()  # unpickles
    pipe.send(swim(env, 5))


@pytest.mark.slow
def test_a_pickle_goes_on_in_another_process():
    env = FishEnv()
    env.reset(seed=4)
    swim(env, 3)
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    worker = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs,))
    worker.start()
    ours.send(env)
    np.testing.assert_array_equal(ours.recv(), swim(env, 5))
    worker.join()


@pytest.mark.parametrize(
    "error",
    [
        UnknownName("task", "stations", ["station_hold"]),
        errors.MissingExtra("numba", "fast", "the engine"),
        errors.DescriptionError(["a", "b"]),
        SimDiverged("lost", time=3.0, states=[1]),
        ConfigError("no"),
        errors.StoreError("cut short"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_arrives_from_another_process_as_it_is(error):
    other = again(error)
    assert type(other) is type(error) and str(other) == str(error) and vars(other) == vars(error)
