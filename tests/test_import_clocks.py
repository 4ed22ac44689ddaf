"""`fishmj log import`: clocks of two units or two recordings, and counts of frames that begin again."""

import lab_files
import numpy as np
import pytest
from lab_files import WAVE, N, near, only


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def moves(t):
    return {"x_m": 0.1 * t, "y_m": 0.02 * np.sin(t), "yaw_deg": 6 * np.sin(6 * t)}


def test_tables_that_share_little_of_the_longer_one_are_refused(tmp_path, bring):
    """A camera of 10 s beside motors of 299 s: clocks in two units, or the wrong file; as dates they are where they are."""
    motors, camera = 0.02 * np.arange(14950), 0.02 * np.arange(500)
    for name, zero in (("swim", 0.0), ("dated", 1.7e9)):
        lab_files.write(tmp_path / name / "motors.csv", {"time_s": zero + motors, "servo1_deg": 20 * np.sin(6 * motors)})
        lab_files.write(tmp_path / name / "camera.csv", {"time_s": zero + 3 + camera, **moves(camera)})
    code, _, err = bring(tmp_path / "swim", "--yes")
    assert code == 2 and "swim: pose spans 9.98 s, cmd 298.98 s, of which they share 9.98 s, 3.3 % of the longer" in err
    assert "[tables.pose], or --plausible overlap=0.02" in err
    assert bring(tmp_path / "swim", "--yes", "--plausible", "overlap=0.02", out=tmp_path / "a")[0] == 0
    assert bring(tmp_path / "swim", "--write-map", tmp_path / "map.toml", out=None)[0] == 0
    said = (tmp_path / "map.toml").read_text().replace("[tables.pose]", "[tables.pose]\noffset = 0")
    (tmp_path / "map.toml").write_text(said)
    assert bring(tmp_path / "swim", "--columns", tmp_path / "map.toml", out=tmp_path / "b")[0] == 0
    assert bring(tmp_path / "dated", "--yes", out=tmp_path / "c")[0] == 0


def by_frames(tmp_path, frames, **more):
    """A camera's file whose stamps are a count of frames at 50 Hz, and the map that says so."""
    unit = ', unit = "deg"'
    columns = "".join(f'columns.{c.split("_")[0]} = {{ column = "{c}"{unit * c.endswith("deg")} }}\n' for c in moves(0))
    (tmp_path / "map.toml").write_text(f'[tables.pose]\nt = {{ column = "frame", scale = 0.02 }}\n{columns}')
    path = lab_files.write(tmp_path / "in" / "camera.csv", {"frame": frames, **moves(0.02 * np.arange(len(frames))), **more})
    return path, "--columns", tmp_path / "map.toml"


@pytest.mark.parametrize(
    ("row", "back", "dropped"), [(6, 6, []), (3994, 30, []), (28, 30, [5, 33]), (1999, 30, [1993, 2006]), (3276, 3276, [])]
)
def test_a_count_of_frames_that_begins_again_is_refused(tmp_path, bring, row, back, dropped):
    """Also near an end, beside frames that were dropped, and where 16 bits of milliseconds would turn."""
    frames = np.delete(np.arange(4000.0), dropped)
    frames[row:] -= min(back, frames[row])
    code, _, err = bring(*by_frames(tmp_path, frames))
    assert code == 2 and f"camera.csv:{row + 2}:frame: time goes back" in err and "plit the file there" in err


def test_frames_out_of_order_or_sent_twice_are_strays(tmp_path, bring):
    frames = np.arange(1000.0)
    frames[[400, 401]] = frames[[401, 400]]
    path, *said = by_frames(tmp_path, frames)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *lines[-4:]]) + "\n")  # the last buffer, written again
    code, _, err = bring(path, *said)
    assert code == 0, err
    assert len(only(tmp_path / "set").tables["pose"]["t"]) == 999


def test_a_count_of_frames_that_another_clock_contradicts_is_noted(tmp_path, bring):
    """Frames that are numbered on after a pause of 2 s; and a count that begins again is named where no time is found."""
    frames = np.arange(1000.0)
    t = 0.02 * frames + 2.0 * (frames >= 500)
    assert bring(*by_frames(tmp_path, frames, time_s=t))[0] == 0
    assert "'frame' times 0.02 s parts by 2 s from 'time_s'" in " ".join(only(tmp_path / "set").meta["notes"])
    assert bring(*by_frames(tmp_path, frames, time_s=0.02 * frames + 3), out=tmp_path / "same")[0] == 0
    assert "parts by" not in " ".join(only(tmp_path / "same").meta["notes"])
    code, _, err = bring(by_frames(tmp_path, frames % 500)[0], "--yes", out=tmp_path / "again")
    assert code == 2 and "'frame' counts the rows, but begins again" in err


UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *(("ms_since_boot", "ms"), ("time_since_boot_ms", "ms"), ("uptime_us", "us"), ("millis", "ms"), ("msSinceBoot", "ms")),
        *(("Milliseconds since start", "ms"), ("Time (us since power-on)", "us"), ("seconds_elapsed", "s"), ("t_us_mcu", "us")),
        *(("time_since_start", "s"), ("esp_millis", "ms"), ("micros_teensy", "us"), ("monotonic_ns", "ns"), ("ms_of_day", "ms")),
    ],
)
def test_a_time_whose_name_has_its_unit_is_read_unasked(tmp_path, bring, name, unit):
    """In front, at the end or between: of a clock at 40 rows a second that has long been on."""
    t = 130.0 + 0.025 * N
    lab_files.write(tmp_path / "a.csv", {name: t * UNITS[unit], "servo1_deg": 20 * WAVE})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 0, err
    near(np.diff(only(tmp_path / "set").tables["cmd"]["t"]), 0.025 + 0 * N[1:])


