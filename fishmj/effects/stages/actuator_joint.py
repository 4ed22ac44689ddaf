"""Effects of the stage `actuator` between motor and link: friction, play, springs, rotor."""

from math import copysign, exp

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

GIVE = 0.001  # rad, b, a quarter of a servo's encoder count
AT_REST = (0.0, 0.0)  # z rad, w rad/s of the step before


def apply_dry_friction(xp, friction, g, memory, h: float):
    """(Gear, memory) of one joint with dry friction that sticks, shared by the effects of gear trains.

        z <- clip(z + h w, +-b)              deflection of the teeth before they slide
        s = (z + h w - z) / h                sliding speed; zero while the teeth only deflect
        tau = -F(s)/b (z~ + h w'),           z~ = clip(z + h w, +-b) - h w, w' the rate after the step: at most F, and too
                                             little to reverse the motion
        tau = -F(s) w'/|w~|                  if a step moves further than b; w~ the larger of w and w + (w - w_before), the
                                             expected w' while a joint breaks away

    A joint at rest stays there until the motor overcomes F. A friction that grows with speed near rest would instead let a
    loaded joint creep back within seconds. (Jenkins' slider; presliding of Dahl 1968, DOI 10.21236/ADA041920.)

    friction(s): the largest friction torque [N m] at a sliding speed s [rad/s].
    """
    clip = lambda way: xp.minimum(xp.maximum(way, -GIVE), GIVE)
    z, before = memory
    way = z + h * g.rate
    z = clip(way)
    most = friction((way - z) / h)
    ahead = 2.0 * g.rate - before
    far = h * xp.maximum(xp.abs(g.rate), xp.where(ahead * g.rate > 0.0, xp.abs(ahead), 0.0))
    spring = xp.where(far > GIVE, 0.0, clip(z + h * g.rate) - h * g.rate) / GIVE
    g = g._replace(torque=g.torque - most * spring, resist=g.resist + most * h / xp.maximum(far, GIVE))
    return g, (z, g.rate)


def coulomb_friction_gear(xp, p, g, memory, h):
    """Friction of at most F_c, sticking at rest."""
    return apply_dry_friction(xp, lambda speed: p.torque, g, memory, h)


def coulomb_friction_fields(site, p):
    """MuJoCo's own dry friction."""
    site.m.dof_frictionloss[site.dof] += p.torque


