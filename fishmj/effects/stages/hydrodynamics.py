"""Effects of the stage `hydrodynamics`: forces of the water."""

from fishmj.base.calib import constant
from fishmj.base.units import G
from fishmj.effects.effect import Confusion, Effect, Parameter


def body_lift_body(xp, p, b, memory, h):
    """fy = -Y |u| w: against the sway whether it swims ahead or astern, so it never feeds energy."""
    return b._replace(fy=b.fy - b.wet * p.coefficient * xp.abs(b.u) * b.w), memory


BODY_LIFT = Effect(
    name="body_lift",
    stage="hydrodynamics",
    about="a hull that moves askew sheds lift at its end: side force with speed times sway",
    formula="fy = -Y |u| w",
    source="published models of robotic fish: 5 to 30 N s2/m2",
    parameters=(Parameter(name="coefficient", unit="N s2/m2", low=0.0, high=100.0, typical=(4.0, 20.0), of="drag"),),
    shows=("position", "heading"),
    native="body fluidcoef (Kutta lift)",
    confusions=(
        Confusion("munk_moment", "a force, not a moment: heading keeps", ("tow_oblique", "turn_left")),
        Confusion("crossflow_drag", "vanishes without speed ahead", ("tow_sideways", "tow_oblique")),
        Confusion("sway_added_mass", "does not need acceleration", ("impulse", "turn_left")),
    ),
    body=body_lift_body,
)


def crossflow_drag_fish(xp, p, c):
    """c_n' = (1 + g) c_n on every link."""
    water = c.swimmer.water
    return c._replace(swimmer=c.swimmer._replace(water=water._replace(cn=[(1.0 + p.gain) * cn for cn in water.cn])))


CROSSFLOW_DRAG = Effect(
    name="crossflow_drag",
    stage="hydrodynamics",
    about="every link is harder or easier to push sideways: turns, side slip",
    formula="c_n' = (1 + g) c_n, all links",
    source="cross-flow coefficients of ellipses and plates: 1.1 to 2; this hull has 30 N s2/m2",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.4)),),
    shows=("position", "heading"),
    confusions=(
        Confusion("yaw_drag", "shows in a side drift without turning", ("tow_sideways", "twirl")),
        Confusion("body_lift", "no speed ahead needed", ("tow_sideways", "burst_and_coast")),
        Confusion("tail_normal_force", "acts on the head as on the tail", ("tow_sideways", "gait")),
    ),
    fish=crossflow_drag_fish,
)


def free_surface_body(xp, p, b, memory, h):
    """fx = -c Fr^2 |u| u, Fr^2 = u^2 / (g L)."""
    return b._replace(fx=b.fx - b.wet * p.gain * (b.u * b.u / (G * p.robot.length)) * xp.abs(b.u) * b.u), memory


FREE_SURFACE = Effect(
    name="free_surface",
    stage="hydrodynamics",
    about="a fish close under the surface makes waves: drag that grows with the fourth power of speed",
    formula="fx = -c Fr^2 |u| u, Fr^2 = u^2/(g L)",
    source="hulls close under the surface; Froude numbers here are 0.04 to 0.2",
    parameters=(Parameter(name="gain", unit="N s2/m2", low=0.0, high=1000.0, typical=(20.0, 150.0), of="drag"),),
    shows=("position",),
    confusions=(
        Confusion("quadratic_drag", "only at speed; two depths", ("burst_and_coast", "gait")),
        Confusion("wall_effect", "the same everywhere in the tank", ("out_and_back",)),
    ),
    body=free_surface_body,
)


def joint_hydro_damping_gear(xp, p, g, memory, h):
    """tau = -c |w| w in water, as its secant, taken implicitly."""
    return g._replace(resist=g.resist + p.coefficient * xp.abs(g.rate) * g.wet), memory


JOINT_HYDRO_DAMPING = Effect(
    name="joint_hydro_damping",
    stage="hydrodynamics",
    about="folds and gaps at the joints pump water: damping with the square of the rate, in water only",
    formula="tau = -c |w| w (in water)",
    source="paper, calibration of the servos in air and water; 0.005 to 0.05 N m s2",
    parameters=(Parameter(name="coefficient", unit="N m s2", low=0.0, high=0.5, typical=(0.005, 0.05), of="turning_drag"),),
    shows=("joint", "power"),
    confusions=(
        Confusion("viscous_friction", "not in air", ("chirp", "square")),
        Confusion("crossflow_drag", "does not push the body", ("gait", "tow_sideways")),
    ),
    gear=joint_hydro_damping_gear,
)


