"""Every algorithm of the register, one of a reader's own among them: it trains, resumes to the bit, exports what it does."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import CALM, StopAt, figures_of

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_json
from fishmj.control.policy import Policy
from fishmj.train.__main__ import main, options, settings_from
from fishmj.train.build import algorithm, config_of, environment, referred
from fishmj.train.learner import METRICS
from fishmj.train.settings import ALGORITHMS, Registered, Settings, as_dict, change, preset
from fishmj.train.training_run import arrays_of, learner_of, tree_of

OWN = {  # the lines that their files need: one with a replay buffer, one without
    "td3": Registered("td3:TD3Config", "td3:TD3", budget=1_000_000),
    "reinforce": Registered("reinforce:ReinforceConfig", "reinforce:Reinforce"),
}


@pytest.fixture(autouse=True)
def with_own(monkeypatch):
    """Registered as a reader would, by a line each."""
    for name, line in OWN.items():
        monkeypatch.setitem(ALGORITHMS, name, line)


def asked_for(*argv) -> Settings:
    return settings_from(options().parse_args(["--preset", "quick", *argv]))


def small(algo: str) -> Settings:
    """The nominal fish in still water, small in what the algorithm has of these; two iterations, an assessment after each."""
    few = {
        "envs": 16,
        "horizon": 8,
        "minibatches": 2,
        "epochs": 1,
        "hidden": (8,),
        "block": 8,
        "batch": 32,
        "warmup": 64,
        "utd": 0.25,
    }
    has = {field.name for field in fields(referred(ALGORITHMS[algo].config))}
    own = {name: value for name, value in few.items() if name in has}
    made = replace(change(preset("quick"), engine="compiled", task=CALM, assess_episodes=2), algo=algo, algorithm=own)
    n = algorithm(made, environment(made)).steps_per_iteration
    return change(made, steps=2 * n, assess_every=n)


@pytest.mark.slow
@pytest.mark.parametrize("algo", [*ALGORITHMS, *OWN])
def test_registered_algorithm_trains_resumes_bitwise_and_exports_a_policy(algo, tmp_path):
    if ALGORITHMS[algo].train:
        pytest.skip(f"{algo} keeps no replay buffer and brings its own environment: test_train_sb3.py")
    settings = small(algo)
    trio = learner_of(settings)
    env, learner, _ = trio
    whole = StopAt(settings, tmp_path / "whole", 10**9, learner=trio)
    whole.go()
    assert whole.done == 2 * learner.steps_per_iteration and learner.name == algo
    first = figures_of(whole)[0]
    assert set(METRICS) <= first.keys() and all(np.isfinite(v) for v in first.values())
    StopAt(settings, tmp_path / "parts", learner.steps_per_iteration, learner=trio).go()
    second = StopAt(settings, tmp_path / "parts", 10**9, learner=trio, resume=True)
    assert second.done == learner.steps_per_iteration
    second.go()
    mine, theirs = (arrays_of(run.training) for run in (second, whole))
    assert mine.keys() == theirs.keys()
    for name, value in mine.items():
        np.testing.assert_array_equal(value, theirs[name], err_msg=name)
    assert figures_of(second) == figures_of(whole)
    policy = Policy.load(second.folder / "last.safetensors")
    assert policy.meta["algorithm"] == algo
    obs = np.random.default_rng(0).normal(size=(5, env.n_obs)).astype(np.float32)
    np.testing.assert_allclose(policy(obs), learner.act(second.training.actor, jnp.asarray(obs)), atol=2e-6)


def test_a_name_without_a_line_is_refused_and_trains_nothing():
    wrong = Settings(algo="tdd3")  # not through `change`, which refuses it, too
    for call in (config_of, lambda s: algorithm(s, None)):
        with pytest.raises(UnknownName, match="unknown algorithm 'tdd3'. Did you mean 'td3'?"):
            call(wrong)
    with pytest.raises(UnknownName, match="tdd3"):
        change(preset("quick"), algo="tdd3")


def test_a_line_is_all_that_the_command_line_needs():
    settings = asked_for("--algo", "td3", "--envs", "32")
    config = config_of(settings)
    assert (type(config).__name__, config.envs, config.hidden) == ("TD3Config", 32, (64, 64))
    with pytest.raises(ConfigError, match="td3: tau = 0; expected a number above 0 to 1"):
        config_of(change(settings, algorithm={"tau": 0}))


def test_on_policy_algorithm_gets_its_options_and_checks_them():
    """Its own settings, those of the base, and none of PPO's."""
    config = config_of(asked_for(*"--algo reinforce --rollout 25 --gamma 0.9 --learning-rate 0.01".split()))
    assert (config.rollout, config.gamma, config.learning_rate, config.hidden) == (25, 0.9, 0.01, (64, 64))
    for words, said in (
        ("--epochs 3", "--epochs is a setting of ppo, sb3-ppo, not of reinforce"),
        ("--clip 0.1", "--clip is a setting of ppo, sb3-ppo, not of reinforce"),
    ):
        with pytest.raises(ConfigError, match=said):
            config_of(asked_for("--algo", "reinforce", *words.split()))
    with pytest.raises(ConfigError, match="reinforce: rollout = 2.5; expected a whole number from 1 to 1000"):
        config_of(change(asked_for("--algo", "reinforce"), algorithm={"rollout": 2.5}))


