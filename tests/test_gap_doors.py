"""The doors of `fishmj gap`, on synthetic data: whose null runs, robots, logs and options; what is refused, in one line."""

import json
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from describing import new, sized

from fishmj import effects
from fishmj.base import console
from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError, DescriptionError, LogError
from fishmj.engines import in_water
from fishmj.gap import __main__ as gap
from fishmj.gap import progress
from fishmj.gap.bench import solver
from fishmj.gap.calibrate.calibration_logs import shipped as logs_of_calibration
from fishmj.gap.commands import admission, find, model_version
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.laboratory.virtual_robot.robot_constants import electrical
from fishmj.gap.laboratory.virtual_robot.trials import plant as second_robot
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import RecordedNull, SimulatedNull, as_excitation, trials_of
from fishmj.gap.records import datasets
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.workflow import investigate
from fishmj.log import Trial, write_dataset
from fishmj.log.dataset import read_dataset, take
from fishmj.mjcf.reading import load_robot

RUNS = ("gait_fast", "steps", "chirp")
SMALL = SimulatedNull(runs=48)


def stiffer(factor: float = 1.05):
    """The shipped fish with another servo gain."""
    robot = load_robot("fish")
    return replace(robot, servo=replace(robot.servo, kp=factor * robot.servo.kp))


@pytest.fixture(scope="module")
def questioned():
    """A model whose servo is 5 % stiffer than the shipped fish's."""
    pytest.importorskip("numba")
    return SwimmingFish(stiffer(), [effects.get(n) for n in ("servo_gain", "command_latency", "viscous_friction")])


def test_null_runs_swim_the_robot_of_the_questioned_model(monkeypatch):
    gains = []

    def caught(made, *rest):
        gains.append(made.motor.gain)
        return trial

    trial = generate({}, ["idle"], 0)[0]
    monkeypatch.setattr("fishmj.gap.laboratory.virtual_robot.trials.trial_of", caught)
    robot = stiffer(1.3)
    record = record_of(trial, robot.timing.physics_dt)
    SimulatedNull(runs=12)._run(robot, as_excitation(record), record)
    assert len(gains) == 12
    assert abs(np.mean(gains) / robot.servo.kp - 1) < 0.01  # drawn within 2 % of the model's own, not of the shipped fish's


def test_null_runs_of_another_robot_are_kept_under_another_key(questioned):
    record = record_of(generate({}, ["idle"], 0)[0], questioned.dt)
    other = SwimmingFish(stiffer(1.06), questioned.active.effects)
    assert SMALL._key(questioned, record, as_excitation(record)) != SMALL._key(other, record, as_excitation(record))


def test_effects_that_a_model_lists_do_not_change_its_null_runs():
    from fishmj.effects.effect_calibration import FittedEffect, Interval

    rusty = replace(
        load_robot("fish"), effects=(FittedEffect("coulomb_friction", {"torque": Interval(0.1, 0.05, 0.15)}, "", ""),)
    )
    plain, listed = SwimmingFish("fish"), SwimmingFish(rusty)
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
def test_fish_with_calibrated_servo_agrees_and_its_latency_is_named(questioned):
    agrees = investigate(questioned, generate({}, RUNS, 11, robot=stiffer()), null=SMALL).verdict
    assert agrees.answer == "AGREES"
    late = investigate(questioned, generate({"command_latency": {"delay": 0.05}}, RUNS, 11, robot=stiffer()), null=SMALL).verdict
    assert late.answer == "NAMED" and [e.name for e in late.effects] == ["command_latency"]
    value = late.effects[0].parameters["delay"]
    assert value.low < 0.05 < value.high


# Doors of a model, its logs and its null sets.


