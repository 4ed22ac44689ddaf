"""`fishmj log import`: names in the tongues and habits of laboratories, and units that do not fit the values."""

import math

import lab_files
import numpy as np
import pytest
from lab_files import WAVE, N, guessed, near, only

from fishmj import log
from fishmj.base.errors import LogError
from fishmj.log import trial_check
from fishmj.log.importers import guess, header
from fishmj.log.importers.header import role
from fishmj.log.limits import typed

T = 0.02 * N
SERVOS = [0.5 * np.sin(6 * T - k) for k in range(3)]  # rad
NAMED = {f"servo{k + 1}_rad": q for k, q in enumerate(SERVOS)}


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize(
    ("names", "place"),
    [
        ("zeit_ms Zeit[s] zeitstempel uhrzeit temps_s ts t_us tstamp zeit_sekunden", "t"),
        ("kurs kurs_deg kurs_grad hdg HDG_deg heading psi ψ gierwinkel gier yawangle orientierung", "pose.yaw"),
        ("spannung akku_V akkuspannung batteriespannung vbat v_bat u_batt vcc lipo_mV spannung_akku", "power.V"),
        ("strom strom_A akkustrom i_a i_mA i_bat ibat curr_mA courant", "power.I"),
        ("servo1_soll sollwinkel1 stellwinkel_1_grad sollwert1 gelenk1_soll consigne1", "cmd.c#"),
        ("servo1_ist istwinkel1 istwert1 gelenk1_ist winkel1_gemessen", "joint.j#"),
        ("temperatur_servo1", "joint.temp#"),
        ("gierrate kurs_rate", "velocity.yaw_rate"),
        ("beschleunigung_x beschl_x", "imu.ax"),
    ],
)
def test_names_of_other_tongues_and_habits_are_known(names, place):
    for name in names.split():
        assert role(header.parse(name), set()).places == (place,), name


@pytest.mark.parametrize("name", "geschwindigkeit_x pressure_psi cam_v kurs_soll tension cap kompass druck motor1_strom".split())
def test_what_only_sounds_like_a_column_of_ours_is_left_out(name):
    assert role(header.parse(name), set()).places == ()


@pytest.mark.parametrize("name", ["akku", "batt", "winkel1", "gelenk1"])
def test_a_name_with_two_meanings_is_asked(name):
    assert len(role(header.parse(name), set()).places) == 2


@pytest.mark.parametrize(
    ("name", "place", "size"),
    [
        *(("x [ft]", "pose.x", 0.3048), ("x (inch)", "pose.x", 0.0254), ("x_dm", "pose.x", 0.1), ("x_um", "pose.x", 1e-6)),
        *(("meas1 [gon]", "joint.j1", np.pi / 200), ("meas1_mdeg", "joint.j1", np.radians(1e-3)), ("time_cs", "t", 0.01)),
        *(("meas1_cdeg", "joint.j1", np.radians(0.01)), ("time [h]", "t", 3600.0), ("time (days)", "t", 86400.0)),
        *(("surge [ft/s]", "velocity.surge", 0.3048), ("surge_ft_s", "velocity.surge", 0.3048)),
        *(("surge (mph)", "velocity.surge", 0.44704), ("surge [m s^-1]", "velocity.surge", 1.0)),
        *(("yaw_rate [mrad/s]", "velocity.yaw_rate", 1e-3), ("yaw_rate [mdps]", "velocity.yaw_rate", np.radians(1e-3))),
        ("ax [mg]", "imu.ax", 9.80665e-3),
    ],
)
def test_rare_units_of_a_name_are_converted(tmp_path, bring, name, place, size):
    values = 0.02 * N if place == "t" else 0.3 * WAVE
    beside = {"pose.x": ("time_s,y_m,yaw_deg", "{t},0.1,2"), "joint.j1": ("time_s", "{t}"), "t": ("meas1_rad", "{w}")}
    beside |= {"velocity.yaw_rate": ("time_s,surge_m_s", "{t},0.1"), "imu.ax": ("time_s,ay [m/s^2]", "{t},0.1")}
    beside = beside.get(place, ("time_s", "{t}"))
    rows = [f"{beside[1].format(t=0.02 * i, w=WAVE[i])},{v:.12g}" for i, v in enumerate(values / size)]
    (tmp_path / "log.csv").write_text("\n".join([f"{beside[0]},{name}", *rows]) + "\n")
    code, _, err = bring(tmp_path / "log.csv", "--yes")
    assert code == 0, err
    table, _, column = ("joint.t" if place == "t" else place).partition(".")
    near(only(tmp_path / "set").tables[table][column], values, 2e-6)


