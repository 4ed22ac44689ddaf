"""Tests of the arguments of `evaluate.run` and `evaluate.trials`, and of trials too short to judge."""

import numpy as np
import pytest

from fishmj import control, engines, evaluate
from fishmj.base.errors import ConfigError
from fishmj.control.policy import Policy
from fishmj.engines.planar import PlanarEngine
from fishmj.evaluate import metrics, trial_report
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water

ONE = evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1, duration=1, turbulence="none", randomisation=0, noise=0)


class Still:
    """Controller without a fault; its class stands for an object that was not made."""

    name = "still"

    def reset(self, n): ...

    def __call__(self, obs): ...


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"controller": Policy.load("station")}, "controller is a Policy; expected its name or file"),
        ({"controller": Still}, "controller = <class .*an object .no class. with"),
        ({"controller": None}, "controller = None; expected a name"),
        ({"controller": lambda obs: obs}, "controller = <function .*`reset"),
        ({"engine": PlanarEngine}, "engine = <class .*, or an engine"),
        ({"engine": engines.make("planar")}, "in water 'structured', the task's in 'swift'"),
        ({"trials": {}}, "trials = {}; expected .*Trials"),
        ({"trials": list(ONE.items)}, "trials = .*; expected .*Trials"),
        ({"seed": 1}, "seed = 1 beside trials"),
        ({"progress": None}, "progress = None; expected a function"),
        ({"shift": (100, 0)}, "shift = 100.0; expected a number from -2 to 2"),
        ({"shift": 3}, "shift = 3; expected"),
        ({"shift": (float("nan"), 0)}, r"shift\[0\] = nan; expected finite numbers of shape"),
    ],
)
def test_run_refuses_a_wrong_argument(wrong, words):
    given = {"controller": "drift", "trials": ONE, "engine": "planar"} | wrong
    with pytest.raises(ConfigError, match=words):
        evaluate.run(**given)


def test_run_without_an_engine_swims_in_the_default_water():
    assert evaluate.run("drift", trials=ONE, engine=None).water == in_water(load_robot("fish")).water["model"]


@pytest.mark.parametrize("twice", [{"speeds": [0.2, 0.2]}, {"los_deg": [0, 360]}, {"los_deg": [45, 90, -315]}])
def test_trials_refuse_a_condition_that_stands_twice(twice):
    with pytest.raises(ConfigError, match="is given twice"):
        evaluate.trials(**twice)


def short_result(near: bool, left: bool = False) -> metrics.Result:
    """Judgement of six short trials of a fish at rest, which is at its target in the first tick if `near`."""
    robot = in_water(load_robot("fish"), "structured")
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 30, 60, 90, 120, 150], repeats=1, duration=1, turbulence="none")
    result = evaluate.run(control.make("drift", robot), robot, trials, engines.make("planar", robot))
    ticks = len(result.t)
    distance = np.full((6, ticks), 0.05 if near else 0.5)
    return result._replace(distance=distance, left=np.full(6, 3 if left else ticks))


@pytest.mark.parametrize(("near", "left", "value"), [(True, False, 1.0), (False, True, 0.0), (False, False, np.nan)])
def test_arrival_in_short_trials_is_unknown_unless_decided(near, left, value):
    result = short_result(near, left)
    np.testing.assert_array_equal(metrics.figures(result)["arrival"], np.full(6, value))
    found = metrics.summary(result)["overall"]
    assert found["rmse_last20"]["why"] == "trials of 1 s are too short; expected 60 s"
    assert found["arrival"]["why"] == ("" if np.isfinite(value) else "trials of 1 s are too short; expected 30 s")
    twin = {one.key: one.why for one in metrics.compare(result, result)}
    assert twin["rmse_total"] == "trials of 1 s are too short; expected 30 s" and not twin["power"]
    assert "rmse after" in trial_report.unbounded([metrics.summary(result)])[0]
    assert "too short to judge" in trial_report.headline([result])
