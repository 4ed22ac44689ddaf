"""Each of the five answers, as its example gives it to a user."""

import importlib.util
import json
from pathlib import Path

import pytest

pytest.importorskip("numba")

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "gap_answers.py"
QUICK = ("--null-runs", "64")
FEW = ("--null-runs", "24")  # where the answer is plain; as many as the tutorial of the search takes, which are kept


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("gap_answers", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_nothing_hidden_is_agreement(example, tmp_path):
    assert example.tell("agrees", tmp_path, QUICK) == ["AGREES"]


@pytest.mark.slow
def test_a_latency_is_named_with_its_size(example, tmp_path):
    assert example.tell("named", tmp_path, FEW) == ["NAMED"]
    verdict = json.loads((tmp_path / "first" / "report" / "verdict.json").read_text())
    (effect,) = verdict["effects"]
    assert effect["name"] == "command_latency" and effect["parameters"]["delay"]["value"] == pytest.approx(0.03, rel=0.1)
    assert verdict["gap_after"] < 0.5 * verdict["gap_before"]


@pytest.mark.slow
def test_restless_water_is_not_repeatable(example, tmp_path):
    """Though an effect was taken, which one round finds; a second one would be another search of the same."""
    assert example.tell("not_repeatable", tmp_path, (*FEW, "--most", "1")) == ["NOT_REPEATABLE"]


@pytest.mark.slow
def test_the_proposed_experiment_turns_a_class_into_a_name(example, tmp_path, capsys):
    assert example.tell("class", tmp_path, QUICK) == ["CLASS", "NAMED"]
    before, after = capsys.readouterr().out.split("The proposed experiment is done")
    assert "torque saturation" in before and "speed limit" in before and "would decide between" in before
    assert "\n  torque saturation 1." in after


def test_what_is_weighed_where_that_is_proposed_is_searched_with(example, tmp_path, monkeypatch):
    """The search itself: test_gap_weighing.py."""
    asked, told = [], iter([("CLASS", "Weigh the robot"), ("NAMED", "")])

    def call(*arguments):
        asked.append(arguments)
        if arguments[0] == "find":
            folder = Path(arguments[arguments.index("--out") + 1])
            folder.mkdir(parents=True)
            answer, proposed = next(told)
            (folder / "verdict.json").write_text(json.dumps({"answer": answer, "next_experiment": proposed}))

    monkeypatch.setattr(example, "call", call)
    assert example.tell("twins", tmp_path) == ["CLASS", "NAMED"]
    assert ["--weigh" in arguments for arguments in asked] == [False, False, True, False]


@pytest.mark.slow
def test_what_no_effect_explains_is_described_as_a_force(example, tmp_path, capsys):
    assert example.tell("unexplained", tmp_path, QUICK) == ["UNEXPLAINED"]
    assert "as a force: sway force ~" in capsys.readouterr().out