MULTIPLES = "BL, 10 mm, 0.1 m, m x10, mm/10, 1/10 mm, m*2, 2^8 px, half feet, m/turn, 100 raw/m, -1..1, a.u., LSB, x100, π m"


@pytest.mark.parametrize("name", [*(f"x [{unit}]" for unit in MULTIPLES.split(", ")), "x_mm_x10", "x cm/2"])
def test_a_unit_without_a_factor_is_asked_with_a_scale(tmp_path, bring, name):
    path = lab_files.write(tmp_path / "log.csv", {"time_ms": 20.0 * N, name: WAVE, "y_m": WAVE, "yaw_deg": 10 * WAVE})
    code, _, err = bring(path, "--yes")
    assert code == 2 and "is no unit that is known: say one with a scale" in err
    assert bring(path, "--yes", "--set", f"{name}=pose.x:m*0.5")[0] == 0
    near(only(tmp_path / "set").tables["pose"]["x"], 0.5 * WAVE)


@pytest.mark.parametrize("unit", ["BL", "m/2", "mm x10"])
def test_a_unit_without_a_factor_in_a_row_of_units_is_asked(tmp_path, bring, unit):
    rows = "".join(f"{0.02 * i},{0.01 * i},0,5\n" for i in range(50))
    (tmp_path / "log.csv").write_text(f"t,x,y,yaw\ns,{unit},{unit},deg/2\n" + rows)
    code, _, err = bring(tmp_path / "log.csv", "--yes")
    assert code == 2 and f"x [{unit}]: {unit} is no unit that is known" in err and "pose.yaw:rad*SCALE" in err


WORDS = "left, camera, raw?, cam 1, z-up, in tank frame, tail_servo, m1, s2, joint 3, world/map, -, UTC, CW+, 0x201, tag 4"


@pytest.mark.parametrize("words", WORDS.split(", "))
def test_words_in_brackets_that_tell_no_unit_are_not_asked(words):
    assert (found := header.parse(f"servo1 [{words}]")).unit == found.other == "" and found.words == ("servo",)
    assert header.parse(f"servo1 (deg, {words})").unit == "deg"


@pytest.mark.parametrize("name", ["servo{} [deg*2]", "servo{}_deg_x10"])
def test_a_servo_in_a_multiple_of_a_unit_is_asked_as_any_column(tmp_path, bring, name):
    path = lab_files.write(tmp_path / "log.csv", {"time_ms": 20.0 * N, **{name.format(k): 20 * WAVE for k in (1, 2)}})
    code, _, err = bring(path, "--yes")
    assert code == 2 and "is no unit that is known" in err and f"--set {typed(name.format(2))}=cmd.c2:rad*SCALE" in err


@pytest.mark.parametrize("name", ["cmd1", "servo1", "meas1", "joint_angle", "yaw", "cmd"])
@pytest.mark.parametrize("cell", ["0x800", "45%", '"[0.1, 0.2]"'])
def test_a_command_joint_or_pose_of_text_is_asked(tmp_path, bring, name, cell):
    rows = "".join(f"{0.02 * i},{cell},{0.01 * i},0\n" for i in range(50))
    (tmp_path / "log.csv").write_text(f"t,{name},x_m,y_m\n{rows}")
    code, _, err = bring(tmp_path / "log.csv", "--yes")
    assert code == 2 and f"{name}: its cells are text, such as '{cell.strip(chr(34))}': write plain numbers" in err
    assert f"--set {name}=skip" in err


