"""`fishmj log import`: files of two meanings are asked or refused, never read as one of them in silence."""

import shlex
import shutil

import lab_files
import numpy as np
import pytest
from lab_files import N, near, only

from fishmj import log
from fishmj.base.errors import LogError
from fishmj.log import physical_checks
from fishmj.log.importers import cells, joint_switches

T = 0.02 * N
SWING = [0.5 * np.sin(6 * T - k) for k in range(3)]  # rad


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def servos(scale=1.0, zero=0.0, unit=""):
    return {f"servo{k + 1}{unit}": zero + scale * q for k, q in enumerate(SWING)}


@pytest.mark.parametrize(
    ("column", "monday", "tuesday", "told"),
    [
        ("servo1", np.degrees(SWING[0]), SWING[0], "tue.csv alone reads as rad"),
        ("voltage", 7.4 + 0 * T, 7400 + T, "mon.csv alone reads as V"),
        ("heading", 100 + np.degrees(SWING[0]), 1 + SWING[0], "tue.csv alone reads as rad"),
    ],
)
def test_one_file_of_several_in_another_unit_is_asked(tmp_path, bring, column, monday, tuesday, told):
    place = {"x": 0.1 * T, "y": 0.0 * T} if column == "heading" else {}
    for name, values in (("mon", monday), ("tue", tuesday)):
        lab_files.write(tmp_path / "in" / f"{name}.csv", {"time": T, **place, column: values})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and told in err and f"--set {column}=" in err


def test_servo_pulses_and_roll_are_left_out_with_the_reason(tmp_path, bring):
    """Numbered pulses are asked about, as joints; a map makes angles of them."""
    place, pulses = (
        {"x": 0.1 * T, "y": 0.0 * T, "yaw": 0.0 * T},
        {f"pulse{k + 1}_us": 1500 + 200 * q for k, q in enumerate(SWING)},
    )
    lab_files.write(tmp_path / "a.csv", {"time": T, **place, "pulse_us": 1500 + T, "roll_deg": 2 * SWING[0], "rx_deg": SWING[1]})
    code, out, err = bring(tmp_path / "a.csv", "--yes")
    notes = " ".join(only(tmp_path / "set").meta["notes"])
    assert code == 0 and "pulse_us: pulses of a servo, no angles: map them with unit = 'deg', scale" in notes, err
    assert "roll_deg: a roll or pitch; the schema's fish swims in the plane" in notes and out.count("a roll or pitch") >= 2
    lab_files.write(tmp_path / "b.csv", {"time": T, **place, **pulses})
    code, _, err = bring(tmp_path / "b.csv", "--yes", out=tmp_path / "asked")
    assert code == 2 and "pulse2_us: may be joint 2 of 3" in err and "zero = the us of the straight joint" in err
    columns = "".join(
        f'columns.c{k} = {{ column = "pulse{k}_us", unit = "deg", scale = 0.09, zero = 1500 }}\n' for k in (1, 2, 3)
    )
    (tmp_path / "map.toml").write_text(f'[meta]\nrobot = "swift"\n[tables.cmd]\nt = "time"\n{columns}')
    assert bring(tmp_path / "b.csv", "--columns", tmp_path / "map.toml", out=tmp_path / "mapped")[0] == 0
    near(only(tmp_path / "mapped").table("cmd")["c2"], np.radians(18 * SWING[1]))


def test_numbered_columns_of_an_unknown_name_may_be_the_joints(tmp_path, bring):
    """They are asked about where the log holds no joint; left out where it does, or where they hold no motion."""
    place = {"x": 0.1 * T, "y": 0.0 * T, "yaw": 0.0 * T}
    motors = {f"m{k + 1}": 20 * q for k, q in enumerate(SWING)}
    lab_files.write(tmp_path / "bare" / "a.csv", {"time": T, **place, **motors})
    code, _, err = bring(tmp_path / "bare", "--yes")
    assert code == 2 and "m2: may be joint 2 of 3" in err and "--set m2=cmd.c2:rad or cmd.c2:deg or joint.j2" in err
    lab_files.write(tmp_path / "array" / "a.csv", {"time": T, **place, "ch[0]": 20 * SWING[0], "ch[1]": 20 * SWING[1]})
    code, _, err = bring(tmp_path / "array", "--yes")
    assert code == 2 and "ch[1]: may be joint 2 of 2" in err
    for name, more in (("known", {**motors, **servos(unit="_rad")}), ("still", {key: 0 * T for key in motors})):
        lab_files.write(tmp_path / name / "a.csv", {"time": T, **place, **more})
        code, out, err = bring(tmp_path / name, "--yes")
        assert code == 0 and "m2" in out and "says nothing" in out, err
        shutil.rmtree(tmp_path / "set")


