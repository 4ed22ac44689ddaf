"""A training that begins with a policy: its network, its settings, and what is refused."""

import numpy as np
import pytest
from training import calm_run

from fishmj import control
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.control.policy import Policy
from fishmj.mjcf.reading import load_robot
from fishmj.train.__main__ import main
from fishmj.train.begin import SIGMA, begin_with, start_from_policy
from fishmj.train.settings import change, preset
from fishmj.train.training_run import TrainingRun, learner_of


def test_the_settings_take_the_policy_s_network_and_nothing_else():
    policy, made = begin_with("station", preset("quick"), {})
    assert made.algorithm["hidden"] == (256, 256) and made.algorithm["activation"] == "relu" and made.algorithm["sigma"] == SIGMA
    assert made.command_path == policy.meta["command_path"] and made.task["memory"] == 1
    taken = ("hidden", "activation", "sigma", "learning_rate")
    assert {key: value for key, value in made.algorithm.items() if key not in taken} == {"envs": 512}
    assert made.algorithm["learning_rate"] == pytest.approx(1e-4)  # a tenth
    assert (made.steps, made.robot) == (preset("quick").steps, preset("quick").robot)


@pytest.mark.parametrize(
    ("asked", "word"),
    [({"--hidden": (8,)}, "--hidden"), ({"--memory": 2}, "--memory"), ({"--command-path": "hold"}, "--command-path")],
)
def test_what_the_policy_decides_cannot_be_asked_for_otherwise(asked, word):
    with pytest.raises(ConfigError, match=f"--begin station: {word} .*the policy has .*leave {word} out"):
        begin_with("station", preset("quick"), asked)


def test_other_algorithms_and_other_structures_are_refused():
    with pytest.raises(ConfigError, match="sac cannot start from a policy"):
        begin_with("station", change(preset("quick"), algo="sac"), {})
    with pytest.raises(ConfigError, match="robot tendon_fish needs 9 and 2"):
        begin_with("station", change(preset("quick"), robot="tendon_fish"), {})


@pytest.mark.slow
def test_resumed_run_that_is_complete_says_that_nothing_is_trained(tmp_path, capsys):
    words = ["--preset", "quick", "--envs", "16", "--horizon", "8", "--minibatches", "1", "--hidden", "8", "--steps", "256"]
    assert console.run(main, [*words, "--out", str(tmp_path / "run")]) == console.OK
    assert "nothing is trained" not in capsys.readouterr().err
    assert console.run(main, ["--resume", "--steps", "256", "--out", str(tmp_path / "run")]) == console.OK
    assert "has 256 control steps of 256 already: nothing to train; raise --steps" in capsys.readouterr().err
    assert console.run(main, ["--resume", "--steps", "100", "--out", str(tmp_path / "run")]) == console.BAD_INPUT
    assert "got --steps 100, but 256 are trained already; expected a larger total" in capsys.readouterr().err


@pytest.mark.parametrize("other", ["--resume", "--together"])
def test_a_run_begins_once_and_alone(other, capsys):
    assert console.run(main, ["--begin", "station", other]) == console.BAD_INPUT
    assert f"--begin with {other}" in capsys.readouterr().err


def test_options_and_the_solver_s_preset_keep_their_learning_rate():
    fast = change(preset("quick"), algorithm={"learning_rate": 0.1})
    for settings, asked in ((preset("lbm"), {}), (fast, {"--learning-rate": 0.1})):
        assert begin_with("station", settings, asked)[1].algorithm["learning_rate"] == settings.algorithm["learning_rate"]


@pytest.mark.slow
def test_the_first_policy_of_such_a_run_is_the_one_that_it_began_with(tmp_path):
    policy, made = begin_with("station", calm_run(algorithm={"envs": 32}), {})
    learner = learner_of(made)
    run = TrainingRun(made, tmp_path / "run", learner=learner, quiet=True, begin=policy)
    obs = np.random.default_rng(0).normal(size=(16, policy.n_obs)).astype(np.float32)
    assert np.abs(np.asarray(run.algorithm.act(run.training.actor, obs)) - Policy.load("station")(obs)).max() < 1e-5
    assert np.allclose(np.exp(run.training.log_sigma), SIGMA)
    run._export("last", {})
    swims = control.make(tmp_path / "run" / "last.safetensors", load_robot("fish")).policy
    assert all(
        np.array_equal(a, b) for x, y in zip(swims.weights, policy.weights, strict=True) for a, b in zip(x, y, strict=True)
    )
    with pytest.raises(ConfigError, match="the policy's layers are"):
        start_from_policy(run.training._replace(actor=run.training.actor[:1]), policy, made, run.env)
