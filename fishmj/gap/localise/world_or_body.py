"""Does the gap of the position point somewhere in the tank, or somewhere on the robot; does that of the turn have a side?

    dr/dt of the position's residual = a + R(heading) b       a [m/s] fixed in the world: current, swirl, tether, camera axes
                                                              b [m/s] fixed on the body: thrust, drag, offsets
    d/dt of the heading's residual = even + odd * (turning rate of the model)
                                                              even [rad/s]: the same on both sides: offset, asymmetry
                                                              odd: a turn too strong or too weak

Seen from the body, a shows as first harmonic over the heading and b as a constant. Rates are straight lines through STRETCH
seconds, tapered so that a beat does not look like a turn; fits weigh with the floor; standard deviations resample BLOCK seconds.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.localise.comparison import Comparison

STRETCH, EVERY, BLOCK = 2.0, 1.0, 4.0  # s
DRAWS = 400
OCTANTS = 8
TURNS = 0.3  # rad/s, spread of the turning rate from which its share in the residual can be told
MOVES = 0.03  # rad, standard deviation of a command that moves


class Frame(NamedTuple):
    """Residual of the velocity over ground. world, body: (2,) m/s with sd; *_share: of its weighted mean square, each alone.

    octant: (8, 2) weighted mean residual ahead and to the left, m/s, by heading (0 = along +x); stretches: (8,) how many.
    """

    world: np.ndarray
    world_sd: np.ndarray
    body: np.ndarray
    body_sd: np.ndarray
    world_share: float
    body_share: float
    octant: np.ndarray
    stretches: np.ndarray

    @property
    def points(self) -> str:
        """world, body, or neither."""
        ahead = self.world_share - self.body_share
        if max(self.world_share, self.body_share) < 0.3 or abs(ahead) < 0.1:
            return "neither"
        return "world" if ahead > 0 else "body"


class Side(NamedTuple):
    """Residual of the turning rate: even [rad/s], odd [1], with sd (infinite: cannot be told); left, right: mean residual while
    turning there, rad/s."""

    even: float
    even_sd: float
    odd: float
    odd_sd: float
    left: float
    right: float


class Interval(NamedTuple):
    """Rates over one stretch of a record."""

    record: int
    block: int
    heading: float
    turning: float  # model, rad/s
    drift: np.ndarray  # (2,) m/s world
    spin: float  # rad/s
    beats: bool  # the joints move
    weight: float
    spin_weight: float


def stretches(c: Comparison) -> list[Interval]:
    """Every stretch of every record that has a pose."""
    out: list[Interval] = []
    for i, record in enumerate(c.records):
        blocks = [b for b in c.layout.blocks if b.record == i and b.sensor == "pose"]
        if len(blocks) != 3 or record.pose is None:
            continue
        t = blocks[0].t
        yaw = np.interp(t, record.pose.t, record.pose.values[:, 2])
        model = np.interp(t, record.pose.t, c.predictions[i]["pose"][0][:, 2])
        for start in np.arange(0.0, t[-1] - STRETCH + 1e-6, EVERY):
            some = (t >= start) & (t < start + STRETCH)
            if some.sum() < 4:
                continue
            drift = np.array([_slope(t[some], c.residuals[0][b.where][some]) for b in blocks[:2]])
            spin = _slope(t[some], c.residuals[0][blocks[2].where][some])
            floor = [float(np.mean(c.scale[b.where][some] ** 2)) for b in blocks]
            turning = _slope(t[some], model[some])
            place = (i, int(start // BLOCK), float(yaw[some].mean()), turning)
            first, last = (round(edge / record.dt) for edge in (start, start + STRETCH))
            beats = float(record.commands[first:last].std(0).max()) > MOVES
            out.append(Interval(*place, drift, spin, beats, 2.0 / (floor[0] + floor[1]), 1.0 / floor[2]))
    return out


def frame(found: list[Interval]) -> Frame | None:
    """World against body; None without a pose."""
    if len(found) < 4:
        return None
    heading = np.array([s.heading for s in found])
    weight = np.array([s.weight for s in found])
    drift = np.stack([s.drift for s in found])
    co = np.cos(heading)
    si = np.sin(heading)
    world = np.tile(np.eye(2), (len(found), 1, 1))
    body = np.stack([np.stack([co, -si], 1), np.stack([si, co], 1)], 1)
    both = np.concatenate([world, body], 2)  # (n, 2, 4)
    value, sd = _fit(both, drift, weight, _blocks(found))
    by_world, by_body = (_explained(part, drift, weight) for part in (world, body))
    seen = np.stack([co * drift[:, 0] + si * drift[:, 1], co * drift[:, 1] - si * drift[:, 0]], 1)
    octant = np.round(heading / (2 * np.pi / OCTANTS)).astype(int) % OCTANTS
    count = np.bincount(octant, minlength=OCTANTS)
    sums = np.stack([np.bincount(octant, weight * seen[:, k], OCTANTS) for k in (0, 1)], 1)
    mean = sums / np.maximum(np.bincount(octant, weight, OCTANTS), 1e-12)[:, None]
    mean[np.bincount(octant, weight, OCTANTS) < 0.01 * weight.sum()] = np.nan
    return Frame(value[:2], sd[:2], value[2:], sd[2:], by_world, by_body, mean, count)


def side(found: list[Interval]) -> Side | None:
    """Even and odd part of the turn's residual where the joints move: what is at rest shows no side; None without a pose."""
    found = [s for s in found if s.beats]
    if len(found) < 4:
        return None
    turning = np.array([s.turning for s in found])
    spin = np.array([s.spin for s in found])
    weight = np.array([s.spin_weight for s in found])
    columns = np.stack([np.ones(len(found)), turning], 1)[:, None]
    both = turning.std() > TURNS
    value, sd = _fit(columns if both else columns[..., :1], spin[:, None], weight, _blocks(found))
    if not both:  # nothing turns: only the even part can be told
        value = np.append(value, 0.0)
        sd = np.append(sd, np.inf)
    means = [float(np.mean(spin[some])) if (some := sign * turning > 0.1).any() else np.nan for sign in (1, -1)]
    return Side(float(value[0]), float(sd[0]), float(value[1]), float(sd[1]), *means)


