"""What `gap find` says: terminal, page and JSON never contradict each other, on small verdicts made by hand."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import effects
from fishmj.gap.commands.apply import verdict_on
from fishmj.gap.decide.decide import _answer, step_table
from fishmj.gap.measured import page as measured_page
from fishmj.gap.report import sections
from fishmj.gap.report.report_data import ReportRow, after, gap_of, listed
from fishmj.gap.search.fit import Candidate
from fishmj.gap.search.stepwise import CrossValidatedFit, SelectionStep
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import MOST, NamedEffect, Value, Verdict, missed_text, round_text
from fishmj.gap.wording import level, number, percent, quantity, title

CURRENT = NamedEffect(
    "steady_current", {"x": Value(0.1415, "m/s", 0.09918, 0.18391), "y": Value(-0.0159, "m/s", -0.028, -0.0036)}, 0.04, 0.99
)
SKIN = NamedEffect("skin_stiffness", {"stiffness": Value(0.91934, "N m/rad", 0.52911, 1.30956)}, 0.0, 0.99)
RIVALS = (
    {"name": "current_shear", "p_best": 0.45, "behind": 0.0, "instead_of": "steady_current"},
    {"name": "swirl", "p_best": 0.48, "behind": 0.0, "instead_of": "steady_current"},
    {"name": "command_gain_error", "p_best": 1.0, "behind": 0.0, "instead_of": "skin_stiffness"},
)
PASSED = {"adequacy": 6483.676, "gain": 3.4e7, "closure": 0.98, "rest": 1.53, "transfer": 1.0, "form": 0.5, "size": 0.2}


def candidate(*names):
    return Candidate(names, (0,), np.ones(1), 1.0, np.zeros(1))


def step(accepted, gap, names=("steady_current",)):
    return SelectionStep((candidate(*names),), None, 34561418.0, accepted, gap, gap)


def verdict(before, now, **more):
    """A search that took a steady current, and what it made of the gap."""
    found = {"answer": "UNEXPLAINED", "effects": (CURRENT,), "rivals": RIVALS[:2], "reason": "made up", "gates": PASSED}
    found |= {"gap_before": before, "gap_after": now, "gap_allowed": 1.2, "explained": 0.98}
    found |= {"steps": (step_table(step(True, (before, now))),)}
    return Verdict(**found | more)


GROWN, SHRUNK = verdict(7273.97, 42555.6), verdict(1521.138, 1316.749)


def material(v, *, changed=None, steps=None):
    """As much of a page's material as words need."""
    plant = SimpleNamespace(active=SimpleNamespace(effects=list(effects.catalogue().values())))
    found = SimpleNamespace(steps=steps or (step(True, (v.gap_before, v.gap_after)),), best=candidate("steady_current"))
    found.base = SimpleNamespace(row=np.zeros(1))
    inquiry = SimpleNamespace(
        verdict=v, found=found, evidence=SimpleNamespace(model=plant), records=[], notes=(), unseen=np.zeros(1, bool)
    )
    changed = v.taken if changed is None else changed
    comparison = SimpleNamespace(changed=changed)
    return SimpleNamespace(inquiry=inquiry, gates=frozen(), comparison=comparison, channels={}, blind=())


# ------------------------------------------------------------------------------------------------------------------- rounds
def test_round_is_called_accepted_only_if_the_held_out_residual_shrinks():
    assert round_text(True, 300.0, (5.0, 1.0)).endswith("accepted") and round_text(True, 300.0, None).endswith("accepted")
    grown = round_text(True, 34561418.0, (7273.97, 42555.6))
    assert "accepted" not in grown and grown.endswith("kept although their residual does not shrink")
    assert "accepted" not in round_text(True, 300.0, (5.0, 5.0))
    little = round_text(False, 12.0, None)
    assert little.startswith("adding it improves the fit too little: gain 12 in") and little.endswith("not enough")
    assert {round_text(False, gain, None) for gain in (0.0, -3.0)} == {"adding it does not improve the fit"}


def test_sizes_that_could_have_been_missed_are_told_by_kind():
    one = {"null": 0.0, "unit": "N m s/rad"}
    missed = {"viscous_friction@knee": one | {"value": 0.002, "of_typical": 0.1}}
    missed |= {"viscous_friction@hip": one | {"value": 0.03, "of_typical": 2.0}}
    missed |= {"servo_gain@a": {"value": 1.2, "null": 1.0, "unit": "1", "of_typical": 1.0}}
    missed |= {"dead_time": {"value": None, "null": 0.0, "unit": "s", "of_typical": None}}
    never, head, *rows = missed_text(missed)
    assert head.endswith("if present alone") and never.endswith("at any size that was tried: dead time")
    assert rows == [
        "    viscous friction: 0.03 N m s/rad at hip, 0.002 N m s/rad at knee",
        "    servo gain: 1 + 0.2 at a",
    ]
    assert missed_text({}) == []


