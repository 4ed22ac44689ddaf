"""Which of several effects found together is too little to be named: what the formula of another leaves may look like it.

An effect is not named beside others that

    brings less than `MINOR` of the gain, and something else may be meant or its value is not believable
    brings less than `LITTLE`, and the catalogue says that one that brings more is taken for it
    brings less than `LITTLE` and is much smaller than usual, unless it gains by itself as much as may be asked of any
    is far smaller than anywhere known and brings less than `LESSER`
    is much smaller than usual and brings less than that, beside one that is not so small and that it is taken for or that turns
    the same gears: the little dry friction that every gear train has shows beside play, where nothing else holds the link

Nor does it spoil the name of those that bring much.
"""

from fishmj.effects.ambiguity import together
from fishmj.gap.decide.poorly_determined import SMALL, small
from fishmj.gap.decide.rivals import Support
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import Gates
from fishmj.gap.verdict import Named

MINOR = 0.05  # share of the gain below which an effect brings little
LITTLE = 0.1  # the same for one that is smaller than usual, or what a larger one is taken for
LESSER = 0.5  # the same for one that is far smaller than it is anywhere known
USUAL = 0.5  # of the least typical size


def negligible(found: Selection, effects: tuple[Named, ...], stand: dict[str, Support], doubts: dict, gates: Gates) -> set[str]:
    """Names of those. doubts: what is not believable about each."""
    e, whole = found.near.origin, sum(s.gain for s in stand.values())
    brings = {n: s.gain / whole for n, s in stand.items()}
    least = {n: min(b, found.share(n, b)) for n, b in brings.items()}
    weak = {n for n, s in stand.items() if doubts[n] or may_be_another(n, s, gates)}
    tiny, faint = ({n.name for n in effects if small(e, n, share)} for share in (SMALL, USUAL))
    alike = {n for n in least for other in least if least[other] > least[n] and confused(e, n, other)}
    little = {n for n in least if least[n] < LITTLE}
    slight = {n for n in little if stand[n].gain < max(gates.enough, gates.beside * whole)}
    out = {n for n, b in brings.items() if b < MINOR and n in weak or b < LESSER and n in tiny} | alike & little | faint & slight
    return out | {n for n in masked_by(e, set(least) - out, faint) if least[n] < LESSER}


def may_be_another(name: str, stand: Support, gates: Gates) -> bool:
    """Whether something else may be meant that is not the same by construction."""
    twins = [r for r in stand.rivals if together(name, r.name)]
    return len(twins) < len(stand.rivals) or (not twins and stand.p_best < gates.p_best)


def confused(e: Likelihood, one: str, other: str) -> bool:
    """Whether the catalogue lists one of two effects among those that the other is taken for."""
    known = {x.name: {c.other for c in x.confusions} for x in e.plant.active.effects}
    return other in known[one] or one in known[other]


def masked_by(e: Likelihood, names, faint: set[str]) -> set[str]:
    """Those of `faint`, much smaller than usual, beside another of `names` that is not: it is taken for them, or turns the same
    gears."""
    geared = {x.name for x in e.plant.active.effects if x.gear is not None}
    return {n for n in faint for other in set(names) - faint if confused(e, n, other) or {n, other} <= geared}