def _slope(t: np.ndarray, values: np.ndarray) -> float:
    """Of the straight line through values, weighted with a Hann window over the stretch."""
    weight = np.sin(np.pi * (t - t[0] + 0.5 * (t[1] - t[0])) / (t[-1] - t[0] + t[1] - t[0])) ** 2
    t = t - weight @ t / weight.sum()
    return float((weight * t) @ values / ((weight * t) @ t))


def _blocks(found: list[Interval]) -> np.ndarray:
    """(n,) which block a stretch belongs to, 0.. ."""
    keys = [(s.record, s.block) for s in found]
    order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return np.array([order[key] for key in keys])


def _fit(columns: np.ndarray, target: np.ndarray, weight: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted least squares of target (n, d) on columns (n, d, p): values and their standard deviations, by block bootstrap."""
    normal = np.einsum("n,ndp,ndq->npq", weight, columns, columns)
    right = np.einsum("n,ndp,nd->np", weight, columns, target)
    count = int(block.max()) + 1
    sums = np.zeros((count, *normal.shape[1:])), np.zeros((count, right.shape[1]))
    np.add.at(sums[0], block, normal)
    np.add.at(sums[1], block, right)
    ridge = 1e-9 * np.trace(sums[0].sum(0)) * np.eye(normal.shape[1])
    solved = lambda draw: np.linalg.solve(sums[0][draw].sum(0) + ridge, sums[1][draw].sum(0))
    draws = np.random.default_rng(0).integers(0, count, (DRAWS, count))
    return solved(slice(None)), np.array([solved(d) for d in draws]).std(0)


def _explained(columns: np.ndarray, target: np.ndarray, weight: np.ndarray) -> float:
    """Share of the weighted mean square of the target that the columns explain."""
    value, _ = _fit(columns, target, weight, np.arange(len(target)))
    rest = target - np.einsum("ndp,p->nd", columns, value)
    return float(1.0 - np.sum(weight[:, None] * rest**2) / np.sum(weight[:, None] * target**2))
