"""Effects of the stage `environment`: currents, wind, tether, tilt."""

from math import cos, sin

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def air_drag_fields(site, p):
    """Density of MuJoCo's medium, which drags at the box of each body's inertia."""
    site.m.opt.density += p.density


AIR_DRAG = Effect(
    name="air_drag",
    stage="environment",
    about="air or water drags at fast links, with the square of their speed",
    formula="F = -rho/2 C A |v| v",
    source="air 1.2 kg/m3; sails and covers act like several times that",
    native="option density",
    robot=RobotForm(
        site="robot",
        parameters=(Parameter(name="density", unit="kg/m3", low=0.0, high=1500.0, typical=(1.2, 60.0)),),
        fields=air_drag_fields,
        confusions=(Confusion("quadratic_friction", "move one joint after the other"),),
    ),
)


ANGLES = tuple(Parameter(name=name, unit="rad", low=-0.3, high=0.3, typical=(0.01, 0.05)) for name in ("pitch", "roll"))


def base_tilt_fields(site, p):
    """Gravity turns by -pitch about y, then by -roll about x of the world: as seen from a base that is turned by them."""
    g = site.m.opt.gravity
    x, y, z = g
    x, z = x * cos(p.pitch) - z * sin(p.pitch), x * sin(p.pitch) + z * cos(p.pitch)
    g[:] = x, y * cos(p.roll) + z * sin(p.roll), z * cos(p.roll) - y * sin(p.roll)


BASE_TILT = Effect(
    name="base_tilt",
    stage="environment",
    about="table or floor is not level: gravity pulls to one side",
    formula="g' = R_x(-roll) R_y(-pitch) g",
    source="tables and floors: 0.2 to 3 deg",
    native="option gravity",
    robot=RobotForm(
        site="base",
        parameters=ANGLES,
        fields=base_tilt_fields,
        confusions=(Confusion("joint_zero_offset", "a zero moves one joint, a tilt all: turn the base by 90 deg"),),
    ),
)


def current_shear_flow(xp, p, place):
    """u' = u + rate y."""
    return place._replace(u=place.u + p.rate * place.y)


CURRENT_SHEAR = Effect(
    name="current_shear",
    stage="environment",
    about="faster water on one side of the tank: drift depends on the station, and a slow turning",
    formula="u' = u + rate y",
    source="pumped tanks: 0.02 to 0.2 1/s",
    parameters=(Parameter(name="rate", unit="1/s", low=-0.5, high=0.5, typical=(0.02, 0.1)),),
    handed=("rate",),
    shows=("position", "heading"),
    confusions=(
        Confusion("wall_effect", "changes sign with the direction of travel", ("out_and_back",)),
        Confusion("swirl", "u only: no cross drift at other x", ("station_left", "station_right", "drift_north")),
        Confusion("steady_current", "the same run at two stations", ("station_left", "station_right")),
    ),
    flow=current_shear_flow,
)


def steady_current_flow(xp, p, place):
    """U' = U + (c_x, c_y)."""
    return place._replace(u=place.u + p.x, v=place.v + p.y)


