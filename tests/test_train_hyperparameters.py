"""Hyperparameters are declared once: options, checks, run folder, policy header and the table of the docs follow from there."""

import json
import math
import re
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import CALM, Point, calm_run

from fishmj import mjcf
from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError
from fishmj.control.learned import body_of
from fishmj.control.policy import Policy
from fishmj.control.policy_meta import fit
from fishmj.tasks.env import Options, StationHold
from fishmj.train.__main__ import judging, options, report, settings_from
from fishmj.train.begin import SIGMA, begin_with
from fishmj.train.build import config_of, environment, policy_of, robot_for, settled
from fishmj.train.hyperparameters import PPOConfig, SACConfig, declared
from fishmj.train.learner import PolicyLayers, episode_metrics, record_of, reported
from fishmj.train.networks import ACTIVATIONS, mlp
from fishmj.train.planned_runs import PlannedRun
from fishmj.train.settings import ALGORITHMS, as_dict, change, from_dict, hyperparameters, of_run, option_text, preset
from fishmj.train.training_run import export, programs, write_settings

PAGE = Path(__file__).resolve().parent.parent / "docs" / "train" / "training.md"


def asked_for(*argv):
    return settings_from(options().parse_args(["--preset", "quick", *argv]))


# ---- one place ----


def test_every_field_of_ppo_and_sac_is_declared_with_range_and_meaning():
    for config in (PPOConfig, SACConfig):
        assert set(declared(config)) == {one.name for one in fields(config)}
        assert all(one.metadata["about"] for one in declared(config).values())
        config()  # every default lies in its range


def test_table_of_the_docs_is_the_code_s():
    lines = ["| option | meaning | values | default | in presets |", "|---|---|---|---|---|"]
    for one in hyperparameters().values():
        values = one.kind.expected.removeprefix("a ").replace("1 to 10 values, each a ", "1 to 10, each a ")
        own: dict[str, list[str]] = {}
        for algo in one.defaults.keys() - {"sb3-ppo", "sb3-sac"}:  # have PPO's and SAC's
            own.setdefault(option_text(one.defaults[algo], one.kind), []).append(algo)
        default = "; ".join(sorted(f"{', '.join(sorted(names))} {value}" for value, names in own.items()))
        presets = "; ".join(f"{key} {option_text(value, one.kind)}" for key, value in one.presets.items()) or "-"
        lines.append(f"| `{one.option}` | {one.about.replace('|', chr(92) + '|')} | {values} | {default} | {presets} |")
    assert "\n".join(lines) in PAGE.read_text(encoding="utf-8"), "the page should have\n" + "\n".join(lines)


def test_activations_of_the_options_are_the_networks():
    from fishmj.train.hyperparameters import ACTIVATIONS as NAMES

    assert set(NAMES) == set(ACTIVATIONS)


def other(one):
    """(text, value) of a hyperparameter that is not its default."""
    default = next(iter(one.defaults.values()))
    if isinstance(default, bool):
        return one.kind.known[not default], not default
    if isinstance(default, tuple):
        return "24,8", (24, 8)
    if isinstance(default, str):
        text = next(name for name in one.kind.known if name != default)
        return text, text
    value = default * 2 if one.kind.holds(default * 2) else default / 2
    return (str(value), value) if one.kind.whole else (repr(value), value)


@pytest.mark.parametrize("name", hyperparameters())
def test_option_reaches_the_algorithm_and_the_run_folder(name, tmp_path):
    one = hyperparameters()[name]
    text, value = other(one)
    for algo in one.defaults:
        settings = asked_for("--algo", algo, one.option, text)
        assert getattr(config_of(settings), name) == value
        write_settings(settled(settings), tmp_path)
        assert of_run(tmp_path) == settled(settings)
        table = json.loads((tmp_path / "settings.json").read_text())
        assert table["algorithm"][name] == (list(value) if isinstance(value, tuple) else value)
        assert set(table["algorithm"]) == set(declared(type(config_of(settings))))
        assert {"fishmj", "jax", "optax"} <= table["made_by"]["versions"].keys() and table["seed"] == 0


