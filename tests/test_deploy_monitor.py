"""The monitor: what is known of its statistics, that it keeps quiet over a healthy robot, and that it names what parted."""

import json
import subprocess
import sys

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, LogError
from fishmj.deploy.commands import monitor_command
from fishmj.deploy.commands.monitor_command import drawn
from fishmj.deploy.monitor.monitor import BLOCK, Blocks, Monitor, reference_of, said
from fishmj.deploy.monitor.statistics import Cusums, learn, long_run_deviation, run_length, threshold
from fishmj.log import Trial, write_trial
from fishmj.mjcf.reading import load_robot
from studies.monitor.side_by_side import blocks_of
from studies.monitor.swims import swim

FLOW = (0.15, np.pi)
META = {"origin": "synthetic", "robot": "fish", "flow": {"speed": FLOW[0], "direction": FLOW[1], "known": True}}


def up_to(tables, end, begin=0.0):
    return {n: {c: v[(t["t"] >= begin) & (t["t"] < end)] for c, v in t.items()} for n, t in tables.items() if n != "truth"}


@pytest.fixture(scope="module")
def healthy():
    return swim(7, 1, 90.0, speed=FLOW[0])


@pytest.fixture(scope="module")
def reference(healthy):
    return reference_of(load_robot("fish"), [Trial(META, up_to(healthy, 90.0))])


@pytest.fixture(scope="module")
def struck():
    return swim(7, 2, 46.0, {"torque_saturation": {"limit": 0.7}}, at=18.0, speed=FLOW[0])


def test_the_mean_run_of_a_cusum_is_siegmunds():
    rng, h, k = np.random.default_rng(1), 3.0, 0.5
    level, length = np.zeros(4000), np.zeros(4000)
    alive = np.ones(4000, bool)
    for step in range(1, 3000):
        level = np.maximum(0.0, level + rng.standard_normal(4000) - k)
        ended = alive & (level >= h)
        length[ended], alive = step, alive & ~ended
    length[alive] = 3000
    assert length.mean() == pytest.approx(run_length(h, k), rel=0.06)


def test_the_threshold_is_where_the_run_is_as_long_as_asked():
    for blocks in (100.0, 1e4, 1e6):
        assert run_length(threshold(blocks)) == pytest.approx(blocks, rel=1e-6)
    with pytest.raises(ConfigError, match="expected at least"):
        threshold(1.0)


def test_the_deviation_of_correlated_blocks_is_that_of_the_long_run():
    rng, phi, x = np.random.default_rng(2), 0.5, np.zeros(40_000)
    for i, e in enumerate(rng.standard_normal(len(x) - 1)):
        x[i + 1] = phi * x[i] + e
    assert long_run_deviation(x) == pytest.approx(1 / (1 - phi), rel=0.12)
    assert long_run_deviation(-np.resize([1.0, -1.0], 100)) == pytest.approx(1.0)  # never below the blocks' own


def test_cusums_stay_low_on_reference_blocks_and_name_a_new_coefficient():
    rng = np.random.default_rng(3)

    def block(coefficient):
        phi = np.stack([np.ones(100), np.sin(np.arange(100) + rng.uniform(0, 6))], 1)
        return {"j1": (0.01 * rng.standard_normal(100) + phi @ [0.002, coefficient], phi)}

    known = learn([block(0.01) for _ in range(200)], {"j1": ("offset", "rate")})
    assert known.tests == 6 and known.channels["j1"].weight == pytest.approx([0.002, 0.01], abs=5e-4)
    quiet = Cusums(known, 0.1, BLOCK)
    for _ in range(2000):
        quiet.take(block(0.01))
        assert quiet.share()["j1"] < 1.0
    parted = Cusums(known, 0.1, BLOCK)
    for _ in range(19):
        parted.take(block(0.004))
    assert parted.parted() == "j1" and parted.highest("j1") == ("rate", -1)


def test_monitor_is_silent_on_a_healthy_robot_and_detects_a_weak_servo(reference, struck):
    monitor = Monitor(load_robot("fish"), FLOW, reference=reference)
    assert monitor.update(up_to(struck, 18.0)) == [] and monitor.settled
    found = monitor.update(up_to(struck, 46.0, begin=18.0))
    assert found and 18.0 < found[0].t < 46.0 and found[0].channel in ("j1", "j2", "j3")
    assert "fishmj gap find" in said(found[0])
    picture = drawn("a <swim>", monitor.history, monitor.alarms)
    assert picture.startswith("<svg") and "a &lt;swim&gt;" in picture and picture.count("<polyline") == 7


