"""The page's table of gates and its place of the gap: each row true, also where the search goes on by another rule."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.gap.localise.narrative import paragraph
from fishmj.gap.localise.residual_patterns import BINS, by_rate
from fishmj.gap.report import pictures, sections
from fishmj.gap.report.sections import gates
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import NamedEffect, Value, Verdict

HELD = {"adequacy": 3.0, "closure": 0.9, "rest": 1.0, "form": 0.05, "size": 0.1, "transfer": 1.0, "gain": 5000.0, "strain": 0.0}
STEP = 1 / 64  # s
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
        ("closure", {"closure": 0.4}, "the remaining residual is small"),
        ("form", {"form": 0.3}, "may be chance"),
        ("force", {"lead": 90.0, "believed": False}, "its form is wrong"),
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
    assert "nothing" not in told and "no larger than that of healthy robots (gap 3.61)" in told and "by the form" in told


def joint_of(t: np.ndarray, commands: np.ndarray) -> SimpleNamespace:
    """Comparison of one joint at times t, whose difference is largest at 2 s and at 70 s."""
    block = SimpleNamespace(channel="joint", column=0, record=0, t=t, where=slice(0, len(t)))
    ratio = np.where((t > 1) & (t < 4), 3.0, np.where(t > 70, 9.0, 1.0))[None]
    records = [SimpleNamespace(commands=commands, dt=STEP)]
    return SimpleNamespace(layout=SimpleNamespace(blocks=[block]), ratio=ratio, over_floor=ratio, records=records)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_the_traces_show_no_pause_of_the_log():
    t = np.concatenate([np.arange(0, 5, 0.1), np.arange(65, 74, 0.1)])
    c = joint_of(t, np.zeros((5000, 1)))
    assert pictures.stretch(c, c.layout.blocks[0]) == (69.5, 73.5)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("speeds", [(1.0,), (0.25, 1.0), np.linspace(0.1, 1, 500)])
def test_fifths_of_the_speed_without_a_command_are_left_out(speeds):
    rates = np.repeat(speeds, 4000 // len(speeds))
    found = by_rate(joint_of(np.arange(0, 62, 0.1), np.cumsum(rates)[:, None] * STEP))
    assert found is None if len(speeds) == 1 else np.isfinite(found.level).all() and len(found.level) >= min(len(speeds), BINS)
