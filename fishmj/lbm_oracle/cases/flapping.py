"""An ellipse that hovers: it swings to and fro and turns, Re = U c / nu = 75, in a closed box, a strip one cell deep.

    x = A0 / 2 cos(w t),   alpha = pi / 2 + pi / 4 sin(w t),   A0 = 2.8 c,   w = 2 pi f,   U = pi f A0
    C_D = -sign(u) F_x / max D,   C_L = F_y / max L,   D, L = 1/2 rho v^2 (1.4 - cos 2 a, 1.2 sin 2 a)

alpha is the angle of the chord to the stroke, a that to the motion; v the speed of the fastest point of the chord. D and L are
the quasi-steady forces, and the denominators their greatest values in a period, as in the source. Thickness 0.10 c. The force is
that on an ellipse without water inside: the markers accelerate the water inside, and its momentum is subtracted.

If the ellipse is too thin for two rows of markers they become one row, as on a fish.

Sources: a robotic wing in oil, Wang, Birch and Dickinson 2004, J. Exp. Biol. 207:449, and a vortex particle code, Eldredge 2007,
J. Comput. Phys. 221:626, both as kept by O. Mesnard's petibm-flapping (BSD 3-Clause), `data/{CL,CD}_{EXP,VVPM}.dat`; kinematics
and denominators: `src/python/flapping.py` there. Both records are means over fiftieths of a period here, the third period first,
interpolated linearly between the points of the source. At the turns of the stroke the drag changes its sign abruptly, and the
records differ in the time of this: only the rms of the lift is gated.
"""

from collections.abc import Callable
from functools import partial
from math import pi

import numpy as np

from fishmj.lbm_oracle.cases import about, below, entry, register, reported
from fishmj.lbm_oracle.immersed.markers import CLAMP, SHEET, Markers, offset_of
from fishmj.lbm_oracle.immersed.shapes import BodyShape
from fishmj.lbm_oracle.scene import Scene

REYNOLDS, SWING, THICKNESS, TURN = 75.0, 2.8, 0.10, pi / 4
FASTEST = 0.08  # lattice units, of the middle of the chord
SAMPLES, PERIODS = 50, 4  # means a period; the last two periods are judged
TANK = {"C_L": 0.431, "C_D": 0.683, "greatest C_L": 1.006}  # Wang et al. 2004, means over the last two of four periods
VORTEX = {"C_L": 0.488, "C_D": 0.715, "greatest C_L": 1.255}  # Eldredge 2007, the same
LIFT, DRAG = (0.41, 0.52), (0.65, 0.76)  # of the means: tank and vortex code with 5 % about them; set before the first run
RMS = 0.12  # of C_L from the vortex code; tank and vortex code are 0.15 from each other
COARSE = 0.2  # of the means, with sixteen cells a chord
# fmt: off
VORTEX_LIFT = np.array([
    0.22, 0.33, 0.44, 0.51, 0.56, 0.52, 0.46, 0.37, 0.33, 0.31, 0.39, 0.52, 0.72, 0.9, 1.0, 1.07, 1.04, 0.94, 0.76, 0.55,
    0.32, 0.15, 0.05, 0.03, 0.07, 0.16, 0.26, 0.33, 0.36, 0.36, 0.31, 0.24, 0.21, 0.22, 0.28, 0.42, 0.61, 0.88, 1.1, 1.19,
    1.23, 1.18, 1.02, 0.79, 0.48, 0.25, 0.09, 0.02, 0.03, 0.09,
    0.19, 0.33, 0.46, 0.53, 0.6, 0.57, 0.51, 0.42, 0.36, 0.34, 0.41, 0.53, 0.73, 0.91, 0.97, 0.97, 0.9, 0.77, 0.6, 0.4,
    0.2, 0.08, 0.01, 0.0, 0.04, 0.13, 0.22, 0.3, 0.36, 0.38, 0.34, 0.27, 0.24, 0.26, 0.34, 0.48, 0.65, 0.92, 1.13, 1.21,
    1.23, 1.14, 1.0, 0.78, 0.48, 0.25, 0.09, 0.01, 0.01, 0.1,
])
VORTEX_DRAG = np.array([
    0.61, 1.35, 1.38, 1.36, 1.33, 1.21, 1.02, 0.9, 0.81, 0.76, 0.8, 0.87, 0.99, 1.12, 1.16, 1.2, 1.18, 1.11, 0.96, 0.75,
    0.48, 0.14, -0.24, -0.55, -0.78, 0.58, 1.06, 1.07, 1.03, 0.98, 0.88, 0.74, 0.68, 0.69, 0.73, 0.8, 0.93, 1.09, 1.21, 1.26,
    1.28, 1.23, 1.12, 0.91, 0.58, 0.21, -0.15, -0.49, -0.8, -1.06,
    0.43, 1.34, 1.37, 1.36, 1.3, 1.2, 1.04, 0.92, 0.84, 0.78, 0.8, 0.89, 1.01, 1.09, 1.11, 1.12, 1.06, 0.99, 0.82, 0.59,
    0.28, -0.03, -0.38, -0.63, -0.81, 0.34, 1.07, 1.07, 1.04, 0.97, 0.87, 0.76, 0.73, 0.73, 0.76, 0.82, 0.95, 1.14, 1.25, 1.29,
    1.3, 1.25, 1.13, 0.89, 0.56, 0.2, -0.18, -0.57, -0.78, -1.07,
])
# fmt: on


