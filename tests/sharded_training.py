"""Checks for a process with two virtual CPU devices, each by its name on the command line; `test_train_sharding` runs them."""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from training import calm_run

from fishmj.control.policy import Policy
from fishmj.train.build import config_of, environment
from fishmj.train.ppo import PPO
from fishmj.train.settings import change
from fishmj.train.sharding import COLUMNS, EACH
from fishmj.train.training_run import TrainingRun, arrays_of, learner_of

TINY = {"hidden": (16,), "envs": 16, "horizon": 8, "minibatches": 2, "epochs": 2}


def tiny(**changes):
    """128 control steps an iteration, with gusts, sensor noise and the draws of a fish."""
    return change(calm_run(), steps=256, assess_every=10**9, task={"noise": 1.0, "randomisation": 1.0}, algorithm=TINY | changes)


def on(devices: int, **changes) -> PPO:
    settings = tiny(**changes)
    return PPO(environment(settings), config_of(settings), settings.steps, devices)


def gradient():
    """From the same rollout the mean gradient of two devices is that of one."""
    one, two = on(1, minibatches=1, epochs=1), on(2, minibatches=1, epochs=1)
    state = one.init(jax.random.key(3))
    _, batch, _ = jax.jit(one.collect)(state)
    split = two.shards.split(lambda given: two.update(*given), (EACH, COLUMNS), EACH)
    (mine, opt, _), (theirs, other, _) = jax.jit(one.update)(state, batch), jax.jit(split)((state, batch))
    gradient_in = lambda adam: np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(adam[1][0].mu)])
    assert np.abs(gradient_in(opt)).max() > 1e-3
    np.testing.assert_allclose(gradient_in(other), gradient_in(opt), rtol=1e-4, atol=1e-7)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-4, atol=1e-6)


def empties():
    """No empty array is split, although the state has some: XLA for GPUs crashes there."""
    two = on(2)
    state = two.place(two.init(jax.random.key(0)))
    assert any(leaf.size == 0 for leaf in jax.tree.leaves(state))
    text = two.iterate.lower(two, state).as_text()
    splits = [line for line in text.splitlines() if "manual_computation" in line]
    assert splits and not any("tensor<0x" in line or "x0x" in line for line in splits)


def draws():
    """Fish that start alike on two devices part at once; the networks stay the same on both, and nothing compiles twice."""
    two = on(2)
    state = two.init(jax.random.key(0))
    rows = np.r_[0:8, 0:8]
    fish = two.layout(state).env_state
    twins = jax.tree.map(lambda leaf, spec: leaf if spec == EACH or not leaf.size else leaf[rows], state.env_state, fish)
    state, _ = two.iterate(two.place(state._replace(env_state=twins)))
    obs = np.asarray(state.env_state.obs)
    assert not (obs[:8] == obs[8:]).all(1).any()
    state, figures = two.iterate(state)
    assert two.iterate._cache_size() == 1 and np.isfinite(float(figures["loss"]))
    for leaf in jax.tree.leaves((state.actor, state.critic, state.opt_state)):
        first, second = (np.asarray(shard.data) for shard in leaf.addressable_shards)
        assert np.array_equal(first, second) and first.shape == leaf.shape
    assert {shard.data.shape[0] for shard in state.env_state.obs.addressable_shards} == {8}


def resume():
    """A run of two devices resumes on one, to the same state, and the reverse."""
    folder, settings = Path(sys.argv[2]), tiny()
    learners = {n: learner_of(settings, n) for n in (1, 2)}
    for first, then in ((2, 1), (1, 2)):
        out = folder / f"{first}to{then}"
        begun = TrainingRun(settings, out, learner=learners[first], quiet=True)
        assert begun.go()["devices"] == first
        assert Policy.load(out / "last.safetensors").meta.get("devices", 1) == first
        longer = replace(begun.settings, steps=512)
        more = TrainingRun(longer, out, learner=learners[then], quiet=True, resume=True)
        before, after = arrays_of(begun.training), arrays_of(more.training)
        assert before.keys() == after.keys() and all(np.array_equal(before[k], after[k]) for k in before)
        assert more.go()["steps"] == 512
        assert Policy.load(out / "last.safetensors").meta.get("devices", 1) == then


def learning():
    """Two devices learn what one learns in a million steps."""
    settings = calm_run()
    made = TrainingRun(settings, Path(sys.argv[2]), learner=learner_of(settings, 2), quiet=True).go()
    assert made["tune_arrival"] > 0.5 and made["tune_stayed"] > 0.5, made


if __name__ == "__main__":
    assert jax.local_device_count() == 2
    globals()[sys.argv[1]]()
