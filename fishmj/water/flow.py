"""Background flow: a mean current plus turbulence, defined once for all waters.

    U(x, t) = U_mean + u'(x - U_mean t)                                   frozen advection (Taylor 1938)
    E(k) ~ (k/ke)^4 / (1 + (k/ke)^2)^(17/6),  ke = 0.7468 / L             von Karman 1948, doi 10.1073/pnas.34.11.530
    TI = u_rms / max(U, 0.1 m/s), u_rms per component

u' is a periodic table with unit variance. A realisation is a random slice, offset and rotation in it, so a `Flow` is
reproducible from its seed and equal on every engine. Presets: `default` (L = 0.3 m), `fine` (L = 0.1 m), `gust` (uniform in
space, Ornstein-Uhlenbeck in time, tau = 1.5 s), `vortex_street`, `shear`, `none`. Different `box` numbers give statistically
independent tables: training, tuning and judging use different ones.
"""

from dataclasses import dataclass
from functools import cache
from math import pi
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import TURN, checked, checked_name

PRESETS = ("default", "fine", "gust", "vortex_street", "shear", "none")
_LENGTHS = {"default": "length", "fine": "length_fine", "vortex_street": "length_street", "shear": "length_shear"}
LENGTH: dict[str, float] = {preset: constant("turbulence", key) for preset, key in _LENGTHS.items()}  # m
GUST_TAU: float = constant("turbulence", "gust_time")  # s
TICK: float = constant("timing", "bus_dt")  # s, time step of gust tables and of flow sampling in the batched engines
_FLOOR: float = constant("turbulence", "speed_floor")  # m/s
_CELLS = 64  # grid points along each side of the box; box side = 8 L
_GUST_ROWS, _GUST_TICKS = 64, 4096
LIMITS = {"speed": (0, 4.999), "direction": TURN, "intensity": (0, 0.999), "seed": (0,), "box": (0,)}  # of a `Flow`
BOXES = {"train": 0, "tune": 1, "judge": 2}


class Current(NamedTuple):
    """Background flow of a batch of B fish; array leaves of NumPy or JAX.

    `table` has unit variance: (S, n, n, 2) for spatial turbulence, (S, T, 2) for gusts.
    """

    mean: Any  # (B, 2) m/s, world frame
    rms: Any  # (B,) m/s
    row: Any  # (B,) int, slice of the table
    offset: Any  # (B, 2) cells (gust: ticks in the first column)
    turn: Any  # (B, 2) cos and sin of the table's rotation
    table: Any  # shared by the batch
    cell: Any  # m, scalar; for gusts 1 tick


@cache
def solenoidal_box(length: float, box: int) -> np.ndarray:
    """Periodic divergence-free von Karman field, (n, n, n, 3) float32 over (z, x, y), unit variance a component."""
    n, side = _CELLS, 8 * length
    rng = np.random.default_rng([20210, box, int(round(length * 1e4))])
    noise = np.fft.rfftn(rng.standard_normal((3, n, n, n)), axes=(1, 2, 3))
    full, half = np.fft.fftfreq(n, 1 / n), np.fft.rfftfreq(n, 1 / n)
    k = np.stack(np.meshgrid(full, full, half, indexing="ij")) * (2 * pi / side)  # (z, x, y)
    k2 = np.maximum(np.sum(k * k, 0), 1e-12)
    ke = 0.7468 / length
    energy = (k2 / ke**2) ** 2 / (1 + k2 / ke**2) ** (17 / 6)
    amplitude = np.sqrt(energy / k2)  # spectral density of each mode ~ E(k) / k^2
    amplitude[0, 0, 0] = 0.0
    noise -= k * np.sum(k * noise, 0) / k2  # projection: div u' = 0
    field = np.fft.irfftn(noise * amplitude, s=(n, n, n), axes=(1, 2, 3))
    field /= np.sqrt(np.mean(field**2))
    return np.ascontiguousarray(np.moveaxis(field[[1, 2, 0]], 0, -1).astype(np.float32))  # components (x, y, z)


@cache
def gust_table(box: int) -> np.ndarray:
    """Periodic Ornstein-Uhlenbeck gusts, (rows, ticks, 2) float32, unit variance a component."""
    rng = np.random.default_rng([20211, box])
    noise = np.fft.rfft(rng.standard_normal((_GUST_ROWS, 2, _GUST_TICKS)))
    decay = np.exp(-TICK / GUST_TAU)
    omega = 2 * pi * np.fft.rfftfreq(_GUST_TICKS)
    series = np.fft.irfft(noise / np.abs(1 - decay * np.exp(-1j * omega)), _GUST_TICKS)
    series /= np.sqrt(np.mean(series**2))
    return np.ascontiguousarray(np.moveaxis(series, 1, -1).astype(np.float32))