STEADY_CURRENT = Effect(
    name="steady_current",
    stage="environment",
    about="water moves over ground by a constant velocity: drift that is fixed in the tank's frame",
    formula="U' = U + (c_x, c_y)",
    source="paper, flow tank: up to 0.4 m/s set; residual currents of 0.03 m/s are usual",
    parameters=(
        Parameter(name="x", unit="m/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),
        Parameter(name="y", unit="m/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),
    ),
    handed=("y",),
    shows=("position",),
    native="option wind (MuJoCo's own fluid only)",
    confusions=(
        Confusion("camera_yaw", "a turned camera turns tracks, a current moves a resting fish", ("drift_east", "drift_north")),
        Confusion("joint_zero_offset", "an offset turns with the fish, a current does not", ("drift_east", "gait_mirrored")),
    ),
    flow=steady_current_flow,
)


AIR = 1.2  # kg/m3


def steady_wind_fields(site, p):
    """MuJoCo's wind in a medium of at least the density of air."""
    site.m.opt.density = max(site.m.opt.density, AIR)
    site.m.opt.wind[:] += p.x, p.y, p.z


STEADY_WIND = Effect(
    name="steady_wind",
    stage="environment",
    about="a fan, or weather, pushes links that are large for their weight",
    formula="F = rho/2 C A |w - v| (w - v)",
    source="fans 3 to 6 m/s",
    native="option wind, density",
    robot=RobotForm(
        site="robot",
        parameters=tuple(Parameter(name=n, unit="m/s", low=-40.0, high=40.0, typical=(2.0, 12.0)) for n in "xyz"),
        fields=steady_wind_fields,
    ),
)


def swirl_flow(xp, p, place):
    """(u, v)' = (u - O y, v + O x): solid rotation about the tank's centre."""
    return place._replace(u=place.u - p.rate * place.y, v=place.v + p.rate * place.x)


SWIRL = Effect(
    name="swirl",
    stage="environment",
    about="pumps set the whole tank turning: a floating fish circles and turns with the water",
    formula="(u, v)' = (u - O y, v + O x)",
    source="pumped tanks: 0.01 to 0.05 rad/s",
    parameters=(Parameter(name="rate", unit="rad/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),),
    handed=("rate",),
    shows=("position", "heading"),
    confusions=(
        Confusion("current_shear", "cross drift at other x", ("station_left", "station_right", "drift_north")),
        Confusion("steady_current", "vanishes at the centre", ("station_left", "station_right")),
    ),
    flow=swirl_flow,
)


def tether_body(xp, p, b, memory, h):
    """F = -k (position - anchor), world, on the reference point."""
    fx, fy = -p.stiffness * (b.x - p.x), -p.stiffness * (b.y - p.y)
    c, s = xp.cos(b.heading), xp.sin(b.heading)
    return b._replace(fx=b.fx + (c * fx + s * fy), fy=b.fy + (c * fy - s * fx)), memory


TETHER = Effect(
    name="tether",
    stage="environment",
    about="a cable or its buoy holds the fish back towards a point of the tank",
    formula="F = -k (position - anchor)",
    source="thin cables on floats: 0.05 to 1 N/m",
    parameters=(
        Parameter(name="stiffness", unit="N/m", low=0.0, high=5.0, typical=(0.05, 0.4)),
        Parameter(name="x", unit="m", low=-1.8, high=1.8, typical=(-1.0, 1.0), shape=True),
        Parameter(name="y", unit="m", low=-1.8, high=1.8, typical=(-1.0, 1.0), shape=True),
    ),
    handed=("y",),
    shows=("position",),
    confusions=(
        Confusion("steady_current", "changes sign beyond the anchor", ("out_and_back", "drift_east")),
        Confusion("linear_surge_drag", "pulls a resting fish", ("drift_east", "out_and_back")),
    ),
    body=tether_body,
)


TURBULENCE = Effect(
    name="turbulence",
    stage="environment",
    about="gusts that differ between replicates: scatter, not a bias",
    formula="du = -u/tau dt + sigma sqrt(2/tau) dW, both components",
    source="paper, drift of a floating marker; 5 to 15 % of the current, 0.3 to 2 s",
    parameters=(
        Parameter(name="sigma", unit="m/s", low=0.0, high=0.2, typical=(0.005, 0.03)),
        Parameter(name="time", unit="s", null=1.0, low=0.05, high=10.0, typical=(0.3, 2.0), shape=True),
    ),
    shows=("position", "heading"),
    confusions=(
        Confusion("steady_current", "three replicates: the mean vanishes", ("drift_east",)),
        Confusion("noise_level", "grows with time, a resting log does not", ("idle", "drift_east")),
    ),
    stream="flow",
)
