"""Each of the five answers, as its example gives it to a user."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("numba")

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "gap_answers.py"
QUICK = ("--null-runs", "64")


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("gap_answers", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["agrees", "named", "not_repeatable"])
def test_the_example_gets_the_answer_it_is_called_by(example, name, tmp_path):
    assert example.tell(name, tmp_path, QUICK) == [name.upper()]


def test_the_proposed_experiment_turns_a_class_into_a_name(example, tmp_path, capsys):
    assert example.tell("class", tmp_path, QUICK) == ["CLASS", "NAMED"]
    before, after = capsys.readouterr().out.split("The proposed experiment is done")
    assert "torque_saturation" in before and "speed_limit" in before and "would decide between" in before
    assert "  torque_saturation: limit" in after


def test_a_weighing_tells_twins_apart(example, tmp_path, capsys):
    assert example.tell("twins", tmp_path, QUICK) == ["CLASS", "NAMED"]
    before, after = capsys.readouterr().out.split("It is weighed")
    assert "yaw_added_mass" in before and "two threads" in before
    assert "  yaw_inertia: inertia" in after


def test_what_no_effect_explains_is_described_as_a_force(example, tmp_path, capsys):
    assert example.tell("unexplained", tmp_path, QUICK) == ["UNEXPLAINED"]
    assert "as a force: sway force ~" in capsys.readouterr().out
