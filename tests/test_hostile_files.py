"""Files made to do harm: nothing of them runs, nothing is written outside its place, nothing fills the memory."""

import io
import stat
import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, FishmjError, SimDiverged, StoreError
from fishmj.base.store import read_npz, write_npz
from fishmj.engines import fast_math, numba_build
from fishmj.gap.commands import model_version
from fishmj.log import read_trial, write_trial
from fishmj.log.dataset import read_bundle, write_bundle
from fishmj.log.trial import Trial
from fishmj.mjcf import build, load_robot
from fishmj.sim import Sim
from fishmj.water.hydro_model import HydroModel

CODE = '"""\\nimport os; os.system("touch pwned")\\n"""'
NAMES = (
    CODE,
    "../../up",
    "/etc/fish",
    "a/b",
    "..",
    "",
    "-rf",
    "a" * 65,
    "<script>alert(1)</script>",
    "a\x1b[2Jb",
    "n\x00l",
    "fïsh",
)


def fish_text() -> str:
    return (calib_folder() / "fish.toml").read_text(encoding="utf-8")


def quoted(text: str) -> str:
    return '"' + "".join(f"\\u{ord(c):04x}" for c in text) + '"'


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
@pytest.mark.parametrize("what", ['name = "swift"', 'name = "body1"', 'name = "side"'], ids=["robot", "link", "fin"])
def test_fault_26_a_name_that_is_code_or_a_path_is_refused(tmp_path, name, what):
    path = tmp_path / "evil.toml"
    path.write_text(fish_text().replace(what, f"name = {quoted(name)}"), encoding="utf-8")
    with pytest.raises(ConfigError, match="evil.toml|swift"):
        load_robot(path)


def test_fault_26_no_word_of_a_description_reaches_generated_source():
    robot = load_robot("fish")
    marked = replace(robot, name="zebrafish", title=CODE, links=tuple(replace(k, name=f"zebra{k.name}") for k in robot.links))
    marked = replace(marked, fins=(), water=robot.water)
    for entry in numba_build.NEEDS:
        text = numba_build.write(marked, entry, fast_math.SINGLE)
        assert "zebra" not in text and "pwned" not in text
        assert text == numba_build.write(replace(robot, fins=()), entry, fast_math.SINGLE)


def test_fault_26_a_robot_made_by_hand_meets_the_same_check():
    for made in (replace(load_robot("fish"), name=CODE), replace(load_robot("fish"), name="../../up")):
        for door in (load_robot, Sim, build):
            with pytest.raises(ConfigError, match="name: got"):
                door(made)


def test_fault_26_diverged_states_are_saved_readable_by_the_user_only(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    sim = Sim("fish")
    for _ in range(3):
        sim.step(np.zeros(3))
    sim.data.qvel[:] = np.nan
    with pytest.raises(SimDiverged) as failure:
        sim.step(np.zeros(3))
    (folder,) = tmp_path.iterdir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700 and str(folder) in str(failure.value)
    assert read_trial(folder / "trial").value("robot") == "swift"


def zeros(path: Path, declared: int, header_rows: int | None = None) -> Path:
    """A table `pose.npz` whose column t is `declared` zeros, packed a piece at a time; its header may tell of more rows."""
    rows = declared if header_rows is None else header_rows
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (rows,)})
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive,
        archive.open("t.npy", "w", force_zip64=True) as out,
    ):
        out.write(head.getvalue())
        for _ in range(0, declared, 1_000_000):
            out.write(bytes(8 * min(1_000_000, declared)))
    return path


def test_fault_27_zip_bomb_archive_is_refused_before_unpacking(tmp_path):
    path = zeros(tmp_path / "pose.npz", 40_000_000)
    assert path.stat().st_size < 2_000_000
    with pytest.raises(StoreError, match="unpack to 3200001.. in 1 arrays; at most 268435456"):
        read_npz(path)


