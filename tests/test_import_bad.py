"""`fishmj log import`: every format and every kind of bad log; one clear line each, and nothing is written."""

import json
import math
import os
import struct

import describing
import lab_files
import numpy as np
import pytest
from lab_files import WAVE, N, near, only
from synthetic import whole_trial

from fishmj import log
from fishmj.base import console
from fishmj.log import __main__ as command
from fishmj.log.importers import guess
from fishmj.log.importers.delimited import read as read_text_table
from fishmj.mjcf import load_robot
from fishmj.mjcf.identity import identity


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Run `log import`: (exit code, stdout, stderr); the data set is tmp_path/set."""
    return lab_files.importer(tmp_path, capsys, monkeypatch)


# ------------------------------------------------------------------------------------------------------------ other formats
@pytest.mark.parametrize("name", ["parquet", "npz", "mcap_cdr", "mcap_json", "rosbag2"])
def test_other_formats_come_in_by_their_columns(tmp_path, bring, name):
    source = lab_files.MAKERS[name](tmp_path)
    code, out, err = bring(source, "--yes")
    assert code == 0, err
    trial = only(tmp_path / "set")
    table = trial.tables["cmd"] if "cmd" in trial.tables else trial.tables["joint"]
    s = lab_files.swim(len(table["t"]))
    near(table["t"], s["t"], 1e-6)
    near(table["c2" if "c2" in table else "j2"], np.radians(s["servo2_deg"]), 1e-6)
    if name in ("mcap_cdr", "rosbag2"):
        assert set(trial.tables) == {"cmd", "joint", "pose"}
        near(trial.tables["pose"]["x"], s["x"] / 1e3)
        near(trial.tables["pose"]["yaw"], np.radians(s["yaw"]))


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_mcap_chunks_of_every_packing_are_read(tmp_path, bring, compression):
    assert bring(lab_files.mcap_cdr(tmp_path / "a.mcap", 12, compression), "--yes")[0] == 0


def test_a_bag_takes_a_topic_mapping(tmp_path, bring):
    (tmp_path / "MAP.toml").write_text(
        '[tables.cmd]\ntopic = "/servo_commands"\ncolumns = { c1 = "data.0", c2 = { field = "data.1", unit = "rad" } }\n'
        '[tables.pose]\ntopic = "/camera/pose"\nt = "header.stamp"\n'
        'columns = { x = "pose.position.x", y = "pose.position.y", yaw = "pose.orientation.z" }\n'
    )
    assert bring(lab_files.bag(tmp_path / "bag"), "--topics", tmp_path / "MAP.toml")[0] == 0
    trial = only(tmp_path / "set")
    near(trial.tables["cmd"]["c2"], np.radians(lab_files.swim(40)["servo2_deg"]))


@pytest.mark.parametrize(
    ("separator", "encoding", "note"),
    [
        *((",", "utf-8-sig", "byte order mark"), (";", "utf-16", "UTF-16"), ("\t", "latin-1", "Latin-1")),
        *(("|", "utf-8", "bars"), (" ", "latin-1", "blanks"), (";", "utf-8-sig", "decimal commas")),
    ],
)
def test_separators_and_encodings_are_converted_with_a_note(tmp_path, bring, separator, encoding, note):
    columns = {"Zeit[s]": 0.02 * N, "Motor1_Soll[°]": 20 * WAVE}
    lab_files.write(tmp_path / "log.csv", columns, separator, "," if separator in ";\t" else ".", encoding)
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0
    trial = only(tmp_path / "set")
    near(trial.tables["cmd"]["c1"], np.radians(20 * WAVE))
    assert any(note in text for text in trial.meta["notes"])


def test_a_row_of_units_and_comments_are_understood(tmp_path, bring):
    rows = "".join(f"{20 * i},{20 * math.sin(i)}\n" for i in range(50))
    (tmp_path / "log.csv").write_text("# rig 2, monday\ntime,servo1\nms,deg\n" + rows)
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0
    near(only(tmp_path / "set").tables["cmd"]["t"], 0.02 * np.arange(50))


def test_blank_cells_of_a_slow_sensor_drop_rows_of_its_own_table_only(tmp_path, bring):
    rows = "".join(f"{20 * i},{20 * math.sin(i):.3f},{f'{i},{i},{i}' if i % 5 == 0 else ',,'}\n" for i in range(100))
    (tmp_path / "log.csv").write_text("time_ms,servo1_deg,cam_x_mm,cam_y_mm,cam_yaw_deg\n" + rows)
    assert bring(tmp_path / "log.csv", "--yes")[0] == 0
    trial = only(tmp_path / "set")
    assert len(trial.tables["cmd"]["t"]) == 100 and len(trial.tables["pose"]["t"]) == 20
    assert any("80 of 100 rows" in note for note in trial.meta["notes"])


# ------------------------------------------------------------------------------------------------------------------ bad logs
def table(
    header="time_ms,servo1_deg,servo2_deg", rows=60, row=lambda i: f"{20 * i},{20 * math.sin(i):.3f},{10 * math.cos(i):.3f}"
):
    return header + "\n" + "".join(row(i) + "\n" for i in range(rows))


def bomb_npz(path):
    import zipfile

    head = (
        b"\x93NUMPY\x01\x00\x76\x00"
        + f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10**9},), }}".encode().ljust(117)
        + b"\n"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("t.npy", "w", force_zip64=True) as member:
        member.write(head)
        member.write(bytes(10**6))


def bomb_parquet(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetWriter(path, pa.schema([("t", pa.float64())]), compression="zstd") as writer:
        for _ in range(3):
            writer.write_table(pa.table({"t": np.zeros(2_000_000)}))


def bomb_mcap(path, compression):
    """A chunk that unpacks to far more than it says."""
    import lz4.frame
    import zstandard

    data = zstandard.compress(bytes(50_000_000)) if compression == "zstd" else lz4.frame.compress(bytes(50_000_000))
    body = (
        struct.pack("<QQQI", 0, 1, 1000, 0)
        + struct.pack("<I", len(compression))
        + compression.encode()
        + struct.pack("<Q", len(data))
        + data
    )
    path.write_bytes(b"\x89MCAP0\r\n\x01" + struct.pack("<QII", 8, 0, 0) + b"\x06" + struct.pack("<Q", len(body)) + body)


BAD = {
    "empty": ("a.csv", "", "the file is empty"),
    "blank lines": ("a.csv", "\n\n \n", "no rows, only comments"),
    "comments only": ("a.csv", "# nothing\n# here\n", "no rows, only comments"),
    "header only": ("a.csv", "time_ms,servo1_deg\n", "column names but no rows"),
    "no header": ("a.csv", "0,1\n20,2\n40,3\n", "the first row holds numbers"),
    "one column": ("a.csv", "time_ms\n0\n20\n", "one column only"),
    "duplicate columns": ("a.csv", table("time_ms,servo1_deg,servo1_deg"), "'servo1_deg' appears twice"),
    "rows cut off": (
        "a.csv",
        table(row=lambda i: f"{20 * i},{i}" if i % 3 == 0 else f"{20 * i},1,2"),
        "2 values in a row of 3 columns, as in 20",
    ),
    "mixed rows": ("a.csv", table(row=lambda i: ",".join("1" * (i % 5 + 1))), "values in a row of 3 columns"),
    "decimal commas between commas": (
        "a.csv",
        table(row=lambda i: f"0,{i},1,5,2,5"),
        "decimal commas between comma-separated columns",
    ),
    "semicolons but commas said": ("a.csv", table().replace(",", "; ", 1), "values in a row|one column only|no column"),
    "all NaN": ("a.csv", table(row=lambda i: f"{20 * i},nan,nan"), "no column was recognised|holds no number"),
    "all text": ("a.csv", table(row=lambda i: "a,b,c"), "no number in any column"),
    "text in the column": ("a.csv", table(row=lambda i: f"{20 * i},open,shut"), "holds no number|no column was recognised"),
    "infinite": ("a.csv", table(row=lambda i: f"{20 * i},inf,-inf"), "no column was recognised|holds no number"),
    "huge numbers": ("a.csv", table(row=lambda i: f"{20 * i},1e999,1e999"), "no column was recognised|holds no number"),
    "huge angles": (
        "a.csv",
        table(row=lambda i: f"{20 * i},1e30,1"),
        r"in deg as cmd.c1 is 1.745e\+28 rad; plausible is at most",
    ),
    "time of NaN": ("a.csv", table(row=lambda i: f"nan,{i},1"), "no column of time|holds no number|holds no"),
    "time stands still": ("a.csv", table(row=lambda i: "0,1,2"), "time stands still|it never rises"),
    "time goes back": ("a.csv", table(row=lambda i: f"{20 * (i * 7 % 60)},1,2"), "time goes back.*rows are out of order"),
    "unpadded": (
        "a.csv",
        table("time_s,servo1_deg,servo2_deg", row=lambda i: f"{i // 50}.{20 * i % 1000},{i},2"),
        r"unpadded \('0.20' for '0.020'\): write them with zeros",
    ),
    "negative step": ("a.csv", table(row=lambda i: f"{-20 * i},1,2"), "time goes back"),
    "no time": ("a.csv", table("frame,servo1_deg,servo2_deg"), "no column of time among"),
    "only forces": ("a.csv", table("time_ms,fx,fy"), "a force or torque"),
    "unknown names": ("a.csv", table("time_ms,foo,bar"), "no column was recognised"),
    "binary": ("a.csv", b"\x00\x01\x02" * 400, "binary data or UTF-16 without its mark"),
    "a NUL in the middle": ("a.csv", table().encode()[:300] + b"\0" + table().encode()[300:], r"a.csv:\d+:1: binary data"),
    "UTF-16 without its mark": ("a.csv", table().encode("utf-16-le"), "binary data or UTF-16"),
    "damaged UTF-16": ("a.csv", table().encode("utf-16")[:-1] + b"", "damaged UTF-16"),
    "picture": (
        "a.csv",
        b"\x89PNG\r\n\x1a\n" + bytes(range(1, 255)) * 20,
        "one column only|no number|values in a row|first row|rows",
    ),
    "a line of 2 MB": ("a.csv", "time_ms,servo1_deg\n" + "1" * 2_000_000 + "\n", "a line of over"),
    "5000 columns": ("a.csv", ",".join(f"c{k}" for k in range(5000)) + "\n", "5000 columns; at most 4096"),
    "formulas": ("a.csv", table(row=lambda i: f"=1+{i},@SUM(A1),-cmd|x"), "no number in any column"),
    "escape codes": ("a.csv", table("time_ms,\x1b[31mred\x1b[0m,\x07bell"), "no column was recognised"),
    "spreadsheet": ("a.xlsx", b"PK\x03\x04", "a workbook of a spreadsheet, which is not read; save each sheet as CSV"),
    "truncated parquet": (
        "a.parquet",
        lambda p: (lab_files.parquet(p), p.write_bytes(p.read_bytes()[:-200])),
        "damaged or no Parquet file",
    ),
    "parquet bomb": ("a.parquet", bomb_parquet, "unpacks to .* GB, the limit is"),
    "truncated npz": ("a.npz", lambda p: (lab_files.npz(p), p.write_bytes(p.read_bytes()[:-200])), "damaged or not an .npz"),
    "npz that says more than it holds": ("a.npz", bomb_npz, r"a.npz: "),
    "truncated mcap": ("a.mcap", lambda p: (lab_files.mcap_cdr(p, 4), p.write_bytes(p.read_bytes()[:-100])), "damaged, cut off"),
    "mcap bomb, zstd": ("a.mcap", lambda p: bomb_mcap(p, "zstd"), "says 1000 bytes unpacks to more"),
    "mcap bomb, lz4": ("a.mcap", lambda p: bomb_mcap(p, "lz4"), "says 1000 bytes unpacks to more"),
    "protobuf": ("a.mcap", lambda p: protobuf(p), "'protobuf' are not read; convert .* pip install mcap-protobuf-support"),
    "no database": ("a.db3", b"SQLite format 3\0" + bytes(2000), "damaged or no rosbag2|no rosbag2"),
    "another database": ("a.db3", lambda p: another_database(p), "expected topics and messages"),
    "a view for a table": ("a.db3", lambda p: another_database(p, view=True), "expected topics and messages"),
}


def protobuf(path):
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="lab.Command", encoding="protobuf", data=b"")
        channel = writer.register_channel(topic="/command", message_encoding="protobuf", schema_id=schema)
        writer.add_message(channel, log_time=0, publish_time=0, data=b"\x0d\0\0\0\0")
        writer.finish()


def another_database(path, view=False):
    import sqlite3

    database = sqlite3.connect(path)
    if view:
        database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT i, i, i FROM n"
        )
    else:
        database.execute("CREATE TABLE people(id)")
    database.commit()
    database.close()


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_is_one_clear_line_and_nothing_is_written(tmp_path, bring, monkeypatch, name):
    import re

    file, content, message = BAD[name]
    path = tmp_path / "lab" / file
    path.parent.mkdir()
    content(path) if callable(content) else path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if "bomb" in name or "more than it holds" in name:
        monkeypatch.setenv("FISHMJ_IMPORT_GB", "0.02")
    before = sorted(tmp_path.rglob("*"))
    code, out, err = bring(path, "--yes")
    assert code == console.BAD_INPUT, (out, err)
    assert re.search(message, err), err
    last = err.split("\n")[-1]
    assert last.isprintable() and last.startswith("fishmj: ") and "Traceback" not in err and len(last) < 1500
    assert sorted(tmp_path.rglob("*")) == before, "nothing may be written"


def test_a_limit_that_is_no_number_is_refused(tmp_path, bring, monkeypatch):
    monkeypatch.setenv("FISHMJ_IMPORT_GB", "lots")
    code, _, err = bring(lab_files.one(tmp_path / "a.csv"), "--yes")
    assert code == 2 and "FISHMJ_IMPORT_GB = 'lots'" in err


# ----------------------------------------------------------------------------------------------------------------- check
def test_check_says_one_line_a_problem(tmp_path, capsys):
    for name in ("a", "b", "c"):
        log.write_trial(tmp_path / "set" / name, whole_trial(0.2), form="csv")
    assert console.run(command.main, ["manifest", str(tmp_path / "set")]) == 0
    (tmp_path / "set" / "a" / "pose.csv").write_text("t,x\n0,0\n")
    (tmp_path / "set" / "a" / "joint.csv").write_text("t,j1\n0,90\n")
    (tmp_path / "set" / "b" / "cmd.csv").unlink()
    capsys.readouterr()
    assert console.run(command.main, ["check", str(tmp_path / "set"), "--json"]) == console.FAILED_CHECK
    told = capsys.readouterr()
    lines = told.err.strip().split("\n")
    assert (
        sum("lacks column 'y', 'yaw'" in line for line in lines) == 1
        and sum("90 looks like degrees" in line for line in lines) == 1
    )
    assert sum("b/cmd.csv: expected sha256" in line for line in lines) == 1
    assert set(json.loads(told.out.strip().split("\n")[-1])["refused"]) == {"a"}


# --------------------------------------------------------------------------------------------------------------- the command
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "the following arguments are required: source"),
        (("a.csv",), "--out is missing"),
        (("a.csv", "--out", "x", "--robto", "eel"), "did you mean --robot?"),
        (("a.csv", "--out", "x", "--medium", "oil"), "water, air"),
        (("a.csv", "--out", "x", "--start", "1,2"), "expected X,Y,YAW such as 0,0,90 (m, m, deg)"),
        (("a.csv", "--out", "x", "--start", "1,2,nan"), "expected a number"),
        (("a.csv", "--out", "x", "--flow", "0.2"), "expected SPEED,DIRECTION such as 0.2,180 (m/s, deg)"),
        (("a.csv", "--out", "x", "--flow", "0.2,400"), "expected a number from -360 to 360"),
        (("a.csv", "--out", "x", "--flow", "0.2,3.14"), "if deg is meant, write 3.14deg"),
        (("a.csv", "--out", "x", "--start", "1,2,1.57"), "if deg is meant, write 1.57deg"),
        (("a.csv", "--out", "x", "--robot", "a/b"), "robot name 'a/b'"),
        (("a.csv", "--out", "x", "--robot", "nowhere.toml"), "no such file"),
        (("a.csv", "--out", "x", "--format", "csvs"), "flat_csv"),
        (("nowhere.csv", "--out", "x"), "no such file or folder"),
    ],
)
def test_a_wrong_command_line_is_one_line(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    lab_files.one(tmp_path / "a.csv")
    assert console.run(command.main, ["import", *words]) == console.BAD_INPUT
    err = capsys.readouterr().err.strip()
    assert message in err and "\n" not in err


def test_what_identifies_a_robot_comes_from_its_description(tmp_path, bring):
    recording, eel = lab_files.one(tmp_path / "a.csv"), tmp_path / "eel.toml"
    assert describing.new("eel", *describing.FIVE, "--out", str(eel)) == 0
    for said, source in (("fish", "fish"), ("swift", "fish"), (eel, eel)):
        out, wanted = tmp_path / f"set of {said!s:.5}", identity(load_robot(source))
        assert bring(recording, "--yes", "--robot", said, out=out)[0] == 0
        assert {key: only(out).meta[key] for key in wanted} == wanted
    assert any("has 4 joints, the columns tell of 3" in note for note in only(out).meta["notes"])
    eel.write_text('name = "eel"\n')
    code, _, err = bring(recording, "--yes", "--robot", eel)
    assert code == 2 and "eel.toml" in err and not (tmp_path / "set").exists()


def test_a_named_robot_takes_the_place_of_the_hashes_of_a_log(tmp_path, bring):
    own = whole_trial(1.0, **identity(load_robot()))
    log.write_trial(tmp_path / "own", own)
    assert bring(tmp_path / "own", "--yes", out=tmp_path / "kept")[0] == 0
    assert bring(tmp_path / "own", "--yes", "--robot", "eel7")[0] == 0
    kept, named = only(tmp_path / "kept").meta, only(tmp_path / "set").meta
    assert kept["body_sha256"] == own.meta["body_sha256"]
    assert named["robot"] == "eel7" and not {"robot_sha256", "body_sha256"} & named.keys()


# ---------------------------------------------------------------------------------------------------------------- hostile
def test_names_with_escape_codes_never_reach_the_terminal(tmp_path, bring):
    folder = tmp_path / "lab\x1b[31m"
    lab_files.write(folder / "run\x1b]0;x\x07.csv", {"time_ms": 20.0 * N, "servo1_deg": 20 * WAVE, "\x1b[31mred": WAVE})
    (folder / "bad\x1b[2J\n.csv").write_text("")
    code, out, err = bring(folder, "--yes", "--skip-bad")
    assert code == 0 and "\x1b" not in out + err and "\x07" not in out + err
    assert not any("\x1b" in note for note in only(tmp_path / "set").meta["notes"])
    code, out, err = bring(folder / "bad\x1b[2J\n.csv", "--yes", out=tmp_path / "two")
    assert code == 2 and err.isprintable()


def test_trial_table_that_is_an_outside_link_or_a_pipe_is_not_read(tmp_path, bring):
    (tmp_path / "secret.csv").write_text("t,c1\n0,0.1\n0.02,0.1\n")
    for name in ("linked", "piped", "good"):
        log.write_trial(tmp_path / "ours" / name, whole_trial(0.2), form="csv")
        if name != "good":
            (tmp_path / "ours" / name / "cmd.csv").unlink()
    (tmp_path / "ours" / "linked" / "cmd.csv").symlink_to(tmp_path / "secret.csv")
    os.mkfifo(tmp_path / "ours" / "piped" / "cmd.csv")
    code, out, err = bring(tmp_path / "ours", "--skip-bad")
    assert code == 0 and log.read_dataset(tmp_path / "set").names == ("good",)
    assert "a link that leads outside" in err and "is no plain file" in err


def test_thousands_of_numbered_columns_are_weighed(tmp_path):
    zero = np.zeros(20)
    sheet_columns = {"time_ms": 20.0 * np.arange(20), **{f"servo{k}_deg": zero for k in range(1, 900)}}
    sheet_columns |= {f"x{k}": zero for k in range(1, 900)}
    sheet = read_text_table(lab_files.write(tmp_path / "a.csv", sheet_columns))
    found = guess.guess(guess.kinds([sheet]))
    assert sum(g.state == guess.TAKEN for g in found) > 800


def test_stamps_of_seconds_and_nanoseconds_are_added(tmp_path, bring):
    rows = "".join(f"{1_700_000_000 + (20 * i) // 1000},{20_000_000 * i % 10**9},{10 * math.sin(i):.4f}\n" for i in range(100))
    (tmp_path / "a.csv").write_text("header.stamp.sec,header.stamp.nanosec,goal_1_deg\n" + rows)
    assert bring(tmp_path / "a.csv", "--yes")[0] == 0
    near(only(tmp_path / "set").tables["cmd"]["t"], 0.02 * np.arange(100), 1e-6)


def test_a_table_that_lies_in_two_files_is_not_pieced_together(tmp_path, bring):
    lab_files.write(tmp_path / "lab" / "a.csv", {"time_ms": 20.0 * N, "goal1_deg": 20 * WAVE, "goal2_deg": 20 * WAVE})
    lab_files.write(tmp_path / "lab" / "b.csv", {"time_ms": 10.0 * N, "goal3_deg": 20 * WAVE, "batt_V": 7.4 + 0 * WAVE})
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "b.csv: goal3_deg: table cmd lies in another file already" in err
    assert bring(tmp_path / "lab", "--yes", "--set", "goal3_deg=skip")[0] == 0
    assert "c3" not in only(tmp_path / "set").tables["cmd"]


PROSE = {
    "scale.txt": "image 2560 x 1440, origin upper left\n",
    "notes.txt": "Tail servo replaced on Monday.\n",
    "water.log": "depth 0.6\nlength 3.0\ntemperature 20.5\n",
    "day.txt": "# of the lab\n2026-03-02 12:30 battery charged\n2026-03-02 12:50 tail replaced\n",
    "README": "Swims of Monday, by hand.\n\n1. still water\n2. flow\n",
    "laptop.txt": "Größe 1,2 m\n",
}


@pytest.mark.parametrize("name", PROSE)
def test_prose_beside_recordings_is_left_out_and_named(tmp_path, bring, name):
    log_file = lab_files.one(tmp_path / "lab" / "log.csv")
    (tmp_path / "lab" / name).write_text(PROSE[name], "latin-1" if name == "laptop.txt" else "utf-8")
    code, out, err = bring(log_file, tmp_path / "lab" / name, "--yes", out=tmp_path / "files")
    assert code == 0 and f"{name}: left out, text without a table of numbers" in out, err
    code, out, err = bring(tmp_path / "lab", "--yes")
    assert code == 0 and name in out and only(tmp_path / "set").tables.keys() == only(tmp_path / "files").tables.keys(), err


def test_a_table_with_a_cut_row_in_a_text_file_is_no_prose(tmp_path, bring):
    lab_files.one(tmp_path / "lab" / "log.csv")
    (tmp_path / "lab" / "camera.txt").write_text("t;x;y\n0;1;2\n1;2\n2;3\n3;1;2\n")
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "camera.txt:3:1: 2 values in a row of 3 columns" in err


@pytest.mark.parametrize("name", ["scale.txt", "camera.csv", "camera.mat"])
def test_a_file_that_is_skipped_is_not_read(tmp_path, bring, name):
    lab_files.one(tmp_path / "lab" / "log.csv")
    (tmp_path / "lab" / name).write_text("0.0012 3 7\n0.0011 3 7\n")
    assert bring(tmp_path / "lab", "--yes")[0] == 2
    code, out, err = bring(tmp_path / "lab", "--yes", "--set", f"{name}=skip")
    assert code == 0 and f"{name}: left out, as --set says" in out, err
    code, _, err = bring(tmp_path / "lab", "--yes", "--set", f"{name}x=skip", "--skip-bad", out=tmp_path / "two")
    assert code == 2 and f"unknown column in --set '{name}x'" in err


def test_a_folder_of_prose_says_why_nothing_is_imported(tmp_path, bring):
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "notes.txt").write_text(PROSE["notes.txt"])
    code, _, err = bring(tmp_path / "lab", "--yes")
    assert code == 2 and "nothing to import" in err and "notes.txt: left out, text without" in err
