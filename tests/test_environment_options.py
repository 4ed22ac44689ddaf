"""Options of every environment that cannot be: one typed line that names the option and what is allowed, never a raw error."""

import sys

import jax
import numpy as np
import pytest
from raft import KEY, ROBOT, Raft, environment, push

from fishmj import engines, suite
from fishmj.base.errors import ConfigError, FishmjError, UnknownName
from fishmj.evaluate.protocol import trials
from fishmj.sim import Sim
from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.episode import TaskOptions, TaskSpec
from fishmj.tasks.gym.fish_env import FishEnv, FishVectorEnv
from fishmj.water.flow import Flow

NAN, TASK = float("nan"), "station_hold"
fish = lambda name=TASK, kwargs=None, environment_kwargs=None: suite.load("fish", name, kwargs, environment_kwargs)
begun = lambda env: (env.reset(seed=0), env)[1]
station = lambda *given, **named: StationHold(ROBOT, *given, **named)

JAX = [
    (lambda: Options(intensity="a"), "intensity = 'a'; expected a number from 0 to 1, or two bounds"),
    (lambda: Options(intensity=(0.1,)), r"intensity = \(0.1,\)"),
    (lambda: Options(intensity=(0.2, 0.1)), "intensity"),
    (lambda: Options(intensity=True), "intensity = True"),
    (lambda: Options(noise="a"), "noise = 'a'; expected a number from 0 to 100"),
    (lambda: Options(noise=(1, 2)), "noise"),
    (lambda: Options(randomisation=NAN), "randomisation = nan"),
    (lambda: Options(randomisation=1.1), "randomisation = 1.1; expected a number from 0 to 1"),
    (lambda: Options(memory=1.5), "memory = 1.5; expected a whole number"),
    (lambda: Options(memory=True), "memory"),
    (lambda: Options(hide="velocity"), "hide = 'velocity'; expected a tuple of names"),
    (lambda: Options(hide=("speed",)), "unknown observation group 'speed'.*Known: joint"),
    (lambda: Options(effects="tether"), "effects = 'tether'"),
    (lambda: Options(turbulence=["gust"]), "turbulence.*Known: default"),
    (lambda: Options(box=0), "box.*Known: judge"),
    (lambda: station(Raft(), Options(course=3)), "task int"),
    (lambda: station(Raft(), Options(course="eight")), "unknown task 'eight'"),
    (lambda: station(Raft(), {"noise": 0}), r"expected fishmj.tasks.env.Options\(...\)"),
    (lambda: StationHold("fisch"), "fisch"),
    (lambda: StationHold(3), "3"),
    (lambda: station("batch"), "engine batch cannot run inside jax.jit; choose compiled, planar or mjx"),
    (lambda: station("lbm"), "unknown engine 'lbm'"),
    (lambda: station(3), "engine = 3; expected one of planar, compiled"),
    (lambda: station(Raft(), wX=1.0), "unknown argument of StationHold 'wX'.*Known: command_path"),
    (lambda: station(Raft(), wG="a"), "wG = 'a'; expected a number from 0 up"),
    (lambda: station(Raft(), wG=NAN), "wG = nan"),
    (lambda: station(Raft(), wS=-0.1), "wS = -0.1; expected a number from 0 up"),
    (
        lambda: station(Raft(), Options(seconds=1.05)),
        "seconds = 1.05 s; expected a multiple of the control step of 0.2 s, such as 1 or 1.2",
    ),
    (lambda: environment().reset(KEY, 0), "n = 0; expected a whole number from 1"),
    (lambda: environment().reset(KEY, 2.5), "n = 2.5"),
    (lambda: environment().reset(0, 2), "key = 0; expected jax.random.key"),
    (lambda: environment().reset("a", 2), "key = 'a'"),
    (lambda: environment().reset(jax.random.split(KEY), 2), "key = Array"),
    (lambda: environment().reset(KEY, [2]), r"n = \[2\]"),
    (lambda: environment().step(environment().reset(KEY, 2), push(3)), r"expected an array \(2, 3\)"),
    (lambda: environment().step(environment().reset(KEY, 2), [[0, 0, 0]]), r"expected an array \(2, 3\)"),
    (lambda: environment().step(environment().reset(KEY, 2), "a"), r"action 'a'; expected an array \(2, 3\)"),
    (lambda: environment().step(environment().reset(KEY, 2), np.full((2, 3), None)), r"expected an array \(2, 3\)"),
    (lambda: environment().step(environment().reset(KEY, 2), np.zeros((2, 3), complex)), r"expected an array \(2, 3\)"),
    (lambda: environment().step(None, push(2)), r"state = None; expected fishmj.tasks.env.EnvState"),
]
TASKS = [
    (lambda: TaskOptions(turbulence="none", intensity=0.3), "intensity = 0.3 with turbulence none"),
    (lambda: TaskOptions(flow_exponent=2, flow_speed=0.2), "flow_exponent = 2 with flow_speed = 0.2"),
    (lambda: TaskOptions(flow_direction="west"), "flow_direction = 'west'; expected a number from -6.2832"),
    (lambda: TaskOptions(flow_speed="fast"), "flow_speed = 'fast'"),
    (lambda: TaskOptions(flow_speed=(0.3, 0.1)), "flow_speed"),
    (lambda: TaskOptions(seconds=(1, 2)), "seconds"),
    (lambda: TaskOptions(wG="a"), "wG"),
    (lambda: TaskOptions(command_path="cubic"), "unknown command path 'cubic'"),
    (lambda: TaskOptions(control_dt="x"), "control_dt"),
    (lambda: TaskOptions(effects="tether"), "effects"),
    (lambda: TaskOptions(robot=3).fish(), "3"),
    (lambda: TaskSpec(TASK, TaskOptions(seconds=0)), "seconds = 0 s; expected a multiple of the control step"),
    (lambda: TaskSpec(TASK, TaskOptions(seconds=1.05)), "seconds = 1.05 s; expected a multiple"),
    (lambda: TaskOptions(wD=-1.0), "wD = -1.0; expected a number from 0 up"),
    (lambda: TaskSpec("figure_eight", TaskOptions(), speed="x"), "speed = 'x'"),
    (lambda: TaskSpec("figure_eight", TaskOptions(), phase=NAN), "phase = nan"),
    (lambda: TaskSpec("angle_of_attack", TaskOptions(), angle="x"), "angle = 'x'"),
]
GYM = [
    (lambda: FishEnv(engine="bacth"), "Did you mean 'batch'"),
    (lambda: FishEnv(engine=3), "engine = 3; expected one of"),
    (lambda: FishEnv(render_mode="human"), "render_mode = 'human'"),
    (lambda: FishEnv(task=3), "task int"),
    (lambda: FishEnv(angle=1.0), "unknown option 'angle'; known: at_target, box"),
    (lambda: FishVectorEnv(2, randomisation=3), "randomisation = 3; expected a number from 0 to 1"),
    (lambda: FishVectorEnv(2.5), "num_envs = 2.5"),
    (lambda: FishVectorEnv("2"), "num_envs = '2'"),
    (lambda: FishVectorEnv(2, max_episode_steps=0), "max_episode_steps = 0"),
    (lambda: FishEnv().reset(options=[1]), "expected a dict"),
    (lambda: FishEnv().reset(options={"pose": "abc"}), "pose = 'abc'; expected shape"),
    (lambda: FishEnv().reset(options={"speed": -0.1}), "speed = -0.1; expected a number from 0 to 5"),
    (lambda: FishEnv().reset(options={"pose": (5, 5, 0)}), "expected a position inside the task's domain"),
    (lambda: FishEnv().reset(options={"target": (9, 0)}), "target = .*; expected a position inside the task's domain"),
    (lambda: begun(FishEnv()).step([[0], [0, 0], 0]), r"action = .*expected finite numbers of shape \(3,\)"),
    (lambda: begun(FishEnv()).step(np.zeros(3, complex)), r"action = .*expected finite numbers of shape \(3,\)"),
    (lambda: begun(FishEnv()).step(np.zeros((1, 3))), r"action = .* of shape \(1, 3\); expected finite numbers of shape \(3,\)"),
    (lambda: begun(FishEnv()).step([0, np.inf, 0]), r"action\[1\] = inf; expected finite numbers of shape \(3,\)"),
    (
        lambda: begun(FishVectorEnv(2)).step([[0, 0, 0], [0, 0, NAN]]),
        r"action\[1, 2\] = nan; expected finite numbers of shape \(2, 3\)",
    ),
    (lambda: begun(FishVectorEnv(2)).step([[0], [0, 0]]), r"action = .*expected finite numbers of shape \(2, 3\)"),
]
SUITE = [
    (lambda: fish(kwargs=3), "task_kwargs = 3; expected a dict"),
    (lambda: fish(kwargs={"random": "x"}), "random = 'x'; expected a seed"),
    (lambda: fish(kwargs={"random": -1}), "random = -1"),
    (lambda: fish(kwargs={"root": "float"}), "unknown root 'float'"),
    (lambda: fish(kwargs={"angle": 1}), "unknown option 'angle'; known: .*random"),
    (lambda: fish(kwargs={"solver": {"domain": "laptop"}}), "solver has the options of water 'lbm'"),
    (lambda: fish(kwargs={"water": "lbm", "solver": {"domian": "laptop"}}), "Did you mean 'domain'"),
    (lambda: fish(kwargs={"water": "lbm", "solver": 3}), "solver = 3"),
    (
        lambda: fish(kwargs={"water": "hybrid", "hybrid": {"every": 3}}),
        r"expected fishmj.engines.hybrid.hybrid.HybridOptions\(...\)",
    ),
    (lambda: fish(environment_kwargs={"flat": True}), "unknown option in environment_kwargs 'flat'"),
    (lambda: fish(environment_kwargs=3), "environment_kwargs = 3"),
    (lambda: fish("figure_eight", {"cycles": -1}), "cycles = -1"),
]
SIM = [
    (lambda: Sim(3), "3"),
    (lambda: Sim(flow={"speed": 0.2}), r"expected fishmj.water.flow.Flow\(...\)"),
    (lambda: Sim(engine="batch"), "unknown engine 'batch'"),
    (lambda: Sim(pose=(0, 0)), r"pose = \(0, 0\) of shape \(2,\); expected finite numbers of shape \(3,\)"),
    (lambda: Sim(pose=(0, NAN, 0)), r"pose\[1\] = nan; expected finite numbers of shape \(3,\)"),
    (lambda: Sim(pose=(0, 0, 90)), r"pose, yaw = 90.0; expected a number from -6.2832 to 6.2832"),
    (lambda: Sim().step(np.full(3, 25.0)), r"command, rad.*goes to 25; expected at most 3.142; are these degrees\?"),
    (lambda: Flow(direction=180), "direction = 180; expected a number from -6.2832 to 6.2832"),
    (lambda: FishEnv(flow_direction=180), "flow_direction = 180"),
    (lambda: trials(direction=180), "direction = 180"),
    (lambda: Sim(latency=-1), "latency = -1; expected a number from 0 to 60"),
    (lambda: Sim(latency="x"), "latency = 'x'"),
    (lambda: Sim(swimmer=3), "swimmer = 3"),
    (lambda: Sim(hybrid=3), "hybrid has the options of water 'hybrid'"),
    (lambda: Sim(injection=3), "unknown injection 3"),
    (lambda: Sim().step("abc"), r"command, rad.*= 'abc'; expected finite numbers of shape \(3,\)"),
    (lambda: Sim().run(3, 1.0), r"commands = 3; expected finite numbers of shape \(0, 3\)"),
    (lambda: Sim().run(np.zeros((100, 3)), NAN), "seconds = nan"),
    (lambda: Sim().run(np.zeros((100, 2)), 1.0), "commands"),
    (lambda: Flow(speed="a"), "speed = 'a'"),
    (lambda: Flow(intensity=None), "intensity = None"),
    (lambda: Flow(seed=1.5), "seed = 1.5; expected a whole number from 0"),
    (lambda: Flow(box="train"), "box = 'train'"),
]
ALL = {"jax": JAX, "task": TASKS, "gym": GYM, "suite": SUITE, "sim": SIM}


