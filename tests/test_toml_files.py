"""Whatever file a user hands in for a TOML, the answer is one clear line: binary, huge, deep, of wrong types, or no file."""

import tomllib
from pathlib import Path

import pytest

from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import FishmjError, UnknownName
from fishmj.effects import effect_calibration
from fishmj.log.importers.topics import read_topics
from fishmj.log.toml import dumps
from fishmj.mjcf import load_robot
from fishmj.water.hydro_model import HydroModel

ROOT = Path(__file__).resolve().parent.parent


FILES = {
    "binary": (b"\x7fELF\x02\x01\x01\x00\xff\xfe" * 20, "not UTF-8"),
    "latin": ('title = "caf\xe9"'.encode("latin-1"), "line 1.*not UTF-8"),
    "zeros": (b"\x00" * 50, "not valid TOML.*line 1"),
    "huge": (b"# " + b"x" * 1_000_001, "larger than 1 MB"),
    "deep": (b"a = " + b"[" * 5000 + b"]" * 5000, "nested too deep"),
    "nested": (b"a = " + b"[" * 100 + b"]" * 100, "nested deeper"),
    "tables": (b"a = " + b"{b = " * 300 + b"1" + b"}" * 300, "nested"),
    "dotted": (b".".join([b"a"] * 200_000) + b" = 1", "line 1: a key of more than 64 parts"),
    "header": (b'name = "x"\n[' + b" . ".join([b'"a"'] * 20_000) + b"]", "line 2: a key of more than 64 parts"),
    "digits": (b"a = " + b"1" * 5000, "not valid TOML"),
    "hexadecimal": (b"a = 0x" + b"f" * 5000, "an integer of 20000 bits"),
    "syntax": (b"a = 1\nb = = 2\n", "not valid TOML.*line 2"),
    "twice": (b"a = 1\na = 2\n", "not valid TOML.*line 2"),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_is_no_toml_is_one_clear_line(tmp_path, kind):
    raw, told = FILES[kind]
    path = tmp_path / "x.toml"
    path.write_bytes(raw)
    for read in (load_robot, read_toml, effect_calibration.read, HydroModel.load):
        with pytest.raises(FishmjError, match=told) as caught:
            read(path)
        assert str(path) in str(caught.value) and len(str(caught.value)) < 500 and "\n" not in str(caught.value)


def test_folder_missing_file_or_invalid_name_gives_one_clear_error(tmp_path):
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "fish.txt").write_text("x")
    cases = [
        (tmp_path / "folder.toml", "is a folder"), (tmp_path, "is a folder"), (tmp_path / "none.toml", "no such file"),
        (tmp_path / "fish.txt", "does not end in .toml"),
        ("x" * 5000 + ".toml", "cannot be read|no such file"),
        ("x" * 5000, "unknown"), ("a\0b.toml", "cannot be read: embedded null byte"),
        ("", "expected the path"), (None, "expected the path"),
        (3, "expected the path"),
    ]  # fmt: skip
    for source, told in cases:
        with pytest.raises(FishmjError, match=told) as caught:
            load_robot(source)
        assert len(str(caught.value)) < 800
    with pytest.raises(UnknownName, match="Did you mean 'fish'"):
        load_robot("fsh")


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path):
    path = tmp_path / "fish.toml"
    path.write_bytes(b"\xef\xbb\xbf" + resolve("fish").read_bytes().replace(b"\n", b"\r\n"))
    assert load_robot(path) == load_robot("fish")


# other files that a user hands in


@pytest.mark.parametrize("kind", [k for k in FILES if k not in ("huge", "hexadecimal")])
def test_a_map_of_topics_that_is_no_toml_is_one_clear_line(tmp_path, kind):
    (tmp_path / "topics.toml").write_bytes(FILES[kind][0])
    with pytest.raises(FishmjError) as caught:
        read_topics(tmp_path / "topics.toml")
    assert len(str(caught.value)) < 500


WATERS = [
    {},
    {"schema": 3},
    {"weights": 3},
    {"base": [1]},
    {"band": 3},
    {"found": "x"},
    {"dt": "x"},
    {"weights": {"file": 3}},
    {"name": 3},
]


@pytest.mark.parametrize("change", WATERS, ids=str)
def test_a_fitted_water_of_wrong_types_is_one_clear_line(tmp_path, change):
    path = resolve("fish").parent.parent / "water" / "swift.toml"
    table = tomllib.loads(path.read_text(encoding="utf-8")) | change if change else {}
    (tmp_path / "w.toml").write_text(dumps(table))
    (tmp_path / "swift.safetensors").write_bytes(path.with_suffix(".safetensors").read_bytes())
    with pytest.raises(FishmjError, match="w.toml"):
        HydroModel.load(tmp_path / "w.toml")
