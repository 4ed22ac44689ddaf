"""Files as an attacker would make them, for the commands that read logs and reports; the form is that of `bad_logs.py`.

HOSTILE: id -> (make, argv, expectation). Besides what holds for bad logs, none of SECRETS is printed and none of SCRIPTS
stands in a page. All files together are below 3 MB. Those of NEEDS_LOGS need pyarrow or zstandard. Nothing here does harm:
what an attacker would run is `touch pwned` in the folder. Links and pipes need a POSIX system.
"""

import io
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from bad_logs import ANGLES, CHECK, IMPORT, LAB, NPZ, ROWS, Make, T, good_tables, lines, servos, trial

SECRETS = ("root:x:0:0", "\x1b", "\x07")  # never in what is printed
SCRIPTS = ("<script>alert(1)", "<img src=x onerror=")  # never in a page


def npy(dtype: str, shape: tuple[int, ...]) -> bytes:
    """Only the header of an .npy file."""
    text = repr({"descr": dtype, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def zeros(megabytes: int) -> tuple[bytes, int, int]:
    """An .npy of zeros, deflated by repetition of one block: its bytes, sum and size."""
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = squeeze.compress(bytes(1 << 20)) + squeeze.flush(zlib.Z_FULL_FLUSH)
    head = npy("<f8", (megabytes << 17,))
    start = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = start.compress(head) + start.flush(zlib.Z_FULL_FLUSH) + block * megabytes + squeeze.flush()
    total, empty = zlib.crc32(head), bytes(1 << 20)
    for _ in range(megabytes):
        total = zlib.crc32(empty, total)
    return data, total, len(head) + (megabytes << 20)


def archive(path: Path, names: list[bytes], megabytes: int, at_one_place: bool) -> None:
    """An .npz of equal columns of zeros; at one place: all entries of its directory point to the first."""
    data, total, size = zeros(megabytes)
    body, listing = b"", b""
    for name in names:
        fields = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 33, total, len(data), size, len(name), 0)
        place = 0 if at_one_place else len(body)
        if place == len(body):
            body += b"PK\3\4" + fields + name + data
        listing += b"PK\1\2" + struct.pack("<H", 20) + fields + struct.pack("<HHHII", 0, 0, 0, 0, place) + name
    end = struct.pack("<HHHHIIH", 0, 0, len(names), len(names), len(listing), len(body), 0)
    path.write_bytes(body + listing + b"PK\5\6" + end)


def npz_bomb(folder: Path) -> None:
    """2.1 GB of zeros in 0.2 MB: eight columns that share one place of the archive."""
    archive(folder / "run.npz", [b"t.npy", *(f"c{k}.npy".encode() for k in range(1, 8))], 256, at_one_place=True)


def npz_below_limit(folder: Path) -> None:
    """1.05 GB of zeros in 1 MB: below the limit of what may be unpacked, and 32 million rows in which time stands still."""
    archive(folder / "run.npz", [b"t.npy", b"c1.npy", b"c2.npy", b"c3.npy"], 250, at_one_place=False)


def parquet_rows_bomb(folder: Path) -> None:
    """10^9 rows in 70 kB: one row group of four million rows, listed 256 times."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 4_000_000
    table = pa.table({name: pa.array(np.zeros(rows)) for name in ("t", "c1", "c2", "c3")})
    raw, foot = io.BytesIO(), io.BytesIO()
    pq.write_table(table, raw, compression="zstd", row_group_size=rows, write_statistics=False)
    meta = pq.read_metadata(raw)
    for _ in range(8):
        meta.append_row_groups(meta)
    meta.write_metadata_file(foot)
    data, footer = raw.getvalue(), foot.getvalue()
    end = struct.unpack("<I", data[-8:-4])[0] + 8
    (folder / "run.parquet").write_bytes(data[:-end] + footer[4:])


def npz_pickle(folder: Path) -> None:
    """An .npz whose column is a pickle that runs a command."""
    trial(folder / "trial", **good_tables())
    (folder / "trial" / "pose.csv").unlink()
    with zipfile.ZipFile(folder / "trial" / "pose.npz", "w") as file:
        file.writestr("t.npy", npy("|O", (1,)) + b"cos\nsystem\n(S'touch pwned'\ntR.")
        for name in ("x", "y", "yaw"):
            file.writestr(f"{name}.npy", npy("<f8", (1,)) + bytes(8))
        file.writestr("../../pwned.npy", npy("<f8", (1,)) + bytes(8))


def npy_huge_shape(folder: Path) -> None:
    """Columns that say they are 10^15 and 2^63 numbers long and hold 8 bytes."""
    trial(folder / "trial", **good_tables())
    (folder / "trial" / "pose.csv").unlink()
    with zipfile.ZipFile(folder / "trial" / "pose.npz", "w") as file:
        for name, shape in {"t": (10**15,), "x": (2**63,), "y": (2**32, 2**32), "yaw": (-1,)}.items():
            file.writestr(f"{name}.npy", npy("<f8", shape) + bytes(8))


def safetensors_huge(folder: Path) -> None:
    """A policy whose tensor says that it holds 2^80 numbers, with a header of depth 50,000 in its metadata."""
    deep = "[" * 50_000 + "]" * 50_000
    tensor = {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 8]}
    head = json.dumps({"__metadata__": {"fishmj": deep, "policy": deep}, "w0": tensor, "../../pwned": tensor}).encode()
    (folder / "policy.safetensors").write_bytes(struct.pack("<Q", len(head)) + head + bytes(8))


def manifest_passwd(folder: Path) -> None:
    """A manifest that lists /etc/passwd, by its path, by dots, and as a trial of its own."""
    trial(folder / "set" / "a", **good_tables())
    names = ["/etc/passwd", "../../../../../../../../etc/passwd", "a/../../../etc/passwd", "a/cmd.csv", "/etc/meta.toml", ""]
    told = {"meta": {}, "files": dict.fromkeys(names, "0" * 64)}
    (folder / "set" / "manifest.json").write_text(json.dumps(told), encoding="utf-8")


def verdict(**more) -> dict:
    """An answer of `gap find`, as the docs describe it and the command writes it."""
    delay = {"value": 0.05, "unit": "s", "low": 0.045, "high": 0.058}
    context = {"model": "fish", "data": "set", "model_sha256": "0" * 64, "data_sha256": "0" * 64, "judged": ["a"]}
    context |= {"null": {"runs": 8, "noise": 1.0, "seed": 0}, "water": "structured", "skipped": {}}
    answer = {
        "answer": "NAMED",
        "effects": [{"name": "command_latency", "parameters": {"delay": delay}, "p_best": 1.0, "closure": 1.0}],
        "rivals": [],
        "tentative": [],
        "terms": [],
        "gap_before": 168.1,
        "gap_after": 0.96,
        "gap_unseen_before": None,
        "gap_after_unseen": None,
        "explained": 1.0,
        "reason": "explains records that it has not seen",
        "warnings": [],
        "next_experiment": "",
        "patched_model": "model.patched.toml",
        "gates": {"gain": 1e6, "closure": 1.0, "transfer": 1.0},
        "steps": [],
        "context": context,
    }
    return answer | more


def verdict_passwd(folder: Path) -> None:
    """A report whose model is /etc/passwd, whose data are /etc and whose patched model lies above the folder."""
    told = verdict(patched_model="../../pwned.toml")
    told["context"] |= {"model": "/etc/passwd", "data": "/etc", "water": "../../../../etc/passwd"}
    (folder / "report").mkdir()
    (folder / "report" / "verdict.json").write_text(json.dumps(told), encoding="utf-8")


def verdict_deep(folder: Path) -> None:
    """A report that is 100,000 brackets deep."""
    text = json.dumps(verdict(steps="DEEP")).replace('"DEEP"', "[" * 100_000 + "]" * 100_000)
    (folder / "report").mkdir()
    (folder / "report" / "verdict.json").write_text(text, encoding="utf-8")


def verdict_pipe(folder: Path) -> None:
    """A report whose verdict is a pipe that nobody writes to."""
    (folder / "report").mkdir()
    os.mkfifo(folder / "report" / "verdict.json")


def links_and_pipes(folder: Path) -> None:
    """A folder of one good log, a pipe, a link to /etc/passwd, one to /dev/zero, one to itself and one to the folder above."""
    lab = folder / "lab"
    servos(lab / "good.csv")
    os.mkfifo(lab / "pipe.csv")
    (lab / "passwd.csv").symlink_to("/etc/passwd")
    (lab / "zero.csv").symlink_to("/dev/zero")
    (lab / "loop.csv").symlink_to("loop.csv")
    (lab / "again").symlink_to(".")
    (lab / "above").symlink_to("..")


def trial_of_links(folder: Path) -> None:
    """A trial folder whose tables are a pipe and a link to /etc/passwd, the first line of which nobody should be shown."""
    trial(folder / "trial", **good_tables())
    (folder / "trial" / "pose.csv").unlink()
    (folder / "trial" / "pose.csv").symlink_to("/etc/passwd")
    os.mkfifo(folder / "trial" / "truth.csv")


def page_script(folder: Path) -> None:
    """HTML and JavaScript in every text of a trial, its name included; a page is made of it."""
    script = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    keys = ("robot", "controller", "excitation", "notes", "source", "licence")
    text = "".join(f"{key} = {json.dumps(script)}\n" for key in keys)
    trial(folder / "swim<img src=x onerror=alert(3)>", text + "joints = 3\n", **good_tables())


def escapes(folder: Path) -> None:
    """Sequences that clear a terminal and set its title, in column names, cells and file names; a file name of two lines."""
    lab = folder / "lab"
    servos(lab / "a\nfishmj: all good, nothing was left out\n.csv")
    bad = "\x1b[2J\x1b[31m\x07"
    columns = [T * 1e3, *ANGLES.T, [f"1{bad}"] * ROWS]
    lines(lab / f"b{bad}.csv", f"time_ms,servo1_deg,servo2_deg,servo3_deg,note{bad}", columns)


def map_everything(folder: Path) -> None:
    """A map of everything to everything: tables and files above the folder, every column from any, scales that overflow."""
    servos(folder / "run.csv")
    text = 'skip = ["*", "../*"]\n[meta]\nrobot = "../../../etc/passwd"\nschema = "evil/9"\n"../../pwned" = 1\n'
    for table, columns in {"cmd": ("c1", "c2", "c3"), "pose": ("x", "y", "yaw"), "../../pwned": ("x",)}.items():
        text += (
            f'[tables."{table}"]\nfile = "../../../../../../etc/*"\nt = {{ column = "*", scale = 1e308, nanoseconds = "*" }}\n'
        )
        text += "".join(f'columns.{name} = {{ column = "*", scale = 1e308, zero = -1e308, sign = -1 }}\n' for name in columns)
    (folder / "MAP.toml").write_text(text, encoding="utf-8")


def toml_deep(folder: Path) -> None:
    """meta.toml with one key of 5,000 parts, brought in with everything else that nobody knows."""
    trial(folder / "trial", **good_tables())
    with (folder / "trial" / "meta.toml").open("a", encoding="utf-8") as file:
        file.write(f"{'.'.join('a' * 5000)} = 1\n")


def formula_cells(folder: Path) -> None:
    """Columns that a spreadsheet would run, on their way through an export to .csv."""
    header = "t,c1,c2,c3,=HYPERLINK(A1),@SUM(1+1)*cmd|' /C calc'!A0,+1+1,-2"
    extra = [np.ones(ROWS)] * 4
    trial(folder / "trial", cmd=(header, [T, *np.radians(ANGLES).T, *extra]), pose=good_tables()["pose"])


def mcap_lies(folder: Path) -> None:
    """An MCAP whose chunk says 100 bytes and unpacks to 200 MB; its lengths add up to 2^63."""
    import zstandard

    packed = zstandard.ZstdCompressor().compress(bytes(200 << 20))

    def record(op: int, data: bytes, length: int | None = None) -> bytes:
        return bytes([op]) + struct.pack("<Q", len(data) if length is None else length) + data

    chunk = struct.pack("<QQQI", 0, 1, 100, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    head = record(1, struct.pack("<I", 0) * 2)
    foot = record(15, struct.pack("<II", 0, 0), 2**63) + record(2, bytes(20))
    (folder / "run.mcap").write_bytes(b"\x89MCAP0\r\n" + head + record(6, chunk) + foot + b"\x89MCAP0\r\n")


SHORT = ["--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "2", "--engine", "planar", "--out", "judged"]

HOSTILE: dict[str, tuple[Make, list[str], str]] = {
    "npz_bomb": (npz_bomb, NPZ, "refused"),
    "npz_below_limit": (npz_below_limit, NPZ, "refused"),
    "parquet_rows_bomb": (parquet_rows_bomb, ["log", "import", "run.parquet", "--out", "data", "--yes"], "refused"),
    "npz_pickle": (npz_pickle, CHECK, "noted"),
    "npy_huge_shape": (npy_huge_shape, CHECK, "noted"),
    "safetensors_huge": (safetensors_huge, ["evaluate", "policy.safetensors", *SHORT], "refused"),
    "manifest_passwd": (manifest_passwd, ["log", "export", "set", "--to", "csv", "--out", "away"], "refused"),
    "verdict_passwd": (verdict_passwd, ["gap", "apply", "report", "--out", "next.toml"], "refused"),
    "verdict_deep": (verdict_deep, ["gap", "next", "report"], "refused"),
    "verdict_pipe": (verdict_pipe, ["gap", "apply", "report"], "refused"),
    "links_and_pipes": (links_and_pipes, [*LAB, "--skip-bad"], "noted"),
    "trial_of_links": (trial_of_links, CHECK, "noted"),
    "page_script": (page_script, ["replay", "swim<img src=x onerror=alert(3)>", "--robot", "fish", "--out", "p.html"], "noted"),
    "escapes": (escapes, [*LAB, "--trial-each"], "noted"),
    "map_everything": (map_everything, [*IMPORT, "--columns", "MAP.toml"], "refused"),
    "toml_deep": (toml_deep, ["log", "import", "trial", "--out", "data", "--yes"], "refused"),
    "formula_cells": (formula_cells, ["log", "export", "trial", "--to", "csv", "--out", "away"], "noted"),
    "mcap_lies": (mcap_lies, ["log", "import", "run.mcap", "--out", "data", "--yes"], "refused"),
}

NEEDS_LOGS = {"parquet_rows_bomb", "mcap_lies"}  # pyarrow, zstandard: pip install "fishmj[logs]"
