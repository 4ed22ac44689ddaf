"""The trial folder of a swim: whole after every end, even after a kill; what cannot be written as a number is said in words."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import LogError, StoreError
from fishmj.deploy.__main__ import main
from fishmj.deploy.commands.swim_command import write_mcap
from fishmj.deploy.loop.journal import Journal
from fishmj.deploy.loop.observation import Pose
from fishmj.deploy.loop.pilot import PlayedPilot
from fishmj.deploy.loop.supervisor import Condition
from fishmj.deploy.loop.trial_log import FIRST, RowBuffer, TrialLog, recovered
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.log import read_trial
from fishmj.mjcf.reading import load_robot
from tests.deploying import Bench

META = {"origin": "measured", "robot": "fish"}
ROOT = Path(__file__).resolve().parent.parent


def test_rows_that_wait_grow_past_their_first_room_and_leave_in_order():
    rows = RowBuffer(["t", "x"])
    for k in range(2 * FIRST + 5):
        rows.add(k, 2 * k)
    np.testing.assert_array_equal(rows.waiting()[:, 1], 2 * np.arange(2 * FIRST + 5))
    rows.drop(2 * FIRST)
    rows.add(-1, -2)
    np.testing.assert_array_equal(rows.waiting()[:, 0], [*range(2 * FIRST, 2 * FIRST + 5), -1])


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


def test_joint_stamps_follow_the_robot_clock_shifted_to_host_time(tmp_path):
    log, late = TrialLog(tmp_path / "swim", META, 3), np.random.default_rng(0).exponential(0.004, 100)
    for k in range(100):
        log.heard(50.0 + 0.02 * k + late[k], Telemetry((0.0, 0.0, 0.0), k, 3.0 + 0.02 * k))
    log.close()
    joint = read_trial(tmp_path / "swim").tables["joint"]
    np.testing.assert_allclose(np.diff(joint["t"]), 0.02, atol=1e-9)
    assert (joint["t_rx"] - joint["t"]).min() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("ahead", "shift"), [(47.0, 47.0), (46.0, 47.006), (47.02, 47.006)])
def test_clock_shift_uses_the_round_trip_if_plausible_else_the_least_delay(tmp_path, ahead, shift):
    """The least delay has the whole way up in it, here 6 ms; another life of the robot's was asked where that does not fit."""
    log = TrialLog(tmp_path / "swim", META | {"host": {"robot": {"clock": {"ahead": ahead, "round_trip": 0.012}}}}, 3)
    log.command(50.0, np.zeros(3), np.zeros(3), 0, 3)
    for k in range(100):
        log.heard(50.006 + 0.02 * k + 0.001 * (k % 3), Telemetry((0.0, 0.0, 0.0), k, 3.0 + 0.02 * k))
    log.close()
    trial = read_trial(tmp_path / "swim")
    np.testing.assert_allclose(trial.tables["joint"]["t"] + 50.0 - 0.02 * np.arange(100), 3.0 + shift, atol=1e-9)
    assert trial.meta["clock"]["joint"].endswith("half of a round trip" if shift == ahead else "the least delay")


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
    out = write_mcap(bench.folder, load_robot("fish"))
    with open(out, "rb") as file:
        summary = make_reader(file).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert any("cmd" in topic for topic in topics) and any("pose" in topic for topic in topics)


KILLED = """
import time, sys
from pathlib import Path
import numpy as np
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.protocols.messages import Telemetry
with TrialLog(Path(sys.argv[1]), {"origin": "measured", "robot": "fish"}, 3, every=0.2) as log:
    k = 0
    while True:
        log.command(0.02 * k, np.zeros(3), np.zeros(3), k, 3)
        k += 1
        if k == 25:
            print("under way", flush=True)
        time.sleep(0.002)
"""


def test_a_killed_swim_loses_only_what_came_since_the_last_writing(tmp_path, capsys):
    folder = tmp_path / "swim"
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(folder)], stdout=subprocess.PIPE, cwd=ROOT)
    process.stdout.readline()
    rows, end = folder / "journal" / "cmd.f64", time.monotonic() + 600
    while not (rows.exists() and rows.stat().st_size >= 25 * 9 * 8) and time.monotonic() < end:
        time.sleep(0.05)
    assert console.run(main, ["recover", str(folder)]) == console.BAD_INPUT and "still under way" in capsys.readouterr().err
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    with pytest.raises(LogError, match=f"fishmj deploy recover {folder}"):
        read_trial(folder)
    assert console.run(main, ["recover", str(folder)]) == console.OK and "rows: cmd" in capsys.readouterr().out
    trial = read_trial(folder)
    assert len(trial.tables["cmd"]["t"]) >= 25 and "was killed" in trial.meta["host"]["events"][-1]
    np.testing.assert_allclose(trial.tables["cmd"]["t"], 0.02 * np.arange(len(trial.tables["cmd"]["t"])), atol=1e-12)
    assert not (folder / "journal").exists() and "state" not in trial.meta["host"]
    assert console.run(main, ["recover", str(folder)]) == console.BAD_INPUT and "nothing to recover" in capsys.readouterr().err


