"""The next experiment: planned like a real one, judged by what tells the explanations that are left apart."""

import json
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import effects
from fishmj.base.errors import LogError, UnknownName
from fishmj.base.store import write_json
from fishmj.effects.ambiguity import together
from fishmj.gap import experiment
from fishmj.gap.commands import next_experiment
from fishmj.gap.experiment import (
    ExperimentScore,
    Hypothesis,
    advice,
    experiment_score,
    experiment_scores,
    from_plain,
    hinted_experiments,
    normalise_weights,
    planned_record,
    to_plain,
)
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull, as_excitation
from fishmj.gap.records.records import Sensor, record_of
from fishmj.gap.verdict import NamedEffect, Value, Verdict
from fishmj.log import excitation

NULL = SimulatedNull(runs=16)
PAIR = ("coulomb_friction", "coulomb_friction + camera_scale")
SOME = ("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag")


@pytest.fixture(scope="module")
def plant():
    return SwimmingFish(catalogue=[effects.get(name) for name in SOME])


@pytest.fixture(scope="module")
def like(plant):
    from fishmj.gap.laboratory.virtual_robot import generate

    return record_of(generate({}, ["idle"], 0)[0], plant.dt)


def side(plant, name, value, spread=0.0, weight=1.0):
    row = plant.null.copy()
    place = plant.index(name, effects.get(name).parameters[0].name)
    row[place] = value
    moves = row[None].copy()
    moves[0, place] += spread
    return Hypothesis((name,), row, moves, weight)


@pytest.mark.parametrize("name", ["gait", "tow_oblique"])
def test_a_planned_experiment_is_the_one_that_will_be_done(plant, like, name):
    """To the byte of its commands, so that its null runs are those of the standard experiment."""
    from fishmj.gap.laboratory.virtual_robot import generate

    done, plan = (
        as_excitation(r) for r in (record_of(generate({}, [name], 3)[0], plant.dt), planned_record(excitation.get(name), like))
    )
    assert plan.commands.tobytes() == done.commands.tobytes()
    assert (plan.id, plan.start, plan.push) == (done.id, done.start, done.push)


def test_alike_explanations_stay_together(plant, like):
    same = [side(plant, "coulomb_friction", 0.1), side(plant, "coulomb_friction", 0.1)]
    assert experiment_score(plant, same, planned_record(excitation.get("steps"), like), NULL).sigma == pytest.approx(
        0.0, abs=1e-9
    )


def test_what_moves_the_fish_sets_apart_what_a_resting_fish_does_not(plant, like):
    sides = normalise_weights([side(plant, "command_latency", 0.03), side(plant, "joint_sensor_delay", 0.03)])
    found = experiment_scores(plant, sides, like, ("drift_north", "gait_fast"), NULL)
    assert [p.excitation for p in found] == ["gait_fast", "drift_north"]
    assert found[0].sigma > 5 > found[1].sigma


def towed_pairs():
    """Pairs of the catalogue whose separating experiments begin with a push, with these experiments."""
    pairs: dict[tuple[str, str], set[str]] = {}
    for effect in effects.catalogue().values():
        for other in effect.confusions:
            pairs.setdefault(tuple(sorted((effect.name, other.other))), set()).update(other.excitations)
    for one, other in combinations(effects.catalogue(), 2):
        if same := together(one, other):
            pairs.setdefault(tuple(sorted((one, other))), set()).update(same.excitations)
    towed = {pair: [run for run in sorted(runs) if any(excitation.get(run).push)] for pair, runs in pairs.items()}
    return {pair: runs for pair, runs in towed.items() if runs}


@pytest.fixture(scope="module")
def placed(like):
    """A record of a fish that was put in its place, as each jig and `gap plant` state it."""
    return like._replace(placed=Sensor(np.zeros(1), np.zeros((1, 3)), np.full(3, 1e-3)))


def test_each_experiment_is_scored_for_logs_with_a_stated_start(plant, placed):
    """A push has no resting start pose, so its null runs lack that sensor."""
    sides = normalise_weights([side(plant, "command_latency", 0.03), side(plant, "steady_current", 0.03)])
    runs = excitation.listed("all")
    assert sum(any(excitation.get(run).push) for run in runs) >= 3
    for record in (placed, placed._replace(power=None)):
        found = experiment_scores(plant, sides, record, runs, SimulatedNull(runs=2))
        assert sorted(p.excitation for p in found) == sorted(runs) and all(np.isfinite(p.sigma) for p in found)


@pytest.mark.slow
@pytest.mark.parametrize("pair", towed_pairs(), ids=" ".join)
def test_pair_that_a_tow_separates_is_scored(placed, pair):
    model = SwimmingFish(catalogue=[effects.get(name) for name in pair])
    sides = normalise_weights([side(model, name, effects.get(name).parameters[0].typical[1]) for name in pair])
    runs = towed_pairs()[pair]
    assert [p.excitation for p in experiment_scores(model, sides, placed, runs[:1], SimulatedNull(runs=2))] == runs[:1]


