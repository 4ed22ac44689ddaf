"""A named effect becomes the next version of a model: hashed, reversible, checked on records, and swimming like any other."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import effects, engines
from fishmj.base import console
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError
from fishmj.base.store import sha256, write_json
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.gap import __main__ as gap
from fishmj.gap.commands import apply, model_version
from fishmj.gap.commands.check import check, gaps
from fishmj.gap.commands.mjcf_patch import difference, hooked, mjcf
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import null_of
from fishmj.gap.records.datasets import named, trials_in
from fishmj.gap.verdict import NamedEffect, Value, Verdict
from fishmj.log.dataset import read_dataset, write_bundle
from fishmj.mjcf import load_robot
from fishmj.sim import Sim

PLANTED = 0.15  # N m
NULL = {"runs": 8, "noise": 1.0, "seed": 0}


def command(capsys, *argv) -> tuple[int, str, str]:
    code = console.run(gap.main, [str(a) for a in argv])
    out = capsys.readouterr()
    return code, out.out, out.err


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two records of a second robot with dry friction."""
    folder = tmp_path_factory.mktemp("planted") / "data"
    argv = [f"coulomb_friction={PLANTED}", "--out", folder, "--excitations", "gait_fast,turn_left", "--logs", "2", "--seed", "5"]
    assert console.run(gap.main, ["plant", *map(str, argv)]) == 0
    return folder


def report(folder, data, name="coulomb_friction", answer="NAMED", **values):
    """A report of gap find on disk, with an effect of these values."""
    units = {p.name: p.unit for p in effects.get(name).parameters}
    given = {key: Value(v, units[key], v - 0.01, v + 0.01) for key, v in values.items()}
    verdict = Verdict(
        answer, (NamedEffect(name, given, 0.98, 0.9),), ({"name": "load_friction", "p_best": 0.02},), gates={"closure": 0.9}
    )
    verdict = replace(verdict, gap_before=3.0, gap_after=1.2)
    context = {
        "model": "fish", "model_sha256": model_version.digest("fish"), "data": str(data), "null": NULL,
        "data_sha256": sha256(data / "manifest.json"), "judged": list(read_dataset(data).names),
    }  # fmt: skip
    folder.mkdir(exist_ok=True)
    write_json(folder / "verdict.json", verdict.plain() | {"context": context})
    return folder


@pytest.fixture(scope="module")
def patched(tmp_path_factory, data):
    """The next version, written once."""
    written = apply.apply(report(tmp_path_factory.mktemp("report"), data, torque=PLANTED))
    assert written.accepted, written.reason
    return written


def test_the_next_version_holds_values_hashes_rivals_and_its_parent(patched, data):
    table, robot = read_toml(patched.path), load_robot(patched.path)
    (fitted,) = robot.effects
    assert patched.path.name == "fish.v2.toml" and fitted.name == "coulomb_friction"
    assert fitted.parameters["torque"] == Interval(PLANTED, PLANTED - 0.01, PLANTED + 0.01)
    assert fitted.hash == sha256(data / "manifest.json") == table["version"]["data_sha256"]
    assert table["version"]["number"] == 2 and table["version"]["parent_sha256"] == model_version.digest("fish")
    assert table["version"]["rivals"][0]["name"] == "load_friction" and table["version"]["judged"]
    before, after = table["version"]["judged_gap"]
    assert (table["version"]["gap_before"], table["version"]["gap_after"]) == (3.0, 1.2) and after < 0.6 * before
    assert (patched.gap_before, patched.gap_after) == (3.0, 1.2) and "gap 3.00 -> 1.20" in patched.reason
    assert replace(robot, effects=()) == load_robot("fish")


def test_a_bundle_in_a_fitted_water_gets_its_version_too(tmp_path, data):
    """What a search was done in, apply and check do it in."""
    folder = read_dataset(data)
    bundle = write_bundle(tmp_path / "data.npz", [named(n, folder[n]) for n in folder.names])
    asked = report(tmp_path / "report", data, torque=PLANTED)
    verdict = json.loads((asked / "verdict.json").read_text())
    verdict["context"] |= {"data": str(bundle), "data_sha256": sha256(bundle), "water": "swift-base"}
    write_json(asked / "verdict.json", verdict)
    written = apply.apply(asked)
    assert written.accepted, written.reason
    assert model_version.facts(written.path)["water"] == "swift-base"
    found = check(written.path, bundle)
    assert found["worse"] == "" and found["same_data"] and found["gap"] == pytest.approx(found["stated"], rel=1e-6)
    other = gaps([load_robot(written.path)], trials_in(bundle), null_of(NULL))[0][0]
    assert abs(other - found["gap"]) > 1e-3, "the fitted water is not the model's own"


