"""The typed library: admissible products for each force, each as a provisional effect with one coefficient.

    force = c x product      force: surge, sway [N], yaw moment [N m], along x or y of the tank [N], at the tail, along or across
                             it [N], joint torque [N m], a sensor's reading [rad]

Admissible are

    inertial   two rates, c = C rho L^n; and the same times the tail's angle
    viscous    one rate
    static     none: a constant, the angle of the tail, a place in the tank (a pull, a slope)
    aging      a rate squared times the time of the session
    joint      powers of angle and rate, load times rate, and terms with memory: hysteresis, creep
    reading    error of a joint sensor's reading: no force, but equivalent to one for the robot
    log        of a sensor alone: the scale of every joint's angle or of one axis of the camera, slack of the joints' encoders

Parity is +1 even, -1 odd when port and starboard are exchanged. A robot that is its own mirror image has only products of the
force's own parity. The others are kept as *one-sided* terms: they state that port and starboard differ, and must gain more to
rank before a mirror-symmetric one (select.py).

A reading is a curve with one coefficient:

    r = a + c f(a)      r' = (1 + c f'(a)) a'      the servo turns the joint until r, not a, equals the command
    f = a               counts per turn; the first harmonic as far as a joint turns (sin a is a to within 6 % up to 35 degrees)
    f = a^2, a^3        a potentiometer or a linkage with a bent characteristic
    f = sin k a         a magnet off its axis, sine and cosine of unequal size, a field that is no pure sine: k = 2, 3, 4

The faulty sensor determines the log:

    servo reading     the servo's own sensor errs, the log has the joint's angle from another one
    encoder reading   one sensor for both: the log has r
    joint log         neither: the log's own scale is wrong, or its encoder hangs on the joint with play, and the robot moves
                      like its model. Play of half a gap b reads a - b z, z' = clip(z + da / b, +-1); b in z is fixed, so that the
                      coefficient before it is linear
"""

import hashlib
from collections import Counter
from collections.abc import Callable
from functools import cache, reduce
from itertools import combinations_with_replacement
from math import prod
from operator import mul
from typing import NamedTuple

from fishmj import effects
from fishmj.effects.effect import Effect, Parameter
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.thresholds import thresholds
from fishmj.mjcf.description import Robot


class Factor(NamedTuple):
    """One quantity. value: from the array namespace and a `BodyMotion`, `Gear` or `LocalWater`. size: typical, SI."""

    name: str
    value: Callable
    parity: int
    size: float


SURGE = Factor("surge speed", lambda xp, b: b.u, 1, 0.2)
SWAY = Factor("sway speed", lambda xp, b: b.w, -1, 0.06)
YAW = Factor("yaw rate", lambda xp, b: b.r, -1, 0.6)
TAIL = Factor("tail rate", lambda xp, b: b.swing, -1, 4.0)
BEND = Factor("tail angle", lambda xp, b: b.bend, -1, 0.8)
MOTION = (SURGE, SWAY, YAW, TAIL)

ANGLE = Factor("angle", lambda xp, g: g.angle, -1, 0.4)
RATE = Factor("rate", lambda xp, g: g.rate, -1, 2.5)
LOAD = Factor("motor torque", lambda xp, g: g.drive, -1, 0.4)

TURNED = Factor("direction of the last turn", lambda xp, g: xp.sign(g.rate), -1, 1.0)

TIP = thresholds().library.trailing_edge
SLIP = Factor("tail speed sideways", lambda xp, k: k.w[-1] + k.omega[-1] * TIP, -1, 0.3)
AHEAD = Factor("tail speed ahead", lambda xp, k: k.u[-1], 1, 0.2)

X = Factor("place x", lambda xp, b: b.x, 0, 1.0)  # parity 0: the tank has no mirror
Y = Factor("place y", lambda xp, b: b.y, 0, 1.0)
TIME = Factor("session time", lambda xp, b: b.time, 1, 8.0)


