"""`gap find LOGS --model robot.xml` for a robot whose base floats: poses, effects, mistakes, patches. Logs are *synthetic*."""

import argparse

import mujoco
import numpy as np
import pytest

from fishmj import effects
from fishmj.base.errors import ConfigError, LogError
from fishmj.gap.bench import robot_bench, robot_cases
from fishmj.gap.commands import next_robot
from fishmj.gap.commands.admit_robot import POSES, _posed, mistakes, refuse_mistakes
from fishmj.gap.commands.apply_robot import changed
from fishmj.gap.laboratory.articulated.flown_faults import FLOWN
from fishmj.gap.laboratory.articulated.flown_plant import FlownMujoco, FlownPinocchio, box_drag
from fishmj.gap.laboratory.articulated.flown_stand import FlownStand, fly, references
from fishmj.gap.laboratory.articulated.hidden_faults import with_hidden
from fishmj.gap.laboratory.articulated.robot_plan import QUADROTOR, draw_plan, mjcf
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_patch import patched
from fishmj.gap.models.robot_sizes import RobotSizes, sizes_of
from fishmj.gap.records.attitude import COORDINATES, quaternion_rate, rotation_vector, turned
from fishmj.gap.records.robot_logs import guess_columns, log_files, read_columns, read_robot_logs, read_sheet
from fishmj.gap.records.shooting import robot_records, thinned

pytest.importorskip("numba")
POSE = robot_cases.POSE
PLAN = draw_plan(QUADROTOR, np.random.default_rng(3))
STAND = FlownStand(0.005, 2e-4, 1e-3, 2.6, 2)
QUIET = np.zeros((80, 6))


def flown(folder, hidden=None, plant=FlownMujoco, stand=STAND):
    """Folder of logs of the described quadrotor with `hidden` in it."""
    hidden = hidden or {}
    folder.mkdir(parents=True, exist_ok=True)
    for i, reference in enumerate(references(5, stand.logs)):
        true = with_hidden(PLAN, hidden, FLOWN)
        log = fly(plant(true, hidden), PLAN, reference, stand, hidden, QUIET, np.random.default_rng(i))
        columns = {f"cmd_r{k + 1}": u for k, u in enumerate(log.commands.T)} | dict(zip(POSE, log.readings.T, strict=True))
        np.savez(folder / f"log{i}.npz", t=log.t, **columns)
    return folder


def records_of(robot, folder):
    files = log_files(folder)
    columns = guess_columns(
        list(read_sheet(files[0]).columns), robot.sites("joint"), robot.actuators, False, free=robot.base is not None
    )
    return robot_records(read_robot_logs(files, columns)[0], robot.dt, robot.channels)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("floating")


@pytest.fixture(scope="module")
def quadrotor(folder):
    path = folder / "quadrotor.xml"
    path.write_text(mjcf(PLAN))
    return read_robot(path)


def test_centre_may_leave_the_frame_of_a_body(tmp_path):
    """MuJoCo compiles a body whose centre is at its frame as a simple one, and refuses another centre in it."""
    path = tmp_path / "boat.xml"
    path.write_text(BOAT)
    robot = read_robot(path)
    sizes = RobotSizes(np.ones(3), np.ones(3), np.ones(2), np.ones(2))
    model = RigidRobot(robot, sizes, [effects.robot_catalogue()["com_offset"]])
    row = model.null
    row[model.index("com_offset@hull", "x")] = 0.02
    assert model.model(row).body_ipos[1].tolist() == [0.02, 0.0, 0.0]


@pytest.fixture(scope="module")
def records(quadrotor, folder):
    return records_of(quadrotor, flown(folder / "healthy"))


@pytest.fixture(scope="module")
def model(quadrotor, records):
    return RigidRobot(quadrotor, sizes_of(quadrotor, records))


def misfit(model, records, row) -> np.ndarray:
    """(6,) root mean square of measured less predicted."""
    left = [r.joint.values - p["joint"][0] for r, p in zip(records, model.predict(records, row), strict=True)]
    return np.sqrt(np.mean(np.concatenate(left) ** 2, 0))


