"""Generator `foil`: each slice of the body is a plate at an angle of attack, the fin a wing with stall and lag.

    slices     D = 1/2 rho S (2 c_f + c_90 sin^2 a) V^2 along the stream, L = 1/2 rho S l c_90 / 2 sin 2a V^2 across it
               form of Wang, Birch and Dickinson 2004, J. Exp. Biol. 207: C_L = 1.2 sin 2a, C_D = 1.4 - cos 2a, l = 1.2;
               l = 1 is a pressure at a right angle to the slice
    skin       c_f = F 0.455 / (log10 Re)^2.58      Prandtl and Schlichting 1932; F roughness, gaps and a beating body
    fin        C_L = (1 - s) C_La sin a q + s 2 sin^2 a cos a,   C_D = 2 c_f + ((1 - s) C_La sin a q)^2 / (pi e A) + s 2 |sin a|^3
               C_La = 2 pi A / (2 + sqrt(A^2 + 4))      Helmbold 1942, Ringbuch der Luftfahrttechnik; A aspect ratio
               s = (1 - k) / (1 + exp((a_s - a) / d)) separated share, Newtonian plate      Beard and McLain 2012, ch. 4
               k: share of leading-edge vortex and suction that a beating fin keeps at any angle (Dickinson et al. 1999)
               q = (1 + u / sqrt(u^2 + (w / 3)^2)) / 2 is 1 ahead, 0 astern, where the trailing edge leads (chosen form)
    lag        sin a of the lift is that of w_e = (1 - A1 - A2) w + A1 z1 + A2 z2,  z_k' = b_k (V / b) (w - z_k)
               w at 3/4 chord, b half a chord; A = 0.165, 0.335, b = 0.0455, 0.3      R. T. Jones 1940, NACA Report 681,
               for Wagner 1925; with a finite span b_k grows, (1 + 2/A), as the wake that matters is shorter (chosen form)
    inertia    plates across: rho pi/4 h^2 / sqrt(1 + (h/l)^2), l the body's length, for the fin its chord      Brennen 1982

Lift is at a right angle to the slice's motion through the water, so it does no work at any angle or lag; drag dissipates energy.
"""

from typing import NamedTuple

import numpy as np

from fishmj.base.units import WATER_VISCOSITY
from fishmj.gap.laboratory.generators.family import Coefficient, Family, RobotWater
from fishmj.gap.laboratory.generators.link_chain import finish, move
from fishmj.gap.laboratory.generators.outline import fin_of, is_fin, ragged, stations_of, swaying
from fishmj.gap.laboratory.generators.water_compiler import entry, inlined
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of

SLOWEST = 1.0e4  # least Reynolds number of the friction law
LAGS = ((0.165, 0.0455), (0.335, 0.3))  # share and rate, half chords travelled
OSWALD = 0.85  # e, planform (textbook 0.7 to 0.95)

COEFFICIENTS = {
    "plate": Coefficient(0.92, 0.08, "1", "of the flat plate's added mass; a thick section has less edge flow (chosen)"),
    "lift_body": Coefficient(1.10, 0.05, "1", "l: 1 without suction at the edges, 1.2 for a thin wing (Wang et al. 2004)"),
    "drag_round": Coefficient(1.00, 0.12, "1", "cylinder broadside 1 to 1.2 (Hoerner 1965)"),
    "drag_flat": Coefficient(1.90, 0.12, "1", "plate broadside 1.2 to 2 (Hoerner 1965)"),
    "friction": Coefficient(3.5, 0.12, "1", "beating, rough body over a smooth plate: 3 to 5 (Lighthill 1971; chosen)"),
    "lift_fin": Coefficient(0.90, 0.08, "1", "of Helmbold's slope; the hull's wake slows the stream (chosen)"),
    "stall": Coefficient(0.61, 0.08, "rad", "wings of aspect ratio 1 stall at 30 to 45 deg (textbook)"),
    "stall_width": Coefficient(0.10, 0.20, "rad", "chosen"),
    "vortex": Coefficient(0.35, 0.20, "1", "k; chosen"),
}


class FoilLaw(NamedTuple):
    """Slices of all links in a row, `begin` (N + 1,) index of each link's first; the fin is another plate of the last link."""

    begin: np.ndarray
    x: np.ndarray  # (S,) m
    area: np.ndarray  # (S,) 1/2 rho h ds, N s2/m2
    broadside: np.ndarray  # (S,) c_90
    lift: float
    friction: float
    length: float  # m, of the Reynolds number
    fin: float  # 1/2 rho S, N s2/m2
    quarter: float  # x where its lift acts, m
    three_quarters: float  # x where it meets the stream, m
    half_chord: float  # m
    slope: float  # C_La
    induced: float  # 1 / (pi e A)
    stall: float  # rad
    width: float  # rad
    vortex: float
    memory: float  # factor on b_k


