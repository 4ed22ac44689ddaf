"""What a gap looks like when no effect of the catalogue explains it: forces as products of what the fish does.

    terms_of(model, records, null) -> (Term, ...)     best first

Every term is a provisional effect with one coefficient, put into the model and whitened by the null like any other (library.py,
select.py). A term is a description in the units of a force, never a name.
"""

from dataclasses import asdict

from fishmj.gap.terms.select import Term, terms_of

_COMPILED: dict = {}  # fingerprint -> the model with the library, compiled at first use, one a process


def model_with_terms(robot):
    """The swimming fish of `robot` (a description, with the effects it lists) in which every term is at its null."""
    from fishmj import effects
    from fishmj.gap.models.swimming_fish import SwimmingFish
    from fishmj.gap.terms.library import library

    made = SwimmingFish(robot, catalogue=[*library(), *(effects.get(fitted.name) for fitted in robot.effects)])
    return _COMPILED.setdefault(made.fingerprint, made)


def describe(model, e, null, seed: int = 0) -> tuple[dict, ...]:
    """The terms of an inquiry as plain dictionaries; none for a model that is no swimming fish.

    Args:
        e: `Likelihood` of the records. null: how its null runs are drawn.
    """
    there = _with_terms(model)
    if there is None:
        return ()
    residuals = null.residuals(model, e.records, e.layout)
    return tuple(asdict(t) | {"firm": t.firm} for t in terms_of(there, e.records, residuals, seed))


def challenge(model, e, found, verdict):
    """The verdict on what was found, UNEXPLAINED if a free force explains more (stronger.py); as it is for no swimming fish.

    Args:
        e: `Likelihood` of the records.
    """
    from fishmj.gap.terms import stronger

    there = _with_terms(model)
    return verdict if there is None else stronger.challenge(there, e, found, verdict)


def _with_terms(model):
    """The fish with the library in place of the catalogue; None for a model that is no swimming fish."""
    from fishmj.gap.models.swimming_fish import SwimmingFish

    return model_with_terms(model.robot) if isinstance(model, SwimmingFish) else None


__all__ = ["Term", "challenge", "describe", "model_with_terms", "terms_of"]
