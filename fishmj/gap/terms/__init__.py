"""What a gap looks like when no effect of the catalogue explains it: forces as products of what the fish does.

    terms_of(plant, records, null) -> (Term, ...)     best first

Every term is a provisional effect with one coefficient, put into the plant and whitened by the null like any other (library.py,
judge.py). A term is a description in the units of a force, never a name.
"""

from dataclasses import asdict

from fishmj.gap.terms.select import Term, terms_of


def described(plant, e, null, seed: int = 0) -> tuple[dict, ...]:
    """The terms of an inquiry as plain dictionaries; none for a plant that is no swimming fish.

    Args:
        e: Evidence of the records. null: how its null runs are drawn.
    """
    there = _with_terms(plant)
    if there is None:
        return ()
    residuals = null.residuals(plant, e.records, e.layout)
    return tuple(asdict(t) | {"firm": t.firm} for t in terms_of(there, e.records, residuals, seed))


def challenged(plant, e, found, verdict):
    """The verdict on what was found, UNEXPLAINED if a free force explains more (outdone.py); as it is for no swimming fish.

    Args:
        e: Evidence of the records.
    """
    from fishmj.gap.terms import stronger

    there = _with_terms(plant)
    return verdict if there is None else stronger.challenged(there, e, found, verdict)


def _with_terms(plant):
    """The fish with the library in place of the catalogue; None for a plant that is no swimming fish."""
    from fishmj.gap.models.swimming_fish import SwimmingFish
    from fishmj.gap.terms.model_with_terms import termed

    return termed(plant.robot) if isinstance(plant, SwimmingFish) else None


__all__ = ["Term", "challenged", "described", "terms_of"]