def test_time_in_ms_in_one_file_and_in_s_in_another_is_asked(tmp_path, bring):
    for name, scale in (("mon", 1.0), ("tue", 1e3)):
        lab_files.write(tmp_path / "in" / f"{name}.csv", {"time": scale * T, **servos(unit="_rad")})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and "tue.csv alone reads as ms" in err


@pytest.mark.parametrize(
    ("clocks", "told"),
    [
        ({"time": T, "stamp_ms": 1.7e12 + 1.01e3 * T}, "2 columns of time, up to 0.02 s apart"),
        ({"time_s": T, "stamp": 1.7e9 + T + 0.008 * np.sin(7 * T)}, "2 columns of time, up to 0.016 s apart"),
        ({"time_ms": 1e3 * T, "camera_time": T + 0.05}, "2 columns of time, one of the camera"),
    ],
)
def test_two_clocks_in_one_table_are_asked(tmp_path, bring, clocks, told):
    place = {"x_m": 0.1 * T, "y_m": 0.0 * T, "yaw_deg": 9 * np.sin(6 * T)}
    lab_files.write(tmp_path / "in" / "a.csv", {**clocks, **servos(unit="_rad"), **place})
    code, _, err = bring(tmp_path / "in", "--yes")
    one, other = clocks
    assert code == 2 and told in err and f"--set {one}=t:" in err and f"--set {other}=t:" in err and "COLUMN=skip" in err
    assert bring(tmp_path / "in", "--yes", "--set", f"{one}=t")[0] == 0


@pytest.mark.parametrize(
    "clocks",
    [
        {"time_s": T, "stamp": 1.7e9 + np.round(T, 3)},
        {"time_ms": np.round(1e3 * T), "stamp": 1.7e9 + np.floor(T)},  # whole seconds
        {"time_s": T + 0.003 * np.sin(T), "tick": N},
        {"time_us": 1e6 * T, "t": T},
    ],
)
def test_one_clock_in_two_columns_is_read_unasked(tmp_path, bring, clocks):
    lab_files.write(tmp_path / "in" / "a.csv", {**clocks, **servos(unit="_rad")})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 0, err


def test_a_file_in_which_the_joint_rests_does_not_raise_the_question(tmp_path, bring):
    noise = 0.3 * np.random.default_rng(1).standard_normal(len(N))  # deg
    for name, values in (("mon", np.degrees(SWING[0])), ("tue", noise)):
        lab_files.write(tmp_path / "in" / f"{name}.csv", {"time": T, "meas1": values})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 0, err
    near(log.read_trial(tmp_path / "set" / "tue").tables["joint"]["j1"], np.radians(noise), 1e-5)


