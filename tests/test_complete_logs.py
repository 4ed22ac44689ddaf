"""Logs of `play`, `evaluate --log`, `Sim` and the flow solver are complete trials: what a robot would log, and the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fishmj import engines, evaluate, log
from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import LogError
from fishmj.engines.extensions import with_effects
from fishmj.evaluate.trial_logs import trial_of, write_logs
from fishmj.gap.calibrate import calibration_logs as calibrate_logs
from fishmj.gap.commands import admission
from fishmj.gap.records.datasets import readable_trials
from fishmj.gap.records.records import record_of
from fishmj.log import Trial, stacked
from fishmj.mjcf import load_robot
from fishmj.mjcf.geometry import link_centres
from fishmj.mjcf.identity import body_sha256, identity, robot_sha256
from fishmj.sim import Sim
from fishmj.tasks.sensing import sensed, sigmas
from fishmj.view.play import LiveSession
from fishmj.view.play import __main__ as play
from fishmj.water.flow import Flow

ROBOT = load_robot("fish")
TABLES = {"cmd", "joint", "pose", "power", "truth", "flow", "target", "obs"}
UNTOLD = {"replicate_of", "commit", "target", "sigma"}  # what a complete simulated trial may leave open


@pytest.fixture(scope="module")
def body():
    return engines.make("compiled", ROBOT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two headless swims by the command, as a data set."""
    root = tmp_path_factory.mktemp("swims")
    for name, seed in (("a", "1"), ("b", "2"), ("again", "1")):
        argv = [
            "--controller",
            "dob",
            "--engine",
            "compiled",
            "--headless-seconds",
            "4",
            "--seed",
            seed,
            "--save",
            str(root / name),
        ]
        assert console.run(play.main, argv) == 0
    return root


def missing(trial) -> set[str]:
    said = [note for note in trial.notes if "missing" in note]
    return {key for note in said for key in note.split("missing ")[1].split(", ")}


def test_two_live_swims_are_a_data_set_that_search_and_calibration_read(folder):
    trials = {name: log.read_trial(folder / name) for name in "ab"}
    data = log.write_dataset(folder / "set", trials)
    for trial in log.read_dataset(data):
        assert set(trial.tables) == TABLES and missing(trial) <= UNTOLD
        record = record_of(trial, 0.004)
        assert record.joint.values.shape == (200, 3) and record.pose.values.shape == (200, 3) and record.power is not None
        assert np.isfinite(record.joint.sigma).all() and record.placed is not None
        assert record.flow == pytest.approx((-0.2, 0.0)) and record.medium == "water"
        assert np.ptp(record.commands) > 0.2
    assert admission.insufficient_data(readable_trials(data), load_robot("fish")) is None
    records = calibrate_logs.read(data).records(0.004)
    assert len(records) == 2 and [calibrate_logs.angles(r).values.shape for r in records] == [(200, 3)] * 2


def test_a_live_swim_is_the_same_log_for_the_same_seed(folder):
    one, again, other = (log.read_trial(folder / name) for name in ("a", "again", "b"))
    assert one.meta == again.meta
    for table, columns in one.tables.items():
        assert all(np.array_equal(columns[c], again.tables[table][c]) for c in columns), table
    assert not np.array_equal(one.tables["joint"]["j1"], other.tables["joint"]["j1"])


def test_a_swim_that_beats_from_the_first_row_begins_where_it_truly_was(folder):
    """Averaged over 0.3 s of it, the joints would be 5 to 8 deg off and the heading 0.05 rad."""
    for name in "ab":
        trial = log.read_trial(folder / name)
        record, truth = record_of(trial, 0.004), trial.table("truth")
        assert np.abs(record.joints - stacked(truth, "j#")[0]).max() < np.radians(1.5)
        assert (
            abs(record.start[2] - truth["yaw"][0]) < 0.03
            and math.hypot(*(record.start - [truth[c][0] for c in ("x", "y", "yaw")])[:2]) < 0.01
        )


