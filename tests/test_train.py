"""Training runs on the fish: they learn, resume to the same bits, hide the flow from the policy, refuse what makes no sense."""

import io
import json
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import StopAt, calm_run, figures_of, sac_run

from fishmj import mjcf
from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_json
from fishmj.control.policy import Policy
from fishmj.tasks.env import Options, StationHold
from fishmj.train import multi_seed, training_run
from fishmj.train.__main__ import main
from fishmj.train.build import pick_engine, policy_of, settled
from fishmj.train.learner import PolicyLayers, warn_of_rounding
from fishmj.train.networks import mlp
from fishmj.train.settings import PRESETS, as_dict, change, from_dict, of_run, preset
from fishmj.train.training_run import TrainingRun, go_on, is_better, learner_of

FIGURES = {"reward": 0.0, "late_distance": 1.0, "episodes": 1, "diverged": 0}  # of an iteration


@pytest.fixture(scope="module")
def learner():
    """(environment, PPO, assessment), compiled once."""
    return learner_of(calm_run())


@pytest.fixture(scope="module")
def env():
    return StationHold(mjcf.load_robot("fish"), "planar", Options(intensity=(0.05, 0.05)))


def same(a: Policy, b: Policy) -> bool:
    return all(np.array_equal(x, y) for u, v in zip(a.weights, b.weights, strict=True) for x, y in zip(u, v, strict=True))


def act_afresh(policy: Policy, obs) -> np.ndarray:
    policy.reset()
    return np.stack([policy(obs), policy(obs)])


def test_steps_that_whole_iterations_exceed_by_far_are_told(capsys):
    for steps, said in ((10, True), (16_384, False), (16_385, True), (163_841, False), (2_000_000, False)):
        warn_of_rounding(SimpleNamespace(steps_per_iteration=16_384), steps)
        assert ("an iteration has 16,384" in capsys.readouterr().err) == said, steps
    learner_of(calm_run(steps=10))
    assert re.search(r"train: ([0-9,]+) control steps instead of 10: an iteration has \1;", capsys.readouterr().err)


# ---- learning ----


@pytest.mark.slow
def test_ppo_learns_to_reach_the_target_in_a_million_steps(learner, tmp_path):
    """The untrained fish drifts past one target in seven; a million control steps (20 s) later it reaches most."""
    run = TrainingRun(calm_run(), tmp_path / "run", learner=learner, quiet=True)
    before = learner[2](run.training.actor, jax.random.key(1))
    made = run.go()
    assert before["arrival"] < 0.25 and before["stayed"] < 0.25
    assert made["tune_arrival"] > 0.5 and made["tune_stayed"] > 0.5 and made["tune_return"] > 2 * before["return"]
    assert all(np.isfinite(v).all() for line in figures_of(run) for v in line.values())
    assert (made["steps"], made["stopped"], made["engine"]) == (983_040, False, "compiled")
    policy = Policy.load(made["policy"])
    assert [w.shape for w, _ in policy.weights] == [(32, 11), (32, 32), (3, 32)] and policy.meta["tune"]["arrival"] == made[
        "tune_arrival"
    ]
    assert of_run(run.folder) == settled(calm_run())


@pytest.mark.slow
def test_training_stops_at_first_good_assessment(learner, tmp_path):
    settings, n = calm_run(assess_every=2 * 8192), learner[1].steps_per_iteration
    good = lambda figures: figures["within"] >= 0.0
    made = TrainingRun(settings, tmp_path, learner=learner, quiet=True, stop_when=good).go()
    assert made["steps"] == 2 * n and not made["stopped"] and "tune_within" in made
    again = TrainingRun(settings, tmp_path, learner=learner, quiet=True, resume=True, stop_when=good).go()
    assert again["steps"] == 2 * n, "a resumed run that is good enough trains no more"


@pytest.mark.slow
def test_an_assessment_is_finite_and_the_same_each_time(learner):
    actor = learner[1].init(jax.random.key(3)).actor
    first, again = (learner[2](actor, jax.random.key(7)) for _ in range(2))
    assert first == again and all(np.isfinite(v) for v in first.values())
    assert all(0 <= first[k] <= 1 for k in ("arrival", "stayed", "within")) and 0 <= first["rmse_last10"] < 3


