"""A page of weighings as evidence: what only scales, an edge and a pendulum can tell."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, hidden, row_of

from fishmj import effects
from fishmj.base.errors import ConfigError
from fishmj.gap import experiment
from fishmj.gap.commands import admission, find
from fishmj.gap.experiment import ExperimentScore, Hypothesis
from fishmj.gap.laboratory.virtual_robot import plant as robot
from fishmj.gap.laboratory.virtual_robot.hidden_dataset import write_hidden
from fishmj.gap.laboratory.virtual_robot.trials import masses, page
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records import datasets, mass_properties
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.workflow import investigate
from fishmj.log import measurements
from fishmj.mjcf.reading import load_robot

RUNS = ("gait", "turn_left", "burst_and_coast")
TURNS = {"yaw_inertia": {"inertia": 0.006}}
WATER = {"yaw_added_mass": {"inertia": 0.006}}


@pytest.fixture(scope="module")
def plant():
    return SwimmingFish(
        catalogue=[effects.get(n) for n in ("yaw_inertia", "yaw_added_mass", "body_mass", "com_offset", "yaw_drag")]
    )


@pytest.mark.parametrize(
    ("hides", "does"),
    [
        ({}, {}),
        (TURNS, TURNS),
        (WATER, {}),
        ({"com_offset": {"x": 0.02}}, {"com_offset": {"x": 0.02}}),
        ({"body_mass": {"mass": 0.2}}, {"body_mass": {"mass": 0.2, "spread": 0.0}}),
    ],
)
def test_the_model_weighs_what_the_robot_weighs(plant, hides, does):
    row = plant.null.copy()
    for name, values in does.items():
        row = row_of(plant, name, **values)
    told = masses(robot(hides, 3))
    np.testing.assert_allclose(mass_properties.predicted(plant, row)[0], list(told.values()), rtol=1e-6)


def test_what_the_page_lacks_is_not_compared(plant):
    whole = page({}, 3)
    record, *_ = mass_properties.with_page(
        [record_of(t, plant.dt) for t in hidden({}, 5, RUNS[:1])], mass_properties.sensor(whole, plant)
    )
    assert [b.column for b in ResidualLayout([record]).blocks if b.channel == mass_properties.CHANNEL] == [0, 1, 2]
    only = mass_properties.sensor({"scales": {"whole": [1.12, 1.121]}}, plant)
    assert [b.column for b in ResidualLayout([record._replace(weighed=only)]).blocks if b.channel == mass_properties.CHANNEL] == [
        0
    ]
    assert only.values[0, 0] == pytest.approx(1.1205) and only.sigma[0] == pytest.approx(1.12e-3, rel=0.01)
    assert mass_properties.sensor({}, plant, known=False) is None
    described = mass_properties.sensor({}, plant)  # the model's mass counts as weighed
    assert described.values[0, 0] == pytest.approx(sum(link.mass for link in plant.robot.links))
    assert described.sigma[0] == pytest.approx(1e-3 * described.values[0, 0]) and np.isnan(described.values[0, 1:]).all()
    assert "counts as weighed" in mass_properties.agreement(plant, [record._replace(weighed=described)])
    with pytest.raises(ConfigError, match=r"\[pendulum\] period"):
        mass_properties.sensor({"pendulum": {"thread": 1.2, "apart": 0.3}}, plant)


def test_null_runs_weigh_what_they_should_to_within_the_instruments(plant):
    sensor = mass_properties.sensor(page({}, 3), plant)
    records = mass_properties.with_page([record_of(t, plant.dt) for t in hidden({}, 5, RUNS[:1])], sensor)
    e = likelihood_of(plant, records, NULL)
    some = e.layout.channel == mass_properties.CHANNEL
    np.testing.assert_allclose(np.sqrt(np.mean((e.factors[:, some] ** 2) * e.runs, 0)), sensor.sigma, rtol=0.3)
    assert np.abs(e.gap(plant.null)[1][mass_properties.CHANNEL]) < 6.0
    around = e.linearised_at(row_of(plant, "yaw_inertia", inertia=0.006), 0.5)
    np.testing.assert_allclose(around.d[some], e.d[some])  # no form error on what mass means


@pytest.mark.slow
def test_a_pendulum_tells_which_of_two_twins_it_is(plant):
    trials = hidden(WATER, 12, RUNS)
    blind = investigate(plant, trials, null=NULL, further=True).verdict
    assert blind.answer == "CLASS" and blind.next_experiment.startswith(experiment.WEIGH), blind.text()
    told = investigate(plant, trials, null=NULL, page=page(WATER, 12)).verdict
    assert told.answer == "NAMED" and [e.name for e in told.effects] == list(WATER), told.text()
    value = told.effects[0].parameters["inertia"]
    assert value.value == pytest.approx(0.006, rel=0.1) and value.low < 0.006 < value.high


def test_weighing_is_advised_only_if_it_separates_the_hypotheses(plant):
    sides = [Hypothesis((n,), row_of(plant, n, **p[n]), np.zeros((0, len(plant.null))), 1.0) for p in (TURNS, WATER) for n in p]
    rows = [s.row[None] for s in sides]
    assert mass_properties.separation(plant, *rows) == pytest.approx(0.006 / (mass_properties.PENDULUM * 0.01304), rel=0.01)
    assert mass_properties.separation(plant, rows[1], plant.null[None]) == 0.0
    quiet = [ExperimentScore("gait", 10.0, 0.4, ("yaw_inertia", "yaw_added_mass"), 0.01)]
    assert experiment.advice(plant, quiet, sides).startswith(experiment.WEIGH)


def test_what_was_weighed_is_said_in_words(plant):
    (record,) = (record_of(t, plant.dt) for t in hidden({}, 5, RUNS[:1]))
    said = lambda hides: mass_properties.agreement(
        plant, mass_properties.with_page([record], mass_properties.sensor(page(hides, 5), plant))
    )
    assert (
        said({}) == "The weighings agree with the model (mass, balance point, yaw inertia)."
        and mass_properties.agreement(plant, [record]) == ""
    )
    assert "yaw inertia is 0.01897 kg m2" in said(TURNS) and "the model's 0.013" in said(TURNS) and "mass" not in said(TURNS)


@pytest.mark.slow
def test_report_shows_the_weighing_apart_from_the_gap_of_the_logs(plant):
    from html import unescape

    from fishmj.gap.report.report_data import gather, plain
    from fishmj.gap.report.sections import html

    inquiry = investigate(plant, hidden(TURNS, 12, RUNS[:2]), null=NULL, page=page(TURNS, 12))
    material = gather(inquiry)
    assert mass_properties.CHANNEL not in material.place.channels
    assert mass_properties.CHANNEL in material.channels
    assert plain(material)["weighed"] in unescape(html(material)) and "yaw inertia is 0.019" in material.weighed


def test_a_robot_that_replaces_another_takes_its_page_along(tmp_path):
    def write(seed, table):
        write_hidden(tmp_path / "data", tmp_path / "truth.json", hidden({}, seed, RUNS[:1]), {}, {}, overwrite=True, page=table)

    for seed in (5, 6):
        write(seed, page({}, seed))
        assert len(datasets.trials_in(tmp_path / "data")) == 1  # the manifest holds the page that is there
        assert datasets.page_in(tmp_path / "data")["balance"]["at"] == page({}, seed)["balance"]["at"]
    write(7, None)
    assert len(datasets.trials_in(tmp_path / "data")) == 1 and datasets.page_in(tmp_path / "data") == {}


def test_gap_find_uses_the_weighing_page_beside_the_trials(tmp_path, monkeypatch):
    write_hidden(tmp_path / "data", tmp_path / "truth.json", hidden({}, 5, RUNS[:1]), {}, {}, page=page({}, 5))
    assert datasets.page_in(tmp_path / "data")["pendulum"]["period"] == page({}, 5)["pendulum"]["period"]
    given = {}
    monkeypatch.setattr(find, "investigate", lambda *_, **options: given.update(options))
    asked = {"model": "fish", "null": None, "null_runs": 64, "noise": 1.0, "seed": 0, "most": None, "anyway": False}
    asked |= {"mass_unknown": False}
    find.search(SimpleNamespace(data=tmp_path / "data", **asked), load_robot("fish"), datasets.readable_trials(tmp_path / "data"))
    assert given["page"] == datasets.page_in(tmp_path / "data")
    assert len(datasets.trials_in(tmp_path / "data")) == 1 and datasets.page_in(tmp_path / "set.npz") == {}


def test_a_number_that_a_page_lacks_is_named(plant):
    with pytest.raises(ConfigError, match=r"\[pendulum\] apart is missing; expected one or more positive numbers in SI units"):
        mass_properties.sensor({"pendulum": {"thread": 1.2, "period": [1.7]}}, plant)


def test_a_current_that_no_trial_states_is_told():
    trial = hidden({}, 5, RUNS[:1])[0]
    told = "1 of 1 swims state no current (flow in meta.toml, or log import --flow); still water is assumed"
    meta = {key: value for key, value in trial.meta.items() if key != "flow"}
    assert admission.still_water([trial]) == [] and admission.still_water([replace(trial, meta=meta)]) == [told]
    assert admission.still_water([replace(trial, meta=meta | {"flow": {"speed": 0.0, "known": False}})]) == [told]
    assert admission.still_water([replace(trial, meta=meta | {"flow": {"speed": 0.1, "known": False}})]) == []
    assert admission.still_water([replace(trial, meta=meta | {"medium": "air"})]) == []


@pytest.mark.parametrize(
    ("table", "values", "told"),
    [
        (
            "scales",
            {"whole": [1100]},
            r"\[scales\] add up to 1100 kg; expected about the 1.\d+ kg of the description; are these g\?",
        ),
        ("scales", {"whole": ["1,1"]}, r"\[scales\] whole = \['1,1'\]; expected one or more positive numbers in SI units"),
        ("balance", {"at": [184.0]}, r"\[balance\] at is 184 m from the nose; expected a place on the straight fish"),
        ("pendulum", {"thread": 1.2, "apart": 0.3, "period": [1700.0]}, r"\[pendulum\] gives a radius of gyration of \d+ m"),
    ],
)
def test_a_weighing_in_another_unit_is_refused_before_the_trials_are_read(tmp_path, plant, table, values, told):
    whole = {key: dict(page({}, 3)[key]) for key in ("scales", "balance", "pendulum")}
    mass_properties.check_page(whole, plant.robot)
    measurements.write(tmp_path, whole | {table: values})
    with pytest.raises(ConfigError, match=told):
        admission.admitted(tmp_path, plant.robot, "fish", False)
