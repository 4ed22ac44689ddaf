"""Commands around the search of a robot in MJCF: check, calibration, import, next experiment. All logs are *synthetic*."""

import json
import sys
import zipfile
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import robot_recordings
from robot_arm import ARM, edited, write_logs

from fishmj.base.errors import ConfigError, LogError, MissingExtra, UnknownName, UsageError
from fishmj.base.store import sha256
from fishmj.gap.calibrate import robot_command
from fishmj.gap.calibrate.robot_fit import described, fit_robot
from fishmj.gap.commands import check, next_experiment
from fishmj.gap.commands.admit_robot import _of_angles, doubts, mistakes, refuse_mistakes, undone
from fishmj.gap.commands.check_robot import ratio_of
from fishmj.gap.commands.find_robot import columns_of, logs_digest, read_logs
from fishmj.gap.models.robot_description import is_robot, read_robot, robot_file
from fishmj.gap.models.robot_excitation import FAMILIES, rest_of, safe_experiments
from fishmj.gap.records.robot_logs import guess_columns, log_files, read_robot_logs, read_sheet
from fishmj.gap.records.shooting import robot_records
from fishmj.log import import_command
from fishmj.log.importers.torch_tensors import read_tensors

pytest.importorskip("numba")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("doors")


@pytest.fixture(scope="module")
def arm(folder):
    return written(folder / "arm.xml", ARM)


def written(path, text):
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def sticky_logs(folder):
    return write_logs(folder / "sticky", edited(elbow_joint='frictionloss="0.06"'), logs=3, seconds=1.6)


# -------------------------------------------------------------------------------------------------------------------------- check
def said(capsys) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_version_with_the_friction_closes_the_gap(arm, sticky_logs, folder, capsys):
    version = written(folder / "arm.v2.xml", edited(elbow_joint='frictionloss="0.06"'))
    asked = [str(version), "--data", str(sticky_logs), "--parent", str(arm), "--yes", "--json"]
    assert check.main(asked) == 0
    found = said(capsys)
    assert found["ratio"]["high"] < 0.1 and found["gap"] < found["gap_parent"] and not found["worse"]
    before, after = found["by_joint"]["elbow"]
    assert after < 0.1 * before


def test_version_that_is_no_better_fails(arm, sticky_logs, folder, capsys):
    version = written(folder / "wrong.v2.xml", ARM.replace('damping="0.06"', 'damping="0.2"'))
    asked = [str(version), "--data", str(sticky_logs), "--parent", str(arm), "--yes", "--json"]
    assert check.main(asked) == 1
    assert "no smaller than its parent's" in said(capsys)["worse"]


def test_version_beside_its_report_is_judged_on_logs_set_aside(arm, sticky_logs, tmp_path, capsys):
    version = written(tmp_path / "arm.v2.xml", edited(elbow_joint='frictionloss="0.06"'))
    context = {"model": str(arm), "model_sha256": sha256(arm), "judged": ["swing1"]}
    context["data_sha256"] = logs_digest(log_files(sticky_logs))
    verdict = {"answer": "NAMED", "effects": [], "context": context, "gap_before": 9.0, "gap_after": 1.0}
    (tmp_path / "verdict.json").write_text(json.dumps(verdict))
    assert check.main([str(version), "--data", str(sticky_logs), "--yes", "--json"]) == 0
    found = said(capsys)
    assert found["logs"] == ["swing1"] and found["same_data"]


def test_version_without_its_parent_is_refused(folder, sticky_logs, tmp_path):
    version = written(tmp_path / "arm.v2.xml", ARM)
    with pytest.raises(ConfigError, match="--parent"):
        check.main([str(version), "--data", str(sticky_logs), "--yes"])
    other = written(tmp_path / "other.xml", ARM.replace('"elbow"', '"knee"'))
    with pytest.raises(ConfigError, match="joints differ"):
        check.main([str(version), "--data", str(sticky_logs), "--parent", str(other), "--yes"])


