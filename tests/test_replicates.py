"""Scatter between replicates is measured right, and only a gap beyond it counts."""

import numpy as np
import pytest

from fishmj import log
from fishmj.base.errors import LogError
from fishmj.log import replicates


def noise(rng, n, tau, sigma):
    """First-order autoregressive noise with standard deviation sigma and correlation exp(-k / tau)."""
    a = np.exp(-1 / tau)
    out = np.empty(n)
    out[0] = rng.normal()
    kicks = np.sqrt(1 - a * a) * rng.normal(size=n)
    for i in range(1, n):
        out[i] = a * out[i - 1] + kicks[i]
    return sigma * out


def run(seed, name, sigma=0.02, tau=20, seconds=20.0, **meta):
    """One synthetic trial: a joint that follows a command, plus noise that has a memory; own irregular stamps."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.clip(rng.normal(0.02, 0.003, int(seconds / 0.02)), 0.005, None)) + 3.0 * seed
    tc = t[0] + np.arange(0, seconds, 0.02)
    joint = 0.4 * np.sin(2 * np.pi * (t - tc[0])) + noise(rng, len(t), tau, sigma)
    tables = {"cmd": {"t": tc, "c1": 0.4 * np.sin(2 * np.pi * (tc - tc[0]))}, "joint": {"t": t, "j1": joint}}
    return log.Trial({"origin": "synthetic", "excitation": "sine", **meta}, tables, name=name)


def test_trials_group_by_what_they_replicate_else_by_conditions():
    trials = [run(0, "a"), run(1, "b"), run(2, "c", robot="other"), run(3, "d", replicate_of="c", robot="other")]
    trials += [run(4, "e", excitation="step"), run(5, "f", excitation=None)]
    found = {tuple(sorted(t.name for t in members)) for members in replicates.groups(trials).values()}
    assert found == {("a", "b"), ("c", "d")}


def test_the_scatter_between_replicates_is_what_was_put_in():
    group = replicates.scatter("sine", [run(seed, f"r{seed}", tau=3) for seed in range(6)])
    joint = group.channel("joint1")
    assert joint.floor == pytest.approx(0.02, rel=0.1) and joint.unit == "rad" and group.aligned == "command"


def test_the_autocorrelation_time_of_squares_is_that_of_theory():
    rng = np.random.default_rng(0)
    for tau in (2.0, 10.0, 40.0):
        a = np.exp(-2 / tau)  # rho^2 of a first-order process
        found = replicates.autocorrelation_time(np.stack([noise(rng, 40000, tau, 1.0) for _ in range(3)]))
        assert found == pytest.approx((1 + a) / (1 - a), rel=0.15)
    assert replicates.autocorrelation_time(rng.normal(size=(2, 5000))) == pytest.approx(1, abs=0.1)
    beat = np.sin(0.2 * np.arange(4000))[None]  # a slipping beat is one piece of information, not 4000
    assert replicates.autocorrelation_time(beat) > 500


def test_scatter_alone_is_hardly_ever_called_a_gap():
    """The true model against a new replicate: the gap is the scatter itself."""
    wrong = 0
    for seed in range(60):
        group = replicates.scatter("sine", [run(10 * seed + k, f"{k}", tau=40) for k in range(3)])
        one = run(10 * seed + 7, "new", tau=40)
        t = one.tables["joint"]["t"]
        gap = np.mean((one.tables["joint"]["j1"] - 0.4 * np.sin(2 * np.pi * (t - t[0]))) ** 2)
        wrong += replicates.judge({"joint1": gap}, group).repeatable
    assert wrong <= 7  # 5 % of 60 is 3; more than 7 would come up one time in 100


def test_a_gap_beyond_the_scatter_counts_and_one_within_does_not():
    group = replicates.scatter("sine", [run(seed, f"r{seed}", tau=3) for seed in range(3)])
    variance = group.channel("joint1").variance
    assert not replicates.judge({"joint1": 1.4 * variance}, group).repeatable
    verdict = replicates.judge({"joint1": 3 * variance}, group)
    assert verdict.repeatable and verdict.p < 1e-3 and verdict.by_channel == {"joint1": pytest.approx(3.0)}
    assert "NOT_REPEATABLE" in replicates.judge({"joint1": 1.4 * variance}, group).text()


def test_few_effective_samples_raise_the_bar_above_one_and_a_half():
    short = replicates.scatter("sine", [run(seed, f"r{seed}", tau=100, seconds=6.0) for seed in range(2)])
    long = replicates.scatter("sine", [run(seed, f"r{seed}", tau=3, seconds=30.0) for seed in range(2)])
    limit = [replicates.judge({"joint1": group.channel("joint1").variance}, group).limit for group in (short, long)]
    assert limit[0] > 2.0 and limit[1] == replicates.RATIO


def test_free_swims_are_compared_relative_to_where_they_start():
    def swim(name, x, y, yaw):
        t = np.arange(0, 10, 0.02)
        along, side = 0.1 * t, 0.02 * np.sin(t)
        c, s = np.cos(yaw), np.sin(yaw)
        pose = {"t": t, "x": x + c * along - s * side, "y": y + s * along + c * side, "yaw": yaw + 0.05 * np.sin(t)}
        return log.Trial({"excitation": "swim"}, {"pose": pose}, name=name)

    group = replicates.scatter("swim", [swim("a", 0, 0, 0), swim("b", 1, -1, 2.0)])
    assert all(group.channel(name).floor < 0.004 for name in ("forward", "left", "turned"))


def test_replicates_without_a_common_clock_are_moved_onto_each_other():
    t = np.arange(0, 12, 1 / 30)

    def swim(name, late):
        yaw = 0.1 * np.sin(2 * np.pi * 0.9 * (t - late)) + 0.02 * np.sin(
            1.3 * (t - late) ** 1.3 if late == 0 else 1.3 * np.abs(t - late) ** 1.3
        )
        return log.Trial({"excitation": "swim"}, {"pose": {"t": t, "x": 0.1 * t, "y": 0 * t, "yaw": yaw}}, name=name)

    group = replicates.scatter("swim", [swim("a", 0.0), swim("b", 0.2)])
    assert group.aligned == "motion" and group.channel("turned").floor < 0.03  # 0.08 when they are left where they are


def test_what_cannot_be_compared_is_said():
    with pytest.raises(LogError, match="has no replicate"):
        replicates.scatter("sine", [run(0, "a")])
    group = replicates.scatter("sine", [run(0, "a"), run(1, "b")])
    with pytest.raises(LogError, match="no channel 'surge' in its replicates; there are joint1"):
        replicates.judge({"surge": 1.0}, group)
    same = run(0, "a")
    with pytest.raises(LogError, match="identical; are they one recording"):
        replicates.judge({"joint1": 1.0}, replicates.scatter("sine", [same, same]))
