"""Faults 1, 2 and 13 to 15 of tests/FAULTS.md in training: nothing paid for is lost; the run says what it did."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from training import StopAt, calm_run, figures_of

from fishmj import mjcf
from fishmj.base import console, store
from fishmj.base.errors import SimDiverged, StoreError
from fishmj.control.policy import Policy
from fishmj.engines import make
from fishmj.tasks.env import Options, StationHold
from fishmj.train import training_run
from fishmj.train.__main__ import main
from fishmj.train.ppo import PPO, PPOConfig
from fishmj.train.training_run import MetricsLog, TrainingRun, learner_of

STEP = 8192  # control steps an iteration of `calm_run`


@pytest.fixture(scope="module")
def learner():
    """(environment, PPO, assessment), compiled once."""
    return learner_of(calm_run())


@pytest.fixture(autouse=True)
def short_pause(monkeypatch):
    monkeypatch.setattr(training_run, "PAUSE", 0.05)


# ---- 1, 2: the physics leaves the finite numbers ----


class Poisoned:
    """The compiled engine, but some fish come back as NaN: number `fish`, whenever its clock shows `tick`."""

    jittable = True

    def __init__(self, robot, fish, tick: int):
        self.engine, self.fish, self.tick = make("compiled", robot), jnp.asarray(fish), tick

    def advance(self, state, commands, params, current, tick):
        """As the engine's."""
        state, trace = self.engine.advance(state, commands, params, current, tick)
        bad = jnp.isin(jnp.arange(len(tick)), self.fish) & (tick == self.tick)
        spoil = lambda a: jnp.where(bad.reshape((-1,) + (1,) * (a.ndim - 1)), jnp.nan, a)
        return jax.tree.map(spoil, state), jax.tree.map(spoil, trace)


def poisoned(fish, tick=0):
    robot = mjcf.load_robot("fish")
    return StationHold(robot, Poisoned(robot, fish, tick), Options(intensity=(0.0, 0.1)))


@pytest.mark.slow
def test_fault_01_a_fish_that_diverges_is_dropped_counted_and_replaced():
    env = poisoned([2], tick=10)
    state = env.reset(jax.random.key(0), 4)
    for k in range(4):
        state = env.step(state, jnp.full((4, 3), 0.3))
        np.testing.assert_array_equal(state.diverged, [False, False, k % 2 == 1, False])  # again in its next episode
        leaves = [leaf for leaf in jax.tree.leaves(state) if jnp.issubdtype(leaf.dtype, jnp.floating)]
        assert all(np.isfinite(leaf).all() for leaf in leaves)
        if k % 2 == 1:
            assert state.count[2] == 0 and state.tick[2] == 0 and not state.fish.v[2].any()  # a new episode, at rest
            assert state.reward[2] == 0 and not state.final_obs[2].any() and not (state.terminated | state.truncated)[2]
    np.testing.assert_array_equal(state.count, [4, 4, 0, 4])


@pytest.mark.slow
def test_fault_02_divergence_above_0_1_percent_stops_with_checkpoint_kept(learner, tmp_path, monkeypatch):
    """Sound until the checkpoint; then three fish are lost in one iteration."""
    settings = calm_run(checkpoint_every=0.0)
    run = StopAt(settings, tmp_path, 2 * STEP, learner=learner)
    run.go()
    kept = run.checkpoints.latest()
    assert (kept.meta["done"], kept.meta["dropped"]) == (2 * STEP, 0) and kept.meta["episodes"] > 50
    again = TrainingRun(settings, tmp_path, learner=learner, resume=True, quiet=True)
    sound = learner[1].iterate

    def spoiled(training):
        training, figures = sound(training)
        return training, {**figures, "diverged": 3}

    monkeypatch.setattr(again, "algorithm", type("Spoiled", (), {"iterate": staticmethod(spoiled), "steps_per_iteration": STEP}))
    with pytest.raises(
        SimDiverged, match=r"3 of \d+ episodes at step 24,576 diverged and were dropped, more than 0.1%"
    ) as caught:
        again.go()
    assert caught.value.term == "physics"
    after = TrainingRun(settings, tmp_path, learner=learner, resume=True, quiet=True)
    assert after.done == 2 * STEP and [line["step"] for line in figures_of(again) if "reward" in line][-1] == 2 * STEP