def test_interval_of_a_ratio_holds_it_and_narrows_with_more_logs():
    rng = np.random.default_rng(1)
    widths = []
    for logs in (6, 60):
        before, noise = rng.gamma(2.0, size=4 * logs), rng.gamma(2.0, size=4 * logs)
        ratio = ratio_of(before, 0.5 * noise, np.repeat(np.arange(logs), 4))
        assert ratio.low < 0.5 < ratio.high and ratio.over == "logs"
        widths.append(ratio.high - ratio.low)
    assert widths[1] < widths[0]


# -------------------------------------------------------------------------------------------------------------- calibrate model
@pytest.fixture(scope="module")
def stiff_logs(folder):
    text = edited(elbow_joint='frictionloss="0.06" armature="0.004"').replace('damping="0.06"', 'damping="0.12"')
    return write_logs(folder / "stiff", text, logs=2, seconds=1.7, seed=3)


def test_calibration_finds_friction_damping_and_armature(arm, stiff_logs, tmp_path, capsys):
    out = tmp_path / "arm.calibrated.xml"
    asked = [str(stiff_logs), "--model", str(arm), "--yes", "--out", str(out), "--only", "friction,damping,armature,bodies"]
    assert robot_command.main([*asked, "--json"]) == 0
    found = said(capsys)
    numbers = {n["name"]: n for n in found["numbers"]}
    for name, true in (("coulomb_friction@elbow", 0.06), ("rotor_inertia@elbow", 0.004), ("viscous_friction@shoulder", 0.12)):
        n = numbers[name]
        assert n["low"] <= true <= n["high"] and n["is_told"] and abs(n["value"] - true) < 0.1 * true, n
    m = mujoco.MjModel.from_xml_path(str(out))
    assert m.dof_frictionloss[1] == pytest.approx(0.06, rel=0.1) and m.dof_damping[0] == pytest.approx(0.12, rel=0.1)
    left = [n for n in found["numbers"] if not n["is_told"]]
    assert {"inertia@upper"} <= {n["name"] for n in left} and found["misfit"][1] < 0.1 * found["misfit"][0]
    assert m.body_inertia[1].tolist() == [0.004, 0.004, 0.0005]  # not told, so as stated
    text = out.read_text()
    assert text.startswith("<!-- calibrated by fishmj calibrate model") and "90 % intervals" in text
    assert [line for line in ARM.splitlines() if "joint name" not in line and line not in text.splitlines()] == []


def test_written_numbers_are_fitted_with_the_others_as_stated(arm, folder):
    """A lower arm of another mass, which stays as stated: half of the fit of all leaves 4.4 times the noise."""
    heavy = edited(elbow_joint='frictionloss="0.06" armature="0.01"', shoulder_joint='armature="0.02"').replace(
        'mass="0.4" diaginertia="0.003 0.003', 'mass="0.5" diaginertia="0.005 0.005'
    )
    robot, records = opened(arm, write_logs(folder / "heavy", heavy, logs=2, seconds=1.6))
    found = fit_robot(robot, records)
    told = {n.name for n in found.numbers if n.is_told}
    assert "mass@lower" not in told and "coulomb_friction@elbow" in told
    before, written, whole = found.misfit
    assert whole <= written < 1.5 < before and all(n.low <= n.value <= n.high for n in found.numbers)


def test_number_that_no_log_shows_is_left(arm, folder):
    """A motor has no damping gain, and a joint at rest tells no friction."""
    logs = write_logs(folder / "still", ARM, logs=2, seconds=1.0)
    robot, records = opened(arm, logs)
    at_rest = [r._replace(joint=r.joint._replace(values=r.joint.values * [1.0, 0.0])) for r in records]
    found = fit_robot(robot, at_rest, ("friction", "gain"))
    left = {n.name: described(n) for n in found.numbers if not n.is_told}
    assert left["servo_damping_gain@shoulder"] == left["coulomb_friction@elbow"] == "left: no log shows it"
    assert found.model.dof_frictionloss[1] == 0.0
    with pytest.raises(LogError, match="no joint moves"):
        fit_robot(robot, [r._replace(joint=r.joint._replace(values=0.0 * r.joint.values)) for r in records])


