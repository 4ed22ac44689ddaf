"""Figures of the results pages: those with stored rows are those of the rows, and each entry finds its numbers on its page."""

import re

import pytest

from fishmj.base.errors import ConfigError, UnknownName
from studies import figures
from studies.figures import FigureEntry

ENTRIES = figures.entries()


@pytest.mark.parametrize("entry", [entry for entry in ENTRIES if entry.rows], ids=lambda entry: entry.name)
def test_page_shows_the_figures_of_its_stored_rows(entry):
    compared = figures.from_rows(entry)
    assert compared and [one for one in compared if not one.same] == []


@pytest.mark.parametrize("entry", [e for e in ENTRIES if e.json or e.output], ids=lambda entry: entry.name)
def test_page_has_every_number_that_a_command_makes_again(entry):
    shown = [group for pattern in entry.find for group in figures.groups(pattern, entry.text, entry.page)]
    made = len(entry.json) or sum(re.compile(pattern).groups for pattern in entry.output)
    assert len(shown) == made and all(figures.number(text) >= 0 for text in shown)


def test_page_of_figures_lists_every_entry_with_its_cost():
    text = figures.PAGE.read_text(encoding="utf-8")
    assert figures.on_page(text, figures.listing(ENTRIES)) == text, "python -m studies.figures --write"
    assert all(entry.minutes < figures.CHEAP for entry in ENTRIES if entry.runs and entry.machine == "cpu")


def made_by(text: str, **options) -> FigureEntry:
    """An entry whose command prints this text."""
    run = f"python -c \"print('{text}')\""
    return FigureEntry("toy", "docs/train/results.md", "toy", run, run=run, **options)


@pytest.mark.parametrize(("made", "state"), [("12.2", "same"), ("12.24", "same"), ("12.3", "DIFFERS")])
def test_number_beyond_the_tolerance_differs(made, state):
    entry = made_by(f"seen {made} s", find=(r"\| `drift` \| 5/72 \|  \| ([\d.]+) \|",), output=(r"seen ([\d.]+) s",))
    row = figures.check(entry, run=True)
    assert row["state"] == state and row["numbers"] == 1
    assert figures.check(entry, run=False)["state"] == "not run"


def test_command_that_fails_or_prints_nothing_is_not_the_same():
    pattern = (r"\| `drift` \| 5/72 \|  \| ([\d.]+) \|",)
    assert figures.check(made_by("none", find=pattern, output=(r"seen ([\d.]+)",)), run=True)["state"] == "failed"
    assert figures.check(made_by("none", find=pattern, json=("a.b",)), run=True)["state"] == "failed"
    run = 'python -c "raise SystemExit(1)"'
    assert figures.check(FigureEntry("toy", "docs/train/results.md", "toy", run, run=run), run=True)["state"] == "DIFFERS"


def test_numbers_of_a_page_are_read_as_written():
    found = figures.NUMBER.findall("71/72, -0.066 (+0.059 1,072) `reference-2` 2.4e-6")
    assert found == ["71", "72", "-0.066", "+0.059", "1,072", "2.4e-6"]
    assert figures.number("108,000") == 108000 and figures.rounding("0.041") == pytest.approx(5.1e-4)
    assert figures.rounding("2.4e-6") == pytest.approx(5.1e-8) and figures.rounding("98") == pytest.approx(0.51)


def test_costly_commands_and_those_of_a_gpu_run_only_by_name():
    toys = [FigureEntry("cheap", "p", "", "", minutes=1, run="x"), FigureEntry("dear", "p", "", "", minutes=60, run="x")]
    toys.append(FigureEntry("solver", "p", "", "", machine="gpu", minutes=1, run="x"))
    assert [run for _, run in figures.wanted(toys, [], rows=False)] == [True, False, False]
    assert [run for _, run in figures.wanted(toys, [], rows=True)] == [False] * 3
    assert [(entry.name, run) for entry, run in figures.wanted(toys, ["solver"], rows=False)] == [("solver", True)]
    with pytest.raises(UnknownName, match="cheap"):
        figures.wanted(toys, ["cheep"], rows=False)


def test_table_that_a_page_lacks_is_named():
    with pytest.raises(ConfigError, match="no table"):
        figures.table_rows("text", "| head |")
