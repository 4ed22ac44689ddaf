"""A round fin that rolls about the stream and pitches about its span, Re = U c / nu = 200, aspect ratio S^2 / A = 1.27.

    roll  phi = -45 deg cos(w t),    pitch  theta = -45 deg cos(w t + psi),    w = 2 pi f,   f = St U / (2 A_phi S / 2)
    C_T, C_L, C_Z = 2 (-F_x, F_y, F_z) / (rho U^2 A),   A = pi c S / 4,   eta = mean T U / mean P

S = pi c AR / 4 is the span from the hinge, at the root, to the tip; P is the power that the fin gives to the water. The sources
average only its positive part, over the time in which it is positive: `eta` here does the same, and `eta of all` uses the mean
of the whole cycle. Theirs is the power of pressure, this one of the whole force. The fifth cycle is judged.

The fin is a sheet of equal areas in a golden spiral, drawn in by the offset of the kernel. Box 8 x 6 x 6 c, open in x and y,
free slip above and below; the hinge 2.8 c behind the inflow. The speed of the fastest marker is the same for every St.

Thin sheets make too little thrust on coarse grids (PetIBM: 0.442, 0.914, 0.986 with 33, 100 and 200 cells a chord). Judged is
therefore the extrapolation from two grids for an error of first order in the cell (`plate.py`): 16 and 32 cells a chord with the
sharper boundary (`SHARP`, which was chosen on other cases). Over St and phase the trends of these limits are judged.

Source: PetIBM's replication of Li and Dong 2016, Phys. Fluids 28:071901: Mesnard and Barba, barbagroup/rescience-rollingpitching,
`content.tex`, table of the grid study, and the results in `runs/*/README.md` of mesnardo/petibm-rollingpitching (BSD 3-Clause).
The two codes differ by 48 % in thrust (0.986 on the finest grid of the one, 1.462 in the other), so this case is a third opinion.
It is compared with PetIBM, whose body is also a sheet.
"""

from math import ceil, pi, radians
from typing import Any, NamedTuple

import numpy as np

from fishmj.lbm_oracle.cases import about, above, below, register, reported
from fishmj.lbm_oracle.cases.plate import limit
from fishmj.lbm_oracle.immersed.markers import PLAIN, SHARP, Markers, Sharpness
from fishmj.lbm_oracle.immersed.shapes import BodyShape
from fishmj.lbm_oracle.scene import Scene

REYNOLDS, ASPECT, SWING = 200.0, 1.27, radians(45.0)
SPAN = pi * ASPECT / 4  # chords
AREA = pi / 4 * SPAN  # chords squared
FASTEST = 0.11  # lattice units, of the tip
SAMPLES, CYCLES = 100, 5
BOX = (8.0, 6.0, 6.0)  # chords
# mean C_T, rms C_L, rms C_Z, eta at St 0.6, psi 90 deg
FINEST = (0.986, 2.817, 1.600, 0.1727)  # PetIBM, 200 cells a chord
LI_DONG = (1.462, 3.417, 1.912, 0.1927)
BY_ST = {0.4: -0.061, 0.6: 0.914, 0.8: 2.554, 1.0: 4.880, 1.2: 7.905}  # C_T at psi 90 deg, 100 cells a chord
BY_PHASE = {60: 0.211, 70: 0.459, 80: 0.684, 90: 0.914, 100: 1.131, 110: 1.328, 120: 1.490}  # C_T at St 0.6
ETA_BY_PHASE = {60: 0.0296, 70: 0.0758, 80: 0.1236, 90: 0.1635, 100: 0.1814, 110: 0.1772, 120: 0.1603}
THRUST, LIFT, SPANWISE = 0.10, 0.05, 0.08  # of the limits from PetIBM's finest grid; tolerances set before the first run
TREND = 0.15  # of differences of C_T between St and between phases


class Cycle(NamedTuple):
    """One cycle of the fin, (SAMPLES, ..): coefficients of thrust, lift and spanwise force, and power over rho U^3 A / 2."""

    force: np.ndarray  # (SAMPLES, 3)
    power: np.ndarray  # (SAMPLES,)

    @property
    def thrust(self) -> float:
        """Mean thrust coefficient."""
        return float(self.force[:, 0].mean())

    @property
    def rms(self) -> np.ndarray:
        """Root mean square (3,) of the three coefficients."""
        return np.sqrt(np.mean(self.force**2, 0))

    @property
    def efficiency(self) -> float:
        """Efficiency as in the sources: thrust over the mean of the positive power."""
        return self.thrust / float(self.power[self.power > 0].mean())

    @property
    def whole_efficiency(self) -> float:
        """Efficiency with the mean power of the whole cycle."""
        return self.thrust / float(self.power.mean())


