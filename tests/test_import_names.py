"""Names of trials of several folders, the experiments that are stated of them, and names of columns that mislead."""

import lab_files
import numpy as np
import pytest

from fishmj import log
from fishmj.base.errors import ConfigError, UsageError
from fishmj.log import Trial, write_trial
from fishmj.log.importers import header
from fishmj.log.importers.gather import excitations


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def days(root, *places):
    """Folders with the files run_1 and run_2 each."""
    for place in places:
        for k in (1, 2):
            lab_files.one(root / place / f"run_{k}.csv")
    return [root / place for place in places]


def names_in(folder):
    return sorted(log.read_dataset(folder).names)


def test_trials_of_two_folders_have_their_folder_in_front(tmp_path, bring):
    monday, tuesday = days(tmp_path, "monday", "tuesday")
    assert bring(tuesday, monday, "--yes")[0] == 0
    assert names_in(tmp_path / "set") == ["monday_run_1", "monday_run_2", "tuesday_run_1", "tuesday_run_2"]


def test_folders_of_one_name_are_told_apart_by_their_parents(tmp_path, bring):
    assert bring(*days(tmp_path, "monday/logs", "tuesday/logs"), "--yes")[0] == 0
    assert names_in(tmp_path / "set") == [f"{day}_logs_run_{k}" for day in ("monday", "tuesday") for k in (1, 2)]


def test_files_of_two_folders_have_a_folder_in_front_where_names_meet(tmp_path, bring):
    days(tmp_path, "monday", "tuesday")
    assert bring(tmp_path / "monday/run_1.csv", tmp_path / "tuesday/run_1.csv", tmp_path / "tuesday/run_2.csv", "--yes")[0] == 0
    assert names_in(tmp_path / "set") == ["monday_run_1", "run_2", "tuesday_run_1"]


def test_a_trial_that_must_take_another_name_is_noted(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "run 1.csv")
    lab_files.one(tmp_path / "lab" / "run_1.csv")
    code, out, _ = bring(tmp_path / "lab", "--yes")
    assert code == 0 and names_in(tmp_path / "set") == ["run_1", "run_1_2"]
    assert "run_1.csv: its trial is called run_1_2, another one has the name run_1" in out


def test_a_folder_that_is_named_twice_is_refused(tmp_path, bring):
    (monday,) = days(tmp_path, "monday")
    code, _, err = bring(monday, monday / ".." / "monday", "--yes")
    assert code == 2 and "is named twice" in err


def test_repeats_of_two_data_sets_still_name_their_own_first(tmp_path, bring):
    for day in ("monday", "tuesday"):
        for k, first in ((1, ""), (2, "gait_1")):
            tables = {"cmd": {"t": [0.0, 0.02, 0.04], "c1": [0.0, 0.1, 0.2]}}
            write_trial(tmp_path / day / f"gait_{k}", Trial({"origin": "measured", "replicate_of": first}, tables))
    assert bring(tmp_path / "monday", tmp_path / "tuesday")[0] == 0
    data = log.read_dataset(tmp_path / "set")
    assert {name: data[name].value("replicate_of") or "" for name in data.names} == {
        "monday_gait_1": "", "monday_gait_2": "monday_gait_1", "tuesday_gait_1": "", "tuesday_gait_2": "tuesday_gait_1"
    }  # fmt: skip


def test_an_excitation_is_stated_of_all_trials_or_of_one(tmp_path, bring):
    (monday,) = days(tmp_path, "monday")
    assert bring(monday, "--yes", "--excitation", "steps", "--excitation", "run_2=gait")[0] == 0
    data = log.read_dataset(tmp_path / "set")
    assert {name: data[name].value("excitation") for name in data.names} == {"run_1": "steps", "run_2": "gait"}


def test_an_excitation_of_a_trial_that_is_not_there_is_refused(tmp_path, bring):
    (monday,) = days(tmp_path, "monday")
    code, _, err = bring(monday, "--yes", "--excitation", "run_3=gait")
    assert code == 2 and "run_3" in err and "run_2" in err and not (tmp_path / "set").exists()


@pytest.mark.parametrize("texts", [["a=gait", "a=steps"], ["gait", "steps"], ["=gait"]])
def test_an_excitation_with_two_readings_is_refused(texts):
    with pytest.raises(UsageError):
        excitations(texts)
    with pytest.raises(ConfigError, match="excitation name"):
        excitations(["a=ga it"])
    assert excitations(["a=gait", "b=gait", "steps"]) == {"a": "gait", "b": "gait", "": "steps"}


