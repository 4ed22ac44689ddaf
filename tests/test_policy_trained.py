"""How a policy was trained: its water, constants and command; what is not so here is said, in table, page, results and logs."""

import json
import os
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from policy_files import ROBOT, SHORT, header, stored

from fishmj import control
from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError
from fishmj.control.learned import header_of
from fishmj.control.policy import FOLDER, SHIPPED, Policy, shipped
from fishmj.control.policy_meta import one_line
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines import in_water
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.evaluate.__main__ import options as evaluate_options
from fishmj.log import read_trial
from fishmj.mjcf.identity import constants_of, constants_sha256
from fishmj.view.play.__main__ import main as play
from fishmj.view.play.__main__ import options as play_options
from fishmj.water.water_identity import water_identity

LACKING = {"pilot": "water, training command", "station-sac": "training command"}  # what is documented nowhere


@pytest.mark.parametrize("name", shipped())
def test_shipped_policies_say_their_water_and_what_they_lack(name):
    water = {"paper": "structured", "paper-sac": "structured", "station-family": "swift-family"}.get(name, "swift")
    lacks = (f"policy {name}: its header lacks {LACKING[name]}, not compared",) if name in LACKING else ()
    assert control.make(name, in_water(ROBOT, water)).notes == lacks
    by_path = os.path.relpath(FOLDER / f"{name}.safetensors")
    assert control.make(by_path, in_water(ROBOT, water)).notes == lacks, "the same file, named by its path"
    other = "swift" if water == "structured" else "structured"
    differs = () if name == "pilot" else (f"policy {name}: not as trained: water {water}, here {other}",)
    assert control.make(name, in_water(ROBOT, other)).notes == differs + lacks


def test_every_shipped_policy_is_in_the_help_and_in_the_guide():
    assert sorted(SHIPPED) == shipped()
    guide = (Path(__file__).parent.parent / "docs" / "train" / "controllers.md").read_text(encoding="utf-8")
    for options in (evaluate_options, play_options):
        text = options().format_help()
        assert all(f"  {name}  " in text and about in text for name, about in SHIPPED.items())
    assert all(f"| `{name}` |" in guide for name in SHIPPED)


# water and constants: said, never refused


def structured(**changes):
    """The fish with other coefficients in its own water."""
    return replace(ROBOT, water={**ROBOT.water, **changes})


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (in_water(ROBOT, "swift"), "water structured, here swift"),
        (in_water(ROBOT, "swift-base"), "water structured, here swift-base"),
        (structured(cf=0.5), "water structured (structured a7526ad5), here structured (structured"),
        (replace(ROBOT, servo=replace(ROBOT.servo, kp=9.0)), "servo kp 8, here 9"),
        (replace(ROBOT, timing=replace(ROBOT.timing, command_latency=0.1)), "timing command_latency 0.06, here 0.1"),
        (
            replace(ROBOT, effects=(FittedEffect("coulomb_friction", {"torque": Interval(0.1, 0.1, 0.1)}),)),
            "effects none, here coulomb",
        ),
        (replace(ROBOT, links=(*ROBOT.links[:-1], replace(ROBOT.links[-1], fin_from=0.06))), "other sections, centres of mass"),
        (
            replace(ROBOT, links=tuple(replace(k, mass=2 * k.mass) for k in ROBOT.links)),
            "mass of head 0.744, here 1.488; mass of",
        ),
    ],
)
def test_another_water_or_other_constants_are_one_line(tmp_path, robot, said):
    (note,) = control.make(stored(tmp_path, header()), robot).notes
    assert note.startswith(f"policy mine: not as trained: {said}") and "\n" not in note


def test_constants_of_a_robot_of_ones_own_are_compared_by_the_header(tmp_path):
    other = replace(ROBOT, servo=replace(ROBOT.servo, kp=9.0), timing=replace(ROBOT.timing, velocity_window=4))
    foreign = header(constants_sha256=constants_sha256(other))
    said = lambda meta: control.make(stored(tmp_path, meta), ROBOT).notes[0].partition("not as trained: ")[2]
    assert said(foreign) == "other masses, sections, servo, timing or effects, which is not stored"
    kept = header_of(other)["constants"]
    assert kept == constants_of(other) and kept["servo kp"] == 9.0
    assert said(foreign | {"constants": kept}) == "servo kp 9, here 8; timing velocity_window 4, here 6"
    many = said(foreign | {"constants": {f"x{i}": i for i in range(99)}})
    assert many.endswith("more") and many.count(";") == 8
    for wrong in ([], {"servo kp": [1]}, {"a\nb": 1}, {"servo kp": "x" * 5000}):
        with pytest.raises(ConfigError, match="constants .* expected"):
            control.make(stored(tmp_path, foreign | {"constants": wrong}), ROBOT)


