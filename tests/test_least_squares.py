"""Damped least squares in batches: a linear fit is solved in one round, and the jackknife is the textbook's."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from fishmj.base.least_squares import Problem, damped_steps, jackknife, jackknife_sd

RNG = np.random.default_rng(0)
SLOPES, SEEN = RNG.normal(size=(20, 3)), RNG.normal(size=20)


def problem(**bounds):
    step, mean = np.array([0.1, 0.01, 1.0]), np.array([0.5, 0.0, -0.5])
    return Problem(lambda rows: rows @ SLOPES.T - SEEN, step, mean, np.diag([1.0, 4.0, 0.0]), **bounds)


def test_one_undamped_round_solves_a_linear_fit_with_its_prior():
    one, x = problem(), np.array([3.0, -2.0, 1.0])
    tried = one.best(x, damped_steps(*one.quadratic(x, *one.linear(x)), (0.0, 10.0)))
    normal = SLOPES.T @ SLOPES + one.precision
    assert tried.place == 0 and tried.x == pytest.approx(np.linalg.solve(normal, SLOPES.T @ SEEN + one.precision @ one.mean))
    assert tried.cost == pytest.approx(one.cost(tried.residual[None], tried.x[None])[0])


def test_differences_stay_below_the_upper_bound_and_steps_within_bounds():
    one = problem(low=np.full(3, -0.1), high=np.full(3, 0.1))
    x = np.full(3, 0.1)
    assert one.linear(x)[1].T / one.step == pytest.approx(SLOPES)
    tried = one.best(x, damped_steps(*one.quadratic(x, *one.linear(x)), (0.0,)))
    assert (np.abs(tried.x) <= 0.1).all()
    assert tried.cost >= 2 * lsq_linear(SLOPES, SEEN, (-0.1, 0.1)).cost


def test_jackknife_of_a_mean_is_its_standard_error():
    drawn = RNG.normal(size=(30, 2))
    without = np.array([np.delete(drawn, i, 0).mean(0) for i in range(30)])
    assert jackknife_sd(without) == pytest.approx(drawn.std(0, ddof=1) / np.sqrt(30))
    assert np.diag(jackknife(without)) == pytest.approx(jackknife_sd(without) ** 2)