@pytest.mark.parametrize("name, cell", [("firmware", "0x800"), ("charge", "45%"), ("cmd", "forward")])
def test_other_columns_of_text_are_left_out(tmp_path, bring, name, cell):
    rows = "".join(f"{0.02 * i},{cell},{0.01 * i},0,5\n" for i in range(50))
    (tmp_path / "log.csv").write_text(f"t,{name},x_m,y_m,yaw_deg\n{rows}")
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0


def test_battery_in_millivolts_without_a_unit_is_inferred_from_values(tmp_path):
    found = guessed(tmp_path, named(7400.0, "vbat"))["vbat"]
    assert (found.place, found.unit, found.state) == ("power.V", "mV", guess.TAKEN)


# ------------------------------------------------------------------------------------------------------------ plausibility
def boat(path, reach=150.0, unit="m"):
    t = 0.1 * np.arange(600)
    return lab_files.write(path, {"t_s": t, f"x_{unit}": reach * t / t[-1], f"y_{unit}": 0 * t, "heading_deg": 0 * t})


def test_a_boat_at_150_m_is_fine(tmp_path, bring):
    assert bring(boat(tmp_path / "boat.csv"), "--yes")[0] == 0
    assert only(tmp_path / "set").tables["pose"]["x"][-1] == pytest.approx(150)


def test_a_longer_course_is_allowed_by_a_flag_which_travels_with_the_trial(tmp_path, bring):
    source = boat(tmp_path / "boat.csv", 800)
    code, _, err = bring(source, "--yes")
    assert code == 2 and "boat.csv" in err and "--plausible reach=" in err
    assert bring(source, "--yes", "--plausible", "reach=1000")[0] == 0
    assert only(tmp_path / "set").meta["plausible"] == {"reach": 1000.0}


def test_millimetres_called_metres_are_seen_by_their_pace(tmp_path, bring):
    t = 0.02 * np.arange(200)
    lab_files.write(tmp_path / "a.csv", {"t_s": t, "x_m": 100 + 80 * t + 3 * np.sin(40 * t), "y_m": 0 * t, "yaw_rad": 0 * t})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "column 'x_m' in m as pose.x is 80" in err and "m/s; plausible is at most 20" in err
    assert 'columns.x = {column = "x_m", unit = "cm"}' in err and "Divide" not in err


def named(values, name, **others):
    """A log with a swim's command and one more column."""
    return {"time_s": 0.02 * N, "servo1_deg": 20 * WAVE, name: values + 0 * N, **others}