@pytest.mark.parametrize("name", hyperparameters())
def test_value_out_of_range_is_refused_by_the_dataclass(name):
    from fishmj.train.settings import referred

    one = hyperparameters()[name]
    for algo in one.defaults:
        config = referred(ALGORITHMS[algo].config)
        bad = [None, "x", math.nan, math.inf, -math.inf, 1j, [], (0,)] + ([] if name == "privileged" else [True])
        bad += [2.5] if getattr(one.kind, "whole", False) else []
        bad += [one.kind.low - 1, one.kind.high * 2] if isinstance(one.kind, console.Number) else []
        bad += [one.kind.low] if getattr(one.kind, "above", False) else []
        for value in bad:
            with pytest.raises(ConfigError, match=f"{config.algo}: {name} = .*; expected "):
                config(**{name: value})


def test_numbers_of_numpy_are_numbers():
    assert PPOConfig(gamma=np.float64(0.9), epochs=np.int64(2)).epochs == 2


@pytest.mark.parametrize(
    "line", ["--algo sac --epochs 3", "--algo sac --lambda 0.9", "--algo ppo --tau 0.01", "--algo ppo --utd 2"]
)
def test_option_of_another_algorithm_is_refused(line):
    _, algo, option, _ = line.split()
    with pytest.raises(ConfigError, match=f"{option} is a setting of .*, not of {algo}; leave it out"):
        config_of(asked_for(*line.split()))


def test_header_of_a_policy_has_every_value(tmp_path):
    settings = settled(asked_for(*"--gamma 0.9 --flow-speeds 0.05,0.4 --episode-seconds 12 --control-dt 0.1 --seed 7".split()))
    network = PolicyLayers(mlp(jax.random.key(0), [11, *settings.algorithm["hidden"], 3]), "tanh")
    export(network, settings, {"steps": 5}, tmp_path / "best.safetensors")
    meta = Policy.load(tmp_path).meta
    assert meta["hyperparameters"] == as_dict(settings)["algorithm"] and meta["hyperparameters"]["gamma"] == 0.9
    assert (meta["task"]["flow_speed"], meta["task"]["seconds"], meta["control_dt"]) == ([0.05, 0.4], 12.0, 0.1)
    assert meta["reward"] == {"wG": 1.0, "wD": 10.0, "wS": 0.005} and meta["seed"] == 7 and "jax" in meta["made_by"]["versions"]


@pytest.mark.parametrize("line, package", [("--algo sb3-ppo", "stable-baselines3"), ("--algo sb3-sac", "torch")])
def test_header_states_the_versions_of_the_programs_of_its_algorithm(line, package, tmp_path):
    own, ours = settled(asked_for(*line.split())), settled(asked_for())
    network = PolicyLayers(mlp(jax.random.key(0), [11, *own.algorithm["hidden"], 3]), "tanh")
    export(network, own, {"steps": 5}, tmp_path / "best.safetensors")
    versions = Policy.load(tmp_path).meta["made_by"]["versions"]
    assert versions[package] == programs(own)["versions"][package] and package not in programs(ours)["versions"]
    assert programs(ours)["versions"].items() <= versions.items()


def test_settled_settings_state_what_is_left_open_and_settle_once():
    made = settled(preset("quick"))
    assert made.control_dt == 0.2 and made.task["seconds"] == 30 and made.task["flow_speed"] == pytest.approx((0.1, 0.3))
    assert settled(made) == made and settled(from_dict(json.loads(json.dumps(as_dict(made))))) == made


def test_policy_that_a_run_begins_with_gives_way_to_no_option():
    asked = {"--activation": "tanh"}
    with pytest.raises(ConfigError, match="--activation tanh, the policy has relu"):
        begin_with("station", preset("quick"), asked)
    assert begin_with("station", preset("quick"), {"--sigma": 0.4})[1].algorithm["sigma"] == 0.4 != SIGMA


# ---- flow, episode, control step ----


