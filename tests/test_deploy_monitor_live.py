"""The monitor beside a swim: rows go to another process, alarms come back as one line and into the log, and the swim goes on."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.commands import swim_command
from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.loop import arming
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loopback.lockstep import LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, make_robot
from fishmj.deploy.monitor import process
from fishmj.deploy.monitor.live import LiveMonitor, MonitorProcess, Watched, watched_of
from fishmj.deploy.monitor.monitor import Alarm
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.log import Trial, read_trial, write_trial
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow
from studies.monitor.swims import swim
from tests.deploying import Bench

FLOW = (0.15, np.pi)
ALARM = {"t": 1.25, "channel": "j2", "probe": "rate", "sign": -1, "share": {"j2": 1.01}}
SCRIPT = """
import json, sys
wanted = json.loads(sys.stdin.readline())
print(json.dumps({"watching": ["j1", "j2"], "t": 0.5}), flush=True)
rows = {}
for line in sys.stdin:
    if "over" in json.loads(line):
        break
    for name, table in json.loads(line).items():
        rows[name] = rows.get(name, 0) + len(table["t"])
print(json.dumps({"alarm": ALARM}), flush=True)
print(json.dumps({"end": {"watched_s": 2.0, "rows": rows, "model": wanted["model"]}}), flush=True)
"""


def beside(tmp_path, script, **options):
    """A swim of the fakes with this process in the place of the monitor's: (monitor, trial, lines that were said)."""
    bench, said, made = Bench(tmp_path / "swim", seconds=2.0), [], []
    process = (
        script
        if isinstance(script, MonitorProcess)
        else MonitorProcess((sys.executable, "-c", script.replace("ALARM", repr(ALARM))))
    )
    options["process"] = process
    bench.at(0.0, lambda: made.append(LiveMonitor(Watched(model="fish"), bench.log, say=said.append, **options)))
    bench.at(0.0, lambda: made[0].__enter__())
    with TrialLog(bench.folder, {"origin": "synthetic", "robot": "fish"}, 3, every=1e6) as log:
        bench.log = log
        bench.made = SwimLoop(bench.rig, bench.pilot, bench.plan, log, stop=bench._stop)
        outcome = bench.made.run()
        made[0].__exit__(None, None, None)
    assert outcome.complete
    return made[0], read_trial(bench.folder), said


def test_monitor_process_receives_rows_and_its_alarm_is_printed_and_logged(tmp_path):
    monitor, trial, said = beside(tmp_path, SCRIPT)
    assert [Alarm(**ALARM)] == monitor.alarms and not monitor.failed
    assert said == ["robot and model part at t = 1.2 s in j2 (rate -); fishmj gap find LOGS names the cause"]
    told = trial.meta["monitor"]
    assert told["alarms"] == [{"t": 1.25, "channel": "j2", "probe": "rate", "sign": -1}] and told["watched_s"] == 2.0
    assert told["learnt_from"] == "the first 300 s" and told["model"] == "fish"
    rows = told["rows"]
    assert 95 <= rows["cmd"] <= 101 and 95 <= rows["joint"] <= 101 and rows["pose"] >= 95 and rows["power"] == rows["joint"]
    assert any("monitor: j2, rate -" in event for event in trial.meta["host"]["events"])


def test_a_monitor_that_dies_is_said_once_and_ends_no_swim(tmp_path):
    monitor, trial, said = beside(tmp_path, "raise SystemExit(3)")
    assert monitor.failed == "its process ended" == trial.meta["monitor"]["failed"]
    assert said == ["monitor: its process ended; nothing is watched any more, the swim goes on"]


def test_after_a_stop_nobody_waits_for_a_monitor_that_is_behind(tmp_path):
    slow = "import json, time; time.sleep(3); print(json.dumps({'end': {'watched_s': 1.0}}))"
    assert "was not waited for" in beside(tmp_path / "a", slow, stopped=lambda: True)[0].failed
    assert beside(tmp_path / "b", slow)[1].meta["monitor"]["watched_s"] == 1.0


