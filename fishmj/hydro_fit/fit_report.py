"""The report of a fitted water: one HTML page without outside references, and the same figures as JSON.

Besides the judgement of `free_swims`: accuracy of the model's wrenches relative to the flow solver's, by regime and link, without
the acceleration's share.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import pages
from fishmj.base.figures import canvas, png
from fishmj.base.store import write_json, write_text
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit.gauss_newton import tow_drag
from fishmj.hydro_fit.fit.prediction_interval import CHANNELS, half_width, means
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, added, rows_of
from fishmj.hydro_fit.fit.rollout import recorded
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel

LABELS = {"speed": "speed along the body [m/s]", "yaw_rate": "yaw rate [rad/s]", "power": "servo power [W]"}
NAMES = {  # block -> regime
    "gait": "cruise", "straight": "cruise", "turning": "turn", "manoeuvre": "brake", "policy": "on-policy",
    "random": "random targets", "uneven": "gusts and shear", "chirp": "chirp", "oscillation": "oscillation",
    "flapping": "held, flapping", "static": "held",
}  # fmt: skip
PREVIEW_TOLERANCES = (
    "fitted to the first part of a plan, or in a small coarse box: the tolerances are those of a whole plan;"
    " what it misses is told and fails nothing, what it meets holds in that box"
)
RUNS = 6  # paths in the figure of free runs
WIDE, DPI = 12.0, 110  # inches and dots an inch of the figures
REST, HIGH, MOVING = 2.0, np.radians(60), 0.05  # s, rad, m/s


def write(
    folder: Path, model: HydroModel, robot: Robot, records: Sequence[SegmentRecord],
    repeats: Sequence[tuple[SegmentRecord, SegmentRecord]] = (),
) -> Path:  # fmt: skip
    """Judges `model` on held-out records and writes report.html and report.json; returns the page's path."""
    found = free_swims.judge(model, robot, records, repeats)
    swims = free_swims.FreeSwims(model, robot, records)
    forces, runs = by_regime(model, robot, records), free_runs(swims)
    points = static_map(model, robot, records)
    pictures = [("Means of free swims, with the 90 % band", means_figure(swims, model.band))]
    pictures.append((f"Free runs from {swims.began:g} s on, {found['freerun_s']:g} s", runs_figure(swims)))
    if points:
        pictures.append(("Held fish: mean force by the second, in head axes", forces_figure(points)))
    grid, turns = gait_rows(swims)
    folder.mkdir(parents=True, exist_ok=True)
    figures: dict[str, Any] = {"check": found, "forces": forces, "free_runs": runs, "gaits": grid, "turns": turns}
    figures |= {"preview": model.preview, "coefficients": coefficients(model), "notes": model.notes, "dataset": model.dataset}
    write_json(folder / "report.json", figures)
    tables = [("Check", check_rows(found)), ("Forces without the acceleration's part", forces), ("Free runs", runs)]
    tables += [("Swimming straight", grid), ("Turning", turns), ("Coefficients", coefficients(model))]
    sections = [pages.Section(title, "", [pages.table(rows)]) for title, rows in tables]
    sections += [pages.Section(title, "", [pages.figure(picture, title, below=False)]) for title, picture in pictures]
    heading = f"Water {model.name}: against the flow solver"
    return write_text(folder / "report.html", pages.report(heading, heading, sections, notes=[about(model, records)]))


def about(model: HydroModel, records: Sequence[SegmentRecord]) -> str:
    """Line on the origin of the figures."""
    seconds = sum(r.seconds for r in records)
    first = f"preview, {PREVIEW_TOLERANCES}; " if model.preview else ""
    return (
        f"{first}robot {model.robot}, slip {model.slip:g}, step {model.dt:g} s; {len(records)} held-out records, {seconds:.0f} s;"
        f" synthetic (computed); data set {str(model.dataset.get('sha256', ''))[:12]}; {model.notes}"
    )


