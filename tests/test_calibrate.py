"""Calibration: numbers of a robot that are known come back, intervals hold, the seal stays shut."""

import json
import subprocess
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base import console, interrupt
from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError, LogError, StoreError
from fishmj.base.store import Manifest, read_json, sha256, write_json, write_text
from fishmj.gap.calibrate import __main__ as command
from fishmj.gap.calibrate import calibrated_model, calibration_logs, commands, mass, servo_fit
from fishmj.gap.calibrate.calibration_logs import Logs
from fishmj.gap.calibrate.parameter_fit import (
    Block,
    FreeParameter,
    LeastSquaresFit,
    ParameterEstimate,
    correlation_length,
    fit,
    widened,
)
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.hidden_lbm import calibration_trials, sealed_score
from fishmj.gap.models.swimming_fish import ServoStand
from fishmj.gap.records.records import Sensor
from fishmj.log import measurements, read_trial, write_trial
from fishmj.log.toml import dumps
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "data" / "calib" / "trials"
SEED = 11


def red_noise(rng: np.random.Generator, n: int, keep: float) -> np.ndarray:
    """AR(1) with unit variance."""
    out, kicks = np.empty(n), rng.standard_normal(n) * np.sqrt(1 - keep**2)
    out[0] = rng.standard_normal()
    for i in range(1, n):
        out[i] = keep * out[i - 1] + kicks[i]
    return out


def test_correlation_length_of_red_noise():
    rng = np.random.default_rng(0)
    found = np.mean([correlation_length(red_noise(rng, 4000, 0.9)) for _ in range(20)])
    assert found == pytest.approx((1 + 0.9) / (1 - 0.9), rel=0.2)
    assert correlation_length(rng.standard_normal(4000)) < 1.5