def section_markers(front: float, rear: float, half: Callable[[np.ndarray], np.ndarray]) -> Markers:
    """A closed section one cell deep about the x axis of link 0, markers about a cell apart, drawn in by the kernel's offset.

    Args:
        front, rear: its ends along x, cells. half: half its thickness at x (N,), cells.
    """
    inset = offset_of(3)
    low, high = front + inset, rear - inset
    n = max(2, round(high - low))
    ds = (high - low) / n
    x = low + ds * (np.arange(n) + 0.5)
    drawn_in = lambda x: half(x) - np.minimum(inset, CLAMP * half(x))
    drawn = drawn_in(x)
    slope = (half(x + 1e-4) - half(x - 1e-4)) / 2e-4
    two = drawn >= SHEET
    size = np.sqrt(1 + slope[two] ** 2)
    zero, one = 0 * size, np.ones(n)
    place = [np.stack([x[two], side * drawn[two], zero], -1) for side in (1.0, -1.0)]
    normal = [np.stack([-slope[two], side + zero, zero], -1) / size[:, None] for side in (1.0, -1.0)]
    area, sheet = [ds * size, ds * size], [zero > 0, zero > 0]
    row = ~two
    place.append(np.stack([x, 0 * x, 0 * x], -1)[row])
    normal.append(np.stack([0 * x, one, 0 * x], -1)[row])
    area.append(ds * one[row])
    sheet.append(one[row] > 0)
    for end, ahead in ((low, -1.0), (high, 1.0)):  # a blunt end is closed by a column of markers
        blunt = float(drawn_in(np.array([end]))[0])
        if blunt >= SHEET:
            m = round(2 * blunt)
            column = blunt * (2 * (np.arange(m) + 0.5) / m - 1)
            place.append(np.stack([end + 0 * column, column, 0 * column], -1))
            normal.append(np.broadcast_to([ahead, 0.0, 0.0], (m, 3)))
            area.append(np.full(m, 2 * blunt / m))
            sheet.append(np.zeros(m, bool))
    return Markers.rigid(*(np.concatenate(parts) for parts in (place, normal, area)), sheet=np.concatenate(sheet))


def ellipse_markers(cells: int, thickness: float = THICKNESS) -> Markers:
    """An ellipse of `cells` cells along x, its middle at the origin of link 0."""
    a, b = cells / 2, thickness * cells / 2
    return section_markers(-a, a, lambda x: b * np.sqrt(np.maximum(1 - (x / a) ** 2, 0.0)))


def ellipse(cells: int) -> BodyShape:
    """An ellipse of `cells` cells along x, full of water."""
    volume = pi / 4 * THICKNESS * cells**2
    inertia = np.eye(3) * volume * (1 + THICKNESS**2) * cells**2 / 16
    make = lambda dx: ellipse_markers(cells)
    return BodyShape(name="ellipse", markers=make, size=cells, area=cells, volume=volume, inertia=inertia, flat=True)


def stroke(phase):
    """Position of the middle in chords, and angle of the chord, at phases in periods."""
    return SWING / 2 * np.cos(2 * pi * np.asarray(phase)), pi / 2 + TURN * np.sin(2 * pi * np.asarray(phase))