@pytest.mark.parametrize(
    ("line", "steps", "assess_every"),
    [
        ("", 8_000_000, 1_000_000),
        ("--algo ppo", 8_000_000, 1_000_000),
        ("--algo sac", 1_000_000, 100_000),
        ("--algo sb3-sac", 1_000_000, 100_000),
        ("--algo sb3-ppo", 16_000_000, 1_600_000),
        ("--algo sac --steps 300000", 300_000, 75_000),
        ("--preset paper-sac", 1_000_000, 100_000),
        ("--preset paper-sac --algo ppo", 1_000_000, 100_000),
    ],
)
def test_an_off_policy_algorithm_has_a_budget_of_its_own(line, steps, assess_every):
    words = line.split()
    settings = settings_from(options().parse_args(words if "--preset" in words else ["--preset", "quick", *words]))
    assert (settings.steps, settings.assess_every) == (steps, assess_every)


# ---- what a run's folder answers ----


def test_the_folders_that_help_names_are_those_that_a_run_makes(monkeypatch, tmp_path, capsys):
    """Of the examples: `--resume --out runs/quick-ppo-0`."""
    from fishmj.train.__main__ import EXAMPLES, folders_of

    monkeypatch.chdir(tmp_path)
    made = folders_of(options().parse_args([]), preset("quick"), [0])[0]
    assert str(made) in EXAMPLES and "runs/<preset>-<algo>-<seed>" in options().format_help().replace("\n", "")


def test_a_folder_of_several_seeds_says_how_they_go_on(tmp_path, capsys):
    for seed in (0, 3):
        (tmp_path / f"seed-{seed}" / "checkpoints").mkdir(parents=True)
        write_json(tmp_path / f"seed-{seed}" / "settings.json", as_dict(change(preset("quick"), seed=seed)))
    assert console.run(main, ["--resume", "--out", str(tmp_path)]) == console.BAD_INPUT
    assert "nothing to resume; it has the runs seed-0, seed-3: add --seeds 0,3" in capsys.readouterr().err


def test_folder_of_a_run_without_checkpoints_is_not_overwritten(tmp_path, capsys):
    """As `--together` leaves them: its best policy would stand beside another run's figures."""
    write_json(tmp_path / "settings.json", as_dict(preset("quick")))
    (tmp_path / "best.safetensors").write_bytes(b"")
    assert console.run(main, ["--preset", "quick", "--out", str(tmp_path)]) == console.BAD_INPUT
    assert "already holds a run that cannot resume; add --force" in capsys.readouterr().err


@pytest.mark.parametrize("algo", ["sb3-sac", "examples/own_code.py:Evolution"])
def test_together_refuses_what_brings_its_own_loop(algo, tmp_path, capsys):
    assert console.run(main, ["--algo", algo, "--together", "--out", str(tmp_path / "run")]) == console.BAD_INPUT
    assert "--together trains fishmj's own algorithms only" in capsys.readouterr().err


def test_seeds_stopped_together_name_no_command_that_would_not_work(monkeypatch, tmp_path, capsys):
    from fishmj.train import multi_seed
    from fishmj.train.training_run import summary_of

    def stopped(settings, seeds, folder, command):
        return [summary_of(change(settings, seed=seed), folder / f"seed-{seed}", 5, 1.0, None, True) for seed in seeds]

    monkeypatch.setattr(multi_seed, "train_together", stopped)
    words = ["--preset", "quick", "--together", "--seeds", "0,1", "--out", str(tmp_path / "run")]
    assert console.run(main, words) == console.INTERRUPTED
    out, err = capsys.readouterr()
    assert "--together cannot resume" in err and "--resume" not in err
    assert "not yet evaluated on the tuning flows" in out and "nan" not in out


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_a_checkpoint_is_read_to_the_bit_and_another_set_up_refused(algo):
    from training import Point

    from fishmj.train.build import referred

    config = {"hidden": (8,), "envs": 8} | ({"horizon": 4, "minibatches": 2} if algo == "ppo" else {"batch": 8})
    learner = referred(ALGORITHMS[algo].learner)(Point(), referred(ALGORITHMS[algo].config)(**config), 800)
    state = learner.init(jax.random.key(1))
    arrays = arrays_of(state)
    again = arrays_of(tree_of(arrays, learner.init(jax.random.key(2))))
    for name, value in arrays.items():
        np.testing.assert_array_equal(again[name], value, err_msg=name)
    with pytest.raises(ConfigError, match=r"fishmj, the robot or the water has changed .* fishmj train --begin RUN"):
        tree_of({name: value[None] for name, value in arrays.items()}, state)


def test_what_is_exported_is_what_acts():
    """SAC's actor has a second half, log sigma, that no policy holds."""
    from training import Point

    from fishmj.train.sac import SAC as Learner
    from fishmj.train.sac import SACConfig

    learner = Learner(Point(), SACConfig(hidden=(8,), envs=8), 800)
    actor = learner.init(jax.random.key(0)).actor
    network = learner.policy_layers(actor)
    assert actor[-1][0].shape == (8, 2) and network.layers[-1][0].shape == (8, 1) and network.activation == "relu"
    x = Point().see(jnp.linspace(-1, 1, 5))
    hidden = np.maximum(np.asarray(x) / learner.obs_scale @ actor[0][0] + actor[0][1], 0)
    mean = (hidden @ actor[1][0] + actor[1][1])[:, :1]
    np.testing.assert_allclose(learner.act(actor, x), np.tanh(mean), atol=1e-6)
