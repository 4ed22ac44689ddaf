"""Typed terms for what no effect explains: well-formed, the identity at zero, found where they are, silent where nothing is."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap_outdone import behind  # noqa: E402

from fishmj.effects.sites import BodyMotion, Gear, LocalWater, SensorReadings, ServoDrive
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.terms import select
from fishmj.gap.terms.library import CURVES, library, model_with_terms, one_sided, sensor_terms
from fishmj.gap.terms.select import terms_of
from fishmj.gap.thresholds import thresholds
from fishmj.mjcf.reading import load_robot
from studies.gap_benchmark.free_terms import RIGHT

RUNS = ("gait_fast", "turn_left", "tow_oblique")
STILL = dict.fromkeys(BodyMotion._fields, 0.0)


class One:
    """The coefficient 1."""

    coefficient = 1.0


def generated(planted: dict, seed: int, runs=RUNS):
    from fishmj.gap.laboratory.virtual_robot import generate

    return generate(planted, runs, seed)


@pytest.fixture(scope="module")
def plant():
    return model_with_terms(load_robot("fish"))


def body(u, w, r, bend, swing) -> BodyMotion:
    return BodyMotion(**STILL | dict(u=u, w=w, r=r, bend=bend, swing=swing, time=3.0, wet=1.0))


def forces(effect, sign: float) -> np.ndarray:
    """What one term does to a fish, or to its mirror image."""
    if effect.body:
        b, _ = effect.body(np, One, body(0.2, 0.1 * sign, 0.5 * sign, 0.3 * sign, 2.0 * sign), (), 0.004)
        return np.array([b.fx, b.fy, b.n])
    if effect.gear:
        g = Gear(0.3 * sign, 0.2 * sign, 1.5 * sign, 0.0, 0.0, 1.0, 0.1, 1.6)
        g, _ = effect.gear(np, One, g, effect.memory, 0.004)
        return np.array([g.torque])
    if effect.servo:
        s = ServoDrive(0.1 * sign, 0.2 * sign, 1.5 * sign, 8.0, 0.3, 0.1, 1.6, 0.0, 3.0)
        read, _ = effect.servo(np, One, s, (), 0.004)
        return np.array([read.error - s.error])
    k = LocalWater([(0.0, 0.0, 0.0)], [0.2], [0.1 * sign], [2.0 * sign], 0.0, 0.0, 3.0, None)
    return np.array(effect.water(np, One, k, (), 0.004)[0].forces[-1])


def test_terms_have_names_of_their_own():
    names, ids = {e.formula for e in library()}, {e.name for e in library()}
    assert len(names) == len(ids) == len(library()) > 90
    assert all(e.name.startswith("X-") and not e.formula.startswith("X-") for e in library())
    assert all(right <= names or right & names for right in RIGHT.values())


def test_symmetric_term_commutes_with_mirroring_and_one_sided_does_not():
    flips = {3: np.array([1.0, -1.0, -1.0]), 1: np.array([-1.0])}
    for effect in library():
        if effect.stage == "environment" or effect in sensor_terms():
            continue  # a tank has no mirror, and a log does nothing to the fish
        here, there = forces(effect, 1.0), forces(effect, -1.0)
        assert np.any(here != 0), effect.formula
        assert np.allclose(there, flips[len(here)] * here) != one_sided(effect), effect.formula


def test_servo_reading_error_lowers_gain_and_encoder_reading_hides_it(plant):
    record = record_of(generated({}, 1, ("slow_triangle",))[0], plant.dt)
    joints = lambda p, row: p.predict([record], row)[0]["joint"][0]
    poses = lambda p, row: p.predict([record], row)[0]["pose"][0]
    of = {e.formula: e.name for e in library()}
    rows = {name: plant.null.copy() for name in ("servo reading ~ angle", "encoder reading ~ angle")}
    for name, row in rows.items():
        row[plant.index(of[name], "coefficient")] = 0.05
    there, hidden = rows.values()
    fish = SwimmingFish()
    less = fish.null.copy()
    less[fish.index("command_gain_error", "gain")] = 1 / 1.05 - 1
    plain = joints(plant, plant.null)
    gap = np.sqrt(np.mean((joints(plant, there) - plain) ** 2))
    assert np.sqrt(np.mean((joints(plant, there) - joints(fish, less)) ** 2)) < 0.05 * gap
    assert np.sqrt(np.mean((joints(plant, hidden) - plain) ** 2)) < 0.05 * gap
    assert np.allclose(poses(plant, hidden), poses(plant, there), atol=1e-4)


def test_a_slope_is_what_the_reading_changes_by():
    a = np.linspace(-0.8, 0.8, 9)
    for curve in CURVES:
        change = (curve.value(np, a + 1e-5) - curve.value(np, a - 1e-5)) / 2e-5
        assert np.allclose(change, curve.slope(np, a), atol=1e-8), curve.name


def test_slack_of_an_encoder_is_play_at_every_turn():
    angle = np.column_stack([0.2 * np.sin(np.linspace(0, 9, 200)), np.linspace(0, 0.005, 200)])
    gap = thresholds().library.slack
    late = behind(angle, gap)
    slack = next(x for x in sensor_terms() if "turn" in x.formula)
    seen = SensorReadings(t=None, x=None, y=None, yaw=None, joint=angle[None], power=None)
    read = lambda c: slack.measure(np, SimpleNamespace(coefficient=np.array([[c]])), seen).joint[0]
    assert np.allclose(read(gap), late, atol=1e-12) and np.array_equal(read(0.0), angle)
    assert np.allclose(read(2 * gap) - angle, 2 * (late - angle), atol=1e-12)


def test_without_coefficients_it_is_the_plain_fish(plant):
    record = record_of(generated({}, 1, ("gait_fast",))[0], plant.dt)
    plain = SwimmingFish()  # the whole catalogue at its null
    for sensor, values in plain.predict([record], plain.null)[0].items():
        assert np.abs(values - plant.predict([record], plant.null)[0][sensor]).max() < 1e-9, sensor


def test_the_right_term_is_among_the_first_two(plant):
    records = [record_of(t, plant.dt) for t in generated({"cubic_joint_spring": {"stiffness": 2.0}}, 61, ("gait", "steps"))]
    null = SimulatedNull(runs=32).residuals(plant, records, ResidualLayout(records))
    terms = terms_of(plant, records, null)
    place = [t.name for t in terms].index("joint torque ~ angle cubed")
    assert place < 2
    assert terms[place].coefficient == pytest.approx(-2.0, rel=0.15)
    assert terms[place].closure > 0.8


def test_nothing_is_firm_where_nothing_is(plant):
    records = [record_of(t, plant.dt) for t in generated({}, 62)]
    null = SimulatedNull(runs=32).residuals(plant, records, ResidualLayout(records))
    assert not any(t.firm for t in terms_of(plant, records, null))


def test_gain_is_on_records_that_the_coefficient_did_not_see():
    """A coefficient that two records contradict gains nothing, one that they share gains what it takes away."""
    g, onto = np.ones((1, 40)), np.kron(np.eye(2), np.ones((20, 1)))
    shared, opposed = np.ones(40), np.repeat([1.0, -1.0], 20)
    assert select.held_out_gains(shared, g, onto)[0] == pytest.approx(40.0)
    assert select.held_out_gains(opposed, g, onto)[0] < -100


def test_discoveries_among_decoys_are_rare():
    rng = np.random.default_rng(0)
    decoys = rng.chisquare(1, 4000)
    false = [np.sum(select.discovery(rng.chisquare(1, 100), decoys) <= 0.1) for _ in range(50)]
    assert np.mean(np.array(false) > 0) < 0.25
    q = select.discovery(np.concatenate([rng.chisquare(1, 95), np.full(5, 40.0)]), decoys)
    assert (q[-5:] <= 0.1).all()
