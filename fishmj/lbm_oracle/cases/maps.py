"""Force maps: symmetries and invariances that hold for any forces.

    mirror      F(-AoA) = (F_x, -F_y, -M)                                    the fish has a left and a right
    square      broadside, F / U^2 is the same at two speeds
    towed       through still water = held in a stream                       Galileo
    turned      stream and fish together by 22.5 and 45 deg in the grid
    blockage    a box 1.5 times as large in every direction
    step        half the time step: half the Mach number
    grid        half the cell, reported: the bias of this one

The straight fish is held at an angle of attack of 30 deg, where drag, lateral force and yaw moment all matter. A difference is
that of the force vectors over the greater of the two. `maps_preview` does the same in a small coarse box for two seconds. A
shedding wake has no mean in that time, so it only reports. On the paper's grid the hull is three cells wide: the checks in
`COARSE` are reported there and judged by `maps_fine`, on half the cell. (`sphere_towed` tests Galileo with a steady wake.) The
water slides along the hull, as by default (`SLIP`).
"""

from dataclasses import replace
from functools import partial
from math import cos, pi, radians, sin
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.lbm_oracle.cases import below, entry, reported
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
from fishmj.water.flow import Flow

SOURCE = "symmetry; Galileo"
SLIP = 1.0
AOA, SPEED, SLOW = 30.0, 0.3, 0.2  # deg, m/s
COARSE = "towed", "step"  # what a hull three cells wide does not pass: the bias of the paper's grid, reported
TICK = 0.02  # s, over which a force is averaged before it is recorded


class Average(NamedTuple):
    """Statistics of one record: mean, its standard error, rms about the mean, all in the record's unit.

    `samples` is T / 2 T_c.
    """

    mean: float
    sem: float
    rms: float
    samples: float


def average(record) -> Average:
    """Mean and standard error of a correlated record (T,) of equal steps; NaN if it is empty, sem NaN for one sample.

        sem = s sqrt(2 T_c / T),   T_c = integral of the autocorrelation to its first zero

    Samples of a wake are not independent: s / sqrt(n) would be far too small.
    """
    x = np.asarray(record, float)
    n = len(x)
    if n == 0:
        return Average(np.nan, np.nan, np.nan, 0.0)
    mean, part = float(x.mean()), x - x.mean()
    rms = float(np.sqrt(np.mean(part**2)))
    if n == 1:
        return Average(mean, np.nan, 0.0, 1.0)
    if rms <= 1e-12 * max(abs(mean), 1e-300):  # a constant has no error and no time scale
        return Average(mean, 0.0, rms, float(n))
    steps = max(2 * float(autocorrelation(part).sum()) - 1, 1.0)  # 2 T_c in steps
    return Average(mean, rms * np.sqrt(min(steps / n, 1.0)), rms, n / steps)


def autocorrelation(part: np.ndarray) -> np.ndarray:
    """Autocorrelation of deviations from a mean (T,), or of several records (T, P) together, from 1 to before its first zero."""
    n = len(part)
    spectrum = np.abs(np.fft.rfft(part.reshape(n, -1), 2 * n, axis=0)) ** 2
    found = np.fft.irfft(spectrum, axis=0)[:n].sum(1) / np.arange(n, 0, -1)
    found /= found[0]
    return found[: int(np.argmax(found < 0)) or n]


class Load(NamedTuple):
    """Means over a record in the robot's frame (x ahead, y left): N, N, N m; `sem` of the force, N."""

    x: float
    y: float
    yaw: float
    sem: float

    @property
    def force(self) -> np.ndarray:
        """Horizontal force (2,) N."""
        return np.array([self.x, self.y])


class MapPlan(NamedTuple):
    """Box, seconds before and of the average at SPEED (more if slower), and the angles by which the grid is turned."""

    domain: Domain
    settle: float
    seconds: float


FULL = MapPlan(replace(preset("forcemap"), name="square", shape=(200, 200, 100)), 9.0, 20.0)
FINE = MapPlan(replace(preset("forcemap").changed(dx=0.01, dt=0.002), name="square", shape=(320, 320, 160)), 6.0, 12.0)
PREVIEW = MapPlan(replace(preset("laptop"), name="square", shape=(64, 64, 30)), 2.0, 2.0)


