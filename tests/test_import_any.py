"""`fishmj log import`: a laboratory's own columns, files and folders come in, in one call; what is unclear is never taken."""

import json
import math
import os
import sys

import lab_files
import numpy as np
import pytest
from lab_files import WAVE, N, guessed, near, only
from synthetic import whole_trial

from fishmj import log
from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.log import __main__ as command
from fishmj.log.importers import guess
from fishmj.log.importers.column_map import of_dict, read_map


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


# ------------------------------------------------------------------------------------------------------ a lab's own files
def test_three_files_of_ones_own_naming_become_a_data_set_in_one_call(tmp_path, bring):
    files = lab_files.three(tmp_path / "monday")
    before = [file.read_bytes() for file in files]
    code, out, err = bring(
        *files,
        "--robot",
        "swift",
        "--excitation",
        "steps_1",
        "--start",
        "1.2,0.6,0",
        "--medium",
        "water",
        "--licence",
        "CC-BY-4.0",
        "--yes",
    )
    assert code == 0, err
    trial, s = only(tmp_path / "set"), lab_files.swim()
    assert trial.name == "monday" and set(trial.tables) == {"cmd", "pose", "power"}
    near(trial.tables["cmd"]["t"], s["t"])
    near(trial.tables["cmd"]["c2"], np.radians(s["servo2_deg"]))
    near(trial.tables["pose"]["t"], s["t"] + 0.004)
    near(trial.tables["pose"]["x"], s["x"] / 1e3)
    near(trial.tables["pose"]["yaw"], np.radians(s["yaw"]))
    near(trial.tables["power"]["V"], s["volt"])
    said = trial.meta
    assert (said["robot"], said["joints"], said["excitation"], said["medium"], said["start"]) == (
        "swift",
        3,
        "steps_1",
        "water",
        [1.2, 0.6, 0],
    )
    assert said["origin"] == "measured" and said["licence"] == "CC-BY-4.0" and "camera.csv" in said["source"]
    assert any("decimal commas read as points" in note for note in said["notes"])
    assert [file.read_bytes() for file in files] == before, "sources are never edited"
    assert "cam_heading_deg" in out and "a word for the heading" in out


def test_guessed_import_without_a_terminal_needs_yes_and_suggests_a_map(tmp_path, bring, monkeypatch):
    monkeypatch.setattr(sys, "stdin", open(os.devnull))
    code, out, err = bring(lab_files.one(tmp_path / "log.csv"))
    assert code == console.BAD_INPUT and "--write-map MAP.toml" in err and "servo1_deg" in out and not (tmp_path / "set").exists()


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("\n", console.BAD_INPUT)])
def test_on_a_terminal_the_user_is_asked(tmp_path, bring, monkeypatch, answer, code):
    class Terminal:
        isatty = staticmethod(lambda: True)
        readline = staticmethod(lambda: answer)

    monkeypatch.setattr(sys, "stdin", Terminal)
    assert bring(lab_files.one(tmp_path / "log.csv"))[0] == code and (tmp_path / "set").exists() == (code == 0)


