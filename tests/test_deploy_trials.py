"""The 72 trials on a robot: their order, a session that goes on, what counts as a trial, and the tables that evaluate writes."""

import csv
import io
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError, StoreError, UsageError
from fishmj.deploy import __main__ as deploy
from fishmj.deploy.commands import trials_command
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.supervisor import NONE, Condition, SwimState
from fishmj.deploy.loop.swim_loop import SwimOutcome
from fishmj.deploy.rig import rig_prompt
from fishmj.deploy.trials import trials_tables
from fishmj.deploy.trials.schedule import Session, counts, cut, order, stream_direction, waters_of
from fishmj.evaluate import metrics, protocol, trial_report
from fishmj.evaluate.trial_report import trials_csv
from fishmj.log import Trial, read_trial, write_trial
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow_map.flow_map import FlowMap
from tests.deploying import FakeClock, FakeEyes, FakeRobot
from tests.test_deploy_flow_map import MAP

ROOT = Path(__file__).resolve().parent.parent
ROBOT = load_robot("fish")
SWUM = SwimOutcome(cause=Condition.FINISHED, refused=(), swim_seconds=60.0, figures={}, released=True)


# ------------------------------------------------------------------------------------------------------------------- plan
def test_the_order_changes_the_pump_twice_and_comes_round_by_round():
    trials = protocol.trials()
    places = order(trials)
    speeds = [place.spec.speed for place in places]
    assert len({place.name for place in places}) == 72 and sum(a != b for a, b in zip(speeds, speeds[1:], strict=False)) == 2
    first = [place.name for place in places[:9]]
    assert first[:2] == ["u0.1_los000_r0", "u0.1_los045_r0"] and first[8] == "u0.1_los000_r1"
    start, target = trials.ends()
    for place in places:
        assert trials.items[place.number] == place.spec
        np.testing.assert_allclose(place.start[:2], start[place.number, :2])
        np.testing.assert_allclose(place.target, target[place.number])
    ahead = places[0]
    np.testing.assert_allclose([*ahead.start[:2], *ahead.target, abs(ahead.start[2])], [0.7, 0, -0.7, 0, np.pi], atol=1e-12)


def test_the_pump_and_the_direction_come_from_the_flow_map():
    waters = waters_of(MAP, [0.2, 0.1, 0.1])
    assert {speed: water.pump for speed, water in waters.items()} == pytest.approx({0.1: 20.0, 0.2: 30.0})
    assert waters_of(None, [0.2]) == {} and stream_direction({}) == 0.0
    turned = FlowMap(tuple(s._replace(direction=d) for s, d in zip(MAP.settings, (3.0, -3.1, 3.1), strict=True)))
    assert stream_direction(waters_of(turned, [0.1, 0.2])) == pytest.approx(np.pi - 0.05, abs=0.01)
    with pytest.raises(ConfigError, match="is outside the measured"):
        waters_of(MAP, [0.05])


def test_what_ends_a_swim_decides_whether_it_is_a_trial():
    made = lambda **change: SwimOutcome(**{**vars(SWUM), **change})
    assert counts(SWUM) and counts(made(cause=Condition.LEFT_TANK, swim_seconds=12.0))
    assert not counts(made(cause=Condition.LINK_SILENT, swim_seconds=12.0)) and not counts(
        made(cause=NONE, refused=("no",), swim_seconds=0.0)
    )


