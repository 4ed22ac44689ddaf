"""The end of a swim: the torque goes off, at once where it must, and the last line says where nobody knows that it did."""

import io
import re
from threading import Event

import numpy as np
import pytest

from fishmj.base import console, interrupt
from fishmj.deploy.commands import swim_command
from fishmj.deploy.link.links import MishLink
from fishmj.deploy.loop.arming import why_not_armed
from fishmj.deploy.loop.graceful_stop import GRACE, TIMES, graceful_stop
from fishmj.deploy.loop.pilot import PlayedPilot
from fishmj.deploy.loop.status import StatusLine
from fishmj.deploy.loop.supervisor import Condition, SwimState
from fishmj.deploy.loop.swim_loop import HOME, LET_GO, SwimOutcome
from fishmj.deploy.protocols.messages import RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.watchdog import Watchdog
from fishmj.log import read_trial
from tests.deploying import DT, Bench


def test_stop_grace_period_covers_homing_and_torque_release():
    assert GRACE > HOME + LET_GO * DT + 2.0  # s, for a log of an hour
    with graceful_stop(Event(), lambda: None, lambda: ""):
        assert interrupt._kept[-1].grace == GRACE
    assert not interrupt._kept


def test_a_swim_that_is_heard_to_let_go_says_nothing_of_it(tmp_path):
    outcome = Bench(tmp_path / "swim", seconds=1.0).swim()
    assert outcome.released is True and outcome.words.startswith("swam 1.0 s; ended by FINISHED; ")
    assert "torque" not in outcome.words


def test_a_robot_that_does_not_let_go_is_told_of_and_the_exit_code_is_1(tmp_path, monkeypatch, capsys):
    bench = Bench(tmp_path / "swim", seconds=1.0)
    monkeypatch.setattr(bench.robot, "disarm", lambda now: None)
    outcome = bench.swim()
    assert outcome.complete and outcome.released is False
    assert outcome.words.endswith("torque NOT confirmed off: use the switch")
    monkeypatch.setattr(swim_command, "_swum", lambda *_: outcome)
    monkeypatch.chdir(tmp_path)
    assert swim_command.main(["--policy", "station"]) == console.FAILED_CHECK
    assert "use the switch" in capsys.readouterr().out


def test_an_answer_from_before_the_robot_was_told_confirms_nothing(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: setattr(bench.robot, "state", RobotState.IDLE))  # it began anew, and falls silent
    bench.at(1.02, lambda: setattr(bench.robot, "silent", True))
    assert bench.swim().released is False


