"""Fault 20 for foreign recordings: whatever is wrong in them is refused at its place, with the fix."""

import shutil

import numpy as np
import pytest
import recordings
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.base.errors import FishmjError, LogError
from fishmj.log import importers


# ------------------------------------------------------------------------------------------------------------ flat csv
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "t [s],c1 [deg]\n0,10\n",
            r"samples.csv:1:7: column 'c1' is in deg; the schema says rad. Multiply the column by 0.0174532925",
        ),
        ("t [ms],c1\n0,0\n", r"samples.csv:1:1: column 't' is in ms; the schema says s. Multiply the column by 0.001 and"),
        ("t,x [mm],y,yaw\n0,0,0,0\n", r"samples.csv:1:3: column 'x' is in mm; the schema says m"),
        (
            "t,surge (knots)\n0,0\n",
            r"samples.csv:1:3: column 'surge' is in knots; the schema says m/s. Multiply the column by 0.514444444 and",
        ),
        ("t,surge (BL/s)\n0,0\n", r"samples.csv:1:3: column 'surge' is in BL/s; .* Convert the column to m/s and write"),
        ("t,c1 [rad],c1 (rad)\n0,0,0\n", r"samples.csv:1:12: column 'c1' appears twice"),
        ("t,c1\n0,57.3\n", r"samples.csv:2:3: column 'c1': 57.3 looks like degrees"),
        ("t;c1\n0,02;0,1\n", r"samples.csv:1:2: columns are separated by semicolons .*decimal commas"),
        ("t,c1\n0,02,0,1\n", r"samples.csv:2:6: 4 values in a row of 2 columns; decimal commas\?"),
        ("\ufefft,c1\n0,0\n", r"samples.csv:1:1: starts with a byte order mark"),
        ("t,oddity\n0,0\n", r"samples.csv:1:1: no column of a known table"),
    ],
)
def test_fault_20_flat_csv_with_wrong_units_or_format_is_refused_with_fix(tmp_path, text, message):
    (tmp_path / "samples.csv").write_text(text, encoding="utf-8")
    assert importers.sniff(tmp_path) == "flat_csv"
    with pytest.raises(LogError, match=message):
        importers.read(tmp_path)


# ------------------------------------------------------------------------------------------------------- foreign faults
def change(path, old, new, count=1):
    text = path.read_bytes()
    assert old in text
    path.write_bytes(text.replace(old, new, count))


@pytest.mark.parametrize(
    ("maker", "file", "old", "new", "message"),
    [
        ("tail_fish", "Amp15Bias-20/STATES1.txt", b"0.066667", b"nan", r"STATES1.txt:1:1: column 't' is nan"),
        (
            "tail_fish",
            "Amp15Bias-20/STATES1.txt",
            b"0.066667",
            b"0,0667",
            r"STATES1.txt:1:1: column 't' has a decimal comma, '0,0667'",
        ),
        ("tail_fish", "Amp15Bias-20/STATES1.txt", b"0.066667 ", b"", r"STATES1.txt:1:1: 6 columns; expected 7: t, surge"),
        (
            "tail_fish",
            "Amp15Bias-20/control15-201.txt",
            b" 15 -20",
            b" 15 -21",
            r"control15-201.txt:1:10: bias_deg = -21, .* folder says -20",
        ),
        (
            "servo_xl330",
            "made_up.json",
            b'"load": ',
            b'"load": 9',
            r"made_up.json:1:\d+: load = 965\d+; expected a 16-bit register",
        ),
        ("servo_xl330", "made_up.json", b'"speed"', b'"sped"', r"made_up.json:1:\d+: entry 1 lacks 'speed'"),
        (
            "servo_xl330",
            "made_up.json",
            b'"temp": 28',
            b'"temp": NaN',
            r"made_up.json:1:\d+: temp = 'nan'; expected a finite number",
        ),
        ("servo_xl330", "made_up.json", b'"kp": 200', b'"kp": 0', r"made_up.json:1:31: kp = '0'; expected a positive number"),
        ("servo_xl330", "made_up.json", b"}]}", b"}", r"made_up.json:1:\d+: not valid JSON"),
        ("tendon_fish_markers", "markers_f1_00.csv", b",", b";", r"markers_f1_00.csv:1:1: 17 columns; expected 18"),
        (
            "tendon_fish_markers",
            "rotatedMarkers_f1_00.csv",
            b"\n",
            b"\n0,0\n",
            r"rotatedMarkers_f1_00.csv:361:1: 361 rows are no whole",
        ),
        ("usv_coastdown", "surge_6.csv", b"-0.017", b"", r"surge_6.csv:1:9: column 'yaw_rate' is blank"),
        ("usv_coastdown", "surge_6.csv", b"2.00000;", b"200;", r"surge_6.csv:1:1: column 'surge': 200 looks like mm/s"),
    ],
)
def test_fault_20_a_faulty_recording_is_refused_at_file_line_column(tmp_path, maker, file, old, new, message):
    root = recordings.MAKERS[maker](tmp_path)
    change(root / file, old, new)
    with pytest.raises(LogError, match=message):
        importers.read(root, maker)


# ---------------------------------------------------------------------------------------------------------------- fuzz
_JUNK = [b",", b"\n", b";", b"-", b"e9", b"nan", b"[", b'"', b"}", b"\x00", b"1e999", b" ", b"9" * 400, "é;".encode(), b"null"]


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """One small recording in every format, to be damaged."""
    root = tmp_path_factory.mktemp("valid")
    small = {name: {"frames": 12} if name in ("tail_fish", "tendon_fish_markers") else {"rows": 12} for name in recordings.MAKERS}
    out = {name: make(root / name, **small[name]) for name, make in recordings.MAKERS.items()}
    recordings.recording(root / "mcap", messages=6)
    return out | {"mcap": root / "mcap"}


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_fault_20_mutated_recordings_raise_only_our_errors(tmp_path_factory, valid, data):
    name = data.draw(st.sampled_from(sorted(valid)))
    folder = tmp_path_factory.mktemp("fuzz") / "a"
    shutil.copytree(valid[name], folder)
    path = data.draw(st.sampled_from(sorted(p for p in folder.rglob("*") if p.is_file())))
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
        trials = importers.read(folder / "swim.mcap" if name == "mcap" else folder, name)
    except FishmjError as error:
        assert str(error) and len(str(error)) < 2000
        return
    for trial in trials.values():  # what is accepted is sound
        for table in trial.tables.values():
            assert all(np.isfinite(v).all() for v in table.values()) and (np.diff(table["t"]) > 0).all()
