"""Foreign recordings come in as trials: SI units, their own stamps, and one clear error at file:line:column."""

import json
import math

import lab_files
import numpy as np
import pytest
import recordings
from absent import absent

from fishmj import log
from fishmj.base import console
from fishmj.base.errors import LogError, MissingExtra, StoreError, UnknownName
from fishmj.log import __main__ as command
from fishmj.log import importers
from fishmj.log.dataset import take


@pytest.mark.parametrize("name", recordings.MAKERS)
def test_every_format_is_recognised_and_read_without_resampling(tmp_path, name):
    path = recordings.MAKERS[name](tmp_path / "raw")
    assert importers.sniff(path) == name
    trials = importers.read(path)
    assert trials and all(trial.meta["origin"] == "measured" and trial.name == key for key, trial in trials.items())
    folder = log.write_dataset(tmp_path / "set", trials)
    for back in log.read_dataset(folder):
        for table, columns in trials[back.name].tables.items():
            assert all(np.array_equal(columns[c], back.tables[table][c]) for c in columns), (table, back.name)


def test_tail_fish_comes_in_radians_with_both_clocks_as_they_are(tmp_path):
    trials = importers.read(recordings.tail_fish(tmp_path))
    assert set(trials) == {"amp15_bias-20_1", "amp15_bias-20_2"}
    one, two = trials.values()
    assert one.tables["gait"]["amplitude"][0] == math.radians(15) and one.tables["gait"]["bias"][0] == math.radians(-20)
    assert one.tables["pose"]["t"][0] == pytest.approx(2 / 30, abs=1e-6) and one.tables["gait"]["t"][0] > 0.3
    assert any("video time may run 2.3" in note for note in one.notes)
    assert one.value("clock_ratio.pose") == pytest.approx(30 * 0.078, rel=0.01) and two.value("clock_ratio.pose") is None
    assert "gait" not in two.tables and any("control15-202.txt: missing" in note for note in two.notes)


def test_servo_import_decodes_signed_load_and_keeps_irregular_stamps(tmp_path):
    folder = recordings.servo(tmp_path, rows=150)
    entries = json.loads((folder / "made_up.json").read_text())["entries"]
    trial = importers.read(folder)["made_up"]
    load = trial.tables["joint"]["load1"]
    assert load.min() < -0.05 < 0 < load.max() and np.array_equal(trial.tables["joint"]["t"], [e["timestamp"] for e in entries])
    assert trial.value("excitation") == "sin_sin_kp200" and trial.value("rig.mass") == 0.49
    assert "I" not in trial.tables["power"] and (trial.tables["cmd"]["on1"] == 1).all()


def test_marker_pixels_become_metres_and_a_heading(tmp_path):
    trial = importers.read(recordings.tendon(tmp_path))["f1_00"]
    points = [log.stacked(trial.tables["markers"], f"p#{axis}") for axis in "xy"]
    apart = np.hypot(points[0][:, 1] - points[0][:, 0], points[1][:, 1] - points[1][:, 0])
    assert apart == pytest.approx(0.142, abs=1e-9)
    assert np.cos(trial.tables["pose"]["yaw"][0] - (math.pi - 0.2)) == pytest.approx(1, abs=1e-9)  # y of a picture points down
    assert trial.value("motor.frequency") == 1.0
    (tmp_path / "markers_f1_00.csv").unlink()
    alone = importers.read(tmp_path)["f1_00"]
    assert set(alone.tables) == {"markers"} and any("no pose" in note for note in alone.notes)


def test_two_marker_files_that_disagree_are_refused(tmp_path):
    folder = recordings.tendon(tmp_path)
    path = folder / "rotatedMarkers_f1_00.csv"
    lines = path.read_text().split("\n")
    lines[13] = "0.9,0.1"
    path.write_text("\n".join(lines))
    with pytest.raises(LogError, match=r"rotatedMarkers_f1_00.csv:10:1: frame 2 differs from the pixel file"):
        importers.read(folder)


def test_boat_rows_of_both_layouts_turn_bearings_into_headings(tmp_path):
    trials = importers.read(recordings.boat(tmp_path))
    assert set(trials["surge_6"].tables) == {"pose", "velocity"} and set(trials["surge_12"].tables) == {"pose", "velocity", "imu"}
    pose = trials["surge_12"].tables["pose"]
    assert (
        pose["yaw"][0] == pytest.approx(math.pi / 2 - 2.5)
        and pose["x"][1] == pytest.approx(-0.02)
        and pose["y"][1] == pytest.approx(0.01)
    )
    assert trials["surge_12"].tables["imu"]["wz"][0] == pytest.approx(math.radians(-0.79))
    assert any("surge jumps" in note for note in trials["surge_6"].notes)
    assert any("x was printed with six digits: steps of 1 m" in note for note in trials["surge_6"].notes)