def linear_surge_drag_body(xp, p, b, memory, h):
    """fx = -c u."""
    return b._replace(fx=b.fx - b.wet * p.coefficient * b.u), memory


LINEAR_SURGE_DRAG = Effect(
    name="linear_surge_drag",
    stage="hydrodynamics",
    about="laminar drag along the body: what is left of a coast when it is slow",
    formula="fx = -c u",
    source="boundary layer of a body of 0.5 m: 0.1 to 0.8 N s/m",
    parameters=(Parameter(name="coefficient", unit="N s/m", low=0.0, high=5.0, typical=(0.1, 0.8), of="drag"),),
    shows=("position",),
    native="option viscosity",
    confusions=(
        Confusion("quadratic_drag", "speeds of 3 to 1, coast to rest", ("tow_ahead", "burst_and_coast")),
        Confusion("steady_current", "coast in two headings", ("burst_and_coast", "out_and_back")),
        Confusion("tether", "does not depend on where the fish is", ("out_and_back",)),
    ),
    body=linear_surge_drag_body,
)


def munk_moment_body(xp, p, b, memory, h):
    """n = -g m_sway u w, m_sway the base model's added mass in sway: turns the nose away from the direction of drift."""
    return b._replace(n=b.n - p.gain * b.sway_mass * b.u * b.w), memory


MUNK_MOMENT = Effect(
    name="munk_moment",
    stage="hydrodynamics",
    about="a body that moves askew is turned further askew; viscosity leaves 0.7 to 1.1 of the ideal moment",
    formula="n = -g m_sway u w",
    source="Munk 1924; factors of 0.7 to 1.1 on hulls",
    parameters=(Parameter(name="gain", unit="1", low=-1.5, high=2.0, typical=(0.1, 0.3)),),
    shows=("heading", "position"),
    confusions=(
        Confusion("body_lift", "a moment, not a force", ("tow_oblique", "turn_left")),
        Confusion("com_offset", "needs speed", ("impulse", "tow_oblique")),
        Confusion("sway_added_mass", "needs no acceleration", ("impulse", "tow_oblique")),
    ),
    body=munk_moment_body,
)


def quadratic_drag_body(xp, p, b, memory, h):
    """fx = -c |u| u."""
    return b._replace(fx=b.fx - b.wet * p.coefficient * xp.abs(b.u) * b.u), memory


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    stage="hydrodynamics",
    about="form drag along the body beyond the model's: mounts, cables, gaps in the skin",
    formula="fx = -c |u| u",
    source="this hull has 1.5 N s2/m2, half as much again with mounts and gaps; paper tunes it as a slip ratio",
    parameters=(Parameter(name="coefficient", unit="N s2/m2", low=-1.0, high=10.0, typical=(0.3, 1.0), of="drag"),),
    shows=("position",),
    native="option density with fluidcoef",
    confusions=(
        Confusion("tail_normal_force", "one steady speed cannot tell thrust from drag: coast down", ("burst_and_coast", "gait")),
        Confusion("linear_surge_drag", "speeds of 3 to 1, coast to rest", ("tow_ahead", "burst_and_coast")),
        Confusion("free_surface", "grows with the square of speed, not faster", ("burst_and_coast", "gait")),
        Confusion("camera_scale", "a run of known length", ("out_and_back",)),
    ),
    body=quadratic_drag_body,
)


def tail_normal_force_fish(xp, p, c):
    """(c_n of the last link, k_e)' = (1 + g) (c_n, k_e)."""
    water, more = c.swimmer.water, 1.0 + p.gain
    water = water._replace(cn=[*water.cn[:-1], more * water.cn[-1]], ke=more * water.ke)
    return c._replace(swimmer=c.swimmer._replace(water=water))


TAIL_NORMAL_FORCE = Effect(
    name="tail_normal_force",
    stage="hydrodynamics",
    about="normal force and shed momentum of the tail fin: thrust and recoil in one",
    formula="(c_n, k_e)_tail' = (1 + g) (c_n, k_e)_tail",
    source="compliant and printed fins: 30 % either way",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.3)),),
    shows=("position", "heading", "power"),
    confusions=(
        Confusion("quadratic_drag", "one steady speed cannot tell thrust from drag: coast down", ("burst_and_coast", "gait")),
        Confusion("crossflow_drag", "not on the head", ("tow_sideways", "gait")),
        Confusion("wake_memory", "the same at every frequency", ("chirp", "gait")),
    ),
    fish=tail_normal_force_fish,
)


