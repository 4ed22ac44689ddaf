"""Claims about trial folders: what is written comes back, what is wrong is named with file, line, column and fix."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import whole_trial

from fishmj import log
from fishmj.base import console
from fishmj.base.errors import LogError, StoreError, UnknownName
from fishmj.log import import_command, toml, trial_check
from fishmj.log.__main__ import main as log_command
from fishmj.log.table_files import HALF_ERROR, narrow


@pytest.fixture
def trial():
    return whole_trial()


def edit(folder, name, old, new, count=1):
    path = folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


# ---------------------------------------------------------------------------------------------------------- round trips
def test_csv_gives_back_every_bit(tmp_path, trial):
    back = log.read_trial(log.write_trial(tmp_path / "a", trial, form="csv"))
    assert set(back.tables) == set(trial.tables) == set(log.TABLES)
    for name, table in trial.tables.items():
        assert list(back.tables[name]) == list(table)
        assert all(np.array_equal(back.tables[name][c], v) for c, v in table.items())


def test_npz_keeps_time_exact_and_signals_to_a_thousandth(tmp_path, trial):
    back = log.read_trial(log.write_trial(tmp_path / "a", trial))
    assert sorted(p.suffix for p in (tmp_path / "a").iterdir()) == [".npz"] * len(log.TABLES) + [".toml"]
    for name, table in trial.tables.items():
        assert np.array_equal(back.tables[name]["t"], table["t"])
        for column, values in table.items():
            error = np.max(np.abs(back.tables[name][column] - values))
            assert back.tables[name][column].dtype == float
            assert error <= max(HALF_ERROR * np.std(values), 1e-6), (name, column)


@pytest.mark.parametrize(("precision", "kind"), [("float32", np.float32), ("float64", np.float64)])
def test_precision_can_be_fixed(tmp_path, trial, precision, kind):
    log.write_trial(tmp_path / "a", trial, precision=precision)
    with np.load(tmp_path / "a" / "pose.npz") as stored:
        assert stored["x"].dtype == kind and stored["t"].dtype == np.float64


def test_an_offset_does_not_hide_the_signal():
    wiggle = 0.01 * np.sin(np.linspace(0, 20, 1000))
    assert narrow(wiggle).dtype == np.float16
    assert narrow(wiggle + 50.0).dtype == np.float32  # float16 steps are 31 mm at 50 m
    assert narrow(wiggle * 1e6 + 1e9).dtype == np.float64  # float32 steps are 64 there
    assert narrow(wiggle * 1e300).dtype == np.float64
    assert narrow(np.full(9, 7.4)).dtype == np.float32 and narrow(np.full(9, 0.5)).dtype == np.float16


def test_meta_comes_back_with_unknown_keys_and_dotted_keys_unfolded(tmp_path, trial):
    extra = {"my.own.key": [1, 2.5, "x"], "robot": 'quo"te\n\x7f', "versions": {"fishmj": "0.1", "num py": "2"}, "gone": None}
    back = log.read_trial(log.write_trial(tmp_path / "a", log.Trial({**trial.meta, **extra}, trial.tables)))
    assert back.meta["my"]["own"]["key"] == [1, 2.5, "x"] and back.meta["robot"] == 'quo"te\n\x7f'
    assert back.meta["versions"] == {"fishmj": "0.1", "num py": "2"} and "gone" not in back.meta
    assert back.value("flow.speed") == 0.2 and back.value("flow.known", "?") == "?"
    assert back.meta["schema"] == "fishmj.log/1"


def test_missing_meta_keys_are_reported_not_fatal(tmp_path, trial):
    back = log.read_trial(log.write_trial(tmp_path / "a", trial))
    note = next(note for note in back.notes if "meta.toml" in note)
    assert "missing medium" in note and "licence" in note and "robot" not in note.split("missing")[1]


def test_reading_never_edits_the_source(tmp_path, trial):
    folder = log.write_trial(tmp_path / "a", trial, form="csv")
    before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}
    log.segments(log.read_trial(folder))
    assert {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()} == before


def test_flat_samples_are_split_over_the_tables(tmp_path):
    (tmp_path / "samples.csv").write_text(
        "t,c1,c2,j1,j2,x,y,yaw,V,I,oddity\n0,0,0,.1,.2,1,2,3,7.4,.5,9\n0.02,0,0,.1,.2,1,2,3,7.4,.5,9\n"
    )
    for path in (tmp_path, tmp_path / "samples.csv"):
        back = log.read_trial(path)
        assert set(back.tables) == {"cmd", "joint", "pose", "power"}
        assert list(back.tables["joint"]) == ["t", "j1", "j2"] and back.tables["pose"]["yaw"][1] == 3
        assert any("oddity" in note for note in back.notes) and any("meta.toml" in note for note in back.notes)


def test_numbered_and_stacked_are_inverse():
    values = np.arange(24.0).reshape(2, 12)
    table = {"t": np.arange(2.0), **log.numbered("u#x", values)}
    assert list(table)[1] == "u1x" and np.array_equal(log.stacked(table, "u#x"), values)
    assert log.stacked(table, "j#").shape == (2, 0)


# ------------------------------------------------------------------------------------------------------------- writing
def test_an_existing_folder_is_not_overwritten_unless_told(tmp_path, trial):
    folder = log.write_trial(tmp_path / "a", trial)
    with pytest.raises(StoreError, match="exists; choose another name or pass overwrite=True"):
        log.write_trial(folder, trial)
    log.write_trial(folder, log.Trial(trial.meta, {"target": trial.tables["target"]}), overwrite=True)
    assert sorted(p.name for p in folder.iterdir()) == ["meta.toml", "target.npz"]
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_folder_that_is_no_trial_is_never_overwritten(tmp_path, trial):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("ten years")
    with pytest.raises(StoreError, match="is no trial"):
        log.write_trial(tmp_path / "home", trial, overwrite=True)
    assert (tmp_path / "home" / "thesis.txt").read_text() == "ten years"


def test_an_invalid_trial_leaves_nothing_behind(tmp_path, trial):
    trial.tables["pose"]["yaw"][7] = np.nan
    with pytest.raises(LogError, match=r"pose:9:yaw: column 'yaw' is nan"):
        log.write_trial(tmp_path / "a", trial)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("meta", "message"),
    [
        ({}, "origin is not set"),
        ({"origin": "guessed"}, "origin = 'guessed'; expected one of 'measured', 'synthetic'"),
        ({"origin": "measured", "schema": "fishmj.log/7"}, "schema = 'fishmj.log/7'; expected 'fishmj.log/1'"),
        ({"origin": "measured", "flow.direction": 90}, "flow.direction = 90.0 looks like degrees"),
        ({"origin": "measured", "flow.speed": -0.1}, "negative"),
        ({"origin": "measured", "flow.speed": "fast"}, "expected a finite number"),
        ({"origin": "measured", "notes": object()}, "'notes': object has no TOML form"),
        ({"origin": "measured", "flow": 3, "flow.speed": 1}, "is a value already"),
    ],
)
def test_impossible_meta_is_refused_on_writing(tmp_path, trial, meta, message):
    with pytest.raises(LogError, match=message):
        log.write_trial(tmp_path / "a", log.Trial(meta, trial.tables))


def test_unknown_table_names_the_closest(tmp_path, trial):
    with pytest.raises(UnknownName, match="Did you mean 'joint'"):
        log.write_trial(tmp_path / "a", log.Trial(trial.meta, {"joints": trial.tables["joint"]}))
    with pytest.raises(LogError, match="no table 'wrench'; it has target"):
        log.Trial({}, {"target": trial.tables["target"]}).table("wrench")


def test_two_files_for_one_table_are_refused(tmp_path, trial):
    folder = log.write_trial(tmp_path / "a", trial)
    (folder / "pose.csv").write_text("t,x,y,yaw\n0,0,0,0\n")
    with pytest.raises(LogError, match="as .csv and as .npz; remove one"):
        log.read_trial(folder)


def test_extra_files_columns_and_unequal_joints_become_notes(tmp_path, trial):
    trial.tables["pose"] |= {"temperature": np.full(200, 20.0), "salt": np.full(200, 1.0)}
    del trial.tables["cmd"]["c3"]
    folder = log.write_trial(tmp_path / "a", trial)
    (folder / "video.csv").write_text("anything")
    for name in ("Gait.CSV", "power.csv.gz"):
        (folder / name).write_text("anything")
    edit(folder, "meta.toml", "origin =", "joints = 4\norigin =")
    notes = "\n".join(log.read_trial(folder).notes)
    assert "pose: 'temperature', 'salt' are not in the schema; kept" in notes
    assert "video.csv: no table of the schema" in notes and "cmd 2, joint 3" in notes and ", meta 4" in notes
    assert "Gait.CSV: not read; expected gait.csv or gait.npz" in notes and "power.csv.gz: not read; expected power.csv" in notes


# ------------------------------------------------------------------------------------------------------------ segments
def test_gaps_over_a_tenth_of_a_second_split_the_trial(trial):
    t = trial.tables["pose"]["t"]
    keep = (t < 1.0) | (t > 1.2)
    trial.tables["pose"] = {c: v[keep] for c, v in trial.tables["pose"].items()}
    first, second = log.segments(trial)
    assert first.tables["pose"]["t"][-1] <= 1.0 and second.tables["pose"]["t"][0] >= 1.2
    assert first.tables["joint"]["t"][-1] < 1.0 and second.tables["joint"]["t"][0] >= 1.2
    assert second.tables["target"]["x"][0] == 0.7  # still holds
    assert any("1 gap(s) over 0.1 s" in note for note in trial_check.check_table("pose", trial.tables["pose"], lambda r, c: ""))
    assert log.segments(trial, limit=0.5) == [trial]


def test_a_slow_camera_is_not_a_gap():
    assert len(log.gaps(np.arange(0, 5, 0.2))) == 0
    assert list(log.gaps(np.array([0, 0.2, 0.4, 1.0, 1.2]))) == [2]


def test_overlapping_gaps_of_two_tables_are_one_cut(trial):
    for name, (a, b) in {"pose": (1.0, 1.3), "joint": (1.2, 1.6)}.items():
        t = trial.tables[name]["t"]
        trial.tables[name] = {c: v[(t < a) | (t > b)] for c, v in trial.tables[name].items()}
    parts = log.segments(trial)
    assert len(parts) == 2 and all(len(log.gaps(p.tables[n]["t"])) == 0 for p in parts for n in ("pose", "joint", "cmd"))


# ------------------------------------------------------------------------------------------------------------ data sets
def test_a_data_set_reads_back_and_notices_every_change(tmp_path, trial):
    folder = log.write_dataset(tmp_path / "set", {f"trial_{i}": trial for i in range(3)}, meta={"licence": "CC-BY-4.0"})
    data = log.read_dataset(folder)
    assert len(data) == 3 and data.names == ("trial_0", "trial_1", "trial_2") and data.meta == {"licence": "CC-BY-4.0"}
    assert [t.name for t in data] == list(data.names) and data["trial_1"].value("robot") == "swift"
    with pytest.raises(UnknownName, match="Did you mean 'trial_1'"):
        data["trial1"]
    (folder / "trial_1" / "pose.npz").unlink()
    edit(folder, "trial_2/meta.toml", "swift", "swiss")
    with pytest.raises(StoreError, match=r"(?s)2 of 45 files.*trial_1/pose.npz: expected .* no such file.*trial_2/meta.toml"):
        log.read_dataset(folder)


def test_a_data_set_needs_trials_with_safe_names(tmp_path, trial):
    with pytest.raises(LogError, match="no trials"):
        log.write_dataset(tmp_path / "set", {})
    for name in ("../out", "/out", ".hidden", ""):
        with pytest.raises(LogError, match="cannot name a trial"):
            log.write_dataset(tmp_path / "set", {name: trial})


# ----------------------------------------------------------------------------------------------------------- properties
_KEYS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
_LEAVES = st.one_of(
    st.text(st.characters(exclude_categories=["Cs"]), max_size=12),
    st.integers(-(2**62), 2**62),
    st.booleans(),
    st.floats(allow_nan=False),
    st.dates(),
)
_TREES = st.recursive(_LEAVES, lambda kids: st.lists(kids, max_size=3) | st.dictionaries(_KEYS, kids, max_size=3), max_leaves=10)


@settings(max_examples=150, deadline=None)
@given(st.dictionaries(_KEYS, _TREES, max_size=5))
def test_written_toml_reads_back_as_it_was(table):
    assert tomllib.loads(toml.dumps(table)) == table


def test_a_place_that_leaps_from_next_to_nothing_is_read(trial):
    pose = trial.tables["pose"]
    half = len(pose["t"]) // 2
    pose["x"] = np.where(np.arange(len(pose["t"])) < half, 5e-324, 1.5)  # the ratio of the two levels is infinite
    assert "x steps faster" in " ".join(trial_check.check_table("pose", pose, lambda row, column: f"row {row}"))


def test_log_of_an_arm_is_sent_to_gap_find(tmp_path, capsys):
    """Nothing in it is a fish's. A trial folder of a fish with a bad row is none."""
    (tmp_path / "arm").mkdir()
    rows = "".join(f"{0.02 * i},{i % 7},{i % 5}\n" for i in range(50))
    (tmp_path / "arm" / "swing.csv").write_text(f"t,cmd_shoulder,pos_shoulder\n{rows}")
    where = "fishmj gap find LOGS --model robot.xml"
    with pytest.raises(LogError, match=where):
        import_command.main([str(tmp_path / "arm"), "--out", str(tmp_path / "made")], dict)
    for place in (tmp_path / "arm", tmp_path / "arm" / "swing.csv"):
        assert log_command(["check", str(place)]) == console.FAILED_CHECK and where in capsys.readouterr().err
    (tmp_path / "fish").mkdir()
    (tmp_path / "fish" / "meta.toml").write_text('schema = "fishmj.log/1"\norigin = "measured"\n')
    (tmp_path / "fish" / "cmd.csv").write_text("t,c1\n0,0\n0,0\n")
    assert log_command(["check", str(tmp_path / "fish")]) == console.FAILED_CHECK and where not in capsys.readouterr().err
