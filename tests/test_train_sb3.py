"""Stable-baselines3 as another learner: same fish, same run, same policy file. Marked sb3, but for what holds without it."""

import json
import sys

import jax
import numpy as np
import pytest
from absent import absent
from training import StopAt, figures_of

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_tensors
from fishmj.control.policy import Policy
from fishmj.tasks.gym.fish_env import FishVectorEnv
from fishmj.tasks.station_hold import input_scale
from fishmj.train.__main__ import main
from fishmj.train.build import config_of, policy_of
from fishmj.train.settings import Settings

SMALL = {"hidden": (32, 32), "envs": 16, "batch": 64, "warmup": 512, "utd": 0.25, "learning_rate": 2e-3}
ON_POLICY = {"hidden": (32, 32), "envs": 16, "horizon": 16, "minibatches": 2, "activation": "relu", "learning_rate": 2e-3}


def settings(**changes) -> Settings:
    """A run of some seconds."""
    algorithm = ON_POLICY if changes.get("algo") == "sb3-ppo" else SMALL
    base = {"algo": "sb3-sac", "engine": "compiled", "algorithm": algorithm, "assess_episodes": 4}
    return Settings(**{**base, "steps": 2048, "assess_every": 1024, "checkpoint_every": 0.0, **changes})


def learner_of(run: Settings):
    """The learner of a run with its fish, seed 2."""
    from fishmj.train import sb3

    kind = {"sb3-sac": sb3.StableSAC, "sb3-ppo": sb3.StablePPO}[run.algo]
    config = config_of(run)
    learner = kind(sb3.FishVecEnv(run, config.envs, reward_scale=config.reward_scale), config, run.steps)
    return learner, learner.init(jax.random.key(2))


def stopping(stopped: list, steps: int):
    """TrainingRun that is interrupted after so many steps and is kept in `stopped`."""

    def made(*args, **options):
        stopped.append(StopAt(*args, steps=steps, **{k: v for k, v in options.items() if k != "quiet"}))
        return stopped[-1]

    return made


def test_without_the_extra_the_message_has_the_install_line(monkeypatch, capsys):
    absent(monkeypatch, "torch")
    monkeypatch.delitem(sys.modules, "fishmj.train.sb3", raising=False)
    assert console.run(main, ["--preset", "quick", "--algo", "sb3-sac"]) == console.BAD_INPUT
    error = capsys.readouterr().err
    assert 'pip install "fishmj[sb3]"' in error and len(error.splitlines()) == 1


@pytest.mark.sb3
def test_sb3_env_is_the_scaled_vector_env_and_bootstraps_time_limits():
    from fishmj.train.sb3 import FishVecEnv

    shoal = FishVecEnv(settings(task={"turbulence": "gust", "hide": ("joint",)}), 6)
    seeds = shoal.seed(3)
    other = FishVectorEnv(6, engine="compiled", autoreset_mode="SameStep", turbulence="gust")
    seen, (raw, _) = shoal.reset(), other.reset(seed=seeds)
    factor = np.where(np.isin(np.arange(11), [5, 6, 7]), 0, 1) / input_scale(3)
    rng, ends = np.random.default_rng(0), []
    for _ in range(160):
        np.testing.assert_allclose(seen, raw * factor, rtol=1e-5)
        assert seen.dtype == np.float32 and shoal.observation_space.contains(seen[0])
        action = rng.uniform(-0.2, 0.2, (6, 3)).astype(np.float32)
        seen, reward, done, infos = shoal.step(action)
        raw, gain, left, late, info = other.step(action)
        np.testing.assert_array_equal(done, left | late)
        np.testing.assert_allclose(reward, gain, rtol=1e-6)
        for i in np.flatnonzero(done):
            ends.append(infos[i]["TimeLimit.truncated"])
            assert infos[i]["TimeLimit.truncated"] == late[i] != left[i]
            np.testing.assert_allclose(infos[i]["terminal_observation"], info["final_obs"][i] * factor, rtol=1e-5)
            assert not np.allclose(infos[i]["terminal_observation"], seen[i])
        assert all(not infos[i] for i in np.flatnonzero(~done))
    assert True in ends and False in ends
    metrics = shoal.metrics()
    assert metrics["episodes"] == len(ends) and metrics["left_tank"] == 1 - np.mean(ends)