def denominators(points: int = 201, phases: int = 2000) -> tuple[float, float]:
    """Greatest quasi-steady lift and drag of a period over rho U^2 c, over the points of the chord."""
    phase = (np.arange(phases) + 0.5)[:, None] / phases
    s = np.linspace(-0.5, 0.5, points)
    _, alpha = stroke(phase)
    u, spin = -np.sin(2 * pi * phase), 2 / SWING * TURN * np.cos(2 * pi * phase)  # in U = pi f A0 and chords
    v2 = (u - spin * s * np.sin(alpha)) ** 2 + (spin * s * np.cos(alpha)) ** 2
    a = np.where(u <= 0, pi - alpha, alpha)
    return float((0.5 * v2 * 1.2 * np.sin(2 * a)).max()), float((0.5 * v2 * (1.4 - np.cos(2 * a))).max())


def hover(cells: int, device: str, *, box: float = 30.0, periods: int = PERIODS, samples: int = SAMPLES) -> np.ndarray:
    """C_L and C_D of the ellipse, (periods samples, 2), each the mean over its part of a period."""
    every = round(pi * SWING * cells / FASTEST / samples)
    steps = every * samples  # a period
    speed = pi * SWING * cells / steps  # U in lattice units that whole steps make of it
    wall = Scene((box * cells, box * cells), 1.0, speed * cells / REYNOLDS, rho=1.0, dt=1.0, sides="wall", device=device)
    path = lambda step: np.array([1.0, 0.0, 0.0]) * stroke(step / steps)[0] * cells + [0.0, 0.0, stroke(step / steps)[1]]
    place = np.array(wall.extent) / 2 + [0.7, 0.2]
    wall.add(ellipse(cells), place, joints=("slide x", "slide y", "hinge z"), motion=path)
    force = wall.run(periods * steps, every).wrench[:, 0, :2] / (speed**2 * cells)
    lift, drag = denominators()
    ahead = np.where((np.arange(periods * samples) % samples) * 2 < samples, 1.0, -1.0)  # it moves towards -x first
    return np.stack([force[:, 1] / lift, ahead * force[:, 0] / drag], -1)


SOURCE = "Wang et al. 2004 and Eldredge 2007, as kept by petibm-flapping"


def checks(cells: int, device: str, lift: tuple[float, float], drag: tuple[float, float], rms: float | None, **options):
    """Checks of one size."""
    record = hover(cells, device, **options)
    last = record[-2 * SAMPLES :]
    for i, (name, room) in enumerate({"C_L": lift, "C_D": drag}.items()):
        middle = sum(room) / 2
        mean = last[:, i].mean()
        yield about(f"mean {name} of the last two periods, c = {cells}", mean, middle, room[1] - middle, absolute=True)
        yield reported(f"the same of the robotic wing; of the vortex code {VORTEX[name]:g}", TANK[name])
    off = np.sqrt(np.mean((last - np.stack([VORTEX_LIFT, VORTEX_DRAG], -1)) ** 2, 0))
    name = f"rms of C_L from the vortex code, c = {cells}"
    yield reported(name, off[0]) if rms is None else below(name, off[0], rms)
    yield reported("rms of C_D from the vortex code", off[1])
    yield reported("greatest C_L; of the robotic wing 1.006", last[:, 0].max(), VORTEX["greatest C_L"])
    before = record[-4 * SAMPLES : -2 * SAMPLES]
    if len(before) == len(last):
        yield reported("mean C_L of the two periods before", before[:, 0].mean())


def range_about(reference: float, room: float) -> tuple[float, float]:
    """The range of `room` about a reference."""
    return (1 - room) * reference, (1 + room) * reference


@register("flapping_coarse", rung=19, grid="256 x 256 x 1, c = 16, box 16 c", source=SOURCE, cost="1 min")
def flapping_coarse(device):
    """A hovering ellipse at Re 75, sixteen cells a chord."""
    means = (range_about(0.5 * (TANK[name] + VORTEX[name]), COARSE) for name in ("C_L", "C_D"))
    yield from checks(16, device, *means, None, box=16.0)


# fmt: off
entry("flapping", "A hovering ellipse at Re 75.", partial(checks, 32, lift=LIFT, drag=DRAG, rms=RMS),
      rung=19.1, grid="960 x 960 x 1, c = 32", source=SOURCE, cost="GPU, 13 G updates", gpu=True)
entry("flapping_fine", "The same ellipse, 48 cells a chord.", partial(checks, 48, lift=LIFT, drag=DRAG, rms=RMS),
      rung=19.2, grid="1440 x 1440 x 1, c = 48", source=SOURCE, cost="GPU, 44 G updates", gpu=True)
# fmt: on