def cut(trial, start):
    """From `start` s on."""
    tables = {name: {c: v[t["t"] >= start] for c, v in t.items()} for name, t in trial.tables.items()}
    return replace(trial, tables=tables)


def test_record_that_starts_in_motion_is_refused_unless_its_push_is_stated():
    sim = Sim("fish")
    trial = sim.run(lambda t: 0.5 * np.sin(2 * math.pi * t - np.arange(3)) * min(t, 1.0), 5.0)
    record_of(trial, 0.004)
    late = cut(trial, 4.0)
    with pytest.raises(LogError, match=r"the fish moves at 0\.\d+ m/s at the first row without a stated push"):
        record_of(late, 0.004)
    record_of(replace(late, meta=late.meta | {"push": [0.3, 0.0, 0.0]}), 0.004)


def test_a_fish_at_rest_is_averaged_for_0_3_s():
    t = np.arange(0, 2, 0.02)
    rng = np.random.default_rng(0)
    values = {c: 0.002 * rng.standard_normal(len(t)) for c in ("x", "y", "yaw")}
    beat = np.where(t > 0.6, 0.5 * np.sin(6 * (t - 0.6)), 0.0)
    table = {"t": t, **{f"j{k}": beat for k in (1, 2, 3)}}
    trial = log.Trial({}, {"cmd": {"t": t, **{f"c{k}": beat for k in (1, 2, 3)}}, "joint": table, "pose": {"t": t, **values}})
    assert record_of(trial, 0.004).start == pytest.approx([values[c][:16].mean() for c in values])


def test_what_a_log_states_of_its_sensors_is_what_they_did(body):
    pond = LiveSession("dob", flow=Flow(speed=0.1, direction=math.pi, seed=3), engine=body)
    for _ in range(100):
        pond.step()
    trial = pond.trial()
    truth, pose, joint = (trial.tables[name] for name in ("truth", "pose", "joint"))
    late = trial.value("latency.pose")
    assert 0 <= late - ROBOT.timing.camera_latency < ROBOT.timing.bus_dt  # in whole bus ticks, rounded up as in every task
    for column in ("x", "y", "yaw"):
        off = pose[column] - np.interp(pose["t"] - late, truth["t"], truth[column])
        assert np.std(off[5:]) == pytest.approx(trial.value(f"sigma.{column}"), rel=0.1) and abs(off[5:].mean()) < 1e-3, column
    off = stacked(joint, "j#") - stacked(truth, "j#")
    assert np.std(off) == pytest.approx(trial.value("sigma.j1"), rel=0.1)
    assert trial.value("sigma.x") == constant("noise", "position") and "camera latency" in trial.value("notes")


def test_without_noise_the_tracker_shows_the_truth_late(body):
    pond = LiveSession("dob", flow=Flow(speed=0.1), engine=body, noise=0.0)
    for _ in range(5):
        pond.step()
    trial, k = pond.trial(), int(pond.loop.scenario.camera[0])
    assert np.array_equal(trial.tables["pose"]["x"][k:], trial.tables["truth"]["x"][:-k])
    assert np.array_equal(trial.tables["pose"]["x"][:k], np.full(k, -0.7)), "before the first frame: where it was put"
    assert np.array_equal(stacked(trial.tables["joint"], "w#"), stacked(trial.tables["truth"], "k#"))
    assert trial.value("start")[:2] == [-0.7, 0.0]