@pytest.mark.sb3
def test_seeds_of_runs_share_no_fish():
    from fishmj.train.sb3 import FishVecEnv

    shoal = FishVecEnv(settings(), 4)
    first, second, again = shoal.seed(0), shoal.seed(1), shoal.seed(0)
    assert first == again and not set(first) & set(second)


@pytest.mark.sb3
@pytest.mark.parametrize("algo", ["sb3-sac", "sb3-ppo"])
def test_a_policy_with_memory_sees_what_sb3_saw(algo):
    run = settings(algo=algo, task={"memory": 3, "turbulence": "gust"})
    learner, training = learner_of(run)
    shoal, env = learner.shoal, learner.model.env
    network, seen = learner.policy_layers(training.actor), env.reset()
    policy = policy_of(network, run, {})
    mine = Policy.of(shoal, [(np.asarray(w).T, b) for w, b in network.layers], activation=network.activation)
    assert mine.memory == 3 and all(np.array_equal(a, b) for a, b in zip(mine.weights[0], policy.weights[0], strict=True))
    for _ in range(10):
        action, _ = learner.model.predict(seen, deterministic=True)
        seen, _, done, _ = env.step(action)
        swum = action if algo == "sb3-sac" else np.tanh(action)
        np.testing.assert_allclose(policy(seen[:, 14:25] * input_scale(3)), swum, atol=1e-5)
        np.testing.assert_array_equal(seen[:, 11:14], swum)
        assert not done.any()


@pytest.mark.sb3
def test_dropped_steps_never_reach_the_replay_memory():
    from gymnasium.spaces import Box

    from fishmj.train.sb3 import FiniteReplayBuffer

    memory = FiniteReplayBuffer(40, Box(-1, 1, (2,)), Box(-1, 1, (1,)), device="cpu", n_envs=4)
    number = np.arange(4.0)
    rows = lambda lost: (
        *(np.tile(number[:, None], (1, k)) for k in (2, 2, 1)), number, np.zeros(4), [{"diverged": i in lost} for i in range(4)],
    )  # fmt: skip
    memory.add(*rows([0, 2]))
    memory.add(*rows([0, 1, 2, 3]))
    memory.add(*rows([]))
    np.testing.assert_array_equal(memory.rewards[:3], [[1, 1, 1, 3], [0, 1, 2, 3], [0, 0, 0, 0]])
    np.testing.assert_array_equal(memory.observations[:2, :, 0], memory.rewards[:2])
    assert memory.pos == 2


@pytest.mark.sb3
def test_a_short_run_learns_that_only_moving_costs(tmp_path):
    """With the goal's weight at zero the best fish holds still: the cost of moving falls below a third of chance."""
    from fishmj.train import sb3

    run = settings(steps=6000, assess_every=3000, reward={"wG": 0.0, "wS": 0.05})
    made = sb3.train_sb3(run, tmp_path)
    reward = [line["reward"] for line in figures_of_folder(tmp_path) if "reward" in line]
    assert np.mean(reward[-4:]) > np.mean(reward[:2]) / 3 and np.mean(reward[:2]) < -0.1
    assert made["algorithm"] == "sb3-sac" and made["steps"] >= 6000 and not made["stopped"] and np.isfinite(made["tune_return"])
    assert made.keys() >= {"folder", "policy", "engine", "seed", "seconds", "steps_per_second", "tune_arrival"}
    policy = Policy.load(tmp_path / "last.safetensors")
    assert [w.shape for w, _ in policy.weights] == [(32, 11), (32, 32), (3, 32)] and policy.meta["activation"] == "relu"