def test_an_effect_at_its_null_and_a_colour_are_no_other_constants(tmp_path):
    links = tuple(replace(link, colour=(1.0, 0.0, 0.0)) for link in ROBOT.links)
    robot = replace(ROBOT, links=links, title="red", effects=(FittedEffect("coulomb_friction", {}),))
    assert control.make(stored(tmp_path, header()), robot).notes == ()


def test_what_differs_stands_in_table_page_results_and_log(tmp_path, capsys):
    """The water of `station` is another one here; `paper` swims in its own, and `dob` was not trained."""
    argv = ["station", "paper", "dob", *SHORT, "--json", "--log", "--out", str(tmp_path)]
    assert console.run(evaluate, argv) == console.OK
    out, err = capsys.readouterr()
    assert err.count("policy station: not as trained: water swift, here structured\n") == 1 and "policy paper:" not in err
    said = "station is not judged as trained: water swift, here structured"
    assert said in out.splitlines() and said in (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in out.splitlines() if line.startswith("|")]
    assert rows[0] == ["controller", "not as trained"] and rows[2:5] == [["station", "water"], ["paper", "-"], ["dob", "-"]]
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    station, paper, dob = (one["policy"] for one in found["results"])
    assert station["differs"] == {"water": ["swift", "structured"]} and paper["differs"] == {} and dob is None
    assert station["water"]["name"] == "swift" and station["command"].startswith("fishmj train --preset paper")
    trial = read_trial(tmp_path / "logs" / "station_u0.2_los000_r0")
    assert trial.value("policy.differs.water") == ["swift", "structured"] and trial.value("water") == "structured"
    assert trial.value("policy.constants_sha256") == constants_sha256(ROBOT)


def test_the_flow_solver_is_another_water_too():
    brain = control.make("station", in_water(ROBOT, "lbm", can=("lbm",)))
    assert brain.notes == ("policy station: not as trained: water swift, here lbm",)
    assert brain.trained()["differs"] == {"water": ["swift", "lbm"]}
    assert control.make("station", in_water(ROBOT, "swift")).trained(brain.robot)["said"] == "water swift, here lbm"


def test_a_live_swim_says_it_and_logs_it(tmp_path, capsys):
    argv = ["--controller", "paper", "--headless-seconds", "0.4", "--save", str(tmp_path / "a"), "--robot"]
    shutil.copy(calib_folder() / "fish.toml", tmp_path / "stiff.toml")
    text = (tmp_path / "stiff.toml").read_text(encoding="utf-8")
    (tmp_path / "stiff.toml").write_text(re.sub(r"(?m)^kp = [0-9.]+", "kp = 9.5", text), encoding="utf-8")
    assert console.run(play, [*argv, str(tmp_path / "stiff.toml")]) == console.OK
    assert capsys.readouterr().err.count("policy paper: not as trained: servo kp 8, here 9.5") == 1
    assert "constants" in read_trial(tmp_path / "a").value("policy.differs")


class Recorded:
    """A training run that only remembers how it was called."""

    command = ""

    def __init__(self, settings, folder, **options):
        self.folder, Recorded.command = folder, options["command"]

    def go(self) -> dict:
        told = {"algorithm": "ppo", "seed": 0, "steps": 1, "seconds": 1.0, "engine": "planar", "policy": str(self.folder)}
        return told | {"stopped": False, "folder": str(self.folder)}


def test_the_command_line_tells_a_training_its_words(tmp_path, monkeypatch):
    from fishmj.train import training_run
    from fishmj.train.__main__ import main as train

    monkeypatch.setattr(training_run, "TrainingRun", Recorded)
    monkeypatch.setattr(training_run, "learner_of", lambda settings, devices: None)
    argv = ["--preset", "quick", "--steps", "300", "--engine", "planar", "--out", str(tmp_path / "a run")]
    assert console.run(train, argv) == console.OK
    assert Recorded.command == f"fishmj train {' '.join(argv[:-1])} {shlex.quote(argv[-1])}"
    assert one_line("fishmj train --out 'a\nb\x1b'") == "fishmj train --out 'a?b?'" and len(one_line("x" * 9999)) == 4000


@pytest.mark.slow
def test_freshly_trained_policy_has_complete_metadata_and_no_warnings(tmp_path):
    from fishmj.train.__main__ import main as train

    argv = ["--preset", "quick", "--envs", "8", "--steps", "300", "--hidden", "8", "--engine", "planar", "--water", "structured"]
    assert console.run(train, [*argv, "--out", str(tmp_path / "a")]) == console.OK
    meta = Policy.load(tmp_path / "a").meta
    assert meta["command"] == f"fishmj train {' '.join(argv)} --out {tmp_path / 'a'}" and meta["water"] == water_identity(ROBOT)
    assert [note for note in control.make(tmp_path / "a", ROBOT).notes if "taken from" not in note] == []
