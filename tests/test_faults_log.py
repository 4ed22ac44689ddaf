"""Fault 20: a log that breaks the schema is refused at file, line and column, with the fix."""

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import whole_trial

from fishmj import log
from fishmj.base.errors import FishmjError, LogError


def csv_trial(tmp_path, text, name="joint.csv", meta='schema = "fishmj.log/1"\norigin = "measured"\n'):
    (tmp_path / "meta.toml").write_text(meta)
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return tmp_path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,j1,j3\n0,1,1\n", r"joint.csv:1:6: table 'joint' lacks column 'j2'; it has t, j1, j3; expected t, j1..jN"),
        ("j1,j2\n1,1\n", r"joint.csv:1:4: table 'joint' lacks column 't'"),
        ("t,j1,j2\n0,0.1,0.1\n0.02,0.1,57.3\n", r"joint.csv:3:10: column 'j2': 57.3 looks like degrees; the schema says rad"),
        ("t,j1\n0,0\n0.02,0\n0.01,0\n", r"joint.csv:4:1: time goes back: 0.010000 s after 0.020000 s"),
        ("t,j1\n0,0\n0,0\n", r"joint.csv:3:1: time stands still"),
        ("t,j1\n0,0\n20,0\n40,0\n", r"joint.csv:3:1: the median step is 20 s, which looks like milliseconds"),
        ("t,j1\n0,0\n0.02,nan\n", r"joint.csv:3:6: column 'j1' is nan; values must be finite"),
        ("t,j1\n0,0\n0.02,-inf\n", r"joint.csv:3:6: column 'j1' is -inf"),
        ("t,j1\n0,0\n0.02,\n", r"joint.csv:3:6: column 'j1' is blank"),
        ("t,j1\n0,0\n0.02,zero\n", r"joint.csv:3:6: column 'j1' 'zero' is not a number"),
        ("t,j1\n0,0\n0.02,1_0\n", r"joint.csv:3:6: column 'j1' '1_0' is not a number"),
        (b"\xef\xbb\xbft,j1\n0,0\n", r"joint.csv:1:1: starts with a byte order mark \(UTF-8\); save it as plain UTF-8"),
        ("t,j1\n0,0\n".encode("utf-16"), r"joint.csv:1:1: starts with a byte order mark \(UTF-16\)"),
        (b"t,j1\n0,\xb0\n", r"joint.csv:2:3: byte 0xb0 is not UTF-8"),
        ("t;j1\n0,02;0,1\n", r"joint.csv:1:2: columns are separated by semicolons .*decimal commas"),
        ("t,j1\n0,02,0,1\n", r"joint.csv:2:6: 4 values in a row of 2 columns; decimal commas\? Write 0.02, not 0,02"),
        ("t,j1,j2\n0,0\n", r"joint.csv:2:4: 2 values in a row of 3 columns; is the row cut off"),
        ("", r"joint.csv:1:1: the file is empty"),
        ("t,j1\n", r"joint.csv:1:1: table 'joint' has no rows"),
        ("t,j1,j1\n0,0,0\n", r"joint.csv:1:6: column 'j1' appears twice"),
        ("t,,j1\n0,0,0\n", r"joint.csv:1:3: column 2 has no name"),
        ("0,0.1\n0.02,0.1\n", r"joint.csv:1:1: the first row holds numbers"),
    ],
)
def test_fault_20_a_faulty_csv_is_refused_at_file_line_column_with_the_fix(tmp_path, text, message):
    with pytest.raises(LogError, match=message):
        log.read_trial(csv_trial(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y,yaw\n0,0,0,-120\n", r"pose.csv:2:7: column 'yaw': -120 looks like degrees"),
        ("t,x,y,yaw\n" + "".join(f"{i / 50},0,0,{5 * i % 17}\n" for i in range(50)), "looks like degrees"),
        ("t,x,y,yaw\n0,1500,0,0\n", r"pose.csv:2:3: column 'x': starts at 1500, which looks like millimetres"),
    ],
)
def test_fault_20_wrong_units_of_a_pose_are_noticed(tmp_path, text, message):
    with pytest.raises(LogError, match=message):
        log.read_trial(csv_trial(tmp_path, text, "pose.csv"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,V\n0,7400\n0.02,7390\n", r"power.csv:2:3: column 'V': usually 7395, which looks like mV; the schema says V. Divide"),
        ("t,V\n0,0.0074\n0.02,0.0074\n", r"column 'V': usually 0.0074, which looks like kV; the schema says V. Multiply"),
        ("t,V,I\n0,7,800\n0.02,7,800\n", r"power.csv:2:5: column 'I': usually 800, which looks like mA"),
    ],
)
def test_wrong_units_of_a_supply_are_noticed_unless_they_are_allowed(tmp_path, text, message):
    with pytest.raises(LogError, match=message):
        log.read_trial(csv_trial(tmp_path, text, "power.csv"))
    allowed = "[plausible]\nvoltage = 1e4\nvoltage_least = 1e-3\ncurrent = 1e3\n"
    log.read_trial(csv_trial(tmp_path, text, "power.csv", 'schema = "fishmj.log/1"\norigin = "measured"\n' + allowed))