def opened(path, logs):
    robot, _, trials, _ = read_logs(SimpleNamespace(model=path, data=logs, columns=None, yes=True))
    return robot, robot_records(trials, robot.dt, robot.sites("joint"))


def test_calibration_refuses_what_it_does_not_know(arm, stiff_logs, tmp_path):
    with pytest.raises(ConfigError, match="known: friction, damping"):
        robot_command.main([str(stiff_logs), "--model", str(arm), "--only", "colour"])
    with pytest.raises(ConfigError, match="exists, or does not end"):
        robot_command.main([str(stiff_logs), "--model", str(arm), "--out", str(arm)])


# --------------------------------------------------------------------------------------------------------- recordings, data sets
def log_columns(folder, number=0):
    """(stamps, commands, positions) of a log in CSV."""
    rows = np.loadtxt(log_files(folder)[number], delimiter=",", skiprows=1)
    return rows[:, 0], rows[:, 1:3], rows[:, 3:5]


def same_as_csv(robot, logs, csv, late=0.0):
    (trial,), _ = read_robot_logs(*guessed(robot, logs))
    t, commands, positions = log_columns(csv)
    cmd, joint = trial.table("cmd"), trial.table("joint")
    np.testing.assert_allclose(np.stack([cmd["c1"], cmd["c2"]], 1), commands)
    np.testing.assert_allclose(np.stack([joint["j1"], joint["j2"]], 1), positions)
    np.testing.assert_allclose(joint["t"] - joint["t"][0], t - t[0], atol=1e-6)
    np.testing.assert_allclose(cmd["t"][0] - joint["t"][0], late, atol=1e-6)


def guessed(robot, logs):
    files = log_files(logs)
    return files, columns_of(SimpleNamespace(columns=None, yes=True), robot, files)


def joint_states(csv):
    """Messages of two topics: states in the order of another program, commands 3 ms later as efforts."""
    for t, (shoulder, elbow), (q1, q2) in zip(*log_columns(csv), strict=True):
        for topic, names, late, values in (
            ("/joint_states", ("elbow", "shoulder"), 0.0, {"position": [q2, q1], "velocity": [0.0, 0.0]}),
            ("/joint_commands", ("shoulder", "elbow"), 0.003, {"effort": [shoulder, elbow]}),
        ):
            stamp = round(1e9 * (1.7e9 + t + late))
            yield topic, stamp, {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}, "name": names, **values}


def test_topics_of_a_recording_are_read_by_their_joints(arm, folder, sticky_logs):
    from mcap.writer import Writer

    path = folder / "swing.mcap"
    with open(path, "wb") as file:
        writer, channels = Writer(file), {}
        writer.start()
        for topic, stamp, message in joint_states(sticky_logs):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic=topic, message_encoding="json", schema_id=0)
            data = json.dumps(message).encode()
            writer.add_message(channels[topic], log_time=stamp, publish_time=stamp, data=data)
        writer.finish()
    same_as_csv(read_robot(arm), path, sticky_logs, late=0.003)


def test_bag_is_one_log(arm, folder, sticky_logs):
    store = robot_recordings.types()
    kinds, kind, messages = store.types, "sensor_msgs/msg/JointState", []
    for topic, stamp, told_of in joint_states(sticky_logs):
        time = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        values = {key: np.array(told_of.get(key, []), float) for key in ("position", "velocity", "effort")}
        header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="")
        message = kinds[kind](header=header, name=list(told_of["name"]), **values)
        messages.append((topic, kind, stamp, bytes(store.serialize_cdr(message, kind))))
    bags = folder / "bags"
    robot_recordings.bag(bags / "swing", messages)
    assert log_files(bags) == [bags / "swing"] and log_files(bags / "swing") == [bags / "swing"]
    same_as_csv(read_robot(arm), bags, sticky_logs, late=0.003)


