"""What the search asks of a name: which records may be spared, what is enough for a further effect, what is believable."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, evidence_on, hidden, plant, row_of  # noqa: E402, F401

from fishmj import effects
from fishmj.gap.decide.decide import confused, decide, masked_by, sanity
from fishmj.gap.records.records import record_of
from fishmj.gap.search import model_error
from fishmj.gap.search.likelihood import Likelihood, likelihood_of, relinearise
from fishmj.gap.search.stepwise import (
    CrossValidatedFit,
    Selection,
    SelectionStep,
    forward_select,
    propose,
    required_gain,
    shows,
    split,
)
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import NamedEffect, Value

SIX = ("gait_fast", "drift_north", "turn_left", "tow_oblique", "gait", "burst_and_coast")


def late(plant, runs, spoilt, by):  # noqa: F811
    """Evidence around a latency that all records have; those of `spoilt` have another effect, too."""
    given = hidden({"command_latency": {"delay": 0.04}}, 71, runs)
    other = hidden({"command_latency": {"delay": 0.04}} | by, 71, runs)
    mixed = [w if name in spoilt else g for g, w, name in zip(given, other, runs, strict=True)]
    e = likelihood_of(plant, [record_of(t, plant.dt) for t in mixed], NULL)
    row = row_of(plant, "command_latency", delay=0.04)
    return e.with_estimated_model_error(row), row


CURRENT, WEAK = {"steady_current": {"x": 0.03, "y": 0.02}}, {"servo_gain": {"gain": -0.5}}


def test_one_path_in_six_may_bend_away(plant):  # noqa: F811
    gates = frozen()
    near, row = late(plant, SIX, ("turn_left",), CURRENT)
    whole = near.error(row, gates.form)
    assert not model_error.believable(whole, 1e4, gates)
    less, names = model_error.error_without_outliers(near, row, 1e4, gates)
    assert names == (near.records[2].name,)
    assert model_error.believable(less, 1e4, gates)
    assert model_error.error_without_outliers(near, row, gates.gain / 2, gates) == (
        whole,
        (),
    )  # what gains too little has nothing to spare


@pytest.mark.parametrize(
    ("runs", "spoilt", "by"),
    [(SIX, ("gait", "burst_and_coast", "turn_left"), CURRENT), (SIX[1:3], ("turn_left",), CURRENT), (SIX, ("gait_fast",), WEAK)],
)
def test_neither_three_paths_in_six_nor_one_in_two_nor_a_joint(plant, runs, spoilt, by):  # noqa: F811
    gates = frozen()
    near, row = late(plant, runs, spoilt, by)
    whole = near.error(row, gates.form)
    assert not model_error.believable(whole, 1e4, gates)
    assert model_error.error_without_outliers(near, row, 1e4, gates) == (whole, ())


def test_the_error_on_some_samples_is_that_of_evidence_that_has_no_others(plant):  # noqa: F811
    near, row = late(plant, SIX[:4], (), CURRENT)
    every = near.error(row, 0.15)
    assert near.error(row, 0.15, np.ones(near.layout.size, bool)) == pytest.approx(every)
    kept = model_error.without_paths_of(near, [1])
    assert set(near.layout.channel[~kept]) == {"position", "heading"} and set(near.layout.record[~kept]) == {1}
    less = near.response.subset(kept)
    assert less.factors.shape == (len(near.factors), kept.sum())
    np.testing.assert_array_equal(less.d(0.1), near.response.d(0.1)[kept])
    assert near.error(row, 0.15, kept) != every


def test_required_gain_of_a_further_effect_grows_with_the_known_gain():
    gates = frozen()
    alone = SimpleNamespace(best=SimpleNamespace(names=()))
    known = SimpleNamespace(best=SimpleNamespace(names=("tether",)), near=SimpleNamespace(layout=SimpleNamespace(size=5000)))
    assert required_gain(gates, alone, 0.0, False) == gates.gain
    least = gates.gain + gates.min_gain_per_sample * 5000
    assert required_gain(gates, known, 1e3, False) == pytest.approx(least)
    assert required_gain(gates, known, 1e3, True) == pytest.approx(
        gates.gain + gates.uncontested_discount * gates.min_gain_per_sample * 5000
    )
    assert required_gain(gates, known, 1.5e5, False) == pytest.approx(gates.min_gain_fraction * 1.5e5)
    assert least < gates.min_gain_fraction * 1.5e5
    assert required_gain(gates, known, 1e9, True) == pytest.approx(gates.min_gain_fraction * 1e9)


def test_given_the_others_is_all_records_less_the_others(plant):  # noqa: F811
    """Of a model without a parameter, whose fits are all one, by the definition of a conditional density."""
    e = evidence_on(plant, {}, 72)
    folds = split(e.records)
    base = e.subset().base()
    known = CrossValidatedFit(e, base, (base,) * len(folds))
    others = sum(e.subset(~fold).loss(plant.null) for fold in folds)
    assert known.conditional_loss(folds) == pytest.approx(len(folds) * e.subset().loss(plant.null) - others)


@pytest.mark.slow
def test_first_effect_below_the_usual_gain_is_accepted_by_its_joint_gain(plant):  # noqa: F811
    e = evidence_on(plant, {"command_latency": {"delay": 0.02}}, 73)
    folds, gates = split(e.records), frozen()
    base = e.subset().base()
    known = CrossValidatedFit(e, base, (base,) * len(folds))
    usual = propose(known, folds, plant.active.effects, gates, 0.0)
    deaf = replace(gates, gain=1.1 * usual.gain)
    step = propose(known, folds, plant.active.effects, deaf, 0.0)
    assert step.accepted and step.ranked[0].names == ("command_latency",) and step.gain > gates.min_joint_gain
    assert not propose(known, folds, plant.active.effects, replace(deaf, min_joint_gain=1e9), 0.0).accepted


def test_the_share_of_an_effect_is_that_of_the_round_that_added_it():
    step = lambda gain, accepted, *names: SelectionStep((SimpleNamespace(names=names, newest=names[-1:]),), None, gain, accepted)
    steps = (step(900.0, True, "tether"), step(100.0, True, "tether", "swirl"), step(50.0, False, "tether", "swirl", "body_lift"))
    found = Selection(None, None, None, steps, 0.0)
    assert found.gain_share("tether", 0.0) == pytest.approx(0.9)
    assert found.gain_share("swirl", 0.0) == pytest.approx(0.1)
    assert found.gain_share("body_lift", 0.3) == 0.3  # in no round that was accepted


def test_what_the_catalogue_takes_for_each_other_is_confused_both_ways(plant):  # noqa: F811
    e = SimpleNamespace(model=plant)
    assert confused(e, "joint_sensor_delay", "command_latency") and confused(e, "command_latency", "joint_sensor_delay")
    assert not confused(e, "steady_current", "speed_limit")


def test_a_little_friction_beside_play_is_not_named_and_much_of_it_is():
    both = ("gear_backlash", "coulomb_friction")
    known = [effects.get(name) for name in (*both, "wall_effect")]
    e = SimpleNamespace(model=SimpleNamespace(active=SimpleNamespace(effects=known)))
    assert masked_by(e, both, {"coulomb_friction"}) == {"coulomb_friction"}
    assert masked_by(e, both, set()) == masked_by(e, both, set(both)) == set()
    assert masked_by(e, ("wall_effect", "coulomb_friction"), {"coulomb_friction"}) == set()  # nothing alike


def test_a_vector_of_which_no_part_differs_from_none_is_not_believed(plant):  # noqa: F811
    e = evidence_on(plant, {"steady_current": {"x": 0.03, "y": 0.0}}, 74)
    row = row_of(plant, "steady_current", x=0.03, y=0.0)
    places = tuple(plant.index("steady_current", p) for p in ("x", "y"))
    c = relinearise(e, e.subset().at(row, ("steady_current",), places))[1]
    said = lambda x, half: NamedEffect(
        "steady_current", {"x": Value(x, "m/s", x - half, x + half), "y": Value(0.001, "m/s", -0.01, 0.012)}, 1.0, 1.0
    )
    assert sanity(e, c, said(0.03, 0.005), little=True) == ()
    assert len(sanity(e, c, said(0.03, 0.05), little=True)) == 1
    assert sanity(e, c, said(0.03, 0.05), little=False) == ()  # together they may be sure


@pytest.mark.slow
def test_gap_usual_in_healthy_robots_agrees_unless_an_effect_closes_most(plant, monkeypatch):  # noqa: F811
    e, gates = evidence_on(plant, {"command_latency": {"delay": 0.02}}, 73), frozen()
    found = forward_select(e, gates, split(e.records), lambda text: None)
    wide = replace(gates, adequacy=1e9)
    assert decide(e, found, wide).answer == "NAMED"  # of a water of literature values an accepted effect goes on
    monkeypatch.setattr(Likelihood, "healthy_gain", lambda e, stage: 1e9)
    assert decide(e, found, wide).answer == decide(e, found, replace(gates, closure=0.1)).answer == "NAMED"  # it closes most
    verdict = decide(e, found, replace(wide, closure=1.1))
    assert verdict.answer == "AGREES" and not verdict.effects and "command latency gains" in verdict.reason
    assert decide(e, found, replace(gates, adequacy=-1.0, closure=1.1)).answer == "UNEXPLAINED"
    with monkeypatch.context() as patch:  # what its own healthy swims leave is taken off: no other robot excuses the rest
        patch.setattr(e, "drawn", False)
        assert decide(e, found, replace(wide, closure=1.1)).answer == "NAMED"
    monkeypatch.setattr(Likelihood, "healthy_gain", lambda e, stage: 1.0)
    assert decide(e, found, replace(wide, closure=1.1)).answer == "NAMED"  # it gains more than any in a healthy robot


def test_an_effect_on_a_channel_that_was_not_logged_is_not_proposed():
    known = effects.catalogue()
    paths, joints = {"position", "heading", "start"}, {"joint"}
    assert shows(known["quadratic_drag"], paths) and not shows(known["quadratic_drag"], joints)
    assert not shows(known["power_offset"], paths | joints) and shows(known["power_offset"], {"power"})
    assert not shows(known["joint_sensor_delay"], paths) and shows(known["joint_sensor_delay"], joints)
    assert shows(known["com_offset"], joints | {"weighing"}) and not shows(known["com_offset"], joints)


@pytest.mark.slow
def test_a_search_without_joint_logs_asks_nothing_of_a_joint_sensor(plant):  # noqa: F811
    swum = hidden({}, 81, ("gait_fast", "turn_left"))
    trials = [replace(t, tables={name: t.tables[name] for name in ("cmd", "pose")}) for t in swum]
    e = likelihood_of(plant, [record_of(t, plant.dt) for t in trials], NULL)
    found = forward_select(e, frozen(), split(e.records), lambda text: None)
    tried = {name for step in found.steps for c in step.ranked for name in c.names}
    assert tried and all(set(effects.get(name).shows) & {"position", "heading"} for name in tried)