def of_video(path, fps, every=1, mark=".", digits=2, seconds=10):
    """A log whose stamps count frames within a second."""
    frames = np.arange(7, seconds * fps, every)
    rows = [f"10:00:{f // fps:02d}{mark}{f % fps:0{digits}d},{20 * np.sin(6 * f / fps):.4f}" for f in frames]
    path.write_text("\n".join(["time,servo1_deg", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("fps", "every", "digits", "span"),
    [
        (30, 1, 2, ".00 to .29"),
        (25, 2, 2, ".00 to .24"),
        (60, 1, 2, ".00 to .59"),
        (24, 6, 2, ".01 to .19"),
        (240, 3, 3, ".001 to .238"),
    ],
)
def test_stamps_that_count_frames_of_a_video_are_asked(tmp_path, bring, fps, every, digits, span):
    path = of_video(tmp_path / "log.csv", fps, every, digits=digits)
    code, _, err = bring(path, "--yes")
    assert code == 2 and f"count from {span}" in err and "s + frame / frames a second" in err and "--set time=t:date" in err
    code, _, err = bring(path, "--yes", "--set", "time=t")
    assert code == 2 and "frames of a video" in err
    assert bring(path, "--yes", "--set", "time=t:date")[0] == 0


@pytest.mark.parametrize("mark", [";", ":"])
def test_time_codes_are_named_where_no_time_is_found(tmp_path, bring, mark):
    path = tmp_path / "log.csv"
    of_video(path, 30, mark=mark)
    path.write_text(path.read_text().replace(",", "\t"))
    code, _, err = bring(path, "--yes")
    assert code == 2 and f"'time' holds frames, 10:00:00{mark}07: write seconds" in err


@pytest.mark.parametrize("rate", [1, 2, 2.5, 7, 10, 29.97, 30, 50, 100])
@pytest.mark.parametrize("late", [0.0, 0.003])
def test_decimal_seconds_are_not_taken_for_frames(rate, late):
    t = 36005.07 + np.arange(400) / rate + np.random.default_rng(1).uniform(0, late / rate, 400)
    for digits in (2, 3):
        assert not cells.frame_doubt(np.round(t, digits)) and not cells.frame_doubt(1.7e9 + np.round(t, digits))


@pytest.mark.parametrize("names", ["time_s,servo3_deg,servo2_deg,servo1_deg", "t,x,y,yaw"])
def test_other_names_in_the_middle_of_a_file_are_refused(tmp_path, bring, names):
    path = lab_files.write(tmp_path / "log.csv", {"time_s": T, **servos(20, unit="_deg")})
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:51], names, *lines[51:]]) + "\n")
    code, _, err = bring(path, "--yes")
    assert code == 2 and f"{path}:52:1: other names of columns in the middle" in err


def swims(rows=400, rate=50.0):
    """Angles (3, rows) rad of a gait with the noise of its encoders."""
    t = np.arange(rows) / rate
    noise = 0.003 * np.random.default_rng(2).standard_normal((3, rows))
    return t, np.stack([0.4 * np.sin(6 * t - k) for k in range(3)]) + noise


def exchanged(values, row, order):
    """A copy whose columns stand in another order from a row on."""
    out = values.copy()
    out[:, row:] = values[list(order), row:]
    return out


@pytest.mark.parametrize("name", ["servo{}_deg", "meas{}_deg"])
@pytest.mark.parametrize(("order", "told"), [((1, 0, 2), (1, 2)), ((2, 1, 0), (1, 3)), ((1, 2, 0), (1, 2, 3))])
def test_joints_that_change_columns_in_the_middle_are_refused(tmp_path, bring, name, order, told):
    t, values = swims()
    values = np.degrees(exchanged(values, 203, order))
    if name.startswith("meas"):
        values[2, 300] = -100.0  # a failed read
    path = lab_files.write(tmp_path / "log.csv", {"time_s": t, **{name.format(k + 1): values[k] for k in range(3)}})
    code, _, err = bring(path, "--yes")
    letter = "c" if name.startswith("servo") else "j"
    assert code == 2 and f"log.csv:205:{name.format(1)}:" in err, err
    assert f"{', '.join(f'{letter}{k}' for k in told)} jump at this row" in err and "exchanged from here on? Split" in err


def test_joints_that_jump_or_change_their_gait_are_not_taken_for_exchanged():
    t, values = swims()
    held = np.where(t < 4, 0.3, -0.3)
    gaits = {
        "as it is": values,
        "one jump": values + np.where(t < 4, 0.0, 0.4) * np.array([[1], [0], [0]]),
        "another gait": np.where(t < 4, values, 0.5 * values[::-1] + 0.3),
        "two poses": np.stack([held, -held, 0 * t]) + 0.1 * (values - swims()[1]),
        "square": np.stack([np.sign(np.sin(3 * t)), -np.sign(np.sin(3 * t)), 0 * t]),
        "alternate": np.stack([values[0], -values[0], values[0]]),
    }
    for told, q in gaits.items():
        assert joint_switches.find(t, {f"j{k + 1}": q[k] for k in range(3)}) is None, told


def test_two_fish_with_the_same_stamps_are_refused_and_repeated_rows_are_not(tmp_path, bring):
    twice = np.repeat(T, 2)
    fish = np.ravel([0.1 * T, 2 - 0.1 * T], "F")
    columns = {"time_s": twice, "sensor": np.tile([1.0, 2.0], len(N)), "x_m": fish, "y_m": 0 * fish, "yaw_deg": 0 * fish}
    code, _, err = bring(lab_files.write(tmp_path / "log.csv", columns), "--yes")
    assert code == 2 and "100 of 200 rows have the stamp of the row before" in err
    columns["x_m"] = 0.05 * 0.02 * np.arange(2 * len(N))  # one fish, stamps coarser than the rate
    assert bring(lab_files.write(tmp_path / "coarse.csv", columns), "--yes")[0] == 0


