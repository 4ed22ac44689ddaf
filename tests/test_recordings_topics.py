"""Topics of a recording: those that are named like tables, those beside them, their clocks, and mappings of topics."""

import json

import lab_files
import numpy as np
import pytest
from lab_files import near, only
from robot_recordings import (
    ANGLES,
    ROWS,
    START,
    YAW,
    T,
    angles_are_right,
    bag,
    json_recording,
    json_topics,
    stamp,
    types,
)

from fishmj.base.errors import LogError
from fishmj.log import importers
from fishmj.log.importers import message_sheets
from fishmj.log.importers.decoding import TopicChannel

JOINTS = ("joint_1", "joint_2", "joint_3")


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


def pose(i):
    return {"x": 1.2 + 0.12 * T[i], "y": 0.6 + 0.01 * T[i], "yaw": YAW[i]}


def joint(i):
    return {f"j{k + 1}": ANGLES[i, k] for k in range(3)}


def servo_states(i):
    return {"name": JOINTS, "position": [*ANGLES[i]]}


def stamped(i, late=0):
    """A header of a message that was taken `late` ns before row `i`."""
    return {"header": {"stamp": {"sec": (stamp(i) - late) // 10**9, "nanosec": (stamp(i) - late) % 10**9}, "frame_id": "tank"}}


# ------------------------------------------------------------------------------------- beside topics that are named like tables
@pytest.mark.parametrize("other", ["/servo_states", "/a/pose", "/imu/raw"])
def test_topics_beside_those_named_like_tables_are_asked_about(other, tmp_path, bring):
    def imu(i):
        return {"linear_acceleration": {"x": 0.1 * i, "y": 0.2}, "angular_velocity": {"z": 0.1 * np.sin(i)}, "acc_x": 0.1 * i}

    messages = {"/servo_states": servo_states, "/a/pose": pose, "/imu/raw": imu}[other]
    source = json_topics(tmp_path / "a.mcap", {"/camera/pose": pose, other: messages})
    code, _, err = bring(source, "--yes")
    assert code == 2 and "only topics that are named like tables are read" in err and f"--set {other}=skip" in err, err
    with pytest.raises(LogError, match="only topics that are named like tables are read"):
        importers.read(source)
    code, out, err = bring(source, "--yes", "--set", f"{other}=skip")
    assert code == 0 and f"{other}: left out, as --set says" in out, err
    near(only(tmp_path / "set").tables["pose"]["yaw"], YAW)


def test_all_topics_are_read_by_their_columns_where_the_user_says_so(tmp_path, bring):
    source = json_topics(tmp_path / "a.mcap", {"/camera/pose": pose, "/servo_states": servo_states})
    code, _, err = bring(source, "--yes", "--format", "table")
    assert code == 0, err
    angles_are_right(tmp_path / "set")
    assert set(only(tmp_path / "set").tables) == {"joint", "pose"}


def test_topics_that_hold_nothing_of_a_table_are_noted(tmp_path, bring):
    others = {"/rosout": lambda i: {"msg": "a"}, "/load": lambda i: {"cpu_share": 0.5}}
    code, out, err = bring(json_topics(tmp_path / "a.mcap", {"/camera/pose": pose} | others), "--yes")
    assert code == 0, err
    assert "/rosout: no number in its 40 messages; left out" in out
    assert "/load: not read, beside topics that are named like tables: cpu_share" in out


def test_statements_on_columns_of_a_recording_read_by_topics_are_refused(tmp_path, bring):
    """They had no effect."""
    code, _, err = bring(json_recording(tmp_path / "a.mcap", pose, "/camera/pose"), "--yes", "--set", "x=pose.y:m")
    assert code == 2 and "--set x: no effect on a recording that is read by its topics; --format table reads it" in err


# --------------------------------------------------------------------------------------------------- fields of such a topic
def test_stamps_of_headers_are_the_clock_of_a_topic_named_like_a_table(tmp_path, bring):
    late = lambda i: stamped(i, late=30_000_000 + 1_000_000 * (i % 3)) | pose(i)
    assert bring(json_topics(tmp_path / "a.mcap", {"/camera/pose": late, "/joint": joint}), "--yes")[0] == 0
    trial = only(tmp_path / "set")
    assert trial.meta["clock"] == {"joint": "log_time", "pose": "header.stamp"}
    near(trial.tables["joint"]["t"] - trial.tables["pose"]["t"], 0.03 + 0.001 * (np.arange(ROWS) % 3))


@pytest.mark.parametrize(
    ("header", "note"),
    [
        (lambda i: {"header": {"frame_id": "tank"}}, ""),
        (lambda i: stamped(i) if i else {}, "no stamp in its header, so that all are stamped by their receipt, in 1 of 40"),
        (lambda i: {"header": {"stamp": {"sec": 5, "nanosec": 10**7 * i}}}, "the stamps of its headers are on another clock"),
        (lambda i: {"header": {"stamp": stamp(i) / 1e9 - 0.1}}, "its header's stamp is no {sec, nanosec}"),
    ],
)
def test_headers_whose_stamps_are_not_read_are_told(header, note, tmp_path, bring):
    source = json_topics(tmp_path / "a.mcap", {"/camera/pose": lambda i: header(i) | pose(i), "/joint": joint})
    code, out, err = bring(source, "--yes")
    assert code == 0 and f"/camera/pose: {note}" * bool(note) in out, err
    trial = only(tmp_path / "set")
    near(trial.tables["pose"]["t"], T)
    assert trial.meta["clock"]["pose"] == "log_time"


def test_fields_without_numbers_are_noted_and_columns_without_them_refused(tmp_path, bring):
    more = lambda i: pose(i) | {"covariance": [0.1, 0.2], "mode": "swim"}
    code, out, err = bring(json_recording(tmp_path / "a.mcap", more, "/camera/pose"), "--yes")
    assert code == 0 and "/camera/pose: 'covariance', 'mode' left out: no number in each message" in out, err
    later = lambda i: joint(i) | ({"w1": 0.1} if i > 2 else {})
    code, _, err = bring(json_recording(tmp_path / "b.mcap", later, "/joint"), "--yes", out=tmp_path / "later")
    assert code == 2 and "/joint[0]:w1 = None; expected a finite number in each message, as in 37 of 40" in err


@pytest.mark.parametrize("back", [10**10, 2 * 10**8])
def test_a_clock_that_was_set_back_is_refused(back, tmp_path, bring):
    """The rows of before and after were put between each other."""
    at = lambda i: stamp(i) - (back + 5_000_000 if i >= ROWS // 2 else 0)
    code, _, err = bring(json_topics(tmp_path / "a.mcap", {"/joint": joint}, at), "--yes")
    assert code == 2 and "/joint[20]:t: time goes back" in err
    if back > 10**9:
        name = "std_msgs/msg/Float64"
        data = bytes(types().serialize_cdr(types().types[name](0.1), name))
        code, _, err = bring(bag(tmp_path / "bag", [("/joint1/command", name, at(i), data) for i in range(ROWS)]), "--yes")
        assert code == 2 and "/joint1/command[20]: received 9.985 s before the message in front of it" in err


# ----------------------------------------------------------------------------------------------------------- what is left out
def test_a_name_to_leave_out_that_a_recording_lacks_is_refused(tmp_path, bring):
    """It was passed over in silence."""
    message = lambda i: {"fish_id": "A"} | pose(i)
    source = json_topics(tmp_path / "a.mcap", {"/camera/pose": message, "/load": lambda i: {"cpu_share": 0.5}})
    told = r"skip: no topic, and no field .* is called '/laod'; did you mean '/load'\?; expected of '/camera/pose', '/load'"
    with pytest.raises(LogError, match=told):
        importers.read(source, skip=["/laod"])
    assert set(importers.read(source, skip=["/load", "fish_id"])["a"].tables) == {"pose"}  # one fish; a field all the same
    code, _, err = bring(source, "--yes", "--set", "fish_idd=skip")
    assert code == 2 and "is called 'fish_idd'; did you mean 'fish_id'?" in err
    topics = tmp_path / "MAP.toml"
    topics.write_text('skip = ["fish"]\n[tables.pose]\ntopic = "/camera/pose"\ncolumns = { x = "x", y = "y", yaw = "yaw" }\n')
    with pytest.raises(LogError, match="is called 'fish'"):
        importers.read(source, topics=topics)
    topics.write_text(topics.read_text().replace('"fish"', '"/camera/pose"'))
    with pytest.raises(LogError, match="skip: '/camera/pose' is the topic of a table of the mapping"):
        importers.read(source, topics=topics)
    (tmp_path / "a.csv").write_text("t,x,y,yaw\n0,1,1,0\n0.1,1,1,0\n")
    with pytest.raises(LogError, match="a topic mapping or skip is for MCAP and rosbag2"):
        importers.read(tmp_path / "a.csv", lambda path: {}, skip=["x"])


def test_a_name_to_leave_out_may_be_of_one_of_several_files(tmp_path, bring):
    lab = tmp_path / "lab"
    lab.mkdir()
    json_topics(lab / "a.mcap", {"/camera/pose": pose, "/imu/raw": lambda i: {"acc_x": 0.1 * i}})
    json_recording(lab / "b.mcap", pose, "/camera/pose")
    rows = "".join(f"{t},{a},{i}\n" for i, (t, a) in enumerate(zip(T, ANGLES[:, 0], strict=True)))
    (lab / "c.csv").write_text("t_s,joint1_measured_rad,count\n" + rows)
    said = ("--yes", "--set", "/imu/raw=skip", "--set", "count=skip")
    code, _, err = bring(lab, *said)
    assert code == 0, err
    code, _, err = bring(lab, *said, "--set", "cuont=skip", out=tmp_path / "two")
    assert code == 2 and "no topic, and no field that tells robots apart, is called 'cuont'" in err


# ---------------------------------------------------------------------------------------------------- mappings and columns
def test_two_robots_are_read_as_one_where_the_user_says_so(tmp_path, bring):
    source = json_recording(tmp_path / "a.mcap", lambda i: {"fish_id": "AB"[i % 2]} | pose(i), "/camera/pose")
    code, _, err = bring(source, "--yes")
    assert code == 2 and "or --set fish_id=skip to read them as one" in err
    assert bring(source, "--yes", "--set", "fish_id=skip", out=tmp_path / "skipped")[0] == 0
    topics = tmp_path / "MAP.toml"
    topics.write_text('[tables.pose]\ntopic = "/camera/pose"\ncolumns = { x = "x", y = "y", yaw = "yaw" }\n')
    code, _, err = bring(source, "--yes", "--topics", topics)
    assert code == 2 and 'or skip = ["fish_id"] at the top of the mapping of topics to read them as one' in err
    topics.write_text('skip = ["fish_id"]\n' + topics.read_text())
    assert bring(source, "--yes", "--topics", topics)[0] == 0
    near(only(tmp_path / "set").tables["pose"]["yaw"], YAW)
    topics.write_text(topics.read_text().replace('["fish_id"]', '"fish_id"'))
    with pytest.raises(LogError, match="skip = 'fish_id'; expected names of fields"):
        importers.read(source, topics=topics)


def test_numbers_as_text_and_long_lists_of_a_topic_are_told(tmp_path, bring):
    code, _, err = bring(json_recording(tmp_path / "a.mcap", lambda i: pose(i) | {"yaw": str(YAW[i])}, "/camera/fish"), "--yes")
    assert code == 2 and "yaw: its cells are text, such as '2.0'" in err
    code, out, _ = bring(json_recording(tmp_path / "b.mcap", lambda i: pose(i) | {"ranges": [1.0] * 80}, "/camera/fish"), "--yes")
    assert code == 0 and "/camera/fish: lists are read to 64 values" in out


@pytest.mark.parametrize(
    ("message", "column"),
    [
        (lambda i: {"fish": {"x": 1.2 + 0.1 * T[i], "y": 0.6, "yaw": str(YAW[i])}}, "fish.yaw"),
        (lambda i: {"name": ["1", "2"], "position": [ANGLES[i, 0], str(ANGLES[i, 1])]}, "joint.2"),
        (lambda i: {"name": ["1", "2"], "angle": [ANGLES[i, 0], str(ANGLES[i, 1])]}, "angle.2"),
    ],
)
def test_numbers_as_text_within_a_message_are_asked_about(message, column, tmp_path, bring):
    """They were passed over in silence."""
    code, out, err = bring(json_recording(tmp_path / "a.mcap", message, "/camera/fish"), "--yes")
    assert code == 2 and f"{column}: its cells are text, such as '" in err and "name" not in out, (out, err)


def test_numbers_as_text_in_messages_of_a_standard_type_are_columns_without_numbers(tmp_path):
    """Some ended the reading with an error of Python."""
    messages = {
        "sensor_msgs/msg/BatteryState": ({"voltage": "7.4", "current": -1.0}, {"voltage"}),
        "std_msgs/msg/Float64MultiArray": ({"data": [1.0, "2.0", None]}, {"data.1"}),
        "trajectory_msgs/msg/JointTrajectory": ({"joint_names": ["a", "b"], "points": [{"positions": [0.1, "x"]}]}, set()),
    }
    for kind, (content, text) in messages.items():
        channel = TopicChannel("json", kind, [(stamp(i), stamp(i), json.dumps(content).encode()) for i in range(ROWS)])
        (sheet,), _ = message_sheets.readable(tmp_path / "a.mcap", {"/a": channel})
        assert sheet.text.keys() == text and text <= sheet.columns.keys()


def test_a_number_beside_the_others_that_is_called_a_stamp_is_the_clock(tmp_path, bring):
    """The receipts were."""
    late = lambda i: {"stamp": (START / 1e9 - 1.7e9) + T[i] * (1 + 0.01 * i), **pose(i)}
    code, _, err = bring(json_recording(tmp_path / "a.mcap", late, "/camera/fish"), "--yes")
    assert code == 0, err
    near(only(tmp_path / "set").tables["pose"]["t"], T * (1 + 0.01 * np.arange(ROWS)))


def test_messages_of_a_topic_that_metadata_counts_and_the_bag_lacks_are_told(tmp_path):
    name = "std_msgs/msg/Float64"
    data = bytes(types().serialize_cdr(types().types[name](0.1), name))
    topics = tmp_path / "MAP.toml"
    topics.write_text('[tables.cmd]\ntopic = "/a"\ncolumns = { c1 = "data" }\n')
    counts = "".join(f"    - topic_metadata: {{name: {of}}}\n      message_count: 40\n" for of in ("/a", "/b", "/absent"))
    messages = [(of, name, stamp(i), data) for i in range(ROWS) for of in ("/a", "/b")]
    source = bag(tmp_path / "bag", messages, f"  topics_with_message_count:\n{counts}")
    notes = importers.read(source, topics=topics)["bag"].notes
    assert not any("is it cut off" in note for note in notes), notes  # the others are not asked for
    from fishmj.log.importers import rosbag2

    told = rosbag2.lost(source, rosbag2.channels(source))
    assert told == ["/absent: metadata.yaml counts 40 messages, the bag holds 0: is it cut off?"]


def test_messages_that_are_in_no_whole_burst_are_told(tmp_path, bring):
    name = "std_msgs/msg/Float64"
    one = lambda i, k: bytes(types().serialize_cdr(types().types[name](ANGLES[i % ROWS, k - 1]), name))
    at = lambda i: START + 20_000_000 * i
    sent = [(i, k) for i in range(300) for k in (1, 2) if (i, k) != (150, 2)]
    messages = [(f"/joint{k}/command", name, at(i) + 300_000 * k, one(i, k)) for i, k in sent]
    code, out, err = bring(bag(tmp_path / "bag", messages), "--yes")
    assert code == 0 and "1 messages left out, without one of each other topic beside them" in out, err