def test_a_robot_that_cannot_say_or_cannot_let_go_has_words_for_it(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.robot.changes["state"] = None
    outcome = bench.swim()
    assert outcome.released is None and "cannot confirm" in outcome.words
    assert "letting go" in MishLink(None).lacks
    outcome = SwimOutcome(cause=Condition.FINISHED, refused=(), swim_seconds=1.0, figures={}, released=None, lets_go=False)
    assert outcome.words.endswith("keeps its torque: use the switch")


def test_a_robot_without_a_state_is_given_torque_once(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.robot.changes["state"], armed = None, []
    bench.robot.arm = lambda *given: armed.append(given)
    assert bench.swim().complete and len(armed) == 1


AT_ONCE = {
    "hot": {"temperature": (30.0, 76.0, 30.0)},
    "no_reply": {"fault": (ServoFault.NONE, ServoFault.NO_REPLY, ServoFault.NONE)},
    "locked": {"fault": (ServoFault.NONE, ServoFault.NONE, ServoFault.LOCKED)},
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_a_servo_that_is_hot_jammed_or_unheard_loses_its_torque_at_once(tmp_path, name):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: bench.robot.changes.update(AT_ONCE[name]))
    bench.swim()
    assert np.abs(bench.robot.sent[-1]).max() > 0.1  # it is not pulled to zero before
    assert "torque off at once" in " ".join(bench.log.events)


def on_the_way_to_zero(bench, then):
    """A swim that is over after 1 s; 0.1 s later, on the way to zero, `then` happens. s that NEUTRAL took."""
    bench.robot.stuck.clear()
    step = bench.swim
    begun = lambda: next((e.t for e in bench.events if e.after is SwimState.NEUTRAL), None)
    listen = bench.eyes.fixes

    def fixes(now):
        if begun() is not None and now > begun() + 0.1:
            then()
        return listen(now)

    bench.eyes.fixes = fixes
    step()
    return bench.clock.now() - begun()


def test_stop_or_hot_servo_while_homing_removes_the_torque_at_once(tmp_path):
    plain = Bench(tmp_path / "plain", seconds=1.0)
    whole = on_the_way_to_zero(plain, lambda: None)
    assert whole > 0.25
    stopped, hot = Bench(tmp_path / "stopped", seconds=1.0), Bench(tmp_path / "hot", seconds=1.0)
    assert on_the_way_to_zero(stopped, lambda: setattr(stopped, "stopped", True)) < 0.2
    assert on_the_way_to_zero(hot, lambda: hot.robot.changes.update(temperature=(80.0,) * 3)) < 0.2


def test_the_stop_that_began_the_way_to_zero_does_not_break_it_off(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: setattr(bench, "stopped", True))
    assert bench.swim().cause == Condition.OPERATOR_STOP
    np.testing.assert_allclose(bench.robot.sent[-1], 0.0)


class Firmware:
    """The states of `fishmj-1`: NEUTRAL is left by DISARM alone, and ARM counts in IDLE only."""

    def __init__(self, bench, state):
        robot = bench.robot
        robot.state = state
        robot.arm = lambda *_: setattr(robot, "state", RobotState.ARMED if robot.state is RobotState.IDLE else robot.state)


@pytest.mark.parametrize("left", [RobotState.NEUTRAL, RobotState.HOLD, RobotState.ARMED])
def test_robot_left_energised_by_a_killed_host_is_released_then_armed(tmp_path, left):
    bench = Bench(tmp_path / "swim", seconds=0.5, plan={"wait": 2.0})
    Firmware(bench, left)
    assert bench.swim().complete


def test_a_robot_that_does_not_arm_is_told_with_its_state(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.robot.changes["state"] = RobotState.NEUTRAL
    assert bench.swim().refused == ("the robot did not arm in 1 s; it says NEUTRAL",)


REFUSED = {
    "servo 2 (from the head) does not answer": {"fault": (ServoFault.NONE, ServoFault.NO_REPLY, ServoFault.NONE)},
    "joint 3 at -63.0 deg (from the head), beyond the 62 deg": {"joint": (0.0, 0.0, np.radians(-63.0))},
    "do its packets arrive": {},
}


@pytest.mark.parametrize("why", REFUSED)
def test_an_arm_that_is_refused_is_told_with_its_reason(why):
    told = Telemetry((0.0, 0.0, 0.0), state=RobotState.IDLE)._replace(**REFUSED[why])
    assert why in why_not_armed(told, np.pi / 3, 0.1, 0.3)
    if "packets" not in why:  # the robot's own watchdog refuses for the same reason, and for none that is not told
        silent = [ServoFault.NO_REPLY in fault for fault in told.fault or [ServoFault.NONE] * 3]
        measured = [np.nan if gone else angle for gone, angle in zip(silent, told.joint, strict=True)]
        assert not Watchdog().arm(1.0, 0.1, 0.3, measured)


def test_watchdog_times_that_no_firmware_takes_are_told():
    assert "hold 0.3 s, neutral 0.1 s" in why_not_armed(Telemetry((0.0,), state=RobotState.IDLE), 1.0, 0.3, 0.1)
    assert why_not_armed(None, 1.0, 0.1, 0.3) == why_not_armed(Telemetry((0.0,)), 1.0, 0.1, 0.3) == ""


def test_refused_arming_names_the_joint_beyond_its_range(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.robot.arm = lambda *_: None
    bench.robot.changes["joint"] = (1.2, 0.0, 0.0)
    (why,) = bench.swim().refused
    assert why.startswith("the robot did not arm in 1 s; it says IDLE: joint 1 at 68.8 deg")


def test_the_firmware_of_the_robot_stands_in_the_log(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.robot.info = bench.robot.info._replace(firmware_sha256="ab" * 32)
    bench.swim()
    assert read_trial(bench.folder).meta["host"]["robot"] == {
        "firmware": "fake-1", "firmware_sha256": "ab" * 32, "policy_sha256": "",
    }  # fmt: skip


def test_a_terminal_that_is_gone_does_not_end_the_swim(tmp_path, monkeypatch):
    def gone(*_, **__):
        raise OSError("no terminal")

    status = StatusLine(1.0)
    monkeypatch.setattr(status._bar, "update", gone)
    bench = Bench(tmp_path / "swim", seconds=1.0)
    bench.robot.changes["temperature"] = None
    monkeypatch.setattr(console, "warn", gone)
    assert bench.swim(status=status).complete


def test_the_status_line_tells_the_wait_and_then_the_time_left(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=3.0)
    bench.eyes.blind, shown, clock = True, io.StringIO(), bench.clock
    status = StatusLine(3.0)
    status._bar = console.Progress(3.0, "swim", "s", stream=shown, clock=clock.now, every=0.5)
    fixes = bench.eyes.fixes

    def late(now):
        bench.eyes.blind = now < 105.0
        return fixes(now)

    bench.eyes.fixes = late
    assert bench.swim(status=status).complete
    lines = shown.getvalue().splitlines()
    assert "waiting for robot and camera, LINKED: POSE_LOST" in lines[1]
    left = [float(re.search(r"([0-9.]+) s left", line)[1]) for line in lines if " left" in line]
    assert left and max(left) < 3.2


def test_letting_go_blindly_goes_on_where_the_link_fails(tmp_path):
    told = []

    def let_go():
        told.append(1)
        raise OSError("no route")

    with graceful_stop(Event(), let_go, lambda: ""):
        interrupt._last()
    assert len(told) == TIMES


@pytest.mark.parametrize("seconds", [5.0, 12.0])
def test_a_swim_says_how_far_from_its_target_it_was(tmp_path, seconds):
    bench = Bench(tmp_path / "swim", seconds=seconds, plan={"target": (0.3, 0.1)})
    outcome, pose = bench.swim(), read_trial(tmp_path / "swim").tables["pose"]
    began = next(event.t for event in bench.events if event.after is SwimState.SWIMMING) - bench.log._zero
    home = next(event.t for event in bench.events if event.after is SwimState.NEUTRAL) - bench.log._zero
    swum = (pose["t_taken"] >= began) & (pose["t_rx"] < home + DT / 2)
    off, t = np.hypot(pose["x"] - 0.3, pose["y"] - 0.1)[swum], pose["t_taken"][swum]
    rms = [np.sqrt(np.mean(part**2)) for part in (off, off[t > t[-1] - 10.0])[: 1 + (seconds > 10)]]
    np.testing.assert_allclose(outcome.off_target, rms, atol=3e-4)
    recent = f" ({outcome.off_target[1]:.3f} in the last 10 s)" if seconds > 10 else ""
    assert outcome.words.endswith(f"ended by FINISHED; {outcome.off_target[0]:.3f} m RMS from the target{recent}")
    assert outcome.figures["off_target_m"]["rms"] == outcome.off_target[0]
    assert ("rms_last_10_s" in outcome.figures["off_target_m"]) == (seconds > 10)


def test_a_gait_steers_to_nowhere_and_says_no_distance(tmp_path):
    outcome = Bench(tmp_path / "swim", seconds=1.0, pilot=PlayedPilot(np.zeros((50, 3)))).swim()
    assert outcome.off_target == () and "target" not in outcome.words
