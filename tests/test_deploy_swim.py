"""The whole loop on the loopback robot: in lockstep in one process, and in real time over UDP and shared memory."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fishmj.control.learned import LearnedController
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.loop import arming
from fishmj.deploy.loop.pilot import PlayedPilot, PolicyPilot
from fishmj.deploy.loop.supervisor import Condition
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loopback import faults
from fishmj.deploy.loopback.lockstep import LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, make_robot
from fishmj.log import excitation, read_trial
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow

ROOT = Path(__file__).resolve().parent.parent
SWIM = [sys.executable, "-m", "fishmj.deploy", "swim", "--policy", "station", "--json"]


def lockstep(folder, seconds, *, policy="station", pilot=None, target=(0.0, 0.0), **settings):
    """A swim of a loopback robot in this process: (outcome, trial, robot)."""
    robot = make_robot(LoopbackSettings(**settings))
    clock, description = LockstepClock(robot), load_robot("fish")
    link, controller = Fishmj1Link(LockstepTransport(clock)), LearnedController(description, policy)
    rig = Rig(
        robot=description, link=link, localiser=InStep(LockstepCamera(clock), PoseTracker(seed=1)), clock=clock,
        examine=lambda info: arming.examine(link, info, description, controller, False),
    )  # fmt: skip
    rig.localiser.open()
    with TrialLog(folder, {"origin": "synthetic", "robot": "fish"}, 3, every=1e6) as log:
        outcome = SwimLoop(rig, pilot or PolicyPilot(controller), SwimPlan(seconds=seconds, target=target), log).run()
    return outcome, read_trial(folder), robot


def test_the_host_swims_the_second_robot_and_its_log_reads(tmp_path):
    outcome, trial, robot = lockstep(tmp_path / "swim", 3.0, start=(-0.5, 0.3, 0.0), seed=2)
    assert outcome.complete
    far = np.hypot(trial.tables["pose"]["x"], trial.tables["pose"]["y"])
    assert far[-1] < far[0] - 0.15  # it swims to the target
    assert len(trial.tables["obs"]["t"]) == 15
    truth = robot.pose()
    assert np.hypot(trial.tables["pose"]["x"][-1] - truth[0], trial.tables["pose"]["y"][-1] - truth[1]) < 0.08


def test_two_percent_loss_and_reordering_do_not_end_a_swim(tmp_path):
    bad = faults.parse(["loss=0.02", "reorder=0.05", "duplicate=0.05", "corrupt=0.02"])
    outcome, trial, _ = lockstep(tmp_path / "swim", 3.0, start=(-0.5, 0.3, 0.0), faults=bad)
    assert outcome.complete
    assert outcome.figures["link"]["bad"] > 0 and outcome.figures["link"]["old"] > 0
    assert (np.diff(trial.tables["joint"]["seq"]) > 0).all()


@pytest.mark.parametrize("name", ["square", "impulse"])
def test_a_step_that_a_joint_has_not_followed_yet_is_no_stuck_servo(tmp_path, name):
    steps = PlayedPilot(excitation.get(name).commands[:150])
    assert lockstep(tmp_path / "swim", 3.0, pilot=steps)[0].complete


FAULTS = {
    "silent_radio@1": (Condition.LINK_SILENT, 1.4),
    "silent_radio:down@1": (Condition.LINK_SILENT | Condition.ROBOT_NEUTRAL, 1.45),
    "brown_out@1": (Condition.LINK_SILENT | Condition.ROBOT_NEUTRAL, 1.5),
    "stuck_servo=2@1": (Condition.SERVO_STUCK, 2.2),
    "low_battery=6.0@1": (Condition.BATTERY_LOW, 2.2),
    "camera_loss@1": (Condition.POSE_LOST, 1.7),
    "camera_jump@1": (Condition.POSE_LOST, 1.7),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_the_loopback_robot_ends_in_neutral_in_time(tmp_path, fault):
    cause, latest = FAULTS[fault]
    outcome, trial, robot = lockstep(tmp_path / "swim", 4.0, start=(-0.5, 0.3, 0.0), faults=faults.parse([fault]))
    assert outcome.cause & cause
    cmd = trial.tables["cmd"]
    ended = cmd["t"][cmd["state"] == 4][0] if (cmd["state"] == 4).any() else cmd["t"][-1]
    assert ended <= latest
    assert "NEUTRAL" in " ".join(trial.meta["host"]["events"][-2:])  # after it at most that the torque went off at once


@pytest.mark.slow
def test_policy_holds_station_in_fitted_water_through_the_whole_chain(tmp_path):
    stream = Flow(speed=0.2, direction=np.pi)
    outcome, trial, _ = lockstep(tmp_path / "swim", 20.0, start=(-0.7, 0.0, 0.0), body="fitted", flow=stream)
    assert outcome.complete
    pose = trial.tables["pose"]
    last = pose["t"] > pose["t"][-1] - 8.0
    assert np.sqrt(np.mean(pose["x"][last] ** 2 + pose["y"][last] ** 2)) < 0.1


@pytest.mark.slow
def test_a_swim_over_udp_and_shared_memory_ends_well(tmp_path):
    words = [*SWIM, "--seconds", "6", "--wait", "30", "--out", str(tmp_path / "swim"), "--loopback", "--start -0.3,0.2,0"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=600, check=False)
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["figures"]["loop"]["ticks"] > 50 and told["figures"]["camera"]["fixes"] > 10, done.stderr
    trial = read_trial(tmp_path / "swim")
    assert {"cmd", "joint", "pose", "power"} <= set(trial.tables)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_swim_that_is_ended_by_a_signal_closes_its_log(tmp_path, number):
    words = [*SWIM, "--seconds", "60", "--wait", "60", "--out", str(tmp_path / "swim"), "--loopback", "--start -0.3,0.2,0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        end = time.monotonic() + 600
        while not (tmp_path / "swim").exists() and time.monotonic() < end:
            time.sleep(0.1)
        os.kill(process.pid, number)
        out, err = process.communicate(timeout=600)
    assert process.returncode == (143 if number == signal.SIGTERM else 130), err
    trial = read_trial(tmp_path / "swim")
    events = " ".join(trial.meta["host"]["events"])
    assert "OPERATOR_STOP" in events or "interrupted" in events or "NEUTRAL" in events  # a busy machine may have ended it before