def test_a_version_goes_back_to_its_parent_bit_for_bit(patched, tmp_path):
    model = tmp_path / patched.path.name
    for path in (patched.path, model_version.beside(patched.path)):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    aside = model_version.revert(model)
    assert model.read_bytes() == resolve("fish").read_bytes() and aside.read_bytes() == patched.path.read_bytes()
    with pytest.raises(ConfigError, match="first version"):
        model_version.revert(model)


def test_versions_form_a_chain_and_a_known_effect_changes_in_place(patched, tmp_path):
    third = tmp_path / "fish.v3.toml"
    new = [
        FittedEffect("coulomb_friction", {"torque": Interval(0.1, 0.1, 0.1)}),
        FittedEffect("tether", {"stiffness": Interval(0.2, 0.1, 0.3)}),
    ]
    model_version.write(patched.path, third, new, {"effects": ["coulomb_friction", "tether"]})
    robot = load_robot(third)
    assert [fitted.name for fitted in robot.effects] == ["coulomb_friction", "tether"]
    assert robot.effects[0].parameters["torque"].value == 0.1
    assert model_version.facts(third)["number"] == 3 and model_version.facts(third)["parent_sha256"] == model_version.digest(
        patched.path
    )
    assert model_version.next_name(third, tmp_path).name == "fish.v4.toml"


def test_gap_check_passes_on_its_data_and_fails_for_a_wrong_effect_size(patched, data, tmp_path, capsys):
    code, out, _ = command(capsys, "check", patched.path, "--data", data, "--json")
    said = json.loads(out.strip().splitlines()[-1])
    assert code == 0 and said["gap"] == pytest.approx(said["stated"], rel=1e-6) and said["gap"] < said["gap_parent"]
    worse = tmp_path / patched.path.name
    worse.write_text(re.sub(r"torque = \{.*\}", "torque = { value = 0.7 }", patched.path.read_text()))
    (tmp_path / model_version.beside(worse).name).write_bytes(model_version.beside(patched.path).read_bytes())
    assert load_robot(worse).effects[0].parameters["torque"].value == 0.7
    code, out, _ = command(capsys, "check", worse, "--data", data)
    assert code == 1 and "FAILED" in out


def test_the_search_sees_the_patched_model_as_it_is(patched):
    chosen = [effects.get(name) for name in ("coulomb_friction", "servo_gain")]
    plain, fish = SwimmingFish("fish", chosen), SwimmingFish(patched.path, chosen)
    assert fish.null[fish.index("coulomb_friction", "torque")] == PLANTED
    assert (fish.nothing == plain.null).all() and fish.fingerprint == plain.fingerprint


def test_the_patched_model_swims_trains_and_is_judged(patched, tmp_path):
    from fishmj import evaluate
    from fishmj.train import __main__ as train

    robot, wave = load_robot(patched.path), lambda t: 0.5 * np.sin(6 * t - np.arange(3))
    there, here = (Sim(r).run(wave, 1.0).table("truth")["j1"] for r in (robot, load_robot("fish")))
    assert np.abs(there - here).max() > 1e-3
    trials = evaluate.trials(speeds=[0.2], los_deg=[45], repeats=1, duration=1)
    result = evaluate.run("dob", robot, trials, engines.make("batch", robot, threads=1, evaluator="jax"))
    assert np.isfinite(result.pose).all()
    argv = ["--preset", "quick", "--robot", patched.path, "--engine", "planar", "--steps", "64", "--envs", "4", "--hidden", "8"]
    argv += ["--randomise-effects", "command_latency", "--out", tmp_path / "run"]
    settings = train.settings_from(train.options().parse_args([str(a) for a in argv]))
    from fishmj.train.build import environment

    env = environment(settings)
    assert settings.task["effects"] == ("command_latency",)
    assert [fitted.name for fitted in env.robot.effects] == ["coulomb_friction", "command_latency"]
    assert env.engine.robot.effects == env.robot.effects


@pytest.mark.parametrize(
    ("name", "values", "attribute"),
    [
        ("coulomb_friction", {"torque": 0.1}, 'frictionloss="0.1"'), ("viscous_friction", {"damping": 0.05}, "damping="),
        ("skin_stiffness", {"stiffness": 0.4}, 'stiffness="0.4"'), ("torque_saturation", {"limit": 1.0}, 'forcerange="-1 1"'),
        ("command_latency", {"delay": 0.03}, 'delay="0.09"'), ("body_mass", {"mass": 0.2}, "mass="),
        ("servo_gain", {"gain": 0.2}, 'gainprm="9.6"'), ("command_gain_error", {"gain": 0.05}, 'gainprm="8.4"'),
    ],
)  # fmt: skip
def test_what_mujoco_holds_itself_is_a_diff_of_its_model(name, values, attribute):
    parent = load_robot("fish")
    robot = replace(parent, effects=(FittedEffect(name, {k: Interval(v, v, v) for k, v in values.items()}),))
    diff = difference(parent, robot)
    added = [line for line in diff.splitlines() if line.startswith("+") and not line.startswith("+++")]
    assert any(attribute in line for line in added), diff
    assert hooked(robot) == [] and mjcf(parent) == mjcf(replace(robot, effects=()))


