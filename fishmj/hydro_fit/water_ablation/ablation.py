"""Ablation: the same data fitted without each part of the model, judged on the same held-out records.

    rows = table(robot, train, val, test, settings=Settings(), folder=Path("runs/ablation"))

One JSON file for each row and seed, written when the row is done, so that an interrupted table resumes. A row of other data,
settings or code (of `hydro_fit`) is done again.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from fishmj.base import interrupt
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import plain, read_json, write_json
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit.fit_pipeline import FitSettings, code
from fishmj.hydro_fit.mujoco_ellipsoid import ellipsoid_check, force
from fishmj.hydro_fit.mujoco_ellipsoid import ellipsoid_fit as ellipsoid
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.hydro_fit.water_ablation.ablation_fit import Variant
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import body_sha256
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat

SCHEMA = "fishmj.ablation/1"


@dataclass(frozen=True)
class AblationRow:
    """One line of the table. kind: prior, ellipsoid or strips; `changes` of the settings.

    Drawn: the result depends on the seed.
    """

    title: str
    kind: str = "strips"
    changes: dict = field(default_factory=dict)
    fitted: bool = True
    inertia: bool = False
    retune: bool = True
    drawn: bool = False


BASE = {"residual": False}
ROWS: dict[str, AblationRow] = {
    "prior": AblationRow("strips: prior", "prior"),
    "ellipsoid-default": AblationRow("MuJoCo's ellipsoids: its coefficients", "ellipsoid", fitted=False),
    "ellipsoid": AblationRow("MuJoCo's ellipsoids: fitted", "ellipsoid"),
    "ellipsoid-inertia": AblationRow("MuJoCo's ellipsoids, inertia added: fitted", "ellipsoid", inertia=True),
    "forces": AblationRow("strips: forces", changes=BASE | {"rollout": False}),
    "base": AblationRow("strips: forces, swims", changes=BASE),
    "whole": AblationRow("strips and residual", drawn=True),
    "memoryless": AblationRow("the same, no wake", changes={"memory": False}, drawn=True),
    "no-products": AblationRow("the same, no products", changes={"products": False}, drawn=True),
    "forces-only": AblationRow("the same, residual taught by forces alone", changes={"swims": 0}, drawn=True),
    "no-retune": AblationRow("the same, strips not fitted again", retune=False, drawn=True),
}


def table(
    robot: Robot, train: Sequence[SegmentRecord], val: Sequence[SegmentRecord], test: Sequence[SegmentRecord], *,
    settings: FitSettings, dataset: dict, folder: Path, names: Iterable[str] = (), seeds: Iterable[int] = (0,),
    report: Callable | None = None,
) -> list[dict]:  # fmt: skip
    """Makes all rows, or those of these names; drawn ones once for each seed.

    Args:
        dataset: identity of the data, in every row's key. report: called with (done, of, title) before and after a row.
    Returns:
        Rows as they are on disk: row, title, seed, figures, n, freerun_s, validation, seconds, notes.
    Raises:
        UnknownName: a row. ConfigError: no seed.
    """
    names, seeds = list(names) or list(ROWS), list(seeds)
    for name in names:
        if name not in ROWS:
            raise UnknownName("row of the ablation", name, ROWS)
    if not seeds:
        raise ConfigError("ablation: no seed; expected at least one, such as --seeds 0")
    todo = [(name, seed) for name in ROWS if name in names for seed in (seeds if ROWS[name].drawn else seeds[:1])]
    made: list[dict] = []
    parts = (train, val, test)
    about = {"robot": robot_hash(robot), "data": dataset, "code": code("hydro_fit/mujoco_ellipsoid", "hydro_fit/water_ablation")}
    about["records"] = [[r.id for r in part] for part in parts]
    words = lambda: f"{folder} holds {len(made)} of {len(todo)} rows; {interrupt.again()}"
    with interrupt.keeping(words):
        for k, (name, seed) in enumerate(todo):
            own = replace(settings, seed=seed, **ROWS[name].changes)
            key, place = _key(about, ROWS[name], own), folder / "rows" / f"{name}-{seed}.json"
            row = _kept(place, key)
            if row is None:
                told = lambda stage, part, _, k=k, name=name: report and report((k + part) / len(todo), f"{name}: {stage}")
                found = _one(robot, parts, ROWS[name], own, about, folder / "stages", told, words)
                row = plain({"schema": SCHEMA, "key": key, "row": name, "title": ROWS[name].title, "seed": seed, **found})
                write_json(place, row)
            made.append(row)
            if report is not None:
                report((k + 1) / len(todo), name)
    return made


def _key(about: dict, row: AblationRow, settings: FitSettings) -> str:
    """Hash of everything on which a row's figures depend."""
    whole = about | {"row": asdict(row) | {"title": ""}, "settings": asdict(settings)}
    return hashlib.sha256(json.dumps(plain(whole)).encode()).hexdigest()


def _kept(place: Path, key: str) -> dict | None:
    """Row that is kept for the same data, settings and code, or None."""
    if not place.is_file():
        return None
    try:
        row = read_json(place)
    except StoreError:  # damaged: it is done again
        return None
    return row if row.get("schema") == SCHEMA and row.get("key") == key else None


def _one(
    robot: Robot,
    parts,
    row: AblationRow,
    settings: FitSettings,
    about: dict,
    stages: Path,
    report: Callable,
    words: interrupt.Words,
) -> dict:
    """Fits and judges a row. words: text of an interrupted table, which also keeps the stage of the fit under way."""
    train, val, test = parts
    if row.kind == "ellipsoid":
        fit = ellipsoid.Fit(robot, train, val, dataset={}, settings=settings, inertia=row.inertia, report=report)
        water = fit.solve() if row.fitted else ellipsoid.Fitted(fit.e, force.default(fit.e), row.inertia, {})
        told = _told(ellipsoid_check.judge(water, robot, test), seconds=water.seconds, notes=water.notes)
        scores = water.validation | {"judged": fit.score(water.flat, None)}
        return told | {"validation": scores, "coefficients": water.coefficients}
    known = {"dataset": about["data"], "code": about["code"], "folder": stages}
    variant = Variant(robot, train, val, settings=settings, retune=row.retune, report=report, **known)

    def kept() -> str:
        variant.loop.save()
        return words()

    with interrupt.keeping(kept):
        model = unfitted(robot) if row.kind == "prior" else variant.solve()
    scores = variant.scores | {"judged": variant.score(flat(model.base), model.learnt)}
    told = _told(free_swims.judge(model, robot, test), seconds=sum(variant.seconds.values()), notes=model.notes)
    return told | {"validation": scores, "stages": variant.seconds}


def _told(found: dict, *, seconds: float = 0.0, notes: str = "") -> dict:
    figures = {key: value for key, value in found["figures"].items() if not isinstance(value, dict)}
    counts = {key: found["n"][key] for key in figures}
    return {"figures": figures, "n": counts, "freerun_s": found["freerun_s"], "seconds": seconds, "notes": notes}


def unfitted(robot: Robot) -> HydroModel:
    """Model with the robot's own water table."""
    water, ch = planar_chain.nominal(robot).water, planar_chain.chain_of(robot)
    members = np.tile(flat(water), (5, 1))
    return HydroModel(
        name="prior",
        robot=robot.name,
        robot_sha256=robot_hash(robot),
        body_sha256=body_sha256(robot),
        dt=ch.dt,
        slip=1.0,
        base=water,
        members=members,
        alone=np.concatenate([members[:1], members]),
    )
