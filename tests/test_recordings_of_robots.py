"""Recordings of ROS and of other programs: joints by name, headings of quaternions, whole bags, and what other files are."""

import json
import math
import re
import shutil
import sqlite3
from functools import cache

import lab_files
import numpy as np
import pytest
from lab_files import near, only

from fishmj import log
from fishmj.errors import LogError
from fishmj.log import importers

ROWS = 40
START = 1_700_000_000_000_000_000  # ns
T = 0.02 * np.arange(ROWS)
ANGLES = 0.4 * np.sin(6 * T[:, None] - np.array([0.0, 1.0, 2.0]))
YAW = 2.0 + 0.1 * np.sin(6 * T)
PARTS = ("head_joint", "body_joint", "tail_joint")


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def stamp(i):
    """Time of row `i` [ns since 1970]."""
    return START + round(1e9 * T[i])


@cache
def types():
    """ROS 2's standard types."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def joint_state(names, position, velocity=(), i=0):
    """(topic, type, time [ns], CDR) of one JointState."""
    store = types()
    kinds, now = store.types, stamp(i)
    header = kinds["std_msgs/msg/Header"](
        stamp=kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9), frame_id=""
    )
    message = kinds["sensor_msgs/msg/JointState"](
        header=header,
        name=list(names),
        position=np.array(position, float),
        velocity=np.array(velocity, float),
        effort=np.zeros(0),
    )
    return "/joint_states", "sensor_msgs/msg/JointState", now, bytes(store.serialize_cdr(message, "sensor_msgs/msg/JointState"))


def database(path, messages):
    """A rosbag2 database; gives the open connection, so that a test may leave its write-ahead log beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    base = sqlite3.connect(path)
    base.execute("CREATE TABLE IF NOT EXISTS topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
    base.execute("CREATE TABLE IF NOT EXISTS messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    numbers = {}
    for topic, kind, now, data in messages:
        if topic not in numbers:
            numbers[topic] = len(numbers) + 1
            base.execute("INSERT OR IGNORE INTO topics VALUES (?, ?, ?, 'cdr')", (numbers[topic], topic, kind))
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", (numbers[topic], now, data))
    base.commit()
    return base


def bag(folder, messages, metadata=""):
    """A rosbag2 of one database."""
    database(folder / f"{folder.name}_0.db3", messages).close()
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n{metadata}")
    return folder


def swim(names=("joint_1", "joint_2", "joint_3")):
    """A message of joint states a row."""
    return [joint_state(names, ANGLES[i], i=i) for i in range(ROWS)]


def json_recording(path, message, topic="/joint_states"):
    """An MCAP file of the JSON messages `message(i)`."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=0)
        for i in range(ROWS):
            writer.add_message(channel, log_time=stamp(i), publish_time=stamp(i), data=json.dumps(message(i)).encode())
        writer.finish()
    return path


def table(path, head, row):
    """A text table of `row(i)`."""
    path.write_text("\n".join([head, *(",".join(map(str, row(i))) for i in range(ROWS))]) + "\n")
    return path


def angles_are_right(folder, columns=("j1", "j2", "j3")):
    """Every joint of the data set's one trial is as it was swum."""
    joint = only(folder).tables["joint"]
    near(np.stack([joint[c] for c in columns], 1), ANGLES)
    near(joint["t"], T)


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


# -------------------------------------------------------------------------------------------------------------- whole bags
@pytest.mark.parametrize("metadata", [True, False])
def test_parts_of_a_bag_are_read_in_the_order_of_numbers(tmp_path, bring, metadata):
    messages = swim()
    names = [f"bag_{k}.db3" for k in range(14)]
    for k, name in enumerate(names):
        database(tmp_path / "bag" / name, messages[3 * k : 3 * k + 3]).close()
    if metadata:
        lines = "".join(f"    - {name}\n" for name in names)
        (tmp_path / "bag" / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{lines}")
    assert bring(tmp_path / "bag", "--yes")[0] == 0
    angles_are_right(tmp_path / "set")


def test_numbered_recordings_that_are_hours_apart_are_no_parts(tmp_path, bring):
    for k in range(2):
        hours = [(topic, kind, now + k * 7200 * 10**9, data) for topic, kind, now, data in swim()]
        database(tmp_path / "bag" / f"swim_{k}.db3", hours).close()
    code, _, err = bring(tmp_path / "bag", "--yes")
    assert code == 2 and "swim_1.db3: begins 7199 s after the file before it ends" in err and "--trial-each" in err
    assert bring(tmp_path / "bag", "--yes", "--trial-each")[0] == 0
    assert len(log.read_dataset(tmp_path / "set")) == 2


def test_part_that_metadata_lists_and_is_absent_is_refused(tmp_path, bring):
    source = bag(tmp_path / "bag", swim(), "  relative_file_paths:\n    - bag_0.db3\n    - bag_1.db3\n")
    code, _, err = bring(source, "--yes")
    assert code == 2 and "no file 'bag_1.db3', which metadata.yaml lists" in err


def test_what_lies_beside_a_bag_and_other_parts_are_noted(tmp_path, bring):
    source = bag(tmp_path / "bag", swim())
    lab_files.one(source / "camera.csv", 40)
    code, out, _ = bring(source, "--yes")
    assert code == 0 and "a bag; passed over beside it: camera.csv; import them by themselves" in out
    shutil.rmtree(tmp_path / "set")
    database(source / "bag_1.db3", []).close()
    code, out, _ = bring(source / "bag_0.db3", "--yes")
    assert code == 0 and "bag_0.db3: one of 2 files of a bag; import the folder bag for all of it" in out


def test_fewer_messages_than_metadata_counts_are_noted(tmp_path, bring):
    count = "  topics_with_message_count:\n    - topic_metadata: {name: /joint_states}\n      message_count: 80\n"
    code, out, _ = bring(bag(tmp_path / "bag", swim(), count), "--yes")
    assert code == 0 and "/joint_states: metadata.yaml counts 80 messages, the bag holds 40: is it cut off?" in out


def logged(folder, messages):
    """A bag whose second half is in the write-ahead log only, as a killed recorder leaves it."""
    database(folder / "bag_0.db3", messages[: ROWS // 2]).close()
    base = sqlite3.connect(folder / "bag_0.db3")
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA wal_autocheckpoint=0")
    base.close()
    base = sqlite3.connect(folder / "bag_0.db3")
    base.execute("PRAGMA wal_autocheckpoint=0")
    for _, _, now, data in messages[ROWS // 2 :]:
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", (now, data))
    base.commit()
    copy = folder.with_name("killed")
    shutil.copytree(folder, copy)
    base.close()
    (copy / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n")
    return copy


def test_write_ahead_log_is_read_and_the_bag_stays_unchanged(tmp_path, bring):
    source = logged(tmp_path / "bag", swim())
    before = {path.name: path.read_bytes() for path in source.iterdir()}
    assert "bag_0.db3-wal" in before
    assert bring(source, "--yes")[0] == 0
    angles_are_right(tmp_path / "set")
    assert {path.name: path.read_bytes() for path in source.iterdir()} == before


def test_write_ahead_log_that_is_absent_or_unfinished_is_refused(tmp_path, bring):
    source = logged(tmp_path / "bag", swim())
    (source / "bag_0.db3-shm").write_bytes(b"x")
    (source / "bag_0.db3-wal").unlink()
    code, _, err = bring(source, "--yes")
    assert code == 2 and "its write-ahead log bag_0.db3-wal is absent" in err
    (source / "bag_0.db3-shm").unlink()
    (source / "bag_0.db3-journal").write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7")
    code, _, err = bring(source, "--yes")
    assert code == 2 and "bag_0.db3-journal: a write that its recorder did not finish" in err


@pytest.mark.parametrize("mode", ["file", "message"])
def test_bags_packed_with_zstd_are_read(tmp_path, bring, mode):
    import zstandard

    pack = zstandard.ZstdCompressor().compress
    messages = [(topic, kind, now, pack(data) if mode == "message" else data) for topic, kind, now, data in swim()]
    source = bag(tmp_path / "bag", messages, "  relative_file_paths: [bag_0.db3.zstd]\n" if mode == "file" else "")
    if mode == "file":
        plain = source / "bag_0.db3"
        plain.with_suffix(".db3.zstd").write_bytes(pack(plain.read_bytes()))
        plain.unlink()
    code, _, err = bring(source, "--yes")
    assert code == 0, err
    angles_are_right(tmp_path / "set")


def test_recording_without_its_last_record_is_refused(tmp_path, bring):
    from mcap.stream_reader import StreamReader

    path = lab_files.mcap_cdr(tmp_path / "a.mcap", 20, "none")
    raw = path.read_bytes()
    with open(path, "rb") as file:
        reader, ends = StreamReader(file, emit_chunks=True), []
        for _ in reader.records:
            ends.append(file.tell())
    for end in (ends[1], ends[-3], ends[-2]):  # after whole records, before the footer
        path.write_bytes(raw[:end])
        code, _, err = bring(path, "--yes")
        assert code == 2 and "a.mcap: damaged, cut off" in err and "mcap recover" in err, end


def test_headers_on_another_clock_are_stamped_by_their_receipt(tmp_path, bring):
    from mcap.writer import Writer

    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/joint_states", "/servo_commands")]
        for i in range(ROWS):
            boot = {"sec": 100, "nanosec": round(1e9 * T[i])}
            state = {"header": {"stamp": boot}, "name": PARTS, "position": list(ANGLES[i])}
            for channel, content in zip(channels, (state, {"angle": {"1": ANGLES[i, 0]}}), strict=True):
                writer.add_message(channel, stamp(i), json.dumps(content).encode(), stamp(i))
        writer.finish()
    code, out, _ = bring(tmp_path / "a.mcap", "--yes", "--set", "/servo_commands=skip")
    assert code == 0 and "/joint_states: the stamps of its headers are on another clock" in out
    angles_are_right(tmp_path / "set")


# -------------------------------------------------------------------------------------------------------------- data sets
def episodes(path, names=3):
    """A file of a LeRobot data set: two episodes of lists of joints [deg]."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    degrees = np.degrees(np.concatenate([ANGLES, 0.5 * ANGLES])).astype(np.float32)
    lists = pa.array([row.tolist() for row in degrees], pa.list_(pa.float32(), 3))
    columns = {"action": lists, "observation.state": lists, "timestamp": np.tile(T, 2).astype(np.float32)}
    pq.write_table(pa.table({**columns, "episode_index": np.repeat([0, 1], ROWS)}), path)
    return path


def test_lists_become_columns_and_episodes_trials(tmp_path, bring):
    code, out, err = bring(episodes(tmp_path / "file-000.parquet"), "--yes")
    assert code == 0 and "list column 'action' read as action.1, action.2, action.3" in out, err
    data = log.read_dataset(tmp_path / "set")
    assert sorted(data.names) == ["file-000_episode_0", "file-000_episode_1"]
    for name, size in zip(sorted(data.names), (1.0, 0.5), strict=True):
        for key, letter in (("cmd", "c"), ("joint", "j")):
            found = data[name].tables[key]
            near(np.stack([found[f"{letter}{k}"] for k in (1, 2, 3)], 1), size * ANGLES, 1e-5)


def test_elements_of_a_list_go_by_the_names_of_the_data_set(tmp_path, bring):
    episodes(tmp_path / "swims" / "data" / "chunk-000" / "file-000.parquet")
    features = {key: {"names": {"motors": ["tail.pos", "head.pos", "body.pos"]}} for key in ("action", "observation.state")}
    (tmp_path / "swims" / "meta").mkdir()
    (tmp_path / "swims" / "meta" / "info.json").write_text(json.dumps({"features": features}))
    code, out, err = bring(tmp_path / "swims", "--yes")
    assert code == 0, err
    data = log.read_dataset(tmp_path / "set")
    near(data[data.names[0]].tables["joint"]["j3"], ANGLES[:, 0], 1e-5)
    near(data[data.names[0]].tables["cmd"]["c1"], ANGLES[:, 1], 1e-5)


def test_lists_of_several_lengths_are_refused(tmp_path, bring):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"timestamp": [0.0, 0.1], "action": pa.array([[1.0], [1.0, 2.0]])}), tmp_path / "a.parquet")
    code, _, err = bring(tmp_path / "a.parquet", "--yes")
    assert code == 2 and "column 'action' holds lists of 1 to 2 numbers; expected one length" in err


# ------------------------------------------------------------------------------------------------------------- other files
@pytest.mark.parametrize(
    ("name", "start", "message"),
    [
        ("old.bag", b"#ROSBAG V2.0\n", "a ROS 1 bag, .*rosbags-convert --src old.bag --dst old "),
        ("a.mat", b"MATLAB 5.0 MAT-file", "a MATLAB file, .*writetable"),
        ("a.mat", b"\x89HDF\r\n\x1a\n", "HDF5, .*h5py"),
        ("a.csv", b"PK\x03\x04xl/workbook.xml", "a workbook of a spreadsheet, .*save each sheet as CSV"),
        ("a.xlsx", b"PK\x03\x04", "a workbook of a spreadsheet"),
        ("a.ulg", b"ULog\x01", "a PX4 log, .*ulog2csv"),
        ("a.tdms", b"TDSm", "a LabVIEW TDMS file"),
        ("a.npy", b"\x93NUMPY", "one array without names, .*numpy.savez"),
        ("a.pkl", b"\x80\x04", "a pickle, which may run code"),
        ("a.txt", b"PAR1", "a Parquet file, .*the end .parquet"),
        ("a.zip", b"PK\x03\x04", "an archive, .*unpack it"),
        ("fish.urdf", b"<robot/>", "a robot's description and no recording, .*fishmj new"),
        ("a.yaml", b"header:\n", "YAML, such as ros2 topic echo prints, .*ros2 bag record"),
    ],
)
def test_other_files_are_named_with_their_remedy(tmp_path, bring, name, start, message):
    (tmp_path / name).write_bytes(start + bytes(200))
    code, _, err = bring(tmp_path / name, "--yes")
    assert code == 2 and "\n" not in err
    assert re.search(message, err), err


def test_files_of_other_programs_in_a_folder_are_left_out_aloud(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "swim.csv", 40)
    (tmp_path / "lab" / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(200))
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 0 and "left out" in err and "old.bag: a ROS 1 bag" in err
