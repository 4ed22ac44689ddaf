"""Training data of the residual: pieces of records with the force that the strips do not explain, padded to one length.

At the start of a piece the water has a memory: the wake is filled by the recorded motion before it (`warm_up`). The judge of
forces needs the same.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fishmj.hydro_fit.fit.regression_rows import RegressionRows, attachment, base_force, rows_of
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain, strip_forces

PIECE, BURN = 4.0, 1.0  # s; the wake of a piece that begins inside a record fills during `BURN`
EVERY = 2  # ticks from row to row: neighbours say the same


class TrainingWindows(NamedTuple):
    """P pieces of T ticks for N links.

    left: force beyond the base, moment about the middle of the link. weight: 0 in burn-in and padding. size: rms of the force
    without the acceleration's part, the unit of errors. episode: number of the episode of each piece.
    """

    step: float  # s from row to row
    x: Any  # (T, F, P) features
    speed: Any  # (T, P) V, m/s
    push: Any  # (T, N, P) m2/s2
    left: Any  # (T, 3, N, P)
    weight: Any  # (T, P)
    size: Any  # (3, N)
    episode: np.ndarray  # (P,)


def motion_of(p: residual_network.Panels, rows: RegressionRows) -> residual_network.MotionFeatures:
    """Features in the middle of every tick; component lists of (M,)."""
    return residual_network.motion(np, p, links_of(rows))


def links_of(rows: RegressionRows) -> planar_chain.Links:
    """Motion of the links through the water in the middle of every tick."""
    u, w, omega = (list(value[1]) for value in (rows.u, rows.w, rows.omega))
    return planar_chain.Links([], [], omega, u, w, [])


def remaining(
    ch: planar_chain.Chain, rows: RegressionRows, c: strip_forces.Coefficients, tick: float
) -> tuple[np.ndarray, np.ndarray]:
    """Force beyond the base and the base's force without the acceleration's part, (3, N, M); moments about the middle."""
    attached = attachment(rows, ch.strips, c, tick)
    left = rows.force - base_force(rows, ch.strips, c, attached)
    drag = base_force(rows, ch.strips, c, attached, inertial=False)
    middle = np.array(residual_network.panels(ch).middle)[:, None]
    for force in (left, drag):
        force[2] -= middle * force[1]
    return left, drag


def training_windows_of(
    ch: planar_chain.Chain, records: Sequence[SegmentRecord], c: strip_forces.Coefficients
) -> TrainingWindows:
    """Pieces of all records."""
    tick = records[0].tick
    rows = rows_of(ch, records)
    m = motion_of(residual_network.panels(ch), rows)
    left, drag = remaining(ch, rows, c, tick)
    size = np.sqrt(((left + drag) ** 2).mean(-1)) + 1e-6
    names = sorted({record.meta["episode"] for record in records})
    step = EVERY * tick
    length, burn = round(PIECE / step) * EVERY, round(BURN / step) * EVERY
    pieces: list[tuple] = []
    for record, span in zip(records, rows.spans(), strict=True):
        settled = record.meta.get("settle", 0.0) > 0
        for a in range(span.start, span.stop, length - burn):
            b = min(a + length, span.stop)
            skip = burn if a > span.start or settled else 0
            if b - a > skip + burn // 2:
                pieces.append((a, b, skip, names.index(record.meta["episode"])))
    longest = max(b - a for a, b, _, _ in pieces)

    def cut(values):  # (..., M) -> (T, ..., P)
        wide = [
            np.concatenate([v := values[..., a:b], np.repeat(v[..., -1:], longest - (b - a), -1)], -1) for a, b, _, _ in pieces
        ]
        return np.moveaxis(np.stack(wide, -1), -2, 0)[::EVERY].astype(np.float32)

    time = np.arange(longest)[::EVERY, None]
    ends, skips = np.array([b - a for a, b, _, _ in pieces]), np.array([s for _, _, s, _ in pieces])
    weight = ((time >= skips) & (time < ends)).astype(np.float32)
    episode = np.array([e for *_, e in pieces])
    features = (np.array(m.x), m.speed, np.array(m.push), left)
    return TrainingWindows._make([step, *(cut(values) for values in features), weight, size.astype(np.float32), episode])


def subset(windows: TrainingWindows, at) -> TrainingWindows:
    """Some of the pieces."""
    return TrainingWindows._make([windows.step, *(a[..., at] for a in windows[1:6]), windows.size, windows.episode[at]])


class WarmUp(NamedTuple):
    """State of a model along M recorded ticks."""

    force: np.ndarray  # (3, N, M) of the residual, N and N m about the link's origin
    memory: np.ndarray  # (M, WAKES + 2) before each tick
    spread: np.ndarray  # (M,) variance between the members' coefficients
    outside: np.ndarray  # (M,) 1 where a link was outside the fitted range


def warm_up(
    ch: planar_chain.Chain, rows: RegressionRows, c: strip_forces.Coefficients, learnt: residual_hooks.Residual, tick: float
) -> WarmUp:
    """Runs the model along all records side by side, each from rest: its forces are recorded and do not act on the fish."""
    u, w, omega = (rows.wide(value[1]) for value in (rows.u, rows.w, rows.omega))  # (N, T, R)
    longest, count = u.shape[1:]
    memory = [np.zeros(count) for _ in residual_hooks.at_rest()]
    kept: list[tuple] = []
    for k in range(longest):
        motion = planar_chain.Links([], [], list(omega[:, k]), list(u[:, k]), list(w[:, k]), [])
        hooks = residual_hooks.LearnedResidual(np, ch, learnt, memory)
        force = np.array(hooks.advance(ch.strips, c, motion, tick))  # (N, 3, R)
        new = [value + np.zeros(count) for value in hooks.end(ch, None, None, None)]
        kept.append((force.transpose(1, 0, 2), np.array(memory), hooks.spread + np.zeros(count), new[-1] - memory[-1]))
        memory = new
    force, before, spread, outside = (np.stack(column, -2) for column in zip(*kept, strict=True))
    return WarmUp(rows.line(force), rows.line(before).T, rows.line(spread), rows.line(outside))


def features(ch: planar_chain.Chain, rows: RegressionRows) -> tuple[np.ndarray, np.ndarray]:
    """xi (M, N, 5) and V_i (M, N) of every row, from which the fitted range is made."""
    p, k = residual_network.panels(ch), links_of(rows)
    xi, speed = residual_hooks.near(np, p, k, residual_network.motion(np, p, k))
    return np.array(xi).transpose(2, 0, 1), np.array(speed).T