def taken(log, first, last):
    """Rows of a swim between two ticks: joints that lag, a pose that is late by a random time."""
    random = np.random.default_rng(0)
    late = random.exponential(0.004, last)
    for k in range(first, last):
        t = 50.0 + 0.02 * k
        log.command(t, np.full(3, 0.01 * k), np.full(3, 0.02 * k), k, 3)
        log.heard(t + late[k], Telemetry((0.0, 0.1, 0.0), k, 3.0 + 0.02 * k, voltage=7.4, current=0.5))
        log.fix(Pose(t - 0.06, 0.001 * k, 0.0, 0.0, t + late[k]), 1.0)


def test_trial_log_is_identical_with_or_without_journal_and_after_a_kill(tmp_path):
    whole, flushed, killed = (TrialLog(tmp_path / name, META, 3) for name in ("whole", "flushed", "killed"))
    for log in (whole, flushed, killed):
        for first, last in ((0, 30), (30, 31), (31, 90)):
            taken(log, first, last)
            if log is not whole:
                log.flush()
    whole.close()
    flushed.close()
    killed._journal.close()  # as the system does for a process that is gone
    recovered(killed.folder)
    trials = [read_trial(log.folder) for log in (whole, flushed, killed)]
    for other in trials[1:]:
        assert set(other.tables) == set(trials[0].tables)
        for name, table in trials[0].tables.items():
            for column, values in table.items():
                np.testing.assert_array_equal(values, other.tables[name][column])
        assert other.meta["clock"] == trials[0].meta["clock"] and other.meta["latency"] == trials[0].meta["latency"]


def test_writing_takes_as_much_at_the_tenth_minute_as_at_the_first(tmp_path, monkeypatch):
    log, sizes = TrialLog(tmp_path / "swim", META, 3), []
    append = Journal.append
    monkeypatch.setattr(Journal, "append", lambda one, name, rows: (sizes.append(rows.size), append(one, name, rows)))
    for k in range(30):
        taken(log, 100 * k, 100 * (k + 1))
        log.flush()
        assert all(rows.count == 0 and len(rows._data) == FIRST for rows in log.rows.values())
    assert len(set(sizes)) == len({"cmd", "joint", "pose", "power"}) and len(sizes) == 120
    log.close()


def test_a_row_that_is_half_on_the_disk_is_left_out(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    taken(log, 0, 20)
    log.flush()
    log._journal.close()
    with open(tmp_path / "swim" / "journal" / "cmd.f64", "ab") as file:
        file.write(b"\0" * 20)
    assert len(recovered(tmp_path / "swim").tables["cmd"]["t"]) == 20


def test_rows_wait_while_the_disk_refuses(tmp_path, monkeypatch):
    log, append = TrialLog(tmp_path / "swim", META, 3), Journal.append

    def full(one, name, rows):
        raise StoreError("no space left")

    taken(log, 0, 20)
    monkeypatch.setattr(Journal, "append", full)
    with pytest.raises(StoreError, match="no space"):
        log.flush()
    monkeypatch.setattr(Journal, "append", append)
    taken(log, 20, 40)
    log.flush()
    log.close()
    assert len(read_trial(tmp_path / "swim").tables["cmd"]["t"]) == 40


def test_what_is_no_journal_is_one_line(tmp_path):
    (tmp_path / "swim" / "journal").mkdir(parents=True)
    with pytest.raises(StoreError, match="no journal of a swim"):
        recovered(tmp_path / "swim")
    (tmp_path / "swim" / "journal" / "layout.json").write_text('{"zero": 1}', encoding="utf-8")
    with pytest.raises(StoreError, match="no layout of a journal"):
        recovered(tmp_path / "swim")


def test_discarded_swim_leaves_no_folder(tmp_path):
    log = TrialLog(tmp_path / "swim", META, 3)
    log.heard(0.0, Telemetry((0.0, 0.0, 0.0)))
    log.flush()
    assert (tmp_path / "swim" / "journal").is_dir()
    log.discard()
    log.close()
    assert not (tmp_path / "swim").exists()
    TrialLog(tmp_path / "swim", META, 3)  # the next swim may have the name


def test_swim_that_never_arms_leaves_no_folder(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.eyes.blind = True
    assert not bench.swim().cause and not (tmp_path / "swim").exists()
