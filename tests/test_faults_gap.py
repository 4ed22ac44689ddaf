"""Faults of the discrepancy workflow: too little data to tell, no effect that explains, a patch that hurts."""

import json

import pytest

pytest.importorskip("numba")

from test_gap_apply import command, data, report  # noqa: E402, F401

from fishmj.base import console
from fishmj.base.calib import read_toml, resolve
from fishmj.gap.commands import apply
from fishmj.log.dataset import write_dataset
from fishmj.mjcf import load_robot
from fishmj.sim import Sim


def records(folder, count, seconds, amplitude):
    """A data set of short simulated trials."""
    import numpy as np

    wave = lambda t: amplitude * np.sin(6 * t - np.arange(3))
    return write_dataset(folder, {f"{i:02d}": Sim("fish", water="structured").run(wave, seconds) for i in range(count)})


@pytest.mark.parametrize(
    ("count", "seconds", "amplitude", "why"), [(1, 3.0, 0.5, "too few"), (2, 1.0, 0.5, "too short"), (2, 2.5, 0.0, "too quiet")]
)
def test_fault_21_too_short_or_too_quiet_names_what_is_confounded(tmp_path, capsys, count, seconds, amplitude, why):
    code, out, _ = command(capsys, "find", records(tmp_path / "d", count, seconds, amplitude), "--out", tmp_path / "r", "--json")
    said = json.loads(out.strip().splitlines()[-1])
    assert code == console.CANNOT_TELL == 3 and said["reason"].startswith(why)
    assert {"coulomb_friction", "command_latency"} <= set(said["confounded"]) and "chirp" in said["record"]
    assert "record next: " in out and not (tmp_path / "r").exists()


@pytest.mark.parametrize("answer", ["UNEXPLAINED", "CLASS"])
def test_fault_22_no_effect_explains_the_gap(data, tmp_path, capsys, answer):  # noqa: F811
    before = resolve("fish").read_bytes()
    folder = report(tmp_path / "r", data, answer=answer, torque=0.15)
    code, out, _ = command(capsys, "apply", folder)
    (kept,) = folder.glob("model.rejected-*.toml")
    assert code == console.FAILED_CHECK and answer in out and "stays as it is" in out
    assert resolve("fish").read_bytes() == before and not list(folder.glob("fish.v*.toml"))
    scores = read_toml(kept)["version"]
    assert scores["gap_after"] > 0 and scores["rejected"] and load_robot(kept).effects[0].name == "coulomb_friction"
    forced = apply.apply(folder, force=True)
    assert forced.accepted and forced.path.name == "fish.v2.toml" and forced.reason.startswith("forced")


def test_fault_22_a_patch_that_hurts_unseen_records(data, tmp_path, capsys):  # noqa: F811
    folder = report(tmp_path / "r", data, torque=0.75)  # five times what is there
    code, out, _ = command(capsys, "apply", folder)
    (kept,) = folder.glob("model.rejected-*.toml")
    scores = read_toml(kept)["version"]
    assert code == console.FAILED_CHECK and "hurts" in out and scores["over_floor"][1] > scores["over_floor"][0]
    assert not list(folder.glob("fish.v*.toml"))


def test_fault_22_nothing_to_add_writes_nothing(data, tmp_path, capsys):  # noqa: F811
    folder = report(tmp_path / "r", data, torque=0.15)
    verdict = json.loads((folder / "verdict.json").read_text()) | {"answer": "AGREES", "effects": []}
    (folder / "verdict.json").write_text(json.dumps(verdict))
    code, out, _ = command(capsys, "apply", folder)
    assert code == console.OK and "AGREES: no effect to add" in out and len(list(folder.iterdir())) == 1


def test_a_model_or_data_other_than_those_of_the_search_are_refused(data, tmp_path, capsys):  # noqa: F811
    folder = report(tmp_path / "r", data, torque=0.15)
    verdict = json.loads((folder / "verdict.json").read_text())
    for key, word in (("model_sha256", "changed since the search"), ("data_sha256", "not the data set")):
        wrong = verdict | {"context": verdict["context"] | {key: "0" * 64}}
        (folder / "verdict.json").write_text(json.dumps(wrong))
        code, _, err = command(capsys, "apply", folder)
        assert code == console.BAD_INPUT and word in err