def signed(f: Factor) -> Factor:
    """The square with the sign of its root: f |f|."""
    return Factor(f"{f.name} squared, signed", lambda xp, b: f.value(xp, b) * xp.abs(f.value(xp, b)), f.parity, f.size**2)


def product(*factors: Factor) -> Factor:
    """Product of all factors; equal ones are written as a power."""
    words = {1: "", 2: " squared", 3: " cubed"}
    name = " x ".join(name + words[n] for name, n in Counter(f.name for f in factors).items())
    value = lambda xp, b: reduce(mul, (f.value(xp, b) for f in factors))
    return Factor(name, value, prod(f.parity for f in factors), prod(f.size for f in factors))


class ReadingCurve(NamedTuple):
    """Curve f of a reading. value, slope: from the array namespace and the angle [rad]. parity: +1 even. size: typical."""

    name: str
    value: Callable
    slope: Callable
    parity: int
    size: float


def harmonic(k: int) -> ReadingCurve:
    """The sine of k times the angle."""
    return ReadingCurve(f"sine of {k} x angle", lambda xp, a: xp.sin(k * a), lambda xp, a: k * xp.cos(k * a), -1, 0.7)


CURVES = (
    ReadingCurve("angle", lambda xp, a: a, lambda xp, a: 1.0, -1, 0.4),
    ReadingCurve("angle squared", lambda xp, a: a * a, lambda xp, a: 2.0 * a, 1, 0.16),
    ReadingCurve("angle cubed", lambda xp, a: a * a * a, lambda xp, a: 3.0 * a * a, -1, 0.064),
    *(harmonic(k) for k in (2, 3, 4)),
)


def in_the_loop(curve: ReadingCurve) -> dict[str, Callable]:
    """The sites of a servo reading."""

    def servo(xp, p, s, memory, h):
        error = s.error - p.coefficient * curve.value(xp, s.angle)
        return s._replace(error=error, rate=s.rate * (1.0 + p.coefficient * curve.slope(xp, s.angle))), memory

    return {"servo": servo}


def in_the_log_too(curve: ReadingCurve) -> dict[str, Callable]:
    """The sites of an encoder reading."""

    def measure(xp, p, seen):
        if not xp.any(p.coefficient):  # whole records of many fish, nearly all of which have another term
            return seen
        more = xp.expand_dims(p.coefficient + 0.0, -1) * curve.value(xp, seen.joint)
        return seen._replace(joint=seen.joint + more)

    return in_the_loop(curve) | {"measure": measure}


# Force -> (field, parity, usual size) on the body; (parity, usual size) at the tail; direction in the tank.
FORCES = {"surge force": ("fx", 1, 0.05), "sway force": ("fy", -1, 0.1), "yaw moment": ("n", -1, 0.01)}
TAILS = {"force along the tail": (1, 0.05), "force across the tail": (-1, 0.1)}
WORLD = {"force along x": (1.0, 0.0), "force along y": (0.0, 1.0)}
USUAL = thresholds().library
ONE = Factor("constant", lambda xp, b: 1.0, 1, 1.0)
_COMPILED: dict[str, SwimmingFish] = {}  # fingerprint -> the model with the library


@cache
def library() -> tuple[Effect, ...]:
    """All provisional effects."""
    forces = (*body_terms(), *tail_terms(), *world_terms(), *joint_terms(), hysteresis(), creep())
    return (*forces, *reading_terms(), *sensor_terms())


def model_with_terms(robot: Robot) -> SwimmingFish:
    """The swimming fish of `robot` with its listed effects, with every term at its null; compiled once a process."""
    made = SwimmingFish(robot, catalogue=[*library(), *(effects.get(fitted.name) for fitted in robot.effects)])
    return _COMPILED.setdefault(made.fingerprint, made)