@pytest.mark.parametrize("style", ["({})", "{}-", "{} deg"])
def test_numbers_in_a_notation_that_is_not_read_are_asked_and_not_dropped(tmp_path, bring, style):
    rows = [
        f"{t:.2f},{abs(v):.3f}" if v >= 0 else f"{t:.2f},{style.format(f'{-v:.3f}')}"
        for t, v in zip(T, 20 * SWING[1], strict=True)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time_s,servo1_deg", *rows]) + "\n")
    code, _, err = bring(path, "--yes")
    assert code == 2 and "are no plain numbers" in err and "--set servo1_deg=cmd.c1:deg" in err


@pytest.mark.parametrize(("dash", "encoding"), [("\u2013", "utf-8"), ("\u2013", "cp1252")])
def test_an_en_dash_is_a_minus(tmp_path, bring, dash, encoding):
    rows = [f"{t:.2f},{20 * v:.3f}".replace("-", dash) for t, v in zip(T, SWING[1], strict=True)]
    path = tmp_path / "log.csv"
    path.write_bytes(("\n".join(["time_s,servo1_deg", *rows]) + "\n").encode(encoding))
    assert bring(path, "--yes")[0] == 0
    near(only(tmp_path / "set").tables["cmd"]["c1"], np.radians(20 * SWING[1]), 1e-4)


def test_counts_of_a_servo_without_their_zero_are_refused(tmp_path, bring):
    path = lab_files.write(tmp_path / "log.csv", {"time_s": T, "servo1": np.round(500 + 200 * SWING[0])})
    code, _, err = bring(path, "--yes", "--set", "servo1=cmd.c1:deg*0.24")
    assert code == 2 and "never straight" in err and "zero = the reading of the straight joint" in err
    assert bring(path, "--yes", "--set", "servo1=cmd.c1:deg*0.24", "--plausible", "angle=4")[0] == 0


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({"cmd1_norm": SWING[0]}, "cmd1_norm=cmd.c1:rad*SCALE"),
        ({"battery_voltage": np.round(74 + 0.4 * SWING[0])}, "tenths of V (V*0.1)"),
        ({"voltage_battery": 7400 + T, "current_battery": np.round(60 + 20 * SWING[0])}, "hundredths of A (A*0.01)"),
        ({"x": 62 + T, "y": 40 + T, "yaw_deg": 45 + 0 * T}, "but the first row is at 62"),
    ],
)
def test_values_that_a_robot_has_in_two_units_are_asked(tmp_path, bring, columns, told):
    code, _, err = bring(lab_files.write(tmp_path / "log.csv", {"time_s": T, **columns}), "--yes")
    assert code == 2 and told in err


def pose(held=False, turned=0.0):
    t = 0.02 * np.arange(400)
    x = 0.2 * t + 0.002 * np.sin(9 * t)
    if held:
        x[100:160] = x[100]
    return log.Trial({}, {"pose": {"t": t, "x": x, "y": 0 * t, "yaw": turned + (0.1 * np.sin(6 * t) if not held else 0 * t)}})


def test_positions_without_a_heading_are_noted_as_no_pose(tmp_path, bring):
    lab_files.write(tmp_path / "in" / "a.csv", {"time_s": T, **servos(unit="_rad"), "x_m": 0.1 * T, "y_m": 0.0 * T})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 0, err
    assert any("are points and no pose" in note for note in only(tmp_path / "set").meta["notes"])


def test_a_tracker_that_stops_or_turns_the_fish_round_is_noted_without_joints():
    assert any("repeat their values" in f.text for f in physical_checks.examine(pose(held=True)))
    assert any("off its heading" in f.text for f in physical_checks.examine(pose(turned=np.pi)))
    assert not list(physical_checks.examine(pose()))


@pytest.mark.parametrize("table", ["pose", "cmd", "joint", "imu"])
def test_a_trial_in_memory_with_an_empty_table_is_one_clear_error(table):
    columns = {"pose": ("x", "y", "yaw"), "cmd": ("c1",), "joint": ("j1",), "imu": ("wz",)}[table]
    empty = {name: np.zeros(0) for name in ("t", *columns)}
    for made in ({}, empty):
        with pytest.raises(LogError, match=f"table '{table}' has no rows; leave an empty table out of the trial"):
            physical_checks.examine(log.Trial({}, {**pose().tables, "joint": {"t": T, "j1": T}, table: made}))


