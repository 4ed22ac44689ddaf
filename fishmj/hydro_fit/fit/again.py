"""A fitted water, fitted again to more swims: the residual learns from them, then the ten factors move.

    model = Again(robot, model, train, val, dataset={...}).run()

As in the first fit, what makes the validation swims worse is not taken, and the notes say so. The range grows with the new swims
and keeps what it had.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fishmj.hydro_fit import learned, residual
from fishmj.hydro_fit.fit import begin
from fishmj.hydro_fit.fit.newton import groups
from fishmj.hydro_fit.fit.pack import packed, unpacked
from fishmj.hydro_fit.fit.prior import flat
from fishmj.hydro_fit.fit.recipe import Fit, Settings
from fishmj.hydro_fit.fit.rows import rows_of
from fishmj.hydro_fit.model import HydroModel
from fishmj.hydro_fit.record import Record
from fishmj.mjcf.description import Robot

STEPS = 100  # of learning by swims; the first fit had more of them, from forces alone


class Again(Fit):
    """One more fit of a model.

    Args:
        train: records at the model's slip ratio. val: those of the first fit, and new ones, which count for half however few
            they are: what was added is what the model is fitted again for. dataset: as in `Fit`.
    """

    def __init__(
        self, robot: Robot, model: HydroModel, train: Sequence[Record], val: tuple[Sequence[Record], Sequence[Record]], *,
        dataset: dict,
    ):  # fmt: skip
        settings = Settings(members=len(model.members), residual=model.learnt is not None, swims=STEPS)
        super().__init__(robot, train, [*val[0], *val[1]], dataset=dataset, settings=settings)
        self.model, self.parts = model, [self._match(part, None) for part in val if part]

    def run(self) -> HydroModel:
        """The factors of the model as it swims, then the error bar; strips fitted without the residual stay as they are."""
        model, still = self.model, np.zeros((self.settings.members, len(groups(self.chain.n))))
        state: dict[str, Any] = {"water": flat(model.base), "factors": still, "alone": model.alone[0], "alone_factors": still}
        if model.learnt is None:
            state |= self._newton(state, None, "rollout")
        else:
            state |= packed(model.learnt)
            taught = state | self._swims(state)
            if self.score(state["water"], unpacked(taught)) < self.score(state["water"], model.learnt):
                state = taught
            else:
                self.notes.append("swims: not taken")
            state |= self._newton(state, unpacked(state), "retune")
        return self._model(state | self._finish(state))

    def _reached(self, net: residual.Net, water: np.ndarray) -> learned.Residual:
        """The range of before, as far as the new swims go beyond it wider."""
        made, before = super()._reached(net, water), self.model.learnt
        if before is None or before.reach is None:
            return made
        return made._replace(reach=learned.widened(before.reach, *begin.features(self.chain, rows_of(self.chain, self.taught))))

    def score(self, water: np.ndarray, learnt) -> float:
        """As in the first fit, the mean of the parts."""
        return float(np.mean([self.score_of(part, water, learnt) for part in self.parts]))
