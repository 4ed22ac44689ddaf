"""Searches of an arm in MJCF from its logs to the answer. All logs are *synthetic*."""

import json
import re
from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from robot_arm import ARM, edited, trials_of, write_logs

from fishmj import effects
from fishmj.gap.commands import find_robot
from fishmj.gap.commands.find_robot import by_effect, place_of, place_text, robot_gates, servo_gains, without_stand_in
from fishmj.gap.decide.implausible import with_oversized
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import RobotSizes, sizes_of
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.shooting import robot_records
from fishmj.gap.report.robot_page import write_robot_page
from fishmj.gap.search import unexplained_torque
from fishmj.gap.search.fit import limiting
from fishmj.gap.search.stepwise import CrossValidatedFit, converge, exchange_limiting_forms, propose
from fishmj.gap.search.unexplained_torque import require_smaller_torques, with_measured_errors
from fishmj.gap.verdict import NamedEffect, Value
from fishmj.gap.wording import quantity
from fishmj.gap.workflow import investigate, require_residual_at_floor

pytest.importorskip("numba")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("robot")


@pytest.fixture(scope="module")
def arm(folder):
    path = folder / "arm.xml"
    path.write_text(ARM)
    return read_robot(path)


@pytest.fixture(scope="module")
def sticky(folder, arm):
    """A search of an arm with dry friction at its elbow, among a few effects."""
    logs = write_logs(folder / "sticky", edited(elbow_joint='frictionloss="0.06"'), logs=3, seconds=2.6)
    return search_among(arm, logs, "coulomb_friction", "viscous_friction", "torque_offset")


def search_among(arm, logs, *names):
    trials = trials_of(arm, logs)
    records = robot_records(trials, arm.dt, arm.sites("joint"))
    null, some = RobotNull(16), [effects.robot_catalogue()[name] for name in names]
    model, _ = with_measured_errors(RigidRobot(arm, sizes_of(arm, records), some), records, null)
    return investigate(model, trials, gates=robot_gates(), null=null, mass_known=False)


def test_search_names_the_hidden_friction(sticky):
    v = sticky.verdict
    assert v.answer == "NAMED" and [e.name for e in v.effects] == ["coulomb_friction@elbow"], v.text()
    found = v.effects[0].parameters["torque"]
    assert found.low <= 0.06 <= found.high and by_effect(v) == {"coulomb_friction@elbow": "NAMED"}
    before, after = v.gates["torques"]["elbow"]  # the friction, and the noise of an encoder
    assert after < 0.005 and 0.03 < before < 0.07


@pytest.mark.parametrize("share, answer", [(1.0, "NAMED"), (0.75, "NAMED"), (0.25, "UNEXPLAINED")])
def test_friction_that_leaves_torques_is_not_named(sticky, share, answer):
    """Less friction than was hidden leaves a torque: what explains a part of it may stand in for something else."""
    e, row = sticky.evidence, sticky.found.best.row.copy()
    row[e.model.index("coulomb_friction@elbow", "torque")] *= share
    v = require_smaller_torques(sticky.verdict, e, row, e.model.robot.channels)
    assert v.answer == answer and v.effects == sticky.verdict.effects, v.gates["torques"]
    assert ("remains" in v.reason) == (answer == "UNEXPLAINED")


def test_torque_beyond_an_actuator_is_outside_the_catalogue(sticky, monkeypatch):
    """The force of a plate loads each joint, so an effect at one of them explains nothing."""
    e, row = sticky.evidence, sticky.found.best.row.copy()
    row[e.model.index("coulomb_friction@elbow", "torque")] *= 0.4
    assert require_smaller_torques(sticky.verdict, e, row, e.model.robot.channels).answer == "NAMED"
    monkeypatch.setattr(unexplained_torque, "torque_limits", lambda robot: np.array([np.inf, 1e-3]))
    v = require_smaller_torques(sticky.verdict, e, row, e.model.robot.channels)
    assert v.answer == "UNEXPLAINED" and v.reason.startswith("something outside the catalogue acts at elbow: torques of")