def test_stream_speeds_episode_and_control_step_of_a_run():
    settings = asked_for(*"--flow-speeds 0.35,0.45 --episode-seconds 3 --control-dt 0.1 --engine planar".split())
    settings = change(settings, task=CALM)
    env = environment(settings)
    state = env.reset(jax.random.key(0), 64)
    speed = np.linalg.norm(np.asarray(state.current.mean)[:, :2], axis=-1)
    assert speed.min() >= 0.349 and speed.max() <= 0.451 and np.ptp(speed) > 0.05
    assert env.limit == 30 and env.robot.timing.control_dt == 0.1
    still = environment(change(asked_for("--flow-speeds", "0", "--engine", "planar"), task=CALM)).reset(jax.random.key(0), 8)
    np.testing.assert_allclose(still.current.mean, 0.0, atol=1e-7)


def test_a_run_has_the_timing_of_its_robot_unless_told_another(tmp_path):
    text = (calib_folder() / "fish.toml").read_text(encoding="utf-8")
    text = re.sub("^control_dt *= *0.2", "control_dt = 0.1", text, flags=re.MULTILINE).replace('"linear"', '"hold"')
    (tmp_path / "held.toml").write_text(text, encoding="utf-8")
    timing = lambda *more: settled(asked_for("--robot", str(tmp_path / "held.toml"), *more))
    assert (timing().control_dt, timing().command_path) == (0.1, "hold")
    assert robot_for(timing("--command-path", "linear")).timing.command_path == "linear" == settled(asked_for()).command_path


def test_stated_range_of_the_task_changes_no_draw():
    robot = mjcf.load_robot("fish")
    plain = StationHold(robot, "planar").reset(jax.random.key(3), 32)
    named = settled(calm_run()).task["flow_speed"]
    stated = StationHold(robot, "planar", Options(flow_speed=named)).reset(jax.random.key(3), 32)
    np.testing.assert_array_equal(plain.current.mean, stated.current.mean)
    np.testing.assert_array_equal(plain.obs, stated.obs)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--flow-speeds 0.3,0.1", "expected the smaller number first"),
        ("--control-dt 0.15", "control_dt = 0.15 s is not a multiple of bus_dt = 0.02 s; nearest valid control_dt: 0.16 s"),
        ("--flow-exponent 2 --flow-speeds 0.2", "flow_exponent = 2.0 with flow_speed = 0.2, a constant"),
        ("--hide target,velocity,yaw_rate,joint,joint_rate", "all groups: the policy would see nothing"),
        ("--reward wG=0 wD=0 wS=0", "reward weights wG, wD, wS are all 0"),
        ("--episode-seconds 0.1", "seconds = 0.1 s; expected a multiple of the control step of 0.2 s"),
    ],
)
def test_run_that_cannot_be_is_refused_before_it_starts(line, said, tmp_path, capsys):
    from fishmj.train.__main__ import main

    out = tmp_path / "run"
    assert console.run(main, ["--preset", "quick", "--engine", "planar", *line.split(), "--out", str(out)]) == console.BAD_INPUT
    assert said in capsys.readouterr().err and not out.exists()


def test_policy_of_another_control_step_is_refused_with_the_remedy():
    settings = settled(asked_for("--control-dt", "0.1"))
    policy = policy_of(PolicyLayers(mlp(jax.random.key(0), [11, 8, 3]), "tanh"), settings, {})
    said = fit(policy.meta, body_of(robot_for(preset("quick"))), anyway=False, known={}).refused
    assert said == (
        "decides every 0.1 s, the robot every 0.2 s: put control_dt = 0.1 into [timing] of its description, FILE.toml, and use "
        "that file (--robot FILE.toml), or add --control-dt 0.1, apart from policies that decide at other times",
    )
    assert not fit(policy.meta, body_of(robot_for(settings)), anyway=False, known={}).refused


# ---- episodes ----


