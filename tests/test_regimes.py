"""Regimes are told from the tables alone: every label on a trial made to show it, and on nothing else."""

import math

import numpy as np
import pytest

from fishmj import log
from fishmj.base.errors import LogError
from fishmj.log import regimes

DT = 0.02


def trial(command, joint=None, pose=None, seconds=8.0):
    """A synthetic trial on a 50 Hz clock from functions of time."""
    t = np.arange(0, seconds + DT / 2, DT)
    c = command(t)
    tables = {"cmd": {"t": t, "c1": c}, "joint": {"t": t, "j1": c if joint is None else joint(t)}}
    if pose is not None:
        x, y, yaw = (np.broadcast_to(v, t.shape).astype(float) for v in pose(t))
        tables["pose"] = {"t": t, "x": x, "y": y, "yaw": yaw}
    return log.Trial({"origin": "synthetic"}, tables, name="made up")


def beat(t, amplitude=0.4):
    return amplitude * np.sin(2 * math.pi * t)


def still(t):
    return 0 * t


def test_a_resting_robot_rests_and_does_nothing_else():
    found = regimes.label(trial(still, pose=lambda t: (0.3, 0.2, 0.1)))
    assert len(found) == 16 and found.is_["rest"].all()
    assert all(found.names(i) == ("rest",) for i in range(16))


def test_a_steady_beat_that_moves_the_body_is_a_steady_swim():
    found = regimes.label(trial(beat, pose=lambda t: (0.1 * t, 0.0, 0.02 * np.sin(2 * math.pi * t))))
    assert found.is_["steady_swim"][2:-1].all() and not found.is_["ramp"][3:-1].any()
    assert not any(found.is_[name].any() for name in ("rest", "coast", "turn", "joint_step", "creep", "torque_limited"))


def test_a_growing_beat_is_a_ramp():
    found = regimes.label(trial(lambda t: beat(t, 0.03 * 2.0 ** np.clip(t, 0, 5)), pose=lambda t: (0.1 * t, 0.0, 0.0)))
    assert found.is_["ramp"][3:9].all() and not found.is_["steady_swim"][4:9].any()


def test_joints_at_rest_on_a_moving_body_are_a_coast():
    def speed(t):
        return 0.3 * np.minimum(t, 4) + 0.1 * np.clip(t - 4, 0, None)

    found = regimes.label(trial(lambda t: np.where(t < 4, beat(t), 0.0), pose=lambda t: (speed(t), 0.0, 0.0)))
    assert found.is_["coast"][9:].all() and not found.is_["coast"][:7].any() and not found.is_["rest"].any()


def test_a_step_of_the_command_is_found_in_its_window_only():
    found = regimes.label(trial(lambda t: np.where(t < 4.2, 0.0, 0.3)))
    assert found.is_["joint_step"].nonzero()[0].tolist() == [8]
    assert not regimes.label(trial(beat)).is_["joint_step"].any()


def test_a_turn_is_a_heading_that_goes_on_and_not_one_that_wags():
    turning = regimes.label(trial(beat, pose=lambda t: (0.1 * t, 0.0, 0.4 * t)))
    wagging = regimes.label(trial(beat, pose=lambda t: (0.1 * t, 0.0, 0.3 * np.sin(2 * math.pi * t))))
    assert turning.is_["turn"].all() and not wagging.is_["turn"][1:-1].any()


def test_stalled_servo_is_torque_limited_and_a_disabled_servo_is_not():
    held = trial(lambda t: np.full_like(t, 0.5), joint=lambda t: np.full_like(t, 0.2))
    assert regimes.label(held).is_["torque_limited"].all()
    held.tables["cmd"]["on1"] = np.zeros(len(held.tables["cmd"]["t"]))
    assert not regimes.label(held).is_["torque_limited"].any()
    late = trial(beat, joint=lambda t: beat(t - 0.05))  # behind, but on its way
    assert not regimes.label(late).is_["torque_limited"].any()


def test_creep_is_motion_below_five_degrees_a_second():
    assert regimes.label(trial(lambda t: math.radians(3) * t)).is_["creep"].all()
    assert not regimes.label(trial(lambda t: math.radians(8) * t)).is_["creep"].any()
    assert not regimes.label(trial(still)).is_["creep"].any()


def test_labels_that_cannot_be_told_are_not_in_known():
    only = log.Trial({}, {"cmd": {"t": np.arange(0, 4, DT), "c1": beat(np.arange(0, 4, DT))}})
    found = regimes.label(only)
    assert set(found.known) == {"rest", "joint_step", "steady_swim", "ramp"}


def test_steady_swim_is_recognised_from_a_logged_gait_without_joints():
    t = np.arange(0, 8, 1 / 30)
    tables = {
        "gait": {"t": t, "amplitude": np.full_like(t, 0.3), "bias": 0 * t},
        "pose": {"t": t, "x": 0.1 * t, "y": 0 * t, "yaw": 0.1 * np.sin(2 * math.pi * t)},
    }
    assert regimes.label(log.Trial({}, tables)).is_["steady_swim"][2:].all()


def test_a_trial_shorter_than_a_window_is_refused():
    with pytest.raises(LogError, match=r"0.200 s long; one window takes 0.5 s"):
        regimes.label(trial(still, seconds=0.2))