def fin_markers(cells: int, sharpness: Sharpness = PLAIN) -> Markers:
    """The elliptical sheet in x and z, its root at the origin of link 0, markers about a cell apart."""
    _, inset = sharpness.insets()
    a, b = cells / 2 - inset, SPAN * cells / 2 - inset
    n = ceil(pi * a * b)
    r, turn = np.sqrt((np.arange(n) + 0.5) / n), pi * (3 - 5**0.5) * np.arange(n)
    place = np.stack([a * r * np.cos(turn), 0 * r, SPAN * cells / 2 + b * r * np.sin(turn)], -1)
    return Markers.rigid(place, np.broadcast_to([0.0, 1.0, 0.0], (n, 3)), pi * a * b / n, sheet=True, sharpness=sharpness)


def angles(phase, lag: float) -> np.ndarray:
    """Angles of the two hinges, (.., 2) rad, at phases in cycles: about x, then about the span; `lag` is psi, rad."""
    turn = 2 * pi * np.asarray(phase)
    return SWING * np.stack([np.cos(turn), np.cos(turn + lag)], -1)  # both axes point against those of the source


def greatest_rim_speed(strouhal: float, lag: float) -> float:
    """Greatest speed of the fin's rim over U."""
    turn = 2 * pi * (np.arange(400) + 0.5)[:, None] / 400
    rim = 2 * pi * np.arange(200) / 200
    x, z = 0.5 * np.cos(rim), 0.5 * SPAN * (1 + np.sin(rim))
    rate = -2 * pi * strouhal / (SWING * SPAN) * SWING
    roll, pitch, lean = rate * np.sin(turn), rate * np.sin(turn + lag), SWING * np.cos(turn + lag)
    # in the rolling frame: (x cos, x sin, z) turned by the pitch, and the roll about x
    fast = (pitch * x * np.sin(lean)) ** 2 + (pitch * x * np.cos(lean) - roll * z) ** 2 + (roll * x * np.sin(lean)) ** 2
    return float(np.sqrt(fast.max()))