COULOMB_FRICTION = Effect(
    name="coulomb_friction",
    stage="actuator",
    about="dry friction in the gears: a torque against the motion whose size does not depend on speed",
    formula="tau = -F_c sign(w)",
    source="Rhoban BAM M1; a bus servo of this size has 0.03 to 0.2 N m",
    parameters=(Parameter(name="torque", unit="N m", low=0.0, high=0.8, typical=(0.03, 0.2), of="torque"),),
    shows=("joint", "power"),
    native="joint frictionloss",
    confusions=(
        Confusion("viscous_friction", "friction error does not depend on amplitude or speed", ("slow_triangle", "chirp")),
        Confusion("servo_deadband", "a dead band's error does not depend on load or direction", ("staircase", "slow_triangle")),
    ),
    memory=AT_REST,
    gear=coulomb_friction_gear,
    robot=RobotForm(
        site="joint",
        scale="torque",
        parameters=(Parameter(name="torque", unit="N m", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=coulomb_friction_fields,
        confusions=(Confusion("viscous_friction", "friction error does not depend on speed: move slowly, then fast"),),
    ),
)


def gear_backlash_gear(xp, p, g, memory, h):
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


def gear_backlash_law(joint, memory, half_gap, rotor):
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


GEAR_BACKLASH = Effect(
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
    gear=gear_backlash_gear,
    robot=RobotForm(
        site="actuator",
        scale=("", "inertia"),
        parameters=(
            Parameter(name="half_gap", unit="rad", low=0.0, high=0.2, typical=(0.003, 0.03)),
            Parameter(name="rotor", unit="kg m2", null=0.1, low=0.005, high=1.0, typical=(0.03, 0.4), shape=True),
        ),
        law=gear_backlash_law,
        confusions=(
            Confusion("command_latency", "lost motion at reversals only; a delay acts all the time"),
            Confusion("servo_gain", "lost motion at reversals only: drive one way against a load"),
        ),
    ),
)


def joint_stiffness_fields(site, p):
    """MuJoCo's joint spring about its own rest angle."""
    site.m.jnt_stiffness[site.joint] += p.stiffness


JOINT_STIFFNESS = Effect(
    name="joint_stiffness",
    stage="actuator",
    about="cables, hoses or a flexible cover pull a joint to its rest angle",
    formula="tau = -k (q - q_rest)",
    source="cable bundles of small arms: 0.02 to 0.5 N m/rad",
    native="joint stiffness",
    robot=RobotForm(
        site="joint",
        scale="stiffness",
        parameters=(Parameter(name="stiffness", unit="N m/rad", low=0.0, high=2.0, typical=(0.03, 0.3)),),
        fields=joint_stiffness_fields,
        confusions=(Confusion("joint_zero_offset", "a spring grows with the angle: turn the robot's base"),),
    ),
)


def load_friction_gear(xp, p, g, memory, h):
    """Friction of at most K |tau_m|, sticking at rest; tau_m = drive - k_b w is the motor's torque on the teeth."""
    load = xp.abs(g.drive - g.kb * g.rate)
    return apply_dry_friction(xp, lambda speed: p.ratio * load, g, memory, h)


def load_friction_law(joint, memory, ratio):
    """Limit of the friction under the present torque of the actuator."""
    return 0.0, ratio * abs(joint.drive)


LOAD_FRICTION = Effect(
    name="load_friction",
    stage="actuator",
    about="teeth under load rub harder: lifting costs more than lowering gives back, holding has a hysteresis",
    formula="tau = -K |tau_motor| sign(w)",
    source="Rhoban BAM M3; 0.1 to 0.3, 0.15 on an XL330",
    parameters=(Parameter(name="ratio", unit="1", low=0.0, high=1.0, typical=(0.1, 0.3)),),
    shows=("joint", "power"),
    confusions=(
        Confusion("coulomb_friction", "vary the load at equal speed", ("hold_angles", "slow_triangle")),
        Confusion("voltage_sag", "vary the speed at equal load", ("chirp", "steps")),
        Confusion("servo_gain", "acts on the moving joint only", ("staircase", "chirp")),
    ),
    memory=AT_REST,
    gear=load_friction_gear,
    robot=RobotForm(
        site="actuator",
        parameters=(Parameter(name="ratio", unit="1", low=0.0, high=1.0, typical=(0.05, 0.3)),),
        law=load_friction_law,
        confusions=(
            Confusion("coulomb_friction", "grows with the load: vary the load at equal speed"),
            Confusion("servo_gain", "acts on the moving joint only: hold a load, then lift and lower it"),
        ),
    ),
)


def quadratic_friction_fields(site, p):
    """Second coefficient of MuJoCo's polynomial damping."""
    site.m.dof_dampingpoly[site.dof, 0] += p.drag


QUADRATIC_FRICTION = Effect(
    name="quadratic_friction",
    stage="actuator",
    about="churning grease, a fan on the shaft, or a link that stirs air or water",
    formula="tau = -D |w| w",
    source="seals and fans: a few per cent of the torque at full speed",
    native="joint damping, its second number",
    robot=RobotForm(
        site="joint",
        scale="drag",
        parameters=(Parameter(name="drag", unit="N m s2/rad2", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=quadratic_friction_fields,
        confusions=(Confusion("viscous_friction", "error grows with the square of speed: move slowly, then fast"),),
    ),
)


def rotor_inertia_fields(site, p):
    """MuJoCo's armature."""
    site.m.dof_armature[site.dof] += p.inertia


ROTOR_INERTIA = Effect(
    name="rotor_inertia",
    stage="actuator",
    about="rotor and gears turn N times as fast as the joint: an inertia J N^2 that no link shows",
    formula="tau = -J N^2 dw/dt",
    source="quasi-direct drives: 0.001 to 0.05 kg m2 at the joint; hobby servos 0.002 to 0.02",
    native="joint armature",
    robot=RobotForm(
        site="joint",
        scale="inertia",
        parameters=(Parameter(name="inertia", unit="kg m2", low=0.0, high=10.0, typical=(0.02, 0.3)),),
        fields=rotor_inertia_fields,
        confusions=(Confusion("link_inertia", "a rotor does not turn with the joints before it: move those alone"),),
    ),
)


def skin_hysteresis_gear(xp, p, g, memory, h):
    """Maxwell branch: tau = -k (angle - z), z' = (angle - z) / T, advanced exactly for a held angle."""
    (rest,) = memory
    rest = g.angle + (rest - g.angle) * xp.exp(-h / p.time)
    return g._replace(torque=g.torque - p.stiffness * (g.angle - rest), resist=g.resist + h * p.stiffness), (rest,)


SKIN_HYSTERESIS = Effect(
    name="skin_hysteresis",
    stage="actuator",
    about="a viscoelastic skin: resists change, then gives way; creep after a step, loops at any speed",
    formula="tau = -k (angle - z), z' = (angle - z)/T",
    source="silicone: loss factor 0.1 to 0.3",
    parameters=(
        Parameter(name="stiffness", unit="N m/rad", low=0.0, high=6.0, typical=(0.2, 1.0), of="torque"),
        Parameter(name="time", unit="s", null=0.5, low=0.02, high=10.0, typical=(0.1, 1.0), shape=True),
    ),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("skin_stiffness", "relaxes while an angle is held", ("hold_angles", "square")),
        Confusion("coulomb_friction", "recovers without drift, loops depend on rate", ("slow_triangle",)),
        Confusion("wake_memory", "the same in air", ("square", "hold_angles")),
    ),
    memory=(0.0,),
    gear=skin_hysteresis_gear,
)


def skin_stiffness_gear(xp, p, g, memory, h):
    """tau = -k (angle + h w'), the spring at the end of the step: the part h k w' is taken implicitly."""
    return g._replace(torque=g.torque - p.stiffness * g.angle, resist=g.resist + h * p.stiffness), memory


SKIN_STIFFNESS = Effect(
    name="skin_stiffness",
    stage="actuator",
    about="a silicone skin pulls joints straight: droop and holding power in proportion to the angle",
    formula="tau = -k angle",
    source="silicone tube of this size: 0.2 to 1.5 N m/rad",
    parameters=(Parameter(name="stiffness", unit="N m/rad", low=0.0, high=6.0, typical=(0.2, 1.0), of="torque"),),
    stores=True,
    shows=("joint", "position", "power"),
    native="joint stiffness",
    confusions=(
        Confusion("servo_gain", "power to hold a constant angle", ("hold_angles", "staircase")),
        Confusion("command_gain_error", "droop needs power to hold, a wrong gain does not", ("hold_angles", "staircase")),
        Confusion("skin_hysteresis", "does not relax with time", ("hold_angles", "slow_triangle")),
    ),
    gear=skin_stiffness_gear,
)


def stribeck_gear(xp, p, g, memory, h):
    """Friction of at most F_s exp(-(w / w_s)^2), sticking at rest."""
    return apply_dry_friction(xp, lambda speed: p.torque * xp.exp(-((speed / p.speed) ** 2)), g, memory, h)


def stribeck_law(joint, memory, torque, speed):
    """Limit of the friction at the present rate."""
    return 0.0, torque * exp(-((joint.rate / speed) ** 2))


STRIBECK = Effect(
    name="stribeck",
    stage="actuator",
    about="friction that is higher at creep speed than in motion: stick and slip",
    formula="tau = -F_s exp(-(w/w_s)^2) sign(w)",
    source="Stribeck curve as in LuGre and Rhoban BAM M2; half to one and a half times Coulomb friction",
    parameters=(
        Parameter(name="torque", unit="N m", low=0.0, high=0.8, typical=(0.03, 0.2), of="torque"),
        Parameter(name="speed", unit="rad/s", null=0.1, low=0.01, high=1.0, typical=(0.05, 0.2), shape=True),
    ),
    shows=("joint", "power"),
    confusions=(
        Confusion("coulomb_friction", "vanishes at speed: needs a decade of low speeds", ("creep", "slow_triangle", "chirp")),
        Confusion("servo_deadband", "depends on speed at small error", ("slow_triangle",)),
    ),
    memory=AT_REST,
    gear=stribeck_gear,
    robot=RobotForm(
        site="joint",
        scale=("torque", ""),
        parameters=(
            Parameter(name="torque", unit="N m", low=0.0, high=1.0, typical=(0.03, 0.2)),
            Parameter(name="speed", unit="rad/s", null=0.1, low=0.01, high=5.0, typical=(0.05, 2.0), shape=True),
        ),
        law=stribeck_law,
        confusions=(
            Confusion("coulomb_friction", "vanishes at speed: creep, then move fast"),
            Confusion("load_friction", "does not depend on the load: vary it at creep speed"),
        ),
    ),
)


def viscous_friction_gear(xp, p, g, memory, h):
    """tau = -D w, taken implicitly."""
    return g._replace(resist=g.resist + p.damping), memory


def viscous_friction_fields(site, p):
    """MuJoCo's own linear damping."""
    site.m.dof_damping[site.dof] += p.damping


VISCOUS_FRICTION = Effect(
    name="viscous_friction",
    stage="actuator",
    about="grease and back-EMF beyond the model's: a torque against the motion in proportion to speed",
    formula="tau = -D w",
    source="Rhoban BAM M1; 0.01 to 0.3 N m s/rad",
    parameters=(Parameter(name="damping", unit="N m s/rad", low=0.0, high=1.0, typical=(0.02, 0.15), of="damping"),),
    shows=("joint", "power"),
    native="joint damping",
    confusions=(
        Confusion("coulomb_friction", "error grows with speed", ("slow_triangle", "chirp")),
        Confusion("joint_hydro_damping", "the same in air and water; linear in speed", ("chirp", "square")),
        Confusion("speed_limit", "acts at every torque, not only near the limit", ("chirp", "steps")),
    ),
    gear=viscous_friction_gear,
    robot=RobotForm(
        site="joint",
        scale="damping",
        parameters=(Parameter(name="damping", unit="N m s/rad", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=viscous_friction_fields,
        confusions=(Confusion("coulomb_friction", "error grows with speed: move slowly, then fast"),),
    ),
)