def test_an_effect_that_needs_a_hook_is_no_diff():
    parent = load_robot("fish")
    robot = replace(parent, effects=(FittedEffect("wake_memory", {}),))
    assert difference(parent, robot) == "" and hooked(robot) == ["wake_memory"]


def test_planting_on_a_log_changes_what_sensors_report_and_nothing_else(data, tmp_path, capsys):
    out = tmp_path / "late"
    texts = ["camera_latency=0.05", "camera_scale=0.02", "command_latency=0.03"]
    code, said, _ = command(capsys, "plant", *texts, "--generator", "log", "--from", data, "--out", out, "--drop", "0.1")
    assert code == 0
    before, after = read_dataset(data)["01_gait_fast"], read_dataset(out)["01_gait_fast"]
    a, b = before.table("pose"), after.table("pose")
    assert 0.8 * len(a["t"]) < len(b["t"]) < len(a["t"])
    at = b["t"] - 0.08  # both delays: poses wait for the camera and for the command
    np.testing.assert_allclose(b["x"], 1.02 * np.interp(at, a["t"], a["x"]), atol=1e-3)  # m, the log's own grain
    np.testing.assert_array_equal(before.table("cmd")["c1"], after.table("cmd")["c1"])
    np.testing.assert_allclose(after.table("joint")["t"][0], before.table("joint")["t"][0] + 0.03, atol=0.2)
    truth = json.loads(out.with_name("late.truth.json").read_text())
    assert truth["effects"]["camera_scale"] == {"scale": 0.02} and "camera_scale" not in said


def test_what_cannot_be_planted_is_refused(data, tmp_path, capsys):
    for argv, word in (
        (["coulomb_friction=0.1", "--generator", "log", "--from", data], "before the sensors"),
        (["camera_scale=9", "--generator", "log", "--from", data], "expected -0.2 to 0.2"),
        (["camera_scale=0.1", "--generator", "log"], "--from"), (["tether", "--generator", "lbm", "--domain", "pond"], "laptop"),
        (["tether", "--generator", "lb"], "lbm"),
    ):  # fmt: skip
        code, _, err = command(capsys, "plant", *argv, "--out", tmp_path / "no")
        assert code == 2 and word in err and not (tmp_path / "no").exists(), err


def test_an_independent_robot_hides_what_was_asked(data):
    truth = json.loads(data.with_name("data.truth.json").read_text())
    assert truth["effects"] == {"coulomb_friction": {"torque": PLANTED}} and truth["generator"] == "independent"
    assert truth["manifest_sha256"] == sha256(data / "manifest.json") and len(read_dataset(data)) == 2


def test_gap_apply_speaks_of_what_it_wrote(data, tmp_path, capsys):
    folder = report(tmp_path / "r", data, torque=PLANTED)
    mine = tmp_path / "my fish" / "mine.toml"
    mine.parent.mkdir()
    code, out, _ = command(capsys, "apply", folder, "--out", mine)
    assert code == 0 and "frictionloss" in out and f"check it any time: fishmj gap check '{mine}' --data DATA" in out
    assert mine.with_suffix(".diff").read_text().startswith("--- parent.xml")
    code, out, _ = command(capsys, "apply", "--revert", mine)
    assert code == 0 and mine.read_bytes() == resolve("fish").read_bytes()


@pytest.mark.parametrize("inside", [False, True])
def test_second_search_leaves_no_model_of_the_first(inside, tmp_path, monkeypatch):
    """Unless it is the very model that was searched."""
    from types import SimpleNamespace

    from fishmj.gap import report
    from fishmj.gap.commands import find

    model = tmp_path / "model.patched.toml"
    for name in ("model.patched.toml", "model.patched.diff", "model.rejected-0123456789ab.toml", "mine.toml"):
        (tmp_path / name).write_text("of the first search")
    monkeypatch.setattr(find, "settle", lambda *_: SimpleNamespace(path=None, accepted=False))
    monkeypatch.setattr(report, "write", lambda *_: [])
    evidence, verdict = SimpleNamespace(model=None), SimpleNamespace(plain=dict)
    inquiry = SimpleNamespace(verdict=verdict, evidence=evidence, records=())
    find.write(inquiry, tmp_path, {"judged": [], "model": str(model) if inside else "fish"})
    assert (tmp_path / "mine.toml").exists() and (tmp_path / "verdict.json").exists()
    assert model.exists() == inside and bool(list(tmp_path.glob("model.rejected-*"))) == inside
