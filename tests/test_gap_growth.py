"""A model restarted in mid-swim: from where the robot was, and back on the model's own motion."""

import numpy as np
import pytest

from fishmj import effects
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.localise import error_growth
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import Record, Sensor, record_of

EFFECTS = (  # as in test_gap.py: one compiled plant for both
    *("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag"),
)
SEED = 7


@pytest.fixture(scope="module")
def plant():
    return SwimmingFish("fish", [effects.get(name) for name in EFFECTS])


def wave(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses and angles of a motion with known rates."""
    pose = np.stack([0.3 * t, 0.05 * np.sin(2 * t), 0.4 * np.sin(3 * t)], 1)
    return pose, 0.5 * np.sin(6 * t)[:, None] * np.ones(3)


def test_a_cut_starts_where_the_robot_was_not_where_the_camera_saw_it():
    t, late = np.arange(0, 6, 0.02), error_growth.StampAges(0.06, 0.01, 0.065)
    pose, joint = wave(t - late.pose)[0], wave(t - late.joint)[1]
    blank = dict(excitation="", replicate_of="", power=None, flow=(0.0, 0.0), medium="water", session=5.0)
    blank |= dict(place=pose[0], start=pose[0], push=np.zeros(3), joints=joint[0])
    commands = np.arange(1500)[:, None] * np.ones(3) * 0.004
    given = Record("a", dt=0.004, commands=commands, joint=Sensor(t, joint, np.full(3, 1e-3)),
                   pose=Sensor(t, pose, np.full(3, 1e-3)), **blank)  # fmt: skip
    found = error_growth.cut(given, 2.0, 1.0, late)
    yaw = 0.4 * np.sin(6.0)
    ahead, left = 0.3, 0.1 * np.cos(4.0)
    c, s = np.cos(yaw), np.sin(yaw)
    assert found.record.start == pytest.approx(wave(np.array([2.0]))[0][0], abs=3e-3)
    assert found.record.push == pytest.approx([c * ahead + s * left, c * left - s * ahead, 1.2 * np.cos(6.0)], abs=0.02)
    assert found.swing == pytest.approx(3 * np.cos(12.0) * np.ones(3), abs=0.06)
    assert found.record.commands[0] == pytest.approx(2.0 - late.command) and found.record.session == 7.0
    assert error_growth.cut(given, 0.01, 1.0, late) is None, "no stamps before it"


def test_a_restart_from_the_models_own_motion_finds_no_error(plant):
    """What the model predicts, taken for measured: after a restart it comes back to it."""
    record = record_of(generate({}, ["gait"], SEED)[0], plant.dt)
    dream = plant.predict([record], plant.null)[0]
    own = record._replace(
        joint=record.joint._replace(values=dream["joint"][0]), pose=record.pose._replace(values=dream["pose"][0])
    )
    _, error, _ = error_growth.errors(plant, [own], plant.null)
    rms = np.sqrt(np.nanmean(error**2, 0))  # (H, J + 3)
    assert len(error) > 15 and np.all(rms[:, :3] < 0.004) and np.all(rms[2, 3:5] < 0.008) and rms[2, 5] < 0.02


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_horizon_that_no_restart_reaches_is_missing(plant):
    """Angles with a pause: no restart meets them again after three seconds."""
    record = record_of(generate({}, ["gait"], SEED)[0], plant.dt)
    t = record.joint.t
    some = (t < 2.5) | (t > t[-1] - 0.9)
    paused = record._replace(joint=Sensor(t[some], record.joint.values[some], record.joint.sigma))
    joint, position, _ = error_growth.curves(plant, [paused], plant.null, plant.null)
    assert np.isnan(joint.before).tolist() == [False, False, False, True] and np.isfinite(position.before).all()
