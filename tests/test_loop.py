"""One sense-and-act loop and one water interface: what every caller of them relies on."""

from dataclasses import replace
from importlib import import_module

import mujoco
import numpy as np
import pytest

from fishmj import control, engines, mjcf
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines.single import HookedWater, MujocoWater, StripWater
from fishmj.hydro_fit.campaign.data.segment import ClosedLoop, Segment
from fishmj.sim import Sim
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import SensorWindow
from fishmj.tasks.sensing import Sensors

ROBOT = mjcf.load_robot("fish")
CROOKED = replace(ROBOT, effects=(FittedEffect("camera_scale", {"scale": Interval(0.2, 0.2, 0.2)}),))
SEGMENT = Segment(id="a", block="x", episode="a", split="train", seconds=1.0, drive={}, pose=(0.1, 0.2, 0.3))


class Run:
    """A fish that moves evenly."""

    def __init__(self, tick):
        self.pose = np.array([0.1 + 0.01 * tick, 0.2, 0.3, 0.5, 0.0, 0.0])
        self.tick = tick

    def angles(self):
        return np.array([0.1, 0.2, 0.3]) * self.tick

    def rates(self):
        return np.array([5.0, 10.0, 15.0])


def steered(robot, ticks=30):
    """Every command of a steered segment, and the observation behind the last."""
    loop, seen = ClosedLoop(SEGMENT, robot, "dob", (0.7, 0.0), 3, 1.0), []
    controller = loop.controller

    def spy(obs):
        seen.append(obs)
        return controller(obs)

    loop.controller = spy
    return np.array([loop(k, Run(k)) for k in range(ticks)]), np.concatenate(seen)


def test_a_steered_segment_observes_as_every_task_does():
    _, observed = steered(ROBOT)
    rng, camera = np.random.default_rng([11, 3]), 4  # 65 ms of camera in ticks of 20 ms
    noise = [rng.standard_normal((1, 11)) for _ in observed]
    poses = np.array([[0.1, 0.2, 0.3]] * 40 + [Run(k).pose[:3] for k in range(1, 21)])[None, -task.history_length(ROBOT) :]
    run = Run(20)
    at = (np.array([camera]), run.angles()[None], run.rates()[None], np.array([[0.7, 0.0]]), noise[2])
    np.testing.assert_array_equal(observed[2:3], task.observe(np, ROBOT, poses, *at))


def test_a_steered_segment_is_one_swim_whatever_effects_the_robot_lists():
    """Its identity leaves them out, and no plant that swims it has them."""
    for plain, crooked in zip(steered(ROBOT), steered(CROOKED), strict=True):
        np.testing.assert_array_equal(crooked, plain)


def test_a_window_keeps_its_length_and_its_newest_rows():
    window = SensorWindow.at_rest(ROBOT, Sensors(ROBOT), np.array([[1.0, 2.0, 3.0]]))
    pose, joint, rate = (np.random.default_rng(i).normal(size=(1, 4, 3)) for i in range(3))
    later = window.after(pose, joint, rate)
    assert later.pose.shape == window.pose.shape and later.joint.shape == window.joint.shape == (1, 1, 6)
    np.testing.assert_array_equal(later.pose[:, -4:], pose)
    np.testing.assert_array_equal(later.pose[:, 0], [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(later.joint[0, 0], [*joint[0, -1], *rate[0, -1]])


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({}, StripWater),
        ({"root": "free"}, StripWater),
        ({"water": "none"}, MujocoWater),
        ({"water": "ellipsoid"}, MujocoWater),
        ({"robot": engines.with_effects(ROBOT, ["tether"])}, HookedWater),
    ],
)
def test_every_water_takes_the_same_calls_and_leaves_no_callback(options, kind):
    sim = Sim(**options)
    assert type(sim.water) is kind
    sim.water.set_flow(np.zeros((4, 2)), np.zeros(2))
    sim.data.ctrl[:] = 0.3
    sim.water.step(sim.data)
    assert sim.data.time == pytest.approx(0.004) and sim.water.power >= 0.0 and np.abs(sim.data.qvel[3:]).max() > 0.0
    assert mujoco.get_mjcb_passive() is None


def test_the_registry_names_a_builder_for_every_controller():
    for name, entry in control.CONTROLLERS.items():
        assert callable(import_module(f"fishmj.control.{entry.module}").build) and entry.about
        assert control.make(name).name == name