# ---------------------------------------------------------------------------------------------------------------------- attitudes
def test_rotation_vector_is_that_of_mujoco():
    rng = np.random.default_rng(0)
    q = rng.standard_normal((2, 40, 4))
    one, other = q / np.linalg.norm(q, axis=-1, keepdims=True)
    told, expected, back = rotation_vector(one, other), np.zeros(3), np.zeros(4)
    for k in range(40):
        mujoco.mju_subQuat(expected, one[k], other[k])
        np.testing.assert_allclose(told[k], expected, atol=1e-12)
        back[:] = other[k]
        mujoco.mju_quatIntegrate(back, expected, 1.0)
        np.testing.assert_allclose(np.abs(turned(other[k], expected) @ back), 1.0, atol=1e-12)
    assert np.all(np.isnan(rotation_vector(np.full((1, 4), np.nan), other[:1])))


def test_rate_of_a_quaternion_is_that_of_mujoco():
    rng = np.random.default_rng(1)
    q, w, h = rng.standard_normal(4), rng.standard_normal(3), 1e-6
    q /= np.linalg.norm(q)
    after = q.copy()
    mujoco.mju_quatIntegrate(after, w, h)
    np.testing.assert_allclose((after - q) / h, quaternion_rate(q, w), atol=1e-5)


