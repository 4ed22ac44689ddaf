"""Open parameters of a description in MJCF, as places in a parameter row of `RigidRobot`.

Priors: the tolerance of masses, inertias and centres (data/calib/robot.toml); for the others the wide prior of the search.
"""

from collections.abc import Sequence
from typing import NamedTuple

from fishmj import effects
from fishmj.effects.effect import Effect
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.search.fit import bounds
from fishmj.gap.thresholds import thresholds

# kind -> (effects of the catalogue, constants of the model) that represent it
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "friction": (("coulomb_friction",), ()),
    "damping": (("viscous_friction",), ()),
    "armature": (("rotor_inertia",), ()),
    "gain": (("servo_gain", "servo_damping_gain"), ()),
    "delay": (("command_latency",), ()),
    "bodies": ((), ("mass", "inertia", "centre")),
}
STATED = {"coulomb_friction": "dof_frictionloss", "viscous_friction": "dof_damping", "rotor_inertia": "dof_armature"}
FACTORS = ("servo_gain", "servo_damping_gain")


class OpenNumber(NamedTuple):
    """One parameter. place: in the row; start: its value there by the description. base: to add to the row's entry for SI.

    step: for derivatives; low, high: bounds of the row's entry; sigma: of the prior. is_factor: a factor on a body's property.
    """

    place: int
    name: str
    unit: str
    base: float
    start: float
    step: float
    low: float
    high: float
    sigma: float
    is_factor: bool


def effects_of(kinds: Sequence[str]) -> list[Effect]:
    """Effects that hold the numbers of some kinds."""
    return [effects.robot_catalogue()[name] for kind in kinds for name in KINDS[kind][0]]


def free_numbers(model: RigidRobot, kinds: Sequence[str]) -> list[OpenNumber]:
    """The numbers of some kinds, in a model with `effects_of(kinds)`."""
    constants = {name for kind in kinds for name in KINDS[kind][1]}
    limits = thresholds().fit
    low, high, size = (part.tolist() for part in bounds(model))
    out = []
    for place, c in enumerate(model.constants):
        if effects.kind_of(c.name) in constants:
            out.append(OpenNumber(place, c.name, "1", 0.0, 1.0, limits.difference_step, low[place], high[place], c.sigma, True))
    for effect in model.active.effects:
        base = stated(model, effect.name)
        for p in effect.parameters:
            place = model.index(effect.name, p.name)
            lowest = low[place] if effects.kind_of(effect.name) in FACTORS else -base
            step, sigma = limits.difference_step * size[place], limits.prior_sd * size[place]
            out.append(OpenNumber(place, effect.name, p.unit, base, p.null, step, lowest, high[place], sigma, False))
    return out


def stated(model: RigidRobot, name: str) -> float:
    """The description's own value of an effect's number; a gain is a factor, 1."""
    kind, site = effects.kind_of(name), effects.site_of(name)
    if kind in FACTORS:
        return 1.0
    if kind not in STATED:
        return float(model.robot.delays.min(initial=0.0)) if kind == "command_latency" else 0.0
    joint = next(j for j in model.robot.joints if j.name == site)
    return float(getattr(model.robot.model, STATED[kind])[joint.dof])
