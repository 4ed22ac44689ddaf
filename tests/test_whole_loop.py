"""The whole loop: what each step hands to the next, what counts as named, and what the swims are judged by."""

import importlib.util
import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.store import read_json, write_json
from fishmj.deploy.commands import swim_command
from fishmj.deploy.loop import graceful_stop
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.rig import rig_experiment
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines import command_latency, nominal_params
from fishmj.gap.commands import admission
from fishmj.gap.commands.apply import settle
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.records.records import record_of
from fishmj.log import read_trial
from fishmj.log.dataset import take
from fishmj.mjcf.reading import load_robot
from studies.whole_loop import __main__ as study
from studies.whole_loop import gains, latency, robots, steps, swims
from studies.whole_loop.steps import Fault, Loop
from studies.whole_loop.tank import Tank

ROOT = Path(__file__).resolve().parent.parent
sized = lambda value: {"value": value, "low": value - 0.01, "high": value + 0.01}
DELAYED = {"name": "command_latency", "parameters": {"delay": sized(0.15)}}
BENT = {"name": "joint_zero_offset", "parameters": {f"offset{k}": sized(v) for k, v in ((1, 0.18), (2, -0.03), (3, 0.03))}}


def verdict(answer, effects=(), tentative=()):
    return {"answer": answer, "effects": list(effects), "tentative": list(tentative), "gap_before": 9.0, "gap_after": 1.0}


def test_every_horn_is_turned_to_both_sides_by_a_rule_that_chooses_no_seed():
    faults = [Fault.of(seed) for seed in range(6)]
    assert {(fault.horn, fault.angle_deg) for fault in faults} == {(h, a) for h in (1, 2, 3) for a in (10.0, -10.0)}
    assert {fault.delay for fault in faults} == {0.15}
    assert faults[0] == (0.15, 1, 10.0)  # of the example
    assert "command_latency=0.15" in faults[0].options() and "offset1=0.174533" in faults[0].options()


def test_swim_command_runs_in_lockstep_and_records_the_true_path(tmp_path, monkeypatch):
    monkeypatch.setattr(graceful_stop, "first_in_line", lambda: pytest.fail("a loop that never waits goes before all others"))
    tank, out = Tank(), tmp_path / "swim"
    assert tank.path.shape == (0, 4) and np.isnan(tank.begun)
    words = ["--policy", "station", "--seconds", "2", "--out", str(out), "--loopback", "--seed 4 --start=-0.5,0.1,171.9"]
    assert swim_command.main(words, wire=tank.wire) == console.OK
    log, path = read_trial(out), tank.path
    assert path[0, 1:3] == pytest.approx((-0.5, 0.1), abs=1e-3) and np.all(np.diff(path[:, 0]) > 0)
    pose = log.tables["pose"]
    zero = tank.begun - log.tables["cmd"]["t"][0]  # of the log, on the host's clock
    for k, column in ((1, "x"), (2, "y")):
        true = np.interp(pose["t_taken"] + zero, path[:, 0], path[:, k])
        assert np.sqrt(np.mean((pose[column] - true) ** 2)) < 0.01  # the camera's 5 mm


def test_an_experiment_through_the_command_leaves_a_data_set(tmp_path, monkeypatch):
    monkeypatch.setattr(graceful_stop, "first_in_line", lambda: pytest.fail("a loop that never waits goes before all others"))
    words = ["idle", "--repeats", "1", "--yes", "--flow", "0,0", "--out", str(tmp_path / "rig"), "--loopback", "--seed 4"]
    assert rig_experiment.main(words, wire=Tank().wire) == console.OK
    (trial,) = take(tmp_path / "rig/trials").trials.values()
    assert trial.value("excitation") == "idle" and trial.value("flow.known")


def test_lockstep_refuses_a_robot_that_it_has_not():
    for given in ({"link": "udp://127.0.0.1", "protocol": "fishmj-1"}, {"link": "loopback", "protocol": "mish-fixed"}):
        with pytest.raises(ConfigError, match="expected loopback and fishmj-1"), ExitStack() as stack:
            Tank().wire(SimpleNamespace(**given, loopback="", robot="fish"), load_robot("fish"), stack)


def test_the_host_knows_the_latency_of_a_patched_description():
    robot = load_robot("fish")
    late = FittedEffect("command_latency", {"delay": Interval(0.15, 0.14, 0.16)}, "a search", "")
    patched = replace(robot, effects=(late,))
    assert command_latency(robot) == pytest.approx(0.06) and command_latency(patched) == pytest.approx(0.21)
    assert nominal_params(patched, 1).delay[0] == round(0.21 / robot.timing.physics_dt)
    link = SimpleNamespace(greets=True)
    reach = [
        SwimLoop(rig_of(r, link), None, SwimPlan(), None).limiter(np.full(3, 1.0), np.zeros(3), 0.0)[0] for r in (robot, patched)
    ]
    assert reach == pytest.approx([5.2 * 0.08, 1.0])  # as far as a servo turns until the command acts