def one_sided(effect: Effect) -> bool:
    """Returns True for a term by which port and starboard differ."""
    return effect.about.startswith("one-sided")


def body_terms() -> list[Effect]:
    """Forces on the body, head axes."""
    second = [product(a, b) for a, b in combinations_with_replacement(MOTION, 2)] + [signed(f) for f in MOTION]
    bent = [product(a, b, BEND) for a, b in combinations_with_replacement(MOTION, 2)]
    aging = [product(signed(f), TIME) for f in MOTION] + [product(TAIL, TAIL, TIME)]
    out = []
    for force, (field, parity, size) in FORCES.items():
        for f in (ONE, BEND, *MOTION, *second, *bent, *aging):
            symmetric = f.parity == parity
            if symmetric or f in (ONE, BEND) or f in second:  # one-sided ones up to second order
                out.append(provisional(force, f, size, symmetric, body=_body(field, f)))
    return out


def tail_terms() -> list[Effect]:
    """Forces at the trailing edge, in the axes of the tail."""
    out = []
    for along, (force, (parity, size)) in zip((True, False), TAILS.items(), strict=True):
        second = [product(SLIP, SLIP), signed(SLIP), product(AHEAD, SLIP), signed(AHEAD)]
        for f in (SLIP, AHEAD, *second, product(signed(SLIP), TIME), product(SLIP, SLIP, TIME)):
            out.append(provisional(force, f, size, f.parity == parity, water=_tail(along, f)))
    return out


def world_terms() -> list[Effect]:
    """Forces that belong to the tank: constant ones and slopes."""
    return [
        provisional(force, f, USUAL.pull, True, body=_world(axis, f), stage="environment")
        for force, axis in WORLD.items()
        for f in (ONE, X, Y)
    ]


def joint_terms() -> list[Effect]:
    """Torques that are equal at every joint."""
    even = [ONE, product(ANGLE, ANGLE), product(RATE, RATE), product(ANGLE, RATE)]
    odd = [ANGLE, signed(ANGLE), product(ANGLE, ANGLE, ANGLE), RATE, signed(RATE), product(RATE, RATE, RATE)]
    odd += [product(ANGLE, ANGLE, RATE), product(ANGLE, RATE, RATE), _held(), LOAD, signed(LOAD)]
    return [provisional("joint torque", f, USUAL.torque, f in odd, gear=_gear(f), stage="actuator") for f in (*odd, *even)]


def _held() -> Factor:
    """Direction of motion times load: friction that grows with the gear's load."""
    return Factor("motor torque, against the motion", lambda xp, g: xp.abs(g.drive) * g.rate / (xp.abs(g.rate) + 0.2), -1, 0.4)


def hysteresis() -> Effect:
    """Rate-independent hysteresis (Bouc-Wen with power 2, yielding at 0.1 rad)."""

    def gear(xp, p, g, memory, h):
        (z,) = memory
        turning = g.rate * z
        z = z + h * g.rate * (1.0 - z * z / 0.01 * xp.where(turning > 0.0, 1.0, 0.0))
        return g._replace(torque=g.torque + p.coefficient * z / 0.1), (z,)

    memory = Factor("hysteresis of the angle", lambda xp, g: g.angle, -1, 1.0)
    return provisional("joint torque", memory, USUAL.torque, True, gear=gear, memory=(0.0,), stage="actuator")


def creep() -> Effect:
    """A spring whose rest angle follows within half a second."""

    def gear(xp, p, g, memory, h):
        (rest,) = memory
        rest = rest + (g.angle - rest) * (h / 0.5)
        return g._replace(torque=g.torque + p.coefficient * (g.angle - rest)), (rest,)

    memory = Factor("creep of the angle", lambda xp, g: g.angle, -1, 0.4)
    return provisional("joint torque", memory, USUAL.torque, True, gear=gear, memory=(0.0,), stage="actuator")


