"""Commands around the search of a robot in MJCF: check, calibration, import, next experiment. All logs are *synthetic*."""

import json
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from robot_arm import ARM, edited, write_logs

from fishmj.base.errors import ConfigError, LogError
from fishmj.gap.calibrate import robot_command
from fishmj.gap.calibrate.robot_fit import described, fit_robot
from fishmj.gap.commands import check
from fishmj.gap.commands.check_robot import ratio_of
from fishmj.gap.commands.find_robot import digest, logs_digest, read_logs
from fishmj.gap.records.robot_logs import log_files
from fishmj.gap.records.shooting import robot_records

pytest.importorskip("numba")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("doors")


@pytest.fixture(scope="module")
def arm(folder):
    return written(folder / "arm.xml", ARM)


def written(path, text):
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def sticky_logs(folder):
    return write_logs(folder / "sticky", edited(elbow_joint='frictionloss="0.06"'), logs=3, seconds=1.6)


# -------------------------------------------------------------------------------------------------------------------------- check
def said(capsys) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_version_with_the_friction_closes_the_gap(arm, sticky_logs, folder, capsys):
    version = written(folder / "arm.v2.xml", edited(elbow_joint='frictionloss="0.06"'))
    asked = [str(version), "--data", str(sticky_logs), "--parent", str(arm), "--yes", "--json"]
    assert check.main(asked) == 0
    found = said(capsys)
    assert found["ratio"]["high"] < 0.1 and found["gap"] < found["gap_parent"] and not found["worse"]
    before, after = found["by_joint"]["elbow"]
    assert after < 0.1 * before


def test_version_that_is_no_better_fails(arm, sticky_logs, folder, capsys):
    version = written(folder / "wrong.v2.xml", ARM.replace('damping="0.06"', 'damping="0.2"'))
    asked = [str(version), "--data", str(sticky_logs), "--parent", str(arm), "--yes", "--json"]
    assert check.main(asked) == 1
    assert "no smaller than its parent's" in said(capsys)["worse"]


def test_version_beside_its_report_is_judged_on_logs_set_aside(arm, sticky_logs, tmp_path, capsys):
    version = written(tmp_path / "arm.v2.xml", edited(elbow_joint='frictionloss="0.06"'))
    context = {"model": str(arm), "model_sha256": digest(arm), "judged": ["swing1"]}
    context["data_sha256"] = logs_digest(log_files(sticky_logs))
    verdict = {"answer": "NAMED", "effects": [], "context": context, "gap_before": 9.0, "gap_after": 1.0}
    (tmp_path / "verdict.json").write_text(json.dumps(verdict))
    assert check.main([str(version), "--data", str(sticky_logs), "--yes", "--json"]) == 0
    found = said(capsys)
    assert found["logs"] == ["swing1"] and found["same_data"]


def test_version_without_its_parent_is_refused(folder, sticky_logs, tmp_path):
    version = written(tmp_path / "arm.v2.xml", ARM)
    with pytest.raises(ConfigError, match="--parent"):
        check.main([str(version), "--data", str(sticky_logs), "--yes"])
    other = written(tmp_path / "other.xml", ARM.replace('"elbow"', '"knee"'))
    with pytest.raises(ConfigError, match="joints differ"):
        check.main([str(version), "--data", str(sticky_logs), "--parent", str(other), "--yes"])


def test_interval_of_a_ratio_holds_it_and_narrows_with_more_logs():
    rng = np.random.default_rng(1)
    widths = []
    for logs in (6, 60):
        before, noise = rng.gamma(2.0, size=4 * logs), rng.gamma(2.0, size=4 * logs)
        ratio = ratio_of(before, 0.5 * noise, np.repeat(np.arange(logs), 4))
        assert ratio.low < 0.5 < ratio.high and ratio.over == "logs"
        widths.append(ratio.high - ratio.low)
    assert widths[1] < widths[0]


# -------------------------------------------------------------------------------------------------------------- calibrate model
@pytest.fixture(scope="module")
def stiff_logs(folder):
    text = edited(elbow_joint='frictionloss="0.06" armature="0.004"').replace('damping="0.06"', 'damping="0.12"')
    return write_logs(folder / "stiff", text, logs=2, seconds=1.7, seed=3)


def test_calibration_finds_friction_damping_and_armature(arm, stiff_logs, tmp_path, capsys):
    out = tmp_path / "arm.calibrated.xml"
    asked = [str(stiff_logs), "--model", str(arm), "--yes", "--out", str(out), "--only", "friction,damping,armature,bodies"]
    assert robot_command.main([*asked, "--json"]) == 0
    found = said(capsys)
    numbers = {n["name"]: n for n in found["numbers"]}
    for name, true in (("coulomb_friction@elbow", 0.06), ("rotor_inertia@elbow", 0.004), ("viscous_friction@shoulder", 0.12)):
        n = numbers[name]
        assert n["low"] <= true <= n["high"] and n["is_told"] and abs(n["value"] - true) < 0.1 * true, n
    m = mujoco.MjModel.from_xml_path(str(out))
    assert m.dof_frictionloss[1] == pytest.approx(0.06, rel=0.1) and m.dof_damping[0] == pytest.approx(0.12, rel=0.1)
    left = [n for n in found["numbers"] if not n["is_told"]]
    assert {"inertia@upper"} <= {n["name"] for n in left} and found["misfit"][1] < 0.1 * found["misfit"][0]
    assert m.body_inertia[1].tolist() == [0.004, 0.004, 0.0005]  # not told, so as stated
    assert "90 % intervals" in out.read_text()


def test_number_that_no_log_shows_is_left(arm, folder):
    """A motor has no damping gain, and a joint at rest tells no friction."""
    logs = write_logs(folder / "still", ARM, logs=2, seconds=1.0)
    robot, records = opened(arm, logs)
    at_rest = [r._replace(joint=r.joint._replace(values=r.joint.values * [1.0, 0.0])) for r in records]
    found = fit_robot(robot, at_rest, ("friction", "gain"))
    left = {n.name: described(n) for n in found.numbers if not n.is_told}
    assert left["servo_damping_gain@shoulder"] == left["coulomb_friction@elbow"] == "left: no log shows it"
    assert found.model.dof_frictionloss[1] == 0.0
    with pytest.raises(LogError, match="no joint moves"):
        fit_robot(robot, [r._replace(joint=r.joint._replace(values=0.0 * r.joint.values)) for r in records])


def opened(path, logs):
    robot, _, trials, _ = read_logs(SimpleNamespace(model=path, data=logs, columns=None, yes=True))
    return robot, robot_records(trials, robot.dt, robot.sites("joint"))


def test_calibration_refuses_what_it_does_not_know(arm, stiff_logs, tmp_path):
    with pytest.raises(ConfigError, match="known: friction, damping"):
        robot_command.main([str(stiff_logs), "--model", str(arm), "--only", "colour"])
    with pytest.raises(ConfigError, match="exists, or does not end"):
        robot_command.main([str(stiff_logs), "--model", str(arm), "--out", str(arm)])
