"""Recordings under names of a laboratory's own, in every format that `fishmj log import` reads. Synthetic: measured by no one."""

import json
import math
import os
import random
import sqlite3
from pathlib import Path

import numpy as np
import recordings

from fishmj import log
from fishmj.base import console
from fishmj.log import __main__ as command
from fishmj.log.importers import guess
from fishmj.log.importers.delimited import read as read_text_table

ROWS = 120
N = np.arange(100)
WAVE = np.sin(0.3 * N)


def importer(tmp_path, capsys, monkeypatch):
    """A function that runs `log import` and gives (exit code, stdout, stderr); the data set is tmp_path/set."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # durability is tested elsewhere

    def run(*words, out=tmp_path / "set"):
        code = console.run(command.main, ["import", *map(str, words), *(["--out", str(out)] if out else [])])
        told = capsys.readouterr()
        return code, told.out, told.err.strip()

    return run


def only(folder):
    """The one trial of a data set."""
    data = log.read_dataset(folder)
    assert len(data) == 1
    return data[data.names[0]]


def guessed(tmp_path, columns, name="log.csv"):
    """Column -> what it is taken for."""
    sheet = read_text_table(write(tmp_path / name, columns))
    return {g.column: g for g in guess.guess(guess.kinds([sheet]))}


def near(got, wanted, tolerance=1e-6):
    """Equal within a tolerance."""
    assert np.allclose(got, wanted, atol=tolerance), (got[:4], wanted[:4])


def swim(rows: int = ROWS) -> dict[str, np.ndarray]:
    """A swim at 50 Hz: s, deg, mm, V."""
    t = 0.02 * np.arange(rows)
    wave = {f"servo{k}_deg": 20 * np.sin(6 * t - k) for k in (1, 2, 3)}
    return {"t": t, **wave, "x": 1200 + 80 * t, "y": 600 + 5 * np.sin(t), "yaw": 8 * np.sin(6 * t), "volt": 7.4 - 0.001 * t}


def write(path: Path, columns: dict, separator: str = ",", decimal: str = ".", encoding: str = "utf-8") -> Path:
    """A text table, six digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(columns), *(separator.join(f"{v:.6f}".replace(".", decimal) for v in row) for row in rows)]
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path


def three(folder: Path, rows: int = ROWS) -> list[Path]:
    """One trial as three programs wrote it: commands, camera, battery; ms, s and us; commas, semicolons and tabs."""
    s = swim(rows)
    return [
        write(folder / "commands.csv", {"time_ms": 1e3 * s["t"], **{k: v for k, v in s.items() if k.startswith("servo")}}),
        write(
            folder / "camera.csv",
            {"frame time [s]": s["t"] + 0.004, "cam_x_mm": s["x"], "cam_y_mm": s["y"], "cam_heading_deg": s["yaw"]},
            separator=";",
            decimal=",",
        ),
        write(folder / "battery.csv", {"stamp_us": 1e6 * s["t"], "batt_mV": 1e3 * s["volt"]}, separator="\t"),
    ]


def one(path: Path, rows: int = ROWS) -> Path:
    """Everything on a common clock, units in the names."""
    s = swim(rows)
    servos = {k: v for k, v in s.items() if k.startswith("servo")}
    return write(
        path,
        {"time_ms": 1e3 * s["t"], **servos, "cam_x_mm": s["x"], "cam_y_mm": s["y"], "cam_yaw_deg": s["yaw"], "batt_V": s["volt"]},
    )


def parquet(path: Path, rows: int = ROWS) -> Path:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    s = swim(rows)
    stamps = pa.array((1_700_000_000_000_000_000 + 1e9 * s["t"]).astype("int64"), pa.timestamp("ns"))
    servos = {k: v for k, v in s.items() if k.startswith("servo")}
    pq.write_table(
        pa.table({"stamp": stamps, **servos, "x_mm": s["x"], "y_mm": s["y"], "yaw_deg": s["yaw"], "mode": ["swim"] * rows}), path
    )
    return path


def npz(path: Path, rows: int = ROWS) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    s = swim(rows)
    np.savez_compressed(
        path, time_ms=1e3 * s["t"], servo_deg=np.stack([s[f"servo{k}_deg"] for k in (1, 2, 3)], 1), extra=np.zeros(3)
    )
    return path


