"""Advice on an effect of an implausible size: another record of the same kind would show the same."""

from collections.abc import Iterable

from fishmj.effects.effect import Effect
from fishmj.gap.wording import title

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
