"""Bags come in whole, data sets by episode, and files of other programs are refused with their remedy."""

import json
import re
import shutil
import sqlite3

import lab_files
import numpy as np
import pytest
from lab_files import near
from robot_recordings import (
    ANGLES,
    PARTS,
    ROWS,
    T,
    angles_are_right,
    bag,
    database,
    stamp,
    swim,
)

from fishmj import log


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


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


def test_files_of_other_programs_in_a_folder_end_the_import(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "swim.csv", 40)
    (tmp_path / "lab" / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(200))
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "old.bag: a ROS 1 bag" in err and "--skip-bad" in err
    code, _, err = bring(tmp_path / "lab", "--yes", "--skip-bad")
    assert code == 0 and "left out" in err and "old.bag: a ROS 1 bag" in err
