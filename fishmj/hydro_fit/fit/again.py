"""A fitted water, fitted again to more swims: the ten factors move, the learnt residual stays as it is. Seconds, not minutes.

    model = Again(robot, model, train, val, dataset={...}).run()

As in the first fit, factors with which the validation swims are worse are not taken, and the notes say so.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fishmj.hydro_fit.fit.newton import groups
from fishmj.hydro_fit.fit.pack import packed
from fishmj.hydro_fit.fit.prior import flat
from fishmj.hydro_fit.fit.recipe import Fit, Settings
from fishmj.hydro_fit.model import HydroModel
from fishmj.hydro_fit.record import Record
from fishmj.mjcf.description import Robot


class Again(Fit):
    """One more fit of a model.

    Args:
        train, val: records at the model's slip ratio. dataset: as in `Fit`.
    """

    def __init__(self, robot: Robot, model: HydroModel, train: Sequence[Record], val: Sequence[Record], *, dataset: dict):
        members = len(model.members)
        super().__init__(
            robot, train, val, dataset=dataset, settings=Settings(members=members, residual=model.learnt is not None)
        )
        self.model = model

    def run(self) -> HydroModel:
        """Factors of the model as it swims, and of the strips alone where there is a residual; then the error bar."""
        model, still = self.model, np.zeros((self.settings.members, len(groups(self.chain.n))))
        state: dict[str, Any] = {"water": model.alone[0], "factors": still, "alone": model.alone[0], "alone_factors": still}
        state |= self._newton(state, None, "rollout")
        if model.learnt is not None:
            state |= {"water": flat(model.base), "factors": still} | packed(model.learnt)
            state |= self._newton(state, model.learnt, "retune")
        return self._model(state | self._finish(state))
