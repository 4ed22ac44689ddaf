"""How large the effects of a verdict are, beside what is typical and what null runs make of them."""

from fishmj.effects.effect import Parameter
from fishmj.gap.decide.intervals import HALF
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.verdict import Named, Value

SPREAD = 0.3  # of the value: standard deviation from which a size is not known
SMALL = 0.1  # of the least typical size


def size_parameters(effect) -> list:
    """The parameters that say how large an effect is: as the first, not those that shape it."""
    return [p for p in effect.parameters if p.unit == effect.parameters[0].unit and not p.shape]


def small(e: Likelihood, n: Named, share: float) -> bool:
    """Whether every main value is less than `share` of the least that is typical."""
    main = size_parameters(next(x for x in e.plant.active.effects if x.name == n.name))
    return all(abs(n.parameters[p.name].value - p.null) < share * min(abs(t - p.null) for t in p.typical) for p in main)


def poorly_determined(p: Parameter, v: Value) -> bool:
    """Whether records and null runs scatter the only size of an effect by more than `SPREAD` of it."""
    return (v.high - v.low) / 2 / HALF > SPREAD * abs(v.value - p.null)


def within_null_scatter(e: Likelihood, effects) -> bool:
    """Whether what was found is one effect, and no larger than null runs may make of it though nothing is hidden in them."""
    if len(effects) != 1:
        return False
    main = size_parameters(next(x for x in e.plant.active.effects if x.name == effects[0].name))
    values = effects[0].parameters
    return insignificant(main, values) if len(main) > 1 else poorly_determined(main[0], values[main[0].name])


def insignificant(main, values: dict[str, Value]) -> bool:
    """Whether the null lies in the intervals of all sizes of an effect."""
    return all(values[p.name].low <= p.null <= values[p.name].high for p in main)