@pytest.mark.slow
def test_fault_02_the_learner_counts_what_the_physics_lost():
    env = poisoned([1, 3], tick=0)  # two of eight diverge in the first step of each of their episodes
    ppo = PPO(env, PPOConfig(envs=8, horizon=4, minibatches=2, epochs=1, hidden=(8,)), 100)
    training, figures = ppo.iterate(ppo.init(jax.random.key(0)))
    assert figures["diverged"] == 8 and figures["episodes"] >= 8
    leaves = [leaf for leaf in jax.tree.leaves(training) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert all(np.isfinite(leaf).all() for leaf in leaves)


@pytest.mark.slow
def test_weights_that_are_not_finite_are_never_saved(learner, tmp_path):
    run = StopAt(calm_run(), tmp_path, STEP, learner=learner)
    run.go()
    before = run.checkpoints.latest().path.read_bytes()
    run.training = run.training._replace(actor=jax.tree.map(lambda a: a * jnp.nan, run.training.actor))
    with pytest.raises(SimDiverged, match=r"\.actor.* became non-finite at step 8,192; the newest checkpoint .* is intact"):
        run._save()
    assert run.checkpoints.latest().path.read_bytes() == before and len(run.checkpoints.paths()) == 1


# ---- 13: signals and kills ----

TRAIN = """
import sys
from training import calm_run
from fishmj.train.training_run import TrainingRun
TrainingRun(calm_run(checkpoint_every=0.0, assess_every=10**9), sys.argv[1]).go()
"""


def started(*argv) -> subprocess.Popen:
    root = Path(__file__).resolve().parents[1]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), str(root / "tests")])}
    return subprocess.Popen([sys.executable, *argv], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(process, condition, seconds=600):
    """Until the condition holds; fails with what the process said when it ends or the time is over."""
    until = time.monotonic() + seconds
    while not condition():
        if process.poll() is not None or time.monotonic() > until:
            process.kill()
            pytest.fail(f"exit {process.poll()}: {process.communicate()}")
        time.sleep(0.05)


@pytest.mark.slow
def test_fault_13_ctrl_c_saves_exits_130_and_the_run_goes_on(tmp_path, capfd):
    folder = tmp_path / "run"
    options = ["--preset", "quick", "--engine", "compiled", "--hidden", "16,16", "--envs", "64", "--out", str(folder)]
    process = started("-m", "fishmj.train", *options, "--steps", "1e11", "--yes", "--json")
    metrics = folder / "metrics.jsonl"
    wait_for(process, lambda: metrics.exists() and metrics.read_text().count("\n") >= 3)
    process.send_signal(signal.SIGINT)
    said, told = process.communicate(timeout=600)
    assert process.returncode == console.INTERRUPTED == 130
    made = json.loads(said.splitlines()[-1])["runs"][0]
    assert made["stopped"] and "go on with: fishmj train --resume" in told.splitlines()[-1]
    assert np.isfinite(Policy.load(made["policy"])(np.zeros((1, 11)))).all()
    steps = made["steps"] + 2048
    capfd.readouterr()
    assert console.run(main, ["--out", str(folder), "--steps", str(steps), "--resume", "--json"]) == console.OK
    again = json.loads(capfd.readouterr().out.splitlines()[-1])["runs"][0]
    assert again["steps"] >= steps and not again["stopped"]
    rows = [json.loads(line)["step"] for line in metrics.read_text().splitlines() if "reward" in line]
    assert rows == list(range(2048, again["steps"] + 1, 2048))  # no gap, nothing twice


@pytest.mark.slow
def test_fault_13_killed_run_resumes_from_the_newest_complete_checkpoint(learner, tmp_path):
    process = started("-c", TRAIN, str(tmp_path))
    checkpoints = store.Checkpoints(tmp_path / "checkpoints")
    wait_for(process, lambda: checkpoints.paths() and int(checkpoints.paths()[0].stem[5:]) >= 3 * STEP)
    process.kill()
    process.communicate()
    settings = calm_run(assess_every=10**9)
    run = StopAt(settings, tmp_path, 0, learner=learner, resume=True)
    newest = checkpoints.paths()[0]
    assert run.done == int(newest.stem[5:]) >= 3 * STEP
    run.stop_at = run.done + 2 * STEP
    assert run.go()["steps"] == run.stop_at
    whole = StopAt(settings, tmp_path / "whole", run.stop_at, learner=learner)
    whole.go()
    assert figures_of(run) == figures_of(whole)  # the same bits as a run that nobody killed


# ---- 14: the disk is full ----


class FullDisk:
    """`write_tensors` on a disk that has no room for the first `times` checkpoints."""

    def __init__(self, monkeypatch, times):
        self.times, self.real, self.tried = times, store.arrays.write_tensors, 0
        monkeypatch.setattr(store.arrays, "write_tensors", self)

    def __call__(self, path, arrays, meta):
        self.tried += 1
        if self.tried <= self.times:
            needed = sum(a.nbytes for a in arrays.values())
            error = StoreError(f"{path}: disk full: needs {needed} bytes, 0 free; the old file is untouched")
            error.errno = errno.ENOSPC
            raise error
        return self.real(path, arrays, meta)


@pytest.mark.slow
def test_fault_14_full_disk_pauses_training_until_there_is_space(learner, tmp_path, monkeypatch, capfd):
    settings = calm_run(checkpoint_every=0.0, assess_every=10**9)
    StopAt(settings, tmp_path, STEP, learner=learner).go()
    disk = FullDisk(monkeypatch, times=3)
    run = StopAt(settings, tmp_path, 3 * STEP, learner=learner, resume=True)
    capfd.readouterr()
    made = run.go()
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("fishmj:")]
    assert disk.tried > 3 and made["steps"] == 3 * STEP
    assert len(said) == 2 and "paused:" in said[0] and "disk full: needs" in said[0] and "bytes" in said[0]
    assert "the disk has room again" in said[1]
    assert store.Checkpoints(tmp_path / "checkpoints").latest().meta["done"] == 3 * STEP
    reference = StopAt(settings, tmp_path / "reference", 3 * STEP, learner=learner)
    reference.go()
    assert figures_of(run) == figures_of(reference)  # the pause changed nothing