def test_the_sensors_of_the_description_are_in_the_log():
    t, still, pose = 0.02 * np.arange(1, 6), np.zeros((5, 3)), np.tile([1.0, 0.0, 0.0], (5, 1))
    quiet = {"start": pose[0], "camera": 1, "random": np.random.default_rng(0), "strength": 0.0}
    tall = with_effects(ROBOT, ["camera_scale"])
    seen = sensed(tall, t, pose, still, still, effects=np.array([0.1]), **quiet)
    assert seen["pose"]["x"] == pytest.approx(1.1)
    late, ramp = with_effects(ROBOT, ["joint_sensor_delay"]), np.outer(t, [1.0, 0.0, 0.0])
    seen = sensed(late, t, pose, ramp, still, effects=np.array([0.04]), **quiet)
    assert seen["joint"]["j1"] == pytest.approx(np.clip(t - 0.04, 0.0, None), abs=1e-9)


def test_changing_the_current_and_the_controller_is_told(body):
    pond = LiveSession("drift", flow=Flow(speed=0.1), engine=body)
    pond.step()
    pond.set_flow(0.2, 0.0)
    pond.choose("dob")
    pond.step()
    trial = pond.trial()
    assert trial.value("flow.known") is False and trial.value("controller") == "dob" and trial.value("excitation") == "live"
    assert any("drift, dob" in note for note in trial.value("notes"))


def test_a_policy_leaves_its_actions_and_its_sum(body):
    pond = LiveSession("paper", engine=body)
    pond.step()
    pond.step()
    trial = pond.trial()
    assert stacked(trial.tables["action"], "a#").shape == (2, 3) and np.abs(stacked(trial.tables["action"], "a#")).max() <= 1
    assert len(trial.value("policy_sha256")) == 64


# ----------------------------------------------------------------------------------------------------------------- --save
def test_a_folder_that_is_no_trial_is_refused_before_the_swim(tmp_path, monkeypatch, capsys):
    (tmp_path / "home").mkdir()
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(play, "LiveSession", lambda *a: pytest.fail("it swims"))
    for place, said in (("home", "is there already"), ("file", "is a file"), ("file/x", "nothing can be written below it")):
        assert console.run(play.main, ["--save", str(tmp_path / place), "--headless-seconds", "1"]) == console.BAD_INPUT
        error = capsys.readouterr().err
        assert said in error and len(error.splitlines()) == 1


# --------------------------------------------------------------------------------------------------------------- evaluate
@pytest.fixture(scope="module")
def result(body):
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 45], repeats=1, duration=4)
    return evaluate.run("paper", ROBOT, trials, body)


def test_a_judged_trial_is_complete(result, tmp_path):
    write_logs(result, tmp_path)
    assert admission.insufficient_data(readable_trials(tmp_path), load_robot("fish")) is None, (
        "gap find takes the folder as it is"
    )
    for trial in log.read_dataset(tmp_path):
        assert set(trial.tables) == TABLES | {"action"} and missing(trial) <= UNTOLD
        assert trial.value("sigma.x") == 0.005 and trial.value("timing") == {"control_dt": 0.2, "command_path": "linear"}
        record = record_of(trial, 0.004)
        assert record.joint is not None and record.pose is not None and record.placed is not None
        late = trial.value("latency.pose")
        off = trial.tables["pose"]["x"] - np.interp(
            trial.tables["pose"]["t"] - late, *(trial.tables["truth"][c] for c in ("t", "x"))
        )
        assert 0.003 < np.std(off[10:]) < 0.007 and 0.03 <= late <= 0.11


def test_every_fish_has_its_own_latency_and_the_same_log_twice(result):
    one, two = trial_of(result, 0), trial_of(result, 1)
    _, camera = result.trials.fish(ROBOT)
    assert [t.value("latency.pose") for t in (one, two)] == pytest.approx(list(camera * 0.02))
    again = trial_of(result, 0)
    assert np.array_equal(one.tables["pose"]["x"], again.tables["pose"]["x"])