def test_one_process_watches_swim_after_swim_until_it_is_closed(tmp_path):
    """Lines of one swim never reach the next one, and a process that died is replaced."""
    each = """
import json, os, sys
for line in sys.stdin:
    if "over" in json.loads(line):
        print(json.dumps({"end": {"watched_s": 1.0, "process": os.getpid()}}), flush=True)
"""
    with MonitorProcess((sys.executable, "-c", each)) as process:
        first, second = (beside(tmp_path / name, process)[1].meta["monitor"]["process"] for name in ("a", "b"))
        assert first == second
        process.close()
        assert beside(tmp_path / "c", process)[1].meta["monitor"]["process"] != first
    assert process._process is None


def test_what_was_learnt_from_healthy_swims_is_kept_for_the_next_swim(tmp_path, monkeypatch):
    learnt = []
    monkeypatch.setattr(process, "reference_of", lambda *given: learnt.append(given) or "reference")
    for _ in range(3):
        assert process._learnt("fish", (), True, False) == "reference"
    assert len(learnt) == 1 and process._learnt("fish", (), True, True) and len(learnt) == 2


def watching(tables, wanted, size=50):
    """What `process.watch` tells of these tables, delivered in pieces of `size` ticks of 20 ms."""
    told, end = [], max(table["t"][-1] for table in tables.values())
    edges = np.arange(0.0, end + 1.0, 0.02 * size)
    inside = lambda t, low: {c: v[(t["t"] >= low) & (t["t"] < low + 0.02 * size)].tolist() for c, v in t.items()}
    pieces = [{name: inside(table, low) for name, table in tables.items()} for low in edges]
    pieces = [{name: rows for name, rows in piece.items() if rows["t"]} for piece in pieces]
    process.watch(wanted, (piece for piece in pieces if piece), told.append)
    return told


@pytest.mark.slow
def test_monitor_process_detects_a_weak_servo_against_a_healthy_swim(tmp_path):
    healthy = {n: t for n, t in swim(7, 1, 90.0, speed=FLOW[0]).items() if n != "truth"}
    struck = {
        n: t for n, t in swim(7, 2, 46.0, {"torque_saturation": {"limit": 0.7}}, at=18.0, speed=FLOW[0]).items() if n != "truth"
    }
    write_trial(
        tmp_path / "well",
        Trial({"origin": "synthetic", "robot": "fish", "flow": {"speed": FLOW[0], "direction": FLOW[1]}}, healthy),
    )
    late = load_robot("fish").timing.camera_latency
    struck["pose"]["t"] = struck["pose"]["t"] - late  # rows come with the time when the picture was taken
    wanted = {"model": "fish", "flow": list(FLOW), "rate": 0.1, "settle": 300.0, "healthy": [str(tmp_path / "well")]}
    blind = {name: table for name, table in struck.items() if name != "power"}
    told = watching(blind, wanted)
    assert told[0]["watching"] == ["surge", "sway", "yaw_rate", "j1", "j2", "j3"]  # no meter, no channel of it
    alarms = [entry["alarm"] for entry in told if "alarm" in entry]
    assert alarms and 18.0 < alarms[0]["t"] < 46.0 and alarms[0]["channel"] in ("j1", "j2", "j3")
    assert told[-1]["end"]["watched_s"] > 30.0 and max(told[-1]["end"]["highest"].values()) >= 1.0


def test_a_process_that_cannot_watch_says_why_in_its_last_line(tmp_path):
    wanted = json.dumps({"model": "no-such-fish", "flow": [0, 0], "rate": 0.1, "settle": 300.0, "healthy": []})
    done = subprocess.run([sys.executable, "-m", "fishmj.deploy.monitor.process"], input=wanted, capture_output=True, text=True)
    assert done.returncode == console.BAD_INPUT and "no-such-fish" in json.loads(done.stdout.splitlines()[-1])["failed"]