def wake_memory_water(xp, p, w, memory, h):
    """m' = m + (1 - e^(-h/T)) (f - m) for drag and trailing edge of the last link; the added mass stays immediate."""
    share = xp.where(p.time > 0.0, 1.0 - xp.exp(-h / xp.where(p.time > 0.0, p.time, 1.0)), 1.0)
    last, fast = w.forces[-1], w.instant[-1]
    kept = tuple(share * (f - i) + (1.0 - share) * m for f, i, m in zip(last, fast, memory, strict=True))
    # forces + (memory - replaced part), so that a time constant of zero is exact
    slow = tuple(f + (k - (f - i)) for f, i, k in zip(last, fast, kept, strict=True))
    return w._replace(forces=[*w.forces[:-1], slow]), kept


WAKE_MEMORY = Effect(
    name="wake_memory",
    stage="hydrodynamics",
    about="circulation needs time to build: thrust lags at starts and rolls off with frequency",
    formula="T dm/dt = f - m; the tail feels m in place of f (drag and trailing edge)",
    source="Wagner 1925: chord over speed, 0.1 to 0.4 s",
    parameters=(Parameter(name="time", unit="s", low=0.0, high=1.0, typical=(0.05, 0.3)),),
    shows=("position", "heading", "power"),
    confusions=(
        Confusion("command_latency", "acts on the force, the joints do not lag", ("chirp", "impulse")),
        Confusion("tail_normal_force", "changes with frequency", ("chirp", "gait")),
        Confusion("skin_hysteresis", "not in air", ("square", "hold_angles")),
    ),
    memory=(0.0, 0.0, 0.0),
    water=wake_memory_water,
)


HALF = constant("tank", "size")[0] / 2  # m, the tank's walls are at x, y = +-HALF


def wall_share(xp, p, x, y):
    """a e^(-d / L), d the distance from the reference point to the nearest wall [m]."""
    gap = xp.maximum(HALF - xp.maximum(xp.abs(x), xp.abs(y)), 0.0)
    return p.gain * xp.exp(-gap / p.robot.length)


def wall_effect_water(xp, p, w, memory, h):
    """f' = f (1 + a e^(-d / L)) for drag and trailing edge."""
    share = wall_share(xp, p, w.x, w.y)
    pairs = zip(w.forces, w.instant, strict=True)
    near = [tuple(f + share * (f - i) for f, i in zip(force, instant, strict=True)) for force, instant in pairs]
    return w._replace(forces=near), memory


def wall_effect_body(xp, p, b, memory, h):
    """m_a' = m_a (1 + a e^(-d / L)): the added mass alike."""
    return b._replace(added=b.added + wall_share(xp, p, b.x, b.y)), memory


WALL_EFFECT = Effect(
    name="wall_effect",
    stage="hydrodynamics",
    about="drag, push of the tail and added mass rise within a body length of a wall",
    formula="(f, m_a)' = (f, m_a) (1 + a e^(-d/L)), d to the nearest wall",
    source="blockage in tanks: 5 to 30 % within half a length",
    parameters=(Parameter(name="gain", unit="1", low=-0.5, high=5.0, typical=(0.1, 0.5)),),
    shows=("position", "heading"),
    confusions=(
        Confusion("current_shear", "the same in both directions of travel", ("out_and_back", "station_left", "station_right")),
        Confusion("lens_distortion", "acts on the motion, not on a resting fish", ("out_and_back",)),
        Confusion("quadratic_drag", "not in the middle of the tank", ("out_and_back", "gait")),
    ),
    water=wall_effect_water,
    body=wall_effect_body,
)


def yaw_drag_body(xp, p, b, memory, h):
    """n = -c |r| r."""
    return b._replace(n=b.n - b.wet * p.coefficient * xp.abs(b.r) * b.r), memory


YAW_DRAG = Effect(
    name="yaw_drag",
    stage="hydrodynamics",
    about="the head's turning is braked with the square of its rate: side fins, masts",
    formula="n = -c |r| r",
    source="plates on a hull of 0.54 m: 0.01 to 0.3 N m s2",
    parameters=(Parameter(name="coefficient", unit="N m s2", low=0.0, high=1.0, typical=(0.005, 0.05), of="turning_drag"),),
    shows=("heading", "position"),
    confusions=(
        Confusion("crossflow_drag", "does not show in a side drift", ("tow_sideways", "twirl")),
        Confusion("yaw_added_mass", "end of a turn against its start", ("twirl", "spin")),
    ),
    body=yaw_drag_body,
)
