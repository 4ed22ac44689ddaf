"""Latencies of a description are played as long as they are: the engines and the tracker remember as much as they need."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj import engines
from fishmj.evaluate import protocol, run_trials
from fishmj.mjcf import load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.sensing import Sensors
from fishmj.water.flow import Flow


def late(**timing):
    robot = load_robot("fish")
    return replace(robot, timing=replace(robot.timing, **timing))


@pytest.mark.parametrize("seconds", [0.065, 0.1, 0.12, 0.3, 1.0])
@pytest.mark.parametrize("bus_dt", [0.02, 0.004])
def test_the_tracker_sees_the_pose_of_as_long_ago_as_the_camera_is_late(seconds, bus_dt):
    robot = late(camera_latency=seconds, bus_dt=bus_dt)
    params, camera = task.draw_fish(np, robot, np.full((1, task.n_fish(robot)), 0.5), 0.0)
    length, sensors = task.history_length(robot), Sensors(robot)
    ticks = int(np.ceil(seconds / bus_dt - 1e-6))
    assert camera.tolist() == [ticks]
    history = np.zeros((1, length, 3))
    history[0, :, 0] = np.arange(length) - length + 1  # x is the age in ticks
    zeros = np.zeros((1, robot.n_joints))
    obs = task.observe(np, robot, history, camera, zeros, zeros, np.zeros((1, 2)), np.zeros((1, 11)))
    assert obs[0, 0] == pytest.approx(ticks) and obs[0, 2] == pytest.approx(1 / bus_dt)
    assert sensors.frames == 0


@pytest.mark.parametrize("draw", [0.0, 0.999999])
@pytest.mark.parametrize("timing", [{}, {"bus_dt": 0.004}, {"bus_dt": 0.1}])
def test_no_randomised_latency_is_longer_than_what_is_remembered(draw, timing):
    robot = late(**timing)
    params, camera = task.draw_fish(np, robot, np.full((1, task.n_fish(robot)), draw), 1.0)
    assert camera[0] <= task.history_length(robot) - robot.timing.velocity_window
    assert camera[0] == int(np.ceil((0.03 + 0.07 * draw) / robot.timing.bus_dt - 1e-6))
    steps = engines.ticks_per(robot)[0]
    assert -(-params.delay[0] // steps) + 2 <= engines.rows_of(robot)


@pytest.mark.parametrize("seconds", [0.06, 0.14, 0.22, 0.5])
def test_a_command_reaches_the_servo_after_its_whole_latency(seconds):
    robot = late(command_latency=seconds)
    engine, params = engines.make("batch", robot), engines.nominal_params(robot, 1)
    ticks = 40
    commands = np.full((1, ticks, robot.n_joints), 0.3)
    rest, still = engines.at_rest(robot, np.zeros((1, 3))), run_trials.stack([Flow(speed=0.0)])
    _, trace = engine.advance(rest, commands, params, still, np.zeros(1, int))
    moved = int(np.argmax(np.abs(trace.joint[0, :, 0]) > 1e-4))
    assert moved == round(seconds / robot.timing.bus_dt)


def test_shipped_robots_remember_what_they_always_did():
    for name in ("fish", "tendon_fish"):
        robot = load_robot(name)
        assert engines.rows_of(robot) == 9 and task.history_length(robot) == robot.timing.velocity_window + 5


def test_a_camera_of_a_second_ago_is_judged_as_any():
    robot = late(camera_latency=1.0, command_latency=0.5)
    trials = protocol.trials(speeds=[0.2], los_deg=[0.0], repeats=1, duration=1.0, randomisation=0.0)
    result = run_trials.run("drift", robot, trials)
    assert np.isfinite(result.pose).all()
