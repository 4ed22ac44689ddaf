"""Commands around the search of a robot in MJCF: check, calibration, import, next experiment. All logs are *synthetic*."""

import json

import numpy as np
import pytest
from robot_arm import ARM, edited, write_logs

from fishmj.base.errors import ConfigError
from fishmj.gap.commands import check
from fishmj.gap.commands.check_robot import ratio_of
from fishmj.gap.commands.find_robot import digest, logs_digest
from fishmj.gap.records.robot_logs import log_files

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