def test_start_of_a_tumbling_body_is_estimated_within_its_error(tmp_path):
    """A free body in weightlessness: its angular momentum stays, its rate does not."""
    text = """<mujoco><option timestep="0.001" gravity="0 0 0" integrator="RK4"/><worldbody><body name="b"><freejoint/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.02 0.015"/><site name="s"/></body></worldbody>
    <actuator><motor name="prop" site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
    path = tmp_path / "body.xml"
    path.write_text(text)
    m = mujoco.MjModel.from_xml_string(text)
    d, rng = mujoco.MjData(m), np.random.default_rng(0)
    d.qvel[:] = 0.4, -0.2, 0.3, 3.0, 0.5, -2.0
    t, q, v = 0.001 * np.arange(2000), np.empty((2000, 7)), np.empty((2000, 6))
    for k in range(2000):
        q[k], v[k] = d.qpos, d.qvel
        mujoco.mj_step(m, d)
    seen = turned(q[::4, 3:], 1e-3 * rng.standard_normal((500, 3)))
    columns = dict(zip(POSE, [*(q[::4, :3] + 1e-4 * rng.standard_normal((500, 3))).T, *seen.T], strict=True))
    np.savez(tmp_path / "log.npz", t=t[::4], cmd_prop=np.zeros(500), **columns)
    (record,) = records_of(read_robot(path), tmp_path / "log.npz")
    place = np.rint(record.starts / 0.001).astype(int)
    assert np.all(np.abs(record.rates - v[place]) < 5.0 * record.rate_error + 1e-3)
    assert np.all(np.abs(rotation_vector(record.start_turns, q[place, 3:])) < 5.0 * record.angle_error[3:])
    assert np.ptp(v[place, 3]) > 0.5  # it tumbles


# ------------------------------------------------------------------------------------------------------------------- descriptions
def test_floating_robot_has_coordinates_and_no_tilt_or_friction(quadrotor, model):
    assert "its tilt, contacts and the free joint's friction" in quadrotor.notes[0]
    assert quadrotor.channels == COORDINATES and quadrotor.sites("actuator") == ("r1", "r2", "r3", "r4")
    names = {placed.effect.name for placed in model.placed}
    assert names >= {"body_mass", "com_offset", "servo_gain", "thrust_loss", "thruster_lag", "steady_wind", "torque_offset"}
    assert not names & {"base_tilt", "coulomb_friction", "joint_zero_offset", "speed_limit"}
    assert ("payload" in names) == (abs(PLAN.limbs[0].centre[2]) > 0.02)  # at the frame it is a heavier body


BALL = '<joint name="base" type="ball"/>'
SITES = 'site="r1" refsite="r2"'
SECOND = '<body name="other"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
REFUSED = {
    "a ball joint": lambda text: text.replace('<freejoint name="base"/>', BALL),
    "2 free joints": lambda text: text.replace("</worldbody>", SECOND + "</worldbody>"),
    "between two sites": lambda text: text.replace('site="r1"', SITES),
    "on the free joint": lambda text: text.replace('site="r1" gear="0 0 1 0 0', 'joint="base" gear="0 0 1 0 0'),
    "a state of its own": lambda text: text.replace('gaintype="fixed"', 'dyntype="filter" dynprm="0.1" gaintype="fixed"'),
}


@pytest.mark.parametrize("what", REFUSED)
def test_floating_robot_that_cannot_be_searched_is_refused(what, tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(REFUSED[what](mjcf(PLAN)))
    with pytest.raises(ConfigError, match=f"{what}.*would work") as told:
        read_robot(path)
    assert "\n" not in str(told.value)


# --------------------------------------------------------------------------------------------------------------------------- logs
NAMES = ["t", "cmd_r1", "cmd_r2", "cmd_r3", "cmd_r4"]


@pytest.mark.parametrize("style", ["{}", "base_{}", "/mocap:pose.{}"])
def test_pose_is_guessed_from_names_that_say_each_part(style):
    part = lambda p: {"/mocap:pose.{}": f"position.{p}" if p in "xyz" else f"orientation.{p[1:]}"}.get(style, p)
    names = [style.format(part(p)) for p in POSE]
    found = guess_columns([*NAMES, *names, "vel_x", "twist.linear.x", "gyro_x"], (), ("r1", "r2", "r3", "r4"), True, free=True)
    assert [c.column for c in found.base.values()] == names
    assert any("qw of the base" in row for row in found.rows())


def test_columns_that_are_named_as_thrusters_are_their_commands():
    found = guess_columns(["t", *POSE, "thrust1", "thrust2"], (), ("thrust1", "thrust2"), True, free=True)
    assert [c.column for c in found.actuator.values()] == ["thrust1", "thrust2"]


def test_pose_of_numbers_or_none_is_left_to_a_map():
    """Numbers do not say whether w is first."""
    with pytest.raises(LogError, match="commands of the actuators"):
        guess_columns(["t", *POSE], (), ("r1", "r2", "r3", "r4"), True, free=True)
    for names in ([f"pose_{k}" for k in range(7)], ["x", "y", "z"], []):
        with pytest.raises(LogError, match=r"free base.*qw = ") as told:
            guess_columns([*NAMES, *names], (), ("r1", "r2", "r3", "r4"), True, free=True)
        assert "\n" not in str(told.value)


def test_map_names_each_part_of_the_pose(tmp_path):
    path = tmp_path / "map.toml"
    parts = "\n".join(f'{p} = "a{k}"' for k, p in enumerate(POSE))
    path.write_text(f'time = "t"\n[joint]\n[actuator]\nm = "u"\n[base]\n{parts}\n')
    assert [c.column for c in read_columns(path, (), ("m",), True).base.values()] == [f"a{k}" for k in range(7)]
    path.write_text(path.read_text().replace('qw = "a3"\n', ""))
    with pytest.raises(LogError, match=r"\[base\] qw: is missing"):
        read_columns(path, (), ("m",), True)


def test_quaternion_of_another_length_is_refused(quadrotor, folder, tmp_path):
    log = dict(np.load(folder / "healthy" / "log0.npz")) if (folder / "healthy").is_dir() else {}
    if not log:
        log = dict(np.load(flown(folder / "healthy") / "log0.npz"))
    np.savez(tmp_path / "log.npz", **log | {"qw": log["qx"]})
    with pytest.raises(LogError, match="row 1 of the quaternion.*expected 1"):
        records_of(quadrotor, tmp_path)


def test_joints_are_read_at_the_stamps_of_the_pose(tmp_path):
    """A trunk with a leg: encoders at 500 Hz, cameras at 100 Hz, in one table."""
    text = mjcf(PLAN).replace(
        "</body>", '<body name="leg"><joint name="knee" type="hinge" axis="0 1 0"/>' + LEG + "</body></body>"
    )
    path = tmp_path / "robot.xml"
    path.write_text(text)
    t, seen = 0.002 * np.arange(600), np.arange(600) % 5 == 0
    pose = {p: np.where(seen, float(p == "qw"), np.nan) for p in POSE}
    np.savez(
        tmp_path / "log.npz",
        t=t,
        pos_knee=np.where(t < 0.8, np.sin(t), np.nan),
        **{f"cmd_r{k}": 0.1 * t for k in range(1, 5)},
        **pose,
    )
    robot = read_robot(path)
    assert robot.channels == (*COORDINATES, "knee")
    (record,) = records_of(robot, tmp_path / "log.npz")
    assert record.joint.t[-1] < 0.8  # no pose is taken where the encoders are silent
    np.testing.assert_allclose(np.diff(record.joint.t), 0.01)
    np.testing.assert_allclose(record.joint.values[:, 6], np.sin(record.joint.t), atol=1e-4)


LEG = '<inertial pos="0 0 -0.1" mass="0.05" diaginertia="1e-4 1e-4 1e-5"/>'


# -------------------------------------------------------------------------------------------------------------------- predictions
WELL = np.array([0.01, 0.01, 0.01, 0.03, 0.03, 0.03])  # m and rad: errors of the starts over 0.3 s


def test_healthy_flight_is_predicted_to_its_start_errors(model, records):
    assert np.all(misfit(model, records, model.null) < WELL)


HIDDEN = {
    "body_mass@b1": {"mass": 0.4 * PLAN.limbs[0].mass},
    "com_offset@b1": {"x": 0.02, "y": -0.01, "z": 0.0},
    "link_inertia@b1": {"share": 3.0},
    "servo_gain@r2": {"gain": -0.25},
    "torque_offset@r3": {"torque": 0.4},
    "torque_saturation@r1": {"limit": 0.24 * PLAN.limbs[0].mass * 9.81},
    "thrust_loss": {"share": 0.25},
    "thruster_lag": {"time": 0.08},
    "command_latency": {"delay": 0.05},
    "steady_wind": {"x": 25.0, "y": 0.0, "z": 10.0},
}


@pytest.mark.parametrize("name", HIDDEN)
def test_effect_on_a_free_body_is_the_edited_robot(name, quadrotor, model, folder):
    logs = records_of(quadrotor, flown(folder / name.replace("@", "_"), {name: HIDDEN[name]}))
    row = model.null
    for parameter, value in HIDDEN[name].items():
        row[model.index(name, parameter)] = value
    without, with_it = misfit(model, logs, model.null), misfit(model, logs, row)
    assert np.all(with_it < WELL), with_it
    assert np.any(with_it < without / 2.0), (without, with_it)


TRUNK = """<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/><worldbody><body name="trunk"><freejoint/>
<inertial pos="0 0 0" mass="2" diaginertia="0.02 0.02 0.02"/><body name="leg"><joint name="knee" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="0.4" diaginertia="0.002 0.002 0.0002"/></body></body></worldbody>
<actuator><motor name="knee" joint="knee"/></actuator></mujoco>"""


def test_friction_of_a_leg_on_a_free_trunk_is_the_edited_robot(tmp_path):
    """A leg in the air: its motor turns the trunk, too."""
    path = tmp_path / "trunk.xml"
    path.write_text(TRUNK)
    m = mujoco.MjModel.from_xml_string(TRUNK.replace('name="knee" type', 'frictionloss="0.03" name="knee" type'))
    m.opt.timestep = 0.0002
    d, t, q = mujoco.MjData(m), 0.004 * np.arange(800), np.empty((800, 8))
    u = 0.1 * np.sin(2.0 * np.pi * 0.8 * t) + 0.06 * np.sin(2.0 * np.pi * 1.7 * t)
    for k in range(800):
        q[k], d.ctrl[:] = d.qpos, u[k]
        mujoco.mj_step(m, d, 20)
    np.savez(tmp_path / "log.npz", t=t, cmd_knee=u, pos_knee=q[:, 7], **dict(zip(POSE, q[:, :7].T, strict=True)))
    robot = read_robot(path)
    records = records_of(robot, tmp_path / "log.npz")
    model = RigidRobot(robot, sizes_of(robot, records))
    row = model.null
    row[model.index("coulomb_friction@knee", "torque")] = 0.03
    law = model.null
    law[model.index("stribeck@knee", "torque")] = 0.03
    law[model.index("stribeck@knee", "speed")] = 1e3
    without, with_it, by_law = (misfit(model, records, one) for one in (model.null, row, law))
    assert np.all(with_it < 0.2 * without + 1e-4) and np.all(by_law < 0.2 * without + 1e-4), (without, with_it, by_law)


def test_planar_boat_with_thrusters_is_predicted(tmp_path):
    """Two slides and a hinge at the root, two propellers astern, water by MuJoCo's own drag."""
    path = tmp_path / "boat.xml"
    path.write_text(BOAT)
    robot, m = read_robot(path), mujoco.MjModel.from_xml_string(BOAT)
    m.opt.timestep = 0.0005
    d, rng = mujoco.MjData(m), np.random.default_rng(0)
    t, q = 0.005 * np.arange(1000), np.empty((1000, 3))
    u = np.stack([3.0 + 2.0 * np.sin(2.0 * np.pi * f * t) for f in (0.3, 0.45)], 1)
    for k in range(1000):
        q[k], d.ctrl[:] = d.qpos, u[k]
        mujoco.mj_step(m, d, 10)
    seen = q + 1e-4 * rng.standard_normal(q.shape)
    named = {f"pos_{n}": c for n, c in zip(("surge", "sway", "yaw"), seen.T, strict=True)}
    np.savez(tmp_path / "log.npz", t=t, cmd_port=u[:, 0], cmd_starboard=u[:, 1], **named)
    records = records_of(robot, tmp_path / "log.npz")
    model = RigidRobot(robot, sizes_of(robot, records))
    assert robot.channels == ("surge", "sway", "yaw") and np.all(misfit(model, records, model.null) < 0.003)
    late = model.null
    late[model.index("thrust_loss", "share")] = 0.3
    assert misfit(model, records, late).max() > 0.0035