def test_one_stray_stamp_is_left_out_with_a_note_and_many_are_refused(tmp_path):
    trial = importers.read(recordings.boat(tmp_path, rows=120, stray=True))["surge_6"]
    assert len(trial.tables["pose"]["t"]) == 119 and any("surge_6.csv:31:" in note and "left out" in note for note in trial.notes)
    path = tmp_path / "surge_6.csv"
    lines = path.read_text().split("\n")
    path.write_text("\n".join(lines[60:120] + lines[:60]) + "\n")
    with pytest.raises(LogError, match=r"surge_6.csv:61:\d+: time goes back: .* rows are out of order"):
        importers.read(path)


def test_a_path_that_is_no_recording_lists_the_formats(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing here")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(LogError, match="none of the known formats .*tail_fish.*usv_coastdown"):
            importers.read(path)
    with pytest.raises(LogError, match="no such file or folder"):
        importers.read(tmp_path / "nowhere")
    with pytest.raises(UnknownName, match="Did you mean 'mcap'"):
        importers.read(tmp_path, "mcaps")
    with pytest.raises(LogError, match="nothing in format tail_fish"):
        importers.read(tmp_path, "tail_fish")


def change(path, old, new, count=1):
    text = path.read_bytes()
    assert old in text
    path.write_bytes(text.replace(old, new, count))


# -------------------------------------------------------------------------------------------------------------- MCAP
def test_mcap_topics_become_tables_as_the_toml_says(tmp_path):
    trial = importers.read(recordings.recording(tmp_path))["swim"]
    cmd, pose = trial.tables["cmd"], trial.tables["pose"]
    assert np.allclose(cmd["c2"], 0.02 * np.arange(20)) and np.allclose(pose["x"], 0.01 * np.arange(20))
    assert np.allclose(pose["yaw"], math.pi / 2) and trial.meta["robot"] == "swift"
    assert np.allclose(cmd["t"] - pose["t"], 0.03, atol=1e-9) and pose["t"][0] == 0.0  # two clocks, one zero
    assert trial.meta["clock"] == {"cmd": "publish_time", "pose": "header.stamp"}


def test_mcap_topics_named_like_tables_need_no_toml(tmp_path):
    trial = importers.read(recordings.recording(tmp_path, mapped=False))["swim"]
    assert set(trial.tables) == {"cmd", "pose"} and np.allclose(trial.tables["cmd"]["c1"], 0.01 * np.arange(20))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            b"/bus/command",
            b"/bus/commands",
            r"swim.mcap: no topic '/bus/commands' for table 'cmd'; it has '/bus/command', '/camera/fish'",
        ),
        (b"position.0", b"position.9", r"swim.mcap:/bus/command\[0\]: no field 'position.9'; at '9'"),
        (b'"deg" } }\n\n', b'"grad" } }\n\n', r"swim.toml: \[tables.cmd\]: c2: unit 'grad' is not known"),
        (b"[tables.cmd]", b"[tables.command]", r"swim.toml: \[tables.command\]: no such table"),
        (
            b'unit = "deg" } }\n\n',
            b'unit = "" } }\n\n',
            r"swim.mcap:/bus/command\[3\]:c2: column 'c2': 3.43775 looks like degrees",
        ),
        (b"[meta]", b"[meta", r"swim.toml:\d+:\d+: not valid TOML"),
    ],
)
def test_a_wrong_topic_mapping_is_named(tmp_path, old, new, message):
    path = recordings.recording(tmp_path)
    change(path.with_suffix(".toml"), old, new)
    with pytest.raises(LogError, match=message):
        importers.read(path)


def test_mcap_in_another_encoding_or_damaged_is_refused(tmp_path):
    with pytest.raises(LogError, match=r"messages are encoded as 'cdr' without a schema; expected json, or cdr of"):
        importers.read(recordings.recording(tmp_path / "a", encoding="cdr"))
    path = recordings.recording(tmp_path / "b")
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(LogError, match=r"swim.mcap: damaged, cut off, or no MCAP file"):
        importers.read(path)