def test_the_best_policy_is_the_one_with_the_greatest_return_and_a_noisy_share_of_fish_does_not_outweigh_it():
    made = lambda stayed, rmse, reward: {"stayed": stayed, "rmse_last10": rmse, "return": reward}
    assert is_better(made(0.1, 2.0, 3.0), None)
    lucky, later = made(0.98535, 0.0901, 83.69), made(0.98438, 0.0893, 85.49)  # of one training, at a third of it and at its end
    assert is_better(later, lucky) and not is_better(lucky, later)


# ---- resuming ----


@pytest.mark.slow
def test_a_stopped_and_resumed_run_is_the_uninterrupted_one_to_the_bit(learner, tmp_path):
    settings, n = calm_run(assess_every=3 * 8192), 8192
    whole = StopAt(settings, tmp_path / "whole", 4 * n, learner=learner)
    first = StopAt(settings, tmp_path / "parts", 2 * n, learner=learner)
    assert whole.go()["stopped"] and first.go()["stopped"]
    second = StopAt(settings, tmp_path / "parts", 4 * n, learner=learner, resume=True)
    assert second.done == 2 * n
    made = second.go()
    assert figures_of(second) == figures_of(whole) and len(figures_of(whole)) == 5  # four iterations and a look
    for name in ("best", "last"):
        assert same(*(Policy.load(run.folder / f"{name}.safetensors") for run in (whole, second))), name
    assert made["tune_return"] == whole.best["return"]
    other = StopAt(change(settings, seed=1), tmp_path / "other", 4 * n, learner=learner)
    other.go()
    assert figures_of(other) != figures_of(whole)
    cut = StopAt(settings, tmp_path / "due", 3 * n, learner=learner)
    cut._assess_actor = lambda: (
        cut._save_on_interrupt(),
        sys.exit(),
    )  # killed with the assessment due, as where an interrupt does not wait
    with pytest.raises(SystemExit):
        cut.go()
    due = StopAt(settings, tmp_path / "due", 4 * n, learner=learner, resume=True)
    assert (due.done, due.assessed) == (3 * n, 0) and due.go()["tune_return"] == whole.best["return"]
    assert figures_of(due) == figures_of(whole)


@pytest.mark.slow
def test_a_run_killed_after_its_last_checkpoint_writes_its_lines_once(learner, tmp_path):
    settings, n = calm_run(assess_every=10**9), 8192
    run = StopAt(settings, tmp_path, n, learner=learner)
    run.go()
    with run.folder.joinpath("metrics.jsonl").open("a") as lines:  # what the kill left: beyond the checkpoint, and half a line
        lines.write('{"step": 16384, "reward": 5.0}\n{"step": 24576, "rew')
    again = StopAt(settings, tmp_path, 3 * n, learner=learner, resume=True)
    again.go()
    assert [line["step"] for line in figures_of(again)] == [n, 2 * n, 3 * n]
    assert all(line["reward"] != 5.0 for line in figures_of(again))


def test_run_folder_is_not_overwritten_or_resumed_with_other_settings(learner, tmp_path, monkeypatch):
    settings = calm_run()
    StopAt(settings, tmp_path, 8192, learner=learner, command="fishmj train --preset quick").go()
    assert Policy.load(tmp_path).meta["command"] == "fishmj train --preset quick"
    with pytest.raises(ConfigError, match="already holds a run; add --resume"):
        TrainingRun(settings, tmp_path, learner=learner)
    with pytest.raises(ConfigError, match="seed = 5, the run has 0; a run resumes with its own settings"):
        TrainingRun(change(settings, seed=5), tmp_path, learner=learner, resume=True)
    with pytest.raises(ConfigError, match="nothing to resume"):
        TrainingRun(settings, tmp_path / "empty", learner=learner, resume=True)
    more = {"learner": learner, "resume": True, "command": "fishmj train --resume"}
    with monkeypatch.context() as other:
        other.setattr(training_run, "constants_sha256", lambda robot: "of a heavier fish")
        with pytest.raises(
            ConfigError, match="the description of fish changed since the checkpoint; restore it, or start another"
        ):
            TrainingRun(settings, tmp_path, **more)
    with pytest.raises(ConfigError, match="--steps 8,000, but 8,192 are trained already; .* for 8,000 more give --steps 16192"):
        TrainingRun(change(settings, steps=8000), tmp_path, **more)
    longer = TrainingRun(change(settings, steps=10**9), tmp_path, **more)  # only longer: that is allowed
    assert longer.done == 8192 and longer.command == "fishmj train --preset quick && fishmj train --resume"
    again = TrainingRun(settings, tmp_path, **more)  # to the same steps: the command that began it says it all
    assert again.command == "fishmj train --preset quick"


