"""Sessions of the three generators: described robot, hidden effects of random size, and logs.

    made = draw_session("pinocchio", "arm", ("coulomb_friction",), seed=7, logs=4, seconds=4.5)
    made.plan, made.hidden, made.logs, made.visible

A seed gives the same session on every machine. An invisible effect is redrawn at another site and 1.8 times as large,
at most five times. A robot that an effect does not fit is redrawn, too.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fishmj.gap.laboratory.articulated import hidden_faults
from fishmj.gap.laboratory.articulated.bam_servo import LAWS, BamServo, servos
from fishmj.gap.laboratory.articulated.flown_faults import FLOWN, FLOWN_OUTSIDE, draw_flown
from fishmj.gap.laboratory.articulated.flown_plant import FlownMujoco, FlownPinocchio
from fishmj.gap.laboratory.articulated.flown_stand import (
    FlownStand,
    draw_flown_stand,
    flown_session,
    flown_visibility,
    usual_flight,
)
from fishmj.gap.laboratory.articulated.hidden_faults import FAULTS, OUTSIDE, Hidden, UsualMotion, draw_hidden, placed
from fishmj.gap.laboratory.articulated.mujoco_plant import BamPlant, MujocoPlant
from fishmj.gap.laboratory.articulated.pinocchio_plant import PinocchioPlant
from fishmj.gap.laboratory.articulated.robot_plan import GRAVITY, QUADROTOR, RobotPlan, draw_plan, joint
from fishmj.gap.laboratory.articulated.robot_stand import Stand, draw_stand, session, usual_motion, visibility

MUJOCO, PINOCCHIO, BAM = "mujoco", "pinocchio", "bam"
NAMES = (MUJOCO, PINOCCHIO, BAM)
SEEN = 5.0  # mean square above which an effect is visible
DRAWS, GROWTH = 6, 1.8  # draws of size and site until an effect is visible; growth per draw
CALM = 0.055  # s, largest swing over no-load speed, so that a healthy servo has spare voltage
PLANS = 60  # most draws of a robot until one fits
SMALL = ("pendulum", "two_link")  # that a hobby servo moves
OF_SERVOS = (
    *("coulomb_friction", "viscous_friction", "rotor_inertia", "stribeck", "load_friction", "torque_offset", "servo_gain"),
    *("payload", "com_offset", "command_latency", "command_hold", "joint_zero_offset", "command_quantisation", "packet_loss"),
)
OUTSIDE_OF_SERVOS = ("cable_torque", "vibration")


class RobotSession(NamedTuple):
    """Described robot with logs of the true one. visible: mean square of each hidden effect alone, by its name."""

    plan: RobotPlan
    hidden: dict[str, dict[str, float]]
    stand: Stand | FlownStand
    logs: list[Any]  # LogRun or FlownLog
    visible: dict[str, float]
    servo: str  # of BAM, with its law; "" for other generators


def able(generator: str, outside: bool = False, family: str = "") -> tuple[str, ...]:
    """Effects, or faults outside every catalogue, that a generator can hide in a robot of a family."""
    if family == QUADROTOR:
        return FLOWN_OUTSIDE if outside else tuple(name for name in FLOWN if name not in FLOWN_OUTSIDE)
    if generator == BAM:
        return OUTSIDE_OF_SERVOS if outside else OF_SERVOS
    known = tuple(name for name in FAULTS if name not in OUTSIDE)
    if generator == PINOCCHIO:
        known = tuple(name for name in known if name not in hidden_faults.ONLY_MUJOCO)
    return OUTSIDE if outside else known


def draw_session(generator: str, family: str, names: Sequence[str], seed: int, logs: int, seconds: float) -> RobotSession:
    """Session with the effects `names` hidden in it. Raises FloatingPointError: every drawn robot ran away, or none fits."""
    for attempt in range(PLANS):
        rng = np.random.default_rng([seed, 41, attempt])
        if family == QUADROTOR:
            try:
                return _flown(generator, draw_plan(family, rng), names, seed + attempt, rng, logs, seconds)
            except FloatingPointError:
                continue
        if generator == BAM:
            made = _servo_robot(family, names, rng)
        else:
            plan = draw_plan(family, rng)
            made = (plan, "", {}, {}) if all(hidden_faults.fits(name, plan) for name in names) else None
        if made is None:
            continue
        try:
            return _drawn(generator, made, names, seed + attempt, rng, logs, seconds)
        except FloatingPointError:
            continue
    raise FloatingPointError(f"none of {PLANS} robots of {family} takes {', '.join(names)}")


def _drawn(generator: str, made: tuple, names: Sequence[str], seed: int, rng, logs: int, seconds: float) -> RobotSession:
    plan, servo, law, own = made
    stand = draw_stand(rng, logs, seconds)
    usual = usual_motion(plan, seed, stand)
    seen = lambda one: visibility_of(generator, plan, one, law, stand, usual, seed)
    hidden, visible = _hide(names, lambda name, strength: draw_hidden(name, rng, plan, usual, strength), seen, own)
    build = builder(generator, law)
    return RobotSession(plan, hidden, stand, session(build, plan, hidden, stand, usual, seed), visible, servo)


def _hide(names: Sequence[str], draw: Callable, seen: Callable, own: Hidden) -> tuple[dict, dict]:
    """Draws effects, larger ones until visible. Returns ({name@site: values}, {name@site: visibility}).

    own: constants of a servo, which are not drawn.
    """
    hidden: dict[str, Mapping[str, float]] = {}
    visible: dict[str, float] = {}
    for name in names:
        fixed = {key: values for key, values in own.items() if placed(key)[0] == name}
        for attempt in range(1 if fixed else DRAWS):
            one = fixed or draw(name, GROWTH**attempt)
            size = seen(one)
            if size > SEEN:
                break
        hidden |= one
        visible |= dict.fromkeys(one, size)
    return hidden, visible


def _flown(generator: str, plan: RobotPlan, names: Sequence[str], seed: int, rng, logs: int, seconds: float) -> RobotSession:
    stand = draw_flown_stand(rng, logs, seconds)
    usual = usual_flight(plan, seed, stand)
    build = FlownPinocchio if generator == PINOCCHIO else FlownMujoco
    few = stand._replace(logs=min(2, logs))
    seen = lambda one: flown_visibility(build, plan, few, usual, seed, flown_session(build, plan, one, few, usual, seed))
    hidden, visible = _hide(names, lambda name, strength: draw_flown(name, rng, plan, usual, strength), seen, {})
    return RobotSession(plan, hidden, stand, flown_session(build, plan, hidden, stand, usual, seed), visible, "")


def visibility_of(generator: str, plan: RobotPlan, one: Hidden, law: dict, stand: Stand, usual: UsualMotion, seed: int) -> float:
    """Mean square of one effect alone, from at most two logs."""
    build = builder(generator, law)
    few = stand._replace(logs=min(2, stand.logs))
    return visibility(build, plan, one, few, usual, seed, session(build, plan, one, few, usual, seed))


def builder(generator: str, law: dict[str, dict[str, float]]) -> Any:
    """Function (plan, hidden) -> plant. law: a servo's constants by effect."""
    if generator == MUJOCO:
        return MujocoPlant
    if generator == PINOCCHIO:
        return PinocchioPlant

    def plant(plan: RobotPlan, present: Hidden) -> BamPlant:
        return BamPlant(plan, present, {k: law[effect] for effect, k in map(placed, present) if effect in law})

    return plant