def check_rows(found: dict) -> list[dict]:
    """Rows of the judgement, one for each figure."""
    rows = []
    for key, value in found["figures"].items():
        for name, part in value.items() if isinstance(value, dict) else [("", value)]:
            limit, own = found["tolerances"][key], found["repeatability"].get(key)
            text = " to ".join(f"{x:g}" for x in limit) if isinstance(limit, list) else f"{limit:.3g}"
            n, ranged = found["n"][key], isinstance(limit, list)
            passed = free_swims.covers_as_stated(part, n) if ranged else found["passed"].get(key)
            verdict = {True: "yes", False: "no", None: "cannot tell"}[passed]
            row = {"figure": f"{key} {name}".strip(), "value": part, "tolerance": text, "solver's own": own, "n": n}
            rows.append(row | {"passed": verdict})
    return rows


def free_runs(swum: free_swims.FreeSwims) -> list[dict]:
    """Velocity, yaw rate and place after 2 and 10 s of free run in cruise."""
    out, tick = [], swum.records[0].tick
    for seconds in (2.0, free_swims.FREERUN):
        ticks = min(round(seconds / tick), swum.cruise.mask.shape[1])
        part = swum.cruise.mask[:, :ticks].min(1) > 0
        if not part.any():
            continue
        pairs = ((swum.cruise_track.q, swum.cruise.q), (swum.cruise_track.v, swum.cruise.v))
        off = [a[part, :ticks] - b[part, 1 : ticks + 1] for a, b in pairs]
        seen = swum.cruise.v[part, 1 : ticks + 1]
        rms = lambda a: float(np.sqrt(np.mean(a**2)))
        row = {"s": seconds, "n": int(part.sum()), "position [m]": float(np.linalg.norm(off[0][:, -1, :2], axis=-1).mean())}
        row |= {"velocity NRMSE": rms(off[1][..., :2]) / max(rms(seen[..., :2]), 1e-6)}
        row |= {"yaw rate NRMSE": rms(off[1][..., 2]) / max(rms(seen[..., 2]), 1e-6)}
        out.append(row | {"joints RMS [rad]": rms(off[0][..., 3:])})
    return out


def gait_rows(swum: free_swims.FreeSwims) -> tuple[list[dict], list[dict]]:
    """Speed and power of each straight gait; yaw rate and radius of each turning one."""
    straight, turning = [], []
    for b, record in enumerate(swum.records):
        if record.meta["block"] not in free_swims.GAITS or np.abs(record.flow).max() > 1e-6:
            continue
        drive = record.meta["segment"].get("drive", {})
        seen, got = ({key: float(values[b]) for key, values in one.items()} for one in (swum.seen, swum.late))
        row = {"record": record.id, "f [Hz]": drive.get("frequency"), "amplitude [rad]": drive.get("amplitude")}
        row |= {"solver [m/s]": seen["surge"], "model [m/s]": got["surge"]}
        row |= {"solver [W]": seen["power"], "model [W]": got["power"]}
        if abs(seen["yaw_rate"]) > free_swims.TURNS:
            row |= {"solver [deg/s]": float(np.degrees(seen["yaw_rate"])), "model [deg/s]": float(np.degrees(got["yaw_rate"]))}
            row |= {"solver R [m]": seen["surge"] / abs(seen["yaw_rate"])}
            row |= {"model R [m]": got["surge"] / max(abs(got["yaw_rate"]), 1e-3)}
            turning.append(row)
        else:
            straight.append(row)
    return straight, turning


def coefficients(model: HydroModel) -> list[dict]:
    """Fit results of each parameter, by stage."""
    keys = ("name", "value", "sd", "prior", "status", "partner", "correlation")
    rows = []
    for stage, found in model.found.items():
        rows += [{"stage": stage} | {key: row[key] for key in keys} for row in found["parameters"].values()]
    return rows


