"""Claims about files: atomic, checked, without pickle."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.base import store
from fishmj.base.errors import StoreError
from fishmj.base.store import atomic, left_out, shipped
from fishmj.base.store.temporary import HOST


@pytest.fixture
def arrays():
    return {
        "a": np.arange(12.0).reshape(3, 4),
        "step": np.array(7),
        "flag": np.array([True, False]),
        "f16": np.ones(3, np.float16),
    }


def test_written_bytes_come_back_and_leave_no_temporary_file(tmp_path):
    path = store.write_bytes(tmp_path / "deep" / "x.bin", b"hello")
    assert path.read_bytes() == b"hello"
    assert [p.name for p in path.parent.iterdir()] == ["x.bin"]


def test_an_unwritable_folder_is_a_store_error_with_its_errno(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StoreError, match="could not be written") as caught:
        store.write_text(tmp_path / "file" / "x", "y")
    assert caught.value.errno in (errno.ENOTDIR, errno.EEXIST)


def test_json_is_strict_and_knows_numpy(tmp_path):
    value = {"a": np.float32(0.5), "b": np.arange(2), "c": float("nan"), "d": (1, True, None), "e": tmp_path}
    text = store.write_json(tmp_path / "x.json", value).read_text()
    assert json.loads(text) == {"a": 0.5, "b": [0, 1], "c": None, "d": [1, True, None], "e": str(tmp_path)}
    assert store.read_json(tmp_path / "x.json")["b"] == [0, 1]


def test_broken_json_names_the_place(tmp_path):
    (tmp_path / "x.json").write_text('{"a": 1,')
    with pytest.raises(StoreError, match="line 1 column"):
        store.read_json(tmp_path / "x.json")


def test_npz_round_trips_bits_shapes_and_types(tmp_path, arrays):
    back = store.read_npz(store.write_npz(tmp_path / "x.npz", arrays))
    assert set(back) == set(arrays)
    for name, value in arrays.items():
        assert back[name].dtype == value.dtype and back[name].shape == value.shape and np.array_equal(back[name], value)


def test_tensors_round_trip_with_zero_d_arrays_and_meta(tmp_path, arrays):
    meta = {"shape": (11, 3), "rate": np.float64(0.1), "name": "paper", "nested": {"a": [1, 2]}}
    back, header = store.read_tensors(store.write_tensors(tmp_path / "x.safetensors", arrays, meta))
    assert back["step"].shape == () and back["step"] == 7
    assert all(np.array_equal(back[k], v) and back[k].dtype == v.dtype for k, v in arrays.items())
    assert header == {"shape": [11, 3], "rate": 0.1, "name": "paper", "nested": {"a": [1, 2]}}


def test_transposed_and_big_endian_arrays_keep_their_values(tmp_path):
    wanted = {"t": np.arange(6.0).reshape(2, 3).T, "b": np.arange(3, dtype=">f4"), "e": np.zeros((0, 3))}
    back, _ = store.read_tensors(store.write_tensors(tmp_path / "x.safetensors", wanted, {}))
    assert all(np.array_equal(back[k], v) and back[k].shape == v.shape for k, v in wanted.items())


def test_tensors_written_by_others_are_refused_with_the_reason(tmp_path):
    from safetensors.numpy import save_file

    save_file({"a": np.zeros(3)}, tmp_path / "x.safetensors")
    with pytest.raises(StoreError, match="not a fishmj tensor file"):
        store.read_tensors(tmp_path / "x.safetensors")


@pytest.mark.parametrize("value", [np.array(["text"]), np.array([object()])])
def test_only_numbers_go_into_tensors(tmp_path, value):
    with pytest.raises(StoreError, match="only numbers and bools"):
        store.write_tensors(tmp_path / "x.safetensors", {"a": value}, {})


def test_manifest_lists_missing_and_changed_files_with_both_hashes(tmp_path):
    for name in ("a.txt", "sub/b.txt", "c.txt"):
        store.write_text(tmp_path / name, name)
    (tmp_path / ".hidden").write_text("not part of it")
    store.Manifest.of(tmp_path, {"origin": "synthetic"}).write(tmp_path)
    manifest = store.Manifest.read(tmp_path)
    assert set(manifest.files) == {"a.txt", "sub/b.txt", "c.txt"} and manifest.meta == {"origin": "synthetic"}
    assert manifest.check(tmp_path) == []
    manifest.verify(tmp_path)
    (tmp_path / "a.txt").write_text("changed")
    (tmp_path / "sub/b.txt").unlink()
    changed, missing = manifest.check(tmp_path)
    assert changed.expected == manifest.files["a.txt"] and changed.got == store.sha256(tmp_path / "a.txt")
    assert missing.got is None
    with pytest.raises(StoreError, match="2 of 3 files missing or changed") as caught:
        manifest.verify(tmp_path)
    assert changed.got in str(caught.value) and "sub/b.txt" in str(caught.value) and "no such file" in str(caught.value)


@pytest.mark.parametrize("name", ["/etc/passwd", "../outside", "a/../../b"])
def test_a_manifest_may_not_leave_its_folder(tmp_path, name):
    store.write_json(tmp_path / "manifest.json", {"files": {name: "0" * 64}})
    with pytest.raises(StoreError, match="outside the folder"):
        store.Manifest.read(tmp_path)


def dead_process() -> int:
    """Number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def left_by(pid: int, target: str, ending: str = "") -> str:
    """The name of a temporary file that a process of this machine left."""
    return f".{target}.{HOST}-{pid}-0123abcd{ending}.tmp"


