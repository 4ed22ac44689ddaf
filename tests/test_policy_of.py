"""`Policy.of`: a network of one's own becomes a policy of its environment, with a memory too, and every judge takes it."""

import json
import re
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from deploying import Bench
from policy_files import ROBOT, header
from raft import KEY, Raft, push

from fishmj import control, suite
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.control.policy import SCHEMA, Policy
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.log import read_trial
from fishmj.mjcf.identity import constants_of
from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.gym.fish_env import FishEnv, FishVectorEnv
from fishmj.water.choice import in_water


def layers(inputs: int = 11, hidden: tuple[int, ...] = (8, 6), seed: int = 0, gain: float = 1.0) -> list:
    """Random (weights (in, out), bias) as one has them in JAX."""
    sizes, keys = [inputs, *hidden, 3], jax.random.split(jax.random.key(seed), len(hidden) + 1)
    made = zip(keys, sizes[:-1], sizes[1:], strict=True)
    return [(gain * jax.random.normal(key, (a, b)) / a**0.5, 0.1 * jnp.ones(b)) for key, a, b in made]


def turned(network: list) -> list:
    """As a file has them: (out, in)."""
    return [(w.T, b) for w, b in network]


def acting(network: list, inputs):
    """Actions of the network for scaled inputs, in JAX."""
    for w, b in network[:-1]:
        inputs = jnp.tanh(inputs @ w + b)
    return jnp.tanh(inputs @ network[-1][0] + network[-1][1])


@pytest.mark.parametrize(
    "make",
    [
        lambda: StationHold(ROBOT, "planar", water="structured"),
        lambda: gymnasium.make("fishmj/StationHold-v0", water="structured"),
        lambda: gymnasium.make_vec("fishmj/StationHold-v0", num_envs=2, water="structured"),
        lambda: suite.load("fish", "station_hold", {"water": "structured"}),
        lambda: in_water(ROBOT, "structured"),
    ],
    ids=["jax", "gymnasium", "vector", "dm_control", "robot"],
)
def test_the_header_comes_from_the_environment(make, tmp_path):
    policy = Policy.of(make(), turned(layers()), algorithm="mine", seed=np.int64(3), steps=10)
    meta = Policy.load(policy.save(tmp_path / "mine.safetensors")).meta
    trained = header(activation="tanh", algorithm="mine", seed=3, scale=[1, 1, 0.3, 0.3, 1.5, *3 * [0.7], *3 * [4]])
    more = {"origin": "synthetic", "schema": SCHEMA, "steps": 10, "constants": constants_of(ROBOT)}
    assert meta == trained | more
    assert control.make(tmp_path / "mine.safetensors", in_water(ROBOT, "structured")).notes == ()


def test_timing_and_water_of_the_environment_are_those_of_the_policy():
    jax_env = StationHold("fish", "planar", control_dt=0.1, command_path="hold")
    gym_env = FishEnv(control_dt=0.1, command_path="hold")
    one, two = (Policy.of(env, turned(layers())).meta for env in (jax_env, gym_env))
    assert one == two and (one["control_dt"], one["command_path"], one["water"]["name"]) == (0.1, "hold", "swift")


def test_water_of_an_engine_is_that_of_the_policy():
    engine = StationHold(ROBOT, "planar", water="swift").engine
    assert Policy.of(StationHold(ROBOT, engine), turned(layers())).meta["water"]["name"] == "swift"


@pytest.mark.parametrize("memory", [1, 4])
def test_actions_are_those_of_the_network_in_the_jax_environment(memory):
    """Raw observations in order and one fish's window: what the environment stacks, the policy remembers."""
    env = StationHold(ROBOT, Raft(), Options(memory=memory, hide=("yaw_rate",)))
    network = layers(env.n_input)
    policy, state = Policy.of(env, turned(network)), env.reset(KEY, 3)
    assert policy.memory == memory and env.input_scale.shape == (env.n_input,)
    for _ in range(6):
        action = acting(network, state.obs / env.input_scale)
        np.testing.assert_allclose(policy(np.asarray(state.obs[:, : env.n_obs])), action, atol=1e-5)
        state = env.step(state, action * 0.02)  # the raft is fast
        if memory > 1:
            policy._window[:, :3] = action * 0.02


