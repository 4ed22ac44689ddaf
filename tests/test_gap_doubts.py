"""Doubts about an effect, in the terminal and on the page: another one is likelier, or its size may be zero."""

from types import SimpleNamespace

import pytest

from fishmj.gap.report import sections
from fishmj.gap.verdict import NamedEffect, Value, Verdict
from fishmj.gap.wording import untold

SHEAR = {"shear": Value(0.02, "1/s", 0.01, 0.03)}
STEADY = {"name": "steady_current", "p_best": 0.61, "behind": 0.001, "instead_of": "current_shear"}


def found(answer: str, p_best: float, parameters: dict[str, Value] = SHEAR) -> Verdict:
    effect = NamedEffect("current_shear", parameters, p_best, 0.9)
    return Verdict(answer, effects=(effect,), rivals=(STEADY,), reason="made up", gates={"closure": 0.9})


def terminal_and_page(v: Verdict) -> tuple[str, str]:
    """The effect's line in a terminal, and on the page."""
    (line,) = [line for line in v.text().splitlines() if "0.02 (" in line]
    return line, sections.value(SimpleNamespace(inquiry=SimpleNamespace(verdict=v)))


@pytest.mark.parametrize("answer", ["CLASS", "UNEXPLAINED"])
def test_effect_that_does_not_lead_is_said_not_to(answer):
    for text in terminal_and_page(found(answer, 0.20)):
        assert "ot the likeliest: steady current wins 0.61 of the bootstrap draws, this one 0.20" in text
    for text in terminal_and_page(found(answer, 0.9)):
        assert "likeliest" not in text and "distinguishable" not in text


def test_size_whose_interval_holds_none_is_said_to():
    doubtful = {"shear": Value(0.02, "1/s", -0.01, 0.05), "delay": Value(0.3, "s", 0.2, 0.4)}
    for text in terminal_and_page(found("CLASS", 0.9, doubtful)):
        assert "ot distinguishable from zero: its interval contains 0" in text
    one_axis = {"x": Value(0.14, "m/s", 0.1, 0.2), "y": Value(0.0, "m/s", -0.1, 0.1)}
    assert untold(one_axis) == "" and untold({}) == ""


def test_head_of_a_class_begins_with_the_likeliest():
    assert sections.headline(found("CLASS", 0.20)) == "Missing: steady current or current shear"
    assert sections.headline(found("CLASS", 0.9)) == "Missing: current shear or steady current"