@pytest.mark.slow
def test_a_resumed_run_reads_its_own_settings(tmp_path, capsys):
    """Nothing is said again but where it is; what is said again and differs is refused with both values."""
    out, n = str(tmp_path / "run"), 2048
    small = ["--preset", "quick", "--engine", "compiled", "--hidden", "8", "--envs", "64", "--memory", "2", "--seed", "3"]
    run = lambda *argv: console.run(main, ["--out", out, *argv, "--json"])
    assert run(*small, "--steps", str(n)) == 0
    for line, said in (
        ("--envs 32", "algorithm.envs = 32, the run has 64"),
        ("--seed 0", "seed = 0, the run has 3"),
        ("--preset paper", "preset = paper, the run has quick"),
        ("--algo sac", "algo = sac, the run has ppo"),
        ("--hide joint", "task.hide = ['joint'], the run has []"),
    ):
        assert run("--resume", *line.split()) == console.BAD_INPUT
        assert said in capsys.readouterr().err
    assert run("--resume", "--envs", "64", "--steps", str(2 * n)) == 0  # said again and the same
    said = capsys.readouterr()
    made = json.loads(said.out.splitlines()[-1])["runs"][0]
    assert (made["seed"], made["steps"]) == (3, 2 * n)
    assert f"evaluate it with: fishmj evaluate {out}\n" in said.out, said.out
    assert f"fewer than half of the fish arrive; to train longer: fishmj train --resume --out {out} --steps N" in said.err
    assert Policy.load(made["policy"]).memory == 2


def test_own_code_of_a_run_is_named_again_on_the_command_line(tmp_path, capsys):
    settings = calm_run(task={"course": "./mine.py:Line"})
    write_json(tmp_path / "settings.json", as_dict(settings))
    (tmp_path / "checkpoints").mkdir()
    assert console.run(main, ["--resume", "--out", str(tmp_path)]) == console.BAD_INPUT
    assert "add --task ./mine.py:Line" in capsys.readouterr().err
    assert go_on(tmp_path, 5, settings).endswith(f"fishmj train --resume --out {tmp_path} --task ./mine.py:Line")
    write_json(tmp_path / "settings.json", {"preset": "quick"})
    assert console.run(main, ["--resume", "--out", str(tmp_path)]) == console.BAD_INPUT
    assert "settings.json: not the settings of a training" in capsys.readouterr().err


def test_a_training_of_one_iteration_shows_its_rate_at_its_end():
    now, out = [0.0], io.StringIO()
    bar = console.Progress(8000, "train", "steps", stream=out, clock=lambda: now[0])
    bar.done_before = 4000  # of the run that goes on
    bar.stage("compiling the first iteration")
    now[0] = 4.0
    bar.update(8000)
    assert "  1k steps/s  took 4.0 s" in out.getvalue().splitlines()[-1]


def test_the_progress_of_a_training_ends_with_the_time_of_its_summary(tmp_path, monkeypatch):
    now, out = [0.0], io.StringIO()
    passes = lambda seconds, result: lambda *_: now.__setitem__(0, now[0] + seconds) or result
    monkeypatch.setattr(training_run, "time", SimpleNamespace(monotonic=lambda: now[0]))
    for name, part in {
        "_iterate": passes(4.0, FIGURES),
        "_assess_actor": passes(2.0, ({}, False)),
        "_save": passes(0, 1),
    }.items():
        monkeypatch.setattr(TrainingRun, name, part)
    monkeypatch.setattr(TrainingRun, "_export", passes(0, None))
    learner = SimpleNamespace(init=lambda key: None, steps_per_iteration=8192)
    run = TrainingRun(calm_run(steps=8192, assess_every=8192), tmp_path, learner=(None, learner, None))
    run.bar = console.Progress(8192, "train", "steps", stream=out, clock=lambda: now[0])
    now[0] += 20.0  # in which the fish and the networks compile
    assert run.go()["seconds"] == 6.0 and "took 6.0 s" in out.getvalue().splitlines()[-1]


