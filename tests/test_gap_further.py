"""A further effect beside a strong one, in a calibrated water: what it gains beyond the errors of what is known."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, hidden, row_of  # noqa: E402

from fishmj.gap.decide.decide import gains_beyond
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search.fit import drop_effect
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.model_error import ModelResponse
from fishmj.gap.search.stepwise import CrossValidatedFit, GainOverModelError, Selection, required_gain, split
from fishmj.gap.thresholds import frozen, thresholds
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED

RUNS = ("gait_fast", "chirp", "turn_left")
CURRENT, FRICTION = {"steady_current": {"x": 0.15, "y": 0.05}}, {"viscous_friction": {"damping": 0.08}}


@pytest.fixture(scope="module")
def told():
    """(likelihood of a calibrated model, that of the same one as described), of the same records."""
    robot = load_robot("fish")
    known = SwimmingFish(robot)
    water = SwimmingFish(replace(robot, water=robot.water | {"model": STRUCTURED}))
    records = [record_of(t, known.dt) for t in hidden(CURRENT | FRICTION, 75, RUNS)]
    null = NULL.residuals(known, records, ResidualLayout(records))
    return Likelihood(water, records, null), Likelihood(known, records, null)


def candidate(e, **given):
    """A set of effects at these values, on all records."""
    row = np.max([row_of(e.model, name, **values) for name, values in given.items()], 0)
    places = tuple(e.model.index(name, p) for name, values in given.items() for p in values)
    return e.subset().at(row, tuple(given), places)


def known_and_more(e):
    """(the current, the current with the friction), as they come out of a round, and the folds."""
    folds = split(e.records)
    sets = []
    for given in (CURRENT, CURRENT | FRICTION):
        c = candidate(e, **given)
        near = e.with_estimated_model_error(c.row)
        c = near.subset().at(c.row, c.names, c.places)
        sets.append(CrossValidatedFit(near, c, (c,) * len(folds)))
    return *sets, folds


def test_the_error_of_a_known_formula_is_worth_what_is_asked_on_top(told):
    e, gates = told[0], frozen()
    row = row_of(e.model, "steady_current", x=0.15, y=0.05)
    near = e.with_estimated_model_error(row)
    tolerant, imitated = near.tolerating(row, gates)
    share = thresholds().intervals.formula_error
    change = near.change(row, e.model.null)
    gained = np.sum(tolerant.subset().whiten(share * change[None]) ** 2)
    assert 0.0 < gained < imitated < (share / gates.form) ** 2 * e.layout.size * 1.5
    assert np.all(tolerant.d >= near.d) and len(tolerant.factors) > len(near.factors)
    one = near.layout.record == 1
    assert np.sum(tolerant.subset().whiten((0.2 * change * one)[None]) ** 2) < 0.2 * np.sum(
        near.subset().whiten((0.2 * change * one)[None]) ** 2
    )  # wrong in its size in one record only


def test_weak_joint_friction_is_accepted_beside_a_dominant_current(told):
    e, gates = told[0], frozen()
    known, more, folds = known_and_more(e)
    beyond = GainOverModelError(known, gates)
    assert beyond.likely([more.best]) and beyond.gain(more, folds) > beyond.required
    assert not beyond.likely([known.best]) and abs(beyond.gain(known, folds)) < beyond.required
    assert required_gain(gates, known, 1e9, True) > 1000 * beyond.required  # what a share of the gain so far may ask
    found = Selection(e.subset().base(), more, folds, (), 0.0)
    gains = gains_beyond(found, gates)
    plain = {name: drop_effect(more.near.subset(), more.best, name).cost - more.best.cost for name in more.best.names}
    assert gains["viscous_friction"] > gates.gain and all(gains[name] < plain[name] for name in plain)


def test_two_per_cent_of_a_small_effect_may_be_more_than_the_noise():
    rng, m = np.random.default_rng(7), 400
    change, known = 0.2 * np.sin(np.arange(m) / 9), np.full(m, 1e-6)
    response = ModelResponse(np.zeros((1, m)), (), np.zeros(m, int), known, change, np.full(m, 0.14))
    noise = np.sqrt(known) * rng.standard_normal(m)
    finer = thresholds().model_error.fine_form_grid
    assert (
        response.most_likely_form(noise) == min(thresholds().model_error.form_grid)
        and response.most_likely_form(noise, finer) == 0.0
    )
    wrong = noise + 0.1 * 0.14 * rng.standard_normal(m)
    assert response.most_likely_form(wrong) == response.most_likely_form(wrong, finer) == 0.1


def test_only_a_calibrated_model_is_asked_for_finer_form_errors(told, monkeypatch):
    asked = []
    monkeypatch.setattr(ModelResponse, "most_likely_form", lambda self, residual, finer=(): asked.append(finer) or 0.05)
    for e in told:
        assert e.with_estimated_model_error(row_of(e.model, "command_latency", delay=0.01)).form == 0.05
    assert asked == [thresholds().model_error.fine_form_grid, ()]
