"""Claims about `fishmj log export`: the same numbers in MCAP, CSV and Parquet, with units, in one step or not at all."""

import json
from dataclasses import replace

import describing
import numpy as np
import pytest
from synthetic import swim, whole_trial

from fishmj import log
from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError, MissingExtra, StoreError, UnknownName
from fishmj.log import __main__ as command
from fishmj.log import foxglove, importers
from fishmj.log.dataset import write_bundle
from fishmj.log.export import export
from fishmj.log.importers.mcap import carried
from fishmj.log.trial import unit
from fishmj.mjcf import load_robot
from fishmj.mjcf.drawing import solids
from fishmj.mjcf.geometry import geometry_of

SHAPE = lambda trial: solids(load_robot())


@pytest.fixture
def trial():
    return whole_trial(1.0, title="A swim", notes=["one", "two"], sigma={"x": 0.005})


@pytest.fixture
def folder(tmp_path, trial):
    return log.write_trial(tmp_path / "swim", trial, form="csv")


def read_mcap(path):
    """(schema name, topic, message, log time) of every message; attachments and metadata beside them."""
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [(s, c.topic, json.loads(m.data), m.log_time) for s, c, m in reader.iter_messages()]
        return found, list(reader.iter_attachments()), list(reader.iter_metadata())


def breaches(schema, value, where=""):
    """What of a message is not as its JSON schema says: types, required keys, keys that nobody knows."""
    if "oneOf" in schema:
        return [] if value in [one["const"] for one in schema["oneOf"]] else [f"{where} = {value}"]
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "number": (int, float), "integer": int}
    if not isinstance(value, kinds[schema["type"]]) or (isinstance(value, bool) and schema["type"] != "boolean"):
        return [f"{where} is {type(value).__name__}, expected {schema['type']}"]
    if schema["type"] == "array":
        return [b for i, item in enumerate(value) for b in breaches(schema["items"], item, f"{where}[{i}]")]
    if schema["type"] == "object":
        out = [f"{where} lacks {k}" for k in schema.get("required", ()) if k not in value]
        out += [f"{where}: {k} is not known" for k in value if k not in schema["properties"]]
        return out + [
            b for k, v in value.items() for b in breaches(schema["properties"].get(k, {"type": "object"}), v, f"{where}.{k}")
        ]
    low, high = schema.get("minimum", value), schema.get("maximum", value)
    return [] if low <= value <= high else [f"{where} = {value}"]


# ---------------------------------------------------------------------------------------------------------------------- mcap
def test_an_mcap_file_holds_every_row_with_its_stamp_and_its_numbers(folder, trial, tmp_path):
    row = export(folder, "mcap", tmp_path / "a.mcap", shape=SHAPE)[0]
    found, attachments, metadata = read_mcap(tmp_path / "a.mcap")
    for name, table in trial.tables.items():
        mine = [(m, at) for _, topic, m, at in found if topic == f"/{name}"]
        assert [at for _, at in mine] == [round(t * 1e9) for t in table["t"]], name
        for column, values in table.items():
            assert np.array_equal([m[column] for m, _ in mine], values), (name, column)
    assert row["rows"] == sum(len(t["t"]) for t in trial.tables.values()) and row["bytes"] == (tmp_path / "a.mcap").stat().st_size
    assert [a.name for a in attachments] == ["meta.toml"] and attachments[0].data == (folder / "meta.toml").read_bytes()
    assert metadata[0].metadata["flow.speed"] == "0.2" and metadata[0].metadata["title"] == "A swim"
    assert [at for *_, at in found] == sorted(at for *_, at in found)


