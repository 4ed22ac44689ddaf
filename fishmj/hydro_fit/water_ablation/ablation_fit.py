"""The recipe's fit without some of its parts. Fits that differ only in later stages share the files of the earlier ones.

`FitPipeline` uses the residual only if it improves the validation swims. Here it is always used, because its contribution is to
be measured. `Variant.scores` has the decision of the recipe. Members, range checks and the error bar are left out.
"""

import hashlib
import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fishmj.base.store import plain
from fishmj.hydro_fit.fit import fit_pipeline
from fishmj.mjcf.identity import body_sha256
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import unflat

NEEDS = {  # settings that a stage depends on, besides those of the stages before it
    "linear": (),
    "rollout": ("seed", "members", "swim", "rollout"),
    "residual": ("residual", "memory", "products", "hidden", "steps"),
    "swims": ("swims",),
    "retune": ("retune",),
}
ALIKE = 2  # members of a model without an error bar: the check wants a spread, here 0


class Variant(fit_pipeline.FitPipeline):
    """A fit without some parts.

    Args:
        code: sha256 of the code; stages of other code are done again. retune: fit the factors again after the residual.
        The rest as for `FitPipeline`.
    """

    def __init__(self, robot, train, val, *, dataset: dict, settings: fit_pipeline.FitSettings, folder: "Path | None", code: str,
                 retune: bool = True, report=fit_pipeline.quiet):  # fmt: skip
        super().__init__(robot, train, val, dataset=dataset, settings=settings, folder=folder, report=report)
        self.told = asdict(settings) | {"retune": retune}
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
        return super()._retune(state) if self.told["retune"] else {}

    def _share(self, stage: str, part: float) -> float:
        return (list(NEEDS).index(stage) + part) / len(NEEDS)

    def _key(self, stage: str) -> str:
        stages = list(NEEDS)
        needed = [name for before in stages[: stages.index(stage) + 1] for name in NEEDS[before]]
        about = self.about | {"settings": {name: self.told[name] for name in needed}}
        return hashlib.sha256(json.dumps(plain(about), sort_keys=True).encode()).hexdigest()

    def _path(self, stage: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{stage}-{self._key(stage)[:12]}.safetensors"
