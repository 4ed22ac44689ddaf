"""The page's table of gates and its place of the gap: each row true, also where the search goes on by another rule."""

from types import SimpleNamespace

import pytest

pytest.importorskip("numba")

from fishmj.gap.localise.narrative import paragraph
from fishmj.gap.report import sections
from fishmj.gap.report.sections import gates
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import NamedEffect, Value, Verdict

HELD = {"adequacy": 3.0, "closure": 0.9, "rest": 1.0, "form": 0.05, "size": 0.1, "transfer": 1.0, "gain": 5000.0, "strain": 0.0}
CURRENT = NamedEffect("steady_current", {"x": Value(0.03, "m/s", 0.02, 0.04)}, 1.0, 0.9)


def page_of(gain: float = 5000.0, accepted: bool = True, **checks: float) -> SimpleNamespace:
    """Report data of a search with one effect, as the sections of the page read it."""
    verdict = Verdict("NAMED", effects=(CURRENT,), gates=HELD | checks)
    found = SimpleNamespace(steps=[SimpleNamespace(gain=gain, accepted=accepted)])
    return SimpleNamespace(inquiry=SimpleNamespace(verdict=verdict, found=found), gates=frozen(), weighed="")


def states(page: SimpleNamespace) -> dict[str, str]:
    return {gate.name: gate.state for gate in gates(page)}


def test_gates_that_hold_have_passed():
    assert set(states(page_of()).values()) == {"passed"}


@pytest.mark.parametrize(
    "gate, changed, says",
    [
        ("gap", {"adequacy": 1.0}, "an effect was accepted"),
        ("gain", {"gain": 250.0}, "all records at once"),
        ("closure", {"closure": 0.4}, "hardly any residual is left"),
        ("form", {"form": 0.3}, "may be chance"),
        ("force", {"lead": 90.0, "believed": False}, "wrong in its form"),
    ],
)
def test_gate_whose_inequality_does_not_hold_has_not_passed(gate, changed, says):
    found = states(page_of(**changed))
    assert found.pop(gate).startswith("not met; continued because ") and set(found.values()) == {"passed"}
    assert says in states(page_of(**changed))[gate]


def test_gap_without_an_accepted_effect_has_failed():
    found = list(states(page_of(accepted=False, adequacy=1.0)).values())
    assert found[0] == "failed" and set(found[1:]) == {"not asked"}


def test_small_residual_beside_a_name_is_not_said_to_hold_nothing():
    place = SimpleNamespace(gap=3.61, allowed=10.1)
    place.text = paragraph(place)
    page = page_of()
    page.place = place
    (told,) = sections.where(page).parts
    assert "nothing" not in told and "no larger than healthy robots leave (gap 3.61)" in told and "by the form" in told
