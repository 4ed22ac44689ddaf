"""Fault 17: files of a data set missing, changed, or of another kind than the rest. Nothing is learnt from the rest silently."""

import json
from dataclasses import replace

import pytest
from ray_toys import toy

from fishmj.base.errors import DatasetError
from fishmj.base.store import Manifest
from fishmj.hydro_fit.campaign.data import plan
from fishmj.hydro_fit.campaign.data.collect import collect
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.segment_dataset import SEGMENTS, open_dataset
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import load_robot

FISH = load_robot("fish")
SETUP = Setup(domain=preset("laptop"), device="cpu")


class Toys:
    """Made-up records."""

    def run(self, waiting, setup, go_on):
        return (toy(segment, setup) for segment in waiting)


@pytest.fixture
def folder(tmp_path):
    """A whole data set of four made-up segments of all splits."""
    wanted = {"train": 2, "val": 1, "test": 1}
    segments = []
    for segment in plan.full(FISH).segments:
        if segment.slip == plan.DEFAULT_SLIP and wanted[segment.split] and not segment.replicate_of:
            wanted[segment.split] -= 1
            segments.append(replace(segment, seconds=1.0))
    small = plan.CampaignPlan(label="small", robot=FISH, seed=0, segments=tuple(segments))
    collect(small, tmp_path / "data", SETUP, pool=Toys(), quiet=True)
    return tmp_path / "data"


def first(folder, suffix):
    """The first training segment's file."""
    return folder / SEGMENTS / (open_dataset(folder).names("train")[0] + suffix)


def change(folder, path, **entries):
    """Change a description and the manifest with it, as a careless merge of two data sets would."""
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))
    Manifest.of(folder).write(folder)


def refused(folder, *said):
    """Opening fails with one error that says all of this."""
    with pytest.raises(DatasetError) as caught:
        open_dataset(folder)
    for text in said:
        assert text in str(caught.value)


def test_a_whole_data_set_opens(folder):
    data = open_dataset(folder)
    assert [len(data.names(split)) for split in ("train", "val")] == [2, 1] and data.robot["name"] == FISH.name
    assert data.sha256 == open_dataset(folder).sha256


def test_partial_data_set_opens_for_test_only_and_checks_all_its_files(folder):
    whole = open_dataset(folder)
    kept = {path.name: path.read_bytes() for path in (folder / SEGMENTS).iterdir()}
    for path in (folder / SEGMENTS).glob("[!t]*"):
        path.unlink()
    part = open_dataset(folder, test=True)
    assert whole.whole and not part.whole and part.sha256 == whole.sha256
    assert [one.meta["split"] for one in part.records("test")] == ["test"]
    for split in ("train", "val"):
        with pytest.raises(DatasetError, match=f"the {split} part is not installed, only in a checkout .*--data"):
            part.names(split)
    (some,) = (folder / SEGMENTS).glob("*.npz")
    some.unlink()
    refused(folder, "1 files missing", f"{some.name}: expected sha256")
    (folder / SEGMENTS / next(name for name in kept if not name.startswith("test"))).write_bytes(b"{}")
    refused(folder, f"{len(kept) - 1} files missing")


def test_fault_17_missing_files_are_listed_with_expected_and_got(folder):
    gone = [first(folder, ".npz"), folder / "split.json"]
    for path in gone:
        path.unlink()
    refused(
        folder,
        "2 files missing, changed",
        gone[0].name,
        "split.json",
        "expected sha256",
        "got no such file",
        "collect them again",
    )


def test_fault_17_a_changed_file_is_listed_with_both_hashes(folder):
    path = first(folder, ".npz")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    refused(folder, f"{SEGMENTS}/{path.name}: expected sha256 {Manifest.read(folder).files[f'{SEGMENTS}/{path.name}']}, got ")


def test_fault_17_arrays_of_another_segment_are_refused_when_read(folder):
    """The manifest was written again over the damage: the description still knows better."""
    one, other = (folder / SEGMENTS / f"{name}.npz" for name in open_dataset(folder).names("train"))
    one.write_bytes(other.read_bytes()[:-1])
    Manifest.of(folder).write(folder)
    with pytest.raises(DatasetError, match=rf"{one.name}: expected sha256 \w+, got \w+"):
        list(open_dataset(folder).records("train"))


def test_fault_17_a_file_that_nobody_declared_is_listed(folder):
    (folder / SEGMENTS / "stray.npz").write_bytes(first(folder, ".npz").read_bytes())
    refused(folder, "stray.npz: expected no such file", "got one")


def test_fault_17_mixed_units_are_listed(folder):
    path = first(folder, ".json")
    units = json.loads(path.read_text())["units"] | {"q": "mm, deg"}
    change(folder, path, units=units)
    refused(folder, "of another kind than the rest", f"{path.name}: units expected", "'m, rad'", "got", "'mm, deg'")


def test_fault_17_mixed_schemas_robots_grids_and_solvers_are_listed(folder):
    path = first(folder, ".json")
    sound = json.loads(path.read_text())
    change(folder, path, schema="fishmj.segment/0")
    refused(folder, "schema expected fishmj.segment/1, got fishmj.segment/0")
    change(folder, path, schema=sound["schema"], robot=sound["robot"] | {"name": "tendon_fish"})
    refused(folder, "robot expected", "swift", "tendon_fish")
    change(folder, path, robot=sound["robot"], grid=sound["grid"] | {"dx": 0.01})
    refused(folder, "grid expected", "'dx': 0.02", "'dx': 0.01")
    change(folder, path, grid=sound["grid"], solver={"sha256": "0" * 64})
    refused(folder, "solver expected", sound["solver"]["sha256"], "0" * 64)
    change(folder, path, solver=sound["solver"])
    open_dataset(folder)


def test_fault_17_a_test_episode_among_the_training_ones_is_found(folder):
    name = next(name for name, meta in open_dataset(folder).about.items() if meta["split"] == "test")
    change(folder, folder / SEGMENTS / f"{name}.json", split="train")
    refused(folder, "not where split.json puts them", name, "expected 'test', got 'train'")
    change(folder, folder / SEGMENTS / f"{name}.json", split="test")
    split = json.loads((folder / "split.json").read_text())
    split["episodes"] = dict.fromkeys(split["episodes"], "train")
    (folder / "split.json").write_text(json.dumps(split))
    Manifest.of(folder).write(folder)
    refused(folder, "the split was changed by hand")


def test_fault_17_the_test_part_is_closed_to_all_but_the_check(folder):
    closed, checked = open_dataset(folder), open_dataset(folder, test=True)
    name = checked.names("test")[0]
    for ask in (lambda: closed.names("test"), lambda: closed.records("test"), lambda: closed[name]):
        with pytest.raises(DatasetError, match="the test part is closed"):
            ask()
    assert [record.id for record in checked.records("test")] == [name] == [checked[name].id]


def test_fault_17_no_data_set_at_all_says_what_to_do(tmp_path, folder):
    refused(tmp_path / "nothing", "no data set", "collect again")
    (folder / "manifest.json").unlink()
    refused(folder, "a campaign that was interrupted has none")
