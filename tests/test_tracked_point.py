"""A log states the tracked point of the body and the age of its poses, and both are used."""

from dataclasses import replace

import lab_files
import numpy as np
import pytest
from lab_files import near, only, swim, three, write

from fishmj.base.errors import LogError
from fishmj.gap.commands import admission
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import record_of
from fishmj.log import Trial, tracked_point
from fishmj.mjcf.reading import load_robot

T, WAGS = np.arange(0, 6, 0.02), np.arange(lab_files.ROWS) % 7


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def trial(**meta):
    beat = 0.4 * np.sin(6 * T) * (T > 0.5)
    joints = {f"{letter}{k}": beat for letter in "cj" for k in (1, 2, 3)}
    tables = {name: {"t": T, **{k: v for k, v in joints.items() if k[0] == name[0]}} for name in ("cmd", "joint")}
    return Trial(meta, {**tables, "pose": {"t": T, "x": 0.05 * T, "y": 0 * T, "yaw": 0.3 * T}}, name="a")


def test_a_marker_is_taken_out_of_the_pose_row_by_row(tmp_path, bring):
    files = three(tmp_path / "in")
    assert bring(tmp_path / "in", "--yes")[0] == 0
    plain = only(tmp_path / "set").table("pose")
    code, out, err = bring(*files, "--yes", "--marker", "0.08,-0.02", out=tmp_path / "moved")
    moved = only(tmp_path / "moved")
    c, s, pose = np.cos(plain["yaw"]), np.sin(plain["yaw"]), moved.table("pose")
    near(pose["x"] + c * 0.08 + s * 0.02, plain["x"])
    near(pose["y"] + s * 0.08 - c * 0.02, plain["y"])
    near(pose["yaw"], plain["yaw"])
    assert code == 0 and moved.value("marker") == [0.08, -0.02] and "0.08 m ahead" in out, err
    code, _, err = bring(tmp_path / "moved", "--marker", "0.08,0", out=tmp_path / "twice")
    assert code == 2 and "is of the reference point already" in err


def test_a_map_states_the_marker_too(tmp_path, bring):
    three(tmp_path / "in")
    assert bring(tmp_path / "in", "--write-map", tmp_path / "map.toml", out=None)[0] == 0
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(f"[meta]\nmarker = [0.1, 0]\n{text}")
    assert bring(tmp_path / "in", "--columns", tmp_path / "map.toml")[0] == 0
    assert only(tmp_path / "set").table("pose")["x"][0] == pytest.approx(1.1, abs=2e-3)
    (tmp_path / "map.toml").write_text(f"[meta]\nmarker = [100, 0]\n{text}")
    code, _, err = bring(tmp_path / "in", "--columns", tmp_path / "map.toml", out=tmp_path / "bad")
    assert code == 2 and "marker = [100, 0]; expected two numbers AHEAD,LEFT in m" in err


def test_one_line_says_what_is_assumed_of_the_camera_and_shared_notes_are_said_once(tmp_path, bring):
    for k in range(5):
        s = swim() | {"gripper": WAGS}
        write(tmp_path / "in" / f"swim{k}.csv", {{"x": "x_mm", "y": "y_mm", "yaw": "yaw_deg"}.get(c, c): v for c, v in s.items()})
    code, out, err = bring(tmp_path / "in", "--yes", "--trial-each")
    assert code == 0 and out.count("assumed, since not stated") == 1, err
    assert "--marker AHEAD,LEFT" in out and "--camera-latency S" in out
    assert out.count("not read: gripper") == 1 and "swim0.csv: not read: gripper (and 4 more trials)" in out
    _, out, _ = bring(tmp_path / "in", "--yes", "--camera-latency", "0.03", out=tmp_path / "late")
    assert "--marker" in out and "--camera-latency" not in out
    code, out, _ = bring(tmp_path / "late", out=tmp_path / "copied")
    assert code == 0 and "assumed" not in out, "a data set says what its poses are"


def test_the_age_of_poses_that_a_log_states_is_used_in_place_of_the_descriptions():
    model, robot = SwimmingFish("fish"), load_robot("fish")
    for age in (0.0, 0.03, 0.2):
        seen = model.records([trial(latency={"pose": age})])[0].pose
        assert seen.t[-1] - T[-1] == pytest.approx(robot.timing.camera_latency - age)
        assert np.interp(3.0, seen.t, seen.values[:, 2]) == pytest.approx(0.3 * (3.0 - model.camera + age))
    assert model.records([trial()])[0].pose.t[0] == 0.0 == record_of(trial(latency={"pose": 0.2}), 0.004).pose.t[0]
    with pytest.raises(LogError, match="latency.pose = 65; expected the age of a pose at its stamp, 0 to 1 s"):
        record_of(trial(latency={"pose": 65}), 0.004)


def test_a_search_says_which_age_of_the_poses_it_takes():
    robot = load_robot("fish")
    still = {"flow": {"speed": 0.0}}
    assert admission.surroundings([trial(**still), trial(latency={"pose": 0.065}, **still)], robot) == []
    told = admission.surroundings([trial(latency={"pose": 0.03}, **still), replace(trial(**still), name="b")], robot)
    assert told == [
        "1 trials state the age of a pose at its stamp, latency.pose 0.03 to 0.03 s; "
        f"it replaces camera_latency = 0.065 s of {robot.name!r}"
    ]


def test_a_trial_without_a_camera_keeps_its_tables():
    bare = replace(trial(), tables={"cmd": trial().tables["cmd"]})
    assert tracked_point.referred(bare, (0.1, 0.0)) is bare and tracked_point.unsaid(bare) == set()
