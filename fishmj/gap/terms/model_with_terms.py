"""The swimming fish with the typed library in place of the catalogue."""

from fishmj import effects
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.terms.library import library

_MADE: dict[str, SwimmingFish] = {}


def termed(robot) -> SwimmingFish:
    """The plant of `robot` (a description, with the effects it lists) in which every term is at its null.

    Compiled at first use, one a process.
    """
    made = SwimmingFish(robot, catalogue=[*library(), *(effects.get(fitted.name) for fitted in robot.effects)])
    return _MADE.setdefault(made.fingerprint, made)
