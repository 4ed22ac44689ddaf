"""The study of the monitor: a loopback robot through the host, effects in mid-swim, stamps that are the same in every swim."""

import json

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.base.store import write_json
from fishmj.deploy.monitor.statistics import Reference, learn
from fishmj.deploy.monitor.tick_interpolation import as_heard
from studies.monitor import __main__ as study
from studies.monitor import loopback_swims, results
from studies.monitor.loopback_swims import swim
from studies.monitor.results import Watched


def test_robot_stamps_are_shifted_by_the_least_delay_of_each_clock_restart():
    own = np.array([5.0, 5.02, 5.04, 0.0, 0.02])  # it began anew
    late = np.array([0.004, 0.003, 0.009, 0.005, 0.006])
    heard = np.array([1.0, 1.02, 1.04, 1.2, 1.22]) + late
    tables = {"joint": {"t": heard * 0, "t_robot": own, "t_rx": heard, "j1": own}, "pose": {"t": own}}
    made = as_heard(tables)
    assert made["joint"]["t"] == pytest.approx([1.003, 1.023, 1.043, 1.205, 1.225])
    assert made["pose"] is tables["pose"] and made["joint"]["j1"] is own
    assert as_heard({"joint": {"t": own}})["joint"] == {"t": own}


def test_monitor_jobs_are_split_over_the_cores_in_bounded_parts():
    jobs = [(200, n, "") for n in range(130)]
    assert [len(part) for part in study.parts(jobs, 1)] == [60, 60, 10] and [len(p) for p in study.parts(jobs[:5], 2)] == [3, 2]
    assert study.parts([], 4) == []


def test_a_score_of_nothing_says_so(tmp_path):
    with pytest.raises(ConfigError, match="leave --score out"):
        study.main(["--out", str(tmp_path), "--score"])


def small_reference() -> Reference:
    rng = np.random.default_rng(5)
    joint = lambda: (0.01 * rng.standard_normal(20), rng.standard_normal((20, 2)))
    blocks = [{"j1": joint(), "power": (rng.standard_normal(20), np.ones((20, 1)))} for _ in range(60)]
    return learn(blocks, {"j1": ("offset", "rate"), "power": ("load",)})


def test_a_reference_that_was_kept_is_the_one_that_was_learnt(tmp_path):
    known = small_reference()
    results.write_reference(tmp_path / "r.npz", known)
    again = results.read_reference(tmp_path / "r.npz")
    assert again.blocks == 60 and list(again.channels) == ["j1", "power"]
    for name, channel in known.channels.items():
        for field in results.FIELDS:
            np.testing.assert_array_equal(getattr(channel, field), getattr(again.channels[name], field))


def test_swims_that_were_watched_are_neither_swum_nor_predicted_again(tmp_path, monkeypatch, capsys):
    """What the monitor said of them is enough: their tables may be gone."""
    for job in study.watched_jobs([200, 201], 1):
        robot, _, effect = job
        alarms = [(80.0 + robot - 200, "power", "load")] if effect else []
        write_json(tmp_path / study.result_of(job), Watched(0.1, 297, alarms, 0.5)._asdict())
    never = lambda *_: pytest.fail("swum again")
    monkeypatch.setattr(study, "made", never)
    monkeypatch.setattr(study, "predicted", never)
    words = ["--robots", "2", "--swims", "1", "--jobs", "1", "--out", str(tmp_path), "--json"]
    assert study.main(words) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["alarms"] == 0 and told["hours"] == pytest.approx(0.33) and told["swims"] == 2
    assert [row["found"] for row in told["effects"]] == ["2/2"] * 6
    assert told["effects"][0]["median_s"] == 20.5 and told["effects"][0]["worst_s"] == 21.0
    with pytest.raises(ConfigError, match="leave --score out"):  # another rate is another threshold: watch again
        study.main([*words, "--score", "--rate", "0.5"])


def test_summary_counts_healthy_alarms_and_excludes_those_before_an_effect():
    seen = {(200, 1, ""): Watched(0.1, 1800, [(34.0, "j3", "friction")], 1.07), (200, 2, ""): Watched(0.1, 1800, [], 0.6)}
    seen[200, 500, "body_mass"] = Watched(0.1, 117, [(34.0, "sway", "size"), (99.0, "power", "load")], 1.2)
    told = study.summary(seen, 0.1)
    assert told["alarms"] == 1 and list(told["false"]) == ["200_1"] and told["hours"] == 2.0
    row = next(row for row in told["effects"] if row["effect"] == "body_mass")
    assert row["before"] == 1 and row["median_s"] == 39.0 and row["found"] == "1/1" and row["first in"] == "power load"
    assert study.highest_rate(0, 10.0) == pytest.approx(0.29957, abs=1e-5)  # -ln 0.05 / 10 h
    assert told["rate_below_95"] == pytest.approx(4.7439 / 2.0, abs=1e-4)  # of one event: tables of the Poisson distribution
    assert "1 alarms in 2.00 h" in study.summary_lines(told)[0] and "1.07 of its limit" in study.summary_lines(told)[-1]


@pytest.mark.slow
def test_the_host_swims_the_loopback_robot_and_an_effect_comes_in_mid_swim():
    """The same robot, seed and targets: until the effect comes both swims are the same, from then on they are not."""
    healthy, weak = swim(7, 1, 12.0), swim(7, 1, 12.0, {"torque_saturation": {"limit": 0.5}}, at=6.0)
    for name, columns in (("cmd", ("c1", "c3")), ("joint", ("j1", "j3")), ("pose", ("x", "yaw")), ("power", ("V", "I"))):
        table, other = healthy[name], weak[name]
        before = table["t"] < 5.9
        assert len(table["t"]) == pytest.approx(600, abs=3)
        for column in columns:
            assert np.array_equal(table[column][before], other[column][: len(table["t"])][before])
    late = healthy["joint"]["t"] > 8.0
    assert np.max(np.abs(healthy["joint"]["j3"] - weak["joint"]["j3"])[late]) > 0.02


def test_a_clock_that_was_set_otherwise_moves_no_stamp_of_a_healthy_robot(monkeypatch):
    """Two swims of one robot, whose clocks a question and its answer set 1.5 ms apart: believed, 23 alarms in 10 min."""
    logged, phase = [], lambda t: float(np.median((t + 0.01) % 0.02))

    def heard(tables):
        logged.append(phase(tables["joint"]["t"] - tables["cmd"]["t"][0]))
        return as_heard(tables)

    monkeypatch.setattr(loopback_swims, "as_heard", heard)
    phases = [phase(swim(200, seed, 0.6)["joint"]["t"]) for seed in (200_000, 200_007)]
    assert np.ptp(logged) == pytest.approx(1.5e-3, abs=2e-4)
    assert np.ptp(phases) < 2e-4
