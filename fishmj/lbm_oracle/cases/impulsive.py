"""A cylinder that moves at once at full speed, Re 550: its drag from the vortex sheet of the start to the first two eddies.

    u - i v = U (1 - R^2 / z^2),   p = rho (U^2 - |u|^2) / 2         outside, z from the axis: the potential flow of the start
    u = 0,   p = -rho U^2 / 2                                        inside
    C_D = 2 F / (rho U^2 D) against U t / R: least 0.703 at 0.79, then greatest 1.287 at 2.89

The water begins in that flow, not in a uniform stream: stopping a stream would send a blow of sound through water and hull. What
is left of it runs to and fro inside the hull (lowest mode 1.841 c / R); C_D is the mean over a period of that. Its time in
U t / R falls with the Mach number, and so does what the forcing leaves of the normal velocity: U is 0.025 cells a step.

Blockage: images between slip walls B apart raise the speed at the body by pi^2 / 12 (D / B)^2 of itself, and C_D by twice that,
which is taken off; there is no wake of any length yet. Sides are open and 20 D apart.

Source: Koumoutsakos and Leonard 1995, J. Fluid Mech. 296:1, figures of C_D by vortex methods, as quoted in later works.
"""

from functools import partial
from math import pi, sqrt

import numpy as np

from fishmj.lbm_oracle.cases import about, entry, reported
from fishmj.lbm_oracle.scene import Scene, cylinder

REYNOLDS, SPEED = 550.0, 0.025
BOX, AT = (24.0, 20.0), (0.4, 0.5)  # diameters; share of the box
END = 3.4  # U t / R
MODE = 1.841  # of sound in a circle: where the derivative of J_1 is zero
EARLY, LATE = (0.6, 1.5), (1.8, END)  # U t / R, in which the least and the greatest are looked for
LEAST, GREATEST = (0.79, 0.703), (2.89, 1.287)  # U t / R and C_D
ROOM = 0.05  # of the greatest C_D


def start_flow(x: np.ndarray, y: np.ndarray, radius: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (nx, ny, 1, 3) and pressure over density (nx, ny, 1) at x (nx,) and y (ny,) from the axis of a cylinder."""
    z = x[:, None] + 1j * y[None]
    outside = np.abs(z) > radius
    w = np.where(outside, speed * (1 - radius**2 / np.where(outside, z, 1) ** 2), 0)
    pressure = 0.5 * np.where(outside, speed**2 - np.abs(w) ** 2, -(speed**2))
    return np.stack([w.real, -w.imag, 0 * w.real], -1)[:, :, None], pressure[:, :, None]


def drag_of_start(cells: int, device: str, *, box=BOX, speed: float = SPEED, end: float = END) -> tuple[np.ndarray, np.ndarray]:
    """U t / R and C_D, (T,) each, of a cylinder of `cells` cells, corrected for blockage."""
    radius = cells / 2
    period = 2 * pi * radius * sqrt(3) / MODE  # steps
    every = max(1, round(period / 12))
    held = Scene(np.multiply(box, cells), 1.0, speed * cells / REYNOLDS, speed, rho=1.0, dt=1.0, sides="open", device=device)
    held.add(cylinder(cells), np.multiply(held.extent, AT) + [0.7, 0.2])  # off the nodes, as a fish is
    water = held.coupled.fluid
    centre = held.coupled.body.data.xpos[1, :2]
    x, y = (water.lattice.corner[a] + np.arange(water.shape[a]) - centre[a] for a in range(2))
    water.impose(*start_flow(x, y, radius, speed))
    held.run(end * radius / speed + period / 2, every)
    mean = np.full(around := round(period / every), 1 / around)
    times = (held.forces.times - every / 2) * speed / radius
    drag = held.coefficients()[:, 0] / (1 + pi**2 / 12 / box[1] ** 2) ** 2
    return np.convolve(times, mean, "valid"), np.convolve(drag, mean, "valid")


def extreme(times: np.ndarray, drag: np.ndarray, between: tuple[float, float], sign: int) -> tuple[float, float]:
    """U t / R and C_D where `sign` C_D is greatest between two times."""
    kept = (times >= between[0]) & (times <= between[1])
    at = np.flatnonzero(kept)[np.argmax(sign * drag[kept])]
    return float(times[at]), float(drag[at])


def checks(cells: int, device: str):
    """Checks of one grid."""
    times, drag = drag_of_start(cells, device)
    (low_at, low), (high_at, high) = extreme(times, drag, EARLY, -1), extreme(times, drag, LATE, 1)
    yield about(f"greatest C_D, D = {cells}", high, GREATEST[1], ROOM)
    yield reported("at U t / R", high_at, GREATEST[0])
    yield reported("least C_D before", low, LEAST[1])
    yield reported("at U t / R", low_at, LEAST[0])
    yield reported(f"C_D at U t / R = {LEAST[0]:g}", float(np.interp(LEAST[0], times, drag)), LEAST[1])
    yield reported("blockage D / breadth, corrected", 1 / BOX[1])


SOURCE = "Koumoutsakos and Leonard 1995, as quoted"


# fmt: off
entry("impulsive_coarse", "An impulsively started cylinder at Re 550, 32 cells across.", partial(checks, 32),
      rung=5.5, grid="768 x 640 x 1, D = 32", source=SOURCE, cost="2 min")
entry("impulsive", "An impulsively started cylinder at Re 550, 128 cells across.", partial(checks, 128),
      rung=5.6, grid="3072 x 2560 x 1, D = 128", source=SOURCE, cost="GPU, 70 G updates", gpu=True)
# fmt: on
