"""What the search asks of a name: which records may be spared, what is enough for a further effect, what is believable."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, evidence_on, hidden, plant, row_of  # noqa: E402, F401

from fishmj.gap import spared  # noqa: E402
from fishmj.gap.decide import sanity  # noqa: E402
from fishmj.gap.folds import Fitted, split  # noqa: E402
from fishmj.gap.gates import frozen  # noqa: E402
from fishmj.gap.nearby import nearest  # noqa: E402
from fishmj.gap.records import record_of  # noqa: E402
from fishmj.gap.rounds import asked, round_of  # noqa: E402
from fishmj.gap.verdict import Named, Value  # noqa: E402
from fishmj.gap.workflow import evidence_of  # noqa: E402

SIX = ("gait_fast", "drift_north", "turn_left", "tow_oblique", "gait", "burst_and_coast")


def late(plant, runs, spoilt):  # noqa: F811
    """Evidence around a latency that all records have; in those of `spoilt` the servos are weak, too."""
    given = hidden({"command_latency": {"delay": 0.04}}, 71, runs)
    weak = hidden({"command_latency": {"delay": 0.04}, "servo_gain": {"gain": -0.5}}, 71, runs)
    mixed = [w if name in spoilt else g for g, w, name in zip(given, weak, runs, strict=True)]
    e = evidence_of(plant, [record_of(t, plant.dt) for t in mixed], NULL)
    row = row_of(plant, "command_latency", delay=0.04)
    return e.trusted(row), row


def test_one_record_in_six_may_be_where_something_else_happens(plant):  # noqa: F811
    gates = frozen()
    near, row = late(plant, SIX, ("gait_fast",))
    whole = near.error(row, gates.form)
    assert not spared.believable(whole, 1e4, gates)
    less, names = spared.error(near, row, 1e4, gates)
    assert names == (near.records[0].name,)
    assert spared.believable(less, 1e4, gates)
    assert spared.error(near, row, gates.gain / 2, gates) == (whole, ())  # what gains too little has nothing to spare


def test_not_three_records_in_six_nor_one_in_two(plant):  # noqa: F811
    gates = frozen()
    near, row = late(plant, SIX, ("gait_fast", "gait", "turn_left"))
    assert spared.error(near, row, 1e4, gates) == (near.error(row, gates.form), ())
    near, row = late(plant, SIX[:2], ("gait_fast",))
    assert not spared.believable(near.error(row, gates.form), 1e4, gates)
    assert spared.error(near, row, 1e4, gates)[1] == ()


def test_the_error_on_some_records_is_that_of_evidence_on_them_alone(plant):  # noqa: F811
    near, row = late(plant, SIX[:4], ())
    every = near.error(row, 0.15)
    assert near.error(row, 0.15, near.everything) == every
    kept = np.array([True, False, True, True])
    moved = near._residuals(row[None])[0]
    columns = kept[near.layout.record]
    assert near.changed.on(columns).unlikely(moved[columns]).shape == near.changed.unlikely(moved).shape
    assert near.error(row, 0.15, kept) != every


def test_what_is_asked_of_a_further_effect_grows_with_the_first_ones_gain_but_not_without_end():
    gates = frozen()
    alone = SimpleNamespace(best=SimpleNamespace(names=()))
    known = SimpleNamespace(best=SimpleNamespace(names=("tether",)), near=SimpleNamespace(layout=SimpleNamespace(size=5000)))
    assert asked(gates, alone, 0.0, False) == gates.gain
    least = gates.gain + gates.again * 5000
    assert asked(gates, known, 1e3, False) == pytest.approx(least)
    assert asked(gates, known, 1e3, True) == pytest.approx(gates.gain + gates.clear * gates.again * 5000)
    assert asked(gates, known, 1.5e5, False) == pytest.approx(gates.beside * 1.5e5)
    assert least < gates.beside * 1.5e5 < gates.enough
    assert asked(gates, known, 1e8, False) == asked(gates, known, 1e9, True) == gates.enough


def test_given_the_others_is_all_records_less_the_others(plant):  # noqa: F811
    """Of a model without a parameter, whose fits are all one, by the definition of a conditional density."""
    e = evidence_on(plant, {}, 72)
    folds = split(e.records)
    base = e.part(e.everything).base()
    known = Fitted(e, base, (base,) * len(folds))
    others = sum(e.part(~fold).loss(plant.null) for fold in folds)
    assert known.given(folds) == pytest.approx(len(folds) * e.part(e.everything).loss(plant.null) - others)


def test_a_first_effect_may_show_by_what_it_gains_on_all_records_and_given_the_others(plant):  # noqa: F811
    e = evidence_on(plant, {"command_latency": {"delay": 0.02}}, 73)
    folds, gates = split(e.records), frozen()
    base = e.part(e.everything).base()
    known = Fitted(e, base, (base,) * len(folds))
    usual = round_of(known, folds, plant.active.effects, gates, 0.0)
    deaf = replace(gates, gain=1.1 * usual.gain)
    step = round_of(known, folds, plant.active.effects, deaf, 0.0)
    assert step.accepted and step.ranked[0].names == ("command_latency",) and step.gain > gates.joint
    assert not round_of(known, folds, plant.active.effects, replace(deaf, joint=1e9), 0.0).accepted


def test_a_vector_of_which_no_part_differs_from_none_is_not_believed(plant):  # noqa: F811
    e = evidence_on(plant, {"steady_current": {"x": 0.03, "y": 0.0}}, 74)
    row = row_of(plant, "steady_current", x=0.03, y=0.0)
    places = tuple(plant.index("steady_current", p) for p in ("x", "y"))
    c = nearest(e, e.part(e.everything).at(row, ("steady_current",), places))[1]
    said = lambda x, half: Named(  # noqa: E731
        "steady_current", {"x": Value(x, "m/s", x - half, x + half), "y": Value(0.001, "m/s", -0.01, 0.012)}, 1.0, 1.0
    )
    assert sanity(e, c, said(0.03, 0.005)) == ()
    assert len(sanity(e, c, said(0.03, 0.05))) == 1