@pytest.mark.parametrize(
    ("make", "said"), [pytest.param(*case, id=f"{room}-{i}") for room in ALL for i, case in enumerate(ALL[room])]
)
def test_an_option_that_cannot_be_is_one_typed_line(make, said):
    with pytest.raises(FishmjError, match=said) as caught:
        make()
    assert "\n" not in str(caught.value) and isinstance(caught.value, ConfigError | UnknownName | FishmjError)


def test_a_single_intensity_is_that_intensity():
    one, two = (StationHold(ROBOT, Raft(), Options(intensity=value)) for value in (0.1, (0.1, 0.1)))
    for a, b in zip(one.reset(KEY, 5).current, two.reset(KEY, 5).current, strict=True):
        np.testing.assert_array_equal(a, b)


def test_numbers_of_numpy_are_numbers():
    options = TaskOptions(noise=np.float32(0.5), intensity=np.array([0.0, 0.1]), seconds=np.int64(3), flow_speed=np.float64(0.2))
    assert TaskSpec(TASK, options).limit == 15
    assert Options(memory=np.int64(2), intensity=[0.0, 0.1]).intensity_bounds == (0.0, 0.1)


def test_a_robot_of_the_jax_environment_may_be_a_name():
    assert StationHold("fish", "planar").robot == StationHold(ROBOT, "planar").robot


def test_the_default_engine_is_the_fastest_one_here(monkeypatch):
    assert engines.name_of(StationHold("fish").engine) == FishEnv().engine == FishVectorEnv(2).engine == "compiled"
    monkeypatch.setitem(sys.modules, "numba", None)
    assert FishEnv().engine == engines.fastest() == "planar"
    assert engines.name_of(StationHold("fish").engine) == "planar"


def test_the_default_engine_in_jax_runs_under_scan_and_vmap():
    env = StationHold("fish", options=Options(noise=0.0))
    states = jax.vmap(lambda key: env.reset(key, 3))(jax.random.split(jax.random.key(0), 2))
    action = 0.3 * np.ones((2, 3, 3), np.float32)
    after, _ = jax.lax.scan(lambda s, _: (jax.vmap(env.step)(s, action), None), states, None, length=2)
    assert (np.asarray(after.tick) == 20).all() and np.isfinite(after.obs).all() and np.abs(after.fish.v).max() > 0.01
