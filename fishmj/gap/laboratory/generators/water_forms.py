"""Generators by name. Each water model is imported and compiled at its first use."""

from importlib import import_module

from fishmj.base.errors import UnknownName
from fishmj.gap.laboratory.generators.family import Family

NAMES = ("morison", "foil", "ellipsoid")


def get(name: str) -> Family:
    """Returns a family. Raises UnknownName, which lists the families; MissingExtra: no numba."""
    if name not in NAMES:
        raise UnknownName("generator", name, NAMES)
    return import_module(f"fishmj.gap.laboratory.generators.{name}").FAMILY
