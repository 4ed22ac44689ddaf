"""`gap find LOGS --model robot.xml`: descriptions, logs, effects and patches of robots in MJCF. All logs are *synthetic*."""

import json

import mujoco
import numpy as np
import pytest
from robot_arm import ARM, edited, swing, trials_of, write_logs

from fishmj import effects
from fishmj.base.errors import ConfigError, LogError
from fishmj.base.store import sha256
from fishmj.gap.commands import check, find, reported
from fishmj.gap.commands.apply_robot import apply_robot, changed, next_version
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_patch import patched
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.robot_logs import guess_columns, read_columns, read_robot_logs
from fishmj.gap.records.shooting import robot_record, robot_records, thinned

pytest.importorskip("numba")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("robot")


@pytest.fixture(scope="module")
def arm(folder):
    path = folder / "arm.xml"
    path.write_text(ARM)
    return read_robot(path)


@pytest.fixture(scope="module")
def records(folder, arm):
    return records_of(arm, write_logs(folder / "healthy", ARM, logs=2, seconds=2.6))


def records_of(robot, logs):
    return robot_records(trials_of(robot, logs), robot.dt, robot.sites("joint"))


@pytest.fixture(scope="module")
def model(arm, records):
    return RigidRobot(arm, sizes_of(arm, records))


def misfit(model, records, row) -> np.ndarray:
    """(J,) root mean square of measured less predicted."""
    seen = model.predict(records, row)
    left = [r.joint.values - p["joint"][0] for r, p in zip(records, seen, strict=True)]
    return np.sqrt(np.mean(np.concatenate(left) ** 2, 0))


# ------------------------------------------------------------------------------------------------------------------- descriptions
REFUSED = {
    "a ball": ('<joint name="shoulder" type="hinge" axis="0 1 0" damping="0.06"/>', '<joint name="shoulder" type="ball"/>'),
    "passive tendons": ("<actuator>", '<tendon><fixed name="t"><joint joint="elbow" coef="1"/></fixed></tendon><actuator>'),
    "equality": ("<actuator>", '<equality><joint joint1="elbow" joint2="shoulder"/></equality><actuator>'),
    "several actuators": ("</actuator>", '<motor name="two" joint="elbow"/></actuator>'),
    "two inputs": ("</actuator>", '<pid name="two" joint="elbow" kp="1" input="pos vel"/></actuator>'),
    "no actuator": (ARM[ARM.index("<actuator>") : ARM.index("</mujoco>")], ""),
}


@pytest.mark.parametrize("what", REFUSED)
def test_robot_that_the_search_cannot_take_is_refused_in_one_line(what, tmp_path):
    path = tmp_path / "robot.xml"
    text = ARM.replace(*REFUSED[what])
    if what == "a ball":
        text = text.replace('<motor name="shoulder" joint="shoulder" ctrlrange="-6 6"/>', "")
    path.write_text(text)
    with pytest.raises(ConfigError, match=what) as told:
        read_robot(path)
    assert "would work" in str(told.value) and "\n" not in str(told.value)


