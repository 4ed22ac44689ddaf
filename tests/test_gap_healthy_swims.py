"""`gap find --healthy`: swims from before; not the logs in question. And a water that was calibrated on those."""

from types import SimpleNamespace

import pytest

pytest.importorskip("numba")

from fishmj.base import console
from fishmj.base.calib import resolve
from fishmj.gap import __main__ as gap
from fishmj.gap.calibrate import calibrated_model
from fishmj.gap.commands import find
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.records.datasets import digest
from fishmj.log import write_dataset
from fishmj.water.choice import STRUCTURED


@pytest.fixture(scope="module")
def swims(tmp_path_factory):
    """Three short swims in question, and three from before of which one is a copy."""
    folder = tmp_path_factory.mktemp("swims")
    now, before = (generate({}, ["gait_fast", "steps", "gait"], seed) for seed in (3, 4))
    data = write_dataset(folder / "now", {f"{i}": t for i, t in enumerate(now)})
    clean = write_dataset(folder / "before", {f"{i}": t for i, t in enumerate(before)})
    mixed = write_dataset(folder / "mixed", {"a": before[0], "copy": now[1], "c": before[2]})
    return SimpleNamespace(data=data, clean=clean, mixed=mixed)


def model(path, **facts: str):
    """A fish whose water was calibrated; facts: of [calibration.water]."""
    text = calibrated_model.put(resolve("fish").read_text(), "water", {"model": STRUCTURED}, new=True)
    path.write_text(text + "\n[calibration.water]\n" + "".join(f'{key} = "{value}"\n' for key, value in facts.items()))
    return path


@pytest.fixture
def notes(monkeypatch):
    """Notes of the searches that begin; none of them is made."""
    begun: list[tuple] = []

    def search(args, robot, given, notes, healthy, answered):
        begun.append(notes)
        raise find.admission.TooDifferent(1e6, {}, [])

    monkeypatch.setattr(find, "search", search)
    return begun


def run(*argv) -> int:
    return console.run(gap.main, ["find", *map(str, argv)])


@pytest.mark.parametrize(
    "given, says", [("data", "3 of 3"), ("mixed", "1 of 3 trials have the readings of searched ones: copy (1")]
)
def test_searched_logs_are_no_healthy_swims(given, says, swims, notes, tmp_path, capsys):
    fish = model(tmp_path / "mine.toml")
    assert run(swims.data, "--model", fish, "--healthy", getattr(swims, given)) == console.BAD_INPUT
    said = capsys.readouterr().err.splitlines()[-1]
    assert says in said and "give swims recorded before" in said and "anything was wrong" in said and not notes


def test_other_swims_are_taken(swims, notes, tmp_path):
    fish = model(tmp_path / "mine.toml", source="elsewhere", manifest_sha256="0" * 64)
    assert run(swims.data, "--model", fish, "--healthy", swims.clean) == console.CANNOT_TELL
    assert not [note for note in notes[0] if "calibrated" in note]


@pytest.mark.parametrize("signed", [True, False])
def test_water_calibrated_on_the_searched_logs_is_warned_of(signed, swims, notes, tmp_path, capsys):
    facts = {"source": swims.data.as_posix(), "manifest_sha256": digest(swims.data) if signed else ""}
    assert run(swims.data, "--model", model(tmp_path / "mine.toml", **facts)) == console.CANNOT_TELL
    said = "the search may name only the rest"
    assert said in capsys.readouterr().err and said in notes[0][-1]