def test_a_terminal_lists_the_least_detectable_sizes_and_the_page_all_of_them():
    one = {"null": 0.0, "unit": "N m"}
    missed = {f"torque_offset@joint_{k}": one | {"value": 0.01 * k, "of_typical": 0.1 * k} for k in range(1, 51)}
    head, row, more = missed_text(missed)
    assert row.startswith("    torque offset: 0.5 N m at joint 50, 0.49 N m at joint 49,") and row.count(" at ") == MOST
    assert more == "    ... and 40 more in report.html"
    page = sections.invisible(material(verdict(1.0, 1.0, answer="AGREES", effects=(), rivals=(), missed=missed)))
    assert page.parts and str(page.parts[1]).count(" at joint") == 50 and "would not have shown" in page.parts[0]
    assert list(verdict(1.0, 1.0, missed=missed).plain()["missed"]) == list(missed)


@pytest.mark.parametrize(("gap", "accepted"), [((7.0, 1.0), True), ((7.0, 9.0), False), ((7.0, np.nan), False)])
def test_terminal_page_and_json_call_the_same_rounds_accepted(gap, accepted):
    one = step(True, gap)
    v = replace(SHRUNK, steps=(step_table(one),))
    told = v.plain()["steps"][0]
    assert (told["accepted"], told["taken"]) == (accepted, True)
    assert ("accepted" in one.text()) is accepted
    assert v.steps[0]["accepted"]  # what the search decided stays


def test_held_out_residual_comes_from_the_fit_that_excluded_the_record():
    blocks = [SimpleNamespace(channel="joint", where=slice(0, 2)), SimpleNamespace(channel="joint", where=slice(2, 4))]
    layout = SimpleNamespace(record=np.array([0, 0, 1, 1]), blocks=blocks, residuals=lambda rows: np.array(rows))
    plant = SimpleNamespace(predict=lambda records, rows: [[1.0 * r[0]] * 4 for r in rows])
    near = SimpleNamespace(layout=layout, model=plant, records=[0, 1], scale=np.ones(4))
    fits = tuple(replace(candidate(), row=np.array([value])) for value in (2.0, 3.0))
    folds = np.array([[True, False], [False, True]])
    assert CrossValidatedFit(near, candidate(), fits).over_floor(folds) == pytest.approx((4.0 + 9.0) / 2)


# --------------------------------------------------------------------------------------------------------------- percentages
def test_no_share_is_claimed_beside_a_gap_that_grows():
    assert not GROWN.shrinks
    for text in (
        GROWN.text(),
        str(sections.figures(material(GROWN))),
    ):
        assert "explain" not in text and "%" not in text
    assert "gap 7270 -> 42600 on the records searched" in GROWN.text() and "it grows" in GROWN.text()
    assert "does not shrink" in GROWN.text() and "does not shrink" in "".join(sections.warnings(material(GROWN)))


@pytest.mark.parametrize(
    "more",
    [
        {"gap_unseen_before": 2.0, "gap_after_unseen": 2.5},
        {"gap_after": 1521.2},
        {"steps": (step_table(step(True, (5.0, 6.0))),)},
    ],
)
def test_wherever_the_gap_was_measured_it_has_to_shrink(more):
    v = replace(SHRUNK, **more)
    assert SHRUNK.shrinks and not v.shrinks and "98" not in v.success_text()
    assert "98" not in sections.meaning(material(replace(v, answer="NAMED"))) + sections.meaning(
        material(replace(v, answer="CLASS"))
    )


def test_a_share_names_what_it_is_of():
    text = SHRUNK.text()
    assert "explains 98 % of the excess log likelihood, on records that it was not fitted to" in text
    assert "gap 1520 -> 1320 on the records searched (|z|^2 / m; up to 1.20 agrees)" in text
    assert "13 % of what is above 1 is gone" in text
    named = replace(SHRUNK, answer="NAMED")
    assert "98 % of the excess log likelihood" in sections.meaning(material(named))
    force = {"name": "sway force ~ tail angle", "closure": 0.28, "firm": True, "alike": []}
    v = replace(SHRUNK, terms=(force,))
    assert "removes 28 % of the excess |z|^2 on the records that it was fitted to, firm" in v.text()
    assert "28 %" in sections.next_step(material(v)) and "Fitted to these records" in sections.next_step(material(v))