def test_an_unwrapped_heading_of_many_turns_is_fine(tmp_path):
    rows = "".join(f"{i / 50},0,0,{0.02 * i}\n" for i in range(3000))  # 1 rad/s for a minute
    assert log.read_trial(csv_trial(tmp_path, "t,x,y,yaw\n" + rows, "pose.csv")).tables["pose"]["yaw"][-1] == 0.02 * 2999


def test_a_heading_may_begin_after_a_few_turns(tmp_path):
    rows = "".join(f"{i / 50},0,0,{6.3 + 0.02 * i}\n" for i in range(100))
    log.read_trial(csv_trial(tmp_path, "t,x,y,yaw\n" + rows, "pose.csv"))


def test_windows_line_ends_quotes_and_spaces_are_fine(tmp_path):
    back = log.read_trial(csv_trial(tmp_path, '"t", j1\r\n0 , 0.5\r\n0.02,"0.6"\r\n\r\n'))
    assert np.array_equal(back.tables["joint"]["j1"], [0.5, 0.6])


def test_broken_meta_is_refused_at_its_line(tmp_path):
    with pytest.raises(LogError, match=r"meta.toml:2:1: not valid TOML"):
        log.read_trial(csv_trial(tmp_path, "t,j1\n0,0\n", meta='schema = "fishmj.log/1"\norigin = measured\n'))


def test_a_folder_without_meta_or_tables_says_what_to_write(tmp_path):
    with pytest.raises(LogError, match=r'meta.toml: missing; write at least schema = "fishmj.log/1"'):
        log.read_trial(tmp_path)
    (tmp_path / "meta.toml").write_text('origin = "measured"\n')
    with pytest.raises(LogError, match="no table found; expected at least one of cmd, joint"):
        log.read_trial(tmp_path)
    with pytest.raises(LogError, match="no such trial"):
        log.read_trial(tmp_path / "nowhere")


_JUNK = [b",", b"\n", b"-", b"e9", b"nan", b"[", b'"', b"=", b"\x00", b"1e999", b"[[a]]\n", "é;".encode()]


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """One small trial in both forms, to be damaged."""
    root = tmp_path_factory.mktemp("valid")
    return {form: log.write_trial(root / form, whole_trial(0.2), form=form) for form in ("csv", "npz")}


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_fault_20_mutated_trials_raise_only_our_errors(tmp_path_factory, valid, data):
    folder = tmp_path_factory.mktemp("fuzz") / "a"
    shutil.copytree(valid[data.draw(st.sampled_from(["csv", "npz"]))], folder)
    path = data.draw(st.sampled_from(sorted(folder.iterdir())))
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(raw) - 1, 0)))
        how = data.draw(st.sampled_from(["flip", "cut", "insert", "repeat"]))
        if how == "flip" and raw:
            raw[at] ^= 1 << data.draw(st.integers(0, 7))
        elif how == "cut":
            del raw[at : at + data.draw(st.integers(1, 40))]
        elif how == "insert":
            raw[at:at] = data.draw(st.sampled_from(_JUNK))
        else:
            raw[at:at] = raw[at : at + 30]
    path.write_bytes(bytes(raw))
    try:
        back = log.read_trial(folder)
    except FishmjError as error:
        assert str(error) and len(str(error)) < 2000
        return
    for table in back.tables.values():  # what is accepted is sound
        assert all(np.isfinite(v).all() for v in table.values()) and (np.diff(table["t"]) > 0).all()
