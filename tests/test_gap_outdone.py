"""What was found has to explain more than any free force; and an effect that can only be right may be wrong in its form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, evidence_on, hidden, plant  # noqa: E402, F401

from fishmj import effects
from fishmj.gap.decide.decide import _answer, needs_exact_value
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import record_of
from fishmj.gap.search.fit import refine
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.search.stepwise import Selection, converge, split
from fishmj.gap.terms import stronger
from fishmj.gap.terms.library import library, model_with_terms
from fishmj.gap.terms.stronger import is_own_formula
from fishmj.gap.thresholds import frozen, residual_allowed, thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.workflow import investigate
from fishmj.mjcf.reading import load_robot


@pytest.fixture(scope="module")
def free():
    """The plant that holds the terms."""
    return model_with_terms(load_robot("fish"))


def best(e) -> tuple[Selection, Verdict]:
    """The best single effect of the plant, as a search that stops there and names it would leave it."""
    whole, folds = e.subset(), split(e.records)
    base = whole.base()
    first = whole.refine(whole.screen(base, e.model.active.effects)[:3], 4)[0]
    fitted = converge(e, folds, first, tuple(refine(e.subset(~f), first) for f in folds))
    gain = sum(e.subset(f).loss(base.row) for f in folds) - fitted.loss(folds)
    return Selection(base, fitted, folds, (), whole.whiten.logdet), Verdict("NAMED", gates={"gain": gain})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [("command_latency", {"delay": 0.03}), ("steady_current", {"x": 0.03, "y": -0.01}), ("yaw_drag", {"coefficient": 0.01})],
)
def test_a_right_name_is_led_by_no_free_force(plant, name, values):  # noqa: F811
    e = evidence_on(plant, {name: values}, 81)
    found, verdict = best(e)
    assert found.best.names == (name,)
    said = stronger.challenge(e, found, verdict)
    assert said.answer == "NAMED" and said.gates["lead"] < thresholds().stronger.lead / 2
    assert said.gates["term"] != "yaw moment ~ yaw rate squared, signed" or name != "yaw_drag"  # its own formula is not asked


@pytest.mark.slow
def test_what_stands_in_for_a_force_is_led_by_its_term(plant):  # noqa: F811
    e = evidence_on(plant, {"tail_yaw_cross_force": {"coefficient": 0.006}}, 82)
    found, verdict = best(e)
    said = stronger.challenge(e, found, verdict)
    assert said.answer == "UNEXPLAINED" and said.gates["lead"] > 10 * thresholds().stronger.lead
    assert said.gates["believed"] and said.gates["term"].startswith("sway force") and said.gates["term"] in said.reason


@pytest.mark.slow
def test_an_encoder_with_slack_is_not_named_dry_friction(plant):  # noqa: F811
    trials = hidden({}, 84)
    for trial in trials:
        joints = trial.tables["joint"]
        for name in [name for name in joints if name != "t"]:
            joints[name] = behind(np.array(joints[name]), 0.007)
    e = likelihood_of(plant, [record_of(t, plant.dt) for t in trials], NULL)
    found, verdict = best(e)
    assert found.best.names == ("coulomb_friction",)
    said = stronger.challenge(e, found, verdict)
    assert said.answer == "UNEXPLAINED" and said.gates["term"] == "joint log ~ direction of the last turn"


def behind(angle, gap):
    """What an encoder shows that hangs on its joint with play of half a gap, rad."""
    out = angle.copy()
    for k in range(1, len(angle)):
        out[k] = np.clip(out[k - 1], angle[k] - gap, angle[k] + gap)
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "answer"),
    [({"command_gain_error": {"gain": 0.03}}, "NAMED"), ({"encoder_harmonic": {"angle": 0.015}}, "UNEXPLAINED")],
)
def test_a_gain_is_led_by_a_servos_reading_only_where_the_reading_errs(planted, answer):
    e = evidence_on(SwimmingFish(catalogue=[effects.get("command_gain_error")]), planted, 85)
    found, verdict = best(e)
    assert found.fitted.best.cost < 0.15 * found.base.cost  # either way a gain closes the gap
    said = stronger.challenge(e, found, verdict)
    assert said.answer == answer
    assert said.gates["term"].startswith("servo reading ~ sine") or answer == "NAMED"


def test_a_term_is_the_formula_of_what_was_named():
    mine = lambda name: {t.formula for t in library() if is_own_formula(effects.get(name), t)}
    assert mine("body_lift") == {"sway force ~ surge speed x sway speed"}  # -Y |u| w
    assert mine("yaw_drag") == {"yaw moment ~ yaw rate squared, signed"}
    assert mine("command_gain_error") == {"servo reading ~ angle"}
    assert mine("viscous_friction") == {"joint torque ~ rate"} and mine("skin_stiffness") == {"joint torque ~ angle"}
    assert mine("tether") == mine("steady_current") == mine("coulomb_friction") == mine("skin_hysteresis") == set()


def in_a_log_scaled_by(factor: float, seed: int):
    """Records of a healthy fish whose log has every joint's angle too large. The model in question knows a command's gain."""
    gains = SwimmingFish(catalogue=[effects.get("command_gain_error"), effects.get("servo_gain")])
    records = [record_of(t, gains.dt) for t in hidden({}, seed)]
    records = [r._replace(joint=r.joint._replace(values=factor * r.joint.values)) for r in records]
    return likelihood_of(gains, records, NULL)


@pytest.mark.slow
def test_a_log_with_a_wrong_scale_names_no_gain_of_the_command(monkeypatch):
    e = in_a_log_scaled_by(1.04, 84)
    found, verdict = best(e)
    assert found.best.names == ("command_gain_error",)
    said = stronger.challenge(e, found, verdict)
    assert said.answer == "UNEXPLAINED" and said.gates["term"] == "joint log ~ angle"
    # where a free force must lead by more, the scale is as good as what was named: neither is told from the other
    given = thresholds().stronger._replace(lead=1e9)
    monkeypatch.setattr(stronger, "thresholds", lambda: thresholds()._replace(stronger=given))
    either = stronger.challenge(e, found, verdict)
    assert either.answer == "CLASS" and [r["name"] for r in either.rivals] == ["joint log ~ angle"]
    assert "protractor" in either.next_experiment and either.rivals[0]["instead_of"] == "command_gain_error"


@pytest.mark.slow
def test_a_gain_of_the_command_is_told_from_the_scale_of_the_log():
    gains = SwimmingFish(catalogue=[effects.get("command_gain_error"), effects.get("servo_gain")])
    e = likelihood_of(gains, [record_of(t, gains.dt) for t in hidden({"command_gain_error": {"gain": 0.04}}, 85)], NULL)
    said = stronger.challenge(e, *best(e))
    assert said.answer == "NAMED" and not said.rivals


def test_with_terms_in_place_of_the_catalogue_the_model_is_the_same(plant, free):  # noqa: F811
    e = evidence_on(plant, {"yaw_drag": {"coefficient": 0.01}}, 83)
    there = e.with_model(free)
    assert there.model is free and there.origin is there and e.model is plant
    assert there.subset().base().cost == pytest.approx(e.subset().base().cost)


@pytest.mark.slow
def test_a_search_names_a_current_with_its_size_and_asks_the_free_forces(plant, monkeypatch):  # noqa: F811
    inquiry = investigate(plant, hidden({"steady_current": {"x": 0.03, "y": -0.01}}, 11), null=NULL)
    verdict = inquiry.verdict
    assert verdict.answer == "NAMED" and verdict.gates["lead"] < 0.0
    (effect,) = verdict.effects
    found = [effect.parameters[axis].value for axis in ("x", "y")]
    assert effect.name == "steady_current" and found == pytest.approx([0.03, -0.01], abs=0.003)
    assert verdict.gap_after < 0.5 * verdict.gap_before
    assert not verdict.gates["believed"]  # a constant force is a poor current
    challenged = lambda: stronger.challenge(inquiry.evidence, inquiry.found, verdict).answer
    given = thresholds().stronger._replace(lead=verdict.gates["lead"] - 1.0)
    any_lead = replace(frozen(), min_gain_fraction=-1.0)  # of the gain
    monkeypatch.setattr(stronger, "thresholds", lambda: thresholds()._replace(stronger=given, gates=any_lead))
    assert challenged() == "NAMED"
    given = given._replace(form_ratio=1e3)
    assert challenged() == "UNEXPLAINED"


def test_only_what_can_only_be_right_may_have_a_wrong_form(plant):  # noqa: F811
    e = SimpleNamespace(model=plant)
    assert needs_exact_value(e, ("command_quantisation",))
    assert not needs_exact_value(e, ("command_quantisation", "yaw_drag")) and not needs_exact_value(e, ())
    gates = frozen()
    checks = {"closure": 1.0, "rest": 1.0, "strain": 500.0, "gain": 1e4, "form": 0.5, "size": 0.1, "transfer": 1.0}
    assert _answer(checks | {"pinned": True}, gates, (), {}, (), ())[0] == "NAMED"
    assert _answer(checks | {"pinned": False}, gates, (), {}, (), ())[0] == "UNEXPLAINED"


def test_residual_limit_scales_with_the_gap_if_the_formula_is_right():
    gates = frozen()
    left = {"closure": 0.99, "rest": 1.4, "strain": 0.0, "gain": 1e4, "size": 0.1, "transfer": 1.0}
    for form, adequacy, answer in (
        (0.05, 100.0, "NAMED"),  # 0.4 of 99: the formula is 6 % off
        (0.05, 5.0, "UNEXPLAINED"),  # 0.4 of 4: 32 %
        (0.22, 100.0, "UNEXPLAINED"),  # a formula that is known to be wrong
    ):
        assert _answer(left | {"form": form, "adequacy": adequacy}, gates, (), {}, (), ())[0] == answer
    assert residual_allowed({"form": 0.05, "adequacy": 1.0}, gates) == residual_allowed({}, gates) == gates.residual
