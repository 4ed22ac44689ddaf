"""How large an effect is beside what is typical, and which of several found together is too little to be named.

What the formula of one effect leaves may look like another. An effect is not named beside others that

    brings less than `doubtful_gain` of the gain, and something else may be meant or its value is not believable
    brings less than `confusable_gain`, and the catalogue says that one that brings more is taken for it
    brings less than that and is below `weak_size`, unless it gains by itself as much as may be asked of any
    is below `implausible_size` and brings less than `implausible_gain`
    is below `weak_size` and brings less than that, beside one that is not so small and that it is taken for or that turns the
    same gears: the little dry friction that every gear train has shows beside play, where nothing else holds the link

Nor does it spoil the name of those that bring much. The thresholds are those of [secondary] in data/calib/gap.toml.
"""

from fishmj.effects.ambiguity import together
from fishmj.effects.effect import Parameter
from fishmj.gap.decide.rivals import Support
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import Gates, thresholds
from fishmj.gap.verdict import Named, Value


def negligible(found: Selection, effects: tuple[Named, ...], stand: dict[str, Support], doubts: dict, gates: Gates) -> set[str]:
    """Names of those. doubts: what is not believable about each."""
    limits = thresholds().secondary
    e = found.near.origin
    whole = sum(s.gain for s in stand.values())
    share = {n: s.gain / whole for n, s in stand.items()}
    # What an effect gained when it was added counts, too: beside a later one that can imitate it, it may gain little at the end.
    least = {n: min(b, found.gain_share(n, b)) for n, b in share.items()}
    doubtful = {n for n, s in stand.items() if doubts[n] or may_be_another(n, s, gates)}
    implausible = {n.name for n in effects if smaller_than(e, n, limits.implausible_size)}
    weak = {n.name for n in effects if smaller_than(e, n, limits.weak_size)}
    little = {n for n in least if least[n] < limits.confusable_gain}
    confusable = {n for n in little for other in least if least[other] > least[n] and confused(e, n, other)}
    slight = {n for n in little if stand[n].gain < max(gates.min_gain_cap, gates.min_gain_fraction * whole)}
    out = {n for n in doubtful if share[n] < limits.doubtful_gain}
    out |= {n for n in implausible if share[n] < limits.implausible_gain}
    out |= confusable | (weak & slight)
    return out | {n for n in masked_by(e, set(least) - out, weak) if least[n] < limits.implausible_gain}


def may_be_another(name: str, stand: Support, gates: Gates) -> bool:
    """Whether something else may be meant that is not the same by construction."""
    twins = [r for r in stand.rivals if together(name, r.name)]
    return len(twins) < len(stand.rivals) or (not twins and stand.p_best < gates.p_best)


def confused(e: Likelihood, one: str, other: str) -> bool:
    """Whether the catalogue lists one of two effects among those that the other is taken for."""
    known = {x.name: {c.other for c in x.confusions} for x in e.model.active.effects}
    return other in known[one] or one in known[other]


def masked_by(e: Likelihood, names, weak: set[str]) -> set[str]:
    """Those of `weak`, much smaller than usual, beside another of `names` that is not: it is taken for them, or turns the same
    gears."""
    geared = {x.name for x in e.model.active.effects if x.gear is not None}
    return {n for n in weak for other in set(names) - weak if confused(e, n, other) or {n, other} <= geared}


def size_parameters(effect) -> list:
    """The parameters that say how large an effect is: as the first, not those that shape it."""
    return [p for p in effect.parameters if p.unit == effect.parameters[0].unit and not p.shape]


def smaller_than(e: Likelihood, n: Named, share: float) -> bool:
    """Whether every main value is less than `share` of the least that is typical."""
    main = size_parameters(next(x for x in e.model.active.effects if x.name == n.name))
    return all(abs(n.parameters[p.name].value - p.null) < share * min(abs(t - p.null) for t in p.typical) for p in main)


def poorly_determined(p: Parameter, v: Value) -> bool:
    """Whether records and null runs scatter the only size of an effect by more than `size_scatter` of it."""
    limits = thresholds()
    return (v.high - v.low) / 2 / limits.intervals.quantile > limits.secondary.size_scatter * abs(v.value - p.null)


def insignificant(main, values: dict[str, Value]) -> bool:
    """Whether the null lies in the intervals of all sizes of an effect."""
    return all(values[p.name].low <= p.null <= values[p.name].high for p in main)


def within_null_scatter(e: Likelihood, effects) -> bool:
    """Whether what was found is one effect, and no larger than null runs may make of it though nothing is hidden in them."""
    if len(effects) != 1:
        return False
    main = size_parameters(next(x for x in e.model.active.effects if x.name == effects[0].name))
    values = effects[0].parameters
    return insignificant(main, values) if len(main) > 1 else poorly_determined(main[0], values[main[0].name])