def test_a_tank_that_stopped_is_logged_up_to_there(result):
    stop = 120
    held = {name: np.array(getattr(result, name)) for name in ("pose", "joint", "velocity", "rate")}
    for name, values in held.items():
        values[0, stop:] = values[0, stop] if name in ("pose", "joint") else 0.0
    left = np.array([stop + 1, len(result.t)])
    tank = result._replace(engine="tanks, window, slip 1", left=left, **held)
    short, whole = trial_of(tank, 0), trial_of(tank, 1)
    assert {len(short.tables[n]["t"]) for n in ("cmd", "joint", "pose", "truth", "power", "flow")} == {stop}
    assert len(short.tables["obs"]["t"]) == stop // 10 and "stopped after 2.40 s" in short.value("notes")
    assert len(whole.tables["truth"]["t"]) == 200 and whole.value("water") == "lbm"


# ------------------------------------------------------------------------------------------------- one fish, the solver
def test_a_sim_says_where_it_began_and_that_it_is_exact():
    trial = Sim("fish", pose=(0.1, 0.2, 0.3), flow=Flow(speed=0.1)).run(lambda t: 0.4 * np.sin(6 * t - np.arange(3)), 0.5)
    assert trial.value("start") == [0.1, 0.2, 0.3] and trial.value("latency.pose") == 0.0
    assert {key: trial.value(key) for key in identity(ROBOT)} == identity(ROBOT) and trial.value("joints") == 3
    assert "exact" in trial.value("notes") and record_of(trial, 0.004).power is not None


def test_a_run_of_the_flow_solver_says_the_flow_and_where_it_began():
    wp = pytest.importorskip("warp")
    wp.config.quiet = True
    from fishmj.lbm_oracle.cases.coupled_fish import pond
    from fishmj.lbm_oracle.run.run import Run

    run = Run(pond("cpu"))
    for _ in range(3):
        run.tick(np.zeros(3))
    trial = run.trial()
    assert {"cmd", "joint", "pose", "power", "truth", "flow", "wrench"} == set(trial.tables)
    assert stacked(trial.tables["flow"], "u#x").shape == (3, 4) and len(trial.value("start")) == 3
    assert trial.value("latency.command") == pytest.approx(ROBOT.timing.command_latency)
    assert record_of(trial, 0.004).pose is not None


def test_link_centres_are_where_mujoco_has_them():
    sim = Sim("fish", pose=(0.3, -0.2, 0.4))
    sim.run(lambda t: 0.4 * np.sin(6 * t - np.arange(3)), 0.4)
    q = np.concatenate([sim.pose[:3], sim.data.qpos[-3:]])
    assert np.allclose(link_centres(ROBOT, q[None])[0], sim.links()[:, :2], atol=1e-9)


def test_the_sum_of_a_robot_changes_with_any_number_of_it():
    same = load_robot("fish")
    heavier = replace(same, links=(replace(same.links[0], mass=same.links[0].mass + 1e-9), *same.links[1:]))
    quicker = replace(same, timing=replace(same.timing, camera_latency=0.066))
    assert len({robot_sha256(one) for one in (ROBOT, same, heavier, quicker)}) == 3
    assert sigmas(2, 0.0) == dict.fromkeys(("x", "y", "yaw", "j1", "j2", "w1", "w2"), 0.0)


def test_logs_of_another_body_under_the_same_name_need_a_word():
    longer = replace(ROBOT, links=(*ROBOT.links[:-1], replace(ROBOT.links[-1], length=2 * ROBOT.links[-1].length)))
    stiffer = replace(ROBOT, servo=replace(ROBOT.servo, kp=1.3 * ROBOT.servo.kp))
    alike, other = (Trial(identity(one), {}, name="a") for one in (stiffer, longer))
    assert admission.of_this_robot([alike], ROBOT, "fish") == [] == admission.of_this_robot([other], longer, "mine")
    with pytest.raises(LogError, match=r"'swift' with another body \(lengths, sections, fins\), the model fish is 'swift'"):
        admission.of_this_robot([alike, other], ROBOT, "fish")
    assert "taken for the same robot" in admission.of_this_robot([other], ROBOT, "fish", agreed=True)[0]
    assert body_sha256(engines.in_water(longer, "structured")) == body_sha256(longer)