@pytest.mark.slow
def test_seeds_trained_together_are_the_seeds_trained_alone(learner, tmp_path, monkeypatch):
    """Two iterations and an assessment of two seeds side by side, then each by itself."""
    settings, n = calm_run(assess_every=2 * 8192), 2 * 8192
    monkeypatch.setattr(multi_seed, "learner_of", lambda settings: learner)
    judge = multi_seed.Lane.judge

    def judge_and_stop(lane, *args):
        judge(lane, *args)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(multi_seed.Lane, "judge", judge_and_stop)
    found = multi_seed.train_together(settings, [0, 3], tmp_path / "both")
    for seed, one in zip((0, 3), found, strict=True):
        alone = StopAt(change(settings, seed=seed), tmp_path / f"{seed}", n, learner=learner)
        made = alone.go()
        assert one.keys() - made.keys() == {"together"} and made.keys() <= one.keys() and one["steps"] == n
        for (w, b), (x, c) in zip(*(Policy.load(run["policy"]).weights for run in (one, made)), strict=True):
            np.testing.assert_allclose(w, x, atol=1e-3)
            np.testing.assert_allclose(b, c, atol=1e-3)
        assert one["tune_return"] == pytest.approx(made["tune_return"], abs=0.1)
    assert not same(*(Policy.load(one["policy"]) for one in found))


# ---- what the policy sees ----


@pytest.mark.slow
def test_a_policy_with_memory_acts_in_numpy_as_it_did_in_training(tmp_path):
    """`--memory 4` with SAC: the exported policy keeps the window that the environment kept, from the first step on."""
    settings = sac_run(steps=384, assess_every=10**9, task={"memory": 4})
    env, sac, _ = learner_of(settings)
    found = {"stayed": 1.0, "rmse_last10": 0.1}  # whatever an assessment says
    run = TrainingRun(settings, tmp_path, learner=(env, sac, lambda *_: found), quiet=True)
    policy = Policy.load(run.go()["policy"])
    assert policy.memory == 4 and policy.weights[0][0].shape == (16, 4 * 11 + 3 * 3)
    louder = [(w * 2.0, b) for w, b in run.training.actor]  # so that the actions are not all near zero
    policy.weights = policy_of(sac.policy_layers(louder), settings, {}).weights
    state = env.reset(jax.random.key(1), 16)
    for _ in range(12):
        action = sac.act(louder, state.obs)
        np.testing.assert_allclose(policy(np.asarray(state.obs[:, :11])), action, atol=2e-6)
        state = env.step(state, action)
        assert not state.terminated.any()
    assert np.abs(action).max() > 0.1


def test_flow_is_hidden_from_the_policy_and_visible_to_the_critic(env):
    state = env.reset(jax.random.key(0), 6)
    other = state._replace(current=state.current._replace(mean=state.current.mean + 0.5, rms=3 * state.current.rms))
    recent, key = jnp.zeros((6, env.sensors.behind + 1, 2 * env.n_act)), jax.random.key(1)
    np.testing.assert_array_equal(env._observe(state, recent, key), env._observe(other, recent, key))
    seen = [env._privileged(s, state.obs) for s in (state, other)]
    differs = np.abs(np.asarray(seen[0] - seen[1])).max(0) > 0.1
    np.testing.assert_array_equal(np.flatnonzero(differs), [11, 12])  # the stream, and nothing else
    assert state.obs.shape == (6, 11) and env.n_input == 11


def test_a_privileged_critic_uses_the_flow_and_a_plain_one_cannot(env):
    from fishmj.train.ppo import PPO, PPOConfig

    obs, seen = jnp.zeros((2, 11)), jnp.zeros((2, 16)).at[1, 11].set(1.0)
    for privileged in (True, False):
        learner = PPO(env, PPOConfig(hidden=(8,), privileged=privileged), 1)
        critic = mlp(jax.random.key(0), [11 + 16 * privileged, 8, 1], last=1.0)
        value = learner.value(critic, obs, seen)
        assert (value[0] != value[1]) == privileged
        actor = mlp(jax.random.key(1), [env.n_input, 8, 3])
        assert policy_of(learner.policy_layers(actor), calm_run(), {}).weights[0][0].shape == (8, 11)


def test_hidden_observations_are_zero_in_training_and_policy_ignores_them():
    hide = ("velocity", "joint")
    env = StationHold(mjcf.load_robot("fish"), "planar", Options(hide=hide, memory=2))
    obs = np.asarray(env.reset(jax.random.key(0), 64).obs)
    hidden = np.isin(np.arange(11), [2, 3, 5, 6, 7])
    both = np.concatenate([hidden, [False] * 3, hidden])
    assert np.all(obs[:, both] == 0) and np.all(np.abs(obs[:, :11][:, ~hidden]).max(0) > 0)
    settings = calm_run(task={"hide": hide, "memory": 2})
    policy = policy_of(PolicyLayers(mlp(jax.random.key(0), [25, 16, 3], last=1.0), "tanh"), settings, {})
    seen, junk = np.ones((1, 11)), np.where(hidden, 9.0, 1.0)[None]
    first, other, twice = (act_afresh(policy, obs) for obs in (seen, junk, 2 * seen))
    np.testing.assert_array_equal(first, other)
    assert not np.array_equal(first, twice)