def load(
    plan: MapPlan, device: str, *, aoa: float = AOA, speed: float = SPEED, turn: float = 0.0, towed: bool = False, at=(0.0, 0.0)
) -> Load:
    """Mean load on a straight fish in a stream of `speed` m/s from `aoa` deg, both turned by `turn` deg in the grid.

    Towed: it moves at that speed through still water, in a window that follows. at: (2,) m, position at which it is held.
    """
    course = radians(turn)
    flow = Flow() if towed else Flow(speed=speed, direction=pi + course)
    domain = replace(plan.domain, follows=True)  # held, too: one place of the fish in its box
    heading = course - radians(aoa)
    held = SwimSetup(domain=domain, flow=flow, slip=SLIP, pose=(*at, heading), device=device).coupled()
    edge = DomainWatch(domain, heading)
    fixed, value = np.ones(held.body.dofs), np.zeros(held.body.dofs)
    if towed:
        value[:2] = speed * cos(course), speed * sin(course)
    steps, longer, record = round(TICK / domain.dt), SPEED / speed, []
    settle, seconds = (round(t * longer / TICK) for t in (plan.settle, plan.seconds))
    for _ in range(settle + seconds):
        for _ in range(steps):
            held.step(fixed, value)
            edge(held)
        record.append(held.take_wrench(TICK)[1])
    drag, lateral, moment = (average(column) for column in planar_load(held.body.data, heading, np.array(record[settle:])).T)
    return Load(drag.mean, lateral.mean, moment.mean, float(np.hypot(drag.sem, lateral.sem)))


def planar_load(data: mujoco.MjData, yaw: float, wrench: np.ndarray) -> np.ndarray:
    """Forces ahead and to the left, N, and moment about the reference point, N m, (T, 3), of a held fish at heading `yaw` rad.

    wrench: (T, L, 6) N and N m of its links, world frame.
    """
    arm = data.xpos[1:, :2] - data.qpos[:2]  # (L, 2)
    fx, fy = wrench[:, :, 0], wrench[:, :, 1]
    turn = (wrench[:, :, 5] + arm[:, 0] * fy - arm[:, 1] * fx).sum(1)
    fx, fy = fx.sum(1), fy.sum(1)
    return np.stack([cos(yaw) * fx + sin(yaw) * fy, cos(yaw) * fy - sin(yaw) * fx, turn], -1)


def relative_difference(one: Load, other: Load) -> float:
    """Difference of two force vectors, divided by the greater."""
    return float(np.linalg.norm(one.force - other.force) / max(np.linalg.norm(one.force), np.linalg.norm(other.force)))


def checks(plan: MapPlan, device: str, judged: bool = True, reported_only: tuple[str, ...] = (), finer: bool = False):
    """Checks in one box; without `judged` they are all reported, and those of `reported_only` in any case."""

    def within(quantity: str, value: float, limit: float):
        told = not judged or quantity.split(":")[0] in reported_only
        return reported(quantity, value) if told else below(quantity, value, limit)

    base = load(plan, device)
    yield reported("drag at 30 deg and 0.3 m/s, N", -base.x)
    yield reported("lateral force there, N", -base.y)
    yield reported("standard error of the force, N", base.sem)
    other = load(plan, device, aoa=-AOA)
    peak = float(np.linalg.norm(base.force))
    mirror = np.hypot(other.x - base.x, other.y + base.y) / peak
    yield within("mirror: difference of the forces", mirror, 0.02)
    yield within("mirror: sum of the yaw moments", abs(other.yaw + base.yaw) / abs(base.yaw), 0.02)
    slow, quick = (abs(load(plan, device, aoa=90.0, speed=speed).y) / speed**2 for speed in (SLOW, SPEED))
    yield within("square: F / U^2 broadside at 0.3 over that at 0.2 m/s, from 1", abs(quick / slow - 1), 0.1)
    yield within("towed: difference from held", relative_difference(load(plan, device, towed=True), base), 0.03)
    for turn in (22.5, 45.0):
        yield within(f"turned by {turn:g} deg: difference", relative_difference(load(plan, device, turn=turn), base), 0.05)
    x, y, z = (round(1.5 * n) for n in plan.domain.shape)
    larger = plan._replace(domain=replace(plan.domain, shape=(x, y, z)))
    yield within("blockage: difference in 1.5 times the box", relative_difference(load(larger, device), base), 0.03)
    shorter = plan._replace(domain=replace(plan.domain, dt=plan.domain.dt / 2))
    yield within("step: difference at half the time step", relative_difference(load(shorter, device), base), 0.03)
    if finer:
        fine = load(plan._replace(domain=plan.domain.changed(dx=plan.domain.dx / 2)), device)
        yield reported("grid: drag over that at half the cell", base.x / fine.x, 1.0)
        yield reported("grid: lateral force over that at half the cell", base.y / fine.y, 1.0)


# fmt: off
entry("maps_preview", "Symmetries and invariances of a force map, in a small box.", partial(checks, PREVIEW, judged=False),
      rung=17, grid="64 x 64 x 30, dx = 2 cm, 4 s", source=SOURCE, cost="3 min", gpu=True)
entry("maps", "Symmetries and invariances of a force map.", partial(checks, FULL, reported_only=COARSE, finer=True),
      rung=17.1, grid="200 x 200 x 100, dx = 2 cm, 29 s", source=SOURCE, cost="GPU, 500 G updates", gpu=True)
entry("maps_fine", "The same on the grid that judges by default.", partial(checks, FINE),
      rung=17.2, grid="320 x 320 x 160, dx = 1 cm, 18 s", source=SOURCE, cost="GPU, 2500 G updates", gpu=True)
# fmt: on