def test_the_messages_are_what_foxglove_knows(folder, tmp_path):
    export(folder, "mcap", tmp_path / "a.mcap", shape=SHAPE)
    found, *_ = read_mcap(tmp_path / "a.mcap")
    assert all(schema.encoding == "jsonschema" for schema, *_ in found)
    kinds = {topic: schema.name for schema, topic, *_ in found}
    assert kinds["/tf"] == "foxglove.FrameTransform" and kinds["/tf_links"] == "foxglove.FrameTransforms"
    assert (
        kinds["/pose_in_tank"] == "foxglove.PoseInFrame"
        and kinds["/scene_fish"] == kinds["/scene_target"] == "foxglove.SceneUpdate"
    )
    for schema, topic, message, _ in found:
        assert breaches(json.loads(schema.data), message, topic) == []
    assert (
        breaches(foxglove.SCHEMAS["foxglove.PoseInFrame"], {"timestamp": {"sec": -1}, "frame_id": 3}) != []
    )  # the check is awake


def test_the_frames_put_every_link_where_the_skin_has_it(tmp_path):
    from fishmj.mjcf.skin import hinge_frames, skin

    log.write_trial(tmp_path / "s", swim(1.0), precision="float64")
    export(tmp_path / "s", "mcap", tmp_path / "a.mcap", shape=SHAPE)
    found, *_ = read_mcap(tmp_path / "a.mcap")
    truth, at = log.read_trial(tmp_path / "s").tables["truth"], 30
    q = np.array([truth["x"][at], truth["y"][at], truth["yaw"][at], *log.stacked(truth, "j#")[at]])
    fish = [m for _, topic, m, _ in found if topic == "/tf"][at]
    steps = [m for _, topic, m, _ in found if topic == "/tf_links"][at]["transforms"]
    assert [fish["parent_frame_id"], fish["child_frame_id"]] == ["tank", "fish"]
    place, yaw, hinges = np.zeros(2), 0.0, []
    for step in (fish, *steps):
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        place = place + turn @ [step["translation"]["x"], step["translation"]["y"]]
        yaw += 2 * np.arctan2(step["rotation"]["z"], step["rotation"]["w"])
        hinges.append(place)
    expected, _ = hinge_frames(skin(load_robot()).hinge_x, q)
    assert np.allclose(hinges[0], q[:2]) and np.allclose(hinges[1:], expected, atol=1e-9)
    assert np.isclose(yaw, q[2:].sum())


@pytest.fixture
def pike(tmp_path, monkeypatch, capsys):
    """A description of one's own, with five links."""
    monkeypatch.chdir(tmp_path)
    assert describing.new("pike", *describing.FIVE) == 0
    capsys.readouterr()
    return tmp_path / "pike.toml"


@pytest.mark.parametrize("name", ["fish", "tendon_fish", "pike"])
def test_the_links_are_drawn_as_long_as_wide_and_as_high_as_the_fish(name, pike):
    robot = load_robot(pike if name == "pike" else name)
    made = solids(robot)
    entities = foxglove.body(0, made)["entities"]
    assert len(entities) == robot.n_joints + 1 and all(e["triangles"][0]["indices"] for e in entities)
    whole = np.concatenate([s.points + [s.front if i else 0.0, 0, 0] for i, s in enumerate(made)])
    high, wide = (max(section[k] for link in robot.links for section in link.sections) for k in (1, 2))
    assert np.ptp(whole[:, 0]) == pytest.approx(robot.length) and whole[:, 0].max() == pytest.approx(made[0].front)
    assert (
        np.ptp(whole[:, 2]) == pytest.approx(high, rel=0.02)
        and np.ptp(whole[:, 1]) <= 1.01 * wide * geometry_of(robot).width_scale
    )
    assert sum(len(e["cubes"]) for e in entities) == sum(fin.count for fin in robot.fins)


