"""Recordings of ROS and of other programs: joints go by their names, and quaternions become headings."""

import math

import lab_files
import numpy as np
import pytest
from lab_files import near, only
from robot_recordings import (
    ANGLES,
    PARTS,
    ROWS,
    YAW,
    T,
    angles_are_right,
    bag,
    joint_state,
    json_recording,
    stamp,
    swim,
    table,
    types,
)

from fishmj.base.errors import LogError
from fishmj.log import importers


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


# ---------------------------------------------------------------------------------------------------------- joints by name
def test_names_that_change_their_order_keep_every_joint(tmp_path, bring):
    order = ((0, 1, 2), (2, 0, 1))
    messages = [joint_state([PARTS[k] for k in order[i % 2]], [ANGLES[i, k] for k in order[i % 2]], i=i) for i in range(ROWS)]
    code, _, err = bring(bag(tmp_path / "bag", messages), "--yes")
    assert code == 0, err
    angles_are_right(tmp_path / "set")


def test_joints_called_after_body_parts_count_from_the_nose(tmp_path, bring):
    messages = [joint_state(["body_joint", "head_joint", "tail_joint"], ANGLES[i, [1, 0, 2]], i=i) for i in range(ROWS)]
    assert bring(bag(tmp_path / "bag", messages), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_joint_columns_of_a_table_count_from_the_nose_too(tmp_path, bring):
    head = "t,tail_joint_measured,head_joint_measured,body_joint_measured"
    source = table(tmp_path / "a.csv", head, lambda i: (T[i], ANGLES[i, 2], ANGLES[i, 0], ANGLES[i, 1]))
    assert bring(source, "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_names_that_tell_no_order_are_asked_and_may_be_said(tmp_path, bring):
    source = bag(tmp_path / "bag", [joint_state(["rudder", "elbow", "m3"], ANGLES[i], ANGLES[i], i=i) for i in range(ROWS)])
    code, _, err = bring(source, "--yes")
    assert code == 2 and "joint.rudder: which joint is it" in err and "--set joint.rudder=joint.j1:rad or joint.j2:rad" in err
    said = ("joint.rudder=joint.j3:rad", "joint.elbow=joint.j1:rad", "joint.m3=joint.j2:rad")
    assert bring(source, "--yes", *(word for one in said for word in ("--set", one)))[0] == 0
    angles_are_right(tmp_path / "set", ("j3", "j1", "j2"))
    near(only(tmp_path / "set").tables["joint"]["w3"], ANGLES[:, 0])  # a joint's rate goes where its angle goes


@pytest.mark.parametrize("names", [["fish/joint_1", "fish/joint_2", "fish/joint_3"], ["joint_0", "joint_1", "joint_2"], []])
def test_namespaces_counts_from_zero_and_no_names_are_read(tmp_path, bring, names):
    assert bring(bag(tmp_path / "bag", swim(names)), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_joints_in_two_messages_of_one_instant_are_one_row(tmp_path, bring):
    halves = [(["joint_1", "joint_2"], slice(0, 2)), (["joint_3"], slice(2, 3))]
    messages = [joint_state(names, ANGLES[i, part], i=i) for i in range(ROWS) for names, part in halves]
    assert bring(bag(tmp_path / "bag", messages), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_gripper_among_the_joints_is_asked_and_can_be_left_out(tmp_path, bring):
    messages = [joint_state(["joint_1", "gripper", "joint_2", "joint_3"], np.insert(ANGLES[i], 1, 0.7), i=i) for i in range(ROWS)]
    source = bag(tmp_path / "bag", messages)
    assert bring(source, "--yes")[0] == 2
    assert bring(source, "--yes", "--set", "joint.gripper=skip")[0] == 0
    angles_are_right(tmp_path / "set")


def test_messages_without_names_beside_named_ones_are_asked(tmp_path, bring):
    source = bag(tmp_path / "bag", [joint_state(PARTS if i % 2 else (), ANGLES[i], i=i) for i in range(ROWS)])
    code, _, err = bring(source, "--yes")
    assert code == 2 and "joint.1: messages without names beside messages that name their joints" in err


@pytest.mark.parametrize(
    ("names", "position", "message"),
    [
        (["joint_1", "joint_2"], [0.1], "/joint_states[0]: 1 positions for 2 names"),
        (["joint_1", "joint_1"], [0.1, 0.2], "/joint_states[0]: joint 'joint_1' is named twice"),
    ],
)
def test_messages_whose_names_do_not_fit_are_refused(tmp_path, bring, names, position, message):
    code, _, err = bring(bag(tmp_path / "bag", [joint_state(names, position, i=i) for i in range(3)]), "--yes")
    assert code == 2 and message in err and not (tmp_path / "set").exists()


def test_short_velocity_list_is_left_out_with_a_note(tmp_path, bring):
    source = bag(tmp_path / "bag", [joint_state(PARTS, ANGLES[i], [0.1], i=i) for i in range(ROWS)])
    code, out, _ = bring(source, "--yes")
    assert code == 0 and "velocity not read, its list is not as long as that of the names, in 40 of 40 messages" in out
    assert "w1" not in only(tmp_path / "set").tables["joint"]


def test_degrees_in_a_joint_state_are_asked(tmp_path, bring):
    source = bag(tmp_path / "bag", [joint_state(PARTS, np.degrees(ANGLES[i]), i=i) for i in range(ROWS)])
    code, _, err = bring(source, "--yes")
    assert code == 2 and "more than a turn" in err and "joint.head_joint=joint.j1:deg" in err


def test_names_in_json_messages_are_followed(tmp_path, bring):
    def message(i):
        order = ((0, 1, 2), (1, 2, 0))[i % 2]
        return {"name": [PARTS[k] for k in order], "position": [ANGLES[i, k] for k in order], "velocity": [], "effort": []}

    assert bring(json_recording(tmp_path / "a.mcap", message), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_names_in_a_list_of_objects_are_followed(tmp_path, bring):
    def message(i):
        return {"joints": [{"name": PARTS[k], "position": ANGLES[i, k]} for k in ((0, 1, 2), (1, 2, 0))[i % 2]]}

    assert bring(json_recording(tmp_path / "a.mcap", message, "/feedback"), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_numbers_in_a_list_of_objects_are_followed(tmp_path, bring):
    def message(i):
        return {"servos": [{"id": k + 1, "position": ANGLES[i, k]} for k in ((0, 1, 2), (2, 0, 1))[i % 2]]}

    assert bring(json_recording(tmp_path / "a.mcap", message, "/servo_states"), "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def trajectory(i, points=1):
    """(topic, type, time [ns], CDR) of a JointTrajectory of two joints in the order 2, 1."""
    kinds, name = types().types, "trajectory_msgs/msg/JointTrajectory"
    none, at = np.zeros(0), kinds["builtin_interfaces/msg/Duration"](sec=0, nanosec=20_000_000)
    point = kinds["trajectory_msgs/msg/JointTrajectoryPoint"](ANGLES[i, [1, 0]], none, none, none, at)
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](0, 0), "")  # 0: begin at once
    message = kinds[name](header, ["joint_2", "joint_1"], [point] * points)
    return "/controller/joint_trajectory", name, stamp(i), bytes(types().serialize_cdr(message, name))


def test_trajectories_of_one_point_are_commands_by_their_names(tmp_path, bring):
    code, _, err = bring(bag(tmp_path / "bag", [trajectory(i) for i in range(ROWS)]), "--yes")
    assert code == 0, err
    cmd = only(tmp_path / "set").tables["cmd"]
    near(np.stack([cmd["c1"], cmd["c2"]], 1), ANGLES[:, :2])
    near(cmd["t"], T)


def test_trajectories_of_several_points_are_asked(tmp_path, bring):
    code, _, err = bring(bag(tmp_path / "bag", [trajectory(i, 2) for i in range(ROWS)]), "--yes")
    assert code == 2 and "command.joint_2: trajectories of several points" in err


@pytest.mark.parametrize(("late", "code"), [(0, 0), (1, 2)])
def test_topics_of_one_number_for_each_joint_are_put_together(tmp_path, bring, late, code):
    """Sent side by side they are one table; where one has half the rate, none is lost in silence."""
    name = "std_msgs/msg/Float64"
    one = lambda i, k: bytes(types().serialize_cdr(types().types[name](ANGLES[i, k - 1]), name))
    sent = [(i, k) for i in range(ROWS) for k in (2, 3, 1) if not (late and k == 3 and i % 2)]
    messages = [(f"/joint{k}_controller/command", name, stamp(i) + 300_000 * k, one(i, k)) for i, k in sent]
    got, out, err = bring(bag(tmp_path / "bag", messages), "--yes")
    assert got == code, err
    if code:
        assert "/joint2_controller/command" in err and "--set" in err
        return
    cmd = only(tmp_path / "set").tables["cmd"]
    near(np.stack([cmd["c1"], cmd["c2"], cmd["c3"]], 1), ANGLES)
    near(cmd["t"], T)
    assert "are one row, stamped by the last, in 40 of 40 messages" in out


@pytest.mark.parametrize(("column", "names"), [("joint_name", ("head", "tail")), ("servo_id", (1, 2))])
def test_tables_with_a_row_for_each_joint_are_refused(tmp_path, bring, column, names):
    row = lambda i: (T[i // 2], names[i % 2], ANGLES[i // 2, i % 2])
    code, _, err = bring(table(tmp_path / "a.csv", f"t_s,{column},measured_angle_rad", row), "--yes")
    assert code == 2 and f"column '{column}' names the joint of each row" in err


def test_stamps_of_publishers_that_overtake_one_another_are_sorted(tmp_path, bring):
    messages = [joint_state(("joint_1", "joint_2", "joint_3"), ANGLES[i ^ 1], i=i ^ 1) for i in range(ROWS)]
    messages = [(topic, kind, stamp(k), data) for k, (topic, kind, _, data) in enumerate(messages)]
    code, out, err = bring(bag(tmp_path / "bag", messages), "--yes")
    assert code == 0 and "sorted by stamp, in 20 of 40 messages" in out, err
    angles_are_right(tmp_path / "set")


def test_names_in_columns_of_an_echoed_topic_are_followed(tmp_path, bring):
    def row(i):
        order = ((0, 1, 2), (2, 0, 1))[i % 2]
        return (stamp(i) + 10**6, i, stamp(i), "", *(PARTS[k] for k in order), *(round(ANGLES[i, k], 9) for k in order))

    lists = ",".join(f"field.{key}{k}" for key in ("name", "position") for k in range(3))
    source = table(tmp_path / "joint_states.csv", f"%time,field.header.seq,field.header.stamp,field.header.frame_id,{lists}", row)
    code, _, err = bring(source, "--yes")
    assert code == 0, err
    angles_are_right(tmp_path / "set")


def test_mapping_takes_joints_by_name(tmp_path):
    order = ((0, 1, 2), (2, 0, 1))
    messages = [joint_state([PARTS[k] for k in order[i % 2]], [ANGLES[i, k] for k in order[i % 2]], i=i) for i in range(ROWS)]
    source = bag(tmp_path / "bag", messages)
    topics = tmp_path / "MAP.toml"
    lines = [f'{ours} = "position.{name}"' for ours, name in zip(("j1", "j2", "j3"), PARTS, strict=True)]
    topics.write_text(f'[tables.joint]\ntopic = "/joint_states"\ncolumns = {{ {", ".join(lines)} }}\n')
    joint = importers.read(source, topics=topics)["bag"].tables["joint"]
    near(np.stack([joint[c] for c in ("j1", "j2", "j3")], 1), ANGLES)
    topics.write_text('[tables.joint]\ntopic = "/joint_states"\ncolumns = { j1 = "position.0" }\n')
    with pytest.raises(LogError, match=r"\[1\]: position.0 is of joint 'tail_joint', .* name the joint .*position.head_joint"):
        importers.read(source, topics=topics)
    topics.write_text('[tables.joint]\ntopic = "/joint_states"\ncolumns = { j1 = "position.nose" }\n')
    with pytest.raises(LogError, match="no message of topic '/joint_states' names all joints of the mapping"):
        importers.read(source, topics=topics)


def test_two_robots_in_one_bag_are_asked_and_one_may_be_left_out(tmp_path, bring):
    messages = [
        (f"/fish{k}{topic}", kind, now, data)
        for i in range(ROWS)
        for k, size in ((1, 0.5), (2, 1.0))
        for topic, kind, now, data in [joint_state(("joint_1", "joint_2", "joint_3"), size * ANGLES[i], i=i)]
    ]
    source = bag(tmp_path / "bag", messages)
    code, _, err = bring(source, "--yes")
    assert code == 2 and "--set /fish2/joint_states=skip" in err
    assert bring(source, "--yes", "--set", "/fish1/joint_states=skip")[0] == 0
    angles_are_right(tmp_path / "set")


# ------------------------------------------------------------------------------------------------------------- quaternions
@pytest.mark.parametrize(
    "parts",
    [
        ("field.pose.orientation.x", "field.pose.orientation.y", "field.pose.orientation.z", "field.pose.orientation.w"),
        ("qw", "qx", "qy", "qz"),
        ("quat_x", "quat_y", "quat_z", "quat_w"),
        ("/camera/orientation/x", "/camera/orientation/y", "/camera/orientation/z", "/camera/orientation/w"),
        ("RX", "RY", "RZ", "RW"),
    ],
)
def test_four_columns_of_a_quaternion_become_a_heading(tmp_path, bring, parts):
    values = {"x": 0 * T, "y": 0 * T, "z": np.sin(YAW / 2), "w": np.cos(YAW / 2)}
    q = [values[part[-1].lower()] for part in parts]
    row = lambda i: (T[i], 0.1 * T[i], 0.2 * T[i], *(round(part[i], 5) for part in q))
    code, _, err = bring(table(tmp_path / "camera.csv", f"t_s,cam_x,cam_y,{','.join(parts)}", row), "--yes")
    assert code == 0, err
    near(only(tmp_path / "set").tables["pose"]["yaw"], YAW, 1e-4)


def test_echoed_pose_is_read_by_its_header_stamp(tmp_path, bring):
    fields = "position.x position.y position.z orientation.x orientation.y orientation.z orientation.w".split()
    head = "%time,field.header.seq,field.header.stamp,field.header.frame_id," + ",".join(f"field.pose.{f}" for f in fields)
    row = lambda i: (stamp(i) + 10**7, i, stamp(i), "tank", T[i], 0.1, 0, 0, 0, math.sin(YAW[i] / 2), math.cos(YAW[i] / 2))
    code, _, err = bring(table(tmp_path / "pose.csv", head, row), "--yes")
    assert code == 0, err
    trial = only(tmp_path / "set")
    near(trial.tables["pose"]["yaw"], YAW)
    assert trial.meta["clock"]["pose"] == "field.header.stamp of the file"


def test_echoed_odometry_gives_its_pose_and_no_place_of_its_twist(tmp_path, bring):
    pose = [
        f"field.pose.pose.{f}" for f in "position.x position.y orientation.x orientation.y orientation.z orientation.w".split()
    ]
    twist = [f"field.twist.twist.{f}" for f in "linear.x linear.y angular.z".split()]
    row = lambda i: (stamp(i), T[i], 0.1, 0, 0, math.sin(YAW[i] / 2), math.cos(YAW[i] / 2), 1.0, 0.2, 0.3)
    code, _, err = bring(table(tmp_path / "odom.csv", ",".join(["%time", *pose, *twist]), row), "--yes")
    assert code == 0, err
    trial = only(tmp_path / "set")
    assert set(trial.tables) == {"pose"}
    near(trial.tables["pose"]["x"], T)
    near(trial.tables["pose"]["yaw"], YAW)


def test_echoed_array_of_commands_is_read(tmp_path, bring):
    row = lambda i: (stamp(i), 0, *np.round(ANGLES[i], 9))
    head = "%time,field.layout.data_offset,field.data0,field.data1,field.data2"
    code, _, err = bring(table(tmp_path / "servo_commands.csv", head, row), "--yes")
    assert code == 0, err
    near(only(tmp_path / "set").tables["cmd"]["c3"], ANGLES[:, 2])


def test_rows_of_numbers_without_names_are_refused(tmp_path, bring):
    row = lambda i: (1_700_000_000, i, "tank", T[i], 0.1, 0.0, 0.0, 0.0, 0.1, 0.99)
    source = tmp_path / "pose.csv"
    source.write_text("\n".join(",".join(map(str, row(i))) for i in range(ROWS)) + "\n")
    code, _, err = bring(source, "--yes")
    assert code == 2 and "the first row holds numbers; write the names of the columns there" in err


@pytest.mark.parametrize(
    ("names", "q", "message"),
    [
        ("q0,q1,q2,q3", (0.6, 0.0, 0.0, 0.8), "do not say which is w"),
        ("qx,qy,qz,qw", (0.0, 0.0, 1.2, 1.6), "has the norm 2"),
        ("qx,qy,qz,qw", (0.0, 0.8, 0.0, 0.6), "is another axis up, or is w first"),
    ],
)
def test_doubtful_quaternions_are_never_taken(tmp_path, bring, names, q, message):
    code, _, err = bring(table(tmp_path / "a.csv", f"t_s,cam_x,cam_y,{names}", lambda i: (T[i], T[i], 0.1, *q)), "--yes")
    assert code == 2 and message in err and not (tmp_path / "set").exists()


def test_orientation_that_was_never_set_is_no_heading(tmp_path, bring):
    zero = dict.fromkeys("xyzw", 0)
    source = json_recording(
        tmp_path / "a.mcap", lambda i: {"position": {"x": T[i], "y": 0.1}, "orientation": zero}, "/camera/pose"
    )
    code, out, _ = bring(source, "--yes")
    assert code == 0 and "an orientation that was not set, no heading" in out
    assert set(only(tmp_path / "set").tables) == {"markers"}


def test_mapping_takes_the_yaw_of_a_quaternion(tmp_path):
    turned = lambda i: {"x": 0, "y": 0, "z": math.sin(YAW[i] / 2), "w": math.cos(YAW[i] / 2)}
    source = json_recording(tmp_path / "a.mcap", lambda i: {"p": {"x": T[i], "y": 0.1}, "q": turned(i)}, "/camera")
    (tmp_path / "a.toml").write_text('[tables.pose]\ntopic = "/camera"\ncolumns = { x = "p.x", y = "p.y", yaw = "q.yaw" }\n')
    near(importers.read(source)["a"].tables["pose"]["yaw"], YAW)


@pytest.mark.parametrize("mixed", [True, False])
@pytest.mark.parametrize(
    ("topic", "field", "names"),
    [
        *((topic, field, "AB") for topic in ("/camera/fish", "/camera/pose") for field in ("fish_id", "name", "child_frame_id")),
        *((topic, "fish_id", (1, 2)) for topic in ("/camera/fish", "/camera/pose")),
        ("/camera/fish", "header", "AB"),
    ],
)
def test_two_robots_in_one_topic_are_refused_by_their_names(field, names, topic, mixed, bring, tmp_path):
    """By topics that are named like tables, too; messages of both alternate, or those of the second follow."""

    def message(i, second):
        name = second if (i % 2 if mixed else 2 * i >= ROWS) else names[0]
        place = {"x": 1.2 + 0.12 * T[i], "y": 0.6 + 0.005 * np.sin(T[i]), "yaw": YAW[i]}
        return {field: {"frame_id": name} if field == "header" else name, **place}

    for name, second, code in (("two", names[1], 2), ("one", names[0], 0)):
        path = json_recording(tmp_path / f"{name}.mcap", lambda i, second=second: message(i, second), topic)
        got, _, err = bring(path, "--yes", out=tmp_path / f"out_{name}")
        assert got == code and (f"holds 2 values ({names[0]}, {names[1]}): several trials" in err) == (code == 2), err


def test_two_robots_of_a_bag_are_told_by_the_frames_of_their_messages(bring, tmp_path):
    of = lambda *frames: [joint_state(PARTS, ANGLES[i], i=i, frame=frames[i % 2]) for i in range(ROWS)]
    code, _, err = bring(bag(tmp_path / "two", of("fish_1", "fish_2")), "--yes")
    assert code == 2 and "/joint_states: column 'frame_id' holds 2 values (fish_1, fish_2)" in err
    assert bring(tmp_path / "two", "--yes", "--set", "frame_id=skip", out=tmp_path / "skipped")[0] == 0
    assert bring(bag(tmp_path / "one", of("fish_1", "fish_1")), "--yes", out=tmp_path / "one_set")[0] == 0