def options(*words):
    return swim_command.options().parse_args(["--policy", "station", *words])


def test_what_a_monitor_cannot_do_is_said_before_the_swim(tmp_path, capsys):
    robot = load_robot("fish")
    assert watched_of(options(), robot, None, 30.0) is None
    found = watched_of(options("--monitor", "fish", "--alarm-rate", "0.5"), robot, (0.2, 3.1), 30.0)
    assert found == Watched(model="fish", flow=(0.2, 3.1), rate=0.5)
    assert "30 s are not watched; give --healthy" in capsys.readouterr().err
    watched_of(options("--monitor", "fish"), robot, None, 600.0)
    assert "still water is taken; give --flow" in capsys.readouterr().err
    for words, match in (
        (("--healthy", str(tmp_path)), "is for --monitor MODEL"),
        (("--monitor", "fish", "--healthy", str(tmp_path)), "no trial folder"),
        (("--monitor", "no-such"), "no-such"),
    ):
        with pytest.raises((ConfigError, KeyError), match=match):
            watched_of(options(*words), robot, None, 30.0)


class Struck(LockstepClock):
    """A lockstep clock whose robot loses torque at `at` s."""

    at, struck = 20.0, False

    def sleep_until(self, t: float) -> None:
        super().sleep_until(t)
        body = self.robot.body
        if self.robot.time > self.at and not self.struck:
            self.struck = True
            body.change(plant({"torque_saturation": {"limit": 0.7}}, 7, nuisance=0.1, robot=body.robot, flow=FLOW))


def in_lockstep(folder: Path, seconds: float, clock_of, watched=None):
    """A swim of loopback robot 7 through the host: (alarms, trial)."""
    fish = make_robot(LoopbackSettings(seed=7, flow=Flow(speed=FLOW[0], direction=FLOW[1]), start=(0.4, 0.2, 0.0)))
    clock, described = clock_of(fish), load_robot("fish")
    link, controller = Fishmj1Link(LockstepTransport(clock)), LearnedController(described, "station")
    rig = Rig(
        robot=described, link=link, localiser=InStep(LockstepCamera(clock), PoseTracker(seed=1)), clock=clock,
        examine=lambda info: arming.examine(link, info, described, controller, False),
    )  # fmt: skip
    rig.localiser.open()
    meta = {"origin": "synthetic", "robot": "fish", "flow": {"speed": FLOW[0], "direction": FLOW[1], "known": True}}
    alarms = []
    with TrialLog(folder, meta, 3, every=1e6) as log:
        monitor = LiveMonitor(watched, log, say=alarms.append) if watched else None
        if monitor:
            monitor.__enter__()
        outcome = SwimLoop(rig, PolicyPilot(controller), SwimPlan(seconds=seconds), log).run()
        if monitor:
            monitor.__exit__(None, None, None)
            assert not monitor.failed
    assert outcome.complete, outcome.words
    return alarms, read_trial(folder)


@pytest.mark.slow
def test_live_monitor_alarms_on_a_torque_fault_and_not_on_a_healthy_swim(tmp_path):
    """The whole chain: loopback robot, radio, supervisor, log, the other process; learnt from a swim of the same robot."""
    in_lockstep(tmp_path / "well", 90.0, LockstepClock)
    watched = Watched(model="fish", flow=FLOW, healthy=(tmp_path / "well",))
    said, trial = in_lockstep(tmp_path / "again", 30.0, LockstepClock, watched)
    assert said == [] and trial.meta["monitor"]["alarms"] == [] and trial.meta["monitor"]["watched_s"] > 15.0
    said, trial = in_lockstep(tmp_path / "weak", 50.0, Struck, watched)
    (first, *_) = trial.meta["monitor"]["alarms"]
    assert 20.0 < first["t"] < 50.0 and said[0].endswith("fishmj gap find LOGS names the cause")
