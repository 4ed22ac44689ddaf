"""Recordings of a swim as robots make them: rosbag2, MCAP with JSON, text tables. Synthetic: measured by no one."""

import json
import sqlite3
from functools import cache

import numpy as np
from lab_files import near, only

ROWS = 40
START = 1_700_000_000_000_000_000  # ns
T = 0.02 * np.arange(ROWS)
ANGLES = 0.4 * np.sin(6 * T[:, None] - np.array([0.0, 1.0, 2.0]))
YAW = 2.0 + 0.1 * np.sin(6 * T)
PARTS = ("head_joint", "body_joint", "tail_joint")


def stamp(i):
    """Time of row `i` [ns since 1970]."""
    return START + round(1e9 * T[i])


@cache
def types():
    """ROS 2's standard types."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def joint_state(names, position, velocity=(), i=0, frame=""):
    """(topic, type, time [ns], CDR) of one JointState."""
    store = types()
    kinds, now = store.types, stamp(i)
    header = kinds["std_msgs/msg/Header"](
        stamp=kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9), frame_id=frame
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
    return json_topics(path, {topic: message})


def json_topics(path, topics, log_time=stamp):
    """An MCAP file of the JSON messages `message(i)` of each topic; none where it gives None."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {topic: writer.register_channel(topic=topic, message_encoding="json", schema_id=0) for topic in topics}
        for i in range(ROWS):
            for topic, message in topics.items():
                if (content := message(i)) is not None:
                    data = json.dumps(content).encode()
                    writer.add_message(channels[topic], log_time=log_time(i), publish_time=log_time(i), data=data)
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