@pytest.mark.parametrize("rate", [10, 30])
def test_of_a_camera_slower_than_its_log_each_value_is_read_once(tmp_path, bring, rate):
    t = 0.02 * np.arange(500)
    swim = lambda t: {"x_m": 0.1 * t, "y_m": 0.05 * np.cos(2 * t), "yaw_deg": 20 * np.sin(4 * t)}
    lab_files.write(tmp_path / "in" / "swim.csv", {"time_s": t, **swim(np.floor(t * rate + 1e-9) / rate)})
    code, out, err = bring(tmp_path / "in", "--yes")
    assert code == 0 and f"{rate} Hz written at 50 Hz" in out + err
    pose = only(tmp_path / "set").tables["pose"]
    assert len(pose["t"]) == 10 * rate
    late = np.radians(80) * 0.02  # a row of the log, at the fastest turn
    near(pose["yaw"], np.radians(swim(pose["t"])["yaw_deg"]), late)


@pytest.mark.parametrize("between", [[0.033, 0.033, 0.2], [0.02, 0.04, 0.06], [0.04, 0.16]])
def test_of_a_camera_whose_frames_come_irregularly_each_value_is_read_once(tmp_path, bring, between):
    t = 0.02 * np.arange(500)
    frames = np.r_[0, np.cumsum(np.random.default_rng(2).choice(between, 400))]
    shown = np.searchsorted(frames, t, side="right") - 1  # the frame that a row repeats
    swim = lambda t: {"x_m": 0.1 * t, "y_m": 0.05 * np.cos(2 * t), "yaw_deg": 20 * np.sin(4 * t)}
    lab_files.write(tmp_path / "in" / "swim.csv", {"time_s": t, **swim(frames[shown])})
    code, out, err = bring(tmp_path / "in", "--yes")
    assert code == 0 and "its first row is kept" in out + err
    near(only(tmp_path / "set").tables["pose"]["t"], t[np.unique(shown, return_index=True)[1]])


@pytest.mark.parametrize("rests", [False, True])
def test_coarse_numbers_of_a_slow_fish_and_rests_keep_every_row(tmp_path, bring, rests):
    t = 0.02 * np.arange(500)
    slow = {"x_m": np.round(0.02 * t, 3), "y_m": np.round(0.03 * np.sin(t), 3), "yaw_deg": np.round(3 * np.sin(0.7 * t))}
    if rests:  # half of each two seconds
        swum = np.minimum(t % 2, 1) + t // 2
        slow = {"x_m": 0.02 * swum, "y_m": 0.03 * np.sin(swum), "yaw_deg": 9 * np.sin(7 * swum)}
    lab_files.write(tmp_path / "in" / "swim.csv", {"time_s": t, **slow})
    code, out, err = bring(tmp_path / "in", "--yes")
    assert code == 0 and "written at" not in out + err
    assert len(only(tmp_path / "set").tables["pose"]["t"]) == len(t)


def test_an_angle_beside_x_and_y_may_be_the_heading(tmp_path, bring):
    """It is no joint unasked: neither beside one command of another file, nor in a log without commands."""
    turn = {"time": T, "x_mm": 100 * T, "y_mm": 3 * np.sin(T), "angle_deg": 57 * SWING[0]}
    lab_files.write(tmp_path / "one" / "tracker.csv", turn)
    lab_files.write(tmp_path / "one" / "servo.csv", {"time": T, "goal_deg": 20 * SWING[0]})
    lab_files.write(tmp_path / "alone" / "tracker.csv", turn)
    for folder in ("one", "alone"):
        code, _, err = bring(tmp_path / folder, "--yes")
        assert code == 2 and "the heading, or a joint's?" in err and "--set angle_deg=pose.yaw:deg or joint.j1:deg" in err
    assert bring(tmp_path / "one", "--yes", "--set", "angle_deg=pose.yaw:deg")[0] == 0
    near(only(tmp_path / "set").table("pose")["yaw"], np.radians(57 * SWING[0]))