@pytest.mark.slow
def test_fault_14_stop_on_a_full_disk_keeps_the_old_checkpoint(learner, tmp_path, monkeypatch, capfd):
    settings = calm_run(checkpoint_every=0.0, assess_every=10**9)
    run = StopAt(settings, tmp_path, STEP, learner=learner)
    run.go()
    before = {p.name: p.read_bytes() for p in run.checkpoints.paths()}
    FullDisk(monkeypatch, times=10**9)
    run = StopAt(settings, tmp_path, 10**12, learner=learner, resume=True)
    threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    made = run.go()
    assert made["stopped"] and made["steps"] == 2 * STEP  # it waited in the first save
    assert {p.name: p.read_bytes() for p in run.checkpoints.paths()} == before
    assert Path(made["policy"]).is_file() and "not saved:" in capfd.readouterr().err
    monkeypatch.undo()
    assert TrainingRun(settings, tmp_path, learner=learner, resume=True).done == STEP


def test_fault_14_figures_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    board = MetricsLog(tmp_path)
    board.write(1, {"reward": 0.5})
    before = board.path.read_bytes()

    class Full:
        """An open file that takes ten bytes more."""

        def __init__(self, *args, **options):
            self.file = open(*args, **options)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self.file.close()

        def __getattr__(self, name):
            return getattr(self.file, name)

        def write(self, data):
            return self.file.write(data[:10])

    monkeypatch.setattr("fishmj.train.training_run.open", Full, raising=False)
    with pytest.raises(OSError, match=r"disk full: needs \d+ bytes") as caught:
        board.write(2, {"reward": 0.7})
    assert caught.value.errno == errno.ENOSPC and board.path.read_bytes() == before


def test_another_failure_of_the_disk_is_an_error_and_no_pause():
    def broken():
        error = StoreError("x: could not be written (Read-only file system)")
        error.errno = errno.EROFS
        raise error

    with pytest.raises(StoreError, match="Read-only"):
        training_run.when_there_is_room(broken, [])


# ---- 15: a damaged checkpoint ----


@pytest.mark.slow
def test_fault_15_damaged_checkpoint_falls_back_to_the_previous_one(learner, tmp_path, capfd):
    settings = calm_run(checkpoint_every=0.0, assess_every=10**9)
    whole = StopAt(settings, tmp_path, 3 * STEP, learner=learner)
    whole.go()
    expected = figures_of(whole)
    newest, previous = whole.checkpoints.paths()
    raw = bytearray(newest.read_bytes())
    raw[-1000] ^= 0x10
    newest.write_bytes(bytes(raw))
    run = StopAt(settings, tmp_path, 3 * STEP, learner=learner, resume=True)
    said = capfd.readouterr().err
    assert run.done == 2 * STEP and f"fell back to {previous.name}" in said and "sha256 mismatch" in said and newest.name in said
    run.go()
    assert figures_of(run) == expected  # the lost interval again, to the bit
    assert newest.with_suffix(".damaged").read_bytes() == raw
    assert store.Checkpoints(tmp_path / "checkpoints").latest().note == ""
