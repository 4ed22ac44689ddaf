"""The worked example of the selection: docs/search/method.md shows the numbers that the function `propose` finds."""

from pathlib import Path

import pytest

pytest.importorskip("numba")

from studies.gap_benchmark import toy_selection  # noqa: E402

PAGE = Path(__file__).resolve().parent.parent / "docs" / "search" / "method.md"


def test_propose_accepts_the_effect_that_carries_over():
    step = toy_selection.first_round()
    assert step.accepted and [c.names for c in step.ranked] == [("friction",), ("drag",)]
    assert step.gain == pytest.approx(876.8, abs=0.05)
    assert step.ranked[0].cost < toy_selection.least_gain_where_fitted(step)


def test_worked_example_of_the_page_is_what_the_code_prints(capsys):
    toy_selection.main()
    printed, page = capsys.readouterr().out, PAGE.read_text(encoding="utf-8")
    for number in ("882", "0.988", "171.2", "0.974", "1.40", "0.12", "1.019", "0.979", "876.8", "655.4", "150.0"):
        assert number in printed and number in page, number
