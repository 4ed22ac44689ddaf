"""Faults 13 to 16: kill during save, disk full, damaged checkpoint, pickled objects."""

import builtins
import errno
import io
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fishmj.base import store
from fishmj.base.errors import StoreError

ROOT = Path(__file__).resolve().parents[1]
WRITER = """
import sys
import numpy as np
from fishmj.base.store import Checkpoints
checkpoints = Checkpoints(sys.argv[1], keep=2)
found = checkpoints.latest()
step = found.step if found else 0
print("ready", flush=True)
while True:
    step += 1
    checkpoints.save(step, {"weights": np.full(200_000, step, np.float64)}, {"sum": 200_000 * step})
    print(step, flush=True)
"""


def test_fault_13_kill_during_save_leaves_the_newest_complete_checkpoint(tmp_path):
    newest, rng = 0, np.random.default_rng(0)
    for _ in range(6):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(tmp_path)],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert writer.stdout.readline() == b"ready\n"  # it read the survivor of the last kill without an error
        for _ in range(2):  # two saves between the kills, however slow the machine
            writer.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.1))
        writer.send_signal(signal.SIGKILL)
        writer.wait(600)
        writer.stdout.close()
        found = store.Checkpoints(tmp_path, keep=2).latest()
        if found is None:
            continue
        assert found.note == "" and found.step >= newest
        assert found.arrays["weights"].sum() == found.meta["sum"]
        newest = found.step
    assert newest > 6  # it did make progress between the kills


class _FullDisk(io.FileIO):
    """A file that takes the first 1000 bytes and then finds the disk full."""

    def write(self, data):
        super().write(bytes(data)[:1000])
        raise OSError(errno.ENOSPC, "No space left on device")


def test_fault_14_full_disk_keeps_the_old_file_and_reports_bytes_needed(tmp_path, monkeypatch):
    checkpoints = store.Checkpoints(tmp_path)
    checkpoints.save(1, {"w": np.zeros(10)}, {})
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    real_open = builtins.open
    full = lambda file, mode="r", *a, **k: _FullDisk(file, "w") if "w" in mode else real_open(file, mode, *a, **k)
    monkeypatch.setattr(builtins, "open", full)
    with pytest.raises(StoreError, match=r"disk full: needs (\d+) bytes, \d+ free; the old file is untouched") as caught:
        checkpoints.save(2, {"w": np.zeros(5000)}, {})
    monkeypatch.undo()
    assert caught.value.errno == errno.ENOSPC  # a trainer pauses on this one
    assert int(str(caught.value).split("needs ")[1].split()[0]) > 5000 * 8
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before  # no temporary file either
    assert checkpoints.latest().step == 1
    assert checkpoints.save(2, {"w": np.zeros(5000)}, {}).is_file()  # space is back: the same call works


@pytest.mark.parametrize("damage", ["truncate", "flip a weight", "flip the header", "empty"])
def test_fault_15_damaged_checkpoint_falls_back_and_says_so(tmp_path, damage):
    checkpoints = store.Checkpoints(tmp_path)
    checkpoints.save(1, {"w": np.arange(100.0)}, {"seed": 3})
    newest = checkpoints.save(2, {"w": np.arange(100.0) + 1}, {"seed": 3})
    raw = bytearray(newest.read_bytes())
    if damage == "truncate":
        raw = raw[:-50]
    elif damage == "flip a weight":
        raw[-300] ^= 0x04
    elif damage == "flip the header":
        raw[raw.index(b"seed")] ^= 0x01
    else:
        raw = b""
    newest.write_bytes(bytes(raw))
    with pytest.warns(RuntimeWarning, match="fell back to step_000000000001"):
        found = checkpoints.latest()
    assert found.step == 1 and np.array_equal(found.arrays["w"], np.arange(100.0))
    assert newest.name in found.note
    if damage.startswith("flip"):
        assert "sha256 mismatch: expected" in found.note and ", got " in found.note


def test_fault_15_when_every_checkpoint_is_damaged_nothing_is_loaded(tmp_path):
    checkpoints = store.Checkpoints(tmp_path)
    for step in (1, 2):
        checkpoints.save(step, {"w": np.zeros(3)}, {}).write_bytes(b"rubbish")
    with pytest.raises(StoreError, match="no checkpoint is intact.*step_000000000002.*step_000000000001"):
        checkpoints.latest()


# protocol 2, written by hand: io.open("SPRUNG", "w")
PICKLE = b"\x80\x02cio\nopen\nX\x06\x00\x00\x00SPRUNGX\x01\x00\x00\x00w\x86R."


class _Trap:
    """Would create a file when unpickled."""

    def __reduce__(self):
        return (open, ("SPRUNG", "w"))


@pytest.mark.parametrize("kind", ["object array", "bare pickle", "torch style"])
@pytest.mark.parametrize("read", [store.read_npz, store.read_tensors])
def test_fault_16_pickled_objects_are_refused_and_never_run(tmp_path, monkeypatch, kind, read):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "x.npz"
    if kind == "object array":
        np.savez(path, a=np.array([_Trap(), None], dtype=object))
    elif kind == "bare pickle":
        path.write_bytes(PICKLE)
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("archive/data.pkl", PICKLE)
    with pytest.raises(StoreError, match="pickled objects.*refused.*write_npz"):
        read(path)
    assert not (tmp_path / "SPRUNG").exists()
