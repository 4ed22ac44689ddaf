"""The line on a judged robot, in the head of every report."""

from dataclasses import replace

from fishmj.base.calib import calib_folder
from fishmj.mjcf import load_robot
from fishmj.mjcf.identity import robot_line, robot_names, robot_sha256


def test_a_judged_robot_is_named_with_its_file_and_hash(tmp_path):
    shipped = load_robot("fish")
    path = tmp_path / "own.toml"
    path.write_text((calib_folder() / "fish.toml").read_text().replace('name = "swift"', 'name = "mine"', 1))
    own = load_robot(path)
    assert robot_names(own) == {"name": "mine", "file": str(path), "sha256": robot_sha256(own)}
    assert robot_line(own) == f"Robot mine, {path}, sha256 {robot_sha256(own)[:12]}"
    assert robot_line(shipped).startswith("Robot swift, shipped as fish, sha256 ")
    by_hand = replace(shipped, file="")
    assert robot_line(by_hand).startswith("Robot swift, described in Python, ") and robot_sha256(by_hand) == robot_sha256(shipped)
    assert by_hand == shipped and repr(by_hand) == repr(shipped)
