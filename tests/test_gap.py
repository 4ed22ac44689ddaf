"""The discrepancy search on fish whose hidden effect is known: it names it, sizes it, and stays silent when nothing is hidden.

A latency, a force outside the catalogue, restless water, and one more fish without a fault: test_examples_gap.py; a current:
test_gap_outdone.py.
"""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import effects
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.whitening import leftover, unexplained, whitening
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search import likelihood
from fishmj.gap.search.stepwise import CrossValidatedFit, converge, informative_records, prune, split
from fishmj.gap.thresholds import frozen
from fishmj.gap.workflow import investigate, unrepeatable
from fishmj.sim import Sim

SHORT = ("gait_fast", "drift_north", "turn_left", "tow_oblique")
SOME = ("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag")
SOME += ("speed_limit", "command_quantisation")
NULL = SimulatedNull(runs=64)


@pytest.fixture(scope="module")
def plant():
    return SwimmingFish(catalogue=[effects.get(name) for name in SOME])


def hidden(planted: dict, seed: int, runs=SHORT):
    from fishmj.gap.laboratory.virtual_robot import generate

    return generate(planted, runs, seed)


def test_rollouts_are_those_of_mujoco(plant):
    """The compiled plant at its null is the simulator that it questions, to round-off."""
    sim = Sim("fish", water="structured")
    trial = sim.run(lambda t: 0.5 * np.sin(2 * np.pi * t - np.arange(3)) * np.clip(t - 0.5, 0.0, 1.0), 3.0)
    record = record_of(trial, plant.dt)
    seen = plant.predict([record], plant.null)[0]
    assert np.abs(seen["joint"][0] - record.joint.values).max() < 1e-9
    late = np.interp(record.pose.t - plant.camera, record.pose.t, record.pose.values[:, 0])
    assert np.abs(seen["pose"][0, 10:, 0] - late[10:]).max() < 1e-3  # straight lines between stamps against the cubic


def test_a_command_acts_at_its_stamp_and_not_at_the_models_next_step(plant):
    """A clock 40 ppm fast stamps every command just behind a step: the joints are those of the exact clock all the same."""
    trial = Sim("fish", water="structured").run(lambda t: 0.5 * np.sin(6 * t - np.arange(3)) * min(t, 1.0), 3.0)
    cmd = trial.table("cmd")
    seen = []
    for stamps in (cmd["t"], cmd["t"] * (1 + 40e-6), cmd["t"] + np.where(np.arange(len(cmd["t"])) % 2, 1.3e-3, 0.0)):
        record = record_of(replace(trial, tables=trial.tables | {"cmd": cmd | {"t": stamps}}), plant.dt)
        seen.append(plant.predict([record], plant.null)[0]["joint"][0])
        held = np.interp(
            np.arange(len(record.commands) + 1) * plant.dt,
            np.append(stamps, 9.0),
            np.r_[0, np.cumsum(cmd["c1"] * np.diff(stamps, append=9.0))],
        )
        assert np.diff(held) / plant.dt == pytest.approx(record.commands[:, 0], abs=1e-9)
    assert np.abs(seen[1] - seen[0]).max() < 5e-4
    assert np.abs(seen[2] - seen[0]).max() < 3e-3  # half of the commands are 1.3 ms late


@pytest.mark.part("search")
def test_a_hidden_effect_is_named_with_its_size(plant):
    verdict = investigate(plant, hidden({"coulomb_friction": {"torque": 0.12}}, 11), null=NULL).verdict
    assert verdict.answer == "NAMED", verdict.text()
    assert [e.name for e in verdict.effects] == ["coulomb_friction"]
    assert verdict.effects[0].parameters["torque"].value == pytest.approx(0.12, rel=0.1)
    assert verdict.gap_after < 0.5 * verdict.gap_before


def test_nothing_hidden_is_agreement(plant):
    verdict = investigate(plant, hidden({}, 22), null=NULL).verdict
    assert verdict.answer == "AGREES", verdict.text()


def test_a_repeatable_gap_is_repeatable(plant):
    trials = hidden({"steady_current": {"x": 0.05, "y": 0.0}}, 42, ("drift_north",) * 3)
    records = [record_of(t, plant.dt) for t in trials]
    from fishmj.gap.search.likelihood import likelihood_of

    assert unrepeatable(trials, likelihood_of(plant, records, NULL)) == ""


def test_folds_share_the_records_and_part_replicates(plant):
    records = [record_of(t, plant.dt) for t in hidden({}, 1, ("drift_north", "drift_north", "gait_fast", "gait_fast"))]
    for seed in range(8):
        folds = split(records, seed)
        assert (folds.sum(0) == 1).all() and sorted(folds.sum(1)) == [1, 1, 2]
        assert not folds[:, :2].all(1).any() and not folds[:, 2:].all(1).any()
    assert split(records[1:3]).tolist() in ([[True, False], [False, True]], [[False, True], [True, False]])


