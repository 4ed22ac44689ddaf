"""A cylinder held in a stream: the steady wake at Re 40 and the vortex street at Re 100, in a strip one cell deep.

    C_D = 2 F_x / (rho U^2 D),   C_L = 2 F_y / (rho U^2 D),   St = f D / U,   l = from the rear to where u = 0 on the axis

The box is 30 D square with free slip at its sides, as wide as that of the reference; it blocks 1/30 of the stream. The street is
judged in a box of 60 x 80 D at half the Mach number. Between sides 30 D apart, sound at Mach 0.1 has a mode at f D / U = 0.16,
next to the shedding frequency, and makes the shedding faster and stronger. Blockage and an inflow 12 D ahead raise the frequency
by 1 % each.

The markers are drawn in by 0.7 cells so that the drag is that of the full diameter. The wake begins at the markers: the bubble is
that of a cylinder smaller by 1.4 cells, and its length converges with the first power of the cell. It is judged at forty cells,
and also reported for the markers' own circle. For the same reason the lift of the street is too weak; it is judged at sixty-four.

Sources: Taira and Colonius 2007, J. Comput. Phys. 225:2118, table 2 (Re 40); Liu, Zheng and Sung 1998 and Park, Kwon and
Choi 1998 (Re 100) as tabulated beside its own figures by the validation pages of the solver Mallard, read 2026-11-20.
"""

from dataclasses import replace
from functools import partial
from math import pi
from typing import Any, NamedTuple

import numpy as np

from fishmj.lbm_oracle import scene
from fishmj.lbm_oracle.cases import Check, about, entry, reported
from fishmj.lbm_oracle.immersed.markers import offset_of
from fishmj.lbm_oracle.immersed.strip import circle_markers
from fishmj.lbm_oracle.scene import Scene

STREAM = 0.06  # lattice units: Mach 0.1
BOX, AT = (30.0, 30.0), (0.4, 0.5)  # diameters; share of the box
JUDGED: dict[str, Any] = {"stream": 0.03, "box": (60.0, 80.0)}  # in which the street is judged
KICK = 4.0  # D / U; a push to the side and back, so that the street need not wait for round-off

TAIRA = {"C_D": 1.54, "l / D": 2.30}
STREET = {"C_D": 1.34, "C_L": 0.335, "St": 0.1645}  # middle of 1.33 and 1.350, 0.33 and 0.339, 0.164 and 0.165


def cylinder(cells: int, speed: float, reynolds: float, box, at, device: str, *, motion=None, **options) -> Scene:
    """A cylinder of `cells` cells across on slides along x and y, in lattice units, and of water's density if it is free.

    Args:
        speed: of the Reynolds number.
        box: length and breadth in diameters.
        at: centre as a share of the box; it is put off the nodes, as a fish is.
        motion: of both slides, cells. options: of the scene.
    """
    water = Scene(np.multiply(box, cells), 1.0, speed * cells / reynolds, rho=1.0, dt=1.0, device=device, **options)
    density = 1.0 if motion is None else None
    place = np.multiply(water.extent, at) + [0.7, 0.2]
    shape = replace(scene.cylinder(cells), markers=lambda dx: circle_markers(cells / 2, dx))
    return water.add(shape, place, joints=("slide x", "slide y"), motion=motion, density=density)


class Held(NamedTuple):
    """Record of a held cylinder: force coefficients (T, 2), the time between two rows in D / U, and the final water."""

    force: np.ndarray
    interval: float
    scene: Scene


def hold(cells: int, reynolds: float, times: float, device: str, *, stream=STREAM, box=BOX, kick: float = 0.0) -> Held:
    """Holds a cylinder of `cells` cells for `times` D / U, from undisturbed flow; `kick` is its first swing aside, of U."""
    swing = round(KICK * cells / stream)
    aside = lambda step: kick * stream * swing / (2 * pi) * (1 - np.cos(2 * pi * min(step / swing, 1.0)))
    options = {"stream": stream, "sponge": max(8, cells), "motion": lambda step: (0.0, aside(step))}
    held = cylinder(cells, stream, reynolds, box, AT, device, **options)
    every = max(1, round(cells / stream / 50))
    held.run(round(times * cells / stream / every) * every, every)
    return Held(held.coefficients()[:, :2], every * stream / cells, held)


def bubble(held: Held, cells: int) -> float:
    """Length of the recirculation behind the cylinder, in D; NaN if the velocity does not change sign within the box."""
    x, y = held.scene.coupled.body.data.xpos[1, :2] - 0.5  # in nodes
    u = held.scene.coupled.fluid.velocity()[:, :, 0, 0]
    row = int(np.floor(y))
    axis = u[:, row] + (y - row) * (u[:, row + 1] - u[:, row])
    rear = x + cells / 2
    first = int(np.ceil(rear)) + 2
    ahead = np.flatnonzero(axis[first:] > 0)
    if len(ahead) == 0 or ahead[0] == 0:
        return float("nan")
    i = first + int(ahead[0])
    return float((i - axis[i] / (axis[i] - axis[i - 1]) - rear) / cells)


