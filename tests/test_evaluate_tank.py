"""Judging in the flow solver: the same driver and control, one tank of water a trial."""

import numpy as np
import pytest

from fishmj import control, engines
from fishmj.base.errors import ConfigError
from fishmj.engines import lbm
from fishmj.evaluate import run_trials, trials
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.mjcf import load_robot
from fishmj.water.flow import Flow

ROBOT = load_robot("fish")


def plan(**changes):
    return trials(**{"speeds": [0.2], "los_deg": [0], "repeats": 1, "duration": 1.0, **changes})


@pytest.mark.slow
def test_a_trial_in_the_solver_is_kept_and_not_run_again(tmp_path, monkeypatch):
    judge = lambda: run_trials.judge_in_solver(
        control.make("drift", ROBOT), ROBOT, plan(), tmp_path, domain="laptop", device="cpu"
    )
    first = judge()
    assert first.water == "lbm" and first.pose.shape == (1, 51, 3) and np.isfinite(first.pose).all()
    drifted = first.pose[0, -1, 0] - first.pose[0, 0, 0]
    assert 0.005 < drifted < 0.1, "a fish at rest over ground is carried along by the stream of 0.2 m/s within a second"
    monkeypatch.setattr(lbm, "LbmEngine", None)  # a second simulation would fail
    again = judge()
    for name in ("pose", "joint", "power", "distance", "left"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_what_would_change_a_trial_changes_its_file_name():
    brain = control.make("dob", ROBOT)
    base = run_trials.fingerprint(brain, ROBOT, plan(), PLAIN)
    others = [
        run_trials.fingerprint(control.make("pd", ROBOT), ROBOT, plan(), PLAIN),
        run_trials.fingerprint(brain, ROBOT, plan(duration=2.0), PLAIN),
        run_trials.fingerprint(brain, ROBOT, plan(seed=1), PLAIN),
        run_trials.fingerprint(brain, ROBOT, plan(turbulence="gust"), PLAIN),
        run_trials.fingerprint(brain, ROBOT, plan(), PLAIN._replace(domain="laptop")),
        run_trials.fingerprint(brain, ROBOT, plan(), PLAIN._replace(slip=0.95)),
    ]
    assert len({base, *others}) == 7
    assert base == run_trials.fingerprint(control.make("dob", ROBOT), ROBOT, plan(), PLAIN)


def test_as_many_fish_as_flows():
    engine = lbm.LbmEngine(ROBOT, plan().flows(), domain="laptop", device="cpu")
    state, params = engines.at_rest(ROBOT, np.zeros((2, 3))), engines.nominal_params(ROBOT, 2)
    with pytest.raises(ConfigError, match="2 fish for 1 flows"):
        engine.advance(state, np.zeros((2, 10, 3)), params, None, np.zeros(2, int))


@pytest.mark.slow
def test_a_trial_in_a_stream_begins_at_rest_in_water_that_flows_past():
    """Let go in water that was never stopped by it, a fish has the stream's speed after two ticks."""
    engine = lbm.LbmEngine(ROBOT, [Flow(speed=0.2)], domain="laptop", device="cpu")
    state, params = engines.at_rest(ROBOT, np.zeros((1, 3))), engines.nominal_params(ROBOT, 1)
    _, trace = engine.advance(state, np.zeros((1, 5, 3)), params, None, np.zeros(1, int))
    assert engine.ticks == [5] and engine.tanks.runs[0].coupled.fluid.time == pytest.approx(0.1)
    assert 0 < trace.velocity[0, 0, 0] < 0.01 and np.abs(trace.velocity[0, :, :2]).max() < 0.05
