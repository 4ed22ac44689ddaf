"""Movement of the links over every recorded tick, and the water's force on them, in the links' own axes.

Wrenches are means over a tick, so every regressor is also a mean: Simpson's rule over the state at its start, middle and end,
with
the constant acceleration (v_end - v_start) / tick. The turn of a link within a tick is neglected in the direction of the force.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.water.dynamics import planar_chain, strip_forces

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6


class RegressionRows(NamedTuple):
    """M ticks of N links. `u`, `w`, `omega`: (3, N, M) at start, middle and end; the rest are means, (N, M)."""

    u: np.ndarray  # m/s
    w: np.ndarray  # m/s
    omega: np.ndarray  # rad/s
    normal: np.ndarray  # n.a of the link's origin, m/s2
    alpha: np.ndarray  # rad/s2
    du: np.ndarray  # (2, N, M) DU/Dt along t and n, m/s2
    force: np.ndarray  # (3, N, M) F_t, F_n, moment about the origin, N and N m
    record: np.ndarray  # (M,) number of the record

    def of(self, i: int) -> tuple:
        """u, w0, Omega of link i at the three instants, (3, M)."""
        return self.u[:, i], self.w[:, i], self.omega[:, i]

    def spans(self) -> list[slice]:
        """Rows of each record."""
        edges = [0, *(np.flatnonzero(np.diff(self.record)) + 1).tolist(), len(self.record)]
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def wide(self, values: np.ndarray) -> np.ndarray:
        """Records side by side, (.., M) -> (.., T, R); zero after the end of a shorter one."""
        spans = self.spans()
        out = np.zeros((*values.shape[:-1], max(span.stop - span.start for span in spans), len(spans)))
        for j, span in enumerate(spans):
            out[..., : span.stop - span.start, j] = values[..., span]
        return out

    def line(self, values: np.ndarray) -> np.ndarray:
        """Inverse of `wide`."""
        return np.concatenate([values[..., : span.stop - span.start, j] for j, span in enumerate(self.spans())], -1)


def ambient_of(record: SegmentRecord) -> np.ndarray:
    """Flow acceleration DU/Dt over every tick, (T, 2) m/s2: of gusts only, which are uniform in space."""
    flow = record.flow.mean(1)
    if record.meta.get("segment", {}).get("flow", {}).get("turbulence") != "gust" or len(flow) < 2:
        return np.zeros_like(flow)
    return np.diff(flow, axis=0, append=flow[-1:]) / record.tick


def rows_of(ch: planar_chain.Chain, records: Iterable[SegmentRecord]) -> RegressionRows:
    """All ticks of some records, one after the other. Raises DatasetError: no record, or a record of another number of links."""
    parts = []
    for number, record in enumerate(records):
        if record.wrench.shape[1] != ch.n:
            raise DatasetError(f"record {record.id}: wrenches on {record.wrench.shape[1]} links, the fish has {ch.n}")
        parts.append(_one(ch, record, number))
    if not parts:
        raise DatasetError("no records to fit: the split is empty; collect first")
    return RegressionRows(*(np.concatenate(column, -1) for column in zip(*parts, strict=True)))


def _one(ch: planar_chain.Chain, record: SegmentRecord, number: int) -> RegressionRows:
    q0, v0 = record.before
    q = np.stack([q0, (q0 + record.q) / 2, record.q]).transpose(2, 0, 1)  # (nv, 3, T)
    v = np.stack([v0, (v0 + record.v) / 2, record.v]).transpose(2, 0, 1)
    flow = [(record.flow[:, i, 0], record.flow[:, i, 1]) for i in range(ch.n)]
    k = planar_chain.kinematics(np, ch, list(q), list(v), flow)
    shape = q[0].shape
    whole = lambda values: np.stack([np.broadcast_to(value, shape) for value in values], 1)
    cp, sp = np.cos(q[2]), np.sin(q[2])
    ax, ay, *turning = record.acceleration.T
    du = [d * np.ones(shape) for d in ambient_of(record).T]
    head = (cp * ax + sp * ay, cp * ay - sp * ax)
    stream = (cp * du[0] + sp * du[1], cp * du[1] - sp * du[0])
    alpha = np.cumsum(turning, 0)
    normal, along, across, force = [], [], [], []
    a = head
    for i in range(ch.n):
        (tx, ty), (nx, ny) = k.t[i], k.n[i]
        if i:
            lever = ch.d[i - 1] * alpha[i - 1]
            a = (a[0] + lever * k.n[i - 1][0], a[1] + lever * k.n[i - 1][1])
        normal.append(_mean((a[0] + k.bias[i][0]) * nx + (a[1] + k.bias[i][1]) * ny, shape))
        along.append(_mean(stream[0] * tx + stream[1] * ty, shape))
        across.append(_mean(stream[0] * nx + stream[1] * ny, shape))
        fx, fy, moment = record.wrench[:, i].T
        fx, fy = cp[1] * fx + sp[1] * fy, cp[1] * fy - sp[1] * fx
        mid = lambda value: np.broadcast_to(value, shape)[1]
        force.append((fx * mid(tx) + fy * mid(ty), fx * mid(nx) + fy * mid(ny), moment))
    return RegressionRows(
        whole(k.u),
        whole(k.w),
        whole(k.omega),
        np.stack(normal),
        np.asarray(alpha),
        np.stack([np.stack(along), np.stack(across)]),
        np.array(force).transpose(1, 0, 2),
        np.full(len(record.q), number),
    )


def _mean(value, shape) -> np.ndarray:
    return np.einsum("s,st->t", SIMPSON, np.broadcast_to(value, shape))


def mean3(parts) -> np.ndarray:
    """Means (3, M) over the tick of (F_t, F_n, moment) of (3, M) or scalar parts."""
    shape = np.broadcast_shapes(*(np.shape(p) for p in parts))
    return np.stack([_mean(p, shape) for p in parts])


def attachment(
    rows: RegressionRows, s: strip_forces.Strips, c: strip_forces.Coefficients, tick: float, start: float = 0.5
) -> np.ndarray:
    """Attachment of the tail in the middle of every tick, (M,), by exact steps; `start` at the first row of a record."""
    u, w, omega = (rows.wide(value[1]) for value in rows.of(len(s.mu) - 1))
    x, out = np.full(u.shape[1], start), np.zeros(u.shape)
    for k in range(len(u)):
        after = strip_forces.attachment(np, s, c, u[k], w[k], omega[k], x, tick)
        out[k], x = (x + after) / 2, after
    return rows.line(out)


def added(rows: RegressionRows, s: strip_forces.Strips, i: int) -> np.ndarray:
    """Force of the link's acceleration on its added mass for k = 1, (3, M), which is subtracted before drags are compared."""
    m0, m1, m2 = s.mu[i]
    a, alpha = rows.normal[i], rows.alpha[i]
    return np.stack([0 * a, -(m0 * a + m1 * alpha), -(m1 * a + m2 * alpha)])


def base_force(
    rows: RegressionRows, s: strip_forces.Strips, c: strip_forces.Coefficients, attached: np.ndarray, *, inertial: bool = True
) -> np.ndarray:
    """Force of the strip model in every row, (3, N, M); `inertial` with the force of the acceleration."""
    out = []
    for i in range(len(s.mu)):
        u, w, omega = rows.of(i)
        force = mean3(strip_forces.link_forces(np, s, c, i, u, w, omega, rows.du[0, i], rows.du[1, i], attached))
        out.append(force + (c.k[i] * added(rows, s, i) if inertial else 0.0))
    return np.stack(out, 1)