def test_the_schemas_own_names_in_its_own_units_need_no_question(tmp_path, bring, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    lab_files.write(
        tmp_path / "a.csv", {"t [s]": 0.02 * np.arange(50), "c1 [rad]": 0.4 * np.sin(np.arange(50)), "V": 7.4 + np.zeros(50)}
    )
    assert bring(tmp_path / "a.csv")[0] == 0 and set(only(tmp_path / "set").tables) == {"cmd", "power"}


def test_a_written_map_is_read_back_and_gives_the_same_trial(tmp_path, bring):
    lab_files.three(tmp_path / "lab")
    assert bring(tmp_path / "lab", "--yes", out=tmp_path / "one")[0] == 0
    assert bring(tmp_path / "lab", "--write-map", tmp_path / "MAP.toml", out=None)[0] == 0
    assert bring(tmp_path / "lab", "--columns", tmp_path / "MAP.toml", out=tmp_path / "two")[0] == 0
    one, two = only(tmp_path / "one"), only(tmp_path / "two")
    assert all(np.array_equal(one.tables[t][c], two.tables[t][c]) for t in one.tables for c in one.tables[t])


def completed(text, **answers):
    """A map whose commented blocks are completed as its first lines say; the answers stand for ? in their order in a line."""
    out = []
    for line in text.splitlines():
        if line.startswith(("# [tables.", "# t =", "# columns.", "# file =")):
            line = line.removeprefix("# ").partition("    ")[0]
            for key, answer in answers.items():
                line = line.replace(f'{key} = "?"', f"{key} = {answer}")
        out.append(line)
    return "\n".join(out)


@pytest.mark.parametrize(
    ("columns", "said", "answers", "table"),
    [
        ({"time": 25.0 * N, "servo1": 4 * WAVE, "servo2": 5 * WAVE}, (), {"unit": '"deg"'}, "cmd"),
        ({"clk": 0.025 * N, "joint1_deg": 40 * WAVE, "load": N}, ("--set", "load=skip"), {"unit": '"s"'}, "cmd"),
        ({"ms": 25.0 * N, "x_px": 9 * WAVE, "y_px": WAVE}, (), {"scale": "0.001"}, "markers"),
    ],
)
def test_a_map_of_which_nothing_is_clear_is_written_to_complete(tmp_path, bring, columns, said, answers, table):
    path = tmp_path / "MAP.toml"
    lab_files.write(tmp_path / "log.csv", columns)
    code, out, err = bring(tmp_path / "log.csv", *said, "--write-map", path, out=None)
    assert code == 0 and "no column is clear, so complete its commented lines" in out, err
    assert all(name in path.read_text() for name in columns)
    code, _, err = bring(tmp_path / "log.csv", "--columns", path)
    assert code == 2 and "MAP.toml: no table; expected at least one block such as [tables.cmd]" in err
    path.write_text(completed(path.read_text(), **answers))
    code, _, err = bring(tmp_path / "log.csv", "--columns", path)
    assert code == 0, err + path.read_text()
    near(only(tmp_path / "set").tables[table]["t"], 0.025 * N)


def test_columns_of_unknown_names_stand_in_the_map_to_complete_and_the_reason_is_said(tmp_path, bring):
    path = tmp_path / "MAP.toml"
    lab_files.write(tmp_path / "log.csv", {"t_s": 0.025 * N, "alpha": 20 * WAVE})
    code, out, _ = bring(tmp_path / "log.csv", "--write-map", path, out=None)
    assert code == 0 and "no column was recognised (alpha: " in out and "gap find LOGS --model" in out
    text = completed(path.read_text(), unit='"deg"').replace("tables.?", "tables.cmd").replace("columns.?", "columns.c1")
    path.write_text(text)
    assert bring(tmp_path / "log.csv", "--columns", path)[0] == 0
    near(only(tmp_path / "set").tables["cmd"]["c1"], np.radians(20 * WAVE))


def test_a_written_map_names_every_column_of_the_files(tmp_path, bring):
    columns = {"time_ms": 20 * N, "servo1_deg": 20 * WAVE, "gripper": N, "humidity": N, "fx": N, "akku": 7 + 0 * N}
    lab_files.write(tmp_path / "log.csv", columns)
    said = ("--set", "gripper=skip", "--write-map", tmp_path / "MAP.toml")
    assert bring(tmp_path / "log.csv", *said, out=None)[0] == 0
    text = (tmp_path / "MAP.toml").read_text()
    assert all(name in text for name in columns) and "# left out: log.csv: fx (a force or torque" in text
    assert 'in [tables.power]: columns.V = {column = "akku", unit = "V"}' in text
    assert "# unclear: log.csv: akku may be power.V:V" in text and read_map(tmp_path / "MAP.toml").skip == ["gripper"]
    assert bring(tmp_path / "log.csv", "--columns", tmp_path / "MAP.toml")[0] == 0
    assert any("not read: humidity, fx, akku" in note for note in only(tmp_path / "set").meta["notes"])


# ------------------------------------------------------------------------------------------------------------------- maps
MAP = """
[meta]
robot = "eel"
[tables.cmd]
t = { column = "tick", scale = 0.02 }
columns.c1 = { column = "goal", unit = "deg", sign = -1, zero = 2.4 }
columns.c2 = { column = "raw", scale = 0.0015339807878856412, zero = 2048 }
[tables.pose]
t = { column = "tick", scale = 0.02 }
columns.x = { column = "u", unit = "px", scale = 0.002, zero = 320 }
columns.y = { column = "v", unit = "px", scale = 0.002, zero = 240, sign = -1 }
columns.yaw = { constant = 0.5 }
"""


def camera(path):
    n = np.arange(60)
    return lab_files.write(
        path, {"tick": n, "goal": 2.4 + 10 * np.sin(n), "raw": 2048 + n, "u": 320 + n, "v": 240 + 2 * n, "note": n}
    )


def test_a_map_says_sign_zero_scale_constants_and_which_way_pixels_run(tmp_path, bring):
    camera(tmp_path / "a.csv")
    (tmp_path / "MAP.toml").write_text(MAP)
    assert bring(tmp_path / "a.csv", "--columns", tmp_path / "MAP.toml")[0] == 0
    trial, n = only(tmp_path / "set"), np.arange(60)
    near(trial.tables["cmd"]["t"], 0.02 * n)
    near(trial.tables["cmd"]["c1"], -np.radians(10 * np.sin(n)))
    near(trial.tables["cmd"]["c2"], n * 2 * math.pi / 4096)
    near(trial.tables["pose"]["x"], 0.002 * n)
    near(trial.tables["pose"]["y"], -0.004 * n)
    near(trial.tables["pose"]["yaw"], 0.5)
    assert trial.meta["robot"] == "eel" and any("not read: note" in note for note in trial.notes + tuple(trial.meta["notes"]))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"deg"', '"degs/h"', r"unit 'degs/h' is not known; known: s, ms"),
        ('"deg"', '"mm"', r"\[tables.cmd\] c1: mm measures length; expected rad"),
        (
            "scale = 0.02 }\ncolumns.c1",
            "scales = 0.02 }\ncolumns.c1",
            r"tables.cmd.t.scales: unknown key; did you mean 'scale'\?",
        ),
        ("sign = -1, zero", "sign = 2, zero", r"tables.cmd.columns.c1.sign: .*1.*, got '2'"),
        ("[tables.pose]", "[tables.poses]", r"no such table; did you mean 'pose'\?"),
        ("columns.yaw", "columns.yaww", r"no column 'yaww'; did you mean 'yaw'\?"),
        ("{ constant = 0.5 }", "{ constant = nan }", r"columns.yaw.constant: .*finite"),
        ("{ constant = 0.5 }", "{ column = 'a', constant = 1.0 }", r'expected column = "a name in the file", or constant'),
        ('unit = "px", scale = 0.002, zero = 320', 'unit = "px"', r"px needs scale"),
        ("[meta]", "[meta", r"not valid TOML"),
    ],
)
def test_a_wrong_map_is_refused_with_the_key_and_the_nearest_name(tmp_path, old, new, message):
    assert old in MAP
    (tmp_path / "MAP.toml").write_text(MAP.replace(old, new, 1))
    with pytest.raises(LogError, match=message) as caught:
        read_map(tmp_path / "MAP.toml")
    assert "\n" not in str(caught.value)