BOAT = """<mujoco><option timestep="0.005" integrator="implicitfast" density="1000"/><worldbody><body name="hull">
<joint name="surge" type="slide" axis="1 0 0"/><joint name="sway" type="slide" axis="0 1 0"/>
<joint name="yaw" type="hinge" axis="0 0 1"/>
<inertial pos="0 0 0" mass="8" diaginertia="0.1 0.4 0.45"/>
<site name="port" pos="-0.4 0.15 0"/><site name="starboard" pos="-0.4 -0.15 0"/>
</body></worldbody><actuator><motor name="port" site="port" gear="1 0 0 0 0 0"/>
<motor name="starboard" site="starboard" gear="1 0 0 0 0 0"/></actuator></mujoco>"""


# ----------------------------------------------------------------------------------------------------------------- mistakes, ends
def test_healthy_flight_has_no_mistake(quadrotor, records):
    assert mistakes(quadrotor, records) == []


@pytest.mark.parametrize("what", POSES)
def test_mistake_in_a_pose_is_named_with_its_remedy(what, quadrotor, records):
    """The record as it is with the mistake: the inverse of what undoes it."""
    _, turn, move = POSES[what]
    wrong = [_posed(r, turn.T, np.linalg.inv(move)) for r in records]
    back = [_posed(r, turn, move) for r in wrong]
    np.testing.assert_allclose(back[0].rates, records[0].rates, atol=1e-9)
    np.testing.assert_allclose(back[0].accelerations, records[0].accelerations, atol=1e-8)
    assert any(what in m.what for m in mistakes(quadrotor, thinned(wrong, 4)))