# ------------------------------------------------------------------------------------------------------------------- logs
def log_of(place, *, seconds=62.0, power=True, zero=3.25, drift=0.0, left=None):
    """A host's log in which the fish goes straight to its target at 0.1 m/s and stays, from `zero` s on."""
    t = np.arange(0.0, zero + (left or seconds), 0.02)
    way = np.clip(0.1 * (t - zero), 0.0, 1.4) / 1.4
    (x, y, yaw), (there_x, there_y) = place.start, place.target
    path = {"x": x + way * (there_x - x) + drift * np.clip(t - zero, 0, None), "y": y + way * (there_y - y)}
    pose = {"t": t + 0.06, **path, "yaw": np.full(len(t), yaw), "quality": np.ones(len(t)), "t_taken": t, "t_rx": t + 0.06}
    state = np.where(t < zero, int(SwimState.ARMED), int(SwimState.SWIMMING)).astype(float)
    zeros = lambda letter, n: {f"{letter}{k + 1}": np.zeros(len(t)) for k in range(n)}
    tables = {
        "cmd": {"t": t, **zeros("c", 3), **zeros("asked", 3), "seq": np.arange(len(t)) * 1.0, "state": state},
        "joint": {"t": t, **zeros("j", 3)},
        "pose": pose,
        "obs": {"t": t[::10], **{f"o{k + 1}": np.full(len(t[::10]), k + 0.5) for k in range(11)}},
        "target": {"t": np.array([0.5]), "x": np.array([there_x]), "y": np.array([there_y])},
    }
    if power:
        tables["power"] = {"t": t, "V": np.full(len(t), 7.5), "I": np.full(len(t), 0.4)}
    meta = {"origin": "synthetic", "robot": "fish", "latency": {"pose": 0.06}, "clock": dict.fromkeys(tables, "host")}
    return Trial(meta, tables, name=place.name)


def judged(trials, logs, **options):
    places = order(trials)
    taken = {name: cut(log, name, trials.duration) for name, log in logs.items()}
    waters = waters_of(MAP, trials.speed.tolist())
    return trials_tables.result_of(
        "station, robot", "", ROBOT, trials_tables.measured_trials(trials, waters), places, taken, trials_tables.TANK, **options
    )


def test_a_log_is_cut_to_where_the_policy_steered_with_its_clocks():
    place = order(protocol.trials())[0]
    taken = cut(log_of(place), place.name, 60.0)
    cmd, pose = taken.tables["cmd"], taken.tables["pose"]
    assert cmd["t"][0] == pytest.approx(0.0, abs=0.021) and cmd["t"][-1] <= 60.5 and (cmd["state"] == SwimState.SWIMMING).all()
    assert pose["t"][0] < -0.9 and pose["t"][-1] == pytest.approx(60.5, abs=0.03)
    np.testing.assert_allclose(pose["t"] - pose["t_taken"], 0.06)
    assert taken.tables["target"]["t"].tolist() == [0.0] and taken.meta["swum_s"] == pytest.approx(60.0)
    idle = log_of(place)
    idle.tables["cmd"]["state"][:] = int(SwimState.ARMED)
    with pytest.raises(ConfigError, match="no command of the policy"):
        cut(idle, place.name, 60.0)


def test_figures_of_a_straight_way_are_those_that_geometry_gives():
    trials = protocol.trials(speeds=[0.1, 0.2], los_deg=[0, 90], repeats=1)
    places = order(trials)
    result = judged(trials, {place.name: log_of(place) for place in places})
    found = metrics.figures(result)
    np.testing.assert_allclose(found["arrival"], 1.0)
    np.testing.assert_allclose(found["approach_time"], 13.0, atol=0.05)  # 1.3 m at 0.1 m/s
    assert found["rmse_last20"].max() < 1e-6 and found["rmse_after_arrival"].max() < 0.05
    np.testing.assert_allclose(found["power"], 3.0, rtol=1e-6)
    np.testing.assert_allclose(found["rheotactic_index"], 1.0)
    # through the water: at its place against 0.1 m/s for 46 s of the 60, and on its way upstream at 0.2 m/s for 14 s
    ahead = next(k for k, t in enumerate(result.trials.items) if (t.speed, t.los) == (0.1, 0.0))
    assert found["energy_per_metre"][ahead] == pytest.approx(3.0 * 60 / (0.2 * 14 + 0.1 * 46), rel=0.01)
    assert [f.intensity for f in result.trials.flows()] == pytest.approx([0.08, 0.08, 0.06, 0.06])