def test_broken_description_is_refused_in_one_line(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text("<mujoco><worldbody><body></mujoco>")
    with pytest.raises(ConfigError, match="cannot compile it as MJCF or URDF") as told:
        read_robot(path)
    assert "\n" not in str(told.value)


def test_urdf_gets_a_motor_at_each_joint(tmp_path):
    inertia = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="{{}}"><inertial><mass value="1"/>{inertia}</inertial></link>'
    joint = '<joint name="hip" type="revolute"><parent link="base"/><child link="leg"/><axis xyz="0 1 0"/>{}</joint>'
    path = tmp_path / "leg.urdf"
    limit = '<limit lower="-2" upper="2" effort="5" velocity="9"/>'
    path.write_text(f'<robot name="leg">{link.format("base")}{link.format("leg")}{joint.format(limit)}</robot>')
    robot = read_robot(path)
    assert robot.actuators == ("hip",) and robot.joints[0].actuator == 0 and "motor" in robot.notes[0]


# --------------------------------------------------------------------------------------------------------------------------- logs
def test_map_sets_unit_sign_and_zero(tmp_path, arm):
    path = tmp_path / "map.toml"
    path.write_text(
        'time = { column = "ms", unit = "ms" }\n[joint]\nshoulder = "a"\n'
        'elbow = { column = "b", unit = "deg", sign = -1, zero = 90 }\n[actuator]\nshoulder = "u"\n'
        'elbow = { column = "i", scale = 0.5 }\n'
    )
    log = tmp_path / "log.csv"
    log.write_text("ms,a,b,u,i\n0,0.1,90,1,2\n10,0.1,45,1,4\n")
    columns = read_columns(path, arm.sites("joint"), arm.actuators)
    (trial,), broken = read_robot_logs([log], columns)
    assert not broken and trial.table("cmd")["t"][1] == 0.01
    np.testing.assert_allclose(trial.table("joint")["j2"], [0.0, np.pi / 4])
    np.testing.assert_allclose(trial.table("cmd")["c2"], [1.0, 2.0])


def test_map_without_a_joint_names_it(tmp_path, arm):
    path = tmp_path / "map.toml"
    path.write_text('time = "t"\n[joint]\nshoulder = "a"\n[actuator]\nshoulder = "u"\nelbow = "i"\n')
    with pytest.raises(LogError, match=r"\[joint\] elbow: is missing"):
        read_columns(path, arm.sites("joint"), arm.actuators)


def test_map_without_several_lists_them_all_and_the_columns_of_the_log(tmp_path, arm):
    path = tmp_path / "map.toml"
    path.write_text('[joint]\nshoulder = "a"\n[actuator]\nelbow = "i"\n')
    wanted = r"time, \[joint\] elbow, \[actuator\] shoulder: are missing; expected a column for each, of a, b, u, i$"
    with pytest.raises(LogError, match=wanted):
        read_columns(path, arm.sites("joint"), arm.actuators, columns=["a", "b", "u", "i"])


@pytest.mark.parametrize(
    ("time", "asked", "read", "torques"),
    [
        ("Zeit", "Sollmoment_#", "Winkel_#", True),
        ("Zeit [ms]", "Sollwinkel_#", "Istwinkel_#", False),
        ("Zeitstempel", "Drehmoment_#", "Gelenkwinkel_#", True),
        ("temps", "consigne_couple_#", "angle_#", True),
    ],
)
def test_columns_in_other_languages_are_guessed(time, asked, read, torques):
    named = [name.replace("#", str(k)) for name in (asked, read) for k in (1, 2)]
    found = guess_columns([time, *named], ("shoulder", "elbow"), ("shoulder", "elbow"), torques)
    assert (found.time.column, found.time.unit) == (time, "ms" if "ms" in time else "")
    assert [c.column for part in (found.actuator, found.joint) for c in part.values()] == named


def test_map_of_german_logs_is_written_and_read(tmp_path, arm, capsys):
    """A current is no torque without its constant: it is left to the user, by the error, and by the map that this names."""
    (tmp_path / "arm.xml").write_text(ARM)
    rows = "".join(f"{k / 100:.2f};0,1;0,2;{k % 9 / 10};{k % 7 / 10}\n".replace(".", ",") for k in range(60))
    (tmp_path / "lauf.csv").write_text(f"Zeit;Strom_1;Strom_2;Winkel_1;Winkel_2\n{rows}")
    path = tmp_path / "map.toml"
    given = [str(tmp_path / "lauf.csv"), "--model", str(tmp_path / "arm.xml")]
    with pytest.raises(LogError, match="no columns for the commands .* gap find .* --write-map MAP.toml$"):
        find.main(given)
    assert find.main([*given, "--write-map", str(path)]) == 0
    text = path.read_text()
    assert '"elbow" = { column = "Winkel_2" }' in text and '# "elbow" = "COLUMN"' in text
    assert "add the 2 columns" in capsys.readouterr().out
    with pytest.raises(LogError, match=r"\[actuator\] shoulder, \[actuator\] elbow: are missing"):
        find.main([*given, "--columns", str(path)])
    for k, name in enumerate(("shoulder", "elbow"), 1):
        text = text.replace(f'# "{name}" = "COLUMN"', f'{name} = {{ column = "Strom_{k}", scale = 0.5 }}')
    path.write_text(text)
    (trial,), broken = read_robot_logs([tmp_path / "lauf.csv"], read_columns(path, arm.sites("joint"), arm.actuators))
    assert not broken and trial.table("joint")["j1"][8] == 0.8 and set(trial.table("cmd")["c2"]) == {0.1}


def test_positions_in_degrees_are_refused(folder, arm, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,pos1,pos2,cmd1,cmd2\n0,10,80,0,0\n0.01,11,85,0,0\n")
    with pytest.raises(LogError, match="degrees"):
        records_of(arm, log)


def test_start_states_are_estimated_within_their_error(arm):
    t, asked, _ = swing(ARM, 3.0, 1)
    m = mujoco.MjModel.from_xml_string(ARM)
    d = mujoco.MjData(m)
    q = []
    for u in asked:
        q.append(d.qpos.copy())
        d.ctrl[:] = u
        mujoco.mj_step(m, d)
    q = np.array(q)
    v = np.gradient(q, arm.dt, axis=0)
    read = q + 2e-4 * np.random.default_rng(0).standard_normal(q.shape)
    tables = {"cmd": {"t": t, "c1": asked[:, 0], "c2": asked[:, 1]}, "joint": {"t": t, "j1": read[:, 0], "j2": read[:, 1]}}
    record = robot_record(SimpleTrial(tables), arm.dt, arm.sites("joint"))
    at = np.searchsorted(t, record.starts - 1e-9)
    assert np.abs(record.angles - q[at]).max() < 5 * record.angle_error.max()
    assert np.abs(record.rates - v[at]).max() < 5 * record.rate_error.max() < 0.5
    assert np.all((record.joint.sigma > 1e-4) & (record.joint.sigma < 4e-4))


class SimpleTrial:
    """A log in memory."""

    name = "log"

    def __init__(self, tables):
        self.tables = tables

    def table(self, name):
        return self.tables[name]

    def value(self, key, default=None):
        return default


def test_segments_do_not_cross_a_pause(records, arm):
    t = np.concatenate([np.arange(0, 2, 0.004), np.arange(2.5, 4.5, 0.004)])
    tables = {"cmd": {"t": t, "c1": 0 * t, "c2": 0 * t}, "joint": {"t": t, "j1": np.sin(t), "j2": np.cos(t)}}
    record = robot_record(SimpleTrial(tables), arm.dt, arm.sites("joint"))
    assert not np.any((record.starts < 2.5) & (record.starts + record.length > 2.0))
    assert len(record.starts) >= 4


def test_segments_do_not_cross_a_pause_of_steady_commands(arm):
    t, sent = np.arange(0, 4.5, 0.004), np.concatenate([np.arange(0, 2, 0.004), np.arange(2.5, 4.5, 0.004)])
    moved = {"t": t, "j1": np.sin(t), "j2": np.cos(t)}
    begin = lambda sent: (
        robot_record(
            SimpleTrial({"cmd": {"t": sent, "c1": 0 * sent, "c2": 0 * sent}, "joint": moved}), arm.dt, arm.sites("joint")
        ).starts
    )
    assert not np.any((begin(sent) < 2.5) & (begin(sent) + 0.3 > 2.0))
    by_event = np.array([0.0, 0.1, 0.5, 0.6, 2.5, 2.6, 4.0])  # which hold until the next
    assert len(begin(by_event)) > len(begin(sent))


def test_thinned_records_keep_readings_of_kept_segments_only(records):
    few = thinned(records, 4)
    assert sum(len(r.starts) for r in few) == 4
    for r in few:
        place = np.searchsorted(r.starts, r.joint.t, side="right") - 1
        assert np.all(r.joint.t - r.starts[place] < r.length)


# -------------------------------------------------------------------------------------------------------------------- predictions
def test_healthy_arm_is_predicted_to_its_start_errors(model, records):
    assert np.all(misfit(model, records, model.null) < [0.01, 0.03])


def test_row_at_null_is_the_described_model(model):
    m = model.model(model.null)
    for name in ("dof_frictionloss", "dof_armature", "body_mass", "body_inertia", "actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_array_equal(getattr(m, name), getattr(model.robot.model, name))


LOWER = 'mass="0.4" diaginertia="0.003 0.003 0.0003"'
HEAVIER = 'mass="0.5" diaginertia="0.00375 0.00375 0.000375"'
TIP = '<inertial pos="0.02 0 -0.15" mass="0.4" diaginertia="0.003 0.003 0.0003"/>'
LOAD = '<body pos="0.04 0 -0.3"><inertial pos="0 0 0" mass="0.05" diaginertia="1e-9 1e-9 1e-9"/></body>'
MOTOR = '<motor name="elbow" joint="elbow" ctrlrange="-4 4"/>'
OFFSET = MOTOR.replace("<motor", '<general gaintype="fixed" gainprm="1" biastype="affine" biasprm="0.05"')
HIDDEN = {  # effect at its site -> (value, robot)
    "coulomb_friction@elbow": ({"torque": 0.06}, {"text": edited(elbow_joint='frictionloss="0.06"')}),
    "viscous_friction@shoulder": ({"damping": 0.1}, {"text": ARM.replace('damping="0.06"', 'damping="0.16"')}),
    "rotor_inertia@elbow": ({"inertia": 0.004}, {"text": edited(elbow_joint='armature="0.004"')}),
    "joint_stiffness@shoulder": ({"stiffness": 0.3}, {"text": edited(shoulder_joint='stiffness="0.3"')}),
    "servo_gain@shoulder": ({"gain": -0.2}, {"text": ARM.replace('joint="shoulder" ctrl', 'joint="shoulder" gear="0.8" ctrl')}),
    "command_latency": ({"delay": 0.02}, {"text": ARM, "late": 0.02}),
    "joint_zero_offset@shoulder": ({"offset": 0.04}, {"text": ARM, "zero": (0.04, 0.0)}),
    "base_tilt": ({"pitch": 0.05, "roll": 0.0}, {"text": ARM, "tilt": 0.05}),
    "quadratic_friction@elbow": ({"drag": 0.01}, {"text": ARM.replace('damping="0.02"', 'damping="0.02 0.01 0"')}),
    "torque_saturation@shoulder": ({"limit": 0.4}, {"text": ARM.replace('range="-6 6"', 'range="-6 6" forcerange="-0.4 0.4"')}),
    "com_offset@lower": ({"x": 0.02, "y": 0.0, "z": -0.03}, {"text": ARM.replace("0.02 0 -0.15", "0.04 0 -0.18")}),
    "payload@lower": ({"mass": 0.05}, {"text": ARM.replace(TIP, TIP + LOAD)}),
    "link_inertia@upper": ({"share": 2.0}, {"text": ARM.replace("0.004 0.004 0.0005", "0.012 0.012 0.0015")}),
    "air_drag": ({"density": 60.0}, {"text": ARM.replace("<option", '<option density="60"')}),
    "steady_wind": ({"x": 25.0, "y": 0.0, "z": 5.0}, {"text": ARM.replace("<option", '<option density="1.2" wind="25 0 5"')}),
    "torque_offset@elbow": ({"torque": 0.05}, {"text": ARM.replace(MOTOR, OFFSET)}),
    "joint_scale@elbow": ({"scale": 0.05}, {"text": ARM, "scale": (1.0, 1.05)}),
    "command_hold": ({"period": 0.06}, {"text": ARM, "hold": 0.06}),
    "command_quantisation@elbow": ({"step": 0.3}, {"text": ARM, "step": (0.0, 0.3)}),
    "clock_drift": ({"rate": 1.01}, {"text": ARM, "rate": 1.01}),
    "body_mass@lower": ({"mass": 0.1}, {"text": ARM.replace(LOWER, HEAVIER)}),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_effect_at_its_value_is_the_edited_robot(name, arm, model, folder):
    """MuJoCo's own attributes, gravity, a late command and a shifted encoder, against the effect's own formula."""
    values, hidden = HIDDEN[name]
    logs = records_of(
        arm,
        write_logs(folder / name.replace("@", "_"), hidden["text"], 2, 2.6, **{k: v for k, v in hidden.items() if k != "text"}),
    )
    row = model.null
    for parameter, value in values.items():
        row[model.index(name, parameter)] = value
    without, with_it = misfit(model, logs, model.null), misfit(model, logs, row)
    assert np.all(with_it < [0.01, 0.03]), with_it
    assert np.any(with_it < without / 3.0), (without, with_it)


def test_command_delay_and_late_readings_predict_the_same(model, records):
    rows = np.tile(model.null, (2, 1))
    rows[0, model.index("command_latency", "delay")] = rows[1, model.index("joint_sensor_delay", "delay")] = 0.01
    one, other = model.predict(records[:1], rows)[0]["joint"]
    np.testing.assert_array_equal(one, other)


def test_delay_moves_the_prediction_smoothly(model, records):
    """Commands hold between stamps; the mean over a step has no jumps, so finite differences see the delay."""
    delays = np.linspace(0.0, 0.006, 13)
    rows = np.tile(model.null, (len(delays), 1))
    rows[:, model.index("command_latency", "delay")] = delays
    seen = model.predict(records[:1], rows)[0]["joint"]
    change = np.linalg.norm(np.diff(seen, axis=0).reshape(12, -1), axis=1)
    assert change.min() > 0.5 * change.max()


def test_record_errors_move_their_own_segment_only(model, records):
    layout = ResidualLayout(records)
    first, _ = model.record_errors(records, layout)
    groups, segments = model.error_groups(records[0]), len(records[0].starts)
    assert len(first) == len(groups)
    t = np.concatenate([b.t for b in layout.blocks if b.record == 0])
    elbow = np.concatenate([np.full(len(b.t), b.channel == "elbow") for b in layout.blocks if b.record == 0])
    place = np.searchsorted(records[0].starts, t, side="right") - 1
    each = len(first) // segments
    for k in (0, len(first) // 2, len(first) - 1):
        assert np.all(first[k][place != k // each] == 0.0) and np.any(first[k])
    share = [np.mean([np.sum(row[elbow] ** 2) / np.sum(row**2) for row in first[groups == j]]) for j in (0, 1)]
    assert share[1] > 0.8 > share[0]  # a torque at the elbow moves the elbow most


def test_channels_of_the_residual_are_the_joints(records):
    assert set(ResidualLayout(records).channel.tolist()) == {"shoulder", "elbow"}


SERVO = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="arm">
<joint name="hip" type="hinge" axis="0 1 0" damping="0.02"/><inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.003 0.003 0.0003"/>
</body></worldbody><actuator><position name="hip" joint="hip" kp="8" kv="0.3"/></actuator></mujoco>"""
SERVOS = {  # effect at its site -> (value, robot, rad of the encoder)
    "servo_gain@hip": ({"gain": 0.5}, SERVO.replace('kp="8" kv="0.3"', 'kp="12" kv="0.45"'), 0.0),
    "servo_damping_gain@hip": ({"gain": 1.0}, SERVO.replace('kv="0.3"', 'kv="0.6"'), 0.0),
    "joint_zero_offset@hip": ({"offset": 0.1}, SERVO, 0.1),
}


@pytest.mark.parametrize("name", SERVOS)
def test_servo_effect_is_the_edited_servo(name, tmp_path):
    """A position servo, which closes its loop on the encoder."""
    values, text, zero = SERVOS[name]
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    robot = read_robot(path)
    m = mujoco.MjModel.from_xml_string(text.replace("0.002", "0.0002"))  # MuJoCo's own step holds a command half a step early
    d, q, t = mujoco.MjData(m), [], 0.002 * np.arange(1500)
    asked = 0.6 * np.sin(5 * t) + 0.4 * np.sin(13 * t)
    for u in asked:
        q.append(d.qpos[0] - zero)
        d.ctrl[0] = u + zero
        mujoco.mj_step(m, d, 10)
    read = np.array(q) + 1e-4 * np.random.default_rng(0).standard_normal(len(q))
    tables = {"cmd": {"t": t, "c1": asked}, "joint": {"t": t, "j1": read}}
    record = robot_record(SimpleTrial(tables), robot.dt, robot.sites("joint"))
    model = RigidRobot(robot, sizes_of(robot, [record]))
    row = model.null
    for parameter, value in values.items():
        row[model.index(name, parameter)] = value
    without, with_it = misfit(model, [record], model.null), misfit(model, [record], row)
    assert with_it[0] < min(0.005, without[0] / 3.0), (without, with_it)


# ------------------------------------------------------------------------------------------------------------------------ patches
def named(name: str, **values: float) -> dict:
    return {"name": name, "parameters": {key: {"value": value, "low": value, "high": value} for key, value in values.items()}}


OUTSIDE = ("joint_zero_offset@shoulder", "joint_scale@elbow", "command_hold", "command_quantisation@elbow", "clock_drift")


@pytest.mark.parametrize("name", [n for n in HIDDEN if n not in OUTSIDE])
def test_patch_moves_like_the_effect(name, arm, model):
    """The written MJCF, read by MuJoCo alone, accelerates like the model with the effect."""
    values, _ = HIDDEN[name]
    m, delay, _ = changed(arm, [named(name, **values)])
    written = mujoco.MjModel.from_xml_string(patched(arm, m, delay))
    assert written.actuator_delay[0] == pytest.approx(values.get("delay", 0.0))
    written.actuator_delay[:] = 0.0
    before, after = (step_from(x) for x in (m, written))
    np.testing.assert_allclose(after, before, atol=1e-5)  # six digits of a written number
    assert delay or np.abs(step_from(arm.model) - after).max() > 1e-4


def step_from(m) -> np.ndarray:
    """Rates after 20 steps from one state under one command."""
    m = mujoco.MjModel.from_xml_string(ARM) if m is None else m
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:], d.ctrl[:] = [0.4, -0.7], [1.0, 2.0], [0.5, 0.1]
    for _ in range(20):
        mujoco.mj_step(m, d)
    return d.qvel.copy()


def verdict_of(arm, answer: str, *found: dict, **each: str) -> dict:
    context = {"model": str(arm.path), "model_sha256": sha256(arm.path)}
    gaps = {"gap_before": 9.0, "gap_after": 1.0, "over_floor": {"searched": [5.0, 1.0]}}
    return {"answer": answer, "effects": list(found), "context": context, "by_effect": each} | gaps


def test_apply_writes_the_next_version(arm, tmp_path):
    told = apply_robot(tmp_path, verdict_of(arm, "NAMED", named("coulomb_friction@elbow", torque=0.06)), None, False)
    assert told["accepted"] and told["path"] == tmp_path / "arm.v2.xml"
    assert 'frictionloss="0.06"' in told["path"].read_text() and "+" in told["mjcf"]
    again = read_robot(told["path"])
    assert again.model.dof_frictionloss.tolist() == [0.0, 0.06]
    assert next_version(told["path"], tmp_path).name == "arm.v3.xml"


def test_apply_leaves_what_is_not_named(arm, tmp_path):
    told = apply_robot(tmp_path, verdict_of(arm, "CLASS", named("coulomb_friction@elbow", torque=0.06)), None, False)
    assert not told["accepted"] and told["path"] is None and not list(tmp_path.iterdir())


def test_apply_takes_the_certain_part_of_a_class(arm, tmp_path):
    found = named("coulomb_friction@elbow", torque=0.06), named("viscous_friction@shoulder", damping=0.1)
    each = {"coulomb_friction@elbow": "NAMED", "viscous_friction@shoulder": "CLASS"}
    told = apply_robot(tmp_path, verdict_of(arm, "CLASS", *found, **each), None, False)
    again = read_robot(told["path"]).model
    assert told["gap_before"] is None and "without viscous friction at shoulder, not certain" in told["reason"]
    assert again.dof_frictionloss.tolist() == [0.0, 0.06]
    np.testing.assert_array_equal(again.dof_damping, arm.model.dof_damping)


def test_logs_with_contact_are_refused(folder, records, tmp_path):
    """A plate where the arm swings."""
    path = tmp_path / "robot.xml"
    plate = '<worldbody><geom type="box" size="0.5 0.5 0.05" pos="0 0 -0.5"/>'
    path.write_text(ARM.replace("<worldbody>", plate).replace(TIP, TIP + '<geom type="sphere" size="0.05" pos="0 0 -0.2"/>'))
    with pytest.raises(LogError, match="touch") as told:
        read_robot(path).check_contact(records)
    assert "\n" not in str(told.value)


def test_apply_refuses_an_encoder_as_mjcf(arm, tmp_path):
    with pytest.raises(ConfigError, match="correct it in the logs"):
        apply_robot(tmp_path, verdict_of(arm, "NAMED", named("joint_zero_offset@shoulder", offset=0.04)), None, False)


def test_apply_refuses_a_changed_description(arm, tmp_path):
    verdict = verdict_of(arm, "NAMED", named("coulomb_friction@elbow", torque=0.06))
    verdict["context"]["model_sha256"] = "0" * 64
    with pytest.raises(ConfigError, match="changed since the search"):
        apply_robot(tmp_path, verdict, None, False)


def test_report_on_a_robot_is_checked_before_use(arm, tmp_path):
    verdict = verdict_of(arm, "NAMED", named("coulomb_friction@elbow", torque=0.06))
    verdict["effects"][0]["parameters"]["torque"]["value"] = "much"
    (tmp_path / "verdict.json").write_text(json.dumps(verdict))
    with pytest.raises(ConfigError, match="effects.0.parameters.torque.value"):
        reported.robot_verdict(tmp_path)
    with pytest.raises(ConfigError, match="use fishmj gap apply"):
        reported.verdict(tmp_path, context=False)


def test_commands_of_fish_refuse_a_robot_in_one_line(arm, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,pos1,pos2,cmd1,cmd2\n0,0,0,0,0\n0.01,0,0,0,0\n")
    with pytest.raises(ConfigError, match="--water is for fish only"):
        find.main([str(log), "--model", str(arm.path), "--water", "swift"])
    with pytest.raises(ConfigError, match="--same-robot is for fish only"):
        check.main([str(arm.path), "--data", str(log), "--same-robot"])
    with pytest.raises(LogError, match="--yes"):
        find.main([str(log), "--model", str(arm.path)])


def test_robot_effects_leave_the_fish_alone():
    fish, robots = effects.catalogue(), effects.robot_catalogue()
    assert not [e.name for e in fish.values() if not e.swims]
    assert {"coulomb_friction", "viscous_friction", "servo_gain", "command_latency"} <= set(fish) & set(robots)


def test_sizes_of_an_effect_scale_with_the_robot(arm, model):
    larger = RigidRobot(arm, model.sizes._replace(torque=10.0 * model.sizes.torque))
    friction = [next(e for e in m.active.effects if e.name == "coulomb_friction@elbow") for m in (model, larger)]
    sizes = [effect.parameters[0].typical[1] for effect in friction]
    assert sizes[1] == pytest.approx(10.0 * sizes[0])
