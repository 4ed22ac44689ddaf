"""Small light markers carried by water: they move with its velocity and spin with half of its vorticity.

    dx/dt = u(x, t),   dpsi/dt = (dv/dx - du/dy) / 2

Heun's rule between two samples of the water; derivatives are central differences across the marker's `width`. A marker has no
inertia and no wind acts on it.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.lattice import Lattice

Sampler = Callable[[np.ndarray], np.ndarray]  # points (P, 3) m -> velocities (P, 3) m/s


def trilinear(field: np.ndarray, lattice: Lattice, origin_lu) -> Sampler:
    """Sampler of a velocity field (nx, ny, nz, 3) m/s between its nodes; `origin_lu` (3,) is the node of its low corner.

    Points outside take the value of the nearest face.
    """
    last = np.array(field.shape[:3]) - 1

    def sample(points: np.ndarray) -> np.ndarray:
        at = np.clip(lattice.to_lu(points) - origin_lu, 0, last)
        base = np.minimum(np.floor(at).astype(int), np.maximum(last - 1, 0))
        part, value = at - base, np.zeros((len(at), 3))
        for corner in np.ndindex(2, 2, 2):
            i, j, k = np.minimum(base + corner, last).T
            value += np.prod(np.where(corner, part, 1 - part), -1)[:, None] * field[i, j, k]
        return value

    return sample


def spin(water: Sampler, points: np.ndarray, width: float) -> np.ndarray:
    """Half the vorticity about the vertical at points (P, 3), (P,) rad/s, by differences across `width` [m]."""
    x, y = np.array([width / 2, 0, 0]), np.array([0, width / 2, 0])
    around = water(np.concatenate([points + x, points - x, points + y, points - y])).reshape(4, -1, 3)
    return 0.5 * ((around[0] - around[1])[:, 1] - (around[2] - around[3])[:, 0]) / width


@dataclass(frozen=True, kw_only=True)
class Release:
    """Times, start and end conditions of the markers.

    times: (P,) s, of release. start: (x, y, z) m, the same for all. low, high: (x, y) m, a marker that leaves this box is done.
    longest: s, a drift that takes longer is ended. width: m, of the marker.
    """

    times: tuple[float, ...]
    start: tuple[float, float, float]
    low: tuple[float, float]
    high: tuple[float, float]
    longest: float
    width: float

    def __post_init__(self):
        if not self.times or not (self.width > 0 and self.longest > 0):
            raise ConfigError(
                f"tracers: {len(self.times)} markers of {self.width} m for {self.longest} s; expected positive numbers"
            )


def carry(looks: Iterable[tuple[float, Sampler]], release: Release) -> list[np.ndarray]:
    """Tracks of the markers through `looks`, (t s, water) at rising times; ends when the last marker is done.

    Returns one (T, 4) array for each marker: t s, x m, y m, heading rad (0 at release); markers never released are left out.
    """
    times = np.array(release.times)
    place, turn = np.tile(np.array(release.start, float), (len(times), 1)), np.zeros(len(times))
    tracks: list[list[tuple]] = [[] for _ in times]
    done, last = np.zeros(len(times), bool), None
    for t, water in looks:
        out = ~done & (times <= t + 1e-9)  # in the water now
        moving = out & np.array([len(track) > 0 for track in tracks])
        if last is not None and moving.any():
            before, old = last
            dt, x = t - before, place[moving]
            u = old(x)
            u[:, 2] = 0.0  # a floating marker keeps its height
            guess = x + dt * u
            end = water(guess)
            end[:, 2] = 0.0
            place[moving] = x + 0.5 * dt * (u + end)
            turn[moving] += 0.5 * dt * (spin(old, x, release.width) + spin(water, place[moving], release.width))
        for i in np.flatnonzero(out):
            tracks[i].append((t, *place[i, :2], turn[i]))
            inside = np.all(place[i, :2] >= release.low) and np.all(place[i, :2] <= release.high)
            done[i] = not inside or t - tracks[i][0][0] >= release.longest - 1e-9
        if done.all():
            break
        last = (t, water)
    return [np.array(track) for track in tracks if track]


def figures(tracks: list[np.ndarray]) -> dict:
    """Statistics of the drifts: times, turning of the heading, and spread.

    `turned` counts markers whose heading spans more than 2 pi; spreads are standard deviations over the markers, of y and heading
    at the greatest distance downstream that all of them reached.
    """
    common = min(float(track[:, 1].max()) for track in tracks)
    ends = np.array([[np.interp(common, np.maximum.accumulate(track[:, 1]), track[:, k]) for k in (2, 3)] for track in tracks])
    lasted = np.array([track[-1, 0] - track[0, 0] for track in tracks])
    gone = np.array([track[-1, 1] - track[0, 1] for track in tracks])
    span = np.array([np.ptp(track[:, 3]) for track in tracks])
    many = len(tracks) > 1
    return {
        "markers": len(tracks),
        "turned": int((span > 2 * np.pi).sum()),
        "turned_share": float((span > 2 * np.pi).mean()),
        "greatest_span_rad": float(span.max()),
        "median_span_rad": float(np.median(span)),
        "distance_m": common - float(tracks[0][0, 1]),
        "lateral_spread_m": float(ends[:, 0].std(ddof=1)) if many else float("nan"),
        "heading_spread_rad": float(ends[:, 1].std(ddof=1)) if many else float("nan"),
        "mean_speed_m_s": float(np.mean(gone / np.maximum(lasted, 1e-9))),
        "mean_seconds": float(lasted.mean()),
    }
