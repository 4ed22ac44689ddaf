"""The trial folder of a swim: whole after every end, even after a kill; what cannot be written as a number is said in words."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fishmj.deploy.mcap_out import write
from fishmj.deploy.observer import Pose
from fishmj.deploy.pilot import PlayedPilot
from fishmj.deploy.supervisor import Condition
from fishmj.deploy.trial_log import FIRST, Rows, TrialLog
from fishmj.errors import StoreError
from fishmj.log import read_trial
from fishmj.mjcf.description import load_robot
from fishmj.protocols.messages import Telemetry
from tests.deploying import Bench

META = {"origin": "measured", "robot": "fish"}
ROOT = Path(__file__).resolve().parent.parent


def test_a_table_grows_past_its_first_size():
    rows = Rows(["t", "x"])
    for k in range(2 * FIRST + 5):
        rows.add(k, 2 * k)
    table = rows.table()
    np.testing.assert_array_equal(table["x"], 2 * np.arange(2 * FIRST + 5))


def test_every_table_of_a_swim_is_there_with_its_clocks(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=1.0)
    bench.swim()
    trial = read_trial(bench.folder)
    assert set(trial.tables) == {"cmd", "joint", "pose", "power", "obs", "action", "target"}
    assert set(trial.meta["clock"]) == set(trial.tables)
    assert {"asked1", "seq", "state"} <= set(trial.tables["cmd"])
    assert {"t_robot", "t_rx", "seq", "echo", "temp1"} <= set(trial.tables["joint"])
    pose = trial.tables["pose"]
    assert trial.value("latency.pose") == pytest.approx(0.06)
    np.testing.assert_allclose(pose["t"] - pose["t_taken"], 0.06, atol=1e-9)
    assert trial.meta["host"]["loop"]["ticks"] > 50 and trial.meta["host"]["events"][-1].endswith("FINISHED")


def test_readings_are_stamped_by_the_robots_even_clock_shifted_to_the_hosts(tmp_path):
    log, late = TrialLog(tmp_path / "swim", META, 3), np.random.default_rng(0).exponential(0.004, 100)
    for k in range(100):
        log.heard(50.0 + 0.02 * k + late[k], Telemetry((0.0, 0.0, 0.0), k, 3.0 + 0.02 * k))
    log.close()
    joint = read_trial(tmp_path / "swim").tables["joint"]
    np.testing.assert_allclose(np.diff(joint["t"]), 0.02, atol=1e-9)
    assert (joint["t_rx"] - joint["t"]).min() == pytest.approx(0.0, abs=1e-12)


def test_a_robot_that_restarts_gets_a_shift_of_its_own(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    for k in range(100):
        log.heard(50.0 + 0.02 * k, Telemetry((0.0, 0.0, 0.0), k, 0.02 * (k if k < 60 else k - 60)))
    log.close()
    np.testing.assert_allclose(np.diff(read_trial(tmp_path / "swim").tables["joint"]["t"]), 0.02, atol=1e-9)


def test_rows_that_are_no_numbers_are_left_out_and_counted(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    for k in range(5):
        log.command(0.02 * k, np.zeros(3), np.array([0.0, np.nan if k == 2 else 0.0, 0.0]), None, 3)
        log.heard(0.02 * k, Telemetry((0.0, 0.0, 0.0)))
    log.close()
    trial = read_trial(tmp_path / "swim")
    assert len(trial.tables["cmd"]["t"]) == 4 and trial.meta["host"]["rows_dropped"] == 1
    assert "t_robot" not in trial.tables["joint"] and "temp1" not in trial.tables["joint"]


def test_a_reading_beyond_all_bounds_is_kept_and_said(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    for k in range(5):
        log.heard(0.02 * k, Telemetry((0.0, 9.0, 0.0)))
    log.close()
    trial = read_trial(tmp_path / "swim")
    assert trial.tables["joint"]["j2"].max() == 9.0 and "degrees" in trial.meta["host"]["implausible"]


def test_repeated_stamps_do_not_make_a_log_unreadable(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    for t in (0.0, 0.02, 0.02, 0.01, 0.04):
        log.fix(Pose(t, 0.0, 0.0, 0.0, t + 0.05), 1.0)
    log.close()
    assert len(read_trial(tmp_path / "swim").tables["pose"]["t"]) == 3


def test_a_folder_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "swim").mkdir()
    with pytest.raises(StoreError, match="exists"):
        TrialLog(tmp_path / "swim", META, 3)


def test_nothing_is_written_where_nothing_was_heard(tmp_path):
    with TrialLog(tmp_path / "swim", META, 3):
        pass
    assert not (tmp_path / "swim").exists()


def test_a_disk_that_refuses_does_not_lose_the_trial(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "full").write_text("a file where the folder should be", encoding="utf-8")
    log = TrialLog(tmp_path / "full" / "swim", META, 3)
    log.heard(0.0, Telemetry((0.0, 0.0, 0.0)))
    log.heard(0.1, Telemetry((0.0, 0.0, 0.0)))
    with pytest.raises(StoreError, match="was kept in"):
        log.close()
    assert len(read_trial(log.folder).tables["joint"]["t"]) == 2


def test_why_the_camera_failed_stands_in_the_log(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.at(0.1, lambda: setattr(bench.eyes, "failed", StoreError("no more pictures")))
    bench.swim()
    assert any("no more pictures" in event for event in read_trial(bench.folder).meta["host"]["events"])


def test_an_experiment_plays_its_commands_tick_by_tick(tmp_path):
    commands = 0.2 * np.sin(np.arange(60) * 0.3)[:, None] * np.ones(3)
    bench = Bench(tmp_path / "swim", seconds=1.2, pilot=PlayedPilot(commands), plan={"pose": False})
    bench.eyes.blind = True
    assert bench.swim().complete
    cmd = read_trial(bench.folder).tables["cmd"]
    begun = np.flatnonzero(cmd["state"] == 3)[0]
    np.testing.assert_allclose(cmd["asked2"][begun : begun + 60], commands[:, 1], atol=1e-12)


def test_an_experiment_ends_by_the_same_faults(tmp_path):
    bench = Bench(tmp_path / "swim", pilot=PlayedPilot(np.zeros((150, 3))), plan={"pose": False})
    bench.at(1.0, lambda: setattr(bench.robot, "silent", True))
    assert bench.swim().cause == Condition.LINK_SILENT


def test_a_swim_goes_out_as_mcap(tmp_path):
    pytest.importorskip("mcap")
    from mcap.reader import make_reader

    bench = Bench(tmp_path / "swim", seconds=1.0)
    bench.swim()
    out = write(bench.folder, load_robot("fish"))
    with open(out, "rb") as file:
        summary = make_reader(file).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert any("cmd" in topic for topic in topics) and any("pose" in topic for topic in topics)


KILLED = """
import time, sys
from pathlib import Path
import numpy as np
from fishmj.deploy.trial_log import TrialLog
from fishmj.protocols.messages import Telemetry
with TrialLog(Path(sys.argv[1]), {"origin": "measured", "robot": "fish"}, 3, every=0.2) as log:
    k = 0
    while True:
        log.command(0.02 * k, np.zeros(3), np.zeros(3), k, 3)
        k += 1
        if k == 25:
            print("under way", flush=True)
        time.sleep(0.002)
"""


def test_a_killed_swim_loses_only_what_came_since_the_last_writing(tmp_path):
    folder = tmp_path / "swim"
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(folder)], stdout=subprocess.PIPE, cwd=ROOT)
    process.stdout.readline()
    end = time.monotonic() + 20
    while not folder.exists() and time.monotonic() < end:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert len(read_trial(folder).tables["cmd"]["t"]) >= 25
