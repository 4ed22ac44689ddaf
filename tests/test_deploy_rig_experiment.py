"""Experiments on a rig: what is played through the host becomes a data set that calibration and search read as it is."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.loop import open_loop_experiment, wiring
from fishmj.deploy.loop.supervisor import Condition
from fishmj.deploy.loop.swim_loop import Rig
from fishmj.deploy.loopback import faults
from fishmj.deploy.loopback.lockstep import LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, make_robot
from fishmj.deploy.rig import rig_experiment, rig_prompt
from fishmj.deploy.rig.rig_prompt import Person
from fishmj.gap.__main__ import main as gap
from fishmj.gap.calibrate.__main__ import main as calibrate
from fishmj.log import excitation, read_trial, write_dataset
from fishmj.log.dataset import take
from fishmj.mjcf.reading import load_robot
from tests.deploying import FakeClock, FakeEyes, FakeRobot

ROOT = Path(__file__).resolve().parent.parent


def lockstep_rig(start=(0.0, 0.0, 0.0), seed=3, **settings):
    robot = load_robot("fish")
    fish = make_robot(LoopbackSettings(seed=seed, start=start, **settings))
    clock = LockstepClock(fish)
    link = Fishmj1Link(LockstepTransport(clock))
    localiser = InStep(LockstepCamera(clock), PoseTracker(seed=seed))
    localiser.open()
    return Rig.of(wiring.Wired(link, localiser, clock, False), robot, None, said=False, ask=pytest.fail)


def played(tmp_path, names, repeats=1, **settings):
    trials = {}
    for run in open_loop_experiment.runs(names, repeats, 3):
        rig = lockstep_rig(run.what.start, **settings)
        meta = open_loop_experiment.meta_of(rig.robot, (0.0, 0.0), True)
        outcome, trial = open_loop_experiment.play(rig, run, tmp_path / "host" / run.name, meta)
        assert outcome.complete, outcome.words
        trials[run.name] = trial
    write_dataset(tmp_path / "trials", trials)
    return tmp_path / "trials"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return played(tmp_path_factory.mktemp("bench"), ["square", "impulse"])


def test_the_commands_of_the_experiment_are_those_of_the_trial(bench):
    trial = read_trial(bench / "square_1")
    what = excitation.get("square")
    cmd = trial.tables["cmd"]
    assert abs(len(cmd["t"]) - len(what.t)) <= 1
    n = min(len(cmd["t"]), len(what.t))
    sent = np.stack([cmd[f"c{k + 1}"] for k in range(3)], 1)[:n]
    wanted = np.stack([cmd.get(f"asked{k + 1}", cmd[f"c{k + 1}"]) for k in range(3)], 1)[:n]
    np.testing.assert_allclose(wanted, what.commands[:n], atol=2e-4)
    # a step goes no faster than the servo turns: the limits act, and what really left is what stands in c
    assert np.max(np.abs(sent - what.commands[:n])) < np.radians(40)


def test_a_data_set_of_the_rig_lacks_no_key_and_no_unit(bench):
    taken = take(bench)
    assert not taken.broken and not taken.notes
    for trial in taken.trials.values():
        assert not [note for note in trial.notes if "missing" in note], trial.notes
        assert trial.tables["joint"]["t"][0] >= 0.0 and trial.value("medium") == "water"
        assert 5e-4 < trial.value("sigma.j1") < 0.02 and 5e-5 < trial.value("sigma.x") < 0.02


def test_calibration_and_search_read_it(bench):
    from fishmj.gap.calibrate.calibration_logs import read
    from fishmj.gap.records.records import record_of

    logs = read(bench)
    assert logs.bench() and not logs.broken and not logs.notes
    record = record_of(logs.trials["square_1"], 0.004)
    assert record.joint is not None and record.pose is not None and record.power is not None
    assert np.linalg.norm(record.start[:2]) < 0.05 and not record.push.any()


def test_repeats_come_one_round_after_the_other_and_name_their_first():
    order = [(run.name, run.first) for run in open_loop_experiment.runs(["calibrate"], 2, 3)]
    assert order[:4] == [("sine_1", ""), ("square_1", ""), ("impulse_1", ""), ("sine_2", "sine_1")]


def test_an_experiment_that_needs_a_carriage_or_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="tow_ahead: needs a tow carriage"):
        open_loop_experiment.runs(["tow_ahead", "gait"], 3, 3)
    with pytest.raises(UnknownName):
        open_loop_experiment.runs(["gate"], 3, 3)


def test_a_swim_that_does_not_end_by_itself_gives_no_trial(tmp_path):
    (run,) = open_loop_experiment.runs(["idle"], 1, 3)
    rig = lockstep_rig()
    begun = rig.clock.now()
    stop = lambda: rig.clock.now() > begun + 2.0
    outcome, trial = open_loop_experiment.play(
        rig, run, tmp_path / "a", open_loop_experiment.meta_of(rig.robot, None, True), stop=stop
    )
    assert trial is None and "OPERATOR_STOP" in outcome.words
    assert (tmp_path / "a" / "meta.toml").is_file()  # the host's log stays


@pytest.mark.parametrize("name", ["chirp", "steps"])
def test_a_jammed_joint_ends_an_experiment_and_a_healthy_one_does_not(tmp_path, name):
    (run,) = open_loop_experiment.runs([name], 1, 3)
    ends = []
    for bad in ((), faults.parse(["stuck_servo=2@0"])):
        rig = lockstep_rig(run.what.start, faults=bad)
        meta = open_loop_experiment.meta_of(rig.robot, None, True)
        ends.append(open_loop_experiment.play(rig, run, tmp_path / f"{len(ends)}", meta)[0])
    assert ends[0].complete
    assert ends[1].cause & Condition.SERVO_STUCK and ends[1].swim_seconds < 0.7 * run.what.seconds


def test_a_run_ends_before_the_wall_that_was_named(tmp_path):
    (run,) = open_loop_experiment.runs(["chirp"], 1, 3)
    rig = lockstep_rig()
    outcome, trial = open_loop_experiment.play(
        rig, run, tmp_path / "a", open_loop_experiment.meta_of(rig.robot, None, True), bound=0.1
    )
    assert trial is None and outcome.cause & Condition.LEFT_TANK
    assert np.abs(read_trial(tmp_path / "a").tables["pose"]["x"]).max() < 0.3


class Tank:
    """A robot without a watchdog, a person who presses Enter, and what was done, in order."""

    def __init__(self, monkeypatch, answers="y", entered=20):
        self.clock, self.done, self.released, self.trial = FakeClock(), [], None, None
        robot, eyes = FakeRobot(self.clock), FakeEyes(self.clock)
        robot.watched = False
        wired = wiring.Wired(robot, eyes, self.clock, False)
        monkeypatch.setattr(rig_prompt.sys, "stdin", io.StringIO("\n" * entered))
        monkeypatch.setattr(wiring, "wire", lambda *_: wired)
        monkeypatch.setattr(console, "confirmed", lambda _: self.done.append("asked") or answers == "y")
        monkeypatch.setattr(rig_experiment, "play", self.play)

    def play(self, rig, run, *args, **options):
        self.done.append((run.name, self.clock.now()))
        return SimpleNamespace(words="ended", released=self.released), self.trial


def session(out):
    return rig_experiment.main(["idle", "--repeats", "3", "--link", "serial:/dev/none", "--out", str(out)])


def test_a_person_has_three_seconds_to_take_the_hands_out(tmp_path, monkeypatch, capsys):
    tank = Tank(monkeypatch)
    session(tmp_path / "a")
    assert [entry for entry in tank.done if entry != "asked"] == [("idle_1", 103.0), ("idle_2", 106.0), ("idle_3", 109.0)]
    assert capsys.readouterr().out.count("hands off: 3\nhands off: 2\nhands off: 1\n") == 3


def test_who_stands_at_the_tank_is_asked_once_a_session(tmp_path, monkeypatch):
    tank = Tank(monkeypatch)
    session(tmp_path / "a")
    assert tank.done.count("asked") == 1


@pytest.mark.parametrize(("released", "code"), [(True, console.OK), (None, console.OK), (False, console.FAILED_CHECK)])
def test_torque_that_is_not_confirmed_off_is_told_by_the_exit_code(bench, tmp_path, monkeypatch, capsys, released, code):
    """None: a robot that cannot say, which the line of every run says."""
    tank = Tank(monkeypatch)
    tank.released, tank.trial = released, read_trial(bench / "square_1")
    words = ["idle", "--repeats", "1", "--link", "serial:/dev/none", "--json", "--out", str(tmp_path / "a")]
    assert rig_experiment.main(words) == code
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["torque_not_off"] == (["idle_1"] if released is False else []) and told["trials"] == ["idle_1"]


def test_where_nobody_stands_at_the_tank_the_session_ends_at_once(tmp_path, monkeypatch):
    tank = Tank(monkeypatch, answers="n")
    with pytest.raises(ConfigError, match="no watchdog; add --i-am-at-the-tank"):
        session(tmp_path / "a")
    assert tank.done == ["asked"]


def test_what_to_do_next_has_only_options_that_are_there(bench, capsys):
    swims = dict.fromkeys("ab", SimpleNamespace(span=(0.0, 1.0), value=lambda _: "gait"))
    servo = {"a": read_trial(bench / "square_1")}
    assert "--repeats 2 or a session" in rig_experiment.collect(bench.parent, {"a": swims["a"]}, "fish")[1]
    said = [rig_experiment.collect(bench.parent, done, "fish")[1] for done in (swims, servo)]
    lines = [line for line in [*said, *rig_experiment.EXAMPLES.splitlines()] if "gap find" in line or "calibrate servo" in line]
    helps = {}
    for name, main in (("gap find", gap), ("calibrate servo", calibrate)):
        with pytest.raises(SystemExit):
            main([name.split()[1], "--help"])
        helps[name] = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert len(lines) == 4
    for line in lines:
        (verb,) = [name for name in helps if name in line]
        assert set(re.findall(r"--[a-z-]+", line)) <= helps[verb], line


def test_noise_at_rest_is_that_of_the_channel():
    rng = np.random.default_rng(0)
    t = np.arange(0, 5, 0.001)
    tables = {"pose": {"t": t, "x": 0.01 * t + 0.003 * rng.standard_normal(len(t)), "y": t * 0, "yaw": t * 0}}
    counts = np.round((0.001 * rng.standard_normal(len(t)) + np.where(t > 1, 0.3, 0.0)) / 0.0042) * 0.0042
    found = open_loop_experiment.noise_at_rest({**tables, "joint": {"t": t, "j1": counts}})
    assert found["x"] == pytest.approx(0.003, rel=0.1) and "y" not in found
    assert found["j1"] == pytest.approx(0.0042 / np.sqrt(12), rel=0.05)


def test_without_a_robot_in_loopback_nobody_says_yes_for_the_person(tmp_path):
    with pytest.raises(ConfigError, match="--yes is for --link loopback"):
        rig_experiment.main(["idle", "--yes", "--link", "udp://127.0.0.1:1", "--out", str(tmp_path / "a")])


def test_a_person_is_asked_until_the_number_makes_sense(capsys):
    person = Person(io.StringIO("ten\n4000\n1,5\n\nq\n"))
    assert person.number("mass, kg", 0.01, 10) == 1.5
    assert person.number("mass, kg", 0.01, 10, empty=True) is None
    with pytest.raises(ConfigError, match="stopped by the person"):
        person.ready("next")
    with pytest.raises(ConfigError, match="nobody answers"):
        person.ready("next")
    assert "is no number" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_experiment_that_is_ended_by_a_signal_brings_the_robot_to_rest(tmp_path, number):
    words = [sys.executable, "-m", "fishmj.deploy", "experiment", "gait", "--repeats", "2", "--yes", "--wait", "60"]
    words += ["--out", str(tmp_path / "data")]
    raw = tmp_path / "data" / "host" / "gait_1"
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        end = time.monotonic() + 600
        said = lambda: (raw / "meta.toml").read_text(encoding="utf-8") if (raw / "meta.toml").exists() else ""
        while "SWIMMING" not in said() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)  # the first rows reach the disk while it swims
        os.kill(process.pid, number)
        out, err = process.communicate(timeout=600)
    assert process.returncode == (143 if number == signal.SIGTERM else 130), err
    events = " ".join(read_trial(raw).meta["host"]["events"])
    assert "SWIMMING -> NEUTRAL: OPERATOR_STOP" in events, (events, err)
    assert "go on with: fishmj deploy experiment gait" in out + err
    assert not (tmp_path / "data" / "host" / "gait_2").exists()