def test_what_training_hid_stays_hidden():
    env = StationHold(ROBOT, Raft(), Options(memory=2, hide=("joint",)))
    policy, seen = Policy.of(env, turned(layers(env.n_input))), np.ones((2, 11))
    seen[1, 5:8] = 9.0
    np.testing.assert_array_equal(*policy(seen))


@pytest.mark.parametrize(
    ("env", "scale"),
    [
        (lambda: StationHold(ROBOT, Raft()).input_scale, np.float32),
        (lambda: FishVectorEnv(2).input_scale, np.float32),
        (lambda: suite.load("fish", "station_hold").task.input_scale, float),
    ],
)
def test_environments_offer_the_divisors_of_a_policy(env, scale):
    np.testing.assert_array_equal(env(), np.asarray(Policy.of(ROBOT, turned(layers())).meta["scale"], scale))


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray, lambda values: [*values]])
def test_divisors_of_any_array_are_taken(array, tmp_path):
    scale = array(np.full(11, 2.0))
    first = Policy.of(ROBOT, turned(layers()), scale=scale)
    direct = Policy(turned(layers()), {"scale": scale, "activation": "tanh"})
    for policy in (first, direct):
        assert Policy.load(policy.save(tmp_path / "p.safetensors")).meta["scale"] == [2.0] * 11
    np.testing.assert_allclose(first(np.ones((1, 11))), acting(layers(), np.full((1, 11), 0.5)), atol=1e-6)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: Policy.of(ROBOT, layers()),
            r"weights \(11, 8\) and bias \(8,\): got .*expected .out, in.; transpose",
        ),
        (lambda: Policy.of(ROBOT, turned(layers(12))), "expected 11 inputs"),
        (lambda: Policy.of(ROBOT, turned(layers()), memory=2), "expected 25 inputs"),
        (lambda: Policy.of(ROBOT, turned(layers())[:-1]), "the last layer gives 6; robot swift has 3 joints"),
        (lambda: Policy.of(ROBOT, turned(layers()), scale=np.ones(25)), r"scale of shape \(25,\); expected \(11,\)"),
        (lambda: Policy.of(ROBOT, turned(layers()), scale=np.zeros(11)), "one positive divisor for each observation"),
        (lambda: Policy.of(ROBOT, turned(layers()), activation="gelu"), "activation 'gelu'; known: relu, tanh"),
        (lambda: Policy.of(ROBOT, turned(layers()), memory=0), "memory 0"),
        (lambda: Policy.of(ROBOT, [w for w, _ in layers()]), r"layers; expected pairs \(weights \(out, in\), bias"),
        (lambda: Policy.of(ROBOT, []), "holds no layers"),
        (lambda: Policy.of(ROBOT, turned(layers()), hide=("speed",)), "unknown observation group 'speed'"),
        (
            lambda: Policy.of(gymnasium.make("CartPole-v1"), turned(layers())),
            "trained in CartPoleEnv; expected an env",
        ),
        (lambda: Policy.of("fish", turned(layers())), "trained in str; expected"),
        (lambda: Policy(turned(layers()), {}).save("p.safetensors"), "the header lacks activation and scale; Policy.of"),
    ],
)
def test_what_is_no_policy_of_this_robot_is_one_line(call, said):
    with pytest.raises((ConfigError, KeyError), match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_fish_that_begin_anew_forget_and_the_others_remember(mode):
    """In a vector environment: each episode against a policy of its own that sees that episode alone."""
    network = turned(layers(11 * 4 + 3 * 3, gain=2.0))
    envs = FishVectorEnv(3, seconds=1.2, autoreset_mode=mode, water="structured")
    many, ones = Policy.of(envs, network, memory=4), [Policy.of(envs, network, memory=4) for _ in range(3)]
    seen, over = envs.reset(seed=0)[0], np.zeros(3, bool)
    envs.episodes.count[:] = [0, 2, 3]  # they end one after another
    ended = 0
    for _ in range(16):
        action = many(seen)
        alone = np.concatenate([one(row) for one, row in zip(ones, seen, strict=True)])
        np.testing.assert_allclose(action, alone, atol=1e-4)  # sums of a batch round otherwise
        seen, _, terminated, truncated, _ = envs.step(action)
        before, over = over, terminated | truncated
        fresh = over if mode == "SameStep" else before
        many.reset(fresh)
        for i in np.flatnonzero(fresh):
            ones[i] = Policy.of(envs, network, memory=4)
            ended += 1
    assert ended >= 5
    with pytest.raises(ConfigError, match=r"rows \(2,\), bool; expected \(3,\) bool"):
        many.reset(np.zeros(2, bool))


@pytest.fixture(scope="module")
def remembering(tmp_path_factory) -> str:
    """File of a policy of random weights that sees four observations."""
    env = StationHold(ROBOT, Raft(), Options(memory=4))
    folder = tmp_path_factory.mktemp("policy")
    return str(Policy.of(env, turned(layers(env.n_input)), seed=0, activation="relu").save(folder / "mine.safetensors"))


def replayed(path: str, obs: np.ndarray) -> np.ndarray:
    """Actions (T, 3) of a fresh policy for one episode's observations (T, 11)."""
    policy = Policy.load(path)
    return np.concatenate([policy(row) for row in obs])


def decisions(trial) -> tuple[np.ndarray, np.ndarray]:
    """(observations (T, 11), actions (T, 3)) that a log holds."""
    obs, action = (
        np.stack([rows for name, rows in trial.tables[table].items() if name != "t"], 1) for table in ("obs", "action")
    )
    return obs, action


def test_a_policy_with_a_memory_is_judged_as_it_acts(remembering, tmp_path, capsys):
    line = [remembering, "--water", "structured", "--speeds", "0.2", "--los", "0,90", "--repeats", "1", "--duration", "2"]
    assert console.run(evaluate, [*line, "--json", "--log", "--out", str(tmp_path)]) == console.OK
    assert "not as trained" not in capsys.readouterr().err
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["results"][0]["policy"]["differs"] == {}
    for los in ("000", "090"):
        obs, action = decisions(read_trial(tmp_path / "logs" / f"mine_u0.2_los{los}_r0"))
        assert len(obs) == 10
        np.testing.assert_allclose(replayed(remembering, obs), action, atol=1e-3)  # float32 in logs and batches


def test_a_policy_with_a_memory_steers_the_host(remembering, tmp_path):
    bench = Bench(tmp_path / "swim", seconds=2.0, pilot=PolicyPilot(LearnedController(ROBOT, remembering)))
    assert bench.swim().complete
    obs, action = decisions(read_trial(bench.folder))
    assert len(obs) == 10
    np.testing.assert_allclose(replayed(remembering, obs), action, atol=1e-3)  # float32 in logs and batches


def test_the_example_of_the_manual_makes_a_policy(tmp_path, monkeypatch):
    page = (Path(__file__).parent.parent / "docs" / "train" / "training.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page.split("## Your own network as a policy")[1].split("\n## ")[0], re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/train/training.md", "exec"), {})  # noqa: S102  our own text
    assert control.make("mine.safetensors").notes == () and Policy.load("mine.safetensors").memory == 8


# the environment's arguments


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: StationHold(ROBOT, turbulence="gust"),
            r"turbulence is an option: .*options=Options\(turbulence=",
        ),
        (lambda: StationHold(ROBOT, Options()), r"got options as the engine"),
        (lambda: StationHold(ROBOT, option=Options()), "unknown argument of StationHold 'option'. Did you mean 'options'"),
        (lambda: StationHold(ROBOT, control_dt=0.15), "control_dt = 0.15 s is not a multiple of bus_dt"),
        (lambda: StationHold(ROBOT, command_path="cubic"), "unknown command path 'cubic'"),
        (lambda: StationHold(ROBOT, StationHold(ROBOT, "planar").engine, control_dt=0.1), "engine's robot has another timing"),
        (lambda: StationHold(ROBOT, Raft(), water="swift"), "water = 'swift' with an engine object, which already has a water"),
        (lambda: Options(engine="planar"), r"engine is an argument, not an option: StationHold\(.., engine=..\)"),
        (lambda: Options(wD=1.0), "wD is an argument, not an option"),
        (lambda: Options(speed=1.0), "unknown option of Options 'speed'"),
        (lambda: Options("gust"), r"Options got 'gust' without its name; write Options\(NAME=..\)"),
    ],
)
def test_an_argument_in_the_wrong_place_is_told_its_place(call, said):
    with pytest.raises((ConfigError, KeyError), match=said):
        call()


def test_the_control_step_of_the_jax_environment_is_the_one_asked_for():
    env = StationHold(ROBOT, "planar", Options(turbulence="none"), control_dt=0.04)
    state = env.step(env.reset(KEY, 2), push(2))
    assert (np.asarray(state.tick) == 2).all() and env.limit == 750
