"""A dataclass declares options of a command: its parser and its values agree."""

import argparse
from dataclasses import dataclass

import pytest

from fishmj.base import console
from fishmj.base.options import setting


def test_a_dataclass_makes_its_options_and_takes_them_back():
    @dataclass(frozen=True)
    class Water:
        depth: float = setting(0.5, console.number(0, 10), "of the water, m", metavar="M")
        kind: str = setting("still", ("still", "gust"), "of the current", "--turbulence")
        walls: bool = setting(True, None, "no walls")
        deep: bool = setting(False, None, "deep water")
        label: str = ""

    parser = console.parser("x", "x")
    console.add_settings(parser, Water, "kind", "depth", "walls", "deep")
    read = lambda *words: Water(**console.settings_of(parser.parse_args(words), Water))
    assert read() == Water()
    assert read("--turbulence", "gust", "--depth", "2", "--no-walls", "--deep") == Water(2.0, "gust", False, True)
    assert [a.option_strings[-1] for a in parser._actions[2:]] == ["--turbulence", "--depth", "--no-walls", "--deep"]
    for words, said in ((["--depth", "11"], "expected a number from 0 to 10"), (["--turbulence", "gus"], "Did you mean 'gust'")):
        with pytest.raises(console.UsageError, match=said):
            read(*words)
    few = console.parser("x", "x")
    console.add_settings(few, Water, "deep")
    assert console.settings_of(few.parse_args([]), Water) == {"deep": False}


@pytest.mark.parametrize(
    ("kind", "text", "example"),
    [
        (console.Listed(console.number(0, 1)), "0-0.04", "0,0.02,0.04"),
        (console.Listed(console.number(0, 1)), "0.5,.1 .. .3", ".1,0.2,.3"),
        (console.Listed(console.number(0, 5), 2), "0:0.4", "0,0.4"),
        (console.Listed(console.SEED), "0-5", "0,5"),
        (console.Listed(console.number(0, 1)), "1-9", ""),
        (console.Listed(console.OneOf(("a", "b"))), "0-5", ""),
    ],
)
def test_a_range_in_place_of_a_list_is_answered_with_the_list(kind, text, example):
    with pytest.raises(argparse.ArgumentTypeError) as error:
        kind(text)
    assert str(error.value).partition("; a range is written as a list, such as ")[2] == example
    assert not example or kind(example)