def test_base_that_was_held_is_refused_by_its_free_joint(quadrotor, records):
    rng = np.random.default_rng(0)
    still = lambda r: r.joint._replace(values=np.tile([0.1, 0.0, 1.0, 0.0, 0.0, 0.0], (len(r.joint.t), 1)))
    noisy = lambda r: turned(r.turns[:1], 1e-3 * rng.standard_normal((len(r.turns), 3)))
    held = [r._replace(joint=still(r), turns=noisy(r)) for r in records]
    with pytest.raises(LogError, match="weld it in the model"):
        refuse_mistakes(quadrotor, held)
    refuse_mistakes(quadrotor, thinned(records, 4))


def test_exchanged_rotors_are_named(quadrotor, records):
    wrong = [r._replace(commands=r.commands[:, [2, 0, 1, 3]]) for r in records]
    with pytest.raises(LogError, match=r"r1 = that of r2, r2 = that of r3, r3 = that of r1.*times better.*--columns"):
        refuse_mistakes(quadrotor, thinned(wrong, 4))


def test_flight_on_the_ground_is_refused(folder, records, tmp_path):
    path = tmp_path / "robot.xml"
    ball = '<geom type="sphere" size="0.3"/><inertial'
    floor = '<worldbody><geom type="plane" size="5 5 1" pos="0 0 -0.1"/>'
    path.write_text(mjcf(PLAN).replace("<inertial", ball).replace("<worldbody>", floor))
    with pytest.raises(LogError, match="touch"):
        read_robot(path).check_contact(records)