def test_a_map_whose_column_is_absent_names_the_nearest(tmp_path, bring):
    camera(tmp_path / "a.csv")
    (tmp_path / "MAP.toml").write_text(MAP.replace('"goal"', '"gaol"').replace('"u"', '"uu"'))
    code, _, err = bring(tmp_path / "a.csv", "--columns", tmp_path / "MAP.toml")
    assert code == 2 and "no column 'gaol'; did you mean 'goal'?" in err


@pytest.mark.parametrize(
    ("table", "column", "unit", "factor"),
    [
        *[("t", "t", unit, factor) for unit, factor in (("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))],
        *[("cmd", "c1", unit, factor) for unit, factor in (("rad", 1), ("deg", math.pi / 180), ("mrad", 1e-3))],
        *[("joint", "w1", unit, factor) for unit, factor in (("rad/s", 1), ("deg/s", math.pi / 180))],
        *[("pose", "x", unit, factor) for unit, factor in (("m", 1), ("cm", 1e-2), ("mm", 1e-3))],
        *[("velocity", "surge", unit, factor) for unit, factor in (("m/s", 1), ("cm/s", 1e-2), ("mm/s", 1e-3))],
        *[("power", "V", unit, factor) for unit, factor in (("V", 1), ("mV", 1e-3))],
        *[("power", "I", unit, factor) for unit, factor in (("A", 1), ("mA", 1e-3))],
        *[("imu", "ax", unit, factor) for unit, factor in (("m/s^2", 1), ("g", 9.80665))],
    ],
)
def test_every_unit_is_converted(tmp_path, bring, table, column, unit, factor):
    n = np.arange(40)
    si, t = (7.3 if column == "V" else 0.3) + 0.1 * np.sin(n), 0.05 * n
    if table == "t":
        lab_files.write(tmp_path / "a.csv", {f"zeit [{unit}]": t / factor, "c1": si})
        assert bring(tmp_path / "a.csv", "--yes")[0] == 0
        near(only(tmp_path / "set").tables["cmd"]["t"], t)
        return
    others = {"cmd": (), "joint": ("j1",), "pose": ("y", "yaw"), "velocity": (), "power": ("V",), "imu": ("ay",)}[table]
    lab_files.write(tmp_path / "a.csv", {"t": t, "k": si / factor, "rest": 1.5 + 0.01 * n})
    rest = {name: "rest" for name in others if name != column}
    made = of_dict({"tables": {table: {"t": "t", "columns": {column: {"column": "k", "unit": unit}, **rest}}}}, "map")
    from fishmj.log.importers.column_map import written

    (tmp_path / "MAP.toml").write_text(written(made))
    assert bring(tmp_path / "a.csv", "--columns", tmp_path / "MAP.toml")[0] == 0
    near(only(tmp_path / "set").tables[table][column], si, 1e-5)


# ---------------------------------------------------------------------------------------------------------- what is unclear
@pytest.mark.parametrize(
    ("columns", "column"),
    [
        ({"time_s": 0.02 * N, "servo1": 4 * WAVE}, "servo1"),  # 4 rad or 4 deg
        ({"time_s": 0.02 * N, "servo1": 0.02 * WAVE}, "servo1"),
        ({"time_s": 0.02 * N, "servo1": 2048 + 500 * WAVE}, "servo1"),  # counts
        ({"time": 1.0 * N, "servo1_deg": 20 * WAVE}, "time"),  # 1 s or 1 ms
        ({"time_s": 0.02 * N, "joint1_rad": 0.4 * WAVE}, "joint1_rad"),  # commanded or measured
        ({"time_s": 0.02 * N, "servo1_rad": 20 * WAVE}, "servo1_rad"),  # the name says rad, the values do not
        ({"time_s": 0.02 * N, "c1": 20 * WAVE}, "c1"),
        ({"time_s": 0.02 * N, "x": 1000 + 2 * N, "y": N, "yaw_deg": WAVE}, "x"),  # mm, cm, px or m
        ({"time_s": 0.02 * N, "x_m": WAVE, "y_m": WAVE, "yaw": 2.5 * WAVE}, "yaw"),  # turns as no fish does, if rad
        ({"time_s": 0.02 * N, "servo1_deg": 20 * WAVE, "x_m": WAVE, "y_m": WAVE, "yaw": 0.2 * WAVE}, "yaw"),  # others are deg
        ({"time_s": 0.02 * N, "x_px": 1000 + 2 * N, "y_px": N, "yaw_deg": WAVE}, "x_px"),
        ({"time_s": 0.02 * N, "cam_x_m": WAVE, "gps_x_m": WAVE, "y_m": WAVE, "yaw_deg": WAVE}, "gps_x_m"),  # two for one place
        ({"time_s": 0.02 * N, "servo_front_deg": WAVE, "servo_rear_deg": WAVE}, "servo_rear_deg"),  # which joint
        ({"time": 0.02 * N, "timestamp": 0.02 * N, "servo1_deg": WAVE}, "timestamp"),
        ({"time_s": 0.02 * N, "servo1_deg": WAVE, "servo3_deg": WAVE}, "servo3_deg"),
    ],
)
def test_an_unclear_column_is_never_taken(tmp_path, bring, columns, column):
    assert guessed(tmp_path, columns)[column].state == guess.UNCLEAR
    code, out, err = bring(tmp_path / "log.csv", "--yes")
    assert code == console.BAD_INPUT and "unclear" in err and column in err and "--set" in err and "\n" not in err
    assert not (tmp_path / "set").exists()


def test_set_decides_an_unclear_column(tmp_path, bring):
    lab_files.write(
        tmp_path / "log.csv", {"time_s": 0.02 * N, "servo1": 4 * WAVE, "x": 1000 + 2 * N, "y": N, "yaw_deg": WAVE, "a=b": N}
    )
    said = ("--set", "servo1=cmd.c1:deg", "--set", "x=pose.x:px*0.001", "--set", "y=pose.y:mm", "--set", "a=b=skip")
    code, _, err = bring(tmp_path / "log.csv", "--yes", *said)
    assert code == 0, err
    trial = only(tmp_path / "set")
    near(trial.tables["cmd"]["c1"], np.radians(4 * WAVE))
    near(trial.tables["pose"]["x"], 1 + 0.002 * N)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("servo1", "expected COLUMN=TABLE.COLUMN:UNIT"),
        ("servo1=cmdd.c1", "did you mean|Did you mean"),
        ("servo1=cmd.d1", "no column 'd1'"),
        ("servo1=cmd.c1:mm", "mm measures length"),
        ("servo1=cmd.c1:parsec", "'parsec' is not known"),
        ("servo1=cmd.c1:deg*-1", "expected a positive number"),
        ("sevro1=cmd.c1", "servo1"),
    ],
)
def test_a_wrong_set_is_one_line(tmp_path, bring, said, message):
    import re

    lab_files.write(tmp_path / "log.csv", {"time_s": 0.02 * N, "servo1": 4 * WAVE})
    code, _, err = bring(tmp_path / "log.csv", "--yes", "--set", said)
    assert code == 2 and re.search(message, err) and "\n" not in err


def test_forces_and_torques_are_never_taken_for_angles(tmp_path):
    names = ["c1 [N]", "c2 [Nm]", "fx", "fy", "mz", "tau1", "thrust_1", "joint1_torque", "servo1_effort", "motor 1 force"]
    found = guessed(tmp_path, {"t": 0.02 * N, **dict.fromkeys(names, 0.3 * WAVE), "servo1_deg": WAVE})
    assert {name: found[name].state for name in names} == dict.fromkeys(names, guess.LEFT)
    assert all("force or torque" in found[name].why for name in names)
    in_file = guessed(tmp_path, {"t": 0.02 * N, "c1": WAVE, "c2": WAVE, "c3": WAVE}, name="rov_wrench.csv")
    assert all(in_file[name].state == guess.LEFT for name in ("c1", "c2", "c3"))


def test_angles_beside_commands_are_measured_and_numbers_from_0_move_up(tmp_path):
    found = guessed(
        tmp_path, {"t": 0.02 * N, "goal0": 0.4 * WAVE, "goal1": 0.4 * WAVE, "joint0": 0.3 * WAVE, "joint1": 0.3 * WAVE}
    )
    assert [found[c].place for c in ("goal0", "goal1", "joint0", "joint1")] == ["cmd.c1", "cmd.c2", "joint.j1", "joint.j2"]


def test_a_place_without_a_heading_is_a_point_and_no_pose(tmp_path):
    found = guessed(tmp_path, {"t": 0.02 * N, "cam_x_mm": 1.0 * N, "cam_y_mm": 1.0 * N})
    assert found["cam_x_mm"].place == "markers.p1x" and "no heading" in found["cam_x_mm"].why


# -------------------------------------------------------------------------------------------------------------------- time
@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("zero", [0.0, 1.7e9])
def test_time_unit_is_inferred_from_the_step_and_epoch_from_the_size(tmp_path, bring, unit, scale, zero):
    t = 0.02 * N
    rows = "".join(
        f"{round(scale * (zero + v))},{20 * w:.3f}\n" if scale > 1 else f"{zero + v:.3f},{20 * w:.3f}\n"
        for v, w in zip(t, WAVE, strict=True)
    )
    (tmp_path / "log.csv").write_text("time,servo1_deg\n" + rows)
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0
    trial = only(tmp_path / "set")
    near(trial.tables["cmd"]["t"], t, 1e-3 if unit == "s" else 1e-6)
    assert any("count from 1970" in note for note in trial.meta.get("notes", [])) == bool(zero)


def test_date_time_stamps_become_seconds_from_the_first_row(tmp_path, bring):
    rows = "".join(f"2026-01-15T12:00:{0.02 * i:06.3f}Z,{20 * math.sin(i)}\n" for i in range(100))
    (tmp_path / "log.csv").write_text("stamp,servo1_deg\n" + rows)
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0
    near(only(tmp_path / "set").tables["cmd"]["t"], 0.02 * np.arange(100), 1e-6)


@pytest.mark.parametrize(("scale", "word"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_the_check_tells_milli_from_micro_from_nanoseconds(tmp_path, scale, word):
    (tmp_path / "meta.toml").write_text('origin = "measured"\n')
    lab_files.write(tmp_path / "cmd.csv", {"t": scale * 0.02 * np.arange(20), "c1": np.zeros(20)})
    with pytest.raises(LogError, match=f"looks like {word}"):
        log.read_trial(tmp_path)


# ------------------------------------------------------------------------------------------------------- files and folders
def names_in(folder):
    return list(log.read_dataset(folder).names)


def test_many_files_of_the_same_columns_are_a_trial_each(tmp_path, bring):
    for k in range(3):
        lab_files.one(tmp_path / "lab" / f"run {k}.csv")
    assert bring(tmp_path / "lab", "--yes")[0] == 0 and names_in(tmp_path / "set") == ["run_0", "run_1", "run_2"]


def test_a_folder_of_folders_is_a_trial_a_folder(tmp_path, bring):
    for day in ("a", "b"):
        lab_files.three(tmp_path / "lab" / day)
    lab_files.one(tmp_path / "lab" / "c" / "log.csv")
    assert bring(tmp_path / "lab", "--yes")[0] == 0 and names_in(tmp_path / "set") == ["a", "b", "c"]


def test_the_same_columns_are_told_apart_by_what_the_files_are_called(tmp_path, bring):
    columns = {"t_s": 0.02 * N, "angle1_deg": 20 * WAVE, "angle2_deg": 20 * WAVE}
    lab_files.write(tmp_path / "lab" / "commands.csv", columns)
    lab_files.write(tmp_path / "lab" / "measured.csv", columns)
    assert bring(tmp_path / "lab", "--yes")[0] == 0 and set(only(tmp_path / "set").tables) == {"cmd", "joint"}


def test_a_mixture_is_refused_with_the_two_options_and_taken_with_either(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "run1.csv")
    lab_files.one(tmp_path / "lab" / "run2.csv")
    lab_files.write(tmp_path / "lab" / "target.csv", {"t_s": 0.02 * N, "target_x_m": WAVE, "target_y_m": WAVE})
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "--one-trial or --trial-each" in err
    assert bring(tmp_path / "lab", "--yes", "--trial-each")[0] == 0 and len(names_in(tmp_path / "set")) == 3


def test_own_trial_folders_become_a_data_set_by_import_or_manifest(tmp_path, bring, capsys):
    for name in ("a", "b"):
        log.write_trial(tmp_path / "ours" / name, whole_trial(0.2), form="csv")
    assert bring(tmp_path / "ours")[0] == 0 and names_in(tmp_path / "set") == ["a", "b"]
    assert console.run(command.main, ["manifest", str(tmp_path / "ours"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.strip().split("\n")[-1])["trials"] == ["a", "b"]
    assert names_in(tmp_path / "ours") == ["a", "b"]
    assert console.run(command.main, ["manifest", str(tmp_path / "ours" / "a")]) == 2


def test_a_manifest_is_not_written_over_a_broken_trial(tmp_path, capsys):
    log.write_trial(tmp_path / "ours" / "a", whole_trial(0.2), form="csv")
    (tmp_path / "ours" / "a" / "pose.csv").write_text("t,x\n0,0\n")
    assert console.run(command.main, ["manifest", str(tmp_path / "ours")]) == 2
    assert "lacks column 'y', 'yaw'" in capsys.readouterr().err and not (tmp_path / "ours" / "manifest.json").exists()


def test_hidden_files_and_links_that_lead_outside_are_passed_over(tmp_path, bring):
    lab_files.one(tmp_path / "secret" / "other.csv")
    lab_files.one(tmp_path / "lab" / "run.csv")
    lab_files.one(tmp_path / "lab" / ".hidden.csv")
    (tmp_path / "lab" / "link.csv").symlink_to(tmp_path / "secret" / "other.csv")
    (tmp_path / "lab" / "round").symlink_to(tmp_path / "lab")
    code, out, _ = bring(tmp_path / "lab", "--yes")
    assert code == 0 and names_in(tmp_path / "set") == ["run"] and "a link that leads outside; passed over" in out


def test_what_is_left_out_beside_a_map_or_trial_folders_has_an_effect_or_is_refused(tmp_path, bring):
    """It was passed over in silence."""
    log, columns = lab_files.one(tmp_path / "log.csv"), tmp_path / "MAP.toml"
    assert bring(log, "--write-map", columns, out=None)[0] == 0 and bring(log, "--columns", columns)[0] == 0
    whole, name = columns.read_text(), "batt_V"
    columns.write_text(f'skip = ["{name}x"]\n{whole}')
    code, _, err = bring(log, "--columns", columns, out=tmp_path / "two")
    assert code == 2 and f"MAP.toml: skip: no column is called '{name}x'; did you mean '{name}'?; expected of " in err
    columns.write_text(whole)
    for said in (f"{name}=skip", f"{name}=cmd.c1:deg"):
        code, _, err = bring(log, "--columns", columns, "--set", said, out=tmp_path / "two")
        assert code == 2 and f"--set {name}: no effect on files that --columns maps; state it in " in err
    code, _, err = bring(tmp_path / "set", "--set", f"{name}=skip", out=tmp_path / "two")
    assert code == 2 and f"--set {name}: no effect on trial folders, which are copied; leave it out" in err


def test_a_bad_file_ends_the_import_unless_skip_bad_leaves_it_out(tmp_path, bring):
    for k in range(3):
        lab_files.one(tmp_path / "lab" / f"run{k}.csv")
    (tmp_path / "lab" / "run1.csv").write_bytes(b"\x00" * 500)
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "run1.csv:1:1: binary data" in err and "--skip-bad" in err and not (tmp_path / "set").exists()
    code, out, err = bring(tmp_path / "lab", "--yes", "--skip-bad", "--json")
    assert (
        code == 0 and names_in(tmp_path / "set") == ["run0", "run2"] and "left out" in err and "run1.csv:1:1: binary data" in err
    )
    assert list(json.loads(out.strip().split("\n")[-1])["skipped"])[0].endswith("run1.csv")


def test_names_of_trials_can_stand_in_a_path(tmp_path, bring):
    for name in ("a b/ö (1).csv", "a b/ö (2).csv", "a b/$(rm).csv"):
        lab_files.one(tmp_path / name)
    assert bring(tmp_path / "a b", "--yes")[0] == 0
    assert all(name.isascii() and not set(name) & set(" ()$/") for name in names_in(tmp_path / "set"))


def test_pipes_and_devices_are_refused(tmp_path, bring):
    os.mkfifo(tmp_path / "pipe.csv")
    for source in (tmp_path / "pipe.csv", "/dev/zero"):
        code, _, err = bring(source, "--yes")
        assert code == 2 and "is no plain file" in err


def test_the_map_in_the_docs_is_valid():
    import tomllib
    from pathlib import Path

    text = (Path(__file__).parent.parent / "docs" / "search" / "logs.md").read_text(encoding="utf-8")
    shown = text.partition("### MAP.toml")[2].split("```toml")[1].split("```")[0]
    assert set(of_dict(tomllib.loads(shown), "docs/search/logs.md").tables) == {"cmd", "pose"}
