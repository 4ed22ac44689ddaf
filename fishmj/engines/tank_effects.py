"""Support of a description's effects in the flow solver's tanks; `tank_run` applies the supported ones.

    servo, gear, command    drive, torque and damping of each joint, in place of MuJoCo's servo
    fish                    masses of the links; gains and limits of the servos
    body                    forces and masses that are not the water's, such as a tether
    flow                    a velocity that is uniform and steady is added to the tank's stream
    delays, measure         applied by the caller that sends commands and reads sensors, as for every engine

The solver computes the water's forces, so effects on strips, added mass or water forces are not supported. `in_tank` finds out by
calling the effect's functions at their sites, also for the user's own effects.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import Effect
from fishmj.effects.sites import BodyMotion, Constants, FlowAt, Gear
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain

WATER = "which the solver replaces"
SOLID = {"chain": ("com", "inertia", "mass", "torque", "motor"), "swimmer": ("mass", "kp", "kv", "kb", "zero")}  # what may change
FORCES = ("fx", "fy", "n", "mx", "my", "mn")
OF_THE_WATER = ("u", "w", "tail", "sway_mass", "drag", "wet", "added")  # fields of a BodyMotion that depend on the water
STATES = 50  # random states at which an effect is tested


def in_tank(effect: Effect) -> str:
    """Reason for which an effect is not supported in the flow solver's tanks; "" if it is supported."""
    if effect.stochastic:
        return "it is stochastic, and simulators do not support it"
    if effect.water is not None:
        return f"it changes the forces of strips, {WATER}"
    for row in _sizes(effect):
        for site, judge in (("fish", _fish), ("body", _body), ("gear", _gear), ("flow", _flow)):
            act = getattr(effect, site)
            with np.errstate(all="ignore"):  # extreme parameters at random states may overflow
                why = "" if act is None else judge(act, effect.memory, row)
            if why:
                return why
    return ""


def refused(robot: Robot) -> dict[str, str]:
    """Unsupported effects of the robot in a tank: {name: reason}."""
    found = {fitted.name: in_tank(effects.get(fitted.name)) for fitted in robot.effects}
    return {name: why for name, why in found.items() if why}


def without(robot: Robot, names: Iterable[str]) -> Robot:
    """Robot without these effects. Raises UnknownName if it has no such effect."""
    have, names = [fitted.name for fitted in robot.effects], tuple(names)
    if wrong := [name for name in names if name not in have]:
        raise UnknownName(f"effect of {robot.name} to leave out", wrong[0], have)
    return replace(robot, effects=tuple(fitted for fitted in robot.effects if fitted.name not in names))


def check_effects(robot: Robot) -> None:
    """Raises ConfigError if a tank does not support all effects of the robot; names each, with reason and remedy."""
    if found := refused(robot):
        each = "; ".join(f"{name}: {why}" for name, why in found.items())
        raise ConfigError(
            f"{robot.name} in the flow solver: {each}. Evaluate without: fishmj evaluate --leave-out {','.join(found)}; elsewhere"
            " take those blocks [[effect]] out of the description"
        )


def _sizes(effect: Effect) -> list[SimpleNamespace]:
    """Parameter values at which an effect is tested: both typical sizes and both bounds."""
    robot = effects.RobotScales()
    picks = (lambda p: p.typical[0], lambda p: p.typical[1], lambda p: p.low, lambda p: p.high)
    return [SimpleNamespace(**{p.name: float(pick(p)) for p in effect.parameters}, joint=0, robot=robot) for pick in picks]


def _fish(act: Callable, memory: tuple, p) -> str:
    robot = load_robot("fish")
    given = Constants(planar_chain.chain_of(robot), planar_chain.nominal(robot))
    found = act(np, p, given)
    for group, free in SOLID.items():
        before, after = getattr(given, group), getattr(found, group)
        changed = [name for name in before._fields if not _same(getattr(before, name), getattr(after, name))]
        if "water" in changed:
            return f"it changes coefficients of strips, {WATER}"
        if other := [name for name in changed if name not in free]:
            return f"it changes {', '.join(other)} of the {group}, but a tank uses the hull of the description"
    return ""


def _body(act: Callable, memory: tuple, p) -> str:
    """Reason if the effect at the site `body` depends on the water or changes added mass; "" otherwise."""
    rng = np.random.default_rng(0)
    state = {name: rng.normal(size=STATES) for name in BodyMotion._fields} | dict.fromkeys((*FORCES, "added"), 0.0)
    ask = lambda **water: act(np, p, BodyMotion(**{**state, **water}), memory, 0.004)[0]
    dry = ask(**dict.fromkeys(OF_THE_WATER, 0.0))
    if not _same(dry.added, 0.0):
        return f"it changes added mass, {WATER}"
    for _ in range(3):
        wet = ask(**{name: rng.normal(size=STATES) for name in OF_THE_WATER} | {"wet": 1.0, "added": 0.0})
        if not all(_same(getattr(dry, name), getattr(wet, name)) for name in FORCES) or not _same(wet.added, 0.0):
            return f"it is a force or an added mass of the water on the body, {WATER}"
    return ""


def _gear(act: Callable, memory: tuple, p) -> str:
    rng = np.random.default_rng(0)
    state = {name: rng.normal(size=STATES) for name in ("drive", "angle", "rate", "torque")}
    ask = lambda wet: act(np, p, Gear(**state, resist=0.0, wet=wet, kb=0.3, limit=1.6), memory, 0.004)
    (dry, kept), (wet, other) = ask(0.0), ask(1.0)
    return "" if _same((*dry._replace(wet=1.0), *kept), (*wet, *other)) else f"it is a drag of water on the joints, {WATER}"


def _flow(act: Callable, memory: tuple, p) -> str:
    """Reason if the effect adds more than one velocity, independent of place, time and water; "" otherwise."""
    rng = np.random.default_rng(0)
    place = FlowAt(*rng.normal(size=(5, STATES)))
    found = act(np, p, place)
    if all(np.ptp(np.asarray(a) - b) < 1e-9 for a, b in ((found.u, place.u), (found.v, place.v))):
        return ""
    return "its velocity varies in space or time, and a tank supports only a uniform, steady mean stream"


def _same(a, b) -> bool:
    """True for equal numbers, in lists or arrays of any depth."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    return bool(np.all(np.equal(a, b)))