def test_what_a_robot_cannot_measure_is_missing_and_never_zero():
    trials = protocol.trials(speeds=[0.1], los_deg=[0, 90, 180], repeats=1)
    places = order(trials)
    logs = {place.name: log_of(place, power=k > 0) for k, place in enumerate(places[:2])}
    result = judged(trials, logs)
    found = metrics.figures(result)
    assert np.isnan(found["power"]).tolist() == [True, False] == np.isnan(found["energy_per_metre"]).tolist()
    summed = metrics.summary(result)["overall"]
    assert summed["power"]["n"] == 1 and summed["power"]["value"] == pytest.approx(3.0)
    rows = list(csv.DictReader(io.StringIO(trials_csv([result]))))
    assert [row["power"] for row in rows] == ["", "3"] and {row["flow_seed"] for row in rows} == {""}
    told = "; ".join(trials_tables.lacking(result, logs, len(places)))
    assert "not the true one" in told and "no power in 1 of 2 trials" in told and "1 of 3 trials were not swum" in told
    dark = judged(trials, {place.name: log_of(place, power=False) for place in places})
    assert metrics.summary(dark)["overall"]["power"]["n"] == 0 and dark.trials.turbulence_said == "measured turbulence 8 %"
    paused = log_of(places[0])
    paused.tables["power"] = {c: v[: len(v) // 2] for c, v in paused.tables["power"].items()}
    assert np.isnan(metrics.figures(judged(trials, {places[0].name: paused}))["power"]).all()
    with pytest.raises(LogError, match="no poses"):
        judged(trials, {places[0].name: Trial({}, {k: v for k, v in log_of(places[0]).tables.items() if k != "pose"}, "x")})
    with pytest.raises(ConfigError, match="none is accepted yet"):
        judged(trials, {})


def test_a_fish_that_left_keeps_its_distance_and_counts_energy_until_then():
    trials = protocol.trials(speeds=[0.1], los_deg=[0], repeats=1)
    (place,) = order(trials)
    result = judged(trials, {place.name: log_of(place, left=8.0)})
    assert int(result.left[0]) == pytest.approx(400, abs=2)
    assert result.distance[0, -1] == pytest.approx(0.6, abs=0.01) and metrics.figures(result)["arrival"][0] == 0.0
    assert metrics.figures(result)["power"][0] == pytest.approx(3.0)
    assert metrics.figures(result)["rmse_last20"][0] == pytest.approx(0.6, abs=0.01)
    assert float(list(csv.DictReader(io.StringIO(trials_csv([result]))))[0]["left_domain_at"]) == pytest.approx(8.0, abs=0.1)


# ----------------------------------------------------------------------------------------------------------------- beside
def other_water(folder, name="station", **change):
    """What `evaluate --out` leaves, of an other water."""
    folder.mkdir(parents=True)
    head = ["controller", "speed", "los_deg", "repeat", "seed", "flow_seed", "left_domain_at", "solver_failed_at", *metrics.UNITS]
    rows = [
        [name, u, b, r, 0, 5, "", "", *(0.5 + 0.01 * k for k in range(len(metrics.UNITS)))]
        for u in (0.1, 0.2)
        for b in (0, 90)
        for r in (0,)
    ]
    rows = [change.get("row", lambda row: row)(row) for row in rows]
    (folder / "trials.csv").write_text("\n".join(",".join(map(str, row)) for row in [head, *rows]) + "\n")
    (folder / "results.json").write_text(json.dumps({"condition": "4 trials, water swift"}))
    return folder


def test_other_waters_stand_beside_by_their_trials_csv(tmp_path, capsys):
    trials = protocol.trials(speeds=[0.1, 0.2], los_deg=[0, 90, 180], repeats=1)
    places = order(trials)
    own = judged(trials, {place.name: log_of(place) for place in places})
    fitted = trials_tables.beside(other_water(tmp_path / "fitted"), "station", own)
    assert fitted.controller == "station, fitted" and "2 of 6 trials are not there" in capsys.readouterr().err
    assert metrics.summary(fitted)["overall"]["arrival"]["n"] == 4
    (difference,) = [d for d in metrics.compare(own, fitted) if d.key == "power"]
    assert difference.n == 4 and difference.value == pytest.approx(0.55 - 3.0)
    found, lacks = trials_tables.written(tmp_path / "out", [own, fitted], ["a note"], replay="fishmj replay x")
    page = (tmp_path / "out" / "report.html").read_text()
    assert lacks == [] and "station, fitted minus station, robot" in page and "a note" in page and "fishmj replay x" in page
    assert {p["b"] for p in found["paired"]} == {"station, fitted"}
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "trials.csv").read_text())))
    assert len(rows) == 12 and {row["controller"] for row in rows} == {"station, robot", "station, fitted"}
    with pytest.raises(ConfigError, match="judges dob; expected station"):
        trials_tables.beside(other_water(tmp_path / "b", "dob"), "station", own)
    with pytest.raises(StoreError, match="no table of evaluate"):
        trials_tables.beside(other_water(tmp_path / "c", row=lambda row: [*row[:-1], "much"]), "station", own)
    with pytest.raises(ConfigError, match="none of these trials"):
        trials_tables.beside(other_water(tmp_path / "d", row=lambda row: [row[0], 0.15, *row[2:]]), "station", own)
    with pytest.raises(StoreError, match="cannot be read"):
        trials_tables.beside(tmp_path / "nothing", "station", own)


