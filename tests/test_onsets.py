"""A clock that is whole beats off is told by the onset of motion; a fish that is held, towed or let go raises no alarm.

The swims are of generators with other waters than the chain on which the thresholds of fishmj.log.onsets were chosen.
"""

from dataclasses import replace
from functools import cache

import lab_files
import numpy as np
import pytest

from fishmj import log
from fishmj.base.calib import calib_folder
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.log import onsets, timebase


@cache
def swim(family="foil", what="gait", seed=11):
    """A swim from rest that a generator, or the virtual robot, logs."""
    return next(iter(generators.generate(family, {}, [what], seed) if family else generate({}, [what], seed)))


def late(trial, seconds, *tables):
    """The trial with the clocks of some tables set so many seconds ahead."""
    moved = {name: {**trial.tables[name], "t": np.asarray(trial.tables[name]["t"]) + seconds} for name in tables}
    return replace(trial, tables={**trial.tables, **moved})


def held_in_place(trial, until):
    """The trial of a fish that is held in its place until a time, while its joints move."""
    pose = {name: np.array(values, float) for name, values in trial.tables["pose"].items()}
    rows, rng = pose["t"] < until, np.random.default_rng(2)
    for name in ("x", "y", "yaw"):
        pose[name] = np.where(rows, pose[name][~rows][0] + 0.001 * rng.standard_normal(len(rows)), pose[name])
    return replace(trial, tables={**trial.tables, "pose": pose})


@pytest.mark.parametrize("family", ["foil", "ellipsoid", None])
@pytest.mark.parametrize("seconds", [5.0, -5.0])
def test_a_clock_that_is_whole_beats_off_is_told_from_the_first_motion(family, seconds):
    trial = swim(family)
    assert timebase.offsets(trial) == []
    for tables, table, offset in ((("joint",), "joint", -seconds), (("cmd", "joint"), "pose", seconds)):
        (found,) = timebase.offsets(late(trial, seconds, *tables))
        assert "first moves at t = " in found and f"the map's [tables.{table}] offset = " in found
        assert float(found.split("offset = ")[1].split(",")[0]) == pytest.approx(offset, abs=0.4)
        assert found in timebase.audit(late(trial, seconds, *tables)).findings


def test_records_that_count_from_their_own_beginning_are_told_by_the_growth_of_the_first_beats():
    """The camera has been on for 4 s more, in which the fish rests; no stamp tells."""
    trial = swim("ellipsoid")
    pose = {name: np.asarray(values, float) for name, values in trial.tables["pose"].items()}
    rest = np.arange(0.0, 4.0, 0.02)
    noise = 0.001 * np.random.default_rng(4).standard_normal(len(rest))
    more = {name: np.concatenate([pose[name][0] + noise, pose[name]]) for name in ("x", "y", "yaw")}
    more["t"] = np.concatenate([pose["t"][0] + rest, pose["t"] + 4.0])
    (found,) = timebase.offsets(replace(trial, tables={**trial.tables, "pose": more}))
    assert "[tables.pose] offset = -4" in found or "[tables.pose] offset = -3.9" in found


@pytest.mark.parametrize("family", ["foil", "morison", None])
@pytest.mark.parametrize("until", [3.6, 4.13, 5.02])
def test_a_fish_that_is_held_while_its_joints_beat_raises_no_alarm(family, until):
    assert timebase.offsets(held_in_place(swim(family), until)) == []


@pytest.mark.parametrize("what", ["tow_ahead", "drift_east", "idle", "impulse"])
def test_a_fish_that_is_towed_or_drifts_raises_no_alarm(what):
    assert timebase.offsets(swim("foil", what)) == []


def test_no_onset_is_claimed_of_a_record_that_begins_in_motion():
    trial = swim()
    cut = {name: {c: np.asarray(v)[np.asarray(table["t"]) > 4] for c, v in table.items()} for name, table in trial.tables.items()}
    joint = cut["joint"]
    assert onsets.onset_of(joint["t"], log.stacked(joint, "j#")) is None
    assert timebase.offsets(late(replace(trial, tables=cut), 5.0, "joint")) == []


def test_shipped_swims_raise_no_alarm():
    assert [found for trial in log.read_dataset(calib_folder() / "trials") for found in onsets.offset_findings(trial)] == []


@pytest.mark.parametrize("table", ["velocity", "imu"])
def test_the_turning_rate_of_another_sensor_serves_as_well_as_the_camera(table):
    trial = swim()
    pose = trial.tables["pose"]
    t, column = np.asarray(pose["t"], float), {"velocity": "yaw_rate", "imu": "wz"}[table]
    rate = {"t": t + 5.0, column: np.gradient(np.unwrap(pose["yaw"]), t)}
    tables = {"joint": trial.tables["joint"], table: rate}
    (found,) = timebase.offsets(replace(trial, tables=tables))
    assert f"[tables.{table}] offset = -" in found


def test_import_notes_a_servo_clock_that_is_off(tmp_path, capsys, monkeypatch):
    bring = lab_files.importer(tmp_path, capsys, monkeypatch)
    trial = swim("ellipsoid")
    for name, shift in (("cmd", 0.0), ("joint", 5.0)):
        angles = np.degrees(log.stacked(trial.tables[name], f"{name[0]}#"))
        columns = {f"{'goal' if name == 'cmd' else 'measured'}{k + 1}_deg": v for k, v in enumerate(angles.T)}
        lab_files.write(tmp_path / "lab" / f"{name}.csv", {"time_s": np.asarray(trial.tables[name]["t"]) + shift, **columns})
    code, out, err = bring(tmp_path / "lab", "--yes")
    assert code == 0 and "joint at t = " in out and "[tables.joint] offset = -5" in out, err + out
