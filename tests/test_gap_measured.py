"""The workflow on real recordings, found through FISHMJ_MEASURED; the full figures stand in docs/search/measured_robots.md."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from fishmj.base import console
from fishmj.gap.__main__ import main
from fishmj.gap.bench import logs
from fishmj.gap.bench.score import score
from fishmj.gap.measured import boat_drag, measured_command, tendon_fish
from fishmj.gap.measured.folder import trials
from fishmj.gap.measured.study import investigate
from fishmj.gap.measured.study_answer import answer, report
from fishmj.gap.measured.study_build import built, deleted, shipped

measured = pytest.mark.skipif(not os.environ.get("FISHMJ_MEASURED"), reason="set FISHMJ_MEASURED to the folder of measured data")


def test_without_the_folder_the_command_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.delenv("FISHMJ_MEASURED", raising=False)
    assert console.run(main, ["measured", "tail_fish"]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "FISHMJ_MEASURED is not set" in said and "gap fetch tail_fish" in said


def test_a_set_that_is_not_there_or_not_known_is_one_clear_error(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("FISHMJ_MEASURED", str(tmp_path))
    assert console.run(measured_command.main, ["servo_xl330"]) == console.BAD_INPUT
    assert "no such folder" in capsys.readouterr().err
    assert console.run(measured_command.main, ["tailfish"]) == console.BAD_INPUT
    assert "Did you mean 'tail_fish'" in capsys.readouterr().err


def part_of(name, folder, keep, change=lambda text: text):
    """A folder of measured data that holds a part of one set."""
    source = Path(os.environ["FISHMJ_MEASURED"]) / name
    for path in source.rglob("*"):
        if path.is_file() and keep(path):
            to = folder / name / path.relative_to(source)
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")


NO_DUTY = lambda text: re.sub(r'"load": -?\d+', '"load": 800', text)  # another make: a register that does not tell the duty
PARTS = {
    "one condition": ("tail_fish", lambda p: p.parent.name == "Amp15Bias0", lambda t: t, "of one group"),
    "one gain": ("servo_xl330", lambda p: '"kp": 100' in p.read_text()[:200], lambda t: t, "of one group"),
    "one trajectory": ("servo_xl330", lambda p: '"sin_sin"' in p.read_text()[:200], lambda t: t, "leave 0 group(s)"),
    "another make": ("servo_xl330", lambda p: p.suffix == ".json", NO_DUTY, "the gain cannot be determined"),
    "one run": ("usv_coastdown", lambda p: p.name.endswith("_5.csv"), lambda t: t, "expected two at least"),
    "one frequency": ("tendon_fish_markers", lambda p: "f0_50" in p.name, lambda t: t, "expected two at least"),
}


@measured
@pytest.mark.parametrize("name, keep, change, words", PARTS.values(), ids=PARTS)
def test_a_part_of_a_set_that_cannot_be_judged_is_one_clear_error(name, keep, change, words, tmp_path, monkeypatch, capsys):
    part_of(name, tmp_path, keep, change)
    monkeypatch.setenv("FISHMJ_MEASURED", str(tmp_path))
    assert console.run(measured_command.main, [name.removesuffix("_markers")]) == console.BAD_INPUT
    err = capsys.readouterr().err
    assert words in err and "Traceback" not in err and len(err.strip().splitlines()) == 1, err


@pytest.mark.slow
@measured
def test_body_lift_is_named_on_the_tail_fish_in_every_fold():
    study = built(shipped("tail_fish"))
    assert len({r.group for r in study.learn}) == 20 and len({r.group for r in study.aside}) == 7
    assert not {r.group for r in study.learn} & {r.group for r in study.aside}
    found = investigate(study, most=1)
    verdict = answer(study, found)
    assert found.rounds[0].best == ("body_lift",) * 4
    assert found.kept_aside[1] <= 0.55 * found.kept_aside[0]
    assert verdict.answer == "NAMED" and verdict.effects[0].p_best > 0.9, verdict.text()
    spread = verdict.effects[0].parameters["coefficient"]
    assert spread.low < 10 < spread.high and spread.high - spread.low < 0.4 * spread.value
    assert not verdict.rivals and found.rounds[0].p_exact < 1e-3
    assert report(study, found, verdict)["origin"] == "measured"


@measured
def test_one_effect_improves_the_servo_and_three_gains_are_too_few_to_tell():
    study = built(shipped("servo_xl330"))
    assert {r.group for r in study.learn} == {"kp100", "kp200", "kp400"} and len(study.aside) == 3
    found = investigate(study, most=1)
    verdict = answer(study, found)
    before, after = (study.figure(e) for e in found.kept_aside[:2])
    assert after <= 0.72 * before
    assert verdict.answer == "TOO_FEW_GROUPS" and "tentative" in verdict.reason and found.rounds[0].p_exact == 0.125
    assert verdict.effects[0].name == "load_friction" and found.rounds[0].best == ("load_friction",) * 3


@measured
def test_the_servo_is_predicted_at_the_stamps_of_the_log():
    study = built(shipped("servo_xl330"))
    raw = trials("servo_xl330")
    for r in study.learn:
        t = raw[r.name].table("joint")["t"]
        assert np.array_equal(r.joint.t, t - raw[r.name].table("cmd")["t"][0]) and np.ptp(np.diff(t)) > 1e-4


@measured
def test_the_boats_runs_do_not_tell_linear_from_quadratic_drag():
    said, figures = boat_drag.run(lambda text: None)
    assert figures["runs"] >= 4 and figures["speeds"] >= 40
    assert figures["answer"].startswith("CLASS") and max(figures["p_better"].values()) < 0.95, said


@pytest.mark.slow
@measured
def test_tendon_fish_speed_at_a_left_out_frequency_is_within_15_per_cent():
    beats = [tendon_fish.beat(name, trial) for name, trial in trials("tendon_fish_markers").items()]
    assert [b.frequency for b in beats] == pytest.approx([0.375, 0.75, 1.125, 1.5], abs=0.02)
    said, figures = tendon_fish.predicted(beats, choices=[tendon_fish.CHOSEN])
    assert figures["holds"] and max(map(abs, figures["choices"][0]["errors"])) <= 0.15, said
    assert max(abs(b / s - 1) for b, s in zip(figures["speed_before"], figures["speed"], strict=True)) > 0.15  # it took a fit


def test_deleted_terms_come_up_in_turn_with_other_records_kept_aside():
    drawn = logs.draw(12, 3)
    assert len({c.id for c in drawn}) == 12 and {c.seed for c in drawn} == {3, 4, 5}
    assert [c.kind for c in drawn].count("none") == sum(c.term == "" for c in drawn) == 2
    assert len({(c.set, c.term) for c in drawn[:5]}) == 5


@pytest.mark.slow
@measured
def test_a_term_deleted_from_the_fitted_model_is_looked_for():
    row = logs.run(logs.Deletion("log-tail_fish-body_lift-0", "single", "tail_fish", "body_lift", 0))
    assert row["answer"] == "NAMED" and [e["name"] for e in row["said"]] == ["body_lift"]
    assert row["true_gap"] > 3 and score([row])["coverage_all_magnitudes"]["value"] == 1.0
    value, low, high = row["said"][0]["values"]["coefficient"]
    assert low <= row["truth"]["body_lift"]["coefficient"] <= high and high - low < 0.4 * value


@measured
def test_a_deleted_constant_is_neither_in_the_model_nor_fitted():
    study = built(shipped("tail_fish", deleted("tail_fish", "yaw_drag")))
    assert "yaw_drag" not in [c.name for c in study.plant.constants] and study.plant.hull.yaw_drag == 0.0
    study = built(shipped("servo_xl330", deleted("servo_xl330", "viscous")))
    assert study.plant.motor.viscous == 0.0 and len(study.aside) == 3