def reading_terms() -> list[Effect]:
    """Reading errors that are equal at every joint's sensor, in the servo's loop, and in the log too."""
    return [
        provisional(reading, f, USUAL.reading, f.parity < 0, stage="measurement", **sites(f))
        for reading, sites in (("servo reading", in_the_loop), ("encoder reading", in_the_log_too))
        for f in CURVES
    ]


@cache
def sensor_terms() -> tuple[Effect, ...]:
    """Scales of the joints' log and of each axis of the camera, and the slack of the joints' encoders."""
    made = (
        ("joint log", ANGLE, _scaled("joint")),
        ("joint log", TURNED, _slack),
        ("camera along x", X, _scaled("x")),
        ("camera along y", Y, _scaled("y")),
    )
    return tuple(provisional(sensor, f, USUAL.reading, True, stage="measurement", measure=site) for sensor, f, site in made)


def provisional(
    force: str, f: Factor | ReadingCurve, size: float, symmetric: bool, stage: str = "hydrodynamics", **site
) -> Effect:
    """The effect of one term, named X- and a hash of its name."""
    formula = f"{force} ~ {f.name}"
    usual = size / f.size
    bound = USUAL.bound * usual
    unit = "rad" if stage == "measurement" else "N m" if force in ("yaw moment", "joint torque") else "N"
    unit += " per SI unit of the product"
    return Effect(
        name=f"X-{hashlib.sha256(formula.encode()).hexdigest()[:8]}",
        stage=stage,
        about="mirror-symmetric" if symmetric else "one-sided: port and starboard differ",
        formula=formula,
        source="none: a term of the typed library",
        parameters=(Parameter(name="coefficient", unit=unit, low=-bound, high=bound, typical=(0.1 * usual, usual)),),
        shows=("joint",) if {"gear", "servo"} & set(site) else ("position", "heading"),
        **site,
    )


def _scaled(field: str):
    def measure(xp, p, seen):
        if not xp.any(p.coefficient):  # as of a reading
            return seen
        read = getattr(seen, field)
        scale = 1.0 + p.coefficient
        return seen._replace(**{field: read * (xp.expand_dims(scale + 0.0, -1) if field == "joint" else scale)})

    return measure


def _slack(xp, p, seen):
    """Applies the encoder's slack: it stays behind at every reversal, a - c z (see above)."""
    if seen.joint.shape[-2] < 2 or not xp.any(p.coefficient):
        return seen
    z = [xp.zeros_like(seen.joint[..., 0, :])]
    for turn in xp.moveaxis(xp.diff(seen.joint, axis=-2), -2, 0) / USUAL.slack:
        z.append(xp.clip(z[-1] + turn, -1.0, 1.0))
    return seen._replace(joint=seen.joint - xp.expand_dims(p.coefficient + 0.0, -1) * xp.stack(z, -2))


def _body(field: str, f: Factor):
    def body(xp, p, b, memory, h):
        return b._replace(**{field: getattr(b, field) + b.wet * p.coefficient * f.value(xp, b)}), memory

    return body


def _world(axis: tuple[float, float], f: Factor):
    ax, ay = axis

    def body(xp, p, b, memory, h):
        force = p.coefficient * f.value(xp, b)
        c = xp.cos(b.heading)
        s = xp.sin(b.heading)
        return b._replace(fx=b.fx + force * (c * ax + s * ay), fy=b.fy + force * (c * ay - s * ax)), memory

    return body


def _tail(along: bool, f: Factor):
    def water(xp, p, k, memory, h):
        force = p.coefficient * f.value(xp, k)
        ft, fn, moment = k.forces[-1]
        last = (ft + force, fn, moment) if along else (ft, fn + force, moment + force * TIP)
        return k._replace(forces=[*k.forces[:-1], last]), memory

    return water


def _gear(f: Factor):
    def gear(xp, p, g, memory, h):
        return g._replace(torque=g.torque + p.coefficient * f.value(xp, g)), memory

    return gear