def means_figure(swum: free_swims.FreeSwims, band: dict[str, list[float]]) -> bytes:
    """Plot of the means of every free swim, model over record, with the 90 % band."""
    figure, axes = canvas(1, len(CHANNELS), (WIDE, 3.8))
    got, seen = means(swum.track, swum.fleet), means(recorded(swum.fleet), swum.fleet)
    gait = np.array([r.meta["block"] in free_swims.GAITS for r in swum.records])
    for axis, channel in zip(axes[0], CHANNELS, strict=True):
        x, y = getattr(seen, channel), getattr(got, channel)
        half = half_width(channel, got, swum.members, band)
        for part, colour, name in ((gait, "#20639b", "gaits"), (~gait, "#c0502e", "other")):
            if part.any():
                axis.errorbar(x[part], y[part], half[part], fmt="o", ms=3.5, lw=0.8, color=colour, label=name)
        ends = [min(x.min(), y.min()), max(x.max(), y.max())]
        axis.plot(ends, ends, lw=0.8, color="#555")
        axis.set_xlabel("flow solver")
        axis.set_title(LABELS[channel], fontsize=10)
    axes[0, 0].set_ylabel("model")
    axes[0, 0].legend(fontsize=8)
    return png(figure, dpi=DPI)


def runs_figure(swum: free_swims.FreeSwims) -> bytes:
    """Plot of the paths of some free runs beside the recorded ones."""
    which = np.linspace(0, len(swum.cruise.q) - 1, min(RUNS, len(swum.cruise.q))).astype(int)
    figure, axes = canvas(2, (len(which) + 1) // 2, (WIDE, 5.5))
    for axis, b in zip(axes.flat, which, strict=False):
        stop = int(swum.cruise.mask[b].sum())
        axis.plot(*swum.cruise.q[b, : stop + 1, :2].T, color="#555", label="flow solver")
        axis.plot(*swum.cruise_track.q[b, :stop, :2].T, color="#20639b", lw=1.2, label="model")
        axis.set_aspect("equal", adjustable="datalim")
        axis.tick_params(labelsize=7)
    axes[0, 0].legend(fontsize=8)
    figure.suptitle("free runs, m", fontsize=10)
    return png(figure, dpi=DPI)


def forces_figure(points: dict[str, np.ndarray]) -> bytes:
    """Plot of drag and lateral force of held, straight and bent fish over the angle of attack, solver and model."""
    figure, axes = canvas(1, 3, (WIDE, 3.8))
    titles = ("force along x, N", "force along y, N", "yaw moment, N m")
    for axis, name, title in zip(axes[0], ("x", "y", "m"), titles, strict=True):
        axis.plot(np.degrees(points["attack"]), points[f"seen_{name}"], "o", ms=3, color="#555", label="flow solver")
        axis.plot(np.degrees(points["attack"]), points[f"got_{name}"], "x", ms=4, color="#20639b", label="model")
        axis.set_xlabel("angle of attack [deg]")
        axis.set_title(title, fontsize=10)
    axes[0, 0].legend(fontsize=8)
    return png(figure, dpi=DPI)


def regimes(records: Sequence[SegmentRecord], rows: RegressionRows) -> np.ndarray:
    """Regime of every row, (M,) text: by block, except the first 2 s of a free swim and angles of attack above 60 deg."""
    out = np.concatenate([np.full(len(r.q), NAMES.get(r.meta["block"], r.meta["block"]), dtype="<U20") for r in records])
    for record, span in zip(records, rows.spans(), strict=True):
        if not any(record.meta["prescribed"].values()) and record.meta.get("settle", 0.0) == 0:
            out[span.start : span.start + round(REST / record.tick)] = "rest start"
    u, w = rows.u[1, 0], rows.w[1, 0]
    out[(np.hypot(u, w) > MOVING) & (np.abs(np.arctan2(w, u)) > HIGH) & (out != "rest start")] = "angle of attack > 60 deg"
    return out


def by_regime(model: HydroModel, robot: Robot, records: Sequence[SegmentRecord]) -> list[dict]:
    """Rows by regime and link: R2 and NRMSE of F_t, F_n and the moment, without the acceleration's part, and mean thrust."""
    ch, tick = planar_chain.chain_of(robot), records[0].tick
    rows = rows_of(ch, records)
    got, label = free_swims.model_force(model, ch, rows, tick), regimes(records, rows)
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
    got, size = free_swims.model_force(model, ch, rows, held[0].tick), round(1 / held[0].tick)
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