def test_fault_27_the_limit_can_be_moved(tmp_path, monkeypatch):
    path = zeros(tmp_path / "pose.npz", 100_000)
    monkeypatch.setenv("FISHMJ_MAX_UNPACKED", "1e5")
    with pytest.raises(StoreError, match="FISHMJ_MAX_UNPACKED=800"):
        read_npz(path)
    monkeypatch.setenv("FISHMJ_MAX_UNPACKED", "many")
    with pytest.raises(StoreError, match="expected a number of bytes"):
        read_npz(path)
    monkeypatch.setenv("FISHMJ_MAX_UNPACKED", "1e6")
    assert read_npz(path)["t"].shape == (100_000,)


def test_fault_27_array_header_larger_than_the_file_is_refused(tmp_path):
    with pytest.raises(StoreError, match="its header tells of 8000000000000 bytes"):
        read_npz(zeros(tmp_path / "pose.npz", 1000, header_rows=10**12))


def test_fault_27_an_archive_of_very_many_members_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as archive:
        for i in range(10_001):
            archive.writestr(f"{i}.npy", b"")
    with pytest.raises(StoreError, match="10001 arrays"):
        read_npz(tmp_path / "many.npz")


def test_fault_27_a_size_that_lies_in_the_directory_is_damage(tmp_path):
    """The directory says 80 bytes, the member holds 8 MB: no more than 80 are read."""
    path = zeros(tmp_path / "t.npz", 1_000_000)
    data = bytearray(path.read_bytes())
    entry = data.rindex(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = struct.pack("<I", 80)
    path.write_bytes(data)
    with pytest.raises(StoreError, match="damaged"):
        read_npz(path)


def shipped_water(folder: Path) -> Path:
    model = HydroModel.load("swift")
    return replace(model, name="mine").save(folder)


@pytest.mark.parametrize("file", ["../../secret.safetensors", "/etc/passwd", "..", ""])
def test_fault_26_a_fitted_water_names_a_file_beside_it_and_no_other(tmp_path, file):
    path = shipped_water(tmp_path / "water")
    path.write_text(path.read_text(encoding="utf-8").replace('"mine.safetensors"', f'"{file}"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="weights. file|weights file name"):
        HydroModel.load(path)


@pytest.mark.parametrize(
    ("before", "after"),
    [("dt = 0.004", "dt = nan"), ("slip = 1.0", 'slip = "x"'), ('name = "mine"', 'name = "../x"'), ("[base]", "[bass]")],
)
def test_fault_26_a_fitted_water_with_nonsense_in_it_is_one_line(tmp_path, before, after):
    path = shipped_water(tmp_path / "water")
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")
    with pytest.raises(FishmjError, match="mine.toml") as failure:
        HydroModel.load(path)
    assert "\n" not in str(failure.value)


def test_fault_26_a_bundle_whose_trial_has_a_path_for_a_name_is_refused(tmp_path):
    t = np.arange(10) / 50
    trial = Trial({"origin": "synthetic"}, {"cmd": {"t": t, "c1": np.sin(t)}}, name="a")
    path = write_bundle(tmp_path / "b.npz", [trial])
    assert read_bundle(path)[0].name == "a"
    arrays = read_npz(path)
    for old, new in (('"name": "a"', '"name": "../a"'), ('"meta": {', '"meta": [{}], "x": {')):
        text = arrays["about"].tobytes().decode()
        assert old in text
        write_npz(tmp_path / "evil.npz", arrays | {"about": np.frombuffer(text.replace(old, new).encode(), np.uint8)})
        with pytest.raises(FishmjError, match="evil.npz"):
            read_bundle(tmp_path / "evil.npz")


def test_fault_26_a_version_names_its_parents_text_beside_it_and_no_other(tmp_path):
    path = tmp_path / "fish.v2.toml"
    path.write_text(fish_text() + '\n[version]\nnumber = 2\nparent_text = "../../etc/passwd"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="parent_text"):
        model_version.revert(path)


def test_fault_26_a_trial_is_not_written_over_a_folder_that_is_none(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    trial = Trial({"origin": "synthetic"}, {"cmd": {"t": np.arange(3.0), "c1": np.zeros(3)}})
    with pytest.raises(StoreError, match="no trial"):
        write_trial(tmp_path / "thesis", trial, overwrite=True)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "years of work"
