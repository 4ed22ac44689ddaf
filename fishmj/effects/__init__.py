"""Catalogue of the imperfections that fishmj knows by name, in `stages/` by the stage at which each acts.

    effects.get("command_latency").formula
    active = effects.EffectStack([effects.get("coulomb_friction")], joints=3)

Domain randomisation draws from these entries, a calibration lists them, and the discrepancy workflow may name them.
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import stages
from fishmj.effects.effect import CHANNELS, STAGES, Confusion, Effect, Parameter, RobotForm, kind_of, site_of
from fishmj.effects.robot_scales import RobotScales
from fishmj.effects.stack import EffectStack


@cache
def catalogue() -> dict[str, Effect]:
    """All effects of a fish by name, in order of stage, then of name."""
    return {effect.name: effect for effect in _every() if effect.swims}


@cache
def robot_catalogue() -> dict[str, Effect]:
    """All effects of a robot described in MJCF by name, in order of stage, then of name."""
    return {effect.name: effect for effect in _every() if effect.robot is not None}


@cache
def _every() -> list[Effect]:
    """Each `Effect` of each file in `stages/`, in order of stage, then of name."""
    modules = [import_module(f"{stages.__name__}.{m.name}") for m in iter_modules(stages.__path__)]
    found = [value for module in modules for value in vars(module).values() if isinstance(value, Effect)]
    return sorted(found, key=lambda effect: (STAGES.index(effect.stage), effect.name))


def join(effect: Effect) -> None:
    """Adds the user's own effect to the catalogue of this process; `engines.own_effects` checks it first.

    Raises ConfigError: another effect has that name.
    """
    if catalogue().setdefault(effect.name, effect) is not effect:
        raise ConfigError(f"effect {effect.name!r} is in the catalogue already; give yours another name")


def get(name: str) -> Effect:
    """One effect. Raises UnknownName, which lists them all."""
    if name not in catalogue():
        raise UnknownName("effect", name, catalogue())
    return catalogue()[name]


__all__ = [
    "CHANNELS",
    "STAGES",
    "Confusion",
    "Effect",
    "EffectStack",
    "Parameter",
    "RobotForm",
    "RobotScales",
    "catalogue",
    "get",
    "join",
    "kind_of",
    "robot_catalogue",
    "site_of",
]
