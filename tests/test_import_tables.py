"""Text tables of laboratories, in the layouts and number styles of their programs: read right, asked, or refused. Synthetic."""

import math
import zipfile

import lab_files
import numpy as np
import pytest
from lab_files import WAVE, N, near, only

from fishmj.base.errors import LogError
from fishmj.log.importers.column_map import of_dict
from fishmj.log.importers.delimited import read
from fishmj.log.importers.header import parse, role

T = 0.02 * np.arange(120)
X, Y, YAW = 0.5 - 0.1 * T, -0.4 + 0.17 * T, 2.1 + 0.1 * np.sin(6 * T)


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def german(value, digits=3):
    return f"{value:.{digits}f}".replace(".", ",")


def rows(cells, mark=",", count=120):
    return "".join(mark.join(cells(i)) + "\n" for i in range(count))


def file(tmp_path, text, name="log.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


# ---------------------------------------------------------------------------------------------------------------- layouts
DLC = "scorer,net,net,net,net,net,net\nbodyparts,nose,nose,nose,tail,tail,tail\ncoords,x,y,likelihood,x,y,likelihood\n"
VICON = "Trajectories\n100\n,,Fish:Head,,,Fish:Tail,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
LVM = (
    "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nDate\t2024/04/08\n***End_of_Header***\t\nChannels\t1\t\n"
    "Delta_X\t0,02\t\n***End_of_Header***\t\t\nX_Value\tservo1_deg\tComment\n"
)
LAYOUTS = {
    "deeplabcut": (DLC + rows(lambda i: (f"{i}", "1.5", f"{i}.5", "0.9", "3", "4", "0.8")), {"nose y": np.arange(120) + 0.5}),
    "vicon": (
        VICON + rows(lambda i: (f"{i + 1}", "0", f"{i}.5", "1", "2", "3", "4", "5")),
        {"Fish:Head X": np.arange(120) + 0.5},
    ),
    "labview": (LVM + rows(lambda i: (german(T[i]), german(WAVE[i % 100])), "\t"), {"X_Value": T}),
    "tracker": (
        "\tmass A\t\tmass B\t\nt\tx\ty\tx\ty\n" + rows(lambda i: (f"{T[i]:.2E}", "1", "2", "3", "4"), "\t"),
        {"mass B y": 4},
    ),
    "one title": (
        "Masse A\nt;x;y;v_{x}\n" + rows(lambda i: (german(T[i]), german(X[i]), "0", "" if not i else "1,5"), ";"),
        {"t": T},
    ),
    "titles": ("Swim 3\nOperator; K. M.\n\nt (s);a\n" + rows(lambda i: (german(T[i], 2), german(X[i], 1)), ";"), {"t (s)": T}),
    "qualisys": ("FREQUENCY\t50\nDATA_INCLUDED\t3D\nFrame\tTime\n" + rows(lambda i: (f"{i}", f"{T[i]:.5f}"), "\t"), {"Time": T}),
    "serial monitor": (
        "17:42:35.900 -> ready\n17:42:36.000 -> t_ms,a\n" + rows(lambda i: (f"17:42:{36 + T[i]:06.3f} -> {20 * i}", "1")),
        {"t_ms": 1e3 * T, "clock": 63756 + T},
    ),
    "row names": ("t a\n" + rows(lambda i: (f'"{i + 1}"', f"{T[i]:.2f}", "2"), " "), {"t": T, "row": 1 + np.arange(120)}),
    "pandas": (",time_s,a\n" + rows(lambda i: (f"{i}", f"{T[i]}", "2")), {"time_s": T}),
    "sep line": ("sep=;\nt;a;;;\n" + rows(lambda i: (german(T[i], 2), "1", "", "", ""), ";"), {"t": T}),
    "units in brackets": ("Time;X\n[s];[mm]\n" + rows(lambda i: (f"{T[i]:.3f}", "1"), ";"), {"Time": T}),
    "quoted names": (
        '"Zeit in s";"a;b"\n' + rows(lambda i: (f'"{german(T[i], 2)}"', '"1,5"'), ";"),
        {"Zeit in s": T, "a;b": 1.5},
    ),
    "comments": ("t,a\n" + rows(lambda i: (f"{T[i]:.2f}", "1" + "\n# mark, here" * (i % 9 == 0))), {"t": T}),
    "names again": ("t,a\n" + rows(lambda i: (f"{T[i]:.2f}", "1" + "\nt,a" * (i == 60))), {"t": T}),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_found_by_its_rows_of_values(tmp_path, name):
    text, wanted = LAYOUTS[name]
    encoding = {"sep line": "utf-16", "quoted names": "utf-8-sig"}.get(name, "latin-1")
    sheet = read(file(tmp_path, text.replace("\n", "\r\n"), encoding=encoding))
    for column, values in wanted.items():
        near(sheet.columns[column], np.broadcast_to(values, (len(T),))[: len(sheet)], 1e-3)


def motive(up="Y", turned=True, kind="Quaternion"):
    """A rigid body that swims in the plane, as Motive exports it; ten frames are lost."""
    head = "Format Version,1.23,Take Name,swim 3,Export Frame Rate,50.000000,Rotation Type,{},Length Units,{}\n\n".format(
        kind, "Millimeters" if up == "Z" else "Meters"
    )
    parts = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    text = head + "".join(f",,{','.join(row)}\n" for row in (["Rigid Body"] * 8, ["fish"] * 8, ['"7E1A"'] * 8, parts))
    text += "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,\n"
    for i, (s, x, y, h) in enumerate(zip(T, X, Y, YAW if turned else 0 * YAW, strict=True)):
        turn = (0, math.sin(h / 2), 0) if up == "Y" else (0, 0, math.sin(h / 2))
        place = (x, 0.012, -y) if up == "Y" else (1e3 * x, 1e3 * y, 12.0)
        cells = [*(f"{v:.6f}" for v in (*turn, math.cos(h / 2), *place)), "0.0003"] if not 50 <= i < 60 else [""] * 8
        text += f"{i},{s:.6f},{','.join(cells)}\n"
    return text


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_motive_export_becomes_poses_in_the_plane(tmp_path, bring, up):
    code, _, err = bring(file(tmp_path, motive(up), "swim 3.csv"), "--yes")
    assert code == 0, err
    pose, kept = only(tmp_path / "set").tables["pose"], np.r_[0:50, 60:120]
    near(pose["x"], X[kept], 2e-6)
    near(pose["y"], Y[kept], 2e-6)
    near(pose["yaw"], YAW[kept], 1e-5)
    assert any("10 of 120 rows" in note for note in only(tmp_path / "set").meta["notes"])


def test_motive_export_of_euler_angles_is_refused(tmp_path):
    with pytest.raises(LogError, match="export it again with Quaternion"):
        read(file(tmp_path, motive(kind="XYZ").replace(",X,Y,Z,W,X,Y,Z,", ",X,Y,Z,,X,Y,Z,")))


def test_tracker_export_with_decimal_commas_becomes_markers(tmp_path, bring):
    text = LAYOUTS["one title"][0]
    assert bring(file(tmp_path, text, "fisch.txt"), "--yes")[0] == 0
    near(only(tmp_path / "set").tables["markers"]["p1x"], X, 1e-3)


# ----------------------------------------------------------------------------------------------------------------- numbers
@pytest.mark.parametrize(
    ("cell", "beside", "value"),
    [
        *(("1.234,5", "0", 1234.5), ("1'234.5", "0", 1234.5), ("1\u2019234,5", "0", 1234.5), ("1\u202f234,5", "0", 1234.5)),
        *(("1 234,5", "0", 1234.5), ("1\u00a0234", "0", 1234), ("1,5e-3", "0", 0.0015), ("1,5E+02", "0", 150)),
        *(
            ("1,234", "0,5", 1.234),
            ("1,234", "0.5", 1234),
            ("1.234", "0,5", 1234),
            ("1.234", "0.5", 1.234),
            ("1.234", "7", 1.234),
        ),
        *(("1,234,567", "0", 1234567), ("1.234.567", "0", 1234567), ("-1,234", "0,5", -1.234), ("0,123", "0", 0.123)),
        *(("\u22121,5", "0", -1.5), ("980", "1,5", 980), ("12", "0", 12), ("1,234.5", "0", 1234.5)),
    ],
)
def test_a_number_of_one_reading_is_read(tmp_path, cell, beside, value):
    sheet = read(file(tmp_path, "t;a;b\n" + rows(lambda i: (f"{20 * i}", cell, beside), ";", 30)))
    near(sheet.columns["a"], value, 1e-9)


@pytest.mark.parametrize(("cell", "other"), [("1,234", "12"), ("1,234", "0.5;0,5")])
def test_a_number_of_two_readings_is_refused_with_its_place(tmp_path, cell, other):
    names = "t;a;b;c\n" if ";" in other else "t;a;b\n"
    with pytest.raises(LogError, match=r"log.csv:2:a: '1,234' may be 1234 or 1.234.*save the file with decimal points"):
        read(file(tmp_path, names + rows(lambda i: (f"{20 * i}", cell, other), ";", 30)))


def test_a_place_with_thousands_separators_does_not_jump(tmp_path, bring):
    text = "time_s;x_mm;y_mm;yaw_deg\n" + rows(lambda i: (f"{T[i]:.3f}", f"{980 + i:,}", "300", f"{2 + 0.1 * i:.2f}"), ";")
    assert bring(file(tmp_path, text), "--yes")[0] == 0
    near(only(tmp_path / "set").tables["pose"]["x"], 0.98 + 0.001 * np.arange(120))


def test_points_between_thousands_are_refused_where_a_place_would_fall(tmp_path):
    text = "time_ms;x_mm;y_mm\n" + rows(lambda i: (f"{20 * i}", f"{980 + i:,}".replace(",", "."), "300"), ";")
    with pytest.raises(LogError, match=r"log.csv:22:x_mm: '1.000' may be 1 or 1000"):
        read(file(tmp_path, text))
    steps = "time_ms;x_mm;y_mm\n" + rows(lambda i: (f"{20 * i}", "100" if i % 9 else "1.250", "300"), ";")
    near(read(file(tmp_path, steps)).columns["x_mm"][:2], [1.25, 100])


# ------------------------------------------------------------------------------------------------------------------ clocks
@pytest.mark.parametrize(
    "stamp",
    [
        lambda s: f"08.04.2024 17:42:{german(36 + s)}",
        lambda s: f"8/4/2024 5:42:{36 + s:06.3f} PM",
        lambda s: f"25/4/2024 17:42:{36 + s:06.3f}",
        lambda s: f"08-Apr-2024 17:42:{36 + s:06.3f}",
        lambda s: f"2024/04/08 17:42:{36 + s:06.3f}",
        lambda s: f"17:42:{36 + int(s)}:{round(1000 * (s % 1)):03d}",
        lambda s: f"42:{german(36 + s)}",
    ],
)
def test_dates_of_many_countries_are_stamps(tmp_path, bring, stamp):
    text = "stamp;servo1_deg\n" + rows(lambda i: (stamp(T[i]), f"{20 * math.sin(i):.2f}"), ";")
    code, _, err = bring(file(tmp_path, text), "--yes")
    assert code == 0, err
    near(only(tmp_path / "set").tables["cmd"]["t"], T, 1e-5)


def clock(seconds):
    seconds %= 86400
    return f"{int(seconds // 3600):02d}:{int(seconds // 60 % 60):02d}:{seconds % 60:06.3f}"


def half_clock(seconds):
    return clock(seconds % 43200 + (43200 if seconds % 43200 < 3600 else 0))


WRAPS = {
    "midnight": ("time", lambda s: clock(86399 + s), "passes midnight"),
    "twelve": ("time", lambda s: half_clock(43200 + 3599 + s), "without AM or PM"),
    "hour": ("time", lambda s: f"{int((3599 + s) // 60 % 60):02d}:{(59 + s) % 60:06.3f}", "passes the hour"),
    "two days": ("time", lambda s: f"{8 + (s >= 1)}.04.2024 {clock(86399 + s)}", ""),
    "micros": ("t_us", lambda s: str(int(2**32 - 1e6 + 1e6 * s + 0.5) % 2**32), "32 bits of us"),
    "millis": ("t_ms", lambda s: str(int(2**32 - 1e3 + 1e3 * s + 0.5) % 2**32), "32 bits of ms"),
    "signed micros": ("t_us", lambda s: str((int(2**31 - 1e6 + 1e6 * s + 0.5) + 2**31) % 2**32 - 2**31), "32 bits of us"),
    "31 bits": ("t_us", lambda s: str(int(2**31 - 1e6 + 1e6 * s + 0.5) % 2**31), "31 bits of us"),
    "micros in s": ("t_s", lambda s: f"{(2**32 / 1e6 - 1 + s) % (2**32 / 1e6):.6f}", "32 bits of us"),
    "16 bits": ("t_ms", lambda s: str(int(2**16 - 1e3 + 1e3 * s + 0.5) % 2**16), "16 bits of ms"),
}


@pytest.mark.parametrize("name", WRAPS)
def test_a_clock_that_begins_again_counts_on_with_a_note(tmp_path, bring, name):
    column, stamp, said = WRAPS[name]
    text = f"{column},servo1_deg\n" + rows(lambda i: (stamp(T[i]), f"{20 * math.sin(i):.2f}"))
    code, _, err = bring(file(tmp_path, text), "--yes")
    assert code == 0, err
    trial = only(tmp_path / "set")
    near(trial.tables["cmd"]["t"] - trial.tables["cmd"]["t"][0], T, 1e-5)
    assert any(said in note and ("log.csv:" in note or not said) for note in trial.meta["notes"])


def test_a_logger_that_began_again_is_split_and_not_sorted(tmp_path, bring):
    text = "t_ms,servo1_deg\n" + rows(lambda i: (str(20 * (i % 60)), f"{20 * math.sin(i):.2f}"))
    code, _, err = bring(file(tmp_path, text), "--yes")
    assert code == 2 and "log.csv:62:t_ms: time goes back" in err and "split the file there" in err and "Sort" not in err


@pytest.mark.parametrize(
    ("form", "every", "said"), [("d", 1, "Mend the file: fractions of a second"), ("03d", 7, "Sort the rows")]
)
def test_rows_are_not_sorted_where_fractions_lack_zeros(tmp_path, bring, form, every, said):
    ms = [20 * (every * i % 120) for i in range(120)]
    text = "time,servo1\n" + rows(lambda i: (f"10:00:{ms[i] // 1000:02}.{ms[i] % 1000:{form}}", f"{WAVE[i % 100]:.2f}"))
    code, _, err = bring(file(tmp_path, text), "--yes", "--set", "time=t:date", "--set", "servo1=cmd.c1:rad")
    assert code == 2 and said in err


def test_times_of_day_on_both_sides_of_midnight_share_a_clock(tmp_path, bring):
    folder = tmp_path / "lab"
    folder.mkdir()
    file(folder, "time,servo1_deg\n" + rows(lambda i: (clock(86399 + T[i]), f"{20 * math.sin(i):.2f}")), "commands.csv")
    text = "time,x_m,y_m,yaw_rad\n" + rows(lambda i: (clock(86400.5 + T[i]), f"{X[i]:.4f}", f"{Y[i]:.4f}", f"{YAW[i]:.4f}"))
    file(folder, text, "camera.csv")
    assert bring(folder, "--yes", "--set", "yaw_rad=pose.yaw:rad")[0] == 0
    tables = only(tmp_path / "set").tables
    near(tables["pose"]["t"][0] - tables["cmd"]["t"][0], 1.5, 1e-6)


MAP = """
[tables.cmd]
t = { column = "time_ms", unit = "ms" }
columns.c1 = { column = "servo1_deg", unit = "deg" }
[tables.pose]
offset = -1.73
t = { column = "Kamerazeit_ms", unit = "ms" }
columns = { x = "x_m", y = "y_m", yaw = "yaw_rad" }
"""


def camera_and_servo(folder):
    """Two files, whose clocks are 1.73 s apart; the camera's time has a German name."""
    folder.mkdir()
    swing = 20 * np.sin(8 * T + 9 * T**2)
    file(folder, "time_ms,servo1_deg\n" + rows(lambda i: (f"{1e3 * T[i]:.0f}", f"{swing[i]:.3f}")), "servo.csv")
    text = "Kamerazeit_ms,x_m,y_m,yaw_rad\n" + rows(
        lambda i: (f"{1e3 * T[i] + 1730:.0f}", f"{X[i]:.4f}", f"{Y[i]:.4f}", f"{YAW[i]:.4f}")
    )
    file(folder, text, "camera.csv")
    return folder


def test_an_offset_of_a_clock_is_stated_in_the_map(tmp_path, bring):
    (tmp_path / "MAP.toml").write_text(MAP)
    assert bring(camera_and_servo(tmp_path / "lab"), "--columns", tmp_path / "MAP.toml")[0] == 0
    trial = only(tmp_path / "set")
    near(trial.tables["pose"]["t"], T, 1e-9)
    near(trial.tables["cmd"]["t"], T, 1e-9)
    assert "-1.73 s" in trial.meta["clock"]["pose"]


@pytest.mark.parametrize("offset", ["nan", "1e9", '"1.73"', "true"])
def test_an_impossible_offset_is_refused_by_its_key(offset):
    import tomllib

    with pytest.raises(LogError, match=r"MAP: tables.pose.offset: "):
        of_dict(tomllib.loads(MAP.replace("-1.73", offset)), "MAP")


# --------------------------------------------------------------------------------------------------------- nothing is lost
@pytest.mark.parametrize(
    "name",
    [
        "Kamerazeit_ms",
        "frametime_us",
        "Messzeit(s)",
        "tiempo_ms",
        "Temps (s)",
        "tijd",
        "Tid [s]",
        "\u6642\u9593",
        "Millisekunden",
        "t/ms",
    ],
)
def test_names_of_time_in_other_languages_are_stamps(name):
    assert role(parse(name), set()).places == ("t",)


@pytest.mark.parametrize("name", ["exposure_time_ms", "loop_time_us", "timeout", "delta_t"])
def test_other_spans_of_time_are_no_stamps(name):
    assert role(parse(name), set()).places == ()


def test_a_camera_file_with_a_german_time_column_is_read(tmp_path, bring):
    assert bring(camera_and_servo(tmp_path / "lab"), "--yes", "--set", "yaw_rad=pose.yaw:rad")[0] == 0
    assert set(only(tmp_path / "set").tables) == {"cmd", "pose"}


@pytest.mark.parametrize(
    ("camera", "asked"),
    [
        ({"kamera_uhr": 20.0 * N, "x_m": WAVE, "y_m": WAVE}, "camera.csv: kamera_uhr: no column of time"),
        ({"frame": 1.0 * N, "x_m": WAVE, "y_m": WAVE}, "--set frame=t:s*SECONDS"),
        ({"frame": N + 3.0 * (N > 40) + (N > 60), "x_m": WAVE, "y_m": WAVE}, "--set frame=t:s*SECONDS"),  # frames were dropped
        ({"x_m": WAVE, "y_m": WAVE}, "camera.csv: x_m: its file has no column of time"),
        ({"time_ms": 20.0 * N, "yaw_deg": 10 * WAVE}, "camera.csv: yaw_deg: table pose also needs x, y"),
        ({"time_ms": 10.0 * N, "servo2_deg": 20 * WAVE}, "camera.csv: servo2_deg: "),
    ],
)
def test_what_would_be_lost_is_asked_with_file_and_column(tmp_path, bring, camera, asked):
    lab_files.write(tmp_path / "lab" / "servo.csv", {"time_ms": 20.0 * N, "servo1_deg": 20 * WAVE})
    lab_files.write(tmp_path / "lab" / "camera.csv", camera)
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and asked in err and not (tmp_path / "set").exists()


def test_a_column_without_a_unit_in_a_row_of_units_keeps_its_name_which_is_quoted_where_it_has_blanks(tmp_path, bring):
    names = ["Zeit", "servo1", "Servo 2", "servo3", "pos1", "pos2", "pos3", "U"]
    units = ["s", "-", "-", "-", "counts", "counts", "counts", "V"]
    counts = [f"{2048 + 200 * v:.0f}" for v in WAVE]
    rows = [[f"{0.02 * k:.2f}", *[counts[k]] * 6, "7.4"] for k in range(len(N))]
    (tmp_path / "a.csv").write_text("\n".join(";".join(row) for row in (names, units, *rows)))
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "--set servo1=cmd.c1:deg" in err and "--set 'Servo 2'=cmd.c2:deg" in err, err


def test_a_map_with_one_missing_column_is_refused_with_its_file(tmp_path, bring):
    (tmp_path / "MAP.toml").write_text(MAP.replace('"servo1_deg"', '"servo1"'))
    code, _, err = bring(camera_and_servo(tmp_path / "lab"), "--columns", tmp_path / "MAP.toml")
    assert code == 2 and "servo.csv: [tables.cmd]: no column 'servo1'; did you mean 'servo1_deg'?" in err
    assert not (tmp_path / "set").exists()


def test_a_file_that_lacks_one_column_of_the_map_is_refused(tmp_path, bring):
    (tmp_path / "MAP.toml").write_text(MAP)
    folder = camera_and_servo(tmp_path / "lab")
    lab_files.write(folder / "zz.csv", {"Kamerazeit_ms": 20.0 * N, "x_m": WAVE, "y_m": WAVE, "yaw": WAVE})
    code, _, err = bring(folder, "--columns", tmp_path / "MAP.toml")
    assert code == 2 and "zz.csv: [tables.pose]: no column 'yaw_rad'; did you mean 'yaw'" in err, err
    (folder / "zz.csv").unlink()
    lab_files.write(folder / "waypoints.csv", {"time_ms": 20.0 * N, "x_m": WAVE})
    assert bring(folder, "--columns", tmp_path / "MAP.toml")[0] == 0


def test_files_without_an_instant_in_common_are_refused_with_the_offset(tmp_path, bring):
    """Local time in one file, UTC in the other."""
    lab_files.write(tmp_path / "lab" / "servo.csv", {"time_s": 0.02 * N, "servo1_deg": 20 * WAVE})
    lab_files.write(tmp_path / "lab" / "camera.csv", {"time_s": 7200 + 0.02 * N, "x_m": WAVE, "y_m": WAVE})
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "(2 h apart: two time zones?). State the offset in a map, [tables.markers] offset = -7200" in err
    assert "removes a true delay too" in err


def test_parts_of_one_table_are_put_together_in_the_order_of_their_numbers(tmp_path, bring):
    for k in range(12):
        part = slice(8 * k, 8 * k + 8)
        lab_files.write(tmp_path / "lab" / f"swim_{k}.csv", {"time_ms": 20.0 * N[part], "servo1_deg": 20 * WAVE[part]})
    code, out, _ = bring(tmp_path / "lab", "--yes", out=tmp_path / "each")
    assert code == 0 and "swim_0.csv to swim_11.csv: each begins where the one before ends; --one-trial makes the 12 files" in out
    code, out, err = bring(tmp_path / "lab", "--yes", "--one-trial")
    assert code == 0 and "swim_0.csv to swim_11.csv: 12 files of the same columns" in out, err
    cmd = only(tmp_path / "set").tables["cmd"]
    near(cmd["t"], 0.02 * N[:96])
    near(cmd["c1"], np.radians(20 * WAVE[:96]))


@pytest.mark.parametrize("name", ["tick_ms", "Ticks [ms]"])
def test_ticks_of_a_microcontroller_are_stamps(tmp_path, bring, name):
    wrapped = (65_000 + 20 * N.astype(int)) % 2**16
    assert bring(lab_files.write(tmp_path / "log.csv", {name: wrapped, "servo1_deg": 20 * WAVE}), "--yes")[0] == 0
    cmd = only(tmp_path / "set").tables["cmd"]
    near(cmd["t"] - cmd["t"][0], 0.02 * N)


@pytest.mark.parametrize(("names", "size"), [(("sec", "nanosec"), 1e9), (("tv_sec", "tv_usec"), 1e6)])
def test_seconds_and_their_parts_in_two_columns_are_one_stamp(tmp_path, bring, names, size):
    t = 99.5 + 0.02 * N
    columns = {names[0]: t // 1, names[1]: np.round(t % 1 * size), "servo1_deg": 20 * WAVE}
    path, written = lab_files.write(tmp_path / "log.csv", columns), tmp_path / "MAP.toml"
    assert bring(path, "--write-map", written, out=None)[0] == 0
    code, _, err = bring(path, "--columns", written)
    assert code == 0, err
    cmd = only(tmp_path / "set").tables["cmd"]
    near(cmd["t"] - cmd["t"][0], 0.02 * N)


@pytest.mark.parametrize("low", [0.0, -180.0])
def test_an_encoder_that_passes_its_seam_is_unwrapped(tmp_path, bring, low):
    true = np.stack([30 * WAVE + 2, 25 * WAVE - 4], 1) + (0 if low == 0 else 180)
    turned = (true - low) % 360 + low
    columns = {"time_ms": 20.0 * N, **{f"meas{k + 1}_deg": turned[:, k] for k in (0, 1)}}
    code, out, err = bring(lab_files.write(tmp_path / "log.csv", columns), "--yes", "--plausible", "angle=4")
    assert code == 0 and "j1 passes the seam of a turn" in out, err
    joint = only(tmp_path / "set").tables["joint"]
    off = np.degrees(np.stack([joint["j1"], joint["j2"]], 1)) - true
    near(off, off[0] * np.ones_like(off), 1e-3)
    assert np.abs(np.sin(np.radians(off[0] / 2))).max() < 1e-5


@pytest.mark.parametrize(("names", "asked"), [(("tail", "nose"), ""), (("mass A", "mass B"), "which point is it")])
def test_points_called_after_parts_of_the_body_count_from_the_nose(tmp_path, bring, names, asked):
    columns = {"t_s": 0.02 * N} | {f"{name} {axis} (m)": WAVE + k for k, name in enumerate(names) for axis in "xy"}
    code, _, err = bring(lab_files.write(tmp_path / "log.csv", columns), "--yes")
    if asked:
        assert code == 2 and asked in err and "markers.p1x:m or markers.p2x:m" in err
        return
    assert code == 0, err
    near(only(tmp_path / "set").tables["markers"]["p1x"], WAVE + 1)


def test_trajectory_of_tum_is_a_pose(tmp_path, bring):
    row = lambda i: (f"{T[i]}", f"{X[i]}", f"{Y[i]}", "0", "0", "0", f"{math.sin(YAW[i] / 2)}", f"{math.cos(YAW[i] / 2)}")
    code, _, err = bring(file(tmp_path, "# timestamp tx ty tz qx qy qz qw\n" + rows(row, " "), "swim.txt"), "--yes")
    assert code == 0, err
    pose = only(tmp_path / "set").tables["pose"]
    near(pose["x"], X)
    near(pose["yaw"], YAW)


def test_one_command_beside_two_joints_is_asked(tmp_path, bring):
    columns = {"time_ms": 20.0 * N, "cmd_deg": 20 * WAVE, "joint1_deg": 19 * WAVE, "joint2_deg": 18 * WAVE}
    path = lab_files.write(tmp_path / "log.csv", columns)
    code, _, err = bring(path, "--yes")
    assert code == 2 and "cmd_deg: 1 of cmd.c1.. beside 2 of joint.j1..: which joint is it?" in err
    assert bring(path, "--yes", "--set", "cmd_deg=cmd.c1:deg")[0] == 0


def test_arrays_of_two_lengths_in_one_archive_are_two_tables(tmp_path, bring):
    t = 0.02 * np.arange(100)
    fast = {"time_ms": 1e3 * t, "servo1_deg": 20 * np.sin(t)}
    slow = {"frame_time_ms": 2e3 * t[:50], "x_m": t[:50], "y_m": t[:50]}
    np.savez(tmp_path / "log.npz", **fast, **slow, rate=np.array(50.0))
    assert bring(tmp_path / "log.npz", "--yes")[0] == 0
    tables = only(tmp_path / "set").tables
    assert len(tables["cmd"]["t"]) == 100 and len(tables["markers"]["t"]) == 50


def test_data_of_other_programs_in_a_folder_are_no_silent_loss(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "a" / "log.csv")
    (tmp_path / "lab" / "a" / "notes.md").write_text("monday")
    code, out, _ = bring(tmp_path / "lab", "--yes")
    assert code == 0 and "passed over: notes.md" in out
    (tmp_path / "lab" / "a" / "camera.xlsx").write_bytes(b"PK\x03\x04")
    code, _, err = bring(tmp_path / "lab", "--yes", out=tmp_path / "two")
    assert code == 2 and "camera.xlsx: " in err and "--skip-bad" in err


@pytest.mark.parametrize("packed", ["camera.csv.gz", "monday.zip"])
def test_packed_tables_are_refused_and_other_archives_passed_over(tmp_path, bring, packed):
    lab_files.one(tmp_path / "lab" / "log.csv")
    with zipfile.ZipFile(tmp_path / "lab" / "drawings.zip", "w") as archive:
        archive.writestr("fish.step", "x")
    assert bring(tmp_path / "lab", "--yes")[0] == 0
    with zipfile.ZipFile(tmp_path / "lab" / packed, "w") as archive:
        archive.writestr("camera.csv", "t,x\n0,1\n")
    code, _, err = bring(tmp_path / "lab", "--yes", out=tmp_path / "two")
    assert code == 2 and f"{packed}: an archive" in err and "unpack it" in err
    (tmp_path / "lab" / "log.csv").unlink()
    code, _, err = bring(tmp_path / "lab", "--yes", out=tmp_path / "three")
    assert code == 2 and f"{packed}: an archive" in err and "nothing to import" not in err


def test_an_angle_called_after_a_part_of_the_body_is_asked(tmp_path, bring):
    columns = {"time_ms": 20.0 * N, "meas1_deg": 20 * WAVE, "meas2_deg": 19 * WAVE, "peduncle_deg": 18 * WAVE}
    code, _, err = bring(lab_files.write(tmp_path / "log.csv", columns), "--yes")
    assert code == 2 and "peduncle_deg" in err and "which joint is it?" in err
