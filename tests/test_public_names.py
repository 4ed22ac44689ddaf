"""What a user can call stays: verbs, options and names that the documents show, each as it was or under its new name."""

import argparse
import json
from importlib import import_module
from pathlib import Path

import pytest

from fishmj import cli

KNOWN = json.loads(Path(__file__).with_name("public_names.json").read_text(encoding="utf-8"))


class Asked(BaseException):
    """A parser was about to read its arguments."""


def options_of(parser: argparse.ArgumentParser) -> set[str]:
    return {text for action in parser._actions for text in action.option_strings or [f"<{action.dest}>"]}


def commands(main, path: str):
    """(command, its main) of a verb, in order."""
    if hasattr(main, "commands"):
        for name in main.commands:
            yield from commands(main.load(name), f"{path} {name}")
    else:
        yield path, main


def test_every_verb_and_option_is_there(monkeypatch):
    def ask(self, args=None, namespace=None):
        raise Asked(self)

    monkeypatch.setattr(argparse.ArgumentParser, "parse_known_args", ask)
    found = {}
    for verb in cli.present():
        for path, main in commands(cli.load(verb), verb):
            with pytest.raises(Asked) as caught:
                main([])
            found[path] = options_of(caught.value.args[0])
    lost = {path: sorted(set(options) - found.get(path, set())) for path, options in KNOWN["options"].items()}
    assert {path: options for path, options in lost.items() if options} == {}


@pytest.mark.parametrize("old", KNOWN["names"])
def test_a_documented_name_is_there(old):
    module, _, name = KNOWN["names"][old].partition(":")
    try:
        assert hasattr(import_module(module), name)
    except AssertionError:
        import_module(f"{module}.{name}")