def test_paths_of_the_other_water_are_turned_into_the_streams_of_the_tank(tmp_path):
    turned = protocol.trials(speeds=[0.1], los_deg=[0, 90], repeats=1, direction=0.7)
    own = judged(turned, {place.name: log_of(place) for place in order(turned)})
    folder = other_water(tmp_path / "solver")
    assert len(trials_tables.beside(folder, "station", own).t) < 2  # its figures alone
    meta = {"origin": "synthetic", "flow": {"direction": 0.0}, "robot": "fish"}
    for place in order(protocol.trials(speeds=[0.1], los_deg=[0, 90], repeats=1)):  # the stream of evaluate moves to x
        t = np.arange(0.02, 61.0, 0.02)
        way = np.clip(t / 14, 0, 1)
        path = {
            "x": place.start[0] + way * (place.target[0] - place.start[0]),
            "y": place.start[1] + way * (place.target[1] - place.start[1]),
        }
        still = dict.fromkeys(("vx", "vy", "wz", *(f"{c}{k}" for c in "jk" for k in (1, 2, 3))), np.zeros(len(t)))
        truth = {"t": t, **path, "yaw": np.full(len(t), np.pi), **still}
        write_trial(folder / "logs" / f"station_{place.name}", Trial(meta, {"truth": truth}))
    solver = trials_tables.beside(folder, "station", own)
    assert solver.t is own.t and solver.known is not None
    np.testing.assert_allclose(solver.pose[:, 0], turned.ends()[0], atol=0.02)
    np.testing.assert_allclose(solver.pose[:, -1, :2], solver.target, atol=2e-3)
    np.testing.assert_allclose(solver.distance, own.distance, atol=0.02)  # both go straight at 0.1 m/s


# ---------------------------------------------------------------------------------------------------------------- session
class Tank:
    """A tank without a fish: the person's answers, what was swum, and how it ended."""

    def __init__(self, monkeypatch, answers, outcomes=()):
        clock = FakeClock()
        self.swum, self.outcomes = [], list(outcomes)
        monkeypatch.setattr(rig_prompt.sys, "stdin", io.StringIO("".join(f"{answer}\n" for answer in answers)))
        monkeypatch.setattr(wiring, "wire", lambda *_: wiring.Wired(FakeRobot(clock), FakeEyes(clock), clock, False))
        monkeypatch.setattr(trials_command, "SwimLoop", self.swim)
        monkeypatch.setattr(
            trials_command.Session, "accept", lambda session, name, *_: self.accept(session.folder / "trials" / name)
        )
        monkeypatch.setattr(trials_command, "tables", lambda *_: console.OK)

    def swim(self, rig, pilot, plan, log, **_):
        self.swum.append((log.folder.name, plan.target, log.meta["flow"]["speed"]))
        return SimpleNamespace(run=lambda: self.outcomes.pop(0) if self.outcomes else SWUM)

    def accept(self, folder):
        """In the place of what is written of a real log."""
        folder.mkdir(parents=True)
        (folder / "meta.toml").write_text("")


