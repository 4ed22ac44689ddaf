"""A package that is not installed, for one test."""

import sys
from importlib.machinery import PathFinder


def absent(monkeypatch, package: str) -> None:
    """From now on in this test, no import finds `package`."""
    belongs = lambda name: name.partition(".")[0] == package
    for name in filter(belongs, list(sys.modules)):
        monkeypatch.delitem(sys.modules, name)
    find = PathFinder.find_spec
    monkeypatch.setattr(PathFinder, "find_spec", lambda name, *given: None if belongs(name) else find(name, *given))
