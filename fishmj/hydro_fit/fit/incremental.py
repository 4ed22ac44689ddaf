"""Refit of a fitted water to more swims: first the residual, then the ten factors.

    model = Refit(robot, model, train, val, dataset={...}).run()

As in the first fit, a stage that makes the validation swims worse is not used, and the notes record that. The range grows with
the new swims and keeps its old extent.
"""

import hashlib
from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.store import json_sha256
from fishmj.hydro_fit.fit.fit_pipeline import FitPipeline, FitSettings
from fishmj.hydro_fit.fit.gauss_newton import factors_of
from fishmj.hydro_fit.fit.rollout import is_free
from fishmj.hydro_fit.fit.rollout_training import BATCH, LENGTH
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water import residual_hooks
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

PASSES, LEAST = 14, 100  # of learning by swims: times that each swim is seen; steps at least


class Refit(FitPipeline):
    """One more fit of a model.

    Args:
        train: records at the model's slip ratio.
        val: those of the first fit, and new ones, which count for half in any number: the new swims are the reason of the refit.
        dataset, folder: as in `FitPipeline`.
    """

    def __init__(
        self, robot: Robot, model: HydroModel, train: Sequence[SegmentRecord],
        val: tuple[Sequence[SegmentRecord], Sequence[SegmentRecord]], *, dataset: dict, folder: Path | None = None,
    ):  # fmt: skip
        pieces = sum(r.seconds for r in train if is_free(r)) / (LENGTH / 2)
        steps = max(LEAST, ceil(PASSES * pieces / BATCH))
        settings = FitSettings(members=len(model.members), residual=model.learnt is not None, swims=steps)
        super().__init__(robot, train, [*val[0], *val[1]], dataset=dataset, settings=settings, folder=folder)
        self.model, self.parts = model, [self._match(part, None) for part in val if part]
        sums = [hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for array in self._first().values()]
        self.key = json_sha256([self.key, sums])

    def run(self) -> HydroModel:
        """Fits the residual and the factors of the model, then the error bar.

        Strips fitted without the residual stay unchanged.
        """
        stages = ("rollout", "finish") if self.model.learnt is None else ("swims", "retune", "finish")
        return self._model(self.run_stages(stages, state=self._first()))

    def _first(self) -> dict[str, Any]:
        """State of a fit at its swims, from the model."""
        model, water, (alone, *others) = self.model, flat(self.model.base), self.model.alone
        state: dict[str, Any] = {"water": water, "factors": factors_of(water, model.members, self.chain.n)}
        state |= {"alone": alone, "alone_factors": factors_of(alone, others, self.chain.n)}
        return state if model.learnt is None else state | residual_hooks.packed(model.learnt)

    def _swims(self, state) -> dict:
        trained = super()._swims(state)
        if self.score(state["water"], residual_hooks.unpacked(state | trained)) < self.score(state["water"], self.model.learnt):
            return trained
        self.notes.append("swims: not taken")
        return {}

    def _range(self, xi: np.ndarray, speed: np.ndarray) -> residual_hooks.MotionRange:
        """The old range, widened as far as the new swims exceed it."""
        before = self.model.learnt
        if before is None or before.reach is None:
            return super()._range(xi, speed)
        return residual_hooks.widened(before.reach, xi, speed)

    def score(self, water: np.ndarray, learnt) -> float:
        """Mean over the parts of the validation error of the first fit."""
        return float(np.mean([self.score_of(part, water, learnt) for part in self.parts]))