@pytest.mark.parametrize(
    ("columns", "said", "mended"),
    [
        (named(7.4, "batt_mV"), "the name says mV, which makes it 0.0074 V, plausible is 1 to 500", "batt_mV=power.V:V"),
        (named(7400, "batt_V"), "the name says V, which makes it 7400 V, plausible is 1 to 500", "batt_V=power.V:mV"),
        (named(7.4, "batt_V", i_mA=0.8 + 0 * N), "makes it 0.0008 A, plausible is 0.005 to 200", "i_mA=power.I:A"),
        (named(1200 + N, "x_cm", y_cm=600 + N, yaw_deg=5 * WAVE), "makes it 12 m, plausible is at most 8", "x_cm=pose.x:mm"),
        (named(1200 + N, "x_cm", y_cm=600 + N, yaw_deg=5 * WAVE), "makes it 12 m, plausible is at most 8", "y_cm=pose.y:mm"),
        ({"time_s": 0.02 * N, "servo1_deg": 0.4 * WAVE}, "the name says deg, but no joint goes beyond", "servo1_deg=cmd.c1:rad"),
        (
            named(0.2 * WAVE, "yaw_deg", x_m=WAVE, y_m=WAVE),
            "says deg, but it stays within 0.2, as rad does",
            "yaw_deg=pose.yaw:rad",
        ),
        (named((N / 60) % 1, "yaw", x_m=WAVE, y_m=WAVE), "wraps by 0.9833: rev?", "yaw=pose.yaw:rev"),
        (named((N / 30) % 2 - 1, "yaw", x_m=WAVE, y_m=WAVE), "wraps by 1.967: rev*0.5?", "yaw=pose.yaw:rev*0.5"),
        (named((N / 9) % 6.28 - 3.14, "yaw_deg", x_m=WAVE, y_m=WAVE), "says deg, but it wraps by 6", "yaw_deg=pose.yaw:rad"),
        (
            named(1000 + 5 * N, "x_mm", y=0.6 + 0.01 * WAVE),
            "its other axis is in mm, where it moves by 0.02 mm",
            "y=markers.p1y:m",
        ),
        (named(170 * WAVE, "cmd1", pos1=15 * WAVE), "up to 170: a servo's counts", "cmd1=cmd.c1:deg"),
        (named(2048 + 300 * WAVE, "cmd1_ticks"), "count of a servo. Say the scale here", "cmd1_ticks=cmd.c1:rad*SCALE"),
        (named(30 * WAVE, "servo1_cmd_percent"), "% of a servo. Say the scale here", "servo1_cmd_percent=cmd.c1:rad*SCALE"),
        (named(0.3, "pos_y_m", pos_x_m=0.01 * N, pos_z_m=0.02 * WAVE, yaw_deg=5 * WAVE), "is y the height?", "pos_y_m=pose.y:m"),
        (named(1500 + 300 * WAVE, "servo1_cmd_us"), "us of a servo. Say the scale here", "servo1_cmd_us=cmd.c1:rad*SCALE"),
        (
            named(90 + 30 * WAVE, "pos1_deg"),
            'from the servo\'s end? In a map say unit = "deg", zero = 90',
            "pos1_deg=joint.j1:deg",
        ),
        (named(90 + 30 * WAVE, "pos1"), 'from the servo\'s end? In a map say unit = "deg", zero = 90', "pos1=joint.j1:rad"),
    ],
)
def test_a_unit_in_a_name_that_does_not_fit_the_values_is_asked(tmp_path, bring, columns, said, mended):
    lab_files.write(tmp_path / "log.csv", columns)
    code, _, err = bring(tmp_path / "log.csv", "--yes")
    assert code == 2 and said in err and f"--set {mended}" in err and "\n" not in err
    name = mended.partition("=")[0]
    assert guessed(tmp_path, columns)[name].state == guess.UNCLEAR


def test_stamps_that_are_no_numbers_are_named(tmp_path, bring):
    (tmp_path / "a.csv").write_text("time_ms,servo1_deg\n" + "".join(f"{hex(20 * i)},{w:.3f}\n" for i, w in enumerate(20 * WAVE)))
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "no column of time ('time_ms' holds no number, such as '0x0')" in err