def _messages(rows: int):
    """(topic, type, time [ns], CDR) of joint states, commands, poses and a battery, as ROS 2 writes them."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    s = swim(rows)
    for i in range(rows):
        now = 1_700_000_000_000_000_000 + round(1e9 * s["t"][i])
        stamp = kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
        header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="tank")
        angles = np.radians([s[f"servo{k}_deg"][i] for k in (1, 2, 3)])
        none = np.zeros(0)
        state = kinds["sensor_msgs/msg/JointState"](
            header=header, name=["joint_1", "joint_2", "joint_3"], position=angles, velocity=0 * angles, effort=none
        )
        layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        command = kinds["std_msgs/msg/Float64MultiArray"](layout=layout, data=angles)
        turn = math.radians(s["yaw"][i])
        place = kinds["geometry_msgs/msg/Point"](x=s["x"][i] / 1e3, y=s["y"][i] / 1e3, z=0.0)
        quaternion = kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(turn / 2), w=math.cos(turn / 2))
        pose = kinds["geometry_msgs/msg/PoseStamped"](
            header=header, pose=kinds["geometry_msgs/msg/Pose"](position=place, orientation=quaternion)
        )
        yield from (
            (topic, kind, now, bytes(store.serialize_cdr(message, kind)))
            for topic, kind, message in (
                ("/joint_states", "sensor_msgs/msg/JointState", state),
                ("/servo_commands", "std_msgs/msg/Float64MultiArray", command),
                ("/camera/pose", "geometry_msgs/msg/PoseStamped", pose),
            )
        )


def bag(folder: Path, rows: int = 40) -> Path:
    """A rosbag2 in SQLite."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n")
    database = sqlite3.connect(folder / f"{folder.name}_0.db3")
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT)"
    )
    database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    numbers: dict[str, int] = {}
    for topic, kind, now, data in _messages(rows):
        if topic not in numbers:
            numbers[topic] = len(numbers) + 1
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (numbers[topic], topic, kind))
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", (numbers[topic], now, data))
    database.commit()
    database.close()
    return folder


def mcap_cdr(path: Path, rows: int = 40, compression: str = "zstd", sums: bool = True) -> Path:
    """An MCAP file as ROS 2 records it; without `sums` damage is not seen before the messages are decoded."""
    from mcap.writer import CompressionType, Writer

    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType[compression.upper()], enable_crcs=sums)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, kind, now, data in _messages(rows):
            if topic not in channels:
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=b"")
                channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
            writer.add_message(channels[topic], log_time=now, publish_time=now, data=data)
        writer.finish()
    return path


def mcap_json(path: Path, rows: int = 40) -> Path:
    """An MCAP file of JSON messages under a lab's own names, without a mapping."""
    from mcap.writer import Writer

    path.parent.mkdir(parents=True, exist_ok=True)
    s = swim(rows)
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic="/servo_command", message_encoding="json", schema_id=0)
        for i in range(rows):
            body = {"angle": {str(k): s[f"servo{k}_deg"][i] for k in (1, 2, 3)}}
            writer.add_message(
                channel,
                log_time=1_700_000_000_000_000_000 + round(1e9 * s["t"][i]),
                publish_time=0,
                data=json.dumps(body).encode(),
            )
        writer.finish()
    return path


MAKERS = {  # name -> writes a valid source below a folder and returns it
    "csv": lambda root: one(root / "log.csv", 40),
    "csvs": lambda root: (three(root / "lab", 40), root / "lab")[1],
    "parquet": lambda root: parquet(root / "log.parquet", 40),
    "npz": lambda root: npz(root / "log.npz", 40),
    "mcap_cdr": lambda root: mcap_cdr(root / "log.mcap", 12),
    "mcap_plain": lambda root: mcap_cdr(root / "log.mcap", 12, "none", sums=False),
    "mcap_json": lambda root: mcap_json(root / "log.mcap", 12),
    "rosbag2": lambda root: bag(root / "bag", 12),
    **{name: (lambda root, make=make, name=name: make(root / name)) for name, make in recordings.MAKERS.items()},
}
_JUNK = [
    b",",
    b"\n",
    b";",
    b"\t",
    b"-",
    b"e9",
    b"nan",
    b"[",
    b'"',
    b"}",
    b"\x00",
    b"1e999",
    b" ",
    b"9" * 400,
    "é;".encode(),
    b"null",
    b"\xff\xfe",
]
_JUNK += [
    b"=1+1",
    b"2026-01-15T12:00:00Z",
    b"\x1b[31m",
    b"\xff" * 8,
    b"\x00" * 8,
    b"\x7f\xff\xff\xff\xff\xff\xff\xff",
    b"deg",
    b"t",
]


def mutated(raw: bytes, rng: random.Random) -> bytes:
    """One to four damages: bits turned, pieces cut out, put in, repeated, or moved; the end cut off."""
    data = bytearray(raw)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(len(data), 1))
        how = rng.randrange(6)
        if how == 0 and data:
            data[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            del data[at : at + rng.randint(1, 40)]
        elif how == 2:
            data[at:at] = rng.choice(_JUNK)
        elif how == 3:
            data[at:at] = data[at : at + rng.randint(1, 200)]
        elif how == 4 and data:
            junk = rng.choice(_JUNK)
            data[at : at + len(junk)] = junk
        elif rng.random() < 0.3:
            del data[at:]
    return bytes(data)