def test_without_the_mcap_package_the_install_line_is_given(tmp_path, monkeypatch):
    path = recordings.recording(tmp_path)
    absent(monkeypatch, "mcap")
    with pytest.raises(MissingExtra, match=r'pip install "fishmj\[logs\]"'):
        importers.read(path)


# ------------------------------------------------------------------------------------------------------------- command
def test_import_keeps_licence_source_and_notes_and_refuses_to_overwrite(tmp_path, capsys):
    source = recordings.tail_fish(tmp_path / "raw")
    assert console.run(command.main, ["import", str(source), "--out", str(tmp_path / "set"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.strip().split("\n")[-1])
    assert told["format"] == "tail_fish" and len(told["trials"]) == 2 and told["meta"]["licence"] == "MIT"
    data = log.read_dataset(tmp_path / "set")
    assert "Mamakoukas" not in data.meta["source"] and "DerivativeBasedKoopman" in data.meta["source"]
    assert any("clocks:" in note for note in data["amp15_bias-20_1"].meta["notes"])
    assert console.run(command.main, ["import", str(source), "--out", str(tmp_path / "set")]) == console.BAD_INPUT
    assert "exists; choose another name" in capsys.readouterr().err


def test_a_data_set_whose_meta_was_edited_fails_its_check_and_every_message_names_the_command(tmp_path, capsys):
    folder = log.write_dataset(tmp_path / "set", importers.read(recordings.boat(tmp_path / "raw")))
    first, second = log.read_dataset(folder).names
    with (folder / first / "meta.toml").open("a", encoding="utf-8") as meta:
        meta.write("# edited\n")
    (folder / second / "pose.csv").unlink()
    todo = f"if the change is meant: fishmj log manifest {folder}"
    assert console.run(command.main, ["check", str(folder)]) == console.FAILED_CHECK
    assert f"2 files changed or gone; restore it, or {todo}" in capsys.readouterr().out
    with pytest.raises(StoreError) as strict:
        log.read_dataset(folder)
    assert str(strict.value).endswith(todo)
    with pytest.raises(LogError, match="none of 2 trials can be read.* changed since the manifest was written; ") as taken:
        take(folder)
    assert str(taken.value).endswith(todo)
    assert console.run(command.main, ["manifest", str(folder)]) == console.OK
    assert len(take(folder).trials) == 2


def test_check_lists_every_trial_that_breaks_the_schema(tmp_path, capsys):
    folder = log.write_dataset(tmp_path / "set", importers.read(recordings.boat(tmp_path / "raw")))
    assert console.run(command.main, ["check", str(folder)]) == 0
    assert "2 trials read, 0 refused" in capsys.readouterr().out
    change(folder / "surge_6" / "pose.csv", b"t,x,y,yaw", b"t,x,y,heading")
    from fishmj.base.store import Manifest

    Manifest.of(folder).write(folder)
    assert console.run(command.main, ["check", str(folder), "--json"]) == console.FAILED_CHECK
    out = capsys.readouterr()
    assert "surge_6" in out.err and "lacks column 'yaw'" in json.loads(out.out.strip().split("\n")[-1])["refused"]["surge_6"]


@pytest.mark.parametrize("restarts", [False, True])
def test_a_column_that_counts_trials_is_no_one_trial(restarts, tmp_path, capsys, monkeypatch):
    """The fish is put back in between; of a clock that starts again, too, the column is named."""
    units = {"x": "x_mm", "y": "y_mm", "yaw": "yaw_deg"}
    bring, one = lab_files.importer(tmp_path, capsys, monkeypatch), {units.get(c, c): v for c, v in lab_files.swim().items()}
    both = {name: np.concatenate([values, values + (2.6 if name == "t" and not restarts else 0)]) for name, values in one.items()}
    file = lab_files.write(tmp_path / "in" / "both.csv", both | {"Trial no": np.repeat([3, 4], lab_files.ROWS)})
    code, _, err = bring(file, "--yes")
    assert code == 2 and "column 'Trial no' holds 2 values (3, 4): several trials or robots in one file; write a file" in err, err
    assert "--set 'Trial no'=skip to read them as one" in err
    if not restarts:
        assert bring(file, "--yes", "--set", "Trial no=skip")[0] == 0
    constant = lab_files.write(tmp_path / "single" / "one.csv", one | {"trial": np.full(lab_files.ROWS, 3)})
    assert bring(constant, "--yes", out=tmp_path / "one")[0] == 0