def test_rows_that_come_one_by_one_give_the_blocks_of_the_whole_log(healthy):
    robot, part = load_robot("fish"), up_to(healthy, 10.5)
    whole = list(Blocks(robot, FLOW).take(part))
    drop = Blocks(robot, FLOW)
    pieces = [b for k in range(150) for b in drop.take(up_to(part, 0.07 * (k + 1), begin=0.07 * k))]
    assert len(whole) == len(pieces) == 2
    for (t, one), (s, other) in zip(whole, pieces, strict=True):
        assert t == s
        for name in one:
            np.testing.assert_allclose(one[name][0], other[name][0], atol=1e-9)


@pytest.mark.slow
def test_many_swims_side_by_side_are_predicted_as_each_alone(healthy, struck):
    robot = load_robot("fish")
    parts = [up_to(tables, 8.5) for tables in (healthy, struck)]
    for part, many in zip(parts, blocks_of(robot, parts, [FLOW, FLOW]), strict=True):
        alone = list(Blocks(robot, FLOW).take(part))
        assert len(alone) == len(many) == 1
        for (t, one), (s, other) in zip(alone, many, strict=True):
            assert t == s
            for name in one:
                np.testing.assert_allclose(one[name][0], other[name][0], rtol=1e-5, atol=1e-7)
                np.testing.assert_allclose(one[name][1], other[name][1], rtol=1e-4, atol=1e-6)


def test_behind_a_pause_the_model_begins_anew(healthy):
    rows = up_to(healthy, 17.0)
    for name in ("joint", "pose", "power"):
        keep = (rows[name]["t"] < 4.0) | (rows[name]["t"] > 6.0)
        rows[name] = {c: v[keep] for c, v in rows[name].items()}
    ends = [t for t, _ in Blocks(load_robot("fish"), FLOW).take(rows)]
    assert ends and not [t for t in ends if t < 14.0]  # the run-in again, then whole blocks


def test_a_monitor_that_cannot_know_the_healthy_robot_is_refused(reference):
    robot = load_robot("fish")
    with pytest.raises(ConfigError, match="at least 80 s, or a healthy log"):
        Monitor(robot, settle=10.0)
    with pytest.raises(ConfigError, match="record the same tables"):
        Monitor(robot, reference=reference, power=False)
    with pytest.raises(ConfigError, match="expected a positive number"):
        Cusums(reference, 0.0, BLOCK)
    with pytest.raises(ConfigError, match="60 s of healthy swimming to learn from, .*; expected at least 80 s"):
        learn([{}] * 30, {})


@pytest.mark.slow
def test_the_command_tells_of_a_trial_folder(tmp_path, healthy, struck, capsys):
    for name, tables in (("well", healthy), ("weak", struck)):
        write_trial(tmp_path / name, Trial(META, up_to(tables, 90.0)))
    picture = tmp_path / "p.svg"
    words = [str(tmp_path / "weak"), "--healthy", str(tmp_path / "well"), "--picture", str(picture), "--json"]
    assert monitor_command.main(words) == 1
    out = capsys.readouterr().out
    told = json.loads(out.splitlines()[-1])["trials"][0]
    assert told["alarms"] >= 1 and told["channel"].startswith("j") and told["first_s"] > 18.0
    assert "robot and model part" in out and picture.read_text().startswith("<svg")


def test_the_command_says_what_it_needs(tmp_path, healthy, capsys):
    cut = up_to(healthy, 12.0)
    write_trial(tmp_path / "short", Trial(META, cut))
    assert monitor_command.main([str(tmp_path / "short")]) == 3
    said = capsys.readouterr().err
    assert "nothing was watched" in said and "the log is of robot" not in said
    for other, words in (({"robot": "pike"}, "robot 'pike', the"), ({"body_sha256": "0" * 64}, "robot 'fish' of another body")):
        write_trial(tmp_path / "other", Trial(META | other, cut), overwrite=True)
        assert monitor_command.main([str(tmp_path / "other")]) == 3
        assert f"the log is of {words}" in capsys.readouterr().err
    two = {**cut, "joint": {key: column for key, column in cut["joint"].items() if key != "j3"}}
    write_trial(tmp_path / "two", Trial(META, two))
    with pytest.raises(LogError, match="table joint has 2 joints, the model 'swift' has 3; name its own robot with --robot"):
        monitor_command.main([str(tmp_path / "two")])
    write_trial(tmp_path / "deaf", Trial(META, {"pose": cut["pose"]}))
    with pytest.raises(LogError, match="no table cmd, joint"):
        monitor_command.main([str(tmp_path / "deaf")])


def test_the_monitor_needs_no_heavy_package():
    code = "import sys; import fishmj.deploy.commands.monitor_command; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"jax", "mujoco", "numba", "warp", "scipy", "matplotlib", "torch", "dm_control"}
    assert heavy.isdisjoint(done.stdout.split())