def test_a_fish_of_ones_own_is_drawn_from_its_description(tmp_path, capsys, pike):
    trial = swim(1.0)
    folder = log.write_trial(tmp_path / "s", replace(trial, meta=trial.meta | {"robot": "my own"}))
    words = ["export", folder, "--to", "mcap", "--out"]
    assert console.run(command.main, [*map(str, words), str(tmp_path / "arrow.mcap")]) == 0
    assert "my own: not a shipped one, drawn as an arrow" in capsys.readouterr().out
    assert console.run(command.main, [*map(str, words), str(tmp_path / "a.mcap"), "--robot", "fish"]) == 0
    scene = next(m for _, topic, m, _ in read_mcap(tmp_path / "a.mcap")[0] if topic == "/scene_fish")
    assert [len(e["triangles"]) for e in scene["entities"]] == [1] * 4 and "arrow" not in capsys.readouterr().out
    assert console.run(command.main, [*map(str, words), str(tmp_path / "b.mcap"), "--robot", str(pike)]) == 2
    assert "has 3 joints" in capsys.readouterr().err and not (tmp_path / "b.mcap").exists()
    assert console.run(command.main, ["export", str(folder), "--to", "csv", "--out", str(tmp_path / "c"), "--robot", "fish"]) == 2


def test_a_robot_that_nobody_knows_is_an_arrow(folder, tmp_path):
    export(folder, "mcap", tmp_path / "a.mcap")
    found, *_ = read_mcap(tmp_path / "a.mcap")
    scene = next(m for _, topic, m, _ in found if topic == "/scene_fish")
    assert len(scene["entities"]) == 1 and len(scene["entities"][0]["arrows"]) == 1
    assert not any(topic == "/tf_links" for _, topic, *_ in found)


def test_every_column_says_its_unit(folder, trial, tmp_path):
    export(folder, "mcap", tmp_path / "a.mcap")
    found, *_ = read_mcap(tmp_path / "a.mcap")
    schemas = {schema.name: json.loads(schema.data) for schema, *_ in found}
    assert schemas["fishmj.joint"]["properties"]["w2"]["description"] == "[rad/s]"
    assert schemas["fishmj.power"]["properties"]["I"]["description"] == "[A]"
    assert {unit(n, c) for n in ("pose", "truth") for c in trial.tables[n]} == {"s", "m", "rad", "m/s", "rad/s"}
    assert unit("wrench", "m1") == "N m" and unit("obs", "o1") == ""


def test_our_own_importer_brings_an_exported_file_back_as_it_was(folder, tmp_path):
    before = log.read_trial(folder)
    export(folder, "mcap", tmp_path / "swim.mcap", shape=SHAPE)
    after = importers.read(tmp_path / "swim.mcap")["swim"]
    assert after.meta == before.meta and set(after.tables) == set(before.tables)
    for name, table in before.tables.items():
        for column, values in table.items():
            assert np.allclose(after.tables[name][column], values, rtol=0, atol=1e-9 if column == "t" else 0), (name, column)


def test_stamps_before_zero_come_back(tmp_path, trial):
    early = {name: {**table, "t": table["t"] - 0.5} for name, table in trial.tables.items()}
    log.write_trial(tmp_path / "early", log.Trial(trial.meta, early), form="csv")
    export(tmp_path / "early", "mcap", tmp_path / "early.mcap")
    found, *_ = read_mcap(tmp_path / "early.mcap")
    assert min(at for *_, at in found) == 0
    after = importers.read(tmp_path / "early.mcap")["early"]
    assert np.allclose(after.tables["cmd"]["t"], early["cmd"]["t"], atol=1e-9)


