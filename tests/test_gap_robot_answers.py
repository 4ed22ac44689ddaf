"""Answers about a robot in MJCF: what may be called named, and what `gap check` says is left. All is *synthetic*."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from robot_arm import ARM, trials_of, write_logs

from fishmj.base import console
from fishmj.base.store import sha256, write_json
from fishmj.gap.commands import apply
from fishmj.gap.commands.admit_robot import _of_angles, in_another_unit, undone
from fishmj.gap.commands.apply_robot import apply_robot, check_command
from fishmj.gap.commands.check_robot import compare, printed_lines
from fishmj.gap.commands.find_robot import by_effect, ranges_of, without_stand_in
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.records.robot_logs import read_columns
from fishmj.gap.records.shooting import robot_records
from fishmj.gap.report.sections import escape_text
from fishmj.gap.verdict import NamedEffect, Value, Verdict

pytest.importorskip("numba")


@pytest.mark.parametrize("place", ["elbow", "shoulder"])
def test_effect_beside_one_without_a_believable_value_is_not_named(place):
    """A ripple whose period lies on its bound, and a stiffness that was fitted beside it: for a cable, in a trial."""
    found = NamedEffect("torque_ripple@elbow", {"period": Value(1.6, "rad", 1.0, 1.6)}, 1.0, 1.0)
    beside = NamedEffect(f"joint_stiffness@{place}", {"stiffness": Value(0.67, "N m/rad", 0.5, 0.8)}, 1.0, 1.0)
    warnings = ("torque ripple at elbow: period = 91.7 deg lies on its bound", "torques of 0.05 N m at elbow are left")
    v = Verdict("CLASS", effects=(found, beside), warnings=warnings)
    assert without_stand_in(v).answer == "UNEXPLAINED" and by_effect(without_stand_in(v)) == {}
    rival = {"name": "joint_scale@elbow", "p_best": 0.3, "instead_of": found.name}
    v = without_stand_in(replace(v, rivals=(rival,)))
    assert v.answer == "CLASS" and set(by_effect(v).values()) == {"CLASS"}
    v = replace(v, warnings=warnings[1:])
    assert by_effect(v) == {found.name: "CLASS", beside.name: "NAMED"}


def test_command_in_a_report_is_code_and_the_rest_is_text():
    assert escape_text("run `fishmj gap apply`, <b>") == "run <code>fishmj gap apply</code>, &lt;b&gt;"
    assert escape_text("`<script>` 5 ms") == "<code>&lt;script&gt;</code> 5\u00a0ms"


def test_version_that_leaves_a_gap_is_told_so(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    arm = read_robot(path)
    trials = trials_of(arm, write_logs(tmp_path / "healthy", ARM, logs=2, seconds=2.6))
    records = robot_records(trials, arm.dt, arm.channels)
    stiff = mujoco.MjSpec.from_string(ARM)
    stiff.joint("elbow").frictionloss = 5.0
    parent = replace(arm, model=stiff.compile())
    told = compare(parent, parent, records)
    assert told["left"].startswith("gap ") and "tolerances and noise" in told["left"]
    assert "RMS [rad, m]" in "\n".join(printed_lines(told | {"same_data": False, "logs": ["a"]}))


@pytest.fixture(scope="module")
def servo_arm(tmp_path_factory):
    """An arm with position servos, and three logs of the arm with motors."""
    folder = tmp_path_factory.mktemp("servos")
    for name, text in (("motors.xml", ARM), ("arm.xml", ARM.replace("<motor", "<position kp='5'"))):
        (folder / name).write_text(text)
    trials = trials_of(read_robot(folder / "motors.xml"), write_logs(folder / "logs", ARM, logs=3, seconds=2.6))
    return read_robot(folder / "arm.xml"), trials


def test_apply_of_a_robot_takes_what_was_counted_in_or_says_that_the_gap_is_with_it(servo_arm, tmp_path):
    robot, _ = servo_arm
    fit = lambda name, **values: {"name": name, "parameters": {k: {"value": v, "low": v, "high": v} for k, v in values.items()}}
    context = {"model": str(robot.path), "model_sha256": sha256(robot.path), "data": "/my logs", "columns": "/a map.toml"}
    verdict = {"answer": "NAMED", "effects": [fit("body_mass@lower", mass=0.1)], "by_effect": {}, "context": context}
    verdict |= {"tentative": [fit("viscous_friction@elbow", damping=0.07)], "gap_before": 9.0, "gap_after": 0.2, "over_floor": {}}
    damping = lambda told: read_robot(told["path"]).model.dof_damping[1]
    alone = apply_robot(tmp_path, verdict, tmp_path / "alone.xml", False)
    assert damping(alone) == pytest.approx(0.02) and alone["gap_after"] is None and "--counted-in" in alone["reason"]
    both = apply_robot(tmp_path, verdict, tmp_path / "both.xml", False, counted_in=True)
    assert damping(both) == pytest.approx(0.09) and both["gap_after"] == 0.2
    doubtful = apply_robot(tmp_path, verdict | {"answer": "CLASS"}, tmp_path / "forced.xml", True, counted_in=True)
    assert damping(doubtful) == pytest.approx(0.02)
    words = check_command(tmp_path, verdict, both["path"], None)
    assert words[-4:] == ["--data", "/my logs", "--columns", "/a map.toml"]
    (tmp_path / "report").mkdir()
    away = check_command(tmp_path / "report", verdict, both["path"], None)
    assert away[-4:] == ["--parent", str(robot.path), "--columns", "/a map.toml"]


def test_one_log_in_another_unit_is_doubted(servo_arm):
    robot, trials = servo_arm
    records = robot_records(trials, robot.dt, robot.channels)
    assert in_another_unit(robot, records) == []
    turned = _of_angles(records[1], np.full(2, np.pi / 180))
    wrong = [records[0], turned._replace(commands=turned.commands * np.pi / 180), records[2]]
    (told,) = in_another_unit(robot, wrong)
    assert told.startswith(f"{records[1].name}: ") and "is it in rad and the others in deg?" in told
    assert in_another_unit(robot, [records[0], turned, records[2]]) == []


def test_commands_alone_in_another_unit_are_a_mistake_that_is_tried(servo_arm):
    robot, trials = servo_arm
    records = robot_records(trials, robot.dt, robot.channels)
    tried = {what: changed for what, _, changed in undone(robot, records)}
    np.testing.assert_allclose(tried["reading commands in degrees"][0].commands, records[0].commands * np.pi / 180)


def test_a_column_of_a_map_has_the_unit_in_its_name_unless_the_map_states_another(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('time = "t"\n[joint]\na = "a_deg"\n[actuator]\na = { column = "cmd_deg", unit = "mrad" }\n')
    columns = read_columns(path, ("a",), ("a",))
    assert columns.joint["a"].unit == "deg" and columns.actuator["a"].unit == "mrad"
    assert columns.rows()[1:] == ["a_deg -> position of a [deg]", "cmd_deg -> command of a [mrad]"]


def test_holes_in_the_logs_are_told_and_not_counted(servo_arm):
    robot, trials = servo_arm
    assert "left out" not in ranges_of(robot, trials)
    joint = trials[0].tables["joint"]
    t = np.asarray(joint["t"], float)
    late = {"t": np.where(np.arange(len(t)) < 200, t, t + 1.5)}
    told = ranges_of(robot, [replace(trials[0], tables=trials[0].tables | {"joint": dict(joint) | late})])
    assert "1 hole of 1.5 s left out" in told


@pytest.mark.parametrize(("answer", "code"), [("CLASS", console.FAILED_CHECK), ("NAMED", console.OK), ("AGREES", console.OK)])
def test_apply_of_an_uncertain_answer_fails_as_that_of_a_fish_does(answer, code, servo_arm, tmp_path, capsys):
    robot, _ = servo_arm
    value = {"value": 0.1, "unit": "kg", "low": 0.09, "high": 0.11}
    found = [] if answer == "AGREES" else [{"name": "body_mass@lower", "parameters": {"mass": value}}]
    context = {"model": str(robot.path), "model_sha256": sha256(robot.path)}
    write_json(
        tmp_path / "verdict.json", {"answer": answer, "effects": found, "context": context, "gap_before": 9, "gap_after": 1}
    )
    assert console.run(apply.main, [str(tmp_path)]) == code
    said = capsys.readouterr().out
    assert ("compare it with its parent" in said) == (answer == "NAMED")
