"""Answers about a robot in MJCF: what may be called named, and what `gap check` says is left. All is *synthetic*."""

from dataclasses import replace

import mujoco
import pytest
from robot_arm import ARM, trials_of, write_logs

from fishmj.gap.commands.check_robot import compare, printed_lines
from fishmj.gap.commands.find_robot import by_effect, without_stand_in
from fishmj.gap.models.robot_description import read_robot
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
