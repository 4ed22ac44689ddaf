"""Play in the gears; the encoder sits on the output side, behind the play."""

from math import copysign

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """The motor crosses the gap x at its no-load speed, drive / k_b, and turns the link for the rest of the step:
    x' = clip(x + h (drive / k_b - w), +-b), share = (clipped part) / (whole distance).
    """
    (x,) = memory
    way = h * (g.drive / g.kb - g.rate)
    taken = xp.minimum(xp.maximum(x + way, -p.half_gap), p.half_gap)
    whole = xp.abs(x + way - x)
    share = xp.where(whole > 0.0, xp.abs(x + way - taken) / xp.where(whole > 0.0, whole, 1.0), 1.0)
    share = xp.minimum(share, 1.0)
    return g._replace(drive=share * g.drive, resist=g.resist - (1.0 - share) * g.kb), (taken,)


def law(joint, memory, half_gap, rotor):
    """A rotor, of its inertia on the link's side, flies through the gap x and gives its momentum to the link where it lands.

    The joint's damping and armature are the rotor's. It lies on the side to which it pushes at the start. Where it lands within a
    step, the momentum's later part goes into the next one. memory: x, the rotor's rate, the link's a step ago, that part [N m].
    """
    if joint.time == 0.0:
        memory[0] = copysign(half_gap, joint.drive - joint.damping * joint.rate)
        memory[1], memory[2], memory[3] = joint.rate, joint.rate, 0.0
    gained, memory[2] = joint.rate - memory[2], joint.rate
    late, memory[3] = memory[3], 0.0
    floats = abs(memory[0]) < half_gap
    slows = 1.0 + joint.step * joint.damping / rotor
    ahead = (memory[1] + joint.step * joint.drive / rotor) / slows
    way = memory[0] + joint.step * (ahead - joint.rate)
    alone = joint.damping * joint.rate - joint.drive + min(rotor, joint.armature) * gained / joint.step
    if abs(way) < half_gap:
        memory[0], memory[1] = way, ahead
        return alone + late, 0.0
    edge = copysign(half_gap, way)
    if not floats:
        memory[0], memory[1] = edge, joint.rate
        return late, 0.0
    share = (edge - memory[0]) / (way - memory[0])
    blow = rotor * (memory[1] + share * (ahead - memory[1]) - joint.rate) / joint.step
    memory[0], memory[1], memory[3] = edge, ahead, share * blow
    return share * alone + (1.0 - share) * blow + late, 0.0


EFFECT = Effect(
    name="gear_backlash",
    stage="actuator",
    about="the link floats in a gap at each reversal until the motor has taken it up; the encoder sees the link",
    formula="x' = clip(x + h (drive/k_b - w), +-b); torque reaches the link only at the ends of the gap",
    source="play operator with memory; small gear trains have 0.3 to 2 deg",
    parameters=(Parameter(name="half_gap", unit="rad", low=0.0, high=0.2, typical=(0.005, 0.035)),),
    shows=("joint", "power"),
    native="a second hinge with a range of +-b behind the motor's",
    confusions=(
        Confusion(
            "command_latency",
            "lost motion at reversals only; a delay acts all the time and also on the first move",
            ("slow_triangle", "chirp"),
        ),
        Confusion(
            "servo_deadband", "a gap holds no position at rest and shrinks under one-sided load", ("hold_angles", "staircase")
        ),
    ),
    memory=(0.0,),
    gear=gear,
    robot=RobotForm(
        site="actuator",
        scale=("", "inertia"),
        parameters=(
            Parameter(name="half_gap", unit="rad", low=0.0, high=0.2, typical=(0.003, 0.03)),
            Parameter(name="rotor", unit="kg m2", null=0.1, low=0.005, high=1.0, typical=(0.03, 0.4), shape=True),
        ),
        law=law,
        confusions=(
            Confusion("command_latency", "lost motion at reversals only; a delay acts all the time"),
            Confusion("servo_gain", "lost motion at reversals only: drive one way against a load"),
        ),
    ),
)
