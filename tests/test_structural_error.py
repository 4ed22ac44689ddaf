"""Structural error of the search: its covariance, its widths, and what it does to a healthy robot of another water."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag

from fishmj.base.errors import UnknownName
from fishmj.effects import STAGES
from fishmj.gap.calibrate.water_fit import calibrate_trials
from fishmj.gap.decide.decide import Support, as_in_healthy_robots
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import structural_error
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.structural_error import strong, widths
from fishmj.gap.null.variances import Sample, score_variances
from fishmj.gap.null.whitening import leftover
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search import likelihood
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.model_error import ModelResponse
from fishmj.gap.thresholds import frozen
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED
from studies.structural_error.most_likely import most_likely

NULL = SimulatedNull(runs=12)


def calibrated():
    """The shipped description, said to be calibrated."""
    robot = load_robot("fish")
    return replace(robot, water=robot.water | {"model": STRUCTURED})


def a_sample(rng, u=(0.5, 2.0, 0.0, 1.0), p=(0.3, 0.0), m=120) -> Sample:
    """A robot drawn from the covariance itself; the last variance is of what its three records share."""
    null, shared, record, channel = rng.normal(size=(4, m)), rng.normal(size=(2, m)), np.arange(m) // 40, np.arange(m) % 2
    parts, groups, d = [rng.normal(size=(6, 40)) for _ in range(3)], [np.arange(6) % 3] * 3, np.full(m, 0.2)
    residual = null.T @ rng.normal(size=4) + np.sqrt(u[3]) * shared.T @ rng.normal(size=2)
    residual += np.concatenate(
        [(a * np.sqrt(np.array(u)[:3])[g][:, None]).T @ rng.normal(size=6) for a, g in zip(parts, groups, strict=True)]
    )
    residual += np.sqrt(d + np.array(p)[channel]) * rng.normal(size=m)
    return Sample(null, shared, np.full(2, 3), parts, groups, record, d, np.ones(m), channel, residual)


def whole_of(s: Sample, u, p) -> np.ndarray:
    """S, written out."""
    parts = np.zeros((len(s.residual), len(s.residual)))
    for i, (a, g) in enumerate(zip(s.parts, s.groups, strict=True)):
        mine = np.flatnonzero(s.record == i)
        parts[np.ix_(mine, mine)] = (a.T * u[g]) @ a
    return s.null.T @ s.null + u[3] * s.shared.T @ s.shared + parts + np.diag(s.variance + p[s.channel] * s.spread)


def test_the_sums_are_those_of_the_whole_covariance():
    s, u, p = a_sample(np.random.default_rng(0)), np.array([0.4, 1.5, 0.1, 0.7]), np.array([0.2, 0.05])
    whole = whole_of(s, u, p)
    inverse, told = np.linalg.inv(whole), score_variances(s, u, p)
    solved = inverse @ s.residual
    assert told.loss == pytest.approx(s.residual @ solved + np.linalg.slogdet(whole)[1])
    assert told.adequacy == pytest.approx(s.residual @ solved / len(solved))
    for g in range(3):
        mine = [(a[group == g], s.record == i) for i, (a, group) in enumerate(zip(s.parts, s.groups, strict=True))]
        assert told.seen[g] == pytest.approx(sum(np.sum((a @ solved[w]) ** 2) for a, w in mine))
        assert told.expected[g] == pytest.approx(sum(np.trace(a @ inverse[np.ix_(w, w)] @ a.T) for a, w in mine))
    assert told.seen[3] == pytest.approx(np.sum((s.shared @ solved) ** 2))
    assert told.expected[3] == pytest.approx(np.trace(s.shared @ inverse @ s.shared.T))
    for c in range(2):
        assert told.seen[4 + c] == pytest.approx(np.sum(solved[s.channel == c] ** 2))
        assert told.expected[4 + c] == pytest.approx(np.sum(np.diag(inverse)[s.channel == c]))


def test_each_round_makes_the_robots_likelier_and_widths_come_back():
    rng = np.random.default_rng(1)
    samples, losses = [a_sample(rng) for _ in range(40)], []

    def ask(u, p):
        told = [score_variances(s, u, p) for s in samples]
        losses.append(sum(one.loss for one in told))
        return told

    found = most_likely(ask, np.ones(4), np.full(2, 0.1), 40)
    assert np.all(np.diff(losses) < 1e-6)
    np.testing.assert_allclose(found.u[[0, 1, 3]], [0.5, 2.0, 1.0], rtol=0.3)
    assert found.u[2] < 1e-2 and found.p[0] == pytest.approx(0.3, rel=0.25) and found.p[1] < 0.03
    assert np.mean(found.adequacy) == pytest.approx(1.0, abs=0.05)


def test_strong_directions_and_the_rest_have_the_scatter_of_the_tangents():
    rng = np.random.default_rng(2)
    moved, d = rng.normal(size=(5, 40)) * np.array([6, 2, 1, 0.3, 0.03])[:, None], np.full(40, 1.5)
    factors, variance = strong(moved, d)
    assert 1 <= len(factors) < 5
    np.testing.assert_allclose(np.sum(factors**2, 0) + variance, np.sum(moved**2, 0))
    apart = moved.T @ moved - factors.T @ factors
    assert np.linalg.eigvalsh(apart / 1.5**2).max() < structural_error.STRONG**2 + 1e-9


def test_a_family_left_out_has_widths_of_its_own():
    everything = widths()
    assert widths("second_robot")._replace(formula=everything.formula) == everything
    for name in generators.NAMES:
        assert widths(name) != everything and set(widths(name).per_record) == set(everything.per_record)
        assert set(widths(name).gains) == set(STAGES) and min(widths(name).gains.values()) >= 0.0
    with pytest.raises(UnknownName, match="morison"):
        widths("trout")


def test_a_water_of_literature_values_has_no_structural_error():
    trials = generate({}, ["gait"], seed=3)
    for robot, has in ((load_robot("fish"), False), (calibrated(), True)):
        plant = SwimmingFish(robot)
        records = [record_of(t, plant.dt) for t in trials]
        null = NULL.residuals(SwimmingFish(load_robot("fish")), records, ResidualLayout(records))
        e = Likelihood(plant, records, null)
        assert (len(e.factors) > len(null)) == has
        gates = e.allowed(frozen())
        assert (gates == frozen()) != has and gates.adequacy >= frozen().adequacy
        e.widths = e.widths._replace(gains={"timing": 30.0})
        assert (e.healthy_gain("timing"), e.healthy_gain("actuator")) == (30.0 * len(records) * has, 0.0)
        stand = {"command_latency": Support(29.0 * len(records), 1.0, ()), "servo_gain": Support(5.0, 1.0, ())}
        assert as_in_healthy_robots(e, stand) == ({"command_latency"} if has else set())
        if has:
            bare = Likelihood(SwimmingFish(load_robot("fish")), records, null)
            assert np.all(e.d >= bare.d - 1e-12) and np.all(e.scale >= bare.scale) and np.median(e.scale / bare.scale) > 1.001
            assert [len(mine.T) for mine in e.by_record] == np.bincount(e.layout.record).tolist()
            near = e.linearised_at(plant.null)
            np.testing.assert_allclose(near.factors[: len(e.factors)], e.factors)


@pytest.mark.slow
def test_structural_error_covers_a_healthy_robot_in_an_unseen_water():
    swims = ["gait_slow", "gait_small", "turn_right", "tow_ahead", "tow_sideways", "ramps_2"]
    robot, _ = calibrate_trials(generators.generate("foil", {}, swims, 5), "fish")
    plant = SwimmingFish(robot)
    trials = generators.generate("foil", {}, ["gait_fast", "turn_left", "burst_and_coast"], 5)
    records = [record_of(t, plant.dt) for t in trials]
    layout = ResidualLayout(records)
    null = NULL.residuals(plant, records, layout)
    with_it = Likelihood(plant, records, null, widths=structural_error.widths("foil"))
    adequacy = with_it.subset().base().cost / layout.size
    assert adequacy < with_it.allowed(frozen()).adequacy
    with_it._structural = with_it._structural._replace(by_record=())
    with_it.factors, with_it.d = with_it.factors[: len(null)], leftover(null, layout)
    assert with_it.subset().base().cost / layout.size > 4 * frozen().adequacy


def linear(rng, records=8, rows=40, shared=3, own=2, told=None):
    """Records of a robot that is linear in what it shares (told, or drawn) and in what each record has by itself."""
    layout = SimpleNamespace(
        record=np.repeat(np.arange(records), rows), channel=np.full(records * rows, "joint"), size=records * rows
    )
    factors, parts = rng.normal(size=(shared, layout.size)), [rng.normal(size=(own, rows)) for _ in range(records)]
    told = rng.normal(size=shared) if told is None else told
    noise = 0.3 * rng.normal(size=layout.size)
    residual = told @ factors + np.concatenate([0.5 * rng.normal(size=own) @ part for part in parts]) + noise
    e = copy(object.__new__(Likelihood))
    e.model = SimpleNamespace(null=np.zeros(1), predict=lambda records, rows: None)
    e.records, e.runs, e.drawn, e.origin, e.layout = [None] * records, shared, True, e, layout
    e.layout.residuals = lambda predictions: residual[None]
    e._null_factors, e._launches, e.scatter = factors, np.zeros((0, layout.size)), ()
    alone = tuple(0.5 * part for part in parts)
    e._structural = structural_error.StructuralError(np.zeros((0, layout.size)), alone, np.zeros(layout.size))
    e.factors, e.d = factors, np.full(layout.size, 0.3)
    e.response = ModelResponse(factors, e.by_record, layout.record, e.d**2, *np.zeros((2, layout.size)))
    return e, told, residual


def test_given_healthy_swims_the_covariance_is_the_conditional_one(monkeypatch):
    monkeypatch.setattr(likelihood, "KnownLayout", lambda records, known: SimpleNamespace(known=known, size=len(known)))
    rng = np.random.default_rng(3)
    (swims, told, left), (new, _, _) = linear(rng), linear(rng, records=2)
    there = new.given(swims)
    apart = lambda e: np.diag(e.d**2) + block_diag(*(part.T @ part for part in e.by_record))
    whole = swims.factors.T @ swims.factors + apart(swims)
    across = new.factors.T @ swims.factors
    expected = new.factors.T @ new.factors - across @ np.linalg.solve(whole, across.T)
    np.testing.assert_allclose(there.factors.T @ there.factors, expected, atol=1e-9)
    np.testing.assert_allclose(there.layout.known, across @ np.linalg.solve(whole, left), atol=1e-9)
    np.testing.assert_allclose(there.layout.known, told @ new.factors, atol=0.5)  # what this robot does is known
    assert np.trace(expected) < 0.05 * np.trace(new.factors.T @ new.factors)
    assert there.origin is there and not there.drawn and new.drawn


def test_a_robot_that_hardly_varies_gets_narrower_widths():
    rng, rows, names = np.random.default_rng(4), 60, ["k_head", "cf", "ke"]
    layout = SimpleNamespace(record=np.repeat(np.arange(10), rows), channel=np.full(600, "joint"), size=600, blocks=[])
    parts = [np.concatenate([rng.normal(size=(3, rows)), rng.normal(size=(6, rows))]) for _ in range(10)]
    for part in parts:
        part[2::3] = 0.0  # nothing shows ke
    moved = structural_error.Tangents(parts, names, np.zeros((0, 600)))
    given = structural_error.StructuralErrorScales(dict.fromkeys(names, 1.0), dict.fromkeys(names, 0.5), {}, {"joint": 0.05})
    asked_for = np.array([0.1, 1.0, 0.0, *[0.0, 0.5, 0.0] * 2])
    residual = np.concatenate([(asked_for * rng.normal(size=9)) @ part for part in parts]) + 0.1 * rng.normal(size=600)
    own = structural_error.own_widths(given, layout, rng.normal(size=(8, 600)) * 1e-3, np.full(600, 0.1), moved, residual)
    assert (
        own.per_record["k_head"] < 0.7 < own.per_record["cf"] < 1.5
        and own.within_record["k_head"] < 0.35 < own.within_record["cf"] < 0.8
    )
    assert own.per_record["ke"] == pytest.approx(1.0, rel=1e-6) and own.within_record["ke"] == pytest.approx(0.5, rel=1e-6)
    none = structural_error.own_widths(given._replace(per_record=dict.fromkeys(names, 0.0)), layout, np.zeros((8, 600)),
        np.full(600, 0.1), moved, residual)  # fmt: skip
    assert set(none.per_record.values()) == {0.0}  # what no other water has is none here