def test_episode_return_and_length_are_those_of_whole_finished_episodes():
    """Against episodes counted one by one, over two rollouts; the first of each point began anywhere and is left out."""
    from fishmj.train.ppo import PPO

    learner = PPO(Point(poisoned=2), PPOConfig(envs=8, horizon=16, minibatches=2, hidden=(8,), sigma=3.0), 1000)
    state = learner.init(jax.random.key(0))
    tally, gain, length, first = state.tally, np.zeros(8), np.zeros(8), np.ones(8, bool)
    seen = []
    for key in jax.random.split(jax.random.key(1), 2):
        env_state, rows, ended = state.env_state, [], []
        for one in jax.random.split(key, 16):
            env_state = learner.env.step(env_state, jax.random.uniform(one, (8, 1), minval=-1.0))
            record = record_of(env_state, learner.env.limit)
            rows.append(record)
            gain, length = gain + np.asarray(record.reward), length + 1
            for i in np.flatnonzero(record.done):
                if not first[i] and not record.diverged[i]:
                    ended.append((gain[i], length[i]))
                gain[i], length[i], first[i] = 0.0, 0.0, False
        tally, found = episode_metrics(tally, jax.tree.map(lambda *a: jnp.stack(a), *rows))
        assert ended and len({n for _, n in ended}) > 1
        expected = np.mean(ended, 0)
        np.testing.assert_allclose([found["episode_return"], found["episode_length"]], expected, rtol=1e-5)
        state, seen = state._replace(env_state=env_state), [*seen, *ended]
    assert max(n for _, n in seen) == 10  # the time limit


def test_no_finished_episode_is_no_figure():
    assert reported({"episode_return": math.nan, "episode_length": math.nan, "reward": jnp.float32(1)}) == {"reward": 1.0}
    assert math.isnan(reported({"loss": math.nan})["loss"])  # stops the run


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_metrics_of_learners_have_episodes(algo):
    from fishmj.train.settings import referred

    few = {"horizon": 32, "minibatches": 2} if algo == "ppo" else {"block": 32, "batch": 8, "warmup": 64}
    config = referred(ALGORITHMS[algo].config)(envs=8, hidden=(8,), **few)
    learner = referred(ALGORITHMS[algo].learner)(Point(), config, 800)
    _, metrics = learner.iterate(learner.init(jax.random.key(1)))
    assert 1 <= float(metrics["episode_length"]) <= 10 and float(metrics["episode_return"]) < 0


def test_the_help_of_the_control_step_says_what_counts_by_decision():
    said = " ".join(options().format_help().split())
    assert "--gamma and --reward apply per decision: half the step halves gamma's horizon in seconds" in said


def test_an_interrupted_training_says_so_before_its_summary(monkeypatch):
    said: list[str] = []
    for say in ("say", "warn"):
        monkeypatch.setattr(console, say, lambda *lines: said.extend(lines))
    result = {"folder": "runs/a b", "policy": "p", "algorithm": "ppo", "engine": "planar", "steps": 10, "seconds": 61.0}
    args = SimpleNamespace(resume=True, together=False, devices=1, sweep=None, seeds=None, json=False)
    runs = [PlannedRun(preset("quick"), Path("runs/a b"), None, "")]
    assert report(args, [], runs, [result | {"stopped": True}]) == console.INTERRUPTED
    assert said[0].startswith("interrupted; runs/a b holds the run up to step 10; go on with: fishmj train --resume --out 'runs/")
    assert "stopped after 10 control steps in 1 min 01 s in all (compiling iterations included) on planar" in said[1]


def test_the_command_that_judges_says_what_differs_from_the_robots_own_timing_and_water():
    assert judging(preset("quick"), "runs/a b") == "fishmj evaluate 'runs/a b'"
    own = change(preset("quick"), robot="tendon_fish", command_path="hold", control_dt=0.4)
    assert judging(own, "runs/a") == "fishmj evaluate runs/a --robot tendon_fish --control-dt 0.4 --command-path hold"
    for water, said in (("fitted", ""), ("lbm", ""), ("family", " --water family"), ("a b.toml", " --water 'a b.toml'")):
        assert judging(change(preset("quick"), water=water), "runs/a") == f"fishmj evaluate runs/a{said}"
