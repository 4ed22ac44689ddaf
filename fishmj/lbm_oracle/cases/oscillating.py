"""A cylinder that swings along x in still water: KC = U / (f D) = 5, Re = U D / nu = 100, in a strip one cell deep.

    x = -A sin(2 pi f t),  A = KC D / (2 pi);    F = -1/2 rho D C_D |u| u - rho pi D^2 / 4 C_I du/dt        Morison

The force is that on a rod that holds no water, as the experiment's. The reference is read off a figure: eleven points of the
in-line force over a period, in rho U^2 D, kept in the folder validation-data of the public solver cuIBM (a fork by C. Minar, file
osc_Re100_KC5_Dutsch.txt, read 2026-11-20); that the figure has twice the coefficient's denominator is confirmed by the same
case among Basilisk's. Both records give their Morison coefficients by the same fit at the same phases.

Source: Duetsch, Durst, Becker and Lienhart 1998, J. Fluid Mech. 360:249, fig. 10; its coefficients 2.09 and 1.45 were not read.
"""

from functools import partial
from math import pi

import numpy as np

from fishmj.lbm_oracle.cases import about, entry, reported
from fishmj.lbm_oracle.cases.cylinder import cylinder

KC, REYNOLDS, SPEED = 5.0, 100.0, 0.06  # greatest speed in lattice units
PHASE = np.array([0.0, 0.1, 0.2, 0.3, 0.3993, 0.5, 0.6, 0.7, 0.8, 0.8993])  # of the period, u = -U at 0
FORCE = np.array([1.0018, -0.0176, -1.1072, -1.6063, -1.6063, -1.0580, 0.0457, 1.0931, 1.5993, 1.6063])  # rho U^2 D


def swing(cells: int, periods: int, device: str, *, box: float = 16.0, samples: int = 200) -> np.ndarray:
    """In-line force on a swinging cylinder of `cells` cells over its last period, (samples,) in rho U^2 D, from u = -U on."""
    every = max(1, round(KC * cells / SPEED / samples))
    steps = every * samples  # a period
    speed = KC * cells / steps  # that whole steps make of it
    path = lambda step: (-KC * cells / (2 * pi) * np.sin(2 * pi * step / steps), 0.0)
    still = cylinder(cells, SPEED, REYNOLDS, (box, box), (0.5, 0.5), device, sides="wall", motion=path)
    return still.run(periods * steps, every).wrench[-samples:, 0, 0] / (speed**2 * cells)


def at(phase: np.ndarray, force: np.ndarray) -> np.ndarray:
    """A periodic record (n,) of means over its n parts, at phases in periods."""
    n = len(force)
    return np.interp(np.asarray(phase) * n - 0.5, np.arange(-1, n + 1), np.concatenate([force[-1:], force, force[:1]]))


def morison(phase: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """C_D and C_I that fit a force in rho U^2 D at phases in periods best, u = -U cos, du/dt = U omega sin."""
    c, s = np.cos(2 * pi * phase), np.sin(2 * pi * phase)
    terms = np.stack([0.5 * np.abs(c) * c, -(pi**2) / (2 * KC) * s], -1)
    drag, inertia = np.linalg.lstsq(terms, force, rcond=None)[0]
    return float(drag), float(inertia)


def checks(cells: int, periods: int, device: str, room: float):
    """The checks of one size."""
    record = swing(cells, periods, device)
    found, read = morison(PHASE, at(PHASE, record)), morison(PHASE, FORCE)
    for name, one, other in zip(("C_D", "C_I"), found, read, strict=True):
        yield about(f"{name} of Morison, D = {cells}", one, other, room)
    yield reported("greatest force over the figure's", np.abs(record).max() / np.abs(FORCE).max(), 1.0)
    yield reported("rms difference at its points, rho U^2 D", np.sqrt(np.mean((at(PHASE, record) - FORCE) ** 2)))
    phase = (np.arange(len(record)) + 0.5) / len(record)
    for name, one, other in zip(("C_D", "C_I"), morison(phase, record), (2.09, 1.45), strict=True):
        yield reported(f"{name} over the whole period", one, other)


SOURCE = "Duetsch et al. 1998, fig. 10, as digitised in cuIBM's validation-data"


# fmt: off
entry("oscillating_coarse", "A cylinder that swings in still water, twelve cells across.", partial(checks, 12, 5, room=0.1),
      rung=8, grid="192 x 192 x 1, D = 12", source=SOURCE, cost="40 s")
entry("oscillating", "A cylinder that swings in still water.", partial(checks, 24, 6, room=0.05),
      rung=8.1, grid="384 x 384 x 1, D = 24", source=SOURCE, cost="5 min", gpu=True)
# fmt: on
