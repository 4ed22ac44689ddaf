"""Doubts about an effect, in the terminal and on the page: another one is likelier, or its size may be zero."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from fishmj import effects
from fishmj.effects import EffectStack
from fishmj.gap.decide.implausible import advice
from fishmj.gap.report import robot_page, sections
from fishmj.gap.verdict import IMPLAUSIBLE, NamedEffect, Value, Verdict
from fishmj.gap.wording import untold
from fishmj.gap.workflow import propose_experiment

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


def test_an_implausible_value_is_said_and_asks_for_the_description_not_for_a_record():
    """Such a CLASS lists no alternatives, so no experiment can tell them apart; it proposed one that the records already had."""
    v = replace(found("CLASS", 1.0), effects=(NamedEffect("torque_saturation", {}, 1.0, 0.9),), rivals=(), reason=IMPLAUSIBLE)
    assert sections.headline(v) == "Implausible value: perhaps torque saturation, or something that it imitates"
    assert v.text().startswith("CLASS: implausible value") and not found("CLASS", 0.9).implausible
    model = SimpleNamespace(active=EffectStack([effects.get("torque_saturation")], 3))
    told = propose_experiment(v, SimpleNamespace(further=True, evidence=SimpleNamespace(model=model))).next_experiment
    assert told.startswith("Check the numbers that torque saturation would change: [servo] torque") and "same kind" in told
    assert "description" in robot_page.next_step(SimpleNamespace(verdict=v, evidence=SimpleNamespace(model=model)))
    for e in effects.catalogue().values():
        assert advice([e]).endswith("would show the same."), e.name