def run(*argv) -> int:
    return console.run(gap.main, [str(a) for a in argv])


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Three short trials on disk, with a manifest."""
    folder = tmp_path_factory.mktemp("logs") / "data"
    return write_dataset(folder, {f"{i}_{t.name}": t for i, t in enumerate(generate({}, ["idle", "gait_fast", "steps"], 3))})


@pytest.fixture
def copied(logs, tmp_path):
    return Path(shutil.copytree(logs, tmp_path / "data"))


def forbidden(*_, **__):
    raise AssertionError("the work began")


@pytest.mark.parametrize("command", [["find", "DATA"], ["next", "DATA"], ["plant", "none", "--out", "NEW"]])
def test_chain_of_more_than_8_links_is_refused_before_computing(command, logs, tmp_path, capsys, monkeypatch):
    assert new("eel", *sized(links="9"), "--out", str(tmp_path / "eel.toml")) == console.OK
    capsys.readouterr()
    monkeypatch.setattr("fishmj.gap.records.datasets.readable_trials", forbidden)
    monkeypatch.setattr("fishmj.gap.null.null_runs.SimulatedNull.residuals", forbidden)
    words = [{"DATA": logs, "NEW": tmp_path / "new"}.get(w, w) for w in command]
    assert run(*words, "--model", tmp_path / "eel.toml") == console.BAD_INPUT
    said = capsys.readouterr().err.splitlines()[-1]  # before it a note on its fin
    assert "eel.toml has 9 links; it is a chain of 2 to 8" in said and "calibrate" in said


def test_logs_of_another_robot_need_a_word(logs, copied, capsys, monkeypatch):
    for meta in copied.glob("*/meta.toml"):
        meta.write_text(meta.read_text().replace('robot = "swift"', 'robot = "other"'))
    (copied / "manifest.json").unlink()
    monkeypatch.setattr(admission, "insufficient_data", lambda *_: admission.InsufficientData("reached", (), ()))
    assert run("find", logs) == console.CANNOT_TELL
    assert run("find", copied) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "the logs are of 'other', the model fish is 'swift'" in said and "--same-robot" in said
    assert run("find", copied, "--same-robot") == console.CANNOT_TELL
    assert "taken for the same robot" in capsys.readouterr().err


def test_logs_with_other_joints_or_no_robot_are_told_apart():
    trial = generate({}, ["idle"], 0)[0]
    robot = load_robot("fish")
    nameless = Trial({k: v for k, v in trial.meta.items() if k != "robot"}, trial.tables, name="a")
    assert admission.of_this_robot([trial], robot, "fish") == []
    assert "1 of 1 trials name no robot" in admission.of_this_robot([nameless], robot, "fish")[0]
    fewer = {k: v for k, v in trial.tables["cmd"].items() if k != "c3"}
    with pytest.raises(LogError, match=r"has 2 joints, the model fish \(swift\) has 3"):
        admission.of_this_robot([Trial(trial.meta, {"cmd": fewer}, name="a")], robot, "fish", agreed=True)


def test_generators_of_logs_name_the_robot_that_the_model_has():
    shipped = trials_of(sorted((solver.folder() / "nulls").glob("*.npz"))[0])[0]
    calibration = read_dataset(logs_of_calibration())
    names = {t.value("robot") for t in (shipped, calibration[calibration.names[0]], generate({}, ["idle"], 0)[0])}
    assert names == {load_robot("fish").name}


def test_null_sets_of_another_fish_are_refused_with_what_differs():
    sets = RecordedNull(folder=solver.folder() / "nulls")
    admission.null_fits(sets, in_water(load_robot("fish"), solver.WATER), "fish")
    with pytest.raises(ConfigError, match=r"differs in servo.kp \(8, 8.4\). Leave out --null"):
        admission.null_fits(sets, stiffer(), "mine.toml")
    with pytest.raises(ConfigError, match="null sets of 'swift' with 3 joints; the model x is 'shark'"):
        admission.null_fits(sets, replace(load_robot("fish"), name="shark"), "x")


# A gap that no effect is meant by.


@pytest.fixture(scope="module")
def far():
    """What `likely` and `admit` read, of a model that swims as the trials did."""
    trials = generate({}, ["gait_fast", "turn_left"], 5, noise=0.0, nuisance=0.0)
    records = [record_of(t, 0.004) for t in trials]

    def evidence(change=lambda r: r, gap=5e3):
        perfect = [{"joint": r.joint.values[None], "pose": r.pose.values[None], "power": r.power.values[None]} for r in records]
        plant = SimpleNamespace(predict=lambda *_: perfect, null=None, joints=3)
        return SimpleNamespace(records=[change(r) for r in records], model=plant, over_floor=lambda row: (gap, {"joint": gap}))

    return evidence


def seen(sensor: str, columns, change):
    """A change of some columns of a sensor."""

    def changed(record):
        given = getattr(record, sensor)
        values = given.values.copy()
        values[:, columns] = change(values[:, columns])
        return record._replace(**{sensor: given._replace(values=values)})

    return changed


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (seen("joint", [0], lambda v: 57.3 * v), "joint 1: moves 57.3 times as far as the model: in degrees?"),
        (seen("joint", [1], lambda v: -v), "joint 2: opposite to the model (correlation -1.00)"),
        (seen("joint", [0, 1], lambda v: v[:, ::-1]), "joint 1: follows the command of joint 2"),
        (seen("joint", [2], lambda v: 0.01 * v), "joint 3: moves 1% of its commanded motion"),
        (seen("joint", [2], lambda v: v + 0.6), "joint 3: 34 deg off on average"),
        (seen("pose", [2], lambda v: -v), "heading: opposite to the model"),
        (seen("pose", [0, 1], lambda v: 1000 * v), "in mm?"),
        (seen("pose", [0, 1], lambda v: v[:, ::-1] * [-1, 1]), "position: path is 90 deg off the model's"),
        (seen("power", [0], lambda v: 1000 * v), "in mW?"),
    ],
)
def test_what_makes_a_gap_huge_is_read_from_the_data(change, says, far):
    assert any(says in cause for cause in admission.likely(far(change))), admission.likely(far(change))


def test_huge_gap_is_refused_with_a_usual_cause_or_beyond_all_effects(far):
    flipped = seen("joint", [1], lambda v: -v)
    assert admission.likely(far()) == []
    admission.admit(far())  # 5000 floors and no usual cause: tethers get there
    admission.admit(far(flipped, gap=900.0))
    admission.admit(far(flipped), anyway=True)
    for evidence in (far(flipped), far(gap=2e5)):
        with pytest.raises(admission.TooDifferent, match="too large for any"):
            admission.admit(evidence)


def test_a_search_that_is_too_different_ends_with_exit_3_and_says_why(logs, capsys, monkeypatch):
    def search(*_):
        raise admission.TooDifferent(1e6, {"joint": 4e6}, ["joint 1: in degrees?"])

    monkeypatch.setattr(find, "search", search)
    assert run("find", logs, "--json") == console.CANNOT_TELL
    out = capsys.readouterr().out
    assert "--anyway" in out and json.loads(out.splitlines()[-1])["causes"] == ["joint 1: in degrees?"]


# Data sets as they are.


def test_a_folder_without_a_manifest_is_taken_and_said_to_be_unsigned(copied):
    signed = take(copied)
    (copied / "manifest.json").unlink()
    taken = take(copied)
    assert list(taken.trials) == list(signed.trials) and not taken.broken
    assert "no manifest.json" in taken.notes[0] and len(taken.sha256) == 64
    assert take(copied).sha256 == taken.sha256
    table = next((copied / "1_02_gait_fast").glob("pose.*"))
    table.write_bytes(table.read_bytes() + b" ")
    assert datasets.digest(copied) != taken.sha256


@pytest.mark.parametrize("signed", [True, False])
def test_a_broken_trial_leaves_the_others(copied, signed, capsys, monkeypatch):
    if not signed:
        (copied / "manifest.json").unlink()
    (copied / "1_02_gait_fast" / "meta.toml").write_text("schema = ")
    taken = datasets.readable_trials(copied, 0.004)
    assert list(taken.broken) == ["1_02_gait_fast"] and len(taken.trials) == 2
    monkeypatch.setattr(admission, "insufficient_data", lambda *_: admission.InsufficientData("reached", (), ()))
    assert run("find", copied, "--json") == console.CANNOT_TELL
    said = capsys.readouterr()
    assert "1_02_gait_fast left out" in said.err and "1_02_gait_fast" in json.loads(said.out.splitlines()[-1])["skipped"]


def test_gap_find_refuses_data_that_are_not_one_folder_per_trial(copied, tmp_path, capsys):
    flat = tmp_path / "samples.csv"
    flat.write_text("t,c1,c2,c3\n0,0,0,0\n")
    (tmp_path / "empty").mkdir()
    for path in (flat, copied / "0_01_idle", tmp_path / "empty", tmp_path / "nowhere"):
        assert run("find", path) == console.BAD_INPUT
        said = capsys.readouterr().err
        assert "one folder a trial" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("meta", "says"),
    [
        ({"push": "hard"}, "push"),
        ({"start": [0, 0]}, "three finite numbers"),
        ({"session_time": "noon"}, "session_time"),
        ({"medium": "oil"}, "water, air"),
    ],
)
def test_meta_data_that_are_no_numbers_are_refused_by_name(meta, says):
    trial = generate({}, ["idle"], 0)[0]
    with pytest.raises(LogError, match=says):
        record_of(Trial(trial.meta | meta, trial.tables, name="a"), 0.004)


def test_clocks_of_another_zero_are_refused_before_they_fill_the_memory():
    trial = generate({}, ["idle"], 0)[0]
    pose = trial.tables["pose"] | {"t": trial.tables["pose"]["t"] + 1.7e9}
    with pytest.raises(LogError, match="same time zero"):
        record_of(Trial(trial.meta, trial.tables | {"pose": pose}, name="a"), 0.004)


def test_a_bus_that_tells_no_current_gives_a_record_without_power():
    trial = generate({}, ["idle"], 0)[0]
    power = {k: v for k, v in trial.tables["power"].items() if k != "I"}
    assert record_of(Trial(trial.meta, trial.tables | {"power": power}, name="a"), 0.004).power is None


# Options: each has its range.

NUMBERS = {
    "find": ("DATA", {"--noise": (-1, "nan", 1e9), "--null-runs": (0, 7, 10**9), "--most": (0, -1, 99), "--seed": (-1, "x")}),
    "next": ("DATA", {"--noise": (-1, "inf"), "--null-runs": (0,), "--top": (0,), "--seed": (-1,)}),
    "plant": ("none", {"--logs": (0, 10**9), "--seed": (-1,), "--noise": ("nan", -1), "--nuisance": (1, -0.1), "--tanks": (0,),
                       "--drop": (1, -1)}),
    "bench": ("", {"--cases": (0, 10**9), "--seed": (-1,), "--shard": ("5/2", "1", "a/b", "0/0"), "--jobs": (-1,),
                   "--kinds": ("singel",), "--generator": ("first",)}),
    "apply": ("DATA", {"--out": ("FOLDER",)}),
}  # fmt: skip
WRONG = [(c, what, option, v) for c, (what, table) in NUMBERS.items() for option, values in table.items() for v in values]


@pytest.mark.parametrize(("command", "what", "option", "value"), WRONG, ids=lambda v: str(v))
def test_an_option_out_of_its_range_is_one_line_that_names_it(command, what, option, value, logs, tmp_path, capsys):
    words = [str(logs)] if what == "DATA" else [what] if what else []
    words += ["--out", str(tmp_path / "new")] if command == "plant" else []
    value = str(tmp_path) if value == "FOLDER" else value
    assert run(command, *words, f"{option}={value}") == console.BAD_INPUT
    said = capsys.readouterr().err
    assert option in said and said.count("\n") == 1 and not (tmp_path / "new").exists()


@pytest.mark.parametrize("command", ["find", "plant", "next", "apply", "check", "bench", "fetch", "measured"])
def test_help_shows_an_example(command, capsys):
    assert run(command, "--help") == console.OK
    said = " ".join(capsys.readouterr().out.split())
    assert said.count(f"fishmj gap {command} ") >= 2  # the usage and the example


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("coulomb_friction=1e9", "expected 0 to 0.8 N m"),
        ("coulomb_friction=nan", "no finite number"),
        ("body_mass=-5", "expected -0.5 to 1.5 kg"),
        ("tether:x=99", "expected -1.8 to 1.8 m"),
        ("tooth", "unknown effect"),
        ("bouc_wen_skin=1000", "expected 0 to 4 N m"),
        ("tether:stiffness", "no finite number"),
        ("tether=0.1 tether=0.2", "given twice"),
    ],
)
def test_an_effect_beyond_its_bounds_is_not_planted(text, says, tmp_path, capsys):
    assert run("plant", *text.split(), "--out", tmp_path / "new", "--logs", "1") == console.BAD_INPUT
    assert says in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_data_are_not_planted_into_what_is_there_already(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fishmj.gap.laboratory.virtual_robot.generate", forbidden)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    (tmp_path / "old.truth.json").write_text("{}")
    for out, more, says in (
        (logs, [], "exists"),
        (logs, ["--overwrite", "--excitations", "gait", "--logs", "1"], "trials that this run does not write"),
        (logs / "new", [], "inside"),
        (tmp_path / "full", ["--overwrite"], "is no data set, and --overwrite"),
        (tmp_path / "old", [], "--truth"),
        (tmp_path / "a b", [], "data set name 'a b'"),
        (tmp_path / "full" / "thesis.txt" / "x", [], "is a file"),
    ):
        assert run("plant", "none", "--out", out, *more) == console.BAD_INPUT
        said = capsys.readouterr().err
        assert says in said and said.count("\n") == 1
    assert (tmp_path / "full" / "thesis.txt").read_text() == "mine"


def test_a_planted_robot_may_be_ones_own(tmp_path):
    text = resolve("fish").read_text().replace("kp = 8.0", "kp = 9.0")
    assert "kp = 9.0" in text
    (tmp_path / "mine.toml").write_text(text)
    asked = ("--out", tmp_path / "d", "--logs", "1", "--excitations", "idle", "--weigh", "--model", tmp_path / "mine.toml")
    assert run("plant", "none", *asked) == console.OK
    assert len(take(tmp_path / "d").trials) == 1


# Reports from elsewhere.

GOOD = {
    "answer": "NAMED",
    "effects": [{"name": "coulomb_friction", "parameters": {"torque": {"value": 0.1, "low": 0.0, "high": 0.2}}, "p_best": 1.0}],
    "rivals": [], "gap_before": 9.0, "gap_after": 1.0,
    "context": {"model": "fish", "model_sha256": "0" * 64, "data": "/nowhere", "data_sha256": "0" * 64, "judged": ["a"],
                "null": {"runs": 8, "noise": 1.0, "seed": 0}},
}  # fmt: skip
LOPSIDED = {"name": "tether", "p_best": 0.1, "values": {"tether": {"x": [1]}}}
BAD = [
    (("answer",), "MAYBE"), (("answer",), None), (("effects",), {}), (("effects", 0, "name"), "../../x"),
    (("effects", 0, "name"), 7), (("effects", 0, "parameters", "torque", "value"), None),
    (("effects", 0, "parameters", "torque", "low"), "1"), (("rivals",), [{"name": "__import__", "p_best": 1}]),
    (("rivals",), [LOPSIDED]), (("context", "model"), 3), (("context", "judged"), []), (("context", "null"), {"runs": 10**9}),
    (("context", "null"), {"exec": "x"}), (("context", "model_sha256"), "x"), (("context", "data"), None), (("context",), []),
]  # fmt: skip


def altered(path, value) -> dict:
    report = json.loads(json.dumps(GOOD))
    at = report
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return report


@pytest.mark.parametrize(("path", "value"), BAD, ids=lambda v: str(v)[:30])
def test_a_hostile_report_is_refused_with_the_field(path, value, tmp_path, capsys):
    (tmp_path / "verdict.json").write_text(json.dumps(altered(path, value)))
    for command in ("apply", "next"):
        assert run(command, tmp_path) == console.BAD_INPUT
        said = capsys.readouterr().err
        assert "verdict.json" in said and said.count("\n") == 1


@pytest.mark.parametrize("text", ["", "[]", "{", "NaN", '{"answer": NaN}', "null"])
def test_a_report_that_is_no_report_is_refused_in_one_line(text, tmp_path, capsys):
    (tmp_path / "verdict.json").write_text(text)
    for command in ("apply", "next"):
        assert run(command, tmp_path) == console.BAD_INPUT
        assert capsys.readouterr().err.count("\n") == 1


def test_a_report_of_a_changed_or_missing_model_is_refused(tmp_path, capsys):
    for model in ("fish", "/nowhere/fish.toml", "../../etc/passwd"):
        (tmp_path / "verdict.json").write_text(json.dumps(altered(("context", "model"), model)))
        assert run("apply", tmp_path) == console.BAD_INPUT
        assert capsys.readouterr().err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["verdict.json"]


def test_nothing_is_written_over_by_a_version(tmp_path, logs, capsys):
    context = {"model_sha256": model_version.digest("fish"), "data": str(logs), "data_sha256": datasets.digest(logs)}
    report = GOOD | {"context": GOOD["context"] | context}
    (tmp_path / "verdict.json").write_text(json.dumps(report))
    (tmp_path / "fish.v2.toml").write_text("mine")
    assert run("apply", tmp_path) == console.BAD_INPUT
    assert "exists and is not overwritten" in capsys.readouterr().err and (tmp_path / "fish.v2.toml").read_text() == "mine"


@pytest.mark.parametrize(
    "line", ['parent_text = "../../x.toml"', 'parent_text = "/etc/passwd"', "parent_text = 3", 'number = "x"']
)
def test_a_version_that_points_elsewhere_is_refused(line, tmp_path, logs, capsys):
    model = tmp_path / "fish.v2.toml"
    model.write_text(f"{resolve('fish').read_text()}\n[version]\n{line}\n")
    for words in (["check", model, "--data", logs], ["apply", "--revert", model]):
        assert run(*words) == console.BAD_INPUT
        assert capsys.readouterr().err.count("\n") == 1


def test_no_text_of_a_description_reaches_what_is_compiled(monkeypatch):
    pytest.importorskip("numba")
    texts = []
    monkeypatch.setattr("fishmj.engines.numba_build.compiled", lambda text: texts.append(text) or SimpleNamespace(roll=None))
    for name in ("fish", "os.system"):
        robot = load_robot("fish")
        links = tuple(replace(link, name=f"{name}{i}") for i, link in enumerate(robot.links))
        fins = tuple(replace(fin, link=links[0].name) for fin in robot.fins)
        _ = SwimmingFish(replace(robot, name=name, title=name, links=links, fins=fins), [effects.get("servo_gain")]).kernel
    assert texts[0] == texts[1] and "os.system" not in texts[1]
    pytest.raises(DescriptionError, lambda: SwimmingFish(replace(load_robot("fish"), name='"""\nimport os  # ')))


def test_null_runs_are_counted_one_by_one_and_kept_ones_not_at_all(tmp_path, monkeypatch):
    monkeypatch.setattr("fishmj.gap.null.null_runs.cache_folder", lambda: tmp_path)
    told = []

    class Bar(progress.QuietBar):
        def update(self, done, **_):
            told.append(done)

    def predict(records, row):
        sensors = ("joint", "pose", "power", "placed")
        return [{s: np.zeros((1, *getattr(r, s).values.shape)) for s in sensors if getattr(r, s) is not None} for r in records]

    still = SimpleNamespace(robot=load_robot("fish"), dt=0.004, fingerprint="still", predict=predict, null=None)
    records = [record_of(t, still.dt) for t in generate({}, ["idle", "idle"], 0)]
    null = SimulatedNull(runs=8)
    null.residuals(still, records, ResidualLayout(records), lambda total, *_: told.append(f"of {total}") or nullcontext(Bar()))
    assert told == ["of 8", *range(1, 9)]  # two replicates are one experiment
    null.residuals(still, records, ResidualLayout(records), forbidden)
