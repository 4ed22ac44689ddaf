"""The study of the monitor: a loopback robot through the host, effects in mid-swim, stamps that are the same in every swim."""

import numpy as np
import pytest

from fishmj.deploy.monitor_rows import as_heard
from fishmj.errors import ConfigError
from fishmj.studies.monitor import __main__ as study
from fishmj.studies.monitor.loopback_swims import swim


def test_stamps_of_the_robots_clock_are_shifted_by_the_least_delay_and_each_life_of_it_by_its_own():
    own = np.array([5.0, 5.02, 5.04, 0.0, 0.02])  # it began anew
    late = np.array([0.004, 0.003, 0.009, 0.005, 0.006])
    heard = np.array([1.0, 1.02, 1.04, 1.2, 1.22]) + late
    tables = {"joint": {"t": heard * 0, "t_robot": own, "t_rx": heard, "j1": own}, "pose": {"t": own}}
    made = as_heard(tables)
    assert made["joint"]["t"] == pytest.approx([1.003, 1.023, 1.043, 1.205, 1.225])
    assert made["pose"] is tables["pose"] and made["joint"]["j1"] is own
    assert as_heard({"joint": {"t": own}})["joint"] == {"t": own}


def test_jobs_are_predicted_in_parts_for_each_core_and_never_too_many_side_by_side():
    jobs = [(200, n, "") for n in range(130)]
    assert [len(part) for part in study.parts(jobs, 1)] == [60, 60, 10] and [len(p) for p in study.parts(jobs[:5], 2)] == [3, 2]
    assert study.parts([], 4) == []


def test_a_score_of_nothing_says_so(tmp_path):
    with pytest.raises(ConfigError, match="leave --score out"):
        study.main(["--out", str(tmp_path), "--score"])


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


@pytest.mark.slow
def test_a_healthy_robot_has_the_same_stamps_in_every_swim():
    """Else the monitor takes a clock that was set a millisecond otherwise for a fault of the joints."""
    phases = [np.median(swim(7, seed, 4.0)["joint"]["t"] % 0.02) for seed in (1, 2, 3)]
    assert np.ptp(phases) < 5e-4