def test_a_reason_claims_a_share_only_beside_a_gap_that_shrinks():
    gates, stand = frozen(), {}
    for shrinks, claimed in ((True, True), (False, False)):
        answer, reason = _answer(PASSED | {"rest": 5.8}, gates, (), stand, (), (), shrinks)
        assert answer == "UNEXPLAINED" and ("98 % of the excess log likelihood" in reason) is claimed
        assert ("does not lower the residual" in reason) is not claimed and "5.8 times" in reason
    good = PASSED | {"rest": 1.0, "form": 0.02, "size": 0.0}
    assert _answer(good, gates, (), stand, (), (), True) == (
        "NAMED",
        "explains records that it has not seen, and nothing else does",
    )
    assert "not their residual smaller" in _answer(good, gates, (), stand, (), (), False)[1]


@pytest.mark.parametrize("checks", [{"rest": 5.8, "form": 0.5}, {"size": 0.6}, {"transfer": 0.5}, {"closure": 0.3, "rest": 5.8}])
def test_unexplained_denies_no_share_that_it_states(checks):
    """Most of the gap may be explained, by an effect that is not certain: no sentence beside it says that nothing explains it."""
    good = PASSED | {"rest": 1.0, "form": 0.02, "size": 0.0} | checks
    answer, reason = _answer(good, frozen(), (), {}, (), ())
    v = replace(SHRUNK, reason=reason, explained=good["closure"])
    assert answer == "UNEXPLAINED" and f"explains {percent(v.explained)} of the excess" in v.text()
    said = (
        v.text(),
        sections.headline(v),
        sections.CONTRACT[answer],
        sections.meaning(material(v)),
        measured_page.MEANING[answer],
    )
    sentences = [part for text in said for part in re.split(r"[.;:\n]", text) if re.search("explain|hold|takes away", part)]
    denied = [part for part in sentences if re.search(r"\b(no|not|nothing)\b", part)]
    assert len(denied) >= 3 and all("certainly" in part or "not fitted to" in part for part in denied), denied


@pytest.mark.parametrize("answer", ["AGREES", "NOT_REPEATABLE", "UNEXPLAINED"])
def test_where_nothing_was_taken_the_gap_is_told_as_it_is(answer):
    refused = (step_table(step(False, None)),)
    shown = (CURRENT,) if answer == "UNEXPLAINED" else ()
    v = verdict(5.0, 5.0, answer=answer, effects=shown, rivals=(), gates={"adequacy": 3.0}, explained=0.0, steps=refused)
    text = v.text()
    assert "gap 5.00 on the records searched" in text and "->" not in text and "%" not in text and "P(best)" not in text
    m = material(v)
    np.testing.assert_array_equal(after(m.inquiry), m.inquiry.found.base.row)
    assert sections.figures(m)[0][0] == "5.00" and v.plain()["gap_after"] == 5.0


def test_terminal_page_json_and_apply_say_one_pair_of_gaps():
    v = replace(SHRUNK, answer="NAMED", gap_unseen_before=400.0, gap_after_unseen=300.0)
    (before, now), m = v.gap, material(v)
    assert (before, now) == (1521.138, 1316.749) == gap_of(m) == tuple(v.plain()[key] for key in ("gap_before", "gap_after"))
    good, reason = verdict_on(v.answer, v.gap, (400.0, 300.0), (390.0, 290.0))
    told = (v.text(), str(sections.figures(m)), reason, step(True, (5.0, 4.0)).text())
    pairs = [re.findall(r"([\d.]+) (?:->|→) ([\d.]+)", text) for text in told]
    assert good and pairs == [[("1520", "1320")]] * 3 + [[]]
    assert "the gap shrinks on records that no decision used" in v.text()
    grown = replace(v, gap_after_unseen=500.0).text()
    assert "the gap does not shrink on records that no decision used" in grown
    hurt = verdict_on("NAMED", v.gap, (400.0, 800.0), (390.0, 290.0))
    assert hurt[0] is False and "the gap is 2.00 times what it was" in hurt[1] and "->" not in hurt[1]


@pytest.mark.parametrize("answer", ["UNEXPLAINED", "CLASS", "NAMED", "NOT_REPEATABLE"])
def test_a_gap_of_usual_size_is_not_said_to_agree_beside_another_answer(answer):
    v = replace(SHRUNK, answer=answer, gap_before=1.5, gap_after=1.4, gap_allowed=1.92)
    for text in (v.text(), str(sections.figures(material(v)))):
        assert "agree" not in text and "no larger than the 1.92 of healthy robots, but of another form" in text
    assert "up to 1.92 agrees" in replace(v, answer="AGREES").text()
    closed, held = replace(v, gap_before=2.0), answer != "UNEXPLAINED"
    for text in (closed.text(), str(sections.figures(material(closed)))):
        assert ("up to 1.92 agrees" in text) is held and ("it is that small now, but by no valid formula" in text) is not held
    assert "up to 1.92 agrees" in replace(closed, gap_after=1.95).text()


