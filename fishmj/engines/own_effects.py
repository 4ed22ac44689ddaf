"""The user's own effects: loaded by reference, checked against the rules of the catalogue, and added to it.

    effect = join(["./my_effects.py:WEED"])[0]          its name is valid from now on, in this process

The rules (`check`): at its null an effect changes no bit of a step, in water and in air, nor of commands, delays and readings.
At typical sizes and at its bounds all results stay finite. At its larger typical size something changes. JAX and the code
generator can trace it.
"""

import math
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec

import numpy as np

from fishmj import effects
from fishmj.base import console, plugins
from fishmj.base.errors import OwnCodeError
from fishmj.base.names import is_name
from fishmj.effects import Effect, EffectStack
from fishmj.effects.effect import CLOCKS, Parameter
from fishmj.effects.sites import SensorReadings
from fishmj.effects.stack import delivered
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

CALLS = {
    **{site: (f"{site}(xp, p, {site}, memory, h)", 5) for site in ("servo", "gear", "body", "water", "command")},
    **{site: (f"{site}(xp, p, {site})", 3) for site in ("fish", "flow", "measure")},
}
FISH, STEPS = 50, 5  # random states, and consecutive steps
FIELDS = ("q", "v", "attached", "power")


def option(parser) -> None:
    """Adds `--effects` to a command line; pass its value to `join`."""
    effects = "your own effect, added to the catalogue: module:EFFECT or file.py:EFFECT; repeat for more (default: none)"
    parser.add_argument("--effects", action="append", default=[], metavar="MODULE:EFFECT", help=effects)


def drawn_option(parser) -> None:
    """Adds `--randomise-effects` to a command line: names for `engines.with_effects`."""
    drawn = "effects of the catalogue drawn in typical sizes for each episode or trial (default: none)"
    parser.add_argument("--randomise-effects", type=console.Listed(console.text), metavar="NAME,..", help=drawn)


def join(texts: Iterable[str]) -> list[Effect]:
    """Loads, checks and adds effects that the user named. Raises UnknownName, OwnCodeError, ConfigError."""
    made = []
    for text in texts:
        effect, what = plugins.load("effect", text, effects.catalogue()), f"effect {text}"
        if not isinstance(effect, Effect):
            raise OwnCodeError(f"{what}: is a {type(effect).__name__}, expected a fishmj.effects.Effect")
        if effects.catalogue().get(effect.name) is not effect:
            check(effect, what)
            effects.join(effect)
        made.append(effect)
    return made


def check(effect: Effect, what: str = "") -> None:
    """Checks an effect against the rules of the catalogue. Raises OwnCodeError, which names the broken rule and the amount."""
    what = what or f"effect {effect.name}"
    _declared(effect, what)
    for site in effect.sites:
        plugins.takes(f"{what}, {site}", getattr(effect, site), *CALLS[site])
    active = EffectStack([effect], _fish()[0].n - 1)
    _identity(active, what)
    _finite(active, what)
    if find_spec("jax") is not None:
        _traced(active, what)


def _declared(effect: Effect, what: str) -> None:
    if not is_name(effect.name):
        raise OwnCodeError(f"{what}: name {effect.name!r}; expected letters, digits, '_', '.' or '-'")
    if effect.stochastic:
        raise OwnCodeError(f"{what}: it is stochastic; simulators and the search support only deterministic effects of your own")
    if not effect.parameters or effect.parameters[0].shape:
        raise OwnCodeError(f"{what}: its first parameter must set its size, not its shape")
    for p in effect.parameters:
        numbers = (p.null, p.low, p.high, *p.typical)
        if not (p.name.isidentifier() and is_name(p.name) and all(math.isfinite(x) for x in numbers)):
            raise OwnCodeError(
                f"{what}: parameter {p.name!r} has {numbers}; expected an identifier and finite null, bounds, typical"
            )
        if not p.low <= p.typical[0] < p.typical[1] <= p.high or (not p.shape and p.typical[0] <= p.null <= p.typical[1]):
            raise OwnCodeError(
                f"{what}: parameter {p.name}: typical {p.typical} must lie within the bounds {p.low:g} to {p.high:g}"
                f" and not hold the null {p.null:g}"
            )
    if unknown := {c.other for c in effect.confusions} - set(effects.catalogue()):
        raise OwnCodeError(f"{what}: confusions with {', '.join(sorted(unknown))}, which are not in the catalogue")


@cache
def _fish() -> tuple:
    """Chain, swimmer and the arguments of a step for FISH random states of the nominal fish."""
    robot, rng = load_robot("fish"), np.random.default_rng(0)
    ch, sw = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    q, v = rng.normal(size=(ch.n + 2, FISH)), 3 * rng.normal(size=(ch.n + 2, FISH))
    flow, ambient = 0.3 * rng.normal(size=(ch.n, 2, FISH)), 0.1 * rng.normal(size=(2, FISH))
    return ch, sw, (list(q), list(v), rng.uniform(size=FISH), list(rng.normal(size=(ch.n - 1, FISH))), list(flow), ambient)


def _step(active: EffectStack, what: str, given, row, memory, wet: float = 1.0):
    """Does one step of all fish with the effect. Raises OwnCodeError if its code fails."""
    ch, sw, _ = _fish()

    def take():
        hooks = Effects(np, active, [np.float64(x) for x in row], list(memory), wet)
        target = [hooks.session.command(j, value, ch.dt) for j, value in enumerate(given[3])]
        return planar_chain.step(np, ch, sw, *given[:3], target, *given[4:], hooks)

    return plugins.call(f"{what}: a step with parameters {[round(float(x), 6) for x in row]}", take)


