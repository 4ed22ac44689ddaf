"""Faults 23, 24 and 25 of a deployed robot: where each ends, how soon, and that the log is whole."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.loop.command_limits import RATE
from fishmj.deploy.loop.supervisor import Condition, SwimState
from fishmj.deploy.protocols.messages import RobotState, ServoFault
from fishmj.log import read_trial
from tests.deploying import Bench


def ended(bench, outcome, cause, latest):
    """The swim ended in NEUTRAL for this cause by `latest` s, the robot was let go, the log is closed and whole."""
    assert bench.rig.supervisor.state is SwimState.NEUTRAL
    assert cause in outcome.cause
    assert bench.to_neutral() <= latest + 1e-6
    assert bench.robot.disarmed > 0
    trial = read_trial(bench.folder)
    assert bench.log.closed and f"NEUTRAL: {cause.name}" in " ".join(trial.meta["host"]["events"])
    sent = np.stack([trial.tables["cmd"][f"c{k}"] for k in (1, 2, 3)], 1)
    assert np.allclose(sent, bench.robot.sent)  # nothing is lost
    return trial


def test_a_swim_without_a_fault_ends_when_its_time_is_over(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=3.0)
    outcome = bench.swim()
    assert outcome.complete and outcome.swim_seconds == pytest.approx(3.0, abs=0.021)
    assert [event.after.name for event in bench.events] == ["LINKED", "ARMED", "SWIMMING", "NEUTRAL"]
    trial = ended(bench, outcome, Condition.FINISHED, 3.0)
    assert len(trial.tables["obs"]["t"]) == len(trial.tables["action"]["t"]) == 15
    assert np.allclose(bench.robot.sent[-1], 0.0)  # the joints are straight when the torque goes off


def test_fault_23_telemetry_gap_over_100_ms_holds_joints_then_resumes(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=2.0)
    bench.at(1.0, lambda: setattr(bench.robot, "silent", True))
    bench.at(1.24, lambda: setattr(bench.robot, "silent", False))
    outcome = bench.swim()
    assert outcome.complete
    trial = read_trial(bench.folder)
    t, asked = trial.tables["cmd"]["t"], np.stack([trial.tables["cmd"][f"asked{k}"] for k in (1, 2, 3)], 1)
    begun = trial.tables["obs"]["t"][0]
    still = (t > begun + 1.13) & (t < begun + 1.23)
    assert still.sum() >= 4 and np.ptp(asked[still], 0).max() < 1e-9
    assert np.ptp(asked[(t > begun + 0.5) & (t < begun + 1.0)], 0).max() > 0.01


@pytest.mark.parametrize("how", ["silent", "deaf"])
def test_fault_23_silence_of_300_ms_ends_in_neutral(tmp_path, how):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: setattr(bench.robot, how, True))
    ended(bench, bench.swim(), Condition.LINK_SILENT, 1.0 + 0.3 + 0.04)


def test_fault_23_a_robot_that_began_anew_ends_in_neutral(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: setattr(bench.robot, "state", RobotState.IDLE))
    ended(bench, bench.swim(), Condition.ROBOT_NEUTRAL, 1.04)


SERVO = {
    "no_reply": ({"fault": (ServoFault.NONE, ServoFault.NO_REPLY, ServoFault.NONE)}, Condition.SERVO_LOST, 0.04),
    "hot": ({"temperature": (30.0, 76.0, 30.0)}, Condition.SERVO_HOT, 0.04),
    "hot_bit": ({"fault": (ServoFault.HOT, ServoFault.NONE, ServoFault.NONE)}, Condition.SERVO_HOT, 0.04),
    "locked": ({"fault": (ServoFault.NONE, ServoFault.NONE, ServoFault.LOCKED)}, Condition.SERVO_STUCK, 0.04),
    "low_battery": ({"voltage": 6.1}, Condition.BATTERY_LOW, 1.04),
    "low_servo_voltage": ({"voltage": None, "current": None, "servo_voltage": (6.0, 6.1, 6.0)}, Condition.BATTERY_LOW, 1.04),
    "wild_reading": ({"joint": (0.0, 5.0, 0.0)}, Condition.READING_BAD, 0.04),
    "nan_reading": ({"joint": (0.0, float("nan"), 0.0)}, Condition.READING_BAD, 0.04),
}


LOW = {
    "fishmj-1": {"voltage": 6.1},
    "servo bus": {"voltage": None, "state": None, "servo_voltage": (6.0, 6.1, 6.2)},
}


@pytest.mark.parametrize("told", LOW)
def test_a_robot_whose_battery_is_low_gets_no_torque(tmp_path, told):
    bench = Bench(tmp_path / "swim", plan={"wait": 2.0})
    bench.robot.changes.update(LOW[told])
    outcome = bench.swim()
    assert not outcome.cause and bench.robot.sent == [] and not bench.folder.exists()
    assert "BATTERY_LOW (6.10 V, low_voltage is 6.4 V: charge it" in outcome.words


def test_a_low_battery_that_ends_a_swim_is_told_with_its_voltage(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: bench.robot.changes.update(voltage=6.1))
    assert "ended by BATTERY_LOW (6.10 V, low_voltage is 6.4 V" in bench.swim().words


@pytest.mark.parametrize(
    ("name", "told"),
    {"hot": "joint 2 from the head) has 76 deg C", "wild_reading": "joint 2 from the head) reports 5 rad"}.items(),
)
def test_swim_that_a_servo_ends_names_it(tmp_path, name, told):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: bench.robot.changes.update(SERVO[name][0]))
    assert told in bench.swim().words


@pytest.mark.parametrize("name", SERVO)
def test_fault_24_each_fault_of_a_servo_or_the_battery_ends_in_neutral(tmp_path, name):
    changes, cause, after = SERVO[name]
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: bench.robot.changes.update(changes))
    ended(bench, bench.swim(), cause, 1.0 + after)
    assert all(np.isfinite(command).all() for command in bench.robot.sent)


def test_fault_24_a_joint_that_does_not_follow_ends_in_neutral(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(0.8, lambda: bench.robot.stuck.update({1}))
    ended(bench, bench.swim(), Condition.SERVO_STUCK, 1.8)


def test_fault_24_a_sag_under_one_kick_is_no_empty_battery(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: bench.robot.changes.update(voltage=6.1))
    bench.at(1.5, lambda: bench.robot.changes.update(voltage=7.2))
    assert bench.swim().complete


def test_fault_24_command_lead_over_measured_joint_obeys_the_servo_rate(tmp_path):
    bench = Bench(tmp_path / "swim")
    bench.at(0.5, lambda: setattr(bench.robot, "joint", np.array([-1.0, 1.0, -1.0])))  # pushed aside
    bench.swim()
    trial = read_trial(bench.folder)
    ahead = bench.description.timing.command_latency + 0.02
    for k in (1, 2, 3):
        measured = np.interp(trial.tables["cmd"]["t"], trial.tables["joint"]["t_rx"], trial.tables["joint"][f"j{k}"])
        lead = np.abs(trial.tables["cmd"][f"c{k}"] - measured)
        assert lead.max() <= RATE * ahead + 1e-6
        assert np.abs(trial.tables["cmd"][f"c{k}"]).max() <= np.pi / 3 + 1e-9


def unguarded(bench):
    return read_trial(bench.folder).meta["host"].get("unguarded", [])


def test_fault_24_guards_that_lack_a_measurement_are_told_once_at_arming(tmp_path, capsys):
    bench = Bench(tmp_path / "whole", seconds=0.5)
    assert bench.swim().complete and unguarded(bench) == [] and "guards" not in capsys.readouterr().err
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.robot.changes |= {"voltage": None, "servo_voltage": None, "temperature": None}
    assert bench.swim().complete
    assert unguarded(bench) == ["BATTERY_LOW (no voltage)", "SERVO_HOT (no temperatures)"]
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and "nothing guards against BATTERY_LOW" in said[0]


def test_fault_24_a_measurement_that_comes_no_more_is_told_on_the_way(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=5.0)
    bench.at(1.0, lambda: bench.robot.changes.update(temperature=None))
    assert bench.swim().complete and unguarded(bench) == ["SERVO_HOT (no temperatures)"]


def test_fault_24_arming_waits_for_slow_measurements(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=0.5)
    bench.robot.changes["temperature"] = None
    fixes = bench.eyes.fixes

    def late(now):
        if now > 100.3:
            bench.robot.changes.clear()
        return fixes(now)

    bench.eyes.fixes = late
    assert bench.swim().complete and unguarded(bench) == []


def wrong_joints(bench):
    bench.robot.info = bench.robot.info._replace(joints=("j1", "j3", "j2"))


def wrong_range(bench):
    bench.robot.info = bench.robot.info._replace(servo_range=2.0)


def wrong_hash(bench):
    bench.robot.info = bench.robot.info._replace(policy_sha256="ab" * 32)


def slow_watchdog(bench):
    bench.robot.info = bench.robot.info._replace(hold=5.0, neutral=20.0)


def no_watchdog(bench):
    bench.robot.watched = bench.robot.greets = False


def blind_joints(bench):
    bench.robot.lacks = ("joint angles",)


REFUSED = {
    wrong_joints: "in this order", wrong_range: "sees that range", wrong_hash: "flash one", slow_watchdog: "only after 20 s",
    no_watchdog: "--i-am-at-the-tank", blind_joints: "fixed firmware",
}  # fmt: skip


@pytest.mark.parametrize("change", REFUSED, ids=lambda f: f.__name__)
def test_fault_25_a_robot_that_the_policy_is_not_for_gets_no_torque(tmp_path, change):
    bench = Bench(tmp_path / "swim")
    change(bench)
    outcome = bench.swim()
    assert not outcome.cause and any(REFUSED[change] in reason for reason in outcome.refused)
    assert bench.robot.state is RobotState.IDLE and bench.robot.sent == []
    assert bench.log.closed


def test_fault_25_attended_swim_is_allowed_without_a_watchdog(tmp_path):
    bench = Bench(tmp_path / "swim", at_the_tank=True)
    no_watchdog(bench)
    assert bench.swim().complete


def test_fault_25_slow_watchdog_is_refused_even_at_an_attended_tank(tmp_path):
    bench = Bench(tmp_path / "swim", at_the_tank=True)
    slow_watchdog(bench)
    outcome = bench.swim()
    assert not outcome.cause and "only after 20 s" in outcome.refused[0] and bench.robot.sent == []


def test_camera_failure_is_named_when_arming_fails_and_when_a_swim_ends(tmp_path):
    bench = Bench(tmp_path / "one", plan={"wait": 1.0})
    bench.eyes.blind, bench.eyes.failed = True, ConfigError("frame of (480, 640, 3) uint8")
    assert bench.swim().words == "not armed: POSE_LOST (camera: frame of (480, 640, 3) uint8)"
    bench = Bench(tmp_path / "two")
    bench.at(1.0, lambda: (setattr(bench.eyes, "blind", True), setattr(bench.eyes, "failed", ConfigError("unplugged"))))
    assert "ended by POSE_LOST (camera: unplugged)" in bench.swim().words


def test_fault_25_policy_of_another_structure_is_refused_on_load():
    from fishmj.control.learned import LearnedController
    from fishmj.mjcf.reading import load_robot

    with pytest.raises(ConfigError, match="robot tendon_fish needs 9 and 2"):
        LearnedController(load_robot("tendon_fish"), "station")


def test_fault_25_nan_action_ends_in_neutral_and_logs_its_observation(tmp_path):
    bench = Bench(tmp_path / "swim")

    def poison():
        weights = [(w.copy(), b.copy()) for w, b in bench.controller.policy.weights]
        weights[0][0][:] = np.nan
        bench.controller.policy.weights = weights

    bench.at(1.0, poison)
    trial = ended(bench, bench.swim(), Condition.ACTION_NAN, 1.0 + 0.2 + 0.04)
    assert "not finite" in (said := " ".join(trial.meta["host"]["events"])) and "observation [" in said
    assert all(np.isfinite(command).all() for command in bench.robot.sent)


@pytest.mark.parametrize("how", ["blind", "frozen"])
def test_fault_25_lost_pose_holds_at_200_ms_and_ends_in_neutral_at_500_ms(tmp_path, how):
    bench = Bench(tmp_path / "swim")
    bench.at(1.0, lambda: setattr(bench.eyes, how, True))
    trial = ended(bench, bench.swim(), Condition.POSE_LOST, 1.0 + 0.5 + 0.04)
    begun = trial.tables["obs"]["t"][0]
    t, asked = trial.tables["cmd"]["t"] - begun, trial.tables["cmd"]["asked1"]
    assert np.ptp(asked[(t > 1.2) & (t < bench.to_neutral() - 0.03)]) < 1e-9


def test_fault_25_a_short_loss_of_the_camera_does_not_end_the_swim(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=2.0)
    bench.at(1.0, lambda: setattr(bench.eyes, "blind", True))
    bench.at(1.4, lambda: setattr(bench.eyes, "blind", False))
    assert bench.swim().complete


@pytest.mark.parametrize(("back", "cause"), [(1.2, Condition.FINISHED), (9.0, Condition.POSE_LOST)])
def test_fault_25_fixes_that_jump_are_refused(tmp_path, back, cause):
    bench = Bench(tmp_path / "swim", seconds=2.0)
    bench.at(1.0, lambda: setattr(bench.eyes, "shift", 0.4))
    bench.at(back, lambda: setattr(bench.eyes, "shift", 0.0))
    outcome = bench.swim()
    assert outcome.cause == cause
    trial = read_trial(bench.folder)
    assert trial.tables["pose"]["x"].max() < 0.5
    assert outcome.figures["fixes_refused"] >= 9


def test_a_fish_that_leaves_where_it_may_swim_ends_in_neutral(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"bound": 0.32})  # the fish of the bench drifts from 0.3 m on, 1 cm/s
    ended(bench, bench.swim(), Condition.LEFT_TANK, 2.0)
    bench = Bench(tmp_path / "outside", plan={"bound": 0.25, "wait": 1.0})
    assert bench.swim().refused == ("LEFT_TANK",) and bench.robot.sent == []


def test_the_operator_ends_a_swim_and_a_new_one_needs_a_person(tmp_path):
    bench = Bench(tmp_path / "one")
    bench.at(1.0, lambda: setattr(bench, "stopped", True))
    ended(bench, bench.swim(), Condition.OPERATOR_STOP, 1.02)
    bench.stopped, bench.folder = False, tmp_path / "two"
    with pytest.raises(ConfigError, match="look at the fish"):
        bench.swim()
    bench.folder = tmp_path / "three"
    assert bench.swim(person=True).complete


def test_a_robot_that_nobody_hears_is_not_waited_for_for_ever(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.robot.silent = True
    outcome = bench.swim()
    assert not outcome.cause and "nothing heard" in outcome.refused[0]
    assert bench.clock.now() < 101.1


def test_without_a_camera_the_robot_is_not_armed(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.eyes.blind = True
    outcome = bench.swim()
    assert "POSE_LOST" in outcome.refused[0] and bench.robot.state is RobotState.IDLE


def test_an_armed_robot_does_not_wait_for_fresh_poses_for_ever(tmp_path):
    bench = Bench(tmp_path / "swim", plan={"wait": 1.0})
    bench.eyes.age = 0.25  # older than 0.2 s, younger than 0.5 s
    outcome = bench.swim()
    assert outcome.swim_seconds == 0.0 and not outcome.complete
    assert bench.robot.state is RobotState.IDLE and bench.clock.now() < 103.0


def test_an_error_in_the_middle_lets_the_robot_go_and_keeps_the_log(tmp_path):
    bench = Bench(tmp_path / "swim")

    def fail():
        raise RuntimeError("a fault of ours")

    bench.at(1.0, fail)
    with pytest.raises(RuntimeError):
        bench.swim()
    assert bench.robot.disarmed >= 10  # one of them may be lost
    trial = read_trial(bench.folder)
    assert "a fault of ours" in trial.meta["host"]["events"][-1] and len(trial.tables["cmd"]["t"]) >= 50