def build(robot: Robot, values) -> RobotWater:
    """Builds the water of one robot."""
    geometry, rho = geometry_of(robot), robot.density_water
    stations = stations_of(robot, geometry)
    fin = fin_of(robot, stations)
    aspect = fin.aspect
    per_length, area, broadside = [], [], []
    for i, s in enumerate(stations):
        on_fin = is_fin(stations, fin, i)
        along = np.where(on_fin, fin.chord, robot.length)
        per_length.append(values["plate"] * rho * np.pi / 4 * s.height**2 / np.sqrt(1.0 + (s.height / along) ** 2))
        area.append(np.where(on_fin, 0.0, 0.5 * rho * s.height * s.ds))
        broadside.append(values["drag_round"] + (values["drag_flat"] - values["drag_round"]) * s.flatness)
    x, begin = ragged([s.x for s in stations])
    chord = fin.front - fin.rear
    law = FoilLaw(
        begin=begin,
        x=x,
        area=ragged(area)[0],
        broadside=ragged(broadside)[0],
        lift=values["lift_body"],
        friction=values["friction"],
        length=robot.length,
        fin=0.5 * rho * fin.area,
        quarter=fin.front - 0.25 * chord,
        three_quarters=fin.front - 0.75 * chord,
        half_chord=chord / 2,
        slope=values["lift_fin"] * 2.0 * np.pi * aspect / (2.0 + np.sqrt(aspect**2 + 4.0)),
        induced=1.0 / (np.pi * OSWALD * aspect),
        stall=values["stall"],
        width=values["stall_width"],
        vortex=values["vortex"],
        memory=1.0 + 2.0 / aspect,
    )
    return RobotWater(swaying(stations, per_length), law, len(LAGS))


@inlined
def skin(law, speed):
    """Friction coefficient of one side."""
    return law.friction * 0.455 / np.log10(max(speed * law.length / WATER_VISCOSITY, SLOWEST)) ** 2.58


@inlined
def lagged(law, w, speed, memory, h):
    """Normal velocity of the lagged circulation, m/s; advances memory (2,) by h, exactly for a steady stream."""
    out = 0.5 * w
    for k in range(2):
        share, rate = LAGS[k]
        out += share * memory[k]
        memory[k] = w + (memory[k] - w) * np.exp(-h * rate * law.memory * speed / law.half_chord)
    return out


@inlined
def wing(law, u, w, behind, memory, h):
    """(F_t, F_n) of the fin at its centre of lift. u, w there, `behind` the normal velocity at 3/4 chord, m/s."""
    speed = np.sqrt(u * u + w * w)
    late = lagged(law, behind, speed, memory, h)
    if speed < 1e-9:
        return 0.0, 0.0
    sine, cosine = late / np.sqrt(late * late + u * u + 1e-12), u / speed
    angle = np.arctan2(abs(late), abs(u))
    separated = (1.0 - law.vortex) / (1.0 + np.exp((law.stall - angle) / law.width))
    ahead = 0.5 + 0.5 * u / np.sqrt(u * u + w * w / 9.0)
    attached = (1.0 - separated) * law.slope * sine * ahead
    lift = attached + separated * 2.0 * abs(sine) * sine * cosine
    broad = abs(w) / speed
    drag = 2.0 * skin(law, speed) + attached * attached * law.induced + separated * 2.0 * broad * broad * broad
    return law.fin * speed * (lift * w - drag * u), law.fin * speed * (-lift * u - drag * w)


@inlined
def forces(law, motion, memory, h, force):
    """Writes force (N, 3): all terms but inertia. Advances the memory."""
    n = law.begin.shape[0] - 1
    for i in range(n):
        u, v, r, f = motion[i, 0], motion[i, 1], motion[i, 2], force[i]
        f[:] = 0.0
        for k in range(law.begin[i], law.begin[i + 1]):
            x = law.x[k]
            w = v + r * x
            square = u * u + w * w
            speed = np.sqrt(square)
            if speed < 1e-9:
                continue
            lift = law.lift * law.broadside[k] * u * w / speed  # C_L V
            drag = 2.0 * skin(law, speed) * speed + law.broadside[k] * w * w / speed
            f[0] += law.area[k] * (lift * w - drag * u)
            normal = law.area[k] * (-lift * u - drag * w)
            f[1] += normal
            f[2] += normal * x
    last, f = motion[n - 1], force[n - 1]
    w, behind = last[1] + last[2] * law.quarter, last[1] + last[2] * law.three_quarters
    along, across = wing(law, last[0], w, behind, memory, h)
    f[0] += along
    f[1] += across
    f[2] += across * law.quarter


@entry
def step(chain, law, q, rate, flow, extra, tether, memory, h, generalised, sparse, work):
    """Evaluates the water once; see `family.Family`."""
    move(chain, q, rate, flow, work)
    forces(law, work.motion, memory, h, work.force)
    finish(chain, extra, tether, work, generalised, sparse)


FAMILY = Family("foil", "plates at an angle of attack; a fin that stalls and remembers", COEFFICIENTS, build, step)
