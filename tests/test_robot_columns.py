"""Columns of a robot's logs: guessed by whole words of their names, in the units that the file states."""

import numpy as np
import pytest

from fishmj.base.errors import LogError
from fishmj.gap.records.robot_logs import guess_columns, read_robot_logs, read_sheet
from fishmj.log.importers import table_forms

N = 0.004 * np.arange(500)  # s


def test_columns_are_guessed_from_a_public_log():
    names = "time,pos_meas1,pos_meas2,vel_meas1,vel_meas2,pos_filt1,pos_filt2,vel_filt1,vel_filt2,tau_con1,tau_con2"
    names += ",tau_fric1,tau_fric2,tau_meas1,tau_meas2"
    found = guess_columns(names.split(","), ("shoulder", "elbow"), ("shoulder", "elbow"), torques=True)
    assert found.time.column == "time"
    assert [c.column for c in found.joint.values()] == ["pos_meas1", "pos_meas2"]
    assert [c.column for c in found.actuator.values()] == ["tau_con1", "tau_con2"]


def test_ambiguous_columns_are_left_to_a_map():
    with pytest.raises(LogError, match="cmd_a1 or cmd_b1|cmd_b1 or cmd_a1"):
        guess_columns(["t", "q1", "q2", "cmd_a1", "cmd_a2", "cmd_b1", "cmd_b2"], ("s", "e"), ("s", "e"), torques=True)


@pytest.mark.parametrize(
    "names, joints, position, command",
    [
        ("t tau_a tau_b pos_a pos_b", "a b", "pos_a pos_b", "tau_a tau_b"),  # not the a of tau
        ("t tau_a tau_tau pos_a pos_tau", "a tau", "pos_a pos_tau", "tau_a tau_tau"),
        ("t left_hip.pos hip.pos tau_leftHip tau_hip", "hip left_hip", "hip.pos left_hip.pos", "tau_hip tau_leftHip"),
        ("t q_j1 q_j10 cmd_j1 cmd_j10", "j1 j10", "q_j1 q_j10", "cmd_j1 cmd_j10"),
        ("t a b tau_a tau_b", "a b", "a b", "tau_a tau_b"),
        ("t a b pos_a pos_b tau_a tau_b", "a b", "pos_a pos_b", "tau_a tau_b"),
        ("t q_wrist qd_wrist speed_wrist[rad/s] T1 tau_wrist", "wrist", "q_wrist", "tau_wrist"),
    ],
)
def test_joint_is_found_by_whole_words_of_a_name(names, joints, position, command):
    found = guess_columns(names.split(), joints.split(), joints.split(), torques=True)
    assert [c.column for c in found.joint.values()] == position.split()
    assert [c.column for c in found.actuator.values()] == command.split()
    assert found.time.column == "t" and not any(c.unit for c in found.joint.values())


@pytest.mark.parametrize(
    "names",
    [
        "t q_shoulder q_elbow shoulder_cmd elbow_cmd",
        "t pos_shoulder_joint pos_elbow_joint cmd_shoulder_servo cmd_elbow_servo",
        "t shoulder elbow cmd_shoulder cmd_elbow",
        "t q1 q2 cmd1 cmd2",
    ],
)
def test_names_of_joints_are_found_for_their_actuators(names):
    """Joint `elbow_joint`, driven by `elbow_servo`: generic words of a name need not stand in a column's."""
    joints, servos = ("shoulder_joint", "elbow_joint"), ("shoulder_servo", "elbow_servo")
    found = guess_columns(names.split(), joints, servos, torques=False, driven=joints)
    _, *position, command, last = names.split()
    assert [c.column for c in found.joint.values()] == position and list(found.joint) == list(joints)
    assert [c.column for c in found.actuator.values()] == [command, last] and list(found.actuator) == list(servos)


def test_commands_named_after_the_driven_joint_are_found():
    found = guess_columns("t q_hip q_knee hip_cmd knee_cmd".split(), ("hip", "knee"), ("m7", "m3"), False, driven=("hip", "knee"))
    assert [c.column for c in found.actuator.values()] == ["hip_cmd", "knee_cmd"]


@pytest.mark.parametrize("column", ["i_elbow", "iq_elbow", "i_1", "current_elbow"])
def test_measured_currents_are_doubted(column):
    found = guess_columns("t q_elbow tau_elbow".split(), ("elbow",), ("elbow",), torques=True)
    map_ = {"elbow": found.actuator["elbow"].model_copy(update={"column": column})}
    assert "commands of elbow are measured, not sent" in found._replace(actuator=map_).doubts()[0]