WORDS = [
    "--policy",
    "station",
    "--link",
    "serial:/dev/none",
    "--i-am-at-the-tank",
    "--speeds",
    "0.1,0.2",
    "--los",
    "0,180",
    "--repeats",
    "1",
]


def walked(tmp_path, monkeypatch, answers, outcomes=(), words=()):
    """The names that were swum in a session of four trials with these answers, the session, and the error it ended with."""
    tank = Tank(monkeypatch, answers, outcomes)
    error = ""
    try:
        trials_command.main([*WORDS, *words, "--out", str(tmp_path / "s")])
    except ConfigError as raised:
        error = str(raised)
    known = json.loads((tmp_path / "s" / "session.json").read_text())
    return [name for name, *_ in tank.swum], known, error


def test_a_person_is_led_through_and_the_same_command_goes_on_the_next_day(tmp_path, monkeypatch, capsys):
    MAP.write(tmp_path / "map.toml")
    mapped = ("--flow-map", str(tmp_path / "map.toml"))
    # pump, place, accept; place, repeat; place, accept; pump, then q
    names, known, error = walked(tmp_path, monkeypatch, ["", "", "", "", "r", "", "", "q"], words=mapped)
    assert names == ["u0.1_los000_r0", "u0.1_los180_r0", "u0.1_los180_r0"] and "stopped by the person" in error
    said = capsys.readouterr().out
    assert (
        "set the pump to 20 (0.1 m/s, TI 8.0 %, L 0.20 m)" in said and "set the pump to 30 (0.2 m/s, TI 6.0 %, L 0.30 m)" in said
    )
    assert said.count("set the pump to 20") == 1 and "put the fish at x = 0.70 m, y = 0.00 m, heading 180 deg" in said
    names, known, error = walked(tmp_path, monkeypatch, ["", "", "s", "", ""], words=mapped)  # the pump again: it is another day
    assert names == ["u0.2_los000_r0", "u0.2_los180_r0"] and error == ""
    assert known["skipped"] == {"u0.2_los000_r0": SWUM.words} and "2 of 4 are there already" in capsys.readouterr().out
    names, known, _ = walked(tmp_path, monkeypatch, ["", "", ""], words=(*mapped, "--retry"))
    assert names == ["u0.2_los000_r0"] and known["skipped"] == {}


def test_swim_ended_by_a_fault_cannot_be_accepted_but_left_tank_can(tmp_path, monkeypatch):
    silent = SwimOutcome(**{**vars(SWUM), "cause": Condition.LINK_SILENT, "swim_seconds": 5.0})
    left = SwimOutcome(**{**vars(SWUM), "cause": Condition.LEFT_TANK, "swim_seconds": 5.0})
    # pump, place, Enter (repeats); place, Enter (accepts); then q
    names, known, _ = walked(tmp_path, monkeypatch, ["", "", "", "", "", "q"], [silent, left])
    assert names == ["u0.1_los000_r0"] * 2 and known["skipped"] == {}
    assert (tmp_path / "s" / "trials" / "u0.1_los000_r0").is_dir()


def test_a_session_of_something_else_is_refused(tmp_path):
    made = Session(tmp_path / "s", {"policy_sha256": "a", "duration": 60.0})
    made.save()
    assert Session(tmp_path / "s", {"policy_sha256": "a", "duration": 60.0}).skipped == {}
    with pytest.raises(ConfigError, match="policy_sha256 = 'a', here 'b'"):
        Session(tmp_path / "s", {"policy_sha256": "b", "duration": 60.0})
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "thesis.tex").write_text("")
    with pytest.raises(ConfigError, match="is no session"):
        Session(tmp_path / "t", {})


def test_without_a_robot_in_loopback_nobody_says_yes_for_the_person(tmp_path):
    with pytest.raises(ConfigError, match="--yes is for --link loopback"):
        trials_command.main([*WORDS, "--yes", "--out", str(tmp_path / "s")])
    for words in ("--body fitted --flow 0.3,0", "--start=1,0,0"):  # every trial has its own
        with pytest.raises(ConfigError, match="every trial sets by --(speeds and --direction|los); leave --(flow|start)"):
            trials_command.main(["--policy", "station", f"--loopback={words}", "--out", str(tmp_path / "s")])
    assert not (tmp_path / "s").exists()
    with pytest.raises(ConfigError, match="none is accepted yet"):
        trials_command.main([*WORDS, "--tables", "--out", str(tmp_path / "s")])