def test_episodes_of_a_lerobot_set_are_logs(folder, sticky_logs):
    """Position servos: `action` and `observation.state` are lists, named in info.json."""
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    names, root = ["shoulder.pos", "elbow.pos"], folder / "lerobot"
    (root / "meta").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    features = {key: {"dtype": "float32", "names": names} for key in ("action", "observation.state")}
    (root / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 250, "features": features}))
    rows = [np.column_stack([np.full(len(t), k), t, u, q]) for k in (0, 1) for t, u, q in [log_columns(sticky_logs, k)]]
    whole = np.concatenate(rows)
    table = {"episode_index": whole[:, 0].astype(int), "timestamp": whole[:, 1]}
    table |= {"action": list(whole[:, 2:4]), "observation.state": list(whole[:, 4:6])}
    pq.write_table(pa.table(table), root / "data" / "chunk-000" / "file-000.parquet")
    servos = written(folder / "servos.xml", ARM.replace("<motor", "<position kp='5'"))
    trials, broken = read_robot_logs(*guessed(read_robot(servos), root))
    assert [trial.name for trial in trials] == ["file-000_episode_0", "file-000_episode_1"] and not broken
    np.testing.assert_allclose(trials[1].table("joint")["j2"], log_columns(sticky_logs, 1)[2][:, 1])
    np.testing.assert_allclose(trials[1].table("cmd")["c1"], log_columns(sticky_logs, 1)[1][:, 0])


def test_import_of_a_robot_names_the_command_that_reads_it(arm, sticky_logs):
    with pytest.raises(UsageError, match="gap find .* reads a robot's logs as they are"):
        import_command.main([str(sticky_logs), "--model", str(arm)], dict)


def test_measured_commands_are_doubted():
    joints = ("shoulder", "elbow")
    columns = guess_columns(["t", "q1", "q2", "tau_meas1", "tau_des1", "tau_des2"], joints, joints, torques=True)
    assert not columns.doubts()
    current = columns._replace(actuator={"elbow": columns.actuator["elbow"].model_copy(update={"column": "current1"})})
    assert "commands of elbow are measured" in current.doubts()[0]


# ------------------------------------------------------------------------------------------------------------------ mistakes
@pytest.fixture(scope="module")
def described_arm(arm, sticky_logs):
    return opened(arm, sticky_logs)


def test_logs_without_a_mistake_are_let_in_although_an_effect_is_missing(described_arm):
    robot, records = described_arm
    assert mistakes(robot, records) == [] and doubts(robot, records) == []
    refuse_mistakes(robot, records)


PLANTED = (
    "exchanging the positions of shoulder and elbow",
    "exchanging the commands of shoulder and elbow",
    "actuator elbow with its commands negated",
    "joint elbow with its positions negated",
    "joint shoulder turned by half a turn",
)


@pytest.mark.parametrize("what", PLANTED)
def test_mistake_is_named_with_its_remedy(what, described_arm):
    robot, records = described_arm
    wrong = next(changed for name, _, changed in undone(robot, records) if name == what)
    assert mistakes(robot, wrong)[0].what == what
    with pytest.raises(LogError, match=r"--columns MAP.toml. If the logs are right, add --anyway"):
        refuse_mistakes(robot, wrong)
    refuse_mistakes(robot, wrong, anyway=True)