@pytest.mark.parametrize(
    "names, why",
    [
        ("t pos_a pos-a pos_b tau_a tau_b", "a: pos_a or pos-a"),
        ("t time pos_a pos_b tau_a tau_b", "stamps: t or time"),
        ("t pos_a[rad/s] pos_b[rad/s] tau_a tau_b", "no columns for the positions"),
        ("t pos_a pos_b tau_a[mA] tau_b[mA]", "no columns for the commands"),
    ],
)
def test_two_columns_for_one_site_or_a_wrong_unit_are_refused(names, why):
    with pytest.raises(LogError, match=why):
        guess_columns(names.split(), ("a", "b"), ("a", "b"), torques=True)


def test_units_that_a_file_states_beside_its_names_are_taken(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time,q1,q2,tau1,tau2\nms,deg,deg,mN m,mN m\n" + "".join(f"{10 * k},90,{k},100,0\n" for k in range(30)))
    sheet = read_sheet(log)
    units = {name: own.units.get(column, "") for name, (own, column) in sheet.columns.items()}
    columns = guess_columns(list(sheet.columns), ("s", "e"), ("s", "e"), True, units)
    (trial,), _ = read_robot_logs([log], columns)
    assert trial.table("cmd")["t"][1] == pytest.approx(0.01)
    assert trial.table("joint")["j1"][0] == pytest.approx(np.pi / 2) and trial.table("cmd")["c1"][0] == pytest.approx(0.1)


def test_unit_that_another_file_states_is_not_overlooked(tmp_path):
    rows = "".join(f"{k / 100},{k / 30},0.2,1,2\n" for k in range(30))
    (tmp_path / "a.csv").write_text("t,q1,q2,tau1,tau2\n" + rows)
    (tmp_path / "b.csv").write_text("t,q1,q2,tau1,tau2\ns,deg,deg,,\n" + rows)
    columns = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    trials, broken = read_robot_logs([tmp_path / "a.csv", tmp_path / "b.csv"], columns)
    assert [trial.name for trial in trials] == ["a"] and "column 'q1': the file says deg, expected rad" in broken["b.csv"]


@pytest.mark.parametrize("values, told", [(100 * np.sin(3 * N), "turns to 100 rad"), (50 * np.sin(5 * N), "turns at 2.. rad/s")])
def test_angles_beyond_any_joint_are_no_radians_unless_they_are_said_to_be(tmp_path, values, told):
    log = tmp_path / "log.csv"
    log.write_text("t,q1,q2,tau1,tau2\n" + "".join(f"{t},{q},0.2,1,2\n" for t, q in zip(N, values, strict=True)))
    guess = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    with pytest.raises(LogError, match=f"joint s {told}; is q1 in degrees, of a motor before its gear"):
        read_robot_logs([log], guess)
    said = guess._replace(joint=guess.joint | {"s": guess.joint["s"].model_copy(update={"unit": "rad"})})
    assert len(read_robot_logs([log], said)[0]) == 1


def test_log_under_two_names_is_read_once(tmp_path):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t,q1,q2,tau1,tau2\n" + "".join(f"{k / 100},{k / 30},0.2,1,2\n" for k in range(30)))
    columns = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    trials, broken = read_robot_logs(sorted(tmp_path.glob("*.csv")), columns)
    assert [trial.name for trial in trials] == ["a"] and "has exactly the readings of a" in broken["b.csv"]


def test_stamps_that_go_back_are_named_with_their_row(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,q1,q2,tau1,tau2\n" + "".join(f"{k % 20 / 100},0.1,0.2,1,2\n" for k in range(30)))
    with pytest.raises(LogError, match="do not increase: 0 s after 0.19 s, row 21; .* where the clock restarts"):
        read_robot_logs([log], guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True))


def test_stamps_in_another_unit_than_seconds_are_refused(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,q1,q2,tau1,tau2\n" + "".join(f"{4 * k},0.1,0.2,1,2\n" for k in range(30)))
    with pytest.raises(LogError, match='row every 4 s.*unit = "ms"'):
        read_robot_logs([log], guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True))


def test_column_of_a_position_servo_is_a_position():
    found = guess_columns(["time", "hip_pos", "hip_pos_target", "hip_torque"], ("hip",), ("hip",), torques=False)
    assert found.joint["hip"].column == "hip_pos" and found.actuator["hip"].column == "hip_pos_target"


def test_a_slow_encoder_is_read_once_and_blank_rows_are_counted(tmp_path):
    """Held values were read as measurements, each up to four rows old; rows of a blank went without a word."""
    t = 0.004 * np.arange(1000)
    held = (np.arange(1000) // 5) * 5
    rows = ["t,cmd_shoulder,cmd_elbow,pos_shoulder,pos_elbow"]
    for i, k in enumerate(held):
        sent = "" if 100 <= i < 130 else f"{np.sin(9 * t[i]):.6f}"
        rows.append(f"{t[i]:.4f},{sent},{np.cos(7 * t[i]):.6f},{np.sin(5 * t[k]):.6f},{np.cos(6 * t[k]):.6f}")
    (tmp_path / "arm.csv").write_text("\n".join(rows) + "\n")
    table = read_sheet(tmp_path / "arm.csv")
    columns = guess_columns(list(table.columns), ["shoulder", "elbow"], ["shoulder", "elbow"], torques=True)
    (trial,), _ = read_robot_logs([tmp_path / "arm.csv"], columns)
    np.testing.assert_allclose(trial.tables["joint"]["t"], t[::5])
    assert "arm: cmd: 30 of 1000 rows left out, blank in one of the columns" in trial.notes
    assert any("joint: each value stands in 5 rows: 50 Hz written at 250 Hz" in note for note in trial.notes)


@pytest.mark.parametrize(("column", "unit"), [("rad_q#", ""), ("mrad_q#", "mrad"), ("q#_deg", "deg"), ("q#", "deg")])
def test_a_column_that_says_its_unit_outweighs_its_topic(column, unit):
    names = [f"/arm_deg:{column}".replace("#", str(k)) for k in (1, 2)] + [f"/arm_deg:tau{k}" for k in (1, 2)]
    found = guess_columns(["t", *names], ("s", "e"), ("s", "e"), torques=True)
    assert [c.unit for c in found.joint.values()] == [unit] * 2


def test_commands_and_positions_of_two_clocks_that_share_little_are_refused(tmp_path):
    """Arrays of two lengths are refused unless a map states the unit of both clocks, or both are dated."""
    sent, read = 0.02 * np.arange(5000), 0.02 * np.arange(300)
    arrays = {f"tau{k}": np.sin(k * sent) for k in (1, 2)} | {f"q{k}": np.sin(k * read) for k in (1, 2)}
    for name, zero in (("log", 0.0), ("dated", 1.7e9)):
        np.savez(tmp_path / f"{name}.npz", t=zero + sent, time=zero + read, **arrays)
    table = read_sheet(tmp_path / "log.npz")
    columns = guess_columns([n for n in table.columns if n != "time"], ("s", "e"), ("s", "e"), torques=True)
    with pytest.raises(LogError, match="commands from 0 to 99.98 s, positions from 0 to 5.98 s: they share 5.98 s; expected"):
        read_robot_logs([tmp_path / "log.npz"], columns)
    said = columns._replace(time=columns.time.model_copy(update={"unit": "s"}))
    assert len(read_robot_logs([tmp_path / "log.npz"], said)[0]) == 1
    dated = guess_columns([n.replace("log", "dated") for n in table.columns if n != "time"], ("s", "e"), ("s", "e"), torques=True)
    assert len(read_robot_logs([tmp_path / "dated.npz"], dated)[0]) == 1


def test_two_robots_in_one_log_are_refused(tmp_path):
    rows = [f"{k % 50 / 100},0.1,0.2,1,2,{'AB'[k // 50]}" for k in range(100)]
    (tmp_path / "log.csv").write_text("\n".join(["t,q1,q2,tau1,tau2,robot", *rows]) + "\n")
    columns = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    with pytest.raises(LogError, match=r"'robot' holds 2 values \(A, B\): several trials or robots in one file; .* for each$"):
        read_robot_logs([tmp_path / "log.csv"], columns)


def test_stamps_in_the_digits_of_a_clock_are_refused(tmp_path):
    t = 55 + 0.02 * np.arange(400)
    rows = [f"{v // 60:.0f}{v % 60:05.2f},{np.sin(v):.5f},{np.cos(v):.5f},1,2" for v in t]
    (tmp_path / "log.csv").write_text("\n".join(["t,q1,q2,tau1,tau2", *rows]) + "\n")
    columns = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    with pytest.raises(LogError, match="log.csv:252:t: its digits are those of a clock, 100 after 59.98; expected seconds"):
        read_robot_logs([tmp_path / "log.csv"], columns)


def test_digits_of_a_clock_are_looked_for_once_a_log(tmp_path, monkeypatch):
    """Commands and positions have one column of stamps."""
    looked = []
    monkeypatch.setattr(table_forms, "clock_digits", lambda stamps, columns=(): looked.append(len(stamps)))
    rows = [f"{v:.3f},{np.sin(v):.5f},{np.cos(v):.5f},1,2" for v in N]
    (tmp_path / "log.csv").write_text("\n".join(["t,q1,q2,tau1,tau2", *rows]) + "\n")
    columns = guess_columns("t q1 q2 tau1 tau2".split(), ("s", "e"), ("s", "e"), torques=True)
    (log,), _ = read_robot_logs([tmp_path / "log.csv"], columns)
    assert set(log.tables) == {"cmd", "joint"} and looked == [len(N)]
