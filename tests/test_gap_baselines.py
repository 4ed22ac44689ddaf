"""The baselines answer the same cases: right where a text-book case is planted, honest about what they lack."""

import numpy as np
import pytest
from absent import absent

pytest.importorskip("numba")

from fishmj import effects
from fishmj.base.errors import MissingExtra
from fishmj.gap.bench import baselines
from fishmj.gap.bench.baselines import baseline_answer, baseline_scores, delta_bic, e_sindy, everything_free, residual_correlation
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import record_of

SOME = ("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag")


@pytest.fixture(scope="module")
def plant():
    return SwimmingFish(catalogue=[effects.get(name) for name in SOME])


def records(plant, planted, runs=("gait_fast", "drift_north"), seed=11):
    from fishmj.gap.laboratory.virtual_robot import generate

    return [record_of(t, plant.dt) for t in generate(planted, runs, seed)]


def test_everything_free_names_what_moved_most(plant):
    found = everything_free.answer(plant, records(plant, {"steady_current": {"x": 0.05, "y": 0.03}}))
    assert found.word == "NAMED" and len(found.effects) == 1


def test_delta_bic_begins_with_the_strongest_effect(plant):
    found = delta_bic.answer(plant, records(plant, {"steady_current": {"x": 0.05, "y": 0.0}}, ("drift_north", "drift_east")))
    assert next(iter(found.effects)) == "steady_current"
    assert found.effects["steady_current"]["x"] == pytest.approx(0.05, abs=0.01)


def test_a_late_command_goes_with_the_rate_of_the_command(plant):
    found = residual_correlation.answer(plant, records(plant, {"command_latency": {"delay": 0.05}}, ("gait_fast",)))
    assert list(found.effects) == ["command_latency"]
    assert np.isnan(found.effects["command_latency"]["delay"])


@pytest.mark.slow
def test_sparse_regression_finds_the_term_that_is_there():
    pytest.importorskip("pysindy", reason="the baseline e_sindy needs the extra bench")
    rng = np.random.default_rng(0)
    theta = {name: rng.normal(size=200) for name in ("u", "w", "r")}
    assert [name for name, _ in e_sindy.terms(theta, 5.0 * theta["w"] + rng.normal(size=200))] == ["w"]
    assert e_sindy.terms(theta, rng.normal(size=200)) == []


def test_an_absent_library_is_said_so(plant, monkeypatch):
    monkeypatch.setattr(baseline_scores, "find_spec", lambda package: None)
    assert "pip install 'fishmj[bench]'" in baselines.reason_absent("e_sindy")
    assert baselines.reason_absent("delta_bic") == ""
    absent(monkeypatch, "pysindy")
    with pytest.raises(MissingExtra, match="pysindy"):
        e_sindy.terms({"u": np.ones(3)}, np.ones(3))


def test_autocorrelation_makes_samples_fewer():
    rng = np.random.default_rng(0)
    white = rng.normal(size=4000)
    slow = np.convolve(white, np.ones(20) / 20, mode="valid")
    assert baseline_answer.correlation_time(white) == pytest.approx(1.0, abs=0.3)
    assert baseline_answer.correlation_time(slow) == pytest.approx(20.0, rel=0.4)


def test_rows_are_scored_like_the_search(plant):
    case = BenchCase("t", "single", {"command_latency": {"delay": 0.05}}, 1.0, ("gait_fast",), 11)
    row = baselines.rows_of(plant, case, {"true_gap": 100.0, "beyond_gap": 100.0}, ("residual_correlation",))[
        "residual_correlation"
    ]
    table = baselines.compared([row], {"residual_correlation": [row]})
    assert row["answer"] == "NAMED" and "1/1" in table and "residual_correlation" in table