def street(force: np.ndarray, interval: float) -> tuple[float, float, float, int]:
    """Mean C_D, half the swing of C_L, St and the number of whole periods of a record (T, 2): from rising zero to rising zero."""
    lift = force[:, 1] - force[:, 1].mean()
    rise = np.flatnonzero((lift[:-1] < 0) & (lift[1:] >= 0))
    if len(rise) < 2:
        return float(force[:, 0].mean()), float(np.ptp(lift) / 2), float("nan"), 0
    crossing = rise - lift[rise] / (lift[rise + 1] - lift[rise])
    periods = len(rise) - 1
    whole = force[rise[0] : rise[-1]]
    swing = np.mean([np.ptp(force[a:b, 1]) for a, b in zip(rise[:-1], rise[1:], strict=True)])
    return float(whole[:, 0].mean()), float(swing / 2), periods / ((crossing[-1] - crossing[0]) * interval), periods


def check_or_report(quantity: str, value: float, reference: float, room: float | None) -> Check:
    """Check within `room` of the reference, relative; reported only if `room` is None."""
    return reported(quantity, value, reference) if room is None else about(quantity, value, reference, room)


def steady(cells: int, device: str, room: dict[str, float], times: float = 45.0, box=BOX):
    """Checks of the steady wake; quantities without `room` are reported."""
    found = hold(cells, 40.0, times, device, box=box)
    last, before = found.force[-50:, 0].mean(), found.force[-100:-50, 0].mean()  # the last two D / U
    length, inset = bubble(found, cells), offset_of(found.scene.coupled.boundary.width)
    yield check_or_report(f"C_D at Re 40, D = {cells}", last, TAIRA["C_D"], room.get("C_D"))
    yield check_or_report(f"bubble l / D at Re 40, D = {cells}", length, TAIRA["l / D"], room.get("l / D"))
    yield reported("the same of the markers' own circle", (length * cells + inset) / (cells - 2 * inset), TAIRA["l / D"])
    yield reported("change of C_D in the last D / U", last / before - 1)
    yield reported("blockage D / breadth", 1 / box[1])


def shedding(cells: int, device: str, room: dict[str, float], times: float = 130.0, settle: float = 70.0, stream=STREAM, box=BOX):
    """Checks of the vortex street; quantities without `room` are reported."""
    found = hold(cells, 100.0, times, device, stream=stream, box=box, kick=0.3)
    drag, lift, frequency, periods = street(found.force[round(settle / found.interval) :], found.interval)
    yield check_or_report(f"mean C_D at Re 100, D = {cells}", drag, STREET["C_D"], room.get("C_D"))
    yield check_or_report(f"amplitude of C_L at Re 100, D = {cells}", lift, STREET["C_L"], room.get("C_L"))
    yield check_or_report(f"Strouhal number at Re 100, D = {cells}", frequency, STREET["St"], room.get("St"))
    yield reported("periods averaged", periods)
    yield reported("blockage D / breadth", 1 / box[1])


TAIRA_SOURCE = "Taira and Colonius 2007, table 2"
STREET_SOURCE = "Liu et al. 1998, Park et al. 1998, as tabulated by Mallard's validation pages"


# fmt: off
entry("cylinder_40_coarse", "The steady wake of a cylinder at Re 40, ten cells across.",
      partial(steady, 10, room={"C_D": 0.06}), rung=5, grid="300 x 300 x 1, D = 10", source=TAIRA_SOURCE, cost="30 s")
entry("cylinder_40", "The steady wake of a cylinder at Re 40.",
      partial(steady, 20, room={"C_D": 0.03}), rung=5.1, grid="600 x 600 x 1, D = 20", source=TAIRA_SOURCE,
      cost="4 min", gpu=True)
entry("cylinder_40_fine", "The steady wake of a cylinder at Re 40, forty cells across.",
      partial(steady, 40, room={"C_D": 0.03, "l / D": 0.05}), rung=5.2, grid="1200 x 1200 x 1, D = 40", source=TAIRA_SOURCE,
      cost="GPU, 43 G updates", gpu=True)
entry("cylinder_100_coarse", "The vortex street of a cylinder at Re 100, ten cells across.",
      partial(shedding, 10, room={"C_D": 0.06}), rung=6, grid="300 x 300 x 1, D = 10", source=STREET_SOURCE, cost="90 s")
entry("cylinder_100", "The vortex street of a cylinder at Re 100.",
      partial(shedding, 20, room={"C_D": 0.04}, **JUDGED), rung=6.1, grid="1200 x 1600 x 1, D = 20", source=STREET_SOURCE,
      cost="GPU, 170 G updates", gpu=True)
entry("cylinder_100_fine", "The vortex street of a cylinder at Re 100, forty cells across.",
      partial(shedding, 40, room={"C_D": 0.04, "St": 0.02}, **JUDGED), rung=6.2, grid="2400 x 3200 x 1, D = 40",
      source=STREET_SOURCE, cost="GPU, 1300 G updates", gpu=True)
entry("cylinder_100_finest", "The vortex street of a cylinder at Re 100, sixty-four cells across: where its lift is judged.",
      partial(shedding, 64, room={"C_D": 0.04, "C_L": 0.06, "St": 0.02}, **JUDGED), rung=6.3, grid="3840 x 5120 x 1, D = 64",
      source=STREET_SOURCE, cost="GPU, 5500 G updates", gpu=True)
# fmt: on