def rig_of(robot, link):
    return Rig(robot=robot, link=link, localiser=None, clock=None, examine=lambda info: None)


def test_swim_rmse_starts_at_arrival_and_extends_an_early_end():
    t = np.arange(100.0, 140.0, 0.02)
    path = lambda x: np.stack([t, x, np.zeros_like(t), np.zeros_like(t)], 1)
    arrives = np.where(t < 107.0, 1.0, 0.05)
    found = swims.figures(path(arrives), 102.0, 132.0, np.zeros(2), 30.0)
    assert found["rmse"] == pytest.approx(0.05) and found["arrival"] == pytest.approx(5.0, abs=0.03) and found["complete"]
    never = swims.figures(path(np.where(t < 111.0, 9.0, 0.4)), 102.0, 132.0, np.zeros(2), 30.0)
    assert never["arrival"] is None and never["rmse"] == pytest.approx(0.4)  # from 10 s on
    left = swims.figures(path(np.where(t < 108.0, 0.05, np.where(t < 109.0, 2.0, 0.0))), 102.0, 108.5, np.zeros(2), 30.0)
    assert not left["complete"] and left["rmse"] == pytest.approx(np.sqrt((6.0 * 0.05**2 + 24.0 * 2.0**2) / 30.0), rel=0.01)


def test_the_fitted_delay_is_that_of_the_joints_that_come_nearest():
    t = np.arange(0.0, 10.0, 0.004)
    beat = lambda delay: np.sin(2 * np.pi * (t - delay))[:, None] * [0.5, 0.4, 0.3]
    model = SimpleNamespace(null=np.zeros(3), index=lambda effect, name: 1)
    model.predict = lambda records, rows: [{"joint": np.stack([beat(row[1]) for row in rows])}]
    record = SimpleNamespace(name="gait_1", joint=SimpleNamespace(values=beat(0.1523)))
    assert latency.fitted(model, record, 0.15) == pytest.approx(0.1523, abs=2e-5)
    with pytest.raises(FishmjError, match="gait_1: no joint angles were logged"):
        latency.fitted(model, SimpleNamespace(name="gait_1", joint=None), 0.15)


@pytest.mark.slow
def test_hidden_latency_is_recovered_from_the_joints_within_1_ms(tmp_path, capsys):
    """The delay alone, fitted to the joints of a gait: nothing of the radio's way up is in it, and it grows by what is hidden."""
    words = ["--seeds", "1", "--hidden", "0", "30", "150", "--out", str(tmp_path), "--json"]
    assert latency.main(words) == console.OK
    (found,) = json.loads(capsys.readouterr().out.splitlines()[-1])["fitted_ms"]
    assert 0.0 < found["0"] < 4.0
    assert [found[hidden] - found["0"] for hidden in ("30", "150")] == pytest.approx([30.0, 150.0], abs=1.0)


def test_a_share_on_the_channels_where_an_effect_shows_is_not_that_of_all():
    told = {
        "command_latency": {"gain": 1000.0, "by_channel": {"joint": 900.0, "position": 60.0, "heading": 40.0}},
        "joint_zero_offset": {"gain": 10.0, "by_channel": {"joint": -2.0, "position": 4.0, "heading": 8.0}},
    }
    found = gains.shares(told, {"command_latency": ("joint",), "joint_zero_offset": ("position", "heading")})
    assert found["joint_zero_offset"] == pytest.approx((10 / 1010, 12 / 112))
    assert found["command_latency"] == pytest.approx((1000 / 1010, 900 / 898))


def test_gain_of_an_effect_excludes_the_tolerated_errors_of_the_others(monkeypatch):
    """Of z with two samples on a joint and one on the heading; errors of the others are let pass by whitening less."""
    layout = SimpleNamespace(channel=np.array(["joint", "joint", "heading"]), size=3)
    z = {"none": [9.0, 2.0, 5.0], "best": [0.5, 0.5, 1.0], "without_a": [7.0, 1.0, 1.5]}
    state = lambda name, share=1.0: SimpleNamespace(
        row=name, names=("a",), z=share * np.array(z[name]), cost=float(np.sum((share * np.array(z[name])) ** 2))
    )
    tolerant = SimpleNamespace(layout=layout)
    tolerant.subset = lambda: SimpleNamespace(layout=layout, share=0.5)
    near = SimpleNamespace(subset=lambda: SimpleNamespace(layout=layout, share=1.0))
    near.tolerating = lambda row, gates: (tolerant, 7.0) if row == "without_a" else pytest.fail("not at the others")
    monkeypatch.setattr(gains, "drop_effect", lambda whole, c, name: state("without_a", whole.share))
    monkeypatch.setattr(gains, "on_records", lambda whole, c: state("best", whole.share))
    gates = SimpleNamespace(gain=250.0, min_gain_per_sample=0.04)
    told = gains.gains(SimpleNamespace(best=state("best"), near=near), gates)["a"]
    assert told["by_channel"] == pytest.approx({"joint": (49.0 + 1.0 - 0.5) / 4, "heading": (2.25 - 1.0) / 4})
    assert told["gain"] == pytest.approx(sum(told["by_channel"].values())) and told["asked"] == pytest.approx(250.12 + 7.0)