def test_patch_of_a_floating_robot_has_the_effects(quadrotor, tmp_path):
    named = [
        {"name": name, "parameters": {key: {"value": value} for key, value in HIDDEN[name].items()}}
        for name in ("com_offset@b1", "servo_gain@r2", "torque_offset@r3", "thruster_lag")
    ]
    m, delay, beyond = changed(quadrotor, named)
    assert [site for site, *_ in beyond.commands] == ["r1", "r2", "r3", "r4"]
    path = tmp_path / "next.xml"
    path.write_text(patched(quadrotor, m, delay))
    again = read_robot(path)
    for name in ("body_ipos", "actuator_gainprm", "actuator_biasprm", "actuator_gear"):
        np.testing.assert_allclose(getattr(again.model, name), getattr(m, name), rtol=1e-6, atol=1e-12)
    assert again.channels == quadrotor.channels and again.sites("actuator") == quadrotor.sites("actuator")


def test_next_experiment_of_a_floating_robot_is_refused(quadrotor):
    args = argparse.Namespace(source=quadrotor.path, model=None, out=None, runs="all")
    with pytest.raises(ConfigError, match="fly it by its controller"):
        next_robot.next_robot(args)


# ---------------------------------------------------------------------------------------------------------------------- benchmark
def test_drag_of_a_box_is_that_of_mujoco():
    plan = PLAN._replace(density=20.0, wind=(3.0, -2.0, 1.0))
    m = mujoco.MjModel.from_xml_string(mjcf(plan))
    d = mujoco.MjData(m)
    d.qvel[:] = 1.0, 2.0, -3.0, 0.5, -0.4, 2.0
    mujoco.mj_forward(m, d)
    force, moment = box_drag(plan, d.qvel[:3] - plan.wind, d.qvel[3:].copy())
    np.testing.assert_allclose(d.qfrc_fluid[:3], force, rtol=1e-6)
    np.testing.assert_allclose(d.qfrc_fluid[3:], moment + np.cross(plan.limbs[0].centre, force), rtol=1e-6, atol=1e-9)


def test_pinocchio_flies_as_mujoco_does():
    pytest.importorskip("pinocchio")
    stand = FlownStand(0.005, 0.0, 0.0, 1.5, 1)
    hidden = {"steady_wind": {"x": 10.0, "y": 3.0, "z": 0.0}, "thruster_lag": {"time": 0.03}}
    true = with_hidden(PLAN, hidden, FLOWN)
    one, other = (
        fly(plant(true, hidden), PLAN, references(5, 1)[0], stand, hidden, QUIET, np.random.default_rng(0))
        for plant in (FlownMujoco, FlownPinocchio)
    )
    np.testing.assert_allclose(one.clean, other.clean, atol=2e-3)


def test_quadrotors_of_the_benchmark_carry_their_own_effects(tmp_path):
    cases = robot_cases.draw_cases(40, 4, ("mujoco", "pinocchio", "bam"), (QUADROTOR,))
    hidden = {name for case in cases for name in case.effects}
    assert hidden <= set(FLOWN) and len(hidden) > 8 and {case.generator for case in cases} == {"mujoco", "pinocchio"}
    row = robot_cases.make_set(
        tmp_path, next(case for case in cases if case.effects == ("thrust_loss",) and case.generator == "mujoco")
    )
    assert row["joints"] == 0 and row["visible"]["thrust_loss"] > 5.0
    log = np.load(tmp_path / row["id"] / "logs" / "log1.npz")
    assert {"t", *POSE, "cmd_r1", "cmd_r2", "cmd_r3", "cmd_r4"} == set(log) and abs(np.mean(log["z"])) < 1.0


@pytest.mark.slow
def test_search_names_the_hidden_centre_of_a_quadrotor(tmp_path):
    case = robot_cases.RobotCase("one", "single", "mujoco", QUADROTOR, ("com_offset",), 12)
    row = robot_bench.judge_set(tmp_path, robot_bench.DataSet(robot_cases.make_set(tmp_path, case)))
    assert row["answer"] == "NAMED" and [e["name"] for e in row["said"]] == ["com_offset@b1"]
    truth, found = row["truth"]["com_offset@b1"], row["said"][0]["values"]
    assert np.hypot(truth["x"] - found["x"][0], truth["y"] - found["y"][0]) < 0.002