def flap(
    cells: int,
    strouhal: float,
    psi: float,
    device: str,
    *,
    box=BOX,
    cycles: int = CYCLES,
    samples: int = SAMPLES,
    sharpness: Sharpness = PLAIN,
) -> list[Cycle]:
    """All cycles of a fin of `cells` cells a chord from rest in a uniform stream; psi in deg."""
    lag, frequency = radians(psi), strouhal / (SWING * SPAN)  # of U / c
    every = round(greatest_rim_speed(strouhal, lag) * cells / (frequency * FASTEST) / samples)
    steps = every * samples
    stream = cells / (frequency * steps)
    options: dict[str, Any] = {"sides": "open", "sponge": max(8, cells // 2), "device": device}
    driven = Scene(np.multiply(box, cells), 1.0, stream * cells / REYNOLDS, stream, rho=1.0, dt=1.0, **options)
    hinge = np.multiply(driven.extent, [0.35, 0.5, 0.5]) - [0.0, 0.0, SPAN * cells / 2] + [0.7, 0.2, 0.1]  # off the nodes
    area, make = AREA * cells**2, lambda dx: fin_markers(cells, sharpness)
    fin = BodyShape(name="fin", markers=make, size=cells, area=area)
    driven.add(fin, hinge, joints=("hinge x", "hinge z"), motion=lambda step: angles(step / steps, lag))
    wrench = driven.run(cycles * steps, every).wrench[:, 0].reshape(cycles, samples, 6)
    middle = every * (np.arange(samples) + 0.5) // 1
    roll, spin = angles(middle / steps, lag)[:, 0], angles((middle + 1) / steps, lag) - angles(middle / steps, lag)
    span = np.stack([0 * roll, -np.sin(roll), np.cos(roll)], -1)
    about_world = spin[:, :1] * [1.0, 0.0, 0.0] + spin[:, 1:] * span
    power = -(wrench[..., 3:] * about_world).sum(-1) / (0.5 * stream**3 * area)
    return [Cycle(*pair) for pair in zip(wrench[..., :3] * [-1, 1, 1] / (0.5 * stream**2 * area), power, strict=True)]


def figures(cells: int, cycle: Cycle, strouhal: float, psi: float):
    """Checks that report a cycle's values beside the published ones."""
    label = f"at St {strouhal:g}, psi {psi:g} deg, c = {cells}"
    yield reported(f"eta {label}", cycle.efficiency, ETA_BY_PHASE[round(psi)] if strouhal == 0.6 else np.nan)
    yield reported(f"eta of all {label}", cycle.whole_efficiency)


SOURCE = "Mesnard and Barba's replication of Li and Dong 2016 with PetIBM"


@register(
    "rolling_fin_coarse", rung=20, grid="40 x 32 x 32 and 60 x 48 x 48, c = 8 and 12, two cycles", source=SOURCE, cost="1 min"
)
def rolling_fin_coarse(device):
    """A rolling and pitching fin at Re 200 and St 0.8, eight and twelve cells a chord: as often left as right, thrust grows."""
    coarse, fine = (flap(cells, 0.8, 90, device, box=(5.0, 4.0, 4.0), cycles=2, samples=40)[-1] for cells in (8, 12))
    yield below("mean C_L over its rms, c = 12", abs(fine.force[:, 1].mean()) / fine.rms[1], 0.1)
    yield above("mean power, c = 12", float(fine.power.mean()), 0.0)
    yield above("C_T of c = 12 less that of c = 8", fine.thrust - coarse.thrust, 0.0)
    yield reported("C_T in the limit of the two", float(limit(8, coarse.thrust, 12, fine.thrust)), BY_ST[0.8])


@register("rolling_fin", rung=20.1, grid="128 x 96 x 96 and 256 x 192 x 192, c = 16 and 32", source=SOURCE,
          cost="GPU, 430 G updates", gpu=True)  # fmt: skip
def rolling_fin(device):
    """A rolling and pitching fin at Re 200 over St and phase."""
    thrust, by_phase, eta = {}, {}, {}
    for strouhal, psi in ((0.4, 90), (0.6, 90), (0.8, 90), (0.6, 80), (0.6, 100), (0.6, 110)):
        made = {}
        for cells in (16, 32):
            *_, before, last = flap(cells, strouhal, psi, device, sharpness=SHARP)
            made[cells] = np.array([last.thrust, last.efficiency])
            there = f"at St {strouhal:g}, psi {psi} deg, c = {cells}"
            yield reported(f"C_T {there}", last.thrust, BY_ST[strouhal] if psi == 90 else BY_PHASE[psi])
            yield reported(f"C_T of the cycle before {there}", before.thrust)
            yield from figures(cells, last, strouhal, psi)
        pushed, efficiency = limit(16, made[16], 32, made[32])
        if psi == 90:
            thrust[strouhal] = pushed
        if strouhal == 0.6:
            by_phase[psi], eta[psi] = pushed, efficiency
    low, high = thrust[0.4], thrust[0.6]
    yield about("St at which the thrust begins (PetIBM 0.41)", 0.4 - 0.2 * low / (high - low), 0.5, 0.1, absolute=True)
    steps = {st: BY_ST[st] - BY_ST[0.4] for st in (0.6, 0.8)}
    for strouhal, step in steps.items():
        yield about(f"C_T at St {strouhal:g} less that at 0.4", thrust[strouhal] - thrust[0.4], step, TREND)
    yield about("C_T at psi 110 deg less that at 80", by_phase[110] - by_phase[80], BY_PHASE[110] - BY_PHASE[80], TREND)
    best = max(eta, key=lambda psi: eta[psi])
    yield about("psi of the best eta among 80, 90, 100, 110, deg", best, 105, 5, absolute=True)


@register("rolling_fin_grid", rung=20.2, grid="128 x 96 x 96 and 256 x 192 x 192, c = 16 and 32", source=SOURCE,
          cost="GPU, 70 G updates", gpu=True)  # fmt: skip
def rolling_fin_grid(device):
    """The same fin at St 0.6, 16 and 32 cells a chord, where its forces lead to."""
    found = {}
    for cells in (16, 32):
        *_, before, last = flap(cells, 0.6, 90, device, sharpness=SHARP)
        found[cells] = np.array([last.thrust, *last.rms[1:]])
        for name, value, reference in zip(("C_T", "rms C_L", "rms C_Z"), found[cells], FINEST, strict=False):
            yield reported(f"{name}, c = {cells}", value, reference)
        yield reported(f"C_T of the cycle before, c = {cells}", before.thrust)
        yield from figures(cells, last, 0.6, 90)
        if cells == 32:
            thrust, lift, spanwise = limit(16, found[16], 32, found[32])
            yield about("C_T in the limit", thrust, FINEST[0], THRUST)
            yield about("rms C_L in the limit", lift, FINEST[1], LIFT)
            yield about("rms C_Z in the limit", spanwise, FINEST[2], SPANWISE)
            yield reported("C_T in the limit beside Li and Dong's", thrust, LI_DONG[0])