def figures_of_folder(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.sb3
def test_stopped_sb3_run_exports_its_policy_and_resumes_with_empty_buffer(tmp_path, capfd, monkeypatch):
    from fishmj.train import sb3

    run = settings(assess_every=10**9)
    stopped = []
    monkeypatch.setattr(sb3, "TrainingRun", stopping(stopped, 1024))
    made = sb3.train_sb3(run, tmp_path)
    assert made["stopped"] and made["steps"] == 1024 and made["policy"].endswith("last.safetensors")
    learner, before = stopped[0].algorithm, stopped[0].training
    files = {path.suffix for path in tmp_path.rglob("*") if path.is_file() and "events" not in path.name}
    assert files == {".safetensors", ".json", ".jsonl"}
    arrays, meta = read_tensors(stopped[0].checkpoints.paths()[0])
    assert meta["done"] == 1024 and not any("replay" in name for name in arrays)
    obs = np.random.default_rng(0).normal(size=(200, 11)).astype(np.float32)
    expected, _ = learner.model.predict((obs / input_scale(3)).astype(np.float32), deterministic=True)
    np.testing.assert_allclose(Policy.load(made["policy"])(obs), expected, atol=1e-5)
    np.testing.assert_allclose(learner.act(before.actor, obs), expected, atol=1e-5)

    seen = {}

    def watch(*args, **options):
        again = StopAt(*args, steps=2048, **{k: v for k, v in options.items() if k != "quiet"})
        again.algorithm._load_state(again.training)
        seen.update(tensors=again.algorithm._snapshot().tensors, memory=again.algorithm.model.replay_buffer.size())
        return again

    monkeypatch.setattr(sb3, "TrainingRun", watch)
    capfd.readouterr()
    assert sb3.train_sb3(run, tmp_path, resume=True)["steps"] == 2048
    assert "checkpoints do not hold the replay buffer: the policy refills it by 512 steps first" in capfd.readouterr().err
    assert seen["memory"] == 0 and seen["tensors"].keys() == before.tensors.keys()
    for name, value in before.tensors.items():  # networks, moments and temperature, to the bit
        np.testing.assert_array_equal(value, seen["tensors"][name], err_msg=name)
    assert any("exp_avg" in name and np.any(value) for name, value in before.tensors.items())
    losses = [line["loss"] for line in figures_of(stopped[0]) if "loss" in line]
    assert losses[0] == 0 and losses[-1] > 0


@pytest.mark.sb3
def test_the_command_trains_and_wrong_settings_are_named(tmp_path, capfd):
    argv = ["--preset", "paper-sac", "--algo", "sb3-sac", "--engine", "batch", "--hidden", "8", "--envs", "4"]
    here = ["--out", str(tmp_path / "run"), "--json"]
    assert console.run(main, [*argv, *here, "--steps", "64"]) == console.OK  # MuJoCo's own engine trains here, too
    made = json.loads(capfd.readouterr().out.splitlines()[-1])["runs"][0]
    assert (made["engine"], made["steps"]) == ("batch", 64) and Policy.load(made["policy"]).meta["algorithm"] == "sb3-sac"
    assert console.run(main, [*argv, *here, "--steps", "64"]) == console.BAD_INPUT
    assert "already holds a run" in capfd.readouterr().err
    elsewhere = ["--out", str(tmp_path / "other")]
    assert console.run(main, [*argv, *elsewhere, "--critic", "privileged"]) == console.BAD_INPUT
    assert "--critic is a setting of ppo, not of sb3-sac" in capfd.readouterr().err


# ---- PPO ----


@pytest.mark.sb3
def test_ppo_s_policy_file_is_its_deterministic_action_to_rounding():
    """Far from zero, too, where SB3 alone would clip the mean at 1 and the file has its tanh."""
    learner, training = learner_of(settings(algo="sb3-ppo"))
    with torch_grad_off():
        learner.model.policy.action_net.weight *= 150
    network = learner.policy_layers(learner._snapshot().actor)
    obs = np.random.default_rng(0).normal(size=(400, 11)).astype(np.float32)
    u, _ = learner.model.predict((obs / input_scale(3)).astype(np.float32), deterministic=True)
    assert np.abs(u).max() > 1.2 and np.abs(u).min() < 0.1
    np.testing.assert_allclose(policy_of(network, settings(algo="sb3-ppo"), {})(obs), np.tanh(u), atol=1e-6)
    np.testing.assert_allclose(learner.act(network.layers, obs), np.tanh(u), atol=1e-6)
    assert len(training.actor) == 3


def torch_grad_off():
    import torch

    return torch.no_grad()


@pytest.mark.sb3
def test_ppo_bootstraps_a_time_limit_but_not_an_end_and_drops_a_diverged_step():
    """Advantages of the collected rollout against delta written out; one fish is declared lost."""
    run = settings(algo="sb3-ppo", task={"seconds": 2.0}, algorithm={**ON_POLICY, "gamma": 0.9, "lam": 0.0})
    learner, _ = learner_of(run)
    seen, beyond, shoal = [], [], learner.shoal
    inner = shoal.step_wait

    def watched():
        out = inner()
        if len(shoal.tally) == 10:  # the time limit of all fish
            shoal.tally[-1].diverged[3] = True
            out[3][5]["TimeLimit.truncated"] = False  # as if it had left the tank
            ends = learner.model.policy.obs_to_tensor(np.stack([info["terminal_observation"] for info in out[3]]))[0]
            beyond.append(learner.model.policy.predict_values(ends).detach().numpy()[:, 0])
        seen.append((out[0], out[1].copy(), *out[2:]))  # SB3 adds to the rewards in place
        return out

    shoal.step_wait = watched
    learner.iterate(learner._now)
    buffer, last = learner.model.rollout_buffer, seen[9]
    assert last[2].all() and [i for i, info in enumerate(last[3]) if not info["TimeLimit.truncated"]] == [5]
    assert not any(out[2].any() for out in seen[:9])
    # the networks have changed since: the values of the rollout are those that it stored
    value, gain = buffer.values.reshape(16, 16, order="F"), np.stack([out[1] for out in seen])
    advantage = buffer.advantages.reshape(16, 16, order="F")
    np.testing.assert_allclose(advantage[4], gain[4] + 0.9 * value[5] - value[4], atol=1e-5)
    expected = gain[9] + 0.9 * np.where(np.arange(16) == 5, 0, beyond[0]) - value[9]
    expected[3] = 0
    assert np.abs(beyond[0]).max() > 1e-3 and advantage[9, 3] == 0
    np.testing.assert_allclose(advantage[9], expected, atol=1e-5)


@pytest.mark.sb3
def test_a_ppo_run_repeats_stops_and_resumes_from_its_tensors(tmp_path, monkeypatch, capfd):
    from fishmj.train import sb3

    run = settings(algo="sb3-ppo", assess_every=10**9)
    whole = [sb3.train_sb3(run, tmp_path / name, quiet=True) for name in ("a", "b")]
    first, again = (Policy.load(made["policy"]) for made in whole)
    assert whole[0]["steps"] == 2048 and first.meta["algorithm"] == "sb3-ppo" and first.meta["hyperparameters"]["horizon"] == 16
    assert all(
        np.array_equal(a, b) for one, two in zip(first.weights, again.weights, strict=True) for a, b in zip(one, two, strict=True)
    )
    stopped: list = []
    monkeypatch.setattr(sb3, "TrainingRun", stopping(stopped, 1024))
    assert sb3.train_sb3(run, tmp_path / "c")["stopped"]
    before = stopped[0].training.tensors
    assert "policy.log_std" in before and before["adam.0.step"] == 4 * 4 * 2
    np.testing.assert_allclose(rate_of(stopped[0]), 2e-3 * 0.1 ** (1024 / 2048), rtol=1e-6)
    monkeypatch.setattr(sb3, "TrainingRun", stopping(stopped, 1280))
    capfd.readouterr()
    assert sb3.train_sb3(run, tmp_path / "c", resume=True)["steps"] == 1280
    assert "checkpoints do not hold the fish" in capfd.readouterr().err
    after = stopped[1].training.tensors
    assert after["steps"] == 1280 and after["adam.0.step"] == 5 * 4 * 2  # Adam goes on, and so does the falling rate
    np.testing.assert_allclose(rate_of(stopped[1]), 2e-3 * 0.1 ** (1280 / 2048), rtol=1e-6)
    with pytest.raises(ConfigError, match="sb3-ppo: envs x horizon = 256 does not split into 3 minibatches"):
        sb3.train_sb3(settings(algo="sb3-ppo", algorithm={**ON_POLICY, "minibatches": 3}), tmp_path / "d")


def rate_of(run) -> float:
    """Learning rate of the last update."""
    return run.algorithm.model.policy.optimizer.param_groups[0]["lr"]