def test_whitening_makes_its_own_scatter_white():
    rng = np.random.default_rng(0)
    shape = rng.normal(size=(5, 200))
    factors = rng.normal(size=(60, 5)) @ shape / np.sqrt(60)
    draws = rng.normal(size=(300, 5)) @ shape + 0.3 * rng.normal(size=(300, 200))
    z = whitening(factors, np.full(200, 0.3))(draws)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.05)
    assert np.mean((draws / 0.3) ** 2) > 20


def test_what_others_explain_is_left_out():
    """A null run in the span of the others leaves its noise only."""
    rng = np.random.default_rng(1)
    runs = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 300)) * 5 + 0.1 * rng.normal(size=(40, 300))
    rest = unexplained(runs, np.full(300, 0.1))
    assert np.sqrt(np.mean(rest**2)) < 0.15
    assert np.sqrt(np.mean(runs**2)) > 5


def test_leftover_never_falls_below_half_the_noise(plant):
    records = [record_of(t, plant.dt) for t in hidden({}, 3, ("drift_north",))]
    layout = ResidualLayout(records)
    d = leftover(np.zeros((8, layout.size)), layout)
    noise = layout.noise()
    known = np.isfinite(noise)
    assert np.allclose(d[known], 0.5 * noise[known])


def test_p_best_is_a_share():
    costs = np.array([[1.0, 1.0, 1.0], [2.0, 0.9, 1.5], [5.0, 5.0, 5.0]])
    share = likelihood.p_best(costs)
    assert share.sum() == pytest.approx(1.0)
    assert share[0] > share[1] > share[2]


def evidence_on(plant, planted, seed, runs=SHORT):
    from fishmj.gap.search.likelihood import likelihood_of

    return likelihood_of(plant, [record_of(t, plant.dt) for t in hidden(planted, seed, runs)], NULL)


def row_of(plant, name, **values):
    row = plant.null.copy()
    for parameter, value in values.items():
        row[plant.index(name, parameter)] = value
    return row


def test_the_loss_is_twice_the_negative_log_likelihood():
    rng = np.random.default_rng(2)
    factors, d, x = rng.normal(size=(5, 40)), rng.uniform(0.5, 2.0, 40), rng.normal(size=40)
    white, s = whitening(factors, d), factors.T @ factors + np.diag(d**2)
    assert white.logdet == pytest.approx(np.linalg.slogdet(s)[1], rel=1e-12)
    assert np.sum(white(x) ** 2) == pytest.approx(x @ np.linalg.solve(s, x), rel=1e-9)


def test_factors_of_one_record_each_whiten_as_if_they_were_written_out():
    rng = np.random.default_rng(3)
    record, factors = np.repeat([0, 1, 2], [10, 25, 5]), rng.normal(size=(4, 40))
    by_record = [rng.normal(size=(k, n)) for k, n in ((2, 10), (0, 25), (7, 5))]
    d, x, written = rng.uniform(0.5, 2.0, 40), rng.normal(size=40), np.zeros((9, 40))
    written[:2, :10], written[2:, 35:] = by_record[0], by_record[2]
    white, whole = whitening(factors, d, by_record, record), whitening(np.concatenate([factors, written]), d)
    assert white.logdet == pytest.approx(whole.logdet, rel=1e-12)
    assert np.sum(white(x) ** 2) == pytest.approx(np.sum(whole(x) ** 2), rel=1e-9)


def test_around_the_model_as_it_is_the_evidence_is_the_same(plant):
    e = evidence_on(plant, {}, 51, ("gait_fast", "drift_north"))
    there = e.linearised_at(plant.null)
    np.testing.assert_array_equal(there.d, e.d)
    np.testing.assert_array_equal(there.factors[: e.runs], e.factors)
    assert not there.factors[e.runs :].any()  # null runs hold what the constants do to this fish


def test_what_makes_the_fish_fickle_is_charged_for_it(plant):
    """Records of a healthy fish: servos a third as stiff make everything uncertain, and are less likely all the same."""
    e = evidence_on(plant, {}, 52)
    everything, weak = np.ones(len(SHORT), bool), row_of(plant, "servo_gain", gain=-0.65)
    there = e.linearised_at(weak).subset(everything)
    assert there.whiten.logdet > e.subset(everything).whiten.logdet + 100
    assert there.loss(weak) > e.subset(everything).loss(plant.null) + 100


