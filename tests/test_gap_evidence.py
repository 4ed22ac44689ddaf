"""Evidence of a set of effects: what a further number must gain before a law that has it leads. *Synthetic*."""

from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.effects.effect import Parameter
from fishmj.gap.search.fit import EffectFitter
from fishmj.gap.thresholds import thresholds

SAMPLES = 40


@pytest.fixture
def fitter():
    """A linear model of three numbers: the first is an effect alone, all three are another that holds it."""
    rng = np.random.default_rng(5)
    slopes = rng.standard_normal((3, SAMPLES)) * [[30.0], [20.0], [10.0]]
    measured = 0.4 * slopes[0] + rng.standard_normal(SAMPLES)
    number = lambda name: Parameter(name=name, unit="1", low=-5.0, high=5.0, typical=(0.5, 1.0))
    active = SimpleNamespace(effects=[SimpleNamespace(parameters=(number("a"), number("b"), number("c")))])
    model = SimpleNamespace(
        constants=(), null=np.zeros(3), active=active, predict=lambda records, rows: np.asarray(rows) @ slopes
    )
    whiten = lambda residual: residual
    whiten.logdet = 0.0
    return slopes, measured, EffectFitter(model, [], SimpleNamespace(residuals=lambda seen: measured - seen), whiten)


@pytest.mark.parametrize("places", [(0,), (0, 1, 2)])
def test_evidence_of_a_linear_model_is_that_of_all_its_values(fitter, places):
    """Integrated over the prior, the residual is normal with covariance 1 + sd^2 J^T J."""
    slopes, measured, fit = fitter
    (best,) = fit.refine([fit.at(np.zeros(3), ("x",), places)], 4)
    sd = thresholds().fit.prior_sd
    covariance = np.eye(SAMPLES) + sd**2 * slopes[list(places)].T @ slopes[list(places)]
    exact = measured @ np.linalg.solve(covariance, measured) + np.linalg.slogdet(covariance)[1]
    assert fit.evidence(best) == pytest.approx(exact, rel=1e-6)


def test_of_nested_laws_that_fit_alike_the_least_leads(fitter):
    _, _, fit = fitter
    few, many = (fit.refine([fit.at(np.zeros(3), ("x",), places)], 4)[0] for places in ((0,), (0, 1, 2)))
    assert many.cost < few.cost
    assert fit.evidence(few) < fit.evidence(many) - 5.0