def test_limits_of_torque_are_those_of_the_actuators(folder):
    path = folder / "limited.xml"
    path.write_text(ARM.replace('ctrlrange="-4 4"', 'ctrlrange="-4 4" forcerange="-3.2 3" gear="2"'))
    assert unexplained_torque.torque_limits(read_robot(path)).tolist() == [np.inf, 6.4]


@pytest.mark.parametrize("where", ["effects", "tentative"])
def test_implausible_wind_is_no_answer(sticky, where):
    """28 m/s, named or only counted in, imitates what the catalogue lacks; friction at a joint has no usual size."""
    wind = NamedEffect("steady_wind", {n: Value(v, "m/s", v, v) for n, v in zip("xyz", (0.0, 0.0, -28.0), strict=True)}, 1.0, 1.0)
    stack = SimpleNamespace(effect=lambda name: effects.robot_catalogue()[name] if name != "steady_wind" else WIND)
    v = replace(sticky.verdict, **{where: (*getattr(sticky.verdict, where), wind)})
    found = without_stand_in(with_oversized(v, stack))
    assert found.answer == "UNEXPLAINED" and "implausible value" in found.reason
    assert any("steady wind: z = -28 m/s is implausibly large" in w for w in found.warnings)
    assert without_stand_in(with_oversized(sticky.verdict, stack)) == sticky.verdict


WIND = SimpleNamespace(parameters=effects.robot_catalogue()["steady_wind"].robot.parameters)


def test_a_limiting_form_gives_way_to_the_law_that_it_imitates(folder, arm):
    """Stribeck friction that fades at its highest speed is nearly Coulomb friction: the search has it for want of the other."""
    logs = write_logs(folder / "dry", edited(elbow_joint='frictionloss="0.06"'), logs=2, seconds=1.6)
    inquiry, said = search_among(arm, logs, "coulomb_friction", "stribeck"), []
    e, folds, base = inquiry.evidence, inquiry.found.folds, inquiry.found.base
    pool = [x for x in e.model.active.effects if "@" in x.name]
    nothing = CrossValidatedFit(e, base, (base,) * len(folds))
    step = propose(nothing, folds, [x for x in pool if x.name == "stribeck@elbow"], robot_gates(), 0.0)
    imitated = converge(e, folds, step.fitted.best, step.fitted.fits)
    fades = np.array(imitated.best.row)
    fades[e.model.index("stribeck@elbow", "speed")] = 5.0  # rad/s, its bound
    imitated = imitated._replace(best=e.subset().at(fades, imitated.best.names, imitated.best.places))
    assert limiting(e.model, imitated.best) == ["stribeck@elbow"]
    own = [x for x in pool if x.name == "stribeck@elbow"]
    assert exchange_limiting_forms(e, folds, imitated, own, robot_gates(), said.append) is imitated and not said
    found = exchange_limiting_forms(e, folds, imitated, pool, robot_gates(), said.append)
    assert found.best.names == ("coulomb_friction@elbow",) and "instead" in said[0]
    assert exchange_limiting_forms(e, folds, found, pool, robot_gates(), said.append) is found and len(said) == 1


def test_residual_above_the_floor_is_no_name(sticky):
    """Judged where each record is predicted without its fold: with fits that lack the friction most of the gap is left."""
    assert require_residual_at_floor(sticky.verdict, sticky).gates["floors"] < 1.25
    fits = tuple(replace(c, row=sticky.evidence.model.null) for c in sticky.found.fitted.fits)
    poor = replace(sticky, found=replace(sticky.found, fitted=sticky.found.fitted._replace(fits=fits)))
    v = require_residual_at_floor(sticky.verdict, poor)
    assert v.answer == "UNEXPLAINED" and v.gates["floors"] > 1.5 and v.effects == sticky.verdict.effects
    assert require_residual_at_floor(replace(sticky.verdict, answer="AGREES"), poor).answer == "AGREES"