def test_degrees_taken_for_radians_are_refused_without_a_word_of_mujoco(arm, folder, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the arm that is predicted from such angles diverges
    robot, records = opened(arm, write_logs(folder / "swung", ARM, logs=2, seconds=1.6))
    turned = [_of_angles(r, np.full(2, 180 / np.pi)) for r in records]
    with pytest.raises(LogError, match='reading positions in degrees .* state unit = "deg"'):
        refuse_mistakes(robot, turned)
    assert "unstable" not in "".join(capfd.readouterr()) and not list(tmp_path.iterdir())


def test_normalised_positions_and_commands_are_refused(folder):
    """-10 to 10 of the calibrated range, which one factor turns into radians."""
    model = ARM.replace("<motor", "<position kp='5' kv='0.2'")
    robot, records = opened(written(folder / "servo_arm.xml", model), write_logs(folder / "servo", model, logs=2, seconds=2.0))
    assert mistakes(robot, records) == []
    scaled = [_of_angles(r, np.full(2, 6.4))._replace(commands=6.4 * r.commands) for r in records]
    with pytest.raises(LogError, match=r"in a unit of their own \(times about 0\.[1-3]\).*state their unit, or scale"):
        refuse_mistakes(robot, scaled)


def test_commands_beyond_their_range_are_doubted(described_arm):
    """100 for a motor of 4 N m: in truth a current, or another unit."""
    robot, records = described_arm
    (told,) = doubts(robot, [r._replace(commands=r.commands * [1.0, 400.0]) for r in records])
    assert "actuator elbow: " in told and "are outside its ctrlrange, -4 to 4: another unit, or a measured current?" in told


def test_joint_at_a_stop_is_no_mistake(folder, arm):
    """No other unit explains an elbow that an obstacle holds."""
    stopped = edited(elbow_joint='range="-0.05 0.05" limited="true" solreflimit="0.02 1"')
    robot, records = opened(arm, write_logs(folder / "stopped", stopped, logs=3, seconds=2.0))
    assert mistakes(robot, records) == []


def test_joint_that_never_moves_is_doubted(described_arm):
    robot, records = described_arm
    values = records[0].joint.values * [1.0, 0.0] + [0.0, 0.3]
    (told,) = doubts(robot, [records[0]._replace(joint=records[0].joint._replace(values=values))])
    assert "joint elbow: always 0.3 while its commands change" in told


def test_commands_on_another_clock_are_refused(arm, described_arm):
    robot, records = described_arm
    with pytest.raises(LogError, match="different clocks"):
        refuse_mistakes(robot, [r._replace(sent=r.sent - 0.4) for r in records])


def test_readings_beyond_the_range_and_other_wraps_are_doubted(folder, described_arm):
    _, records = described_arm
    limited = written(
        folder / "limited.xml",
        edited(elbow_joint='range="2 3" limited="true"').replace("<option", "<compiler angle='radian'/><option"),
    )
    doubt = doubts(read_robot(limited), records)[0]
    assert "outside its range, 2 to 3" in doubt and "degrees" not in doubt
    in_rad = written(folder / "in_rad.xml", edited(elbow_joint='range="-2 2" limited="true"'))  # read as degrees
    doubt = doubts(read_robot(in_rad), records)[0]
    assert (
        "-0.0349 to 0.0349" in doubt
        and 'the model means -2 to 2 in rad: MJCF reads degrees without <compiler angle="radian"/>' in doubt
    )
    values = records[0].joint.values.copy()
    values[20:, 1] += 5.2
    wrapped = records[0]._replace(joint=records[0].joint._replace(values=values))
    assert any("wrap not at 2 pi" in doubt for doubt in doubts(described_arm[0], [wrapped]))


# ------------------------------------------------------------------------------------------------------------- next experiment
SPEED = 2.5  # rad/s
LIMITED = ARM.replace("<option", "<compiler angle='radian'/><option").replace(
    'damping="0.02"', 'damping="0.02" range="-1 1" limited="true"'
)


def test_experiments_stay_within_the_limits(folder):
    robot = read_robot(written(folder / "limits.xml", LIMITED))
    made = safe_experiments(robot, rest_of(robot, SPEED), FAMILIES, 4.0, SPEED, seed=1)
    assert {"multisine", "steps", "holds"} <= {one.family for one in made}
    for one in made:
        assert np.abs(one.commands[:, 0]).max() <= 6.0 and np.abs(one.commands[:, 1]).max() <= 4.0
        assert np.abs(one.v).max() <= SPEED and np.abs(one.q[:, 1]).max() <= 0.8 + 1e-6
        assert np.ptp(one.q, 0).max() > 0.02 and np.abs(one.commands[0]).max() == np.abs(one.commands[-1]).max() == 0.0


def test_servo_whose_zero_is_beyond_its_range_begins_inside_it(folder):
    """Such as a knee that cannot be straight."""
    servos = (
        LIMITED.replace('range="-1 1"', 'range="-2.7 -0.8"').replace("<motor", "<position kp='20' kv='1'").replace("-4 4", "-9 9")
    )
    robot = read_robot(written(folder / "knee.xml", servos))
    made = safe_experiments(robot, rest_of(robot, SPEED), ("holds",), 4.0, SPEED, seed=1)
    knee = made[0].q[:, 1]
    assert -2.51 <= knee.min() and knee.max() <= -0.99 and np.ptp(knee) > 0.1


def test_arm_that_would_hit_a_plate_moves_less(folder):
    plate = '<worldbody><geom type="box" size="0.02 0.5 0.5" pos="0.12 0 -0.5"/>'
    text = ARM.replace("<worldbody>", plate).replace(
        '<body name="lower"', '<geom type="sphere" size="0.02" pos="0 0 -0.3"/><body name="lower"'
    )
    free, beside = (read_robot(written(folder / f"plate{i}.xml", body)) for i, body in enumerate((ARM, text)))
    ways = []
    for robot in (free, beside):
        (largest, *_) = safe_experiments(robot, rest_of(robot, SPEED), ("holds",), 4.0, SPEED, seed=1)
        ways.append(np.sin(largest.q[:, 0]).min())
    assert -0.3 * ways[1] < 0.12 < -0.3 * ways[0]


def class_of(arm, effect, rival):
    found = [{"name": effect[0], "parameters": {effect[1]: {"value": effect[2], "low": effect[2], "high": effect[2]}}}]
    context = {"model": str(arm), "model_sha256": sha256(arm)}
    rivals = [{"name": rival, "instead_of": effect[0], "p_best": 0.4}]
    return {"answer": "CLASS", "effects": found, "rivals": rivals, "context": context, "gap_before": 9.0, "gap_after": 1.0}


def test_next_experiment_separates_what_differs_and_not_what_is_the_same(arm, tmp_path, capsys):
    friction = class_of(arm, ("coulomb_friction@elbow", "torque", 0.05), "viscous_friction@elbow")
    late = class_of(arm, ("command_latency", "delay", 0.02), "joint_sensor_delay")
    best = []
    for k, verdict in enumerate((friction, late)):
        report = tmp_path / str(k)
        report.mkdir()
        (report / "verdict.json").write_text(json.dumps(verdict))
        assert next_experiment.main([str(report), "--runs", "holds,multisine", "--seconds", "4", "--json"]) == 0
        found = said(capsys)
        best.append(found["experiments"][0]["sigma"])
    assert best[0] > 10.0 and best[1] < 1.0 and "no experiment decides" in found["advice"]


def test_next_experiment_writes_commands_that_tell_the_numbers(arm, tmp_path, capsys):
    out = tmp_path / "experiment.csv"
    asked = [str(arm), "--runs", "holds", "--seconds", "3", "--out", str(out), "--json"]
    assert next_experiment.main(asked) == 0
    found = said(capsys)["experiments"]
    assert found[0]["bits"] > 10.0 and found[0]["numbers told"] > 4
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    assert out.read_text().startswith("t,cmd_shoulder,cmd_elbow\n") and np.allclose(np.diff(table[:, 0]), 0.01)
    with pytest.raises(ConfigError, match="does not end in .csv"):
        next_experiment.main(asked)


def test_next_experiment_refuses_what_is_not_safe(arm, tmp_path):
    with pytest.raises(ConfigError, match="no experiment is safe"):
        next_experiment.main([str(arm), "--runs", "steps", "--seconds", "2", "--speed", "0.001"])
    with pytest.raises(UnknownName, match="juggle"):
        next_experiment.main([str(arm), "--runs", "juggle"])


# ------------------------------------------------------------------------------------------------- other robots, other files
def test_robot_of_the_menagerie_is_found_by_its_name(arm, monkeypatch):
    class MenagerieError(Exception):
        pass

    def get(name):
        if name != "arm":
            raise MenagerieError(f"Unknown robot {name!r}.")
        entry = SimpleNamespace(file=arm.name)
        return SimpleNamespace(path=lambda: arm.parent, default_model="arm", entry=lambda which: entry)

    monkeypatch.setitem(sys.modules, "mujoco_menagerie", SimpleNamespace(get=get, MenagerieError=MenagerieError))
    assert robot_file("menagerie:arm") == arm and is_robot("menagerie:arm")
    with pytest.raises(ConfigError, match="menagerie:leg: Unknown robot 'leg'"):
        robot_file("menagerie:leg")


def test_menagerie_without_its_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(MissingExtra, match=r'menagerie:arm needs mujoco-menagerie: pip install "fishmj\[menagerie\]"'):
        robot_file("menagerie:arm")


def test_a_base_that_is_fixed_touches_its_own_links(folder, arm, sticky_logs):
    """MuJoCo leaves out contacts of a body with its parent, but not with a parent that is fixed to the world."""
    base = '<body name="base"><geom type="sphere" size="0.1"/><body name="upper">'
    text = ARM.replace('<body name="upper">', base + '<geom type="sphere" size="0.1"/>').replace(
        "</worldbody>", "</body></worldbody>"
    )
    robot = read_robot(written(folder / "based.xml", text))
    robot.check_contact(opened(arm, sticky_logs)[1])


def tensor_file(path, pickled, **storages):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", pickled)
        archive.writestr("log/byteorder", "little")
        for key, values in storages.items():
            archive.writestr(f"log/data/{key[1:]}", values.tobytes())
    return path


def tensor(key, count, size, stride):
    """Opcodes of a tensor in data.pkl, protocol 2, as torch.save writes them."""
    number = lambda n: b"J" + int(n).to_bytes(4, "little")
    text = lambda word: b"X" + len(word).to_bytes(4, "little") + word.encode()
    whole = lambda numbers: b"(" + b"".join(map(number, numbers)) + b"t"
    storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text(key) + text("cpu") + number(count) + b"tQ"
    rest = number(0) + whole(size) + whole(stride) + b"\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + rest + b"tR"


def entry(name, body):
    return b"X" + len(name).to_bytes(4, "little") + name.encode() + body


def test_tensors_are_read_without_their_pickle(tmp_path):
    t, q = np.arange(3, dtype="<f4"), np.arange(6, dtype="<f4")
    body = b"\x80\x02}(" + entry("time", tensor("0", 3, (3,), (1,))) + entry("dof_pos", tensor("1", 6, (3, 2), (2, 1))) + b"u."
    path = tensor_file(tmp_path / "log.pt", body, s0=t, s1=q)
    found = read_tensors(path)
    np.testing.assert_array_equal(found["dof_pos"], q.reshape(3, 2))
    assert list(read_sheet(path).columns) == ["time", "dof_pos_1", "dof_pos_2"]


HOSTILE = {
    "calls 'os system'": b"\x80\x02cos\nsystem\n(" + entry("id", b"") + b"tR.",
    "a tensor of": b"\x80\x02}(" + entry("time", tensor("0", 3, (900,), (1,))) + b"u.",
    "no dictionary of tensors": b"\x80\x02}.",
    "holds": b"\x80\x02c__main__\nx\n)\x81.",
}


@pytest.mark.parametrize("says", HOSTILE)
def test_file_of_more_than_tensors_is_refused(says, tmp_path):
    path = tensor_file(tmp_path / "log.pt", HOSTILE[says], s0=np.zeros(3, "<f4"))
    with pytest.raises(LogError, match=says):
        read_tensors(path)
    path.write_bytes(b"\x80\x02}.")
    with pytest.raises(LogError, match="not of torch.save in its zip format"):
        read_tensors(path)


def test_an_only_log_is_cut_into_parts(arm, folder):
    logs = write_logs(folder / "alone", ARM, logs=1, seconds=8.4)
    robot, _, trials, _ = read_logs(SimpleNamespace(model=arm, data=logs, columns=None, yes=True))
    assert [t.name for t in trials] == [f"swing0_part_{k}" for k in (1, 2, 3, 4)]
    seconds = [float(np.ptp(t.table("joint")["t"])) for t in trials]
    assert min(seconds) > 2.0 and sum(seconds) == pytest.approx(8.4, abs=0.05)
    assert len(robot_records(trials, robot.dt, robot.sites("joint"))) == 4