def test_gains_of_a_robot_that_did_not_go_through_the_loop_say_what_to_do(tmp_path):
    with pytest.raises(ConfigError, match=r"seed_03/fish.toml: no such file; python -m studies.whole_loop --only 3 --out"):
        gains.searched(Loop(out=tmp_path), 3)


def test_an_effect_counts_as_named_only_where_the_answer_is_named():
    found = steps.answered(verdict("NAMED", [DELAYED], [BENT]))
    assert found["named"] == {"command_latency": {"delay": 0.15}} and list(found["counted_in"]) == ["joint_zero_offset"]
    found = steps.answered(verdict("UNEXPLAINED", [DELAYED]))
    assert found["named"] == {} and list(found["counted_in"]) == ["command_latency"]


def test_joints_that_are_late_are_not_taken_for_one_another():
    """A sixth of a beat late, each joint of a gait moves as the next one should: no reason to stop the search at its door."""
    records = [record_of(trial, 0.004) for trial in generate({}, ["gait_fast", "turn_left"], 5, noise=0.0, nuisance=0.0)]

    def late(record):
        t, values = record.joint.t, record.joint.values
        moved = np.stack([np.interp(t - 0.16, t, column) for column in values.T], 1)
        return record._replace(joint=record.joint._replace(values=moved))

    predicted = [{"joint": r.joint.values[None], "pose": r.pose.values[None], "power": r.power.values[None]} for r in records]
    model = SimpleNamespace(predict=lambda *_: predicted, null=None, joints=3)
    assert admission.likely(SimpleNamespace(records=[late(r) for r in records], model=model)) == []


@pytest.mark.parametrize("counted_in", [False, True])
def test_counted_in_effects_are_applied_to_the_model_only_on_request(tmp_path, counted_in):
    context = {"model": "fish", "data": "logs", "data_sha256": "0" * 64, "judged": ["gait"], "null": {}, "water": "structured"}
    found = verdict("NAMED", [DELAYED], [BENT])
    measure = lambda versions: [(9.0, {}, 5.0), (1.0, {}, 1.0)]
    written = settle(found, context, measure, tmp_path / "fish.v2.toml", tmp_path, counted_in=counted_in)
    effects = {effect.name: effect for effect in load_robot(written.path).effects}
    assert list(effects) == ["command_latency", "joint_zero_offset"][: 1 + counted_in]
    assert not counted_in or effects["joint_zero_offset"].provenance.startswith("counted in, not named")


def searching(monkeypatch, tmp_path, answer, find=console.OK, applied=True):
    """The commands that `search` calls with a report that holds `answer`, and what it keeps."""
    loop, asked = Loop(out=tmp_path), []
    loop.folder(0).mkdir(parents=True)

    def called(loop, seed, *words, ok=(0,)):
        words = [str(word) for word in words]
        asked.append(words)
        out = Path(words[words.index("--out") + 1])
        if words[1] == "find" and find == console.OK:
            write_json(out / "verdict.json", answer)
        if words[1] == "apply" and applied:
            out.touch()
        return find

    monkeypatch.setattr(steps, "called", called)
    steps.search(loop, 0)
    return asked, read_json(loop.folder(0) / "searched.json")


def test_what_is_named_is_applied_with_what_is_counted_in(monkeypatch, tmp_path):
    asked, found = searching(monkeypatch, tmp_path, verdict("NAMED", [DELAYED], [BENT]))
    assert [words[1] for words in asked] == ["find", "apply"] and "--counted-in" in asked[1]
    assert asked[1][2] == asked[0][asked[0].index("--out") + 1] and found["patched"]


@pytest.mark.parametrize(
    ("answer", "find", "commands"),
    [
        (verdict("UNEXPLAINED", [DELAYED]), console.OK, ["find"]),
        (None, console.CANNOT_TELL, ["find"]),
        (verdict("NAMED", [DELAYED]), console.OK, ["find", "apply"]),  # apply refuses
    ],
)
def test_what_is_not_named_or_not_applied_leaves_the_model_as_it_is(monkeypatch, tmp_path, answer, find, commands):
    asked, found = searching(monkeypatch, tmp_path, answer, find, applied=False)
    assert [words[1] for words in asked] == commands and not found["patched"]
    steps.train(Loop(out=tmp_path), 0, steps.AFTER)  # nothing to train in, nothing to swim
    swims.swim(Loop(out=tmp_path), 0, steps.AFTER)
    assert len(asked) == len(commands) and not (tmp_path / "seed_00/swims").exists()


