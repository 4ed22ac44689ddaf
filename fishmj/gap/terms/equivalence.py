"""Is a term an effect's own formula? Then it says nothing against the effect.

Alike are what both do in states drawn at random: the push on a body that swims ahead (surge force, sway force, yaw moment over a
body length), the torque on a joint, or where a joint comes to rest and what the log says of it. -Y |u| w is a sway force ~ surge
speed x sway speed, whatever either does astern; a damping is a joint torque ~ rate; a command's gain a servo reading ~ angle.
"""

from types import SimpleNamespace

import numpy as np

from fishmj.effects.effect import Effect
from fishmj.effects.sites import BodyMotion, Gear, Measured, ServoDrive
from fishmj.gap.terms.regressors import ANGLE, BEND, LOAD, RATE, SURGE, SWAY, TAIL, YAW, Factor
from fishmj.gap.thresholds import thresholds

LIMITS = thresholds().equivalence


def is_own_formula(effect: Effect, term: Effect) -> bool:
    """Whether a term is the effect's own formula; only of effects that push the body, turn a joint or move its rest, and that
    remember nothing."""
    if effect.memory or term.memory:
        return False
    pairs = [(does(effect), does(term)) for does in (pushes, torques, rests)]
    return any(bool(abs(a @ b) > LIMITS.cosine * np.linalg.norm(a) * np.linalg.norm(b) > 0.0) for a, b in pairs)


def pushes(effect: Effect) -> np.ndarray:
    """(3 n,) over n random states of an effect at its usual size; zero of one that does not push."""
    if effect.body is None:
        return np.zeros(3 * LIMITS.states)
    u, w, r, swing, bend = drawn(SURGE, SWAY, YAW, TAIL, BEND)
    still = dict.fromkeys(BodyMotion._fields, 0.0) | {"sway_mass": 1.0, "drag": 1.0, "wet": 1.0, "added": 1.0}
    state = BodyMotion(**still | {"u": np.abs(u), "w": w, "r": r, "swing": swing, "bend": bend})
    pushed, _ = effect.body(np, usual(effect), state, effect.memory, LIMITS.step)
    return np.concatenate([np.broadcast_to(x, LIMITS.states) for x in (pushed.fx, pushed.fy, pushed.n / LIMITS.length)])


def torques(effect: Effect) -> np.ndarray:
    """(n,) of an effect at its usual size on a joint; zero of one that is in no gear."""
    if effect.gear is None:
        return np.zeros(LIMITS.states)
    angle, rate, drive = drawn(ANGLE, RATE, LOAD)
    state = Gear(drive, angle, rate, torque=0.0, resist=0.0, wet=1.0, kb=0.1, limit=1.6)
    turned, _ = effect.gear(np, usual(effect), state, effect.memory, LIMITS.step)
    return np.broadcast_to(turned.torque - turned.resist * rate + turned.drive - drive, LIMITS.states)


def rests(effect: Effect) -> np.ndarray:
    """(2 n,) by how much a joint comes to rest off its command with an effect at its usual size, and the log off both."""
    (asked,) = drawn(ANGLE)
    values = usual(effect)
    shift = np.zeros(LIMITS.states)
    reading = asked
    if effect.command is not None:
        shift = effect.command(np, values, asked, effect.memory, LIMITS.step)[0] - asked
    if effect.servo is not None:
        state = ServoDrive(shift, asked, rate=0.0, kp=1.0, kv=0.0, kb=0.1, limit=1.6, current=0.0, time=0.0)
        shift = effect.servo(np, values, state, effect.memory, LIMITS.step)[0].error
    if effect.measure is not None:
        still = dict.fromkeys(Measured._fields, np.zeros(LIMITS.states))
        reading = effect.measure(np, values, Measured(**still | {"joint": asked[:, None]})).joint[:, 0]
    return np.concatenate([np.broadcast_to(x, LIMITS.states) for x in (shift, shift + reading - asked)])


def drawn(*factors: Factor) -> np.ndarray:
    """(len(factors), n) values of their usual size."""
    return np.random.default_rng(0).standard_normal((len(factors), LIMITS.states)) * np.array([[f.size] for f in factors])


def usual(effect: Effect) -> SimpleNamespace:
    """The parameters at their usual size."""
    return SimpleNamespace(**{p.name: p.null if p.shape else p.probe for p in effect.parameters}, joint=0)