def _street(length: float) -> np.ndarray:
    """Staggered vortex street (Kochin's stable spacing) of Gaussian vortices, periodic, (1, n, n, 2)."""
    n, side, ratio = _CELLS, 8 * length, constant("turbulence", "street_spacing")
    grid = np.arange(n) / n * side
    x, y = np.meshgrid(grid, grid, indexing="ij")
    spacing = side / 4
    core = 0.25 * length
    u, v = np.zeros((n, n)), np.zeros((n, n))
    for i in range(4):
        for sign, lead, height in ((1, 0.0, 0.5 * ratio), (-1, 0.5, -0.5 * ratio)):
            dx = (x - (i + lead) * spacing + side / 2) % side - side / 2
            dy = (y - side / 2 - height * spacing + side / 2) % side - side / 2
            swirl = sign * np.exp(-(dx**2 + dy**2) / (2 * core**2))
            u, v = u - swirl * dy / core, v + swirl * dx / core
    field = np.stack([u, v], -1)
    field -= field.mean((0, 1))
    return (field / np.sqrt(np.mean(field**2)))[None].astype(np.float32)


def _shear() -> np.ndarray:
    """Sinusoidal shear u'(y), constant along the stream, one period in n cells, (1, n, n, 2)."""
    field = np.zeros((1, _CELLS, _CELLS, 2), np.float32)
    field[..., 0] = np.sqrt(2) * np.sin(2 * pi * np.arange(_CELLS) / _CELLS)
    return field


def table_of(preset: str, box: int = 0) -> tuple[np.ndarray, float]:
    """The preset's unit-variance table for planar waters and its cell: m for spatial tables, 1 tick for gusts."""
    if preset not in PRESETS:
        raise UnknownName("turbulence", preset, PRESETS)
    if preset == "gust":
        return gust_table(box), 1.0
    if preset == "none":
        return np.zeros((1, 2, 2), np.float32), 1.0
    length = LENGTH[preset]
    cell = 8 * length / _CELLS
    if preset == "vortex_street":
        return _street(length), cell
    if preset == "shear":
        return _shear(), cell
    return np.ascontiguousarray(solenoidal_box(length, box)[..., :2]), cell


def draw(xp, preset: str, table, cell, speed, direction, intensity, uniforms) -> Current:
    """Draws the flow of B fish. uniforms: (B, 4) in [0, 1); speed m/s and direction rad, towards which the water moves, (B,)."""
    rows, cells = table.shape[0], table.shape[1]
    aligned = preset in ("vortex_street", "shear")
    angle = direction if aligned else 2 * pi * uniforms[:, 3]
    return Current(
        mean=xp.stack([speed * xp.cos(direction), speed * xp.sin(direction)], -1),
        rms=intensity * xp.maximum(speed, _FLOOR),
        row=xp.minimum(xp.floor(uniforms[:, 0] * rows), rows - 1).astype("int32"),
        offset=xp.floor(uniforms[:, 1:3] * cells) if table.ndim == 3 else uniforms[:, 1:3] * cells,
        turn=xp.stack([xp.cos(angle), xp.sin(angle)], -1),
        table=table,
        cell=cell,
    )


def sample(xp, c: Current, points, tick):
    """Water velocity at points (B, N, 2) [m] at bus tick (B,) int, and the uniform acceleration DU/Dt.

    Returns:
        (B, N, 2) m/s and (B, 2) m/s2. For frozen turbulence DU/Dt is second order in TI and left out.
    """
    cos, sin = c.turn[:, 0], c.turn[:, 1]
    if c.table.ndim == 3:
        ticks = c.table.shape[1]
        now = (tick + c.offset[:, 0].astype("int32")) % ticks
        here, ahead = c.table[c.row, now], c.table[c.row, (now + 1) % ticks]
        gust = c.rms[:, None] * _turned(xp, here, cos, sin)
        slope = c.rms[:, None] * _turned(xp, ahead - here, cos, sin) / TICK
        return xp.broadcast_to((c.mean + gust)[:, None, :], points.shape), slope
    n = c.table.shape[1]
    rel = points - (c.mean * (tick * TICK)[:, None])[:, None, :]
    cos, sin = cos[:, None], sin[:, None]
    gx = (cos * rel[..., 0] + sin * rel[..., 1]) / c.cell + c.offset[:, None, 0]
    gy = (cos * rel[..., 1] - sin * rel[..., 0]) / c.cell + c.offset[:, None, 1]
    fx, fy = xp.floor(gx), xp.floor(gy)
    ax, ay = (gx - fx)[..., None], (gy - fy)[..., None]
    ix, iy = fx.astype("int32") % n, fy.astype("int32") % n
    jx, jy, row = (ix + 1) % n, (iy + 1) % n, c.row[:, None]
    t = c.table
    value = (1 - ax) * ((1 - ay) * t[row, ix, iy] + ay * t[row, ix, jy]) + ax * ((1 - ay) * t[row, jx, iy] + ay * t[row, jx, jy])
    return c.mean[:, None, :] + c.rms[:, None, None] * _turned(xp, value, cos, sin), xp.zeros_like(c.mean)