def test_a_command_that_fails_says_where_its_words_are(tmp_path):
    with pytest.raises(FishmjError, match=r"seed 3: fishmj gap find ended with 2; see .*seed_03/log.txt"):
        steps.called(Loop(out=tmp_path), 3, "gap", "find", tmp_path / "nothing")
    said = (tmp_path / "seed_03/log.txt").read_text()
    assert said.startswith("$ fishmj gap find") and f"fishmj: {tmp_path / 'nothing'}" in said


def row(seed, named, before, after):
    rmse = {"rmse_healthy": 0.05, "rmse_before": before, "rmse_unpatched": before, "rmse_after": after}
    return {
        "seed": seed,
        "named": named,
        "counted_in": ["joint_zero_offset"] * (len(named) == 1),
        "patched": after is not None,
        **rmse,
    }


def test_the_summary_counts_robots_and_compares_those_that_were_patched():
    both = ["command_latency", "joint_zero_offset"]
    rows = [row(k, both, 1.0 + 0.1 * k, 0.2 + 0.1 * k) for k in range(6)]
    rows += [row(6, both[:1], 1.0, 0.2), row(7, ["wall_effect"], 1.0, 0.2), row(8, [], 1.0, None)]
    told = robots.summary(rows)
    counted = [told[key] for key in ("robots", "both", "one", "none", "both_fitted", "others_named", "patched")]
    assert counted == [9, 6, 1, 2, 7, 1, 8]
    assert told["after_less_before"] == pytest.approx([-0.8] * 3) and told["after_less_unpatched"][0] == pytest.approx(-0.8)


def test_what_is_finished_is_not_done_again(monkeypatch, tmp_path):
    loop = Loop(out=tmp_path, swims=1)
    folder = loop.folder(2)
    write_json(folder / "searched.json", steps.answered(verdict("NAMED", [DELAYED], [BENT])) | {"patched": True})
    for arm in steps.ARMS:
        write_json(folder / f"swims/{arm}.json", [{"rmse": 0.3, "arrival": None, "complete": True, "ended": ""}])
    for name in ("fish.toml", "trained_after.json", "trained_unpatched.json"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    monkeypatch.setattr(steps.rig_experiment, "main", lambda *_, **__: console.OK)
    monkeypatch.setattr(steps, "called", lambda *_, **__: pytest.fail("called again"))
    for step in robots.chain():
        step.do(loop, 2)
    found = robots.row_of(loop, 2)
    assert found["named"] == ["command_latency"] and found["counted_in"] == ["joint_zero_offset"] and found["horn"] == 3
    assert found["zeros_deg"] == pytest.approx(np.degrees(0.18)) and found["delay_ms"] == pytest.approx(150.0)


@pytest.mark.slow
def test_whole_loop_names_a_hidden_fault_patches_the_model_and_swims(tmp_path, capsys):
    """Few experiments and a token training: each step takes what the one before wrote, and the fault is named."""
    pytest.importorskip("numba")
    spec = importlib.util.spec_from_file_location("whole_loop", ROOT / "examples" / "whole_loop.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    names = ("gait", "turn_left", "turn_right", "steps", "burst_and_coast", "gait_mirrored")
    short = {"healthy": names, "experiments": names, "null_runs": 24, "steps": 20_000, "swims": 1, "seconds": 5.0}
    told = example.tell(Loop(out=tmp_path / "loop", **short))
    assert "command_latency" in told["named"] and told["delay_ms"] == pytest.approx(150.0, abs=20.0)
    assert told["patched"] and told["rmse_after"] > 0.0 and set(told["swims"]) == set(steps.ARMS)
    said = capsys.readouterr().out
    for command in ("deploy experiment", "calibrate water", "gap find", "gap apply", "train", "deploy swim"):
        assert f"$ fishmj {command} " in said
    folder = tmp_path / "loop/seed_00"
    assert {"command_latency", *told["counted_in"]} == {effect.name for effect in load_robot(folder / "fish.v2.toml").effects}
    words = ["--only", "0", "--experiments", *names, "--swims", "1", "--seconds", "5", "--jobs", "1"]  # all of it is there
    assert study.main([*words, "--out", str(tmp_path / "loop"), "--json"]) == console.OK
    (again,) = json.loads(capsys.readouterr().out.splitlines()[-1])["robots"]
    assert again["swims"] == told["swims"]
