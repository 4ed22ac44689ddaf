"""The generators by name. Each form of water is loaded, and compiled, at its first use."""

from importlib import import_module

from fishmj.base.errors import UnknownName
from fishmj.gap.laboratory.generators.family import Family

NAMES = ("morison", "foil", "ellipsoid")


def get(name: str) -> Family:
    """One family. Raises UnknownName, which lists them; MissingExtra without numba."""
    if name not in NAMES:
        raise UnknownName("generator", name, NAMES)
    return import_module(f"fishmj.gap.laboratory.generators.{name}").FAMILY
