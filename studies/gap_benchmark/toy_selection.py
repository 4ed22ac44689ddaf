"""Worked example of the function `propose`: two effects, three records of one sample each, a linear model.

    python -m studies.gap_benchmark.toy_selection          prints the numbers of docs/search/method.md

The real `propose`, shortlist, Gauss-Newton fit and cross-validation run on a stand-in for the likelihood, whose covariance is the
identity. In a search the covariance comes from null runs and is made anew around each finalist.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.effects import Parameter
from fishmj.gap.null.whitening import whitening
from fishmj.gap.search.fit import Candidate, EffectFitter
from fishmj.gap.search.likelihood import over_floor
from fishmj.gap.search.stepwise import CrossValidatedFit, SelectionStep, propose, required_gain
from fishmj.gap.thresholds import frozen, thresholds

RESIDUAL = np.array([11.0, 19.0, 20.0])  # of the model as it is, one sample a record, in floors
SIGNATURES = {"friction": np.array([10.0, 20.0, 20.0]), "drag": np.array([20.0, 20.0, 10.0])}  # of an effect of size 1
SIZE = Parameter(name="size", unit="1", low=-9.0, high=9.0, typical=(0.5, 1.0))
EFFECTS = tuple(SimpleNamespace(name=name, parameters=(SIZE,)) for name in SIGNATURES)


class LinearModel:
    """Model whose prediction is the sum of the signatures, each times the size of its effect."""

    constants = ()
    null = np.zeros(len(EFFECTS))
    active = SimpleNamespace(effects=EFFECTS)

    def index(self, effect: str, parameter: str) -> int:
        """Place of a parameter in the row."""
        return list(SIGNATURES).index(effect)

    def predict(self, records, rows) -> np.ndarray:
        """(R, m) predictions of parameter rows (R, P) on the records."""
        return np.asarray(rows) @ np.array(list(SIGNATURES.values()))[:, list(records)]


class OneSampleEach:
    """Layout of records with one sample each."""

    def __init__(self, records: list[int]):
        self.records, self.size = records, len(records)
        self.record, self.channel = np.arange(self.size), np.full(self.size, "joint")
        self.blocks = [SimpleNamespace(record=i, where=slice(i, i + 1), channel="joint") for i in range(self.size)]

    def residuals(self, predictions: np.ndarray) -> np.ndarray:
        """(R, m) measured minus predicted."""
        return RESIDUAL[list(self.records)] - predictions


@dataclass(frozen=True, eq=False)
class UnitLikelihood:
    """Likelihood whose covariance is the identity wherever it is linearised."""

    model: LinearModel = field(default_factory=LinearModel)
    layout: OneSampleEach = field(default_factory=lambda: OneSampleEach([0, 1, 2]))
    calibrated = False
    scale = np.ones(3)

    @property
    def records(self) -> list[int]:
        return self.layout.records

    @property
    def origin(self) -> "UnitLikelihood":
        return self

    def with_estimated_model_error(self, row: np.ndarray) -> "UnitLikelihood":
        return self

    def subset(self, keep: np.ndarray | None = None, more: np.ndarray | None = None) -> EffectFitter:
        """A fitter on the records where keep is true; more: further factors of the covariance there."""
        records = [r for r in self.records if keep is None or keep[r]]
        factors = np.zeros((0, len(records))) if more is None else more
        return EffectFitter(self.model, records, OneSampleEach(records), whitening(factors, np.ones(len(records))))

    def loss(self, row: np.ndarray) -> float:
        return self.subset().loss(row)

    def jacobian(self, candidate: Candidate) -> np.ndarray:
        """(K, m) change of the residual with each parameter of a candidate."""
        return -np.array([SIGNATURES[name] for name in candidate.names])

    def change(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        before, after = self.layout.residuals(self.model.predict(self.records, np.stack([start, end])))
        return after - before

    def over_floor(self, row: np.ndarray) -> tuple[float, dict]:
        return over_floor(self.layout.residuals(self.model.predict(self.records, row[None]))[0], self.scale, self.layout)


FOLDS = np.eye(3, dtype=bool)  # one record in each


def model_as_it_is() -> CrossValidatedFit:
    """Start of the selection: no effect."""
    near: Any = UnitLikelihood()
    base = near.subset().base()
    return CrossValidatedFit(near, base, (base,) * len(FOLDS))


def cross_validated(name: str) -> CrossValidatedFit:
    """One effect, fitted to all records and without each fold."""
    near: Any = UnitLikelihood()
    row = np.eye(len(EFFECTS))[list(SIGNATURES).index(name)]
    fitted = lambda keep: near.subset(keep).refine([near.subset(keep).at(row, (name,), (list(SIGNATURES).index(name),))])[0]
    return CrossValidatedFit(near, fitted(None), tuple(fitted(~fold) for fold in FOLDS))


def first_round() -> SelectionStep:
    """The round that `propose` makes of the model as it is."""
    return propose(model_as_it_is(), FOLDS, EFFECTS, frozen(), 0.0)


def least_gain_where_fitted(first: SelectionStep) -> float:
    """Gain on all records at once below which a second round ends."""
    required = required_gain(frozen(), first.fitted or model_as_it_is(), first.gain, uncontested=True)
    return thresholds().stepwise.screen_fraction * required


def main() -> None:
    """Prints every number of the worked example."""
    base = model_as_it_is()
    console.say(f"model as it is: loss {base.loss(FOLDS):.1f}")
    for name in SIGNATURES:
        fitted = cross_validated(name)
        all_at_once = fitted.best
        console.say(f"{name}: size {all_at_once.row.max():.3f}, cost on all records {all_at_once.cost:.1f}")
        for (fitter, unseen), fold in zip(fitted.held_out(FOLDS), FOLDS, strict=True):
            prior = fitter.prior(unseen.row[None])[0]
            console.say(
                f"  without record {'ABC'[int(np.argmax(fold))]}: size {unseen.row.max():.3f}, z^2 {np.sum(unseen.z**2):.2f},"
                f" prior {prior:.2f}, log det S {fitter.whiten.logdet:.2f}"
            )
        console.say(f"  loss {fitted.loss(FOLDS):.1f}, gain {base.loss(FOLDS) - fitted.loss(FOLDS):.1f}")
    step = first_round()
    tried = step.ranked[0]
    console.say(f"propose: {tried.names[0]}, gain {step.gain:.1f} of {step.asked:.1f} asked, accepted {step.accepted}")
    console.say(f"second round: at most {tried.cost:.1f} left of {least_gain_where_fitted(step):.1f} asked where fitted")


if __name__ == "__main__":
    main()