def test_the_current_is_stated_by_an_option_or_not_at_all(tmp_path, bring):
    lab_files.one(tmp_path / "in" / "swim.csv")
    for words, speed, direction in (((), None, None), (("--flow", "0.2,180"), 0.2, np.pi), (("--flow", "0,0"), 0.0, 0.0)):
        out = tmp_path / f"set{len(words)}{speed}"
        assert bring(tmp_path / "in", *words, "--yes", out=out)[0] == 0
        trial = lab_files.only(out)
        assert (trial.value("flow.speed"), trial.value("flow.direction")) == (speed, direction)
        assert trial.value("flow.known") is (True if words else None)


@pytest.mark.parametrize(
    "column",
    [
        *("x_std", "y_max", "yaw_std", "cos_yaw", "rel_x", "wall_x", "angle_x", "servo1_amplitude", "servo1_trim", "joint1_max"),
        *("joint1_acc", "tail_freq", "servo1_moving", "voltage_ref", "current_limit", "time_offset", "utc_offset"),
    ],
)
def test_a_setting_or_statistic_is_not_the_quantity_itself(column):
    assert header.role(header.parse(column), set()).places == ()


def test_a_rate_of_the_heading_is_no_heading():
    assert header.role(header.parse("theta_dot"), set()).places == ("joint.w#",)
    assert header.role(header.parse("yaw_dot"), set()).places == ("velocity.yaw_rate",)
    assert header.role(header.parse("time_min"), set()).places == ("t",)


BUS = [
    "id1_goal_deg",
    "id_1_goal",
    "ID1_GoalPosition",
    "goal_id1_deg",
    "dxl_id_1_goal",
    "dxl1_goal_position",
    "motor1_target",
    "m1_setpoint",
]


@pytest.mark.parametrize("column", BUS)
def test_a_goal_of_a_servo_on_a_bus_is_a_command(column):
    assert header.role(header.parse(column), set()).places == ("cmd.c#",)


@pytest.mark.parametrize("column", ["id1", "fish_id", "id1_x", "id1_goal_x", "id1_position", "id1_heading_deg", "target_id_1"])
def test_an_identity_of_an_animal_is_no_servo(column):
    assert header.role(header.parse(column), set()).places == ()


T = {"unix_ms": 1.76e12 + 20.0 * lab_files.N}
POSE = {**T, "blob_x_mm": 900 + lab_files.N, "blob_y_mm": 30 * lab_files.WAVE, "blob_heading_deg": 9 * lab_files.WAVE}


def test_goals_by_numbers_on_a_bus_come_in_beside_a_pose(tmp_path, bring):
    goals = {f"id{k}_goal_deg": 20 * np.roll(lab_files.WAVE, k) for k in (1, 2, 3)}
    lab_files.write(tmp_path / "lab" / "goal_positions.csv", T | goals)
    lab_files.write(tmp_path / "lab" / "overhead.csv", POSE)
    assert bring(tmp_path / "lab", "--yes")[0] == 0
    trial = lab_files.only(tmp_path / "set")
    lab_files.near(trial.tables["cmd"]["c3"], np.radians(goals["id3_goal_deg"]))


def test_columns_that_speak_of_commands_are_not_left_out_in_silence(tmp_path, bring):
    names = ["goal_front", "goal_mid", "goal_rear"]
    lab_files.write(tmp_path / "lab" / "sent.csv", T | {name: 20 * np.roll(lab_files.WAVE, len(name)) for name in names})
    lab_files.write(tmp_path / "lab" / "overhead.csv", POSE)
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "--set goal_front=cmd.c1:rad or cmd.c1:deg" in err and "=skip" in err
    one = bring(tmp_path / "lab", "--yes", "--set", "unix_ms=t:ms", "--set", "goal_front=cmd.c1:deg")
    assert one[0] == 2 and "--set goal_mid=cmd.c2" in one[2]
    said = ("--set", "unix_ms=t:ms", *(word for name in names for word in ("--set", f"{name}=skip")))
    assert bring(tmp_path / "lab", "--yes", *said)[0] == 0
    assert set(lab_files.only(tmp_path / "set").tables) == {"pose"}


def test_a_log_of_a_pose_alone_is_not_asked_about_its_commands(tmp_path, bring):
    more = {"target_depth": lab_files.WAVE, "target_speed": lab_files.WAVE, "area": lab_files.WAVE, "elongation": lab_files.WAVE}
    lab_files.write(tmp_path / "lab" / "overhead.csv", POSE | more | {"id1_area": lab_files.WAVE, "id2_area": -lab_files.WAVE})
    assert bring(tmp_path / "lab", "--yes")[0] == 0