def test_temporaries_of_killed_process_are_removed(tmp_path):
    pid = dead_process()
    (tmp_path / left_by(pid, "set")).mkdir()
    (tmp_path / left_by(pid, "set") / "half.npz").write_bytes(b"half")
    (tmp_path / left_by(pid, "a.toml")).write_text("half")
    kept = {left_by(os.getpid(), "b.toml"), ".c.toml.ffffffff-1-0123abcd.tmp", ".d.tmp", "e.tmp"}  # running, elsewhere, not ours
    for name in kept:
        (tmp_path / name).write_text("whole")
    store.write_text(tmp_path / "new.txt", "x")
    assert {p.name for p in tmp_path.iterdir()} == kept | {"new.txt"}


def test_data_moved_aside_by_killed_process_return(tmp_path):
    pid = dead_process()
    for target in ("gone", "there"):
        (tmp_path / left_by(pid, target, ".old")).mkdir()
        (tmp_path / left_by(pid, target, ".old") / "data").write_text("old")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "data").write_text("new")
    store.write_text(tmp_path / "new.txt", "x")
    assert (tmp_path / "gone" / "data").read_text() == "old" and (tmp_path / "there" / "data").read_text() == "new"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gone", "new.txt", "there"]


def test_checkpoints_keep_the_newest_and_clean_up_after_a_killed_writer(tmp_path):
    checkpoints = store.Checkpoints(tmp_path, keep=2)
    assert checkpoints.latest() is None
    (tmp_path / left_by(dead_process(), "step_000000000009.safetensors")).write_bytes(b"half")
    for step in (1, 2, 10):
        checkpoints.save(step, {"w": np.full(3, step)}, {"seed": 1})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["step_000000000002.safetensors", "step_000000000010.safetensors"]
    latest = checkpoints.latest()
    assert latest.step == 10 and latest.meta == {"seed": 1, "step": 10} and latest.note == "" and latest.arrays["w"][0] == 10


def test_a_write_is_synced_before_it_is_renamed(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda handle: (order.append("fsync"), fsync(handle))[1])
    monkeypatch.setattr(os, "replace", lambda a, b: (order.append("replace"), replace(a, b))[1])
    store.write_bytes(tmp_path / "x", b"1")
    assert order == ["fsync", "replace", "fsync"]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_mutated_archives_raise_only_store_errors_or_read_the_same(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("fuzz")
    original = {"a": np.linspace(0, 1, 50), "b": np.arange(6).reshape(2, 3)}
    for path in (store.write_npz(folder / "x.npz", original), store.write_tensors(folder / "x.safetensors", original, {"k": 1})):
        raw = bytearray(path.read_bytes())
        if data.draw(st.booleans()):
            raw = raw[: data.draw(st.integers(0, len(raw) - 1))]
        for place in data.draw(st.lists(st.integers(0, max(len(raw) - 1, 0)), max_size=4)):
            if raw:
                raw[place] ^= 1 << data.draw(st.integers(0, 7))
        path.write_bytes(bytes(raw))
        try:
            read = store.read_npz(path) if path.suffix == ".npz" else store.read_tensors(path)[0]
        except StoreError:
            continue
        for name, value in read.items():
            assert name not in original or np.array_equal(value, original[name])


def test_shipped_data_are_found_from_any_folder_unless_the_user_has_a_copy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = shipped("data/gap/lbm/nulls")
    assert found.is_absolute() and len(list(found.glob("*.npz"))) == 48
    assert shipped("data/no/such") == Path("data/no/such") and shipped("gap/lbm/nulls") == Path("gap/lbm/nulls")
    (tmp_path / "data" / "gap" / "lbm" / "nulls").mkdir(parents=True)
    assert shipped("data/gap/lbm/nulls") == Path("data/gap/lbm/nulls")


def test_an_installed_package_says_where_the_rest_of_the_data_is(monkeypatch, tmp_path):
    assert left_out("data/gap/lbm/planted") == "", "a checkout has all"
    monkeypatch.setattr("fishmj.base.store.manifest.FOLDERS", (tmp_path / "data" / "calib",))
    assert "checkout or the source distribution (sdist)" in left_out("data/gap/lbm/planted")
    assert left_out("elsewhere/data") == ""


def test_clear_removes_what_it_names_and_nothing_else(tmp_path):
    (tmp_path / "logs" / "a").mkdir(parents=True)
    for name in ("report.html", "mine.html", "logs/a/x", "logs/b"):
        (tmp_path / name).write_text("x")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "kept").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "outside")
    store.clear(tmp_path, "report.html", "logs/a", "link", "not_there*")
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert left == {"mine.html", "logs", "logs/b", "outside", "outside/kept"}
    store.clear(tmp_path / "nowhere", "*")


def test_what_differs_between_two_tables_is_told_once_for_all_commands():
    mine, theirs = {"a": {"b": 1, "c": None}, "d": 2, "e": "x", "f": 3}, {"a": {"b": 2, "c": 4}, "d": 2, "f": 4, "g": 5}
    told = atomic.differing(mine, theirs, "{key}: {mine}, not {theirs}", free=("f",))
    assert told == "a.b: 1, not 2; a.c: not set, not 4; g: not set, not 5 and 1 more"
    assert atomic.differing(mine, mine, "{key}") == "" == atomic.differing({"a": None}, {}, "{key}")