@pytest.mark.parametrize("part", ["nose", "tail", "peduncle"])
def test_a_point_at_an_end_of_the_fish_is_not_its_pose_unasked(tmp_path, bring, part):
    point = {"time": T, f"{part}_x_mm": 100 * T, f"{part}_y_mm": 3 * np.sin(T), "heading_deg": 57 * SWING[0]}
    lab_files.write(tmp_path / "a.csv", point)
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and f"the {part}; a pose is of the straight fish's centre of mass" in err
    said = [word for axis in "xy" for word in ("--set", f"{part}_{axis}_mm=pose.{axis}:mm")]
    assert bring(tmp_path / "a.csv", "--yes", *said)[0] == 0


@pytest.mark.parametrize(
    "slip", [{"x_px": "px*0.00125", "y_px": "px*0.0125"}, {"x_mm": "cm"}, {"x_mm": "mm*0.5", "y_mm": "mm"}], ids=str
)
def test_one_camera_has_one_scale(tmp_path, bring, slip):
    unit = next(iter(slip)).removeprefix("x_")
    place = {f"x_{unit}": 100 * T, f"y_{unit}": 3 * np.sin(T), "heading_deg": 57 * SWING[0]}
    lab_files.write(tmp_path / "a.csv", {"time": T, **place})
    said = [word for name, what in slip.items() for word in ("--set", f"{name}=pose.{name[0]}:{what}")]
    code, _, err = bring(tmp_path / "a.csv", "--yes", *said)
    assert code == 2 and "expected one scale for x and y" in err and f"'x_{unit}'" in err