def test_a_parameter_that_the_data_leave_open_separates_less(plant, like):
    record = planned_record(excitation.get("drift_north"), like)
    known = [side(plant, "steady_current", 0.03), side(plant, "camera_scale", 0.02)]
    unknown = [side(plant, "steady_current", 0.03, spread=0.03), known[1]]
    assert experiment_score(plant, unknown, record, NULL).sigma < 0.5 * experiment_score(plant, known, record, NULL).sigma


def test_hints_begin_with_what_the_catalogue_says(plant):
    sides = [side(plant, "command_latency", 0.03), side(plant, "joint_sensor_delay", 0.03)]
    said = [r for c in effects.get("command_latency").confusions if c.other == "joint_sensor_delay" for r in c.excitations]
    assert said and hinted_experiments(sides)[: len(said)] == tuple(said)
    assert len(hinted_experiments(sides)) >= 6


def test_what_no_experiment_separates_gets_the_class_own_advice(plant):
    sides = [side(plant, "steady_current", 0.03), side(plant, "camera_scale", 0.02)]
    sides = [s._replace(names=(n,)) for s, n in zip(sides, ("clock_offset", "camera_latency"), strict=True)]
    said = advice(plant, [ExperimentScore("gait", 10.0, 0.4, ("clock_offset", "camera_latency"), 0.01)], sides)
    assert "No experiment tried separates clock offset from camera latency" in said and "lamp" in said


def test_sides_survive_the_report(plant):
    there = side(plant, "coulomb_friction", 0.1, spread=0.01)
    back = from_plain(plant, to_plain(plant, there), 1.0)
    assert np.allclose(back.row, there.row) and np.allclose(back.moves, there.moves)


def test_a_report_is_answered_without_its_data(tmp_path, capsys):
    ours = {"torque": {"value": 0.1, "low": 0.09, "high": 0.11}}
    rival = {"name": "viscous_friction", "p_best": 0.3, "values": {"viscous_friction": {"damping": [0.1, 0.09, 0.11]}}}
    verdict = {"answer": "CLASS", "effects": [{"name": "coulomb_friction", "p_best": 0.7, "parameters": ours}], "rivals": [rival]}
    (tmp_path / "verdict.json").write_text(json.dumps(verdict))
    assert next_experiment.main([str(tmp_path), "--runs", "slow_triangle,drift_north", "--null-runs", "16", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["experiments"][0]["excitation"] == "slow_triangle"
    assert "between Coulomb friction and viscous friction" in told["advice"]


def test_report_of_a_doubtful_name_without_a_near_rival_is_answered(plant, tmp_path, capsys, monkeypatch):
    """Its explanations are those that the search compared, also of several effects each."""
    both = side(plant, "coulomb_friction", 0.1)
    place = plant.index("camera_scale", effects.get("camera_scale").parameters[0].name)
    both.row[place] = 0.02
    both = both._replace(names=("coulomb_friction", "camera_scale"), moves=np.repeat(both.row[None], 2, 0))
    sides = [side(plant, "coulomb_friction", 0.1, spread=0.01, weight=0.7), both._replace(weight=0.3)]
    monkeypatch.setattr(experiment, "hypotheses_of", lambda found, verdict: sides)
    monkeypatch.setattr(experiment, "experiment_scores", lambda *args, **_: [ExperimentScore("gait", 9.0, 8.0, PAIR, 1.0)])
    e = SimpleNamespace(model=plant, records=[None])
    named = NamedEffect("coulomb_friction", {"torque": Value(0.1, "N m", 0.09, 0.11)}, 0.9, 0.9)
    verdict = experiment.advise(e, None, Verdict("CLASS", effects=(named,), warnings=("a bound",)), NULL)
    assert verdict.next_experiment.endswith("between Coulomb friction and Coulomb friction + camera scale.")
    write_json(tmp_path / "verdict.json", verdict.plain())
    assert next_experiment.main([str(tmp_path), "--runs", "slow_triangle,drift_north", "--null-runs", "16", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {tuple(e["pair"]) for e in told["experiments"]} == {PAIR}


def test_report_without_values_is_answered_with_its_own_advice(tmp_path, capsys):
    rival = {"name": "viscous_friction", "p_best": 0.3}
    verdict = {"answer": "CLASS", "effects": [], "rivals": [rival], "next_experiment": "Hold a ruler beside the track."}
    (tmp_path / "verdict.json").write_text(json.dumps(verdict))
    assert next_experiment.main([str(tmp_path)]) == 0 and "CLASS: Hold a ruler beside" in capsys.readouterr().out
    (tmp_path / "verdict.json").write_text(json.dumps(verdict | {"next_experiment": ""}))
    with pytest.raises(LogError, match="give the data set itself"):
        next_experiment.main([str(tmp_path)])


def test_nothing_is_left_to_decide_after_a_name(tmp_path, capsys):
    (tmp_path / "verdict.json").write_text(json.dumps({"answer": "NAMED", "effects": [], "rivals": []}))
    assert next_experiment.main([str(tmp_path)]) == 0
    assert "nothing to separate" in capsys.readouterr().out


def test_an_unknown_experiment_is_refused(plant):
    with pytest.raises(UnknownName, match="excitation"):
        next_experiment._runs("gait,gaite", [])