# ---- settings and the command line ----


@pytest.mark.parametrize("name", PRESETS)
def test_settings_survive_json(name):
    settings = change(preset(name), task={"hide": ("joint",)}, reward={"wS": 0.01})
    assert from_dict(json.loads(json.dumps(as_dict(settings)))) == settings


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--preset papr", "got 'papr'. Did you mean 'paper'?"),
        ("--algo sacc", "Did you mean 'sac'?"),
        ("--engine planer", "Did you mean 'planar'?"),
        ("--turbulence gusts", "Did you mean 'gust'?"),
        ("--hide velocty", "Did you mean 'velocity'?"),
        ("--robot fsh", "Did you mean 'fish'?"),
        ("--command-path lin", "Did you mean 'linear'?"),
        ("--critic privileg", "Did you mean 'privileged'?"),
        ("--algo sac --critic plain", "--critic is a setting of ppo, not of sac; leave it out"),
        ("--reward wD", "argument --reward: 'wD': expected wG=, wD=, wS= and a number"),
        ("--reward wX=1", "argument --reward: got 'wX'"),
        ("--hidden 64,x", "argument --hidden: got 'x', expected a whole number from 1 to 8192"),
        ("--seeds a,b", "argument --seeds: got 'a', expected a whole number from 0"),
        ("--memory 0", "argument --memory: got '0', expected a whole number from 1 to 1000"),
        ("--steps 0", "argument --steps: got '0', expected a number from 1 to 1e+11"),
        ("--steps nan", "argument --steps: got 'nan', expected a number from 1 to 1e+11"),
        ("--envs 0", "argument --envs: got '0', expected a whole number from 1 to"),
        ("--learning-rate -1", "argument --learning-rate: got '-1', expected a number above 0 to 1"),
        ("--intensity 2", "argument --intensity: got '2', expected a number from 0 to 0.99"),
        ("--engine batch", "engine batch cannot run inside jax.jit; train on compiled"),
        ("--together --resume", "--together cannot resume"),
        ("--together --devices 2", "--together with --devices 2"),
        ("--algo sac --devices 2", "--devices 2: sac trains on one device"),
        ("--devices 1000", "--devices 1000: JAX sees 1 "),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(line, said, tmp_path, capsys):
    usual = {"--preset": "quick", "--engine": "planar"}
    argv = [word for option, value in usual.items() if option not in line for word in (option, value)]
    argv += [*line.split(), "--out", str(tmp_path / "run")]
    assert console.run(main, argv) == console.BAD_INPUT
    error = capsys.readouterr().err
    assert said in error and len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("water", ["structured", "swift-base", "fitted"])
def test_an_engine_that_can_hold_the_water_is_picked(water):
    """The compiled one, with a learnt residual too."""
    pytest.importorskip("numba")
    assert pick_engine(change(PRESETS["quick"], water=water)) == "compiled"
    assert pick_engine(change(PRESETS["quick"], water=water, engine="mjx")) == "mjx"


def test_a_preset_on_mjx_trains_as_many_fish_as_fill_a_gpu():
    from fishmj.train.__main__ import options, settings_from

    envs = lambda *words: settings_from(options().parse_args(["--preset", "paper", *words])).algorithm["envs"]
    assert (envs("--engine", "mjx"), envs("--engine", "planar"), envs("--engine", "mjx", "--envs", "64")) == (16384, 8192, 64)


def test_a_setting_that_does_not_exist_is_named():
    with pytest.raises(UnknownName, match="unknown setting 'stepss'. Did you mean 'steps'?"):
        change(preset("quick"), stepss=3)
    with pytest.raises(UnknownName, match="unknown setting of ppo 'horizn'. Did you mean 'horizon'?"):
        learner_of(calm_run(algorithm={"horizn": 3}))
    with pytest.raises(ConfigError, match="envs x horizon = 8160 does not split into 4096 minibatches"):
        learner_of(calm_run(algorithm={"envs": 255, "minibatches": 4096}))


def test_help_needs_no_engine():
    code = "import sys; from fishmj.train.__main__ import options; options().format_help(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"jax", "mujoco", "torch", "numba"}.isdisjoint(done.stdout.split())
