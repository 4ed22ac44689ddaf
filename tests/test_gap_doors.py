"""The doors of `fishmj gap`: whose null runs, which robots, which logs, which options; what is refused, and in one line.

All data here are synthetic.
"""

from dataclasses import replace

import numpy as np
import pytest

from fishmj import effects
from fishmj.gap import null_runs
from fishmj.gap.null_runs import Null
from fishmj.gap.plants.fish import Fish
from fishmj.gap.records import record_of
from fishmj.gap.workflow import investigate
from fishmj.mjcf.description import load_robot
from fishmj.virtual_robot import generate
from fishmj.virtual_robot.machine import electrical
from fishmj.virtual_robot.trials import plant as second_robot

RUNS = ("gait_fast", "steps", "chirp")
SMALL = Null(runs=48)


def stiffer(factor: float = 1.05):
    """The shipped fish with another servo gain."""
    robot = load_robot("fish")
    return replace(robot, servo=replace(robot.servo, kp=factor * robot.servo.kp))


@pytest.fixture(scope="module")
def questioned():
    """A model whose servo is 5 % stiffer than the shipped fish's."""
    pytest.importorskip("numba")
    return Fish(stiffer(), [effects.get(n) for n in ("servo_gain", "command_latency", "viscous_friction")])


def test_null_runs_swim_the_robot_of_the_questioned_model(monkeypatch):
    gains = []

    def caught(made, *rest):
        gains.append(made.motor.gain)
        return trial

    trial = generate({}, ["idle"], 0)[0]
    monkeypatch.setattr("fishmj.virtual_robot.trials.trial_of", caught)
    robot = stiffer(1.3)
    what = null_runs.repeated(record_of(trial, robot.timing.physics_dt))
    SMALL._run(robot, what, record_of(trial, robot.timing.physics_dt))
    assert len(gains) == SMALL.runs
    assert abs(np.mean(gains) / robot.servo.kp - 1) < 0.01  # drawn within 2 % of the model's own, not of the shipped fish's


def test_null_runs_of_another_robot_are_kept_under_another_key(questioned):
    record = record_of(generate({}, ["idle"], 0)[0], questioned.dt)
    what = null_runs.repeated(record)
    other = Fish(stiffer(1.06), questioned.active.effects)
    assert SMALL._key(questioned, record, what) != SMALL._key(other, record, what)


def test_effects_that_a_model_lists_do_not_change_its_null_runs():
    from fishmj.effects.calibration import Fitted, Interval

    rusty = replace(load_robot("fish"), effects=(Fitted("coulomb_friction", {"torque": Interval(0.1, 0.05, 0.15)}, "", ""),))
    plain, listed = Fish("fish"), Fish(rusty)
    assert plain.fingerprint == listed.fingerprint and not np.array_equal(plain.null, listed.null)
    assert np.array_equal(plain.nothing, listed.nothing)


def test_the_second_robots_motor_follows_a_calibrated_torque_speed_line():
    servo = load_robot("fish").servo
    assert electrical(servo) == (servo.resistance, servo.constant)  # the data sheet's own, to the last bit
    kd = 1.1 * servo.kd
    damped = replace(servo, kd=kd, speed_no_load=servo.torque / (kd - servo.kv))  # as `calibrate servo` writes it
    resistance, constant = electrical(damped)
    assert constant**2 / resistance == pytest.approx(damped.kb)
    assert constant * damped.voltage / resistance == pytest.approx(damped.torque)
    made = second_robot({}, nuisance=0.0, robot=replace(load_robot("fish"), servo=damped))
    assert made.motor.rate_gain + made.motor.constant**2 / made.motor.resistance == pytest.approx(kd)


@pytest.mark.slow
def test_a_healthy_fish_with_a_calibrated_servo_agrees_and_a_late_one_is_named(questioned):
    agrees = investigate(questioned, generate({}, RUNS, 11, robot=stiffer()), null=SMALL).verdict
    assert agrees.answer == "AGREES"
    late = investigate(questioned, generate({"command_latency": {"delay": 0.05}}, RUNS, 11, robot=stiffer()), null=SMALL).verdict
    assert late.answer == "NAMED" and [e.name for e in late.effects] == ["command_latency"]
    value = late.effects[0].parameters["delay"]
    assert value.low < 0.05 < value.high