def test_tables_need_no_robot_and_know_which_it_was(tmp_path, monkeypatch, capsys):
    asked = ["--policy", "station", "--speeds", "0.1", "--los", "0,90", "--repeats", "1"]
    trials = protocol.trials(speeds=[0.1], los_deg=[0, 90], repeats=1)
    monkeypatch.setattr(trials_command.Walk, "through", lambda walk: None)
    monkeypatch.setattr(trials_command, "tables", lambda *_: console.OK)
    trials_command.main([*asked, "--link", "serial:/dev/none", "--out", str(tmp_path / "s")])
    monkeypatch.undo()
    for place in order(trials):
        log = log_of(place, seconds=62.0)
        write_trial(tmp_path / "s" / "host" / place.name, log)
        Session(tmp_path / "s", {}).accept(place.name, tmp_path / "s" / "host" / place.name, 60.0)
    other_water(tmp_path / "s" / "beside" / "fitted")
    monkeypatch.setitem(sys.modules, "scipy", None)  # as on the computer beside the tank
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    assert trials_command.main([*asked, "--tables", "--out", str(tmp_path / "s"), "--json"]) == console.OK
    told, err = capsys.readouterr()
    found = json.loads(told.splitlines()[-1])
    trained = found["results"][0]["policy"]
    assert trained["robot"] == "swift" and "seed" in trained and "water" not in trained["differs"]
    assert [r["controller"] for r in found["results"]] == ["station, robot"] and "no comparison with other waters: scipy" in err
    assert found["robot"]["name"] == "swift" and "Robot swift, shipped as fish" in (tmp_path / "s" / "report.html").read_text()
    assert "on the robot in its tank" in found["condition"] and "fishmj replay" in (tmp_path / "s" / "report.html").read_text()
    assert (tmp_path / "s" / "trials" / "manifest.json").is_file() and found["missing"] == []
    with pytest.raises(ConfigError, match="simulated = False, here True"):
        trials_command.main([*asked, "--yes", "--out", str(tmp_path / "s")])


def test_each_trial_has_a_loopback_robot_of_its_own_unless_a_seed_is_named(tmp_path, monkeypatch):
    """The same one whatever other trials are asked for: parts of a session may be swum side by side."""
    seeds = [f"--seed={trials_command.robot_seed(5, name)}" for name in ("u0.1_los000_r0", "u0.1_los090_r0")]
    assert len(set(seeds)) == 2
    named = "--seed 3 --turbulence gust"
    for k, words in enumerate((["--seed", "5"], ["--loopback", named], ["--seed", "5"])):
        asked = ["--policy", "station", "--speeds", "0.1,0.2" if k == 2 else "0.1", "--los", "0,90", "--repeats", "1", "--yes"]
        given = []

        def opened(args, robot, stack, given=given):
            given.append(args.loopback.split())
            raise StoreError("far enough")

        for _ in range(2):
            with pytest.raises(StoreError, match="far enough"):
                trials_command.main([*asked, *words, "--out", str(tmp_path / f"{k}")], opened)
            session = Session(tmp_path / f"{k}", {})
            session.skip("u0.1_los000_r0", "the next one")
        for trial, seed in zip(given, seeds, strict=True):
            assert [w for w in trial if w.startswith("--seed")] == (["--seed"] if k == 1 else [seed])
        assert given[0][-1] == "--flow=0.1,0deg" and given[0][-2].startswith("--start=0.7,")


def test_interrupted_trials_say_what_is_kept_and_how_to_go_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(trials_command.Walk, "through", lambda walk: walk.stop.set())
    assert trials_command.main([*WORDS, "--out", str(tmp_path / "s")]) == console.INTERRUPTED
    kept = f"interrupted; 0 trials are in {tmp_path / 's' / 'trials'}; go on with"
    assert kept in capsys.readouterr().err.splitlines()[-1]


