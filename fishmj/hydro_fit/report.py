"""The report of a fitted water: one HTML page without outside references, and the same figures as JSON."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fishmj import pages
from fishmj.hydro_fit import fit_figures, force_by_regime, free_swims
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.store import write_json, write_text
from fishmj.water.hydro_model import HydroModel


def write(
    folder: Path,
    model: HydroModel,
    robot: Robot,
    records: Sequence[SegmentRecord],
    repeats: Sequence[tuple[SegmentRecord, SegmentRecord]] = (),
) -> Path:
    """Judge `model` on held-out records and write report.html and report.json; returns the page's path."""
    found = free_swims.judge(model, robot, records, repeats)
    swum = free_swims.FreeSwims(model, robot, records)
    forces, runs = force_by_regime.by_regime(model, robot, records), free_runs(swum)
    points = force_by_regime.static_map(model, robot, records)
    pictures = [("Means of free swims, with the 90 % band", fit_figures.against(swum, model.band))]
    pictures.append((f"Free runs from {swum.began:g} s on, {found['freerun_s']:g} s", fit_figures.freeruns(swum)))
    if points:
        pictures.append(("Held fish: mean force by the second, in head axes", fit_figures.force_map(points)))
    grid, turns = gait_rows(swum)
    folder.mkdir(parents=True, exist_ok=True)
    told = {"check": found, "forces": forces, "free_runs": runs, "gaits": grid, "turns": turns}
    write_json(
        folder / "report.json", told | {"coefficients": coefficients(model), "notes": model.notes, "dataset": model.dataset}
    )
    tables = [("Check", check_rows(found)), ("Forces without the acceleration's part", forces), ("Free runs", runs)]
    tables += [("Swimming straight", grid), ("Turning", turns), ("Coefficients", coefficients(model))]
    sections = [pages.Section(title, "", [pages.table(rows)]) for title, rows in tables]
    sections += [pages.Section(title, "", [pages.figure(png, title, below=False)]) for title, png in pictures]
    heading = f"Water {model.name}: against the flow solver"
    return write_text(folder / "report.html", pages.report(heading, heading, sections, notes=[about(model, records)]))


def about(model: HydroModel, records: Sequence[SegmentRecord]) -> str:
    """One line on where the figures come from."""
    seconds = sum(r.seconds for r in records)
    return (
        f"robot {model.robot}, slip {model.slip:g}, step {model.dt:g} s; {len(records)} held-out records, {seconds:.0f} s;"
        f" synthetic (computed); data set {str(model.dataset.get('sha256', ''))[:12]}; {model.notes}"
    )


def check_rows(found: dict) -> list[dict]:
    """The judgement, one row a figure."""
    rows = []
    for key, value in found["figures"].items():
        for name, part in value.items() if isinstance(value, dict) else [("", value)]:
            limit, own = found["tolerances"][key], found["repeatability"].get(key)
            told = " to ".join(f"{x:g}" for x in limit) if isinstance(limit, list) else f"{limit:.3g}"
            passed = limit[0] <= part <= limit[1] if isinstance(limit, list) else found["passed"].get(key)
            verdict = {True: "yes", False: "no", None: "cannot tell"}[passed]
            row = {"figure": f"{key} {name}".strip(), "value": part, "tolerance": told, "solver's own": own, "n": found["n"][key]}
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
        off = [
            a[part, :ticks] - b[part, 1 : ticks + 1]
            for a, b in ((swum.cruise_track.q, swum.cruise.q), (swum.cruise_track.v, swum.cruise.v))
        ]
        seen = swum.cruise.v[part, 1 : ticks + 1]
        rms = lambda a: float(np.sqrt(np.mean(a**2)))
        row = {"s": seconds, "n": int(part.sum()), "position [m]": float(np.linalg.norm(off[0][:, -1, :2], axis=-1).mean())}
        row |= {"velocity NRMSE": rms(off[1][..., :2]) / max(rms(seen[..., :2]), 1e-6)}
        out.append(
            row | {"yaw rate NRMSE": rms(off[1][..., 2]) / max(rms(seen[..., 2]), 1e-6), "joints RMS [rad]": rms(off[0][..., 3:])}
        )
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
        row |= {
            "solver [m/s]": seen["surge"],
            "model [m/s]": got["surge"],
            "solver [W]": seen["power"],
            "model [W]": got["power"],
        }
        if abs(seen["yaw_rate"]) > free_swims.TURNS:
            row |= {"solver [deg/s]": float(np.degrees(seen["yaw_rate"])), "model [deg/s]": float(np.degrees(got["yaw_rate"]))}
            row |= {
                "solver R [m]": seen["surge"] / abs(seen["yaw_rate"]),
                "model R [m]": got["surge"] / max(abs(got["yaw_rate"]), 1e-3),
            }
            turning.append(row)
        else:
            straight.append(row)
    return straight, turning


def coefficients(model: HydroModel) -> list[dict]:
    """What the data say about each parameter, by stage."""
    keys = ("name", "value", "sd", "prior", "status", "partner", "correlation")
    rows = []
    for stage, found in model.found.items():
        rows += [{"stage": stage} | {key: row[key] for key in keys} for row in found["parameters"].values()]
    return rows
