"""Generators of blind test data: robotic fish in three water models other than the strip model and the second robot's.

    morison     inertia and drag strip by strip; momentum shed wherever the body narrows
    foil        plates at an angle of attack: quasi-steady lift and drag, a fin with stall and Wagner lag
    ellipsoid   one ellipsoid's added mass, quadratic damping by links, a tail fin by thin-foil theory

    generate("morison", effects, excitations, seed) -> [Trial]     trials with hidden effects
    parse(texts, seed, family) -> effects                          in the notation of `gap plant`
    page(family, effects, seed) -> dict                            readings of scales, knife edge and pendulum of that robot
    detectable(family, effects, excitations, seed) -> dict         its visible size over noise and healthy robots

The rigid bodies, joints, dry friction and actuators are MuJoCo's own. No package of a fit is imported. docs/search/generators.md.
"""

from typing import TYPE_CHECKING, Any

from fishmj.gap.laboratory.generators.family import NAMES

if TYPE_CHECKING:
    from fishmj.gap.laboratory.generators.detectability import detectable
    from fishmj.gap.laboratory.generators.effect_catalogue import hidden, parse
    from fishmj.gap.laboratory.generators.generator_trials import generate, page

__all__ = ["NAMES", "detectable", "generate", "hidden", "page", "parse"]
_WHERE = {
    "generate": "generator_trials",
    "parse": "effect_catalogue",
    "hidden": "effect_catalogue",
    "detectable": "detectability",
    "page": "generator_trials",
}


def __getattr__(name: str) -> Any:
    """Loads MuJoCo and numba at first use only."""
    if name not in _WHERE:
        raise AttributeError(f"module 'fishmj.gap.laboratory.generators' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"fishmj.gap.laboratory.generators.{_WHERE[name]}"), name)