def test_model_that_agrees_by_its_own_tolerances_is_at_the_floor(sticky):
    """A true robot that is far off in one constant leaves more than the floor, of which the constant is most."""
    near = copy(sticky.found.near)
    near.scale = near.scale / 10.0
    off = replace(sticky, found=replace(sticky.found, fitted=sticky.found.fitted._replace(near=near)))
    v = require_residual_at_floor(sticky.verdict, off)
    assert v.answer == "NAMED" and v.gates["floors"] > 1.5 and v.gates["stated"] < 1.2


def test_formula_of_a_robot_may_be_right(sticky):
    assert sticky.found.near.form < 0.02


def test_constants_count_once_where_null_runs_draw_them(sticky):
    """S is wider for what is not linear in the constants only where that exceeds the scatter of the null runs."""
    e, row = sticky.evidence, sticky.found.best.row
    twice = copy(e)
    twice.origin, twice._null_scatter = twice, 0.0
    once, both = (np.mean(one.linearised_at(row, 0.0).d / e.d) for one in (e, twice))
    assert 1.0 <= once < both


def test_healthy_arm_agrees(folder, arm):
    logs = write_logs(folder / "well", ARM, logs=3, seconds=2.0, seed=4)
    found = search_among(arm, logs, "coulomb_friction", "viscous_friction")
    v, e, row = found.verdict, found.evidence, found.found.base.row
    assert v.answer == "AGREES" and len(v.missed) == 4
    start, known = e.subset().z(row[None]), {x.name: x.parameters[0].name for x in e.model.active.effects}
    for name, told in v.missed.items():  # of that size an effect gains what a search asks for, of twice that plenty
        rows = np.tile(row, (2, 1))
        rows[:, e.model.index(name, known[name])] = told["value"], 2 * told["value"]
        once, twice = np.sum((e.subset().z(rows) - start) ** 2, 1)
        assert 0.5 < once / found.gates.gain < 2 and twice > 2 * once, name
    damping = quantity(v.missed["viscous_friction@elbow"]["value"], "N m s/rad")
    assert "not excluded: sizes" in v.text() and f"{damping} at elbow" in v.text()


def test_torque_of_no_effect_is_unexplained(folder, arm):
    """A torque at the elbow of another form than any effect in question: a spring beyond an angle."""
    text = edited(elbow_joint='range="-0.3 0.3" limited="true" solreflimit="0.3 1"')
    logs = write_logs(folder / "stop", text, logs=3, seconds=2.0, seed=2)
    assert search_among(arm, logs, "torque_offset", "rotor_inertia").verdict.answer == "UNEXPLAINED"


def test_place_of_the_gap_is_the_joint(sticky):
    place = place_of(sticky)
    assert place.joints["elbow"] > 0.5 and sum(place.joints.values()) == pytest.approx(1.0)
    assert sum(place.motions["elbow"].values()) == pytest.approx(place.joints["elbow"])


def test_gap_is_located_once_for_the_text_and_for_json(sticky, arm, monkeypatch, capsys):
    located = []
    monkeypatch.setattr(find_robot, "place_of", lambda inquiry: located.append(place_of(inquiry)) or located[0])
    monkeypatch.setattr(find_robot, "read_logs", lambda args: (arm, [], [None, None], {}))
    monkeypatch.setattr(find_robot, "search", lambda *given: sticky)
    assert find_robot.find(SimpleNamespace(out=None, json=True)) == 0 and len(located) == 1
    *said, told = capsys.readouterr().out.splitlines()
    assert f"  {located[0].text}" in said and json.loads(told)["localisation"]["text"] == located[0].text


def test_gains_of_a_servo_are_those_of_mjcf(folder):
    """kp alone lower by a fifth is two effects of the catalogue, and one number of the MJCF."""
    path = folder / "servo_arm.xml"
    path.write_text(ARM.replace("<motor", "<position kp='5' kv='0.4'"))
    robot = read_robot(path)
    some = [effects.robot_catalogue()[name] for name in ("servo_gain", "servo_damping_gain")]
    ones = np.ones(2)
    model = RigidRobot(robot, RobotSizes(ones, ones, ones, ones), some)
    row = model.null.copy()
    row[model.index("servo_gain@elbow", "gain")], row[model.index("servo_damping_gain@elbow", "gain")] = -0.2, 0.25
    verdict = SimpleNamespace(effects=[SimpleNamespace(name="servo_gain@elbow")], tentative=[])
    found = SimpleNamespace(best=SimpleNamespace(row=row))
    inquiry = SimpleNamespace(evidence=SimpleNamespace(model=model), verdict=verdict, found=found)
    assert servo_gains(inquiry) == ["elbow: kp 5 -> 4, kv 0.4 -> 0.4"]