@pytest.mark.parametrize(
    ("column", "asked"),
    [
        ({"loop_ms": 20.0 * N}, "is it this one"),  # rises, but is called a span
        ({"ms_since_last_frame": 20.0 * N}, "is it this one"),
        ({"mcu_ms": 20.0 * N, "host_ms": 20.0 * N + 3 * WAVE}, "host_ms"),  # which?
        ({"age_ms": 20.0 + 3 * WAVE}, "no column of time"),  # falls
    ],
)
def test_a_span_of_time_and_one_of_two_clocks_stay_a_question(tmp_path, bring, column, asked):
    lab_files.write(tmp_path / "a.csv", {**column, "servo1_deg": 20 * WAVE})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and asked in err, err


def test_a_time_of_day_beside_dates_is_of_their_day(tmp_path, bring):
    """Both began at 0, whatever lay between their first rows."""
    t = 0.02 * N
    folder = tmp_path / "swim"
    folder.mkdir()
    rows = ["time,servo1_deg", *(f"23:59:{58 + s:06.3f},{20 * w:.4f}" if s < 2 else f"00:00:{s - 2:06.3f},{20 * w:.4f}"
            for s, w in zip(t, WAVE, strict=True))]  # fmt: skip
    (folder / "cmd.csv").write_text("\n".join(rows) + "\n")
    rows = ["time,x_m,y_m,yaw_rad", *(f"2024-04-08T23:59:{58.5 + s:06.3f}Z,{0.1 * s:.4f},0,0" for s in t if s < 1.5)]
    (folder / "camera.csv").write_text("\n".join(rows) + "\n")
    assert bring(folder, "--yes")[0] == 0
    trial = only(tmp_path / "set")
    assert trial.table("cmd")["t"][0] == 0 and trial.table("pose")["t"][0] == pytest.approx(0.5)
    assert "cmd: its times of day are taken for those of 2024-04-08" in trial.meta["notes"]


def test_stamps_with_and_without_a_date_are_two_clocks(tmp_path, bring):
    t = 0.02 * N
    lab_files.write(tmp_path / "swim" / "cmd.csv", {"time_s": 1.7e9 + t, "servo1_deg": 20 * WAVE})
    lab_files.write(tmp_path / "swim" / "camera.csv", {"time_s": t, **moves(t)})
    told = "pose: stamps without a date beside stamps with one"
    assert bring(tmp_path / "swim", "--yes", out=tmp_path / "a")[0] == 0
    assert any(told in note for note in only(tmp_path / "a").meta["notes"])
    assert bring(tmp_path / "swim", "--write-map", tmp_path / "map.toml", out=None)[0] == 0
    said = (tmp_path / "map.toml").read_text().replace("[tables.pose]", "[tables.pose]\noffset = 0.5")
    (tmp_path / "map.toml").write_text(said)
    assert bring(tmp_path / "swim", "--columns", tmp_path / "map.toml", out=tmp_path / "b")[0] == 0
    assert not any(told in note for note in only(tmp_path / "b").meta["notes"])


@pytest.mark.parametrize("unit", ["sec", "min"])
def test_durations_of_matlab_are_stamps(tmp_path, bring, unit):
    size = {"sec": 1.0, "min": 60.0}[unit]
    rows = ["Time,servo1_deg", *(f"{0.02 * k / size:.7g} {unit},{20 * w:.4f}" for k, w in enumerate(WAVE))]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0
    near(only(tmp_path / "set").table("cmd")["t"], 0.02 * N)


def test_arrays_of_matlab_and_dates_of_numpy_are_read(tmp_path, bring):
    """loadmat gives columns (T, 1), rows (1, T), and joints (J, T) as they were saved."""
    t, joints = 0.02 * N, np.radians(20) * np.stack([WAVE, 0.5 * WAVE])
    dates = np.datetime64("2024-04-08T17:42:36") + (1e3 * t).round().astype("timedelta64[ms]")
    for name, stamps in (("column", t[:, None]), ("row", t[None]), ("date", dates), ("duration", dates - dates[0])):
        np.savez(tmp_path / f"{name}.npz", time=stamps, cmd=joints, x=t[:, None], y=0 * t, yaw=0 * t[None], gain=np.ones((1, 3)))
        assert bring(tmp_path / f"{name}.npz", "--yes", out=tmp_path / name)[0] == 0
        trial = only(tmp_path / name)
        near(trial.table("cmd")["t"], t), near(trial.table("cmd")["c2"], joints[1]), near(trial.table("pose")["x"], t)


def test_a_duration_of_a_parquet_file_is_no_time_of_day(tmp_path, bring):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"time": pa.array((20 * N).astype("int64"), pa.duration("ms")), "servo1_deg": 20 * WAVE}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    assert bring(tmp_path / "a.parquet", "--yes")[0] == 0
    assert not any("date" in note for note in only(tmp_path / "set").meta.get("notes", []))