def averaged(trial, rows: int):
    """The trial with joint angles that a centred moving average smoothed, to the digits of a file."""
    mean = lambda v: np.round(np.convolve(np.pad(v, rows // 2, mode="edge"), np.ones(rows) / rows, "valid"), 5)
    joint = {name: mean(v) if name[0] == "j" else v for name, v in trial.tables["joint"].items()}
    return replace(trial, tables={**trial.tables, "joint": joint})


@pytest.mark.parametrize("rows", [5, 9, 15])
def test_smoothed_joint_angles_are_told_and_raw_ones_are_not(rows):
    logs = calibration_logs.read(SHIPPED)
    trials = [logs.trials[name] for name in logs.bench()]
    assert calibration_logs.smoothing(trials) == ""
    note = calibration_logs.smoothing([averaged(trial, rows) for trial in trials])
    assert f"a moving average over {rows} rows" in note and "command_latency" in note
    coarse = [replace(t, tables={**t.tables, "joint": {c: np.round(v, 2) for c, v in t.tables["joint"].items()}}) for t in trials]
    assert calibration_logs.smoothing(coarse) == ""


def test_servo_calibration_prints_that_angles_were_smoothed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(commands, "compile_kernel", lambda *_: None)
    for name in calibration_logs.read(SHIPPED).bench():
        write_trial(tmp_path / name, averaged(read_trial(SHIPPED / name), 9))
    commands.open_bench_logs(Namespace(data=tmp_path, model="fish", same_robot=False), load_robot("fish"))
    assert "as after a moving average over 9 rows" in capsys.readouterr().err


def test_intervals_hold_under_autocorrelated_residuals():
    """A slope and an offset in red noise: the 90 % interval covers about as often as it says; a naive one does not."""
    rng, t, inside, naive = np.random.default_rng(1), np.linspace(0, 1, 300), 0, 0
    blocks = [Block(f"t{i}", f"g{i % 3}", slice(300 * i, 300 * (i + 1))) for i in range(6)]
    line = lambda thetas: (thetas[:, :1] + thetas[:, 1:] * np.tile(t, 6)[None]) * 1.0
    start = [FreeParameter("a", "1", 0.5, 0.1), FreeParameter("b", "1", 0.0, 0.1)]
    for _ in range(60):
        data = 1.0 + 2.0 * np.tile(t, 6) + 0.3 * np.concatenate([red_noise(rng, 300, 0.95) for _ in blocks])
        found = fit(start, lambda thetas, data=data: data - line(thetas), blocks)
        slope = found.estimates["b"]
        inside += slope.low <= 2.0 <= slope.high
        sd = 0.3 / np.sqrt(np.sum((np.tile(t, 6) - 0.5) ** 2))
        naive += abs(slope.value - 2.0) < 1.645 * sd
    assert inside >= 50, f"{inside} of 60"
    assert naive < 30, f"the naive interval holds {naive} times: this test proves nothing"


def test_a_bound_and_a_prior_are_kept():
    blocks = [Block("t", "g", slice(0, 50))]
    target = np.full(50, -1.0)
    bounded = fit([FreeParameter("a", "1", 0.5, 0.1, low=0.0)], lambda thetas: target - thetas, blocks)
    assert bounded.theta[0] == 0.0 and bounded.estimates["a"].low == 0.0
    held = fit([FreeParameter("a", "1", 0.5, 0.1, sigma=1e-6)], lambda thetas: target - thetas, blocks)
    assert held.theta[0] == pytest.approx(0.5, abs=1e-3)


@pytest.fixture(scope="module")
def robot() -> tuple[dict, Logs]:
    """Truth and bench trials of one robot, one repeat."""
    return calibration_trials.truth(calibration_trials.hidden(SEED)), Logs(
        Path("drawn"), calibration_trials.trials(SEED, repeats=1)
    )


@pytest.fixture(scope="module")
def fitted(robot) -> servo_fit.ServoFit:
    return servo_fit.calibrate(robot[1], ServoStand(), alone=False)


def test_servo_numbers_come_back_within_their_intervals(robot, fitted):
    truth, _ = robot
    for name, e in fitted.estimates.items():
        wide = widened(e)
        assert wide.low <= truth[name] <= wide.high, (name, wide, truth[name])
    assert fitted.estimates["kp"].value == pytest.approx(truth["kp"], rel=0.06)
    assert fitted.estimates["command_latency"].value == pytest.approx(truth["command_latency"], abs=0.004)
    assert np.degrees(fitted.whole.after.std()) < 0.4 < np.degrees(fitted.whole.before.std())


def test_latencies_come_back(robot, fitted):
    truth, logs = robot
    found = servo_fit.calibrate_latency(logs, fitted)
    for name, e in found.estimates.items():
        assert e.value == pytest.approx(truth[name], abs=0.012), name
    assert {row.path for row in found.rows} == {"command", "camera"}


def test_without_bench_trials_it_says_what_to_record():
    with pytest.raises(LogError, match="at least two"):
        servo_fit.calibrate(Logs(Path("empty"), {}), ServoStand())


def some_trials(folder: Path, names: str, change=lambda table, column, values: values) -> Path:
    """Shipped trials with other values in them, as a data set without a manifest."""
    for name in names.split():
        trial = read_trial(SHIPPED / name)
        tables = {t: {c: change(t, c, v) for c, v in columns.items()} for t, columns in trial.tables.items()}
        write_trial(folder / name, replace(trial, tables={t: c for t, c in tables.items() if c.get("j1", 0) is not None}))
    return folder


@pytest.mark.parametrize(
    ("names", "change", "said"),
    [
        ("air_sine_1", None, "found: 1 sine in air. Record square, impulse in air and in water, three times each"),
        ("air_sine_1", None, "name the signal: log import .. --excitation TRIAL=square"),
        ("air_sine_1 air_sine_2 water_sine_1", None, "found: 2 sine in air, 1 sine in water. Record square, impulse"),
        ("water_sine_1 water_square_1", lambda t, c, v: None if t == "joint" else v, "water_sine_1 is left out: no table joint"),
        ("air_sine_1 air_square_1", lambda t, c, v: 0.01 * v if (t, c[0]) == ("cmd", "c") else v, "commands stay within 0."),
        ("air_sine_1 air_square_1", lambda t, c, v: 0 * v if c[0] == "j" else v, "joint: j1 stands still (0 deg) while c1 moves"),
        ("air_sine_1 air_square_1", lambda t, c, v: -v if c == "j2" else v, "joint: j2 runs against its command c2"),
    ],
)
@pytest.mark.parametrize("verb", ["servo", "latency"])
def test_servo_calibration_refuses_insufficient_trials_and_writes_nothing(tmp_path, capsys, verb, names, change, said):
    data = some_trials(tmp_path / "data", names, change or (lambda t, c, v: v))
    where = ["--data", data, "--out", tmp_path / "new.toml", "--report", tmp_path / "report"]
    assert console.run(command.main, [verb, *map(str, where)]) == console.BAD_INPUT
    last = capsys.readouterr().err.strip().split("\n")[-1]
    assert last.startswith("fishmj: ") and said in last
    assert f"calibrate {verb} needs" in last or "joint: j" in last
    assert ("without encoders has `fishmj gap find`" in last) == ("no table joint" in said)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_outliers_count_by_their_size_and_do_not_pull_a_fit():
    rng, t = np.random.default_rng(4), np.linspace(0, 1, 400)
    data = 2.0 * t + 0.01 * rng.standard_normal(400)
    data[::25] = -30.0
    fit_with = lambda outlier: fit(
        [FreeParameter("slope", "1", 1.0, 0.1)],
        lambda thetas: data - thetas * t,
        [Block("t", "g", slice(0, 400), outlier=outlier)],
    )
    assert fit_with(0.1).theta[0] == pytest.approx(2.0, abs=0.02) and abs(fit_with(np.inf).theta[0] - 2.0) > 1.0


def test_two_groups_tell_no_width_and_the_curvature_stands_alone():
    data, t = np.random.default_rng(5).standard_normal(400), np.tile(np.linspace(0, 1, 100), 4)
    made = lambda groups: fit(
        [FreeParameter("a", "1", 0.5, 0.1)],
        lambda thetas: data - thetas * t,
        [Block(f"t{i % groups}", f"g{i % groups}", slice(100 * i, 100 * (i + 1))) for i in range(4)],
    )
    assert set(made(2).spreads) == {"curvature"} and set(made(4).spreads) == {"curvature", "trials", "signals"}


def test_a_value_at_its_bound_is_marked_in_the_table():
    target = np.full(50, -1.0)
    found = fit([FreeParameter("a", "1", 0.5, 0.1, low=0.0)], lambda thetas: target - thetas, [Block("t", "g", slice(0, 50))])
    assert commands.rows(found.estimates)[0]["at bound"] == "lower"
    inside = fit([FreeParameter("a", "1", 0.5, 0.1, low=-9.0)], lambda thetas: target - thetas, [Block("t", "g", slice(0, 50))])
    assert commands.rows(inside.estimates)[0]["at bound"] == ""


def test_what_a_fit_leaves_unexplained_names_joint_and_trial(robot):
    records = robot[1].records(0.004, robot[1].bench())[:2]
    sizes = [r.joint.values.size for r in records]
    left = 0.005 * np.ones(sum(sizes))
    assert servo_fit.unexplained(records, left) == []
    rows = len(records[1].joint.t)
    left[sizes[0] + rows : sizes[0] + 2 * rows] = np.radians(14.0)
    told = servo_fit.unexplained(records, left)
    assert len(told) == 1 and told[0].startswith(f"j2 of trial {records[1].name} (14 deg RMS left of ")
    left[sizes[0] + rows : sizes[0] + 2 * rows : 2] = 0.0
    left[sizes[0] + rows + rows // 30 : sizes[0] + 2 * rows] = 0.0
    assert servo_fit.unexplained(records, left) == [], "a few readings that are no angle are no bad fit"


def test_a_fit_that_must_not_be_used_is_refused_with_its_report(robot, fitted, tmp_path, capsys, monkeypatch):
    def bad(*_, **__):
        raise servo_fit.BadFit("data: 3 trials do not tell kp", fitted)

    monkeypatch.setattr(servo_fit, "calibrate", bad)
    monkeypatch.setattr(commands, "compile_kernel", lambda *_: None)
    data = some_trials(tmp_path / "data", "air_sine_1 air_square_1")
    out, page = tmp_path / "new.toml", tmp_path / "report" / "report.html"
    assert console.run(command.main, ["servo", *map(str, ["--data", data, "--out", out, "--report", page.parent])]) == 2
    said = capsys.readouterr()
    assert said.err.strip().split("\n")[-1].endswith(f"do not tell kp. Nothing is written; the evidence is in {page}")
    assert "RMS left [deg]" in said.out and "do not tell kp" in page.read_text() and not out.exists()


@pytest.mark.slow
def test_trials_in_air_alone_tell_gain_and_latency():
    """The nine shipped trials in air; the sealed robot has 7.943 N m/rad and 94.06 ms."""
    logs = Logs(SHIPPED, {p.name: read_trial(p) for p in sorted(SHIPPED.glob("air_*"))})
    found = servo_fit.calibrate(logs, ServoStand()).estimates
    assert found["kp"].value == pytest.approx(7.943, rel=0.1) and found["command_latency"].value == pytest.approx(
        0.094, abs=0.005
    )
    assert found["command_latency"].high - found["command_latency"].low < 0.005


@pytest.mark.slow
def test_failed_reads_do_not_change_a_calibrated_servo(tmp_path):
    def missed(table, column, values):
        values = np.array(values, float)
        if column == "j2":
            values[::25] = (-1 - 500) * np.radians(0.24)
        return values

    names = " ".join(p.name for p in sorted(SHIPPED.glob("air_*")))
    logs = calibration_logs.read(some_trials(tmp_path / "data", names, missed))
    assert sum("failed reads of j2" in note for note in logs.notes) == 9
    found = servo_fit.calibrate(logs, ServoStand(), alone=False).estimates
    assert found["kp"].value == pytest.approx(8.49, rel=0.02) and found["command_latency"].value == pytest.approx(
        0.097, abs=0.001
    )


def test_fitted_numbers_lose_the_words_for_a_guess():
    text = calibrated_model.start(Path("absent.toml"), "fish")
    for _ in range(2):
        text = calibrated_model.put(text, "servo", {"kp": 8.1}, source="data/monday")
        text = calibrated_model.put(text, "water", {"k": [0.8] * 4, "cf": 0.01}, source="data/monday", new=True)
    lines = text.split("\n")
    assert "kp = 8.1  # N m/rad, calibrated from data/monday" in lines
    water = text[text.index("[water]") : text.index("stations")]
    assert (
        "Prior" not in water
        and "literature" not in water
        and "cf = 0.01  # tangential friction, calibrated from data/monday" in lines
    )
    other = calibrated_model.put(
        calibrated_model.start(Path("absent.toml"), "tendon_fish"), "servo", {"kp": 8.1}, source="data/monday"
    )
    head = next(line for line in other.split("\n") if line.startswith("[servo]"))
    assert head.startswith("[servo]                      # kp calibrated from data/monday; the rest guessed")
    assert calibrated_model.put(other, "servo", {"kp": 8.2}, source="data/monday").count("kp calibrated from") == 1


def test_a_page_of_weighings_that_is_absent_says_what_to_write(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"measurements.toml: no such file; write there what was weighed"):
        mass.calibrate(tmp_path, load_robot())


def test_the_bench_in_water_is_the_strip_fish_step_by_step(robot):
    """One plant for both media: with `wet` 1 the row of the described robot moves as the chain of `hydro_fit` does."""
    plant, logs = ServoStand(), robot[1]
    record = logs.records(plant.dt, logs.of("water", ("square",)))[0]._replace(pose=None, power=None)
    late, n = round(plant.latency / plant.dt), 300
    q, v, attached = [*map(float, record.start), 0.0, 0.0, 0.0], [0.0] * 6, 0.5
    angles = [q[3:]]
    for k in range(n):
        target = list(record.commands[max(k - late, 0)])
        s = planar_chain.step(np, plant.chain, plant.nominal, q, v, attached, target, [(0.0, 0.0)] * 4, (0.0, 0.0))
        q, v, attached = s.q, s.v, s.attached
        angles.append(q[3:])
    t = np.arange(0, n + 1, 5) * plant.dt
    seen = record._replace(joint=Sensor(t, np.zeros((len(t), 3)), np.ones(3)), joints=np.zeros(3))
    found = plant.predict([seen], plant.null)[0]["joint"][0]
    assert np.abs(found - np.array(angles)[::5]).max() < 1e-4 < np.ptp(found, 0).min()
    hung = plant.predict([seen._replace(medium="air")], plant.null)[0]["joint"][0]
    assert np.abs(hung - found).max() > 0.02, "air is another medium"


def test_a_hull_pushed_beyond_its_tolerance_is_told():
    """Constants of the water that the fit needs far from what is described mean another water."""
    at = {c.name: ParameterEstimate(c.name, "factor", 1.0, 0.9, 1.1, 0.05, "trials") for c in servo_fit.STAND_CONSTANTS[2:]}
    fit_with = lambda mass: LeastSquaresFit(
        np.zeros(10), at | {"mass": at["mass"]._replace(value=mass)}, np.zeros(1), np.zeros(1), 1, {}
    )
    found = lambda mass: servo_fit.ServoFit(None, [], np.zeros(1), fit_with(mass), {})
    assert found(1.05).words == "" and "mass 1.38" in found(1.38).words


def test_masses_come_back_from_the_weighings(tmp_path: Path):
    made = calibration_trials.hidden(SEED)
    truth = calibration_trials.truth(made)
    page = calibration_trials.weighings(made, random_streams.stream(SEED, "weighing"))
    write_text(tmp_path / measurements.FILE, dumps(page))
    found = mass.calibrate(tmp_path, load_robot()).estimates
    for name in ("mass", "com", "inertia"):
        assert found[name].value == pytest.approx(truth[name], rel=0.02), name
    del page["scales"]["tail"]
    write_text(tmp_path / measurements.FILE, dumps(page))
    with pytest.raises(ConfigError, match=r"\[scales\] tail"):
        mass.calibrate(tmp_path, load_robot())


def test_the_nominal_robot_weighs_what_it_is_described_to():
    made = calibration_trials.plant({}, 0, nuisance=0.0)
    truth, described = calibration_trials.truth(made), load_robot()
    assert truth["mass"] == pytest.approx(described.mass)
    assert mass._yaw_inertia(described) == pytest.approx(truth["inertia"], rel=1e-6)


def test_a_calibrated_fish_is_a_fish_and_remembers_where_from(tmp_path: Path):
    out = tmp_path / "mine.toml"
    e = ParameterEstimate("kp", "N m/rad", 9.25, 9.0, 9.5, 0.1, "trials")
    friction = ParameterEstimate("friction", "N m", 0.05, 0.04, 0.06, 0.005, "trials")
    for _ in range(2):  # the second time replaces
        text = calibrated_model.put(calibrated_model.start(out, "fish"), "servo", {"kp": 9.25})
        calibrated_model.write(out, text, "servo", {"kp": e}, {"coulomb_friction.torque": friction}, "here")
    read, table = load_robot(out), read_toml(out)
    assert read.servo.kp == 9.25 and [f.name for f in read.effects] == ["coulomb_friction"]
    assert table["calibration"]["servo"]["kp"] == {"value": 9.25, "low": 9.0, "high": 9.5, "unit": "N m/rad"}
    assert out.read_text().count("[calibration.servo]") == 1 and "# N m/rad" in out.read_text()
    with pytest.raises(ConfigError, match="no line for kq"):
        calibrated_model.put(text, "servo", {"kq": 1.0})


def test_shipped_trials_are_whole_synthetic_and_sealed():
    manifest = Manifest.read(SHIPPED)
    manifest.verify(SHIPPED)
    assert calibration_trials.SEALED not in manifest.files
    assert manifest.meta["sealed"]["sha256"] == sha256(SHIPPED / calibration_trials.SEALED)
    metas = [read_toml(SHIPPED / name) for name in manifest.files if name.endswith("meta.toml")]
    assert len(metas) == 27 and {m["origin"] for m in metas} == {"synthetic"}
    assert all("seed" not in m and m["source"] in manifest.meta["generators"].values() for m in metas)
    wet = [m for m in metas if m["medium"] == "water"]
    assert {m["grid"]["domain"] for m in wet} == {"window_coarse"} and len(wet) == 18, "all water is the flow solver's"


@pytest.mark.slow
def test_another_robot_takes_the_place_of_the_first(tmp_path: Path):
    make = ["--out", str(tmp_path / "t"), "--water", "second", "--seconds", "6", "--seed"]
    assert calibration_trials.main([*make, "3"]) == 0
    first = sealed_score.opened(tmp_path / "t")
    assert len(list((tmp_path / "t").glob("*/meta.toml"))) == 27 and "slip" not in first
    assert calibration_trials.main([*make, "4", "--repeats-swims", "1", "--overwrite"]) == 0
    assert len(list((tmp_path / "t").glob("*/meta.toml"))) == 21
    assert sealed_score.opened(tmp_path / "t")["kp"] != first["kp"]
    Manifest.read(tmp_path / "t").verify(tmp_path / "t")


def test_a_broken_seal_is_noticed(tmp_path: Path):
    write_json(tmp_path / calibration_trials.SEALED, {"values": {"kp": 8.0}})
    Manifest({}, {"sealed": {"file": calibration_trials.SEALED, "sha256": "0" * 64}}).write(tmp_path)
    with pytest.raises(StoreError, match="seal"):
        sealed_score.opened(tmp_path)


def test_what_fits_never_names_the_seal():
    """Only the command line hands over to the module that opens it."""
    fits = [path for path in (ROOT / "fishmj" / "gap").rglob("*.py") if "laboratory" not in path.parts]
    assert len(fits) > 50
    for path in fits:
        text = path.read_text(encoding="utf-8")
        assert "sealed.json" not in text and "SEALED" not in text, path
        if path.name != "__main__.py":
            assert "hidden_trials" not in text and "hidden_score" not in text, path


WATCH = """
import json, sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
from fishmj.gap.calibrate.__main__ import main
from fishmj.gap.calibrate.calibration_logs import read
read(sys.argv[1])
for verb in ("mass", "slip"):
    main([verb, "--data", sys.argv[1], "--report", sys.argv[2]])
print(json.dumps({"sealed": [p for p in opened if "sealed" in p], "trials": sum("meta.toml" in p for p in opened)}))
"""


def test_calibration_does_not_open_the_sealed_file(tmp_path: Path):
    command = [sys.executable, "-c", WATCH, str(SHIPPED), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["sealed"] == [] and found["trials"] > 20


def test_score_compares_fitted_with_sealed(tmp_path: Path):
    folder = tmp_path / "trials"
    folder.mkdir()
    calibration_trials.seal(folder, SEED, {"kp": 8.0, "kd": 0.3}, {})
    out = tmp_path / "fish.toml"
    e = ParameterEstimate("kp", "N m/rad", 8.4, 8.1, 8.7, 0.1, "trials")
    calibrated_model.write(out, calibrated_model.start(out, "fish"), "servo", {"kp": e}, {}, "here")
    (row,) = sealed_score.score(folder, str(out))
    assert row["error %"] == pytest.approx(5.0) and row["inside"] == "no"
    assert read_json(folder / "sealed.json")["values"]["kp"] == 8.0


def test_robots_that_were_checked_are_not_checked_again(tmp_path, monkeypatch, capsys):
    done, said = [], []

    def one(true, logs, plant):
        if len(done) == 2 and not said:
            said.append(interrupt._kept[-1][0]())
            raise KeyboardInterrupt
        done.append(true["kp"])
        return {"kp": [0.1 * len(done), 10.0, True]}

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(commands, "check_one", one)
    monkeypatch.setattr(calibration_trials, "trials", lambda seed: {})
    with pytest.raises(KeyboardInterrupt):
        command.drawn(["--robots", "3"])
    assert said == [f"{command.CHECKED} holds 2 of 3 robots; go on with the same command"]
    assert command.drawn(["--robots", "3", "--json"]) == 0 and len(done) == len(set(done)) == 3
    (row,) = json.loads(capsys.readouterr().out.splitlines()[-1])["check"]
    assert row["robots"] == 3 and row["mean error"] == pytest.approx(0.2) and row["inside"] == 1.0