def test_the_replay_of_the_worst_trial_names_an_own_robot(monkeypatch):
    place = SimpleNamespace(spec="a", name="u0.1_los000_r0")
    monkeypatch.setattr(trial_report, "worst", lambda result: 0)
    said = lambda robot: trials_tables.worst_replay(
        Path("my s"), SimpleNamespace(trials=SimpleNamespace(items=["a"])), [place], robot
    )
    assert said("fish") == "fishmj replay 'my s/trials/u0.1_los000_r0'"
    assert said("my fish.toml") == said("fish") + " --robot 'my fish.toml'"


@pytest.mark.slow
def test_sigint_during_trials_brings_robot_to_rest_and_keeps_the_log(tmp_path):
    words = [
        *"--policy station --link loopback --speeds 0.1 --los 0,180 --repeats 1 --wait 60 --out".split(),
        str(tmp_path / "s"),
    ]
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "fishmj.deploy", "trials", *words],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT,
    ) as process:  # fmt: skip
        process.stdin.write("\n" * 3)
        process.stdin.flush()
        journal, log = tmp_path / "s" / "host" / "u0.1_los000_r0" / "meta.toml", ""
        while not (journal.is_file() and "SWIMMING" in log) and process.poll() is None:
            time.sleep(0.1)
            log = journal.read_text() if journal.is_file() else ""
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=600)[0]
    assert process.returncode == console.INTERRUPTED, said
    events = " ".join(read_trial(journal.parent).meta["host"]["events"])
    assert "SWIMMING -> NEUTRAL: OPERATOR_STOP" in events and "go on with: fishmj deploy trials" in said
    assert not (tmp_path / "s" / "trials").exists()


@pytest.mark.slow
def test_lockstep_trials_write_tables_and_compare_with_another_water(tmp_path, capsys):
    out, words = tmp_path / "s", ["--speeds", "0.1,0.2", "--los", "0,90", "--repeats", "1", "--duration", "12", "--json"]
    begin = ["trials", "--policy", "station", "--link", "loopback", "--yes", *words, "--out", str(out)]
    assert deploy.main(begin) == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["trials"] == sorted(t.name for t in protocol.trials(speeds=[0.1, 0.2], los_deg=[0, 90], repeats=1).items)
    assert told["results"][0]["overall"]["power"]["n"] == 4
    trial = read_trial(out / "trials" / "u0.2_los090_r0")
    assert trial.value("condition.los_deg") == 90.0 and trial.meta["flow"]["speed"] == 0.2
    assert {"obs", "action", "power", "pose", "cmd", "joint", "target"} <= set(trial.tables)
    first = read_trial(out / "trials" / "u0.1_los000_r0")
    begun = np.interp(0.0, first.tables["pose"]["t_taken"], first.tables["pose"]["x"])
    assert begun == pytest.approx(0.7, abs=0.05)
    other_water(out / "beside" / "fitted")
    swum = {path: path.stat().st_mtime_ns for path in (out / "host").iterdir()}
    assert deploy.main(begin) == console.OK  # everything is there: only the tables are made again
    assert swum == {path: path.stat().st_mtime_ns for path in (out / "host").iterdir()}
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [r["controller"] for r in told["results"]] == ["station, loopback robot", "station, fitted"]
    assert "fitted: 4 trials, water swift" in (out / "report.html").read_text()
    assert told["results"][0]["policy"]["robot"] == "swift" and told["results"][1]["policy"] is None, "no results of its own"


def test_a_direction_beyond_a_turn_is_refused_where_it_is_typed(capsys):
    asked = lambda text: trials_command.options().parse_args([*WORDS, "--out", "s", "--direction", text]).direction
    assert asked("360") <= protocol.LIMITS["direction"][1] and asked("-90") == -np.pi / 2
    with pytest.raises(UsageError, match="expected a number from -360 to 360"):
        asked("361")
    with pytest.raises(UsageError, match="rad, as it was before, would be 90 deg; if deg is meant, write 1.5708deg"):
        asked("1.5708")
