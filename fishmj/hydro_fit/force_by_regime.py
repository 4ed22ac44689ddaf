"""Forces by regime: how well a model says what the flow solver's wrenches were, the acceleration's share taken off."""

from collections.abc import Sequence

import numpy as np

from fishmj.dynamics import planar_chain
from fishmj.hydro_fit.fit import wake_warmup
from fishmj.hydro_fit.fit.gauss_newton import tow_drag
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, added, attachment, base_force, rows_of
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.hydro_model import HydroModel

NAMES = {
    "gait": "cruise",
    "straight": "cruise",
    "turning": "turn",
    "manoeuvre": "brake",
    "policy": "on-policy",
    "random": "random targets",
    "uneven": "gusts and shear",
    "chirp": "chirp",
    "flapping": "held, flapping",
    "oscillation": "oscillation",
    "static": "held",
}
REST, HIGH, MOVING = 2.0, np.radians(60), 0.05  # s, rad, m/s


def regimes(records: Sequence[SegmentRecord], rows: RegressionRows) -> np.ndarray:
    """The regime of every row, (M,) text: by block, but for the first 2 s of a free swim and angles of attack above 60 deg."""
    out = np.concatenate([np.full(len(r.q), NAMES.get(r.meta["block"], r.meta["block"]), dtype="<U20") for r in records])
    for record, span in zip(records, rows.spans(), strict=True):
        if not any(record.meta["prescribed"].values()) and record.meta.get("settle", 0.0) == 0:
            out[span.start : span.start + round(REST / record.tick)] = "rest start"
    u, w = rows.u[1, 0], rows.w[1, 0]
    out[(np.hypot(u, w) > MOVING) & (np.abs(np.arctan2(w, u)) > HIGH) & (out != "rest start")] = "angle of attack > 60 deg"
    return out


def model_force(model: HydroModel, ch: planar_chain.Chain, rows: RegressionRows, tick: float) -> np.ndarray:
    """(3, N, M), with the force of the acceleration."""
    force = base_force(rows, ch.strips, model.base, attachment(rows, ch.strips, model.base, tick))
    return force if model.learnt is None else force + wake_warmup.warm_up(ch, rows, model.base, model.learnt, tick).force


def by_regime(model: HydroModel, robot: Robot, records: Sequence[SegmentRecord]) -> list[dict]:
    """One row a regime and link: R2 and NRMSE of F_t, F_n and the moment, without the acceleration's part, and mean thrust."""
    ch, tick = planar_chain.chain_of(robot), records[0].tick
    rows = rows_of(ch, records)
    got, label = model_force(model, ch, rows, tick), regimes(records, rows)
    inertia = np.stack([model.base.k[i] * added(rows, ch.strips, i) for i in range(ch.n)], 1)
    seen, got, drag = rows.force - inertia, got - inertia, tow_drag(ch, robot)
    out = []
    for name in dict.fromkeys(label.tolist()):
        part = label == name
        thrust = [(got - seen)[0][:, part & (rows.record == r)].sum(0).mean() for r in np.unique(rows.record[part])]
        for i, link in enumerate(robot.links):
            row: dict = {"regime": name, "link": link.name, "s": round(float(part.sum() * tick), 1)}
            for c, component in enumerate(("F_t", "F_n", "M")):
                error, truth = (got - seen)[c, i, part], seen[c, i, part]
                row[f"{component} R2"] = float(1 - (error**2).mean() / max(truth.var(), 1e-12))
                row[f"{component} NRMSE"] = float(np.sqrt((error**2).mean() / max((truth**2).mean(), 1e-12)))
            row["thrust/tow drag"] = float(np.abs(thrust).mean() / drag)
            out.append(row)
    return out


def static_map(model: HydroModel, robot: Robot, records: Sequence[SegmentRecord]) -> dict[str, np.ndarray]:
    """Mean forces in head axes of held fish by seconds, over the angle of attack of the head."""
    ch = planar_chain.chain_of(robot)
    held = [r for r in records if r.meta["block"] == "static"]
    if not held:
        return {}
    rows = rows_of(ch, held)
    got, size = model_force(model, ch, rows, held[0].tick), round(1 / held[0].tick)
    points: dict[str, list] = {key: [] for key in ("attack", *(f"{who}_{c}" for who in ("seen", "got") for c in "xym"))}
    q = np.concatenate([r.before[0] for r in held])
    for span in rows.spans():
        for a in range(span.start, span.stop - size + 1, size):
            part = slice(a, a + size)
            turn = np.cumsum(np.concatenate([[0.0], q[a, 3:]]))
            points["attack"].append(float(np.arctan2(rows.w[1, 0, part].mean(), rows.u[1, 0, part].mean())))
            for who, force in (("seen", rows.force), ("got", got)):
                t, n, m = (force[c, :, part].mean(-1) for c in range(3))
                points[f"{who}_x"].append(float((np.cos(turn) * t - np.sin(turn) * n).sum()))
                points[f"{who}_y"].append(float((np.sin(turn) * t + np.cos(turn) * n).sum()))
                points[f"{who}_m"].append(float(m[0] + _lever(ch, turn, t, n, m)))
    return {key: np.array(values) for key, values in points.items()}


def _lever(ch: planar_chain.Chain, turn, t, n, m) -> float:
    """Moment of the links behind the head about the reference point."""
    x = y = total = 0.0
    for i in range(1, ch.n):
        x, y = x + ch.d[i - 1] * np.cos(turn[i - 1]), y + ch.d[i - 1] * np.sin(turn[i - 1])
        fx, fy = np.cos(turn[i]) * t[i] - np.sin(turn[i]) * n[i], np.sin(turn[i]) * t[i] + np.cos(turn[i]) * n[i]
        total += m[i] + x * fy - y * fx
    return float(total)
