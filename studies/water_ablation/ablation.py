"""Ablation: the same data fitted without each part of the model, judged on the same held-out records.

    rows = table(robot, train, val, test, settings=Settings(), folder=Path("runs/ablation"))

One JSON file for each row and seed, written when the row is done, so that an interrupted table resumes. A row of other data,
settings or code (of `hydro_fit`) is done again.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from fishmj.base import interrupt
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import json_sha256, plain, read_json, write_json
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit import fit_pipeline
from fishmj.hydro_fit.prior_model import unfitted
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import body_sha256
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat, unflat
from studies.water_ablation import ellipsoid_fit, force

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
    settings: fit_pipeline.FitSettings, dataset: dict, folder: Path, names: Iterable[str] = (), seeds: Iterable[int] = (0,),
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
    about = {
        "robot": robot_hash(robot),
        "data": dataset,
        "code": fit_pipeline.code(str(Path(__file__).parent)),
    }
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


def _key(about: dict, row: AblationRow, settings: fit_pipeline.FitSettings) -> str:
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
    settings: fit_pipeline.FitSettings,
    about: dict,
    stages: Path,
    report: Callable,
    words: interrupt.Words,
) -> dict:
    """Fits and judges a row. words: text of an interrupted table, which also keeps the stage of the fit under way."""
    train, val, test = parts
    if row.kind == "ellipsoid":
        fit = ellipsoid_fit.Fit(robot, train, val, dataset={}, settings=settings, inertia=row.inertia, report=report)
        water = fit.solve() if row.fitted else ellipsoid_fit.Fitted(fit.e, force.default(fit.e), row.inertia, {})
        told = _told(ellipsoid_fit.judge(water, robot, test), seconds=water.seconds, notes=water.notes)
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


NEEDS = {  # settings that a stage depends on, besides those of the stages before it
    "linear": (),
    "rollout": ("seed", "members", "swim", "rollout"),
    "residual": ("residual", "memory", "products", "hidden", "steps"),
    "swims": ("swims",),
    "retune": ("retune",),
}
ALIKE = 2  # members of a model without an error bar: the check wants a spread, here 0


class Variant(fit_pipeline.FitPipeline):
    """The recipe's fit without some parts; fits that differ only in later stages share the files of the earlier ones.

    `FitPipeline` uses the residual only if it improves the validation swims. Here it is always used, because its contribution is
    to be measured; `scores` has the decision of the recipe. Members, range checks and the error bar are left out.

    Args:
        code: sha256 of the code; stages of other code are done again. retune: fit the factors again after the residual.
        The rest as for `FitPipeline`.
    """

    def __init__(self, robot, train, val, *, dataset: dict, settings: fit_pipeline.FitSettings, folder: "Path | None", code: str,
                 retune: bool = True, report=fit_pipeline.quiet):  # fmt: skip
        super().__init__(robot, train, val, dataset=dataset, settings=settings, folder=folder, report=report)
        self.all_settings = asdict(settings) | {"retune": retune}
        self.about["code"] = code
        self.scores: dict[str, float] = {}

    def begin_stage(self, stage: str) -> None:
        """Sets the key of the stage, which depends only on the settings up to it."""
        self.key = self._key(stage)

    def solve(self) -> HydroModel:
        """Runs all stages but the last; returns the model with the residual in it, if there is one."""
        state = self.run_stages(NEEDS, time.process_time)
        learnt = fit_pipeline.learnt_of(state)
        self.scores = {"base": self.score(state["alone"], None), "whole": self.score(state["water"], learnt)}
        return HydroModel(
            name="variant",
            robot=self.robot.name,
            robot_sha256=robot_hash(self.robot),
            body_sha256=body_sha256(self.robot),
            dt=self.chain.dt,
            slip=float(self.train[0].meta["grid"].get("slip", 1.0)),
            base=unflat(state["water"].tolist()),
            members=np.tile(state["water"], (ALIKE, 1)),
            alone=np.tile(state["alone"], (1 + ALIKE, 1)),
            learnt=learnt,
            found=self.found,
            notes="; ".join(self.notes),
        )

    def _retune(self, state) -> dict:
        return super()._retune(state) if self.all_settings["retune"] else {}

    def _share(self, stage: str, part: float) -> float:
        return (list(NEEDS).index(stage) + part) / len(NEEDS)

    def _key(self, stage: str) -> str:
        stages = list(NEEDS)
        needed = [name for before in stages[: stages.index(stage) + 1] for name in NEEDS[before]]
        about = self.about | {"settings": {name: self.all_settings[name] for name in needed}}
        return json_sha256(plain(about))

    def _path(self, stage: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{stage}-{self._key(stage)[:12]}.safetensors"