def test_what_is_not_repeatable_shows_no_explanation_though_one_was_taken():
    v = replace(SHRUNK, answer="NOT_REPEATABLE", effects=(), rivals=())
    assert not v.taken and "explain" not in v.text() and "->" not in v.text()


def test_verdict_without_rounds_states_the_gap_on_held_out_records():
    v = replace(SHRUNK, steps=(), gates={"closure": 0.7}, explained=0.7)
    assert "explains 70 % of what lies above the floor, on records that it was not fitted to" in v.text()
    assert "gap 1520 -> 1320 on records kept aside" in v.text()
    none = replace(v, gap_after=v.gap_before, explained=0.0)
    assert "does not lower the gap" in none.text() and "likelier" not in none.text()


# --------------------------------------------------------------------------------------------------------------------- lists
def test_explanations_are_ranked_by_probability_among_their_own_rivals():
    v = replace(GROWN, effects=(CURRENT, SKIN), rivals=RIVALS)
    lists = [line for line in v.text().splitlines() if "P(best)" in line]
    assert lists[0].endswith("largest first: swirl 0.48, current shear 0.45, steady current 0.04")
    assert lists[1].endswith("largest first: command gain error 1.00, skin stiffness 0.00")
    assert "a rival at 0 is still too close to rule out" in lists[2]
    assert "bootstrap draws" not in replace(v, rivals=()).text()


def test_finalists_are_sorted_by_p_best_with_those_on_a_bound_last():
    row = lambda p, tried=False: ReportRow("x", {}, 0.0, p, False, tried)
    assert listed([row(0.0, True), row(None), row(0.3), row(0.7)]) == [3, 2, 0, 1]
    assert listed([row(0.4), row(0.4, True)])[0] == 1


def test_table_labels_the_tried_hypothesis_as_tried_and_never_as_best():
    rows = (
        ReportRow("swirl", {"rate": (0.02, "rad/s")}, -0.031, 0.96, True),
        ReportRow("steady_current", {}, 0.0, 0.04, False, True),
    )
    text = sections.ranked(SimpleNamespace(table=rows[:1], alike=np.eye(1)), 0, 1) + sections.ranked(
        SimpleNamespace(table=rows[1:], alike=np.eye(1)), 0, 1
    )
    assert ">-3.1 %<" in text and ">tried<" in text and ">best<" not in text
    assert ">-<" in sections.ranked(SimpleNamespace(table=(replace(rows[0], behind=None),), alike=np.eye(1)), 0, 1)


# ----------------------------------------------------------------------------------------------------------- numbers and names
def test_no_id_of_an_effect_and_no_number_without_end_is_said():
    v = replace(GROWN, effects=(CURRENT, SKIN), rivals=RIVALS, tentative=(replace(SKIN, name="yaw_added_mass"),))
    text = " ".join(
        [
            v.text(),
            *sections.warnings(material(v)),
            step(True, (7273.97, 42555.6)).text(),
        ]
    )
    assert not [name for name in effects.catalogue() if "_" in name and name in text]
    assert "steady current x 142 (99.2 to 184) mm/s, y -15.9 (-28 to -3.6) mm/s" in text
    digits = [
        re.sub(r"e[+-]\d+$", "", d).replace(".", "").lstrip("0").rstrip("0") for d in re.findall(r"\d[\d.]*(?:e[+-]\d+)?", text)
    ]
    assert max(map(len, digits)) <= 3, digits


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (number(34561418.0), "3.46e+07"),
        (number(42555.6), "42600"),
        (number(-5865.2), "-5870"),
        (number(0.066), "0.066"),
        (level(0.972), "0.97"),
        (level(12.34), "12.3"),
        (level(7273.97), "7270"),
        (percent(0.98), "98 %"),
        (percent(0.9993), "99.9 %"),
        (percent(0.99999), "99.9 %"),
        (percent(1.0), "100 %"),
        (quantity(0.04, "s", 0.0347, 0.0452), "40 (34.7 to 45.2) ms"),
        (quantity(0.1, "1"), "0.1"),
        (title("yaw_drag+swirl"), "yaw drag and swirl"),
        (title("coulomb_friction@left_hip+stribeck"), "Coulomb friction at left hip and Stribeck"),
        (title("munk_moment+viscous_friction@munk"), "Munk moment and viscous friction at munk"),
    ],
)
def test_numbers_have_two_or_three_digits(shown, expected):
    assert shown == expected