def shifted(c: Current, by, tick) -> Current:
    """Flow with `by` (B, 2) m/s added to the mean (NumPy); at bus tick (B,) the eddies keep their positions."""
    by, cos, sin = np.asarray(by, float), c.turn[:, 0], c.turn[:, 1]
    if c.table.ndim == 3:  # gusts are uniform in space, so the mean does not move them
        return c._replace(mean=c.mean + by)
    ride = by * (np.asarray(tick) * TICK)[:, None]
    return c._replace(mean=c.mean + by, offset=c.offset + _turned(np, ride, cos, -sin) / c.cell)


def _turned(xp, vectors, cos, sin):
    x, y = vectors[..., 0], vectors[..., 1]
    return xp.stack([cos * x - sin * y, sin * x + cos * y], -1)


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Background flow, reproducible from its numbers and the same in every water.

    speed m/s; direction rad, towards which the water moves, counter-clockwise from tank +x; intensity TI; box: table number.
    """

    speed: float = 0.0
    direction: float = 0.0
    turbulence: str = "none"
    intensity: float = constant("turbulence", "intensity")
    seed: int = 0
    box: int = 0

    def __post_init__(self):
        checked_name("turbulence", self.turbulence, PRESETS)
        for name, bounds in LIMITS.items():
            checked(f"flow: {name}", getattr(self, name), *bounds, whole=name in ("seed", "box"))

    @property
    def mean(self) -> np.ndarray:
        """Mean velocity (3,) m/s."""
        return self.speed * np.array([np.cos(self.direction), np.sin(self.direction), 0.0])

    @property
    def rms(self) -> float:
        """u_rms of each component, m/s."""
        return 0.0 if self.turbulence == "none" else self.intensity * max(self.speed, _FLOOR)

    def current(self) -> Current:
        """This flow as a batch of one for the batched engines."""
        return stack([self])

    def uniforms(self) -> np.ndarray:
        """Four draws in [0, 1) that fix slice, offset and rotation."""
        return np.random.default_rng([77, self.seed]).random(4)

    def at(self, x, t: float) -> np.ndarray:
        """Water velocity at points x (..., 3) [m] and time t [s]: (..., 3) m/s.

        z = 0 is the plane that the planar waters see; spatial turbulence is solenoidal in three dimensions.
        """
        x = np.asarray(x, float)
        flat = x.reshape(-1, 3)
        out = np.zeros_like(flat)
        if self.turbulence in ("default", "fine") and self.intensity > 0:
            out[:] = self.mean + self.rms * self._spatial(flat - self.mean * t)
        else:
            whole = int(np.floor(t / TICK + 1e-9))
            part = t / TICK - whole
            c = self.current()
            one, two = (sample(np, c, flat[None, :, :2], np.array([whole + i]))[0][0] for i in (0, 1))
            out[:, :2] = one + part * (two - one)
        return out.reshape(x.shape)

    def _spatial(self, rel):
        """Trilinear lookup in the three-dimensional box at points relative to the moving frame, (P, 3)."""
        length = LENGTH[self.turbulence]
        box, n, cell = solenoidal_box(length, self.box), _CELLS, 8 * length / _CELLS
        c = self.current()
        cos, sin = c.turn[0]
        grid = np.stack([rel[:, 2], cos * rel[:, 0] + sin * rel[:, 1], cos * rel[:, 1] - sin * rel[:, 0]], -1) / cell
        grid += np.array([c.row[0], *c.offset[0]])
        base = np.floor(grid)
        part, base = grid - base, base.astype(int)
        value = np.zeros((len(rel), 3))
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, part, 1 - part), -1)
            index = (base + corner) % n
            value += weight[:, None] * box[index[:, 0], index[:, 1], index[:, 2]]
        return np.concatenate([_turned(np, value, cos, sin), value[:, 2:]], -1)


@dataclass(frozen=True, kw_only=True)
class DrawnFlow(Flow):
    """Background flow with a given draw instead of a seed."""

    drawn: Current  # a batch of one

    @classmethod
    def of(cls, drawn: Current, kind: Flow) -> "DrawnFlow":
        """Background flow with this draw (a batch of one), and the turbulence and box of `kind`."""
        u, v = (float(component) for component in drawn.mean[0])
        return cls(speed=np.hypot(u, v), direction=np.arctan2(v, u), turbulence=kind.turbulence, box=kind.box, drawn=drawn)

    @property
    def rms(self) -> float:
        """u_rms of each component, m/s."""
        return float(self.drawn.rms[0])

    def current(self) -> Current:
        """The flow as drawn."""
        return self.drawn


def stack(flows: list[Flow]) -> Current:
    """Several flows of one preset and box as one batch. Raises ConfigError if presets or boxes differ."""
    kinds = {(f.turbulence, f.box) for f in flows}
    if len(kinds) != 1:
        raise ConfigError(f"a batch of flows shares one turbulence preset and box, got {sorted(kinds)}")
    preset, box = kinds.pop()
    table, cell = table_of(preset, box)
    speed, direction, intensity = (np.array([getattr(f, k) for f in flows], float) for k in ("speed", "direction", "intensity"))
    return draw(np, preset, table, cell, speed, direction, intensity, np.array([f.uniforms() for f in flows]))