@pytest.mark.parametrize("stage", ["place_of", "place_text", "write_robot_page"])
def test_failing_page_costs_a_robot_no_answer(stage, sticky, arm, tmp_path, monkeypatch, capsys):
    """The verdict is on disk before the place of the gap and the page are made."""

    def fail(*given):
        raise RuntimeError("no page today")

    monkeypatch.setattr(find_robot, "read_logs", lambda args: (arm, [], [None, None], {}))
    monkeypatch.setattr(find_robot, "search", lambda robot, trials, args, answered: answered(sticky) and sticky)
    monkeypatch.setattr(find_robot, "context_of", lambda *given: {"judged": []})
    monkeypatch.setattr(find_robot, stage, fail)
    assert find_robot.find(SimpleNamespace(out=tmp_path, json=True)) == 0
    done = capsys.readouterr()
    assert "the answer is complete, but" in done.err and "no page today" in done.err
    assert json.loads((tmp_path / "verdict.json").read_text())["answer"] == sticky.verdict.answer
    assert json.loads(done.out.splitlines()[-1])["answer"] == sticky.verdict.answer


def test_of_a_model_that_agrees_the_tolerances_explain_the_residual(sticky):
    place, agrees = place_of(sticky), replace(sticky.verdict, answer="AGREES")
    assert place_text(agrees, place) == f"{place.text}; the stated tolerances explain all of it"
    assert place_text(sticky.verdict, place) == place.text
    assert place_text(agrees, place._replace(joints={"elbow": 0.0})) == "no residual is above the floor"


def test_interrupted_search_goes_on_with_its_null_runs_and_torques(folder, arm, tmp_path, monkeypatch):
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path))
    trials = trials_of(arm, write_logs(folder / "kept", ARM, logs=2, seconds=1.6))
    records = robot_records(trials, arm.dt, arm.sites("joint"))
    start = RigidRobot(arm, sizes_of(arm, records), [effects.robot_catalogue()["viscous_friction"]])
    stop, drawn, measure = lambda *given: 1 / 0, RobotNull._drawn, find_robot.with_measured_errors
    go_on = lambda null: find_robot.with_kept_errors(start, trials, records, null)
    monkeypatch.setattr(find_robot, "with_measured_errors", stop)
    with pytest.raises(ZeroDivisionError):
        go_on(RobotNull(8))
    monkeypatch.setattr(RobotNull, "_drawn", stop)  # the runs are kept
    monkeypatch.setattr(find_robot, "with_measured_errors", measure)
    null = RobotNull(8)
    first = go_on(null)
    monkeypatch.setattr(find_robot, "with_measured_errors", stop)  # and so are the torques
    again = go_on(RobotNull(8))
    for name in ("torque_error", "reference"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    monkeypatch.setattr(RobotNull, "_drawn", drawn)
    anew = RobotNull(8).residuals(start, records, ResidualLayout(records))
    np.testing.assert_array_equal(*null.kept.values(), anew)
    with pytest.raises(ZeroDivisionError):  # other settings are another search
        go_on(RobotNull(8, seed=1))
    assert str(tmp_path / "null") in find_robot.words() and "the same command continues from them" in find_robot.words()


def test_page_shows_the_answer(sticky, tmp_path):
    write_robot_page(sticky, place_of(sticky), by_effect(sticky.verdict), tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert re.search(r"Robot \S+, \S+, sha256 [0-9a-f]{12}<", page.split("</header>")[0])
    assert "the same figures as JSON: verdict.json" in page
    assert "Missing: Coulomb friction at elbow" in page and "Torques that the model does not explain" in page