def _changes(one, other) -> dict[str, float]:
    """Largest difference of each field in which two steps are not equal to the bit."""
    pairs = {field: [np.array(getattr(step, field), float) for step in (one, other)] for field in FIELDS}
    return {field: float(np.abs(a - b).max()) for field, (a, b) in pairs.items() if not np.array_equal(a, b)}


def _identity(active: EffectStack, what: str) -> None:
    """Checks that no bit changes at the null, for every null of its shape parameters."""
    ch, sw, first = _fish()
    for wet in (1.0, 0.0):
        given, memory = first, active.memory
        for k in range(STEPS):
            plain = planar_chain.step(np, ch, sw, *given)
            same = _step(active, what, given, active.null, memory, wet)
            for field, most in _changes(same, plain).items():
                medium, nulls = "water" if wet else "air", zip(active.names, active.null, strict=True)
                null = ", ".join(f"{name} = {x:g}" for (_, name), x in nulls)
                raise OwnCodeError(
                    f"{what}: at its null ({null}) it changes {field} by up to {most:.3g} in step {k + 1} in {medium};"
                    " at the null it must change no bit"
                )
            given, memory = (plain.q, plain.v, plain.attached, *first[3:]), same.memory
    rng = np.random.default_rng(1)
    sent = rng.normal(size=(20, active.joints))
    x, y, yaw, power = rng.normal(size=(4, 20))
    seen = SensorReadings(0.02 * np.arange(20), x, y, yaw, sent, power)
    got = plugins.call(f"{what}, command", delivered, np, active, active.null, sent, ch.dt)
    read = plugins.call(f"{what}, measure", active.measure, np, active.null, seen)
    late = [active.delay(np, active.null, clock, seen.t) for clock in CLOCKS]
    pairs = zip((got, *read, *late), (sent, *seen, *[0.0] * len(late)), strict=True)
    if not all(np.array_equal(np.asarray(a) + 0.0 * np.asarray(b), b + 0.0 * np.asarray(a)) for a, b in pairs):
        raise OwnCodeError(f"{what}: at its null it changes commands, readings or delays; at the null it must change no bit")


def _finite(active: EffectStack, what: str) -> None:
    """Checks that at typical sizes and at both bounds a step stays finite, and that the larger typical size changes something."""
    _, _, given = _fish()
    (effect,), memory = active.effects, list(active.memory)
    memory[:2] = 3.0, 600.0  # A, current of the servos; s, ten minutes into a session
    for where, size in _sizes(effect.parameters):
        with np.errstate(all="ignore"):
            found = _step(active, what, given, size, memory)
        if not all(np.isfinite(value).all() for value in (*found.q, *found.v, found.attached, found.power, *found.memory)):
            values = ", ".join(f"{p.name} = {x:g}" for p, x in zip(effect.parameters, size, strict=True))
            raise OwnCodeError(f"{what}: at {where} ({values}) a step is not finite; correct the formula or narrow the bounds")
    if set(effect.sites) - {"measure", "command"} and not _shows(active, what, given, _sizes(effect.parameters)[1][1], memory):
        raise OwnCodeError(f"{what}: at its larger typical size it changes nothing; does the function use the parameter?")


def _shows(active: EffectStack, what: str, given, size, memory) -> bool:
    """Returns True if the effect changes a result within STEPS steps; velocities reverse after each, for effects on braking."""
    ch, sw, first = _fish()
    for _ in range(STEPS):
        plain, strong = planar_chain.step(np, ch, sw, *given), _step(active, what, given, size, memory)
        if _changes(strong, plain):
            return True
        given, memory = (strong.q, [-v for v in strong.v], strong.attached, *first[3:]), strong.memory
    return False


def _sizes(parameters: tuple[Parameter, ...]) -> list[tuple[str, list[float]]]:
    """Parameter rows at which an effect is tested."""
    row = lambda pick: [float(pick(p)) for p in parameters]
    typical = [
        ("its smaller typical size", row(lambda p: p.typical[0])),
        ("its larger typical size", row(lambda p: p.typical[1])),
    ]
    return [*typical, ("its lower bounds", row(lambda p: p.low)), ("its upper bounds", row(lambda p: p.high))]


def _traced(active: EffectStack, what: str) -> None:
    """Checks that JAX can trace a step, and that the code generator knows all its operations."""
    import jax.numpy as jnp

    from fishmj.engines import codegen

    ch, sw, _ = _fish()
    several = lambda letter, n: [f"{letter}{i}" for i in range(n)]
    names = [several("q", ch.n + 2), several("w", ch.n + 2), "a", several("c", ch.n - 1)]
    names += [several("p", len(active.null)), several("m", len(active.memory))]

    def take(values):
        q, v, attached, target, parameters, memory = values
        hooks = Effects(jnp, active, parameters, memory)
        target = [hooks.session.command(j, value, ch.dt) for j, value in enumerate(target)]
        s = planar_chain.step(jnp, ch, sw, q, v, attached, target, [(0.1, 0.0)] * ch.n, (0.0, 0.0), hooks)
        return [*s.q, *s.v, s.attached, s.power, *s.memory]

    plugins.call(f"{what}: compiled engines cannot trace it; use xp, arithmetic and xp.where", codegen.trace, take, names)