def test_an_mcap_file_of_others_carries_nothing_of_ours(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n and then nothing")
    assert carried(tmp_path / "x.mcap") is None


# -------------------------------------------------------------------------------------------------------------- csv, parquet
def test_csv_comes_back_bit_by_bit(folder, trial, tmp_path):
    export(folder, "csv", tmp_path / "out")
    back = log.read_trial(tmp_path / "out")
    assert back.meta == log.read_trial(folder).meta
    assert all(np.array_equal(back.tables[n][c], v) for n, table in trial.tables.items() for c, v in table.items())


def test_no_cell_of_a_csv_is_a_formula(trial, tmp_path):
    columns = {**trial.tables["joint"], "=1+1": np.ones(50), "@SUM(A1)": np.ones(50), "_=1+1": np.ones(50), "+a": np.ones(50)}
    log.write_trial(
        tmp_path / "a", log.Trial({"origin": "measured", "notes": "=cmd|' /C calc'!A0"}, {"joint": columns}), form="npz"
    )
    export(tmp_path / "a", "csv", tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").glob("[!.]*")) == ["joint.csv", "meta.toml"]
    lines = (tmp_path / "out" / "joint.csv").read_text().splitlines()
    assert not any(cell.startswith(("=", "+", "@", "\t")) for line in lines for cell in line.split(","))
    assert all(cell.lstrip("-").replace("e-", "").replace(".", "").isdigit() for line in lines[1:] for cell in line.split(","))
    assert len(log.read_trial(tmp_path / "out").tables["joint"]) == len(columns)


def test_parquet_holds_the_numbers_and_their_units(folder, trial, tmp_path):
    from pyarrow import parquet

    export(folder, "parquet", tmp_path / "out")
    for name, table in trial.tables.items():
        back = parquet.read_table(tmp_path / "out" / f"{name}.parquet")
        assert back.column_names == list(table) and back.schema.metadata[b"fishmj.table"] == name.encode()
        for column, values in table.items():
            assert np.array_equal(back[column].to_numpy(), values)
            assert back.schema.field(column).metadata[b"unit"].decode() == unit(name, column)
    assert (tmp_path / "out" / "meta.toml").read_bytes() == (folder / "meta.toml").read_bytes()


@pytest.mark.parametrize(("form", "missing"), [("mcap", "mcap"), ("parquet", "pyarrow")])
def test_an_absent_library_is_named_before_anything_is_written(folder, tmp_path, monkeypatch, form, missing):
    monkeypatch.setattr("fishmj.log.export.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=rf'{missing}: pip install "fishmj\[logs\]"'):
        export(folder, form, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------------------------------------------- data sets, refusals
@pytest.mark.parametrize("form", ["mcap", "csv", "parquet"])
def test_a_data_set_is_one_file_or_folder_a_trial_with_a_manifest(trial, tmp_path, form):
    log.write_dataset(tmp_path / "set", {"one": trial, "two": trial}, meta={"licence": "CC0-1.0"})
    told = []
    rows = export(tmp_path / "set", form, tmp_path / "out", done=lambda count, total: told.append((count, total)))
    end = ".mcap" if form == "mcap" else ""
    assert [row["trial"] for row in rows] == ["one", "two"] and told[-1] == (2, 2)
    assert all(row["path"] == str(tmp_path / "out" / f"{row['trial']}{end}") for row in rows)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["meta"] == {"licence": "CC0-1.0"} and len(manifest["files"]) >= 2
    if form == "csv":
        assert log.read_dataset(tmp_path / "out").names == ("one", "two")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "set"]


def test_a_bundle_is_exported_and_its_names_are_no_paths(trial, tmp_path):
    few = {name: trial.tables[name] for name in ("cmd", "joint", "pose")}
    write_bundle(tmp_path / "good.npz", [log.Trial(trial.meta, few, name="one")])
    assert [row["trial"] for row in export(tmp_path / "good.npz", "csv", tmp_path / "good")] == ["one"]
    write_bundle(tmp_path / "evil.npz", [log.Trial(trial.meta, few, name="../../evil")])
    with pytest.raises(ConfigError, match=r"trial name '\.\."):
        export(tmp_path / "evil.npz", "csv", tmp_path / "evil")
    assert not (tmp_path / "evil").exists() and not (tmp_path.parent / "evil").exists()


def test_export_overwrites_only_earlier_exports_and_only_with_force(folder, tmp_path):
    export(folder, "csv", tmp_path / "out")
    with pytest.raises(StoreError, match="exists; choose another name, or pass --force"):
        export(folder, "csv", tmp_path / "out")
    export(folder, "csv", tmp_path / "out", tables=["pose"], force=True)
    assert sorted(p.name for p in (tmp_path / "out").glob("[!.]*")) == ["meta.toml", "pose.csv"]
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("ten years")
    with pytest.raises(StoreError, match="no export wrote it"):
        export(folder, "csv", tmp_path / "home", force=True)
    log.write_trial(tmp_path / "measured", log.read_trial(folder))
    with pytest.raises(StoreError, match="no export wrote it"):
        export(folder, "csv", tmp_path / "measured", force=True)
    (tmp_path / "notes.mcap").write_text("ten years")
    with pytest.raises(StoreError, match="is no MCAP file"):
        export(folder, "mcap", tmp_path / "notes.mcap", force=True)
    with pytest.raises(StoreError, match="is a folder, and a file would replace it"):
        export(folder, "mcap", tmp_path / "home", force=True)
    for place in (folder, folder / "inside", tmp_path):
        with pytest.raises(StoreError, match="lies in, or holds, what is exported"):
            export(folder, "csv", place, force=True)
    assert (tmp_path / "home" / "thesis.txt").read_text() == "ten years" and log.read_trial(folder)


def test_an_export_that_fails_leaves_the_old_one_and_no_parts(folder, tmp_path, monkeypatch):
    export(folder, "mcap", tmp_path / "a.mcap")
    before = (tmp_path / "a.mcap").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fishmj.log.foxglove.frame", full)
    with pytest.raises(StoreError, match="could not be written"):
        export(folder, "mcap", tmp_path / "a.mcap", force=True)
    assert (tmp_path / "a.mcap").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "swim"]


def test_tables_are_chosen_by_name(folder, tmp_path):
    row = export(folder, "csv", tmp_path / "a", tables=["pose", "joint"])[0]
    assert set(row["tables"]) == {"pose", "joint"} == set(log.read_trial(tmp_path / "a").tables)
    with pytest.raises(UnknownName, match="Did you mean 'pose'"):
        export(folder, "csv", tmp_path / "b", tables=["poze"])
    bare = log.Trial({"origin": "measured"}, {"cmd": log.read_trial(folder).tables["cmd"]})
    log.write_trial(tmp_path / "bare", bare)
    assert export(tmp_path / "bare", "csv", tmp_path / "c", tables=["cmd", "pose"])[0]["absent"] == ["pose"]
    with pytest.raises(LogError, match="has none of pose; it has cmd"):
        export(tmp_path / "bare", "csv", tmp_path / "d", tables=["pose"])


# ------------------------------------------------------------------------------------------------------------------- command
def test_the_command_exports_and_tells_it_as_json(folder, tmp_path, capsys):
    out = tmp_path / "a.mcap"
    assert (
        console.run(command.main, ["export", str(folder), "--to", "mcap", "--out", str(out), "--tables", "pose,joint", "--json"])
        == 0
    )
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["to"] == "mcap" and set(told["trials"][0]["tables"]) == {"pose", "joint"}
    assert told["trials"][0]["bytes"] == out.stat().st_size
    found, *_ = read_mcap(out)
    assert any(topic == "/tf_links" for _, topic, *_ in found), "the fish is known by its name"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--to", "mcpa", "--out", "x"], "Did you mean 'mcap'"),
        (["--to", "csv"], "--out"),
        (["--to", "csv", "--out", "x", "--tables", ""], "unknown table ''"),
        (["--to", "csv", "--out", "file/x"], "is a file, so nothing can be written below it"),
    ],
)
def test_a_wrong_option_is_one_line(folder, more, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert console.run(command.main, ["export", str(folder), *more]) == console.BAD_INPUT
    error = capsys.readouterr().err
    assert said in error and len(error.splitlines()) == 1 and "Traceback" not in error
