"""Effects that no log of a robot can tell apart: named together, with the values at which they are the same. *Synthetic* logs."""

from dataclasses import replace

import numpy as np
import pytest
from robot_arm import ARM
from test_gap_robot import named, records_of, verdict_of

from fishmj.effects.ambiguity import series_at
from fishmj.gap.commands.apply_robot import apply_robot
from fishmj.gap.commands.find_robot import by_effect, without_stand_in
from fishmj.gap.decide.decide import truncated_series
from fishmj.gap.decide.indistinguishable import drawn_motions, with_indistinguishable
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import NamedEffect, Value, Verdict

PENDULUM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="b1">
      <joint name="j1" type="hinge" axis="0 1 0"/>
      <inertial pos="0.004 0.02 -0.23" mass="1.6" diaginertia="0.03 0.03 0.004"/>
    </body>
  </worldbody>
  <actuator><motor name="j1" joint="j1" ctrlrange="-9 9"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return questioned(tmp_path_factory.mktemp("pendulum"), PENDULUM, ["j1"])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return questioned(tmp_path_factory.mktemp("arm"), ARM, ["shoulder", "elbow"])


def questioned(folder, text, joints):
    """(model, records of two logs that swing)."""
    (folder / "robot.xml").write_text(text)
    robot = read_robot(folder / "robot.xml")
    t = np.arange(0.0, 3.0, 0.01)
    for k in range(2):
        q = [np.sin((1.0 + k + i) * t) for i in range(len(joints))]
        u = [np.cos((1.0 + k + i) * t) for i in range(len(joints))]
        names = ["t", *joints, *(f"cmd_{name}" for name in robot.actuators)]
        rows = [",".join(f"{x:.6f}" for x in row) for row in zip(t, *q, *u, strict=True)]
        (folder / f"{k}.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    records = records_of(robot, folder)
    return RigidRobot(robot, sizes_of(robot, records)), records


def answer(question, name, rivals, **values):
    """Verdict on an effect with rivals that were as likely in the logs."""
    model, records = question
    effect = next(e for e in model.active.effects if e.name == name)
    found = {p.name: Value(v := values.get(p.name, p.typical[1]), p.unit, v, v) for p in effect.parameters}
    share = 1.0 / (1 + len(rivals))
    told = tuple({"name": rival, "instead_of": name, "p_best": share, "behind": 0.0} for rival in rivals)
    before = Verdict("CLASS", (NamedEffect(name, found, share, 1.0),), told)
    return with_indistinguishable(before, model, records, frozen(), 0)


def test_one_equation_with_two_names_is_named_with_the_value_of_the_other(pendulum):
    v = answer(pendulum, "air_drag", ["quadratic_friction@j1"])
    (found,) = v.effects
    assert (v.answer, v.rivals, found.p_best) == ("NAMED", (), 1.0) and by_effect(v) == {"air_drag": "NAMED"}
    back = answer(pendulum, "quadratic_friction@j1", ["air_drag"], drag=found.same["quadratic_friction@j1"]["drag"].value)
    assert back.effects[0].same["air_drag"]["density"].value == pytest.approx(found.parameters["density"].value, rel=1e-6)
    assert "or, the same on this robot in any motion: quadratic friction at j1 " in v.text()


def test_a_tilt_is_a_zero_of_one_joint_but_not_of_two(pendulum, arm):
    v = answer(pendulum, "joint_zero_offset@j1", ["base_tilt", "com_offset@b1"], offset=0.2)
    same = v.effects[0].same
    assert v.answer == "NAMED" and same["base_tilt"]["pitch"].value == pytest.approx(0.2, abs=1e-6)
    assert same["base_tilt"].keys() == {"pitch", "roll"}
    assert same["com_offset@b1"].keys() == {"x", "z"}  # one along the axis of the hinge moves nothing
    assert same["com_offset@b1"]["x"].value == pytest.approx(-0.23 * np.sin(0.2) + 0.004 * (np.cos(0.2) - 1), abs=1e-6)
    assert answer(arm, "joint_zero_offset@elbow", ["base_tilt"]).answer == "CLASS"


def test_what_some_motion_tells_apart_stays_a_rival(pendulum, arm):
    v = answer(pendulum, "air_drag", ["viscous_friction@j1", "quadratic_friction@j1"])
    assert v.answer == "CLASS" and [r["name"] for r in v.rivals] == ["viscous_friction@j1"]
    assert set(v.effects[0].same) == {"quadratic_friction@j1"} and by_effect(v) == {"air_drag": "CLASS"}
    assert answer(arm, "air_drag", ["quadratic_friction@elbow"]).rivals
    assert answer(pendulum, "air_drag", ["force a|a|"]).rivals  # a force of no effect
    assert answer(pendulum, "command_latency", ["joint_sensor_delay"]).answer == "NAMED"
    assert answer(pendulum, "command_latency", ["latency_jitter"]).rivals  # whose mean alone is a latency


def test_an_effect_that_no_drawn_motion_shows_keeps_its_rivals(pendulum):
    assert answer(pendulum, "air_drag", ["quadratic_friction@j1"], density=0.0).rivals


def test_a_value_that_is_not_believable_is_not_named_and_one_beside_torques_is(pendulum):
    model, records = pendulum
    v = answer(pendulum, "air_drag", ["viscous_friction@j1"])
    rivals = ({"name": "quadratic_friction@j1", "instead_of": "air_drag", "p_best": 0.5},)
    doubted = replace(v, rivals=rivals, warnings=("air drag: density = 400 kg/m3 lies on its bound",))
    assert with_indistinguishable(doubted, model, records, frozen(), 0) == doubted
    beside = replace(doubted, warnings=("torques of 1.3 N m at j1 remain unexplained",))
    assert with_indistinguishable(beside, model, records, frozen(), 0).answer == "NAMED"


def test_drawn_motions_go_beyond_those_of_the_logs_within_the_limits(pendulum):
    model, records = pendulum
    drawn = drawn_motions(model, records, np.random.default_rng(0))
    assert sum(len(r.starts) for r in drawn) <= 48
    assert max(np.abs(r.angles).max() for r in drawn) > 2.5 > max(np.abs(r.angles).max() for r in records)
    assert max(np.abs(r.commands).max() for r in drawn) > 1.5 * max(np.abs(r.commands).max() for r in records)
    assert all(np.abs(r.commands).max() <= 9.0 for r in drawn)


def test_apply_takes_what_is_the_same_for_an_error_of_a_sensor(arm, tmp_path):
    late = named("joint_sensor_delay", delay=0.02) | {"same": {"clock_drift": {}, "command_latency": {"delay": {"value": 0.02}}}}
    told = apply_robot(tmp_path, verdict_of(arm[0].robot, "NAMED", late), None, False)
    assert "MJCF has no joint sensor delay: command latency, equivalent on this robot, is written" in told["reason"]
    assert read_robot(told["path"]).delays.tolist() == [0.02, 0.02]


def test_a_torque_offset_beside_a_stiffness_is_the_start_of_any_torque_over_the_angle(pendulum):
    assert series_at(["torque_offset@j1", "joint_stiffness@j2", "torque_offset@j2", "payload@j1"]) == ("j2",)
    (doubt,) = truncated_series(name for name in ("joint_stiffness@j1", "torque_offset@j1"))  # read once, as `decide` gives them
    assert truncated_series(["joint_stiffness@j1", "torque_offset@j2"]) == ()
    model, records = pendulum
    v = answer(pendulum, "torque_offset@j1", ["com_offset@b1"])
    doubted = replace(v, answer="CLASS", warnings=(doubt,))
    assert with_indistinguishable(doubted, model, records, frozen(), 0) == doubted  # no name by a rival that is the same
    pair = tuple(replace(v.effects[0], name=name, p_best=1.0, same={}) for name in ("joint_stiffness@j1", "torque_offset@j1"))
    alone = with_indistinguishable(Verdict("CLASS", pair, warnings=(doubt,)), model, records, frozen(), 0)
    assert without_stand_in(alone).answer == "UNEXPLAINED" and by_effect(without_stand_in(alone)) == {}