# ------------------------------------------------------------------------------------------------------------------------- servos
def _servo_robot(family: str, names: Sequence[str], rng) -> tuple | None:
    """(robot with servos, their name and law, constants of the hidden law by effect, effects with the servo's own values)."""
    plan = draw_plan(family if family in SMALL else SMALL[int(rng.integers(2))], rng)
    if any(FAULTS[name].coupled for name in names if name in FAULTS) and len(plan.limbs) < 2:
        return None
    servo = str(rng.choice(list(servos())))
    numbers = LAWS[next((name for name in names if name in LAWS), "")]
    number = str(rng.choice(numbers))
    kind = servos()[servo]
    constants = kind.laws[number]
    plan = carrying(plan, kind, constants, rng)
    at = int(rng.integers(len(plan.limbs)))
    law, own = {}, {}
    for name in names:
        if name in LAWS:
            law[name] = {k: v for k, v in constants.items() if k not in ("k_t", "r", "armature", "base", "viscous")}
            own[f"{name}@{joint(at)}"] = _as_parameters(name, constants)
        field, key, value = {
            "coulomb_friction": ("friction", "torque", constants["base"]),
            "viscous_friction": ("damping", "damping", constants["viscous"]),
            "rotor_inertia": ("armature", "inertia", constants["armature"]),
        }.get(name, ("", "", 0.0))
        if field:  # absent from the description
            plan = plan.changed(at, **{field: 0.0})
            own[f"{name}@{joint(at)}"] = {key: value}
    return plan, f"{servo} {number}", law, own


def _as_parameters(name: str, constants: Mapping[str, float]) -> dict[str, float]:
    """Values of a servo's law under the names of the catalogue.

    Load friction of the catalogue is a share of the motor's torque. In slow motion the external torque is its opposite, so that
    M3's share of their difference counts twice, and the shares of M5 and M6 add up.
    """
    if name == "stribeck":
        return {"torque": constants["stribeck"], "speed": constants["speed"]}
    if "load" in constants:
        return {"ratio": 2.0 * constants["load"]}
    return {"ratio": sum(constants[key] for key in ("motor", "external", "motor_stribeck", "external_stribeck"))}


def carrying(plan: RobotPlan, kind: BamServo, constants: Mapping[str, float], rng) -> RobotPlan:
    """Puts a servo at each joint, and makes the links as heavy as the servos can move."""
    stall = kind.volts * kind.duty * constants["k_t"] / constants["r"]
    size = 1.0 if stall > 2.0 else 0.35  # scale of the links
    reach_of = CALM * kind.volts * kind.duty / constants["k_t"]
    limbs = []
    for k, b in enumerate(plan.limbs):
        centre = tuple(size * x for x in b.centre)
        reach = float(np.linalg.norm(centre)) * (1.0 if len(plan.limbs) == 1 else 2.5 - 1.5 * k)
        mass = float(rng.uniform(0.08, 0.25)) * stall / (GRAVITY * reach) / (1.0 if len(plan.limbs) == 1 else 1.5 + k)
        inertia = tuple(x * size**2 * mass / b.mass for x in b.inertia)
        limbs.append(
            b._replace(
                place=tuple(size * x for x in b.place),
                centre=centre,
                mass=mass,
                inertia=inertia,
                armature=constants["armature"],
                friction=constants["base"],
                damping=constants["viscous"],
                kp=kind.stiffness * kind.volts * constants["k_t"] / constants["r"],
                kv=constants["k_t"] ** 2 / constants["r"],
                limit=stall,
                swing=(b.swing[0], min(b.swing[1], reach_of)),
                gear=1.0,
            )
        )
    return plan._replace(limbs=tuple(limbs), torques=False)