def test_units_that_the_header_states_may_differ(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", {"time": T, "x_mm": 100 * T, "y_cm": 3 * np.sin(T), "heading_deg": 57 * SWING[0]})
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0
    near(only(tmp_path / "set").table("pose")["y"], 0.03 * np.sin(T))


def test_identities_of_servos_are_no_numbers_of_joints(tmp_path, bring):
    """Each may be any joint; once one is said, the rest count on from it."""
    lab_files.write(tmp_path / "a.csv", {"time": T, **{f"goal_{11 + k}_deg": 20 * q for k, q in enumerate(SWING[:2])}})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "--set goal_11_deg=cmd.c1:deg or cmd.c2:deg;" in err
    code, _, err = bring(tmp_path / "a.csv", "--yes", "--set", "goal_11_deg=cmd.c1:deg")
    assert code == 2 and "--set goal_12_deg=cmd.c2:deg;" in err
    lab_files.write(tmp_path / "b.csv", {"time": T, "goal1_deg": 20 * SWING[0], "goal2_deg": 20 * SWING[1]})
    code, out, _ = bring(tmp_path / "b.csv", "--yes", "--set", "goal1_deg=cmd.c1:deg", out=tmp_path / "said")
    assert code == 0 and set(only(tmp_path / "said").table("cmd")) == {"t", "c1", "c2"}


@pytest.mark.parametrize("names", [("cmdA", "cmdB"), ("goal_A", "goal_B"), ("servo a", "servo b")], ids=str)
def test_letters_of_two_servos_are_no_units(tmp_path, bring, names):
    """`cmdA` is no current: each is asked which joint it is, also beside a voltage that would make a current of it."""
    lab_files.write(
        tmp_path / "a.csv", {"time": T, **dict(zip(names, (20 * q for q in SWING), strict=False)), "vbat": 11.1 + 0 * T}
    )
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and all(f"--set {shlex.quote(name)}=cmd.c1:deg or cmd.c2:deg" in err for name in names)


def test_a_clock_that_is_set_back_is_no_few_stray_rows(tmp_path, bring):
    """The rows after it are all late by so much; 40 of 5000 were left out, and the joints went on a beat later."""
    t = 0.02 * np.arange(5000)
    set_back, mixed = np.where(t < 50.0, t, t - 0.8), t.copy()
    mixed[[2000, 2001]] = mixed[[2001, 2000]]
    for name, stamps in (("set", set_back), ("mixed", mixed)):
        lab_files.write(tmp_path / name / "swim.csv", {"time_s": stamps, "servo1_deg": 20 * np.sin(6 * t)})
    code, _, err = bring(tmp_path / "set", "--yes", out=tmp_path / "a")
    assert code == 2 and "the clock was set back by 0.8 s. Split the file there" in err
    assert bring(tmp_path / "mixed", "--yes", out=tmp_path / "b")[0] == 0


@pytest.mark.parametrize(("middle", "told"), [(9.5, "A or mA?"), (42.0, "A or mA?"), (0.8, "")])
def test_a_current_that_a_robot_has_in_two_units_is_asked(tmp_path, bring, middle, told):
    """9.5 mA is a robot at rest, 9.5 A a fast one; whole numbers may be counts."""
    columns = {"time_s": T, **servos(unit="_rad"), "voltage": 7.4 + 0.001 * T, "current": middle * (1 + 0.1 * np.sin(3 * T))}
    code, _, err = bring(lab_files.write(tmp_path / "a.csv", columns), "--yes")
    assert (code, told in err) == (2 if told else 0, True), err
    for said, size in (("A", 1.0), ("mA", 1e-3)):
        if told:
            assert "--set current=power.I:A or power.I:mA" in err
            assert bring(tmp_path / "a.csv", "--yes", "--set", f"current=power.I:{said}", out=tmp_path / said)[0] == 0
            near(only(tmp_path / said).table("power")["I"], size * columns["current"], 1e-5)
    columns["current"] = np.round(3 + np.sin(3 * T))
    code, _, err = bring(lab_files.write(tmp_path / "b.csv", columns), "--yes", out=tmp_path / "counts")
    assert code == 2 and "whole numbers: A, mA, or counts (A*SCALE)?" in err


@pytest.mark.parametrize("name", ["force_run.csv", "target.csv", "arm_rad.csv"])
def test_a_column_that_says_what_it_is_outweighs_the_name_of_its_file(tmp_path, bring, name):
    place = {"cam_x_mm": 100 * T, "cam_y_mm": 3 * np.sin(T), "cam_heading_deg": 9 * SWING[0]}
    path = lab_files.write(tmp_path / name, {"time_s": T, "meas1_deg": np.degrees(SWING[1]), **place})
    code, _, err = bring(path, "--yes")
    assert code == 0, err
    near(only(tmp_path / "set").table("joint")["j1"], SWING[1])
    near(only(tmp_path / "set").table("pose")["x"], 0.1 * T)


@pytest.mark.parametrize(("swims", "rests", "late"), [(0.7, 0.3, 0.0), (3, 0.45, 0.0), (2, 2, 0.0), (2, 2, 0.3)])
@pytest.mark.parametrize("noise", [0.0, 3e-5])
@pytest.mark.parametrize("joints", [True, False])
def test_a_fish_at_rest_is_no_tracker_that_repeats_its_pose(swims, rests, late, noise, joints):
    """Its pose stays one number, or flickers in its last digit; and for `late` s after its joints have begun to move."""
    t = 0.02 * np.arange(1000)
    way = np.cumsum(np.minimum(t % (swims + rests) / 0.1, 1.0) * (t % (swims + rests) < swims)) * 0.02
    rng, bent, seen = np.random.default_rng(3), np.interp(t + late, t, way), way
    coarse = lambda v, digit: digit * np.round((v + noise * rng.standard_normal(len(v))) / digit)
    place = {"x": coarse(0.1 * seen, 1e-4), "y": coarse(0.02 * np.sin(seen), 1e-4), "yaw": coarse(0.2 * np.sin(6 * seen), 1e-3)}
    tables = {"pose": {"t": t, **place}, "joint": {"t": t, "j1": 0.4 * np.sin(6 * bent), "j2": 0.4 * np.cos(6 * bent)}}
    rest = log.Trial({}, tables if joints else {"pose": tables["pose"]})
    assert not [f.text for f in physical_checks.examine(rest) if "repeat" in f.text]
    lost = rng.random(len(t)) < 0.1
    k = np.maximum.accumulate(np.where(lost, 0, np.arange(len(t))))
    tables["pose"] |= {name: v[k] for name, v in place.items()}
    assert any("repeat the pose of the row before" in f.text for f in physical_checks.examine(rest))


def test_columns_of_a_file_of_commands_are_asked(tmp_path, bring):
    """Beside a file of joints they would be left out, and the log would have no commands. A target's file has a place."""
    lab_files.write(tmp_path / "in" / "commands.csv", {"time": T, **dict(zip(("front", "mid", "aft"), SWING, strict=True))})
    lab_files.write(tmp_path / "in" / "encoders.csv", {"time": T, **{f"joint{k + 1}": 0.9 * q for k, q in enumerate(SWING)}})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and "mid: its file speaks of a command, and the log has none" in err and "--set mid=cmd.c2" in err
