"""Effects of an implausible size, and advice on them: another record of the same kind would show the same."""

from collections.abc import Iterable
from dataclasses import replace

from fishmj.effects.effect import Effect, site_of
from fishmj.gap.decide.decide import size_parameters
from fishmj.gap.thresholds import thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import quantity, title

OVERSIZED = "implausibly large"

ACTS_ON = {  # numbers of a description by Parameter.of, else by stage
    "torque": "[servo] torque and kp",
    "damping": "[servo] kd, torque and speed_no_load",
    "slowness": "[servo] speed_no_load",
    "resistance": "[servo] voltage, resistance and constant",
    "mass": "mass of each [[link]]",
    "inertia": "mass, com and length of each [[link]]",
    "actuator": "[servo] kp, kd and torque",
    "timing": "[timing] command_latency and camera_latency",
    "inertia_stage": "mass and com of each [[link]]",
    "hydrodynamics": "[water], and sections of each [[link]]",
    "environment": "the current that the logs state",
    "measurement": "the calibration of camera and encoders",
}


def advice(found: Iterable[Effect]) -> str:
    """Sentence on the numbers of the description that the effects act on, which to check before recording again."""
    found = tuple(found)
    of = lambda e: next((p.of for p in e.parameters if p.of in ACTS_ON), "inertia_stage" if e.stage == "inertia" else e.stage)
    numbers = "; ".join(dict.fromkeys(ACTS_ON[of(e)] for e in found))
    names = " and ".join(title(e.name) for e in found)
    return f"Check the numbers that {names} would change: {numbers}. Another record of the same kind would show the same."


def with_oversized(verdict: Verdict, stack) -> Verdict:
    """The verdict with a warning for each implausibly large value of an accepted effect, named or only counted in.

    Only effects on the whole robot count, such as wind and air: typical sizes at a joint differ too much between robots.
    stack: `model.active`, whose effects state typical values.
    """
    if verdict.answer not in ("NAMED", "CLASS"):
        return verdict
    warnings, most = [], thresholds().torques.oversize
    for found in (f for f in (*verdict.effects, *verdict.tentative) if not site_of(f.name)):
        for p in size_parameters(stack.effect(found.name)):
            value, usual = found.parameters[p.name].value, max(abs(t - p.null) for t in p.typical)
            if abs(value - p.null) > most * usual:
                about = f"{title(found.name)}: {title(p.name)} = {quantity(value, p.unit)} is {OVERSIZED}"
                warnings.append(f"{about}, known robots have up to {quantity(usual, p.unit)}")
    return replace(verdict, warnings=(*verdict.warnings, *warnings))
