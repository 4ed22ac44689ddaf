"""A scale of the positions that is wrong by ten shows in the way of a beat over the body's length."""

from argparse import Namespace
from dataclasses import replace

import lab_files
import numpy as np
import pytest

from fishmj import log
from fishmj.base.calib import calib_folder
from fishmj.gap.calibrate.commands import open_logs
from fishmj.gap.commands.admission import admitted, unphysical
from fishmj.gap.laboratory import generators
from fishmj.log import physical_checks
from fishmj.mjcf.reading import load_robot

FISH = load_robot("fish")


def scaled(trial, times, **meta):
    """The trial with positions that are so many times too large."""
    pose = trial.tables["pose"]
    pose = {**pose, **{name: times * np.asarray(pose[name], float) for name in ("x", "y")}}
    return replace(trial, tables={**trial.tables, "pose": pose}, meta={**trial.meta, **meta})


def stride_notes(trial, length=FISH.length):
    return [found for found in physical_checks.examine(trial, ["stride"], length)]


@pytest.fixture(scope="module", params=["foil", "ellipsoid", "morison"])
def swim(request):
    (trial,) = generators.generate(request.param, {}, ["gait"], 23)
    return trial


def test_a_scale_that_is_ten_times_too_large_is_told_with_what_is_expected(swim):
    assert stride_notes(swim) == [] and stride_notes(scaled(swim, 10), length=0.0) == []
    (found,) = stride_notes(scaled(swim, 10))
    assert found.level == physical_checks.NOTE and "body lengths a beat" in found.text
    assert "0.535 m long; expected 0.1 to 1, at most 1.5): is the scale of x and y wrong" in found.text
    assert "allow it with stride in [plausible] of meta.toml" in found.text
    assert stride_notes(scaled(swim, 10, plausible={"stride": 20.0})) == []


def test_a_fish_that_is_pushed_or_in_an_unknown_stream_or_carried_by_a_stated_one_is_not_doubted(swim):
    assert (
        stride_notes(scaled(swim, 10, push=[0.3, 0.0, 0.0])) == [] and stride_notes(scaled(swim, 10, flow={"known": False})) == []
    )
    t = np.asarray(swim.tables["pose"]["t"], float)
    pose = {**swim.tables["pose"], "x": np.asarray(swim.tables["pose"]["x"], float) + 1.5 * t}
    carried = replace(swim, tables={**swim.tables, "pose": pose})
    assert (
        stride_notes(carried)
        and stride_notes(replace(carried, meta={**carried.meta, "flow": {"speed": 1.5, "direction": 0.0}})) == []
    )


def test_a_fish_that_glides_or_is_towed_with_straight_joints_is_not_judged(swim):
    still = {name: 0 * np.asarray(v) if name != "t" else v for name, v in swim.tables["joint"].items()}
    assert stride_notes(scaled(replace(swim, tables={**swim.tables, "joint": still}), 10)) == []


def test_shipped_trials_pass():
    trials = [trial for trial in log.read_dataset(calib_folder() / "trials") if "pose" in trial.tables]
    assert [found for trial in trials for found in stride_notes(trial)] == []
    assert sum(bool(stride_notes(scaled(trial, 10))) for trial in trials) == 15  # all that beat before a camera


def test_the_search_and_the_calibration_tell_it_of_their_robot(tmp_path, capsys):
    trials = [scaled(log.read_trial(calib_folder() / "trials" / f"swim_gait_{k}"), 5) for k in (1, 2)]
    log.write_dataset(tmp_path / "data", {trial.name: trial for trial in trials})
    assert "body lengths a beat" in unphysical(trials, length=FISH.length)[1][0] and unphysical(trials)[1] == []
    assert any("body lengths a beat" in note for note in admitted(tmp_path / "data", FISH, "fish", agreed=False)[1])
    open_logs(Namespace(data=tmp_path / "data", model="fish", same_robot=False), FISH)
    assert capsys.readouterr().err.count("body lengths a beat") == 2


def test_import_with_the_robot_notes_a_pixel_that_is_ten_times_too_large(tmp_path, capsys, monkeypatch, swim):
    bring = lab_files.importer(tmp_path, capsys, monkeypatch)
    pose, joint = swim.tables["pose"], swim.tables["joint"]
    lab_files.write(
        tmp_path / "lab" / "camera.csv",
        {"time_s": pose["t"], **{f"{c}_px": np.asarray(pose[c]) / 0.002 for c in "xy"}, "yaw_rad": pose["yaw"]},
    )
    angles = {f"measured{k}_deg": np.degrees(joint[f"j{k}"]) for k in (1, 2, 3)}
    lab_files.write(tmp_path / "lab" / "joint.csv", {"time_s": joint["t"], **angles})
    for metres, robot, count in ((0.02, ("--robot", "fish"), 1), (0.002, ("--robot", "fish"), 0), (0.02, (), 0)):
        said = [word for c in "xy" for word in ("--set", f"{c}_px=pose.{c}:px*{metres}")]
        out = tmp_path / f"out_{metres}_{len(robot)}"
        code, text, err = bring(tmp_path / "lab", "--yes", *said, *robot, out=out)
        assert code == 0 and text.count("body lengths a beat") == count, err + text
        assert "length" not in log.read_trial(out / "lab").meta