def test_ticks_of_a_servo_are_taken_with_a_scale(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", {"time_s": 0.02 * N, "cmd1_ticks": 300 * WAVE})
    code, _, err = bring(tmp_path / "a.csv", "--yes", "--set", "cmd1_ticks=cmd.c1:rad*0.001534")
    assert code == 0, err
    near(only(tmp_path / "set").tables["cmd"]["c1"], 0.4602 * WAVE)


def test_what_is_asked_is_answered_either_way(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", named(1200 + N, "x_cm", y_cm=600 + N, yaw_deg=5 * WAVE))
    for unit, place in (("mm", 1.2), ("cm", 12.0)):
        said = ("--set", f"x_cm=pose.x:{unit}", "--set", f"y_cm=pose.y:{unit}")
        code, _, err = bring(tmp_path / "a.csv", "--yes", *said, out=tmp_path / unit)
        assert code == 0, err
        assert only(tmp_path / unit).tables["pose"]["x"][0] == pytest.approx(place)


@pytest.mark.parametrize(
    ("table", "source", "said", "line"),
    [
        ("power", {"V": ("k", "mV", 7.4)}, "in mV as power.V is usually 0.0074 V; plausible is 1 to 500", ("V", "V")),
        ("cmd", {"c1": ("k", "", 20.0)}, "in rad as cmd.c1 is 20 rad; plausible is at most 3.142", ("c1", "deg")),
        ("target", {"x": ("k", "", 1200.0), "y": ("k", "mm", 1.0)}, "starts at 1200 m; plausible is at most 1000", ("x", "cm")),
    ],
)
def test_a_unit_of_a_map_that_does_not_fit_names_the_line_that_mends_it(tmp_path, bring, table, source, said, line):
    lab_files.write(tmp_path / "a.csv", {"t": 0.02 * N, "k": next(iter(source.values()))[2] + 0 * N})
    rows = "".join(
        f'columns.{ours} = {{ column = "{k}"{f", unit = {unit!r}" if unit else ""} }}\n' for ours, (k, unit, _) in source.items()
    )
    (tmp_path / "MAP.toml").write_text(f'[tables.{table}]\nt = "t"\n{rows}')
    code, _, err = bring(tmp_path / "a.csv", "--columns", tmp_path / "MAP.toml")
    assert code == 2 and said in err and "a.csv:2:k" in err and "the column by" not in err
    assert 'columns.{} = {{column = "k", unit = "{}"}} in the map'.format(*line) in err


def test_stamps_of_a_map_in_another_unit_name_the_line_that_mends_it(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", {"t": 20.0 * N, "k": 0.3 * WAVE})
    (tmp_path / "MAP.toml").write_text('[tables.cmd]\nt = "t"\ncolumns.c1 = "k"\n')
    code, _, err = bring(tmp_path / "a.csv", "--columns", tmp_path / "MAP.toml")
    assert code == 2 and 't = {column = "t", unit = "ms"} in the map, or --set t=t:ms' in err


def test_a_battery_that_is_off_is_no_mistake_of_units(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", {"time_s": 0.02 * N, "servo1_deg": 20 * WAVE, "batt_mV": 0 * N})
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("reach=far", "expected NAME=NUMBER"),
        ("reech=10", "Did you mean 'reach'"),
        ("reach=-1", "expected a positive number"),
        ("reach=nan", "positive"),
    ],
)
def test_a_wrong_bound_is_one_line(tmp_path, bring, text, message):
    code, _, err = bring(boat(tmp_path / "a.csv"), "--yes", "--plausible", text)
    assert code == 2 and message in err and "\n" not in err


def test_the_shipped_bounds_are_whole():
    assert trial_check.shipped_bounds().reach >= 200 and trial_check.shipped_bounds().angle == math.pi


def test_a_trials_own_meta_relaxes_a_bound(tmp_path):
    lab_files.write(tmp_path / "pose.csv", {"t": 1.0 * N, "x": 9.0 * N, "y": 0 * WAVE, "yaw": 0 * WAVE})
    (tmp_path / "meta.toml").write_text('origin = "measured"\n')
    with pytest.raises(LogError, match="from the first row, which looks like millimetres"):
        log.read_trial(tmp_path)
    (tmp_path / "meta.toml").write_text('origin = "measured"\n[plausible]\nreach = 5000.0\n')
    assert log.read_trial(tmp_path).tables["pose"]["x"][-1] == 891
    (tmp_path / "meta.toml").write_text('origin = "measured"\nplausible = "all"\n')
    with pytest.raises(LogError, match="expected a table such as"):
        log.read_trial(tmp_path)


@pytest.mark.parametrize(
    ("name", "seconds", "asked", "unit"),
    [("time_min", 60.0, "may be s or min", "min"), ("time", 3600.0, "may be h", "h"), ("time", 86400.0, "or day", "day")],
)
def test_stamps_in_long_units_are_asked_with_the_unit_that_fits(tmp_path, bring, name, seconds, asked, unit):
    t = 0.02 * N
    rows = [f"{name},servo1_deg,servo2_deg", *(f"{float(a) / seconds!r},{20 * b:.4f},0" for a, b in np.stack([t, WAVE], 1))]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "swim.csv").write_text("\n".join(rows) + "\n")
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and asked in err and f"t:{unit}" in err
    assert bring(tmp_path / "in", "--yes", "--set", f"{name}=t:{unit}")[0] == 0
    near(only(tmp_path / "set").table("cmd")["t"], t)


def test_a_heading_that_counts_turns_may_be_rad(tmp_path, bring):
    yaw = 0.1 * N + 0.05 * WAVE
    lab_files.write(tmp_path / "in" / "swim.csv", {"time_s": 0.1 * N, "x_m": np.sin(yaw), "y_m": -np.cos(yaw), "yaw_rad": yaw})
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and "deg, or a heading that counts turns" in err and "pose.yaw:deg or pose.yaw:rad" in err
    assert bring(tmp_path / "in", "--yes", "--set", "yaw_rad=pose.yaw:rad")[0] == 0
    near(only(tmp_path / "set").table("pose")["yaw"], yaw)


@pytest.mark.parametrize(("turn", "unit"), [(400.0, "gon"), (36e3, "cdeg"), (2e3 * math.pi, "mrad")])
def test_a_heading_that_wraps_at_another_turn_is_asked(tmp_path, bring, turn, unit):
    """It was read as degrees, and lost the rows around each wrap."""
    yaw = 0.1 * N + 0.05 * WAVE
    heading = (yaw % (2 * math.pi)) / (2 * math.pi) * turn
    lab_files.write(
        tmp_path / "in" / "swim.csv", {"time_s": 0.1 * N, "x_m": np.sin(yaw), "y_m": -np.cos(yaw), "heading": heading}
    )
    code, _, err = bring(tmp_path / "in", "--yes")
    assert code == 2 and f": {unit}?, --set heading=pose.yaw:{unit};" in err
    assert bring(tmp_path / "in", "--yes", "--set", f"heading=pose.yaw:{unit}")[0] == 0
    found = only(tmp_path / "set").table("pose")["yaw"]
    near(np.cos(found), np.cos(yaw))


@pytest.mark.parametrize(("turn", "unit"), [(3600, "deg*0.1"), (256, "rev*0.00390625"), (65536, "rev*1.52587891e-05")])
def test_whole_counts_of_a_heading_that_wrap_are_asked(tmp_path, bring, turn, unit):
    """A sensor's tenths of a degree, or parts of a turn that are a power of two, were read as degrees."""
    yaw = 0.1 * N + 0.05 * WAVE
    counts = np.floor((yaw % (2 * math.pi)) / (2 * math.pi) * turn)
    lab_files.write(tmp_path / "a.csv", {"time_s": 0.1 * N, "x_m": np.sin(yaw), "y_m": -np.cos(yaw), "heading": counts})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and f": {unit}?, --set heading=pose.yaw:{unit};" in err
    assert bring(tmp_path / "a.csv", "--yes", "--set", f"heading=pose.yaw:{unit}")[0] == 0
    near(np.cos(only(tmp_path / "set").table("pose")["yaw"]), np.cos(yaw), 2 * math.pi / turn)


def test_a_heading_in_counts_that_never_wraps_is_noted(tmp_path, bring):
    t = 0.02 * np.arange(1000)
    yaw = 0.5 + 0.06 * t
    place = {"x_m": 0.2 * np.cumsum(np.cos(yaw)) * 0.02, "y_m": 0.2 * np.cumsum(np.sin(yaw)) * 0.02}
    lab_files.write(tmp_path / "a.csv", {"time_s": t, **place, "heading": np.round(10 * np.degrees(yaw))})
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0
    told = " ".join(only(tmp_path / "set").meta["notes"])
    assert "all along: is it in another unit" in told and "Values times 0.1 would agree" in told


def test_a_head_that_swings_faster_than_its_tail_is_noted(tmp_path, bring):
    """A straight swim whose heading goes up to 1.2 degrees was read as rad."""
    t = 0.02 * np.arange(400)
    servos = {f"servo{k}_rad": 0.4 * np.sin(7 * t - k) for k in (1, 2, 3)}
    for name, swing in (("deg", 1.2), ("rad", 0.1)):
        lab_files.write(tmp_path / f"{name}.csv", {"t": t, **servos, "x": 0.2 * t, "y": 0 * t, "yaw": -swing * np.sin(7 * t - 2)})
        assert bring(tmp_path / f"{name}.csv", "--yes", out=tmp_path / name)[0] == 0
        told = " ".join(only(tmp_path / name).meta.get("notes", []))
        assert ("times as fast as the tail bends (at most 1 is plausible): is yaw in degrees?" in told) == (name == "deg")


@pytest.mark.parametrize(("name", "zero"), [("time", 133_500_000_000_000_000), ("stamp", 638_500_000_000_000_000), ("ticks", 0)])
def test_ticks_of_100_ns_are_asked_with_their_unit(tmp_path, bring, name, zero):
    """They were read as us, ten times as long."""
    rows = [f"{name},servo1_deg", *(f"{zero + 200_000 * k},{20 * w:.4f}" for k, w in enumerate(WAVE))]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "ns*100 (ticks of " in err and f"{name}=t:s or t:ms or t:us or t:ns or t:ns*100" in err
    assert bring(tmp_path / "a.csv", "--yes", "--set", f"{name}=t:ns*100")[0] == 0
    near(only(tmp_path / "set").table("cmd")["t"], 0.02 * N, 2e-5)


def test_an_acceleration_below_a_tenth_may_be_said_in_g(tmp_path, bring):
    lab_files.write(tmp_path / "a.csv", {"t": 0.02 * N, "ax": 0.02 * WAVE, "ay": 0.01 * WAVE})
    code, _, err = bring(tmp_path / "a.csv", "--yes")
    assert code == 2 and "--set ax=imu.ax:m/s^2 or imu.ax:g" in err


def test_a_joint_that_swings_about_a_far_middle_is_noted(tmp_path, bring):
    """Percent of a pulse's period, 7.5 when straight, were read as degrees in silence."""
    lab_files.write(tmp_path / "a.csv", {"t": 0.02 * N, "servo1": 7.5 + 2 * WAVE, "servo2": 7.5 + WAVE, "servo3": 7.5 + 0 * N})
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0
    told = [note for note in only(tmp_path / "set").meta["notes"] if "never straight" in note]
    assert len(told) == 2 and "'servo1' as cmd.c1" in told[0]


def test_commands_that_end_at_exactly_one_are_asked(tmp_path, bring):
    """Actions of a policy lie in [-1, 1]; so may commands in rad. A unit in the name decides, as do values beyond."""
    for name, unit, scale, asked in (("policy", "", 1.0, True), ("named", "_rad", 1.0, False), ("beyond", "", 1.2, False)):
        clipped = {f"cmd{k + 1}{unit}": np.clip(3 * q, -1, 1) * scale for k, q in enumerate(SERVOS)}
        lab_files.write(tmp_path / name / "a.csv", {"time": T, **clipped})
        code, _, err = bring(tmp_path / name, "--yes", out=tmp_path / f"{name}_set")
        assert (code == 2) is asked and ("--set cmd1=cmd.c1:rad or cmd.c1:rad*SCALE" in err) is asked, err
    said = [f"--set=cmd{k}=cmd.c{k}:rad*0.5" for k in (1, 2, 3)]
    assert bring(tmp_path / "policy", *said, "--yes", out=tmp_path / "half")[0] == 0
    near(only(tmp_path / "half").table("cmd")["c1"], 0.5 * np.clip(3 * SERVOS[0], -1, 1))


def test_whole_numbers_below_a_converter_s_range_are_no_millivolts_for_sure(tmp_path, bring):
    counts = np.round(2500 - T)
    for name, column, values, asked in (
        ("counts", "vbat", counts, True),
        ("named", "vbat_mV", counts + 1000, False),
        ("supply", "vbat", counts + 5000, False),
    ):
        lab_files.write(tmp_path / name / "a.csv", {"time": T, **NAMED, column: values})
        code, _, err = bring(tmp_path / name, "--yes", out=tmp_path / f"{name}_set")
        assert (code == 2) is asked and ("mV, or counts of a converter (V*SCALE)?" in err) is asked, err


def test_millimetres_in_which_a_fish_hardly_moves_are_asked(tmp_path, bring):
    """A place in m under a name in mm; noise of a fish at rest is none."""
    noise = 0.2 * np.random.default_rng(3).standard_normal((2, len(N)))
    for name, x, asked in (("metres", 0.2 * T, True), ("rest", 30 + noise[0], False), ("swim", 200 * T, False)):
        place = {"x_mm": x, "y_mm": noise[1] if name == "rest" else 0.1 * x, "yaw_rad": 0.0 * T}
        lab_files.write(tmp_path / name / "a.csv", {"time": T, **NAMED, **place})
        code, _, err = bring(tmp_path / name, "--yes", out=tmp_path / f"{name}_set")
        assert (code == 2) is asked and ("in which it moves by" in err) is asked, (name, err)