@pytest.mark.slow
def test_an_effect_that_stood_in_for_a_later_one_goes_again(plant):
    folds = np.arange(len(SHORT)) % 2 == np.arange(2)[:, None]
    e = evidence_on(plant, {"command_latency": {"delay": 0.04}}, 53)
    row = row_of(plant, "command_latency", delay=0.04)
    row[plant.index("camera_scale", "scale")] = 0.002
    names = ("camera_scale", "command_latency")
    places = tuple(plant.index(n, p.name) for n in names for p in effects.get(n).parameters)
    c = e.subset().at(row, names, places)
    found = prune(e, folds, converge(e, folds, c, (c, c)), frozen())
    assert {found.best.names, *(fit.names for fit in found.fits)} == {("command_latency",)}
    assert found.best.row[plant.index("command_latency", "delay")] == pytest.approx(0.04, abs=0.004)


def test_what_the_records_leave_open_stays_near_its_null(plant):
    """No joint moves in a drift, so that no record of one knows what friction does."""
    e = evidence_on(plant, {}, 54, ("drift_north", "drift_north"))
    search = e.subset(np.ones(2, bool))
    place = plant.index("coulomb_friction", "torque")
    start = search.at(row_of(plant, "coulomb_friction", torque=0.15), ("coulomb_friction",), (place,))
    assert search.refine([start])[0].row[place] < 0.05


@pytest.mark.slow
def test_form_error_is_small_for_the_right_effect_and_large_for_a_wrong(plant):
    e = evidence_on(plant, {"command_latency": {"delay": 0.04}}, 55)
    right, wrong = row_of(plant, "command_latency", delay=0.04), row_of(plant, "servo_gain", gain=-0.4)
    assert e.with_estimated_model_error(right).form <= 0.05
    assert e.with_estimated_model_error(right).error(right, 0.15).excess_log_likelihood == 0.0
    assert e.with_estimated_model_error(right).error(right, 0.15).gain_error_rms < 0.1
    assert e.with_estimated_model_error(wrong).form > 0.15
    assert e.with_estimated_model_error(wrong).error(wrong, 0.15).excess_log_likelihood > 30.0


def test_effect_that_varies_between_records_has_size_error_not_form_error(plant):
    e = evidence_on(plant, {"command_latency": {"delay": 0.04}}, 55)
    rows = [row_of(plant, "command_latency", delay=delay) for delay in (0.04, 0.03, 0.052)]
    near = e.with_estimated_model_error(rows[0])
    other = near.layout.record == 0
    residual = near._residuals(rows[0][None])[0] + np.where(other, e.change(rows[0], rows[1]), e.change(rows[0], rows[2]))
    resized = near.response.error(residual, near.layout, 0.15)
    assert resized.form < near.response.most_likely_form(residual)
    assert 0.1 < resized.gain_error_rms < 0.4


def test_the_step_that_commands_are_counted_in_is_found_among_hundreds(plant):
    e = evidence_on(plant, {"command_quantisation": {"step": 0.0231}}, 60)
    one = e.subset(informative_records(e.subset().base(), e.layout, 1))
    (values,) = one.grid_search(one.base(), plant.active.effects).values()
    assert values[0] == pytest.approx(0.0231, rel=0.004)
    first = one.screen(one.base(), plant.active.effects, {"command_quantisation": values})[0]
    assert first.names == ("command_quantisation",)


def test_a_limit_that_only_one_record_reaches_is_left_open_by_the_others(plant):
    """Slow motion says nothing about the largest speed; what it leaves open is not straight, and yet covers what a beat shows."""
    e = evidence_on(plant, {"speed_limit": {"slowness": 0.5}}, 59, ("slow_triangle", "gait_fast"))
    row = row_of(plant, "speed_limit", slowness=0.5)
    search = e.subset()
    places = (plant.index("speed_limit", "slowness"),)
    best, unlearnt = (search.at(r, ("speed_limit",), places) for r in (row, plant.null))
    found = CrossValidatedFit(e.with_estimated_model_error(row), best, (unlearnt, best))
    beat = np.array([False, True])
    (searched, predicted), _ = found.held_out(np.stack([beat, ~beat]))
    assert found.near.subset(beat).at(plant.null).cost > 2.0 * searched.layout.size
    assert predicted.cost < 1.2 * searched.layout.size


def test_what_a_fold_leaves_open_counts_where_it_is_predicted(plant):
    """Only a beat tells how late commands are: predicted from a drift it is uncertain; a drift predicted from a beat is not."""
    e = evidence_on(plant, {"command_latency": {"delay": 0.04}}, 56, ("gait_fast", "drift_north"))
    row = row_of(plant, "command_latency", delay=0.04)
    folds = np.eye(2, dtype=bool)
    c = e.subset().at(row, ("command_latency",), (plant.index("command_latency", "delay"),))
    found = converge(e, folds, c, (c, c))
    (beat, _), (drift, _) = found.held_out(folds)
    known = [found.near.subset(f).whiten.logdet for f in folds]
    assert beat.whiten.logdet > known[0] + 2.0
    assert drift.whiten.logdet == pytest.approx(known[1], abs=0.5)
    assert found.loss(folds) == pytest.approx(sum(c.cost + s.whiten.logdet for s, c in found.held_out(folds)))
