"""The importers and audits on real recordings, found through FISHMJ_MEASURED; figures stand in docs/search/measured_robots.md."""

import os
from pathlib import Path

import numpy as np
import pytest

from fishmj import log
from fishmj.base.store import sha256
from fishmj.gap.measured import fetch
from fishmj.log import importers, regimes, replicates, timebase

ROOT = Path(os.environ.get("FISHMJ_MEASURED", ""))
pytestmark = pytest.mark.skipif(
    not os.environ.get("FISHMJ_MEASURED"), reason="set FISHMJ_MEASURED to the folder of measured data"
)
COUNTS = {"tail_fish": 54, "servo_xl330": 12, "tendon_fish_markers": 4, "usv_coastdown": 6}


def folder(name):
    if not (ROOT / name).is_dir():
        pytest.skip(f"{ROOT} holds no {name}; get it with `gap fetch {name}`")
    return ROOT / name


@pytest.fixture(scope="module")
def trials():
    cache = {}

    def load(name):
        return cache.setdefault(name, importers.read(folder(name)))

    return load


@pytest.mark.parametrize("name", COUNTS)
def test_measured_sets_are_recognised_read_and_written(name, trials, tmp_path):
    assert importers.sniff(folder(name)) == name
    found = trials(name)
    assert len(found) >= COUNTS[name]  # a fuller copy of the source has more
    few = dict(list(found.items())[:3])
    for back in log.read_dataset(log.write_dataset(tmp_path / "set", few)):
        for table, columns in few[back.name].tables.items():
            assert all(np.array_equal(values, back.tables[table][column]) for column, values in columns.items())


@pytest.mark.parametrize("name", COUNTS)
def test_measured_files_have_the_sums_that_fetch_pins(name):
    there = [pin for pin in fetch.public_set(name).files if (folder(name) / pin.path).is_file()]
    assert there and all(sha256(folder(name) / pin.path) == pin.sha256 for pin in there)


def test_the_video_clock_of_the_tail_fish_runs_twice_too_fast(trials):
    """The commanded beat is 1 Hz. In video time it is 1.9 to 2.3 Hz, and it is faster where the control loop was slower."""
    beats, ratios = [], []
    for trial in trials("tail_fish").values():
        if "gait" not in trial.tables or len(trial.tables["velocity"]["t"]) < 100:
            continue
        t, rate = (trial.tables["velocity"][c] for c in ("t", "yaw_rate"))
        wiggle = (rate - np.polyval(np.polyfit(t, rate, 2), t)) * np.hanning(len(t))
        hertz = np.linspace(1, 4, 400)
        beats.append(hertz[np.abs(np.exp(-2j * np.pi * hertz[:, None] * t) @ wiggle).argmax()])
        ratios.append(30 / timebase.clock_of("gait", trial.tables["gait"]).rate)
    assert len(beats) > 40 and 1.8 < min(beats) and max(beats) < 2.4
    assert np.corrcoef(beats, ratios)[0, 1] > 0.8
    assert np.median(np.array(beats) / ratios) == pytest.approx(0.93, abs=0.02)  # Hz of the beat in control time
    audit = timebase.audit(trials("tail_fish")["amp15_bias-20_1"])
    assert any("may run 2.3" in finding for finding in audit.findings)


def test_tail_fish_velocities_are_those_of_its_poses(trials):
    trial = trials("tail_fish")["amp20_bias0_1"]
    lag = timebase.audit(trial).lags[0]
    assert (lag.earlier, lag.later) == ("pose", "velocity") and abs(lag.lag) < 0.002 and lag.correlation > 0.97


def test_tail_fish_has_two_runs_of_every_condition(trials):
    groups = replicates.groups(trials("tail_fish").values())
    assert len(groups) == 27 and all(len(members) >= 2 for members in groups.values())
    group = replicates.scatter("amp15_bias-20", groups["amp15_bias-20"])
    assert 0.002 < group.channel("surge").floor < 0.03


def test_the_servo_bus_slows_down_when_torque_is_on_and_loses_nothing(trials):
    for trial in trials("servo_xl330").values():
        clock = timebase.clock_of("joint", trial.tables["joint"])
        assert 180 < clock.rate < 290 and clock.dropped == 0 and not clock.counted
        load, on = trial.tables["joint"]["load1"], trial.tables["cmd"]["on1"]
        assert np.abs(load).max() <= 0.886 and (on.min() == 0) == trial.value("rig.trajectory").startswith("lift")


def test_the_boat_speed_is_a_sawtooth_and_its_fixes_come_once_a_second(trials):
    for trial in trials("usv_coastdown").values():
        t, surge = (trial.tables["velocity"][c] for c in ("t", "surge"))
        resets = t[1:][np.diff(surge) < -1]
        assert len(resets) > 5 and np.median(np.diff(resets)) == pytest.approx(1.0, abs=0.1)


def test_the_tendon_fish_swims_at_the_known_speeds(trials):
    for name, speed in {"f0_50": 0.023, "f1_00": 0.081, "f1_50": 0.130, "f2_00": 0.202}.items():
        pose = trials("tendon_fish_markers")[name].tables["pose"]
        gone = np.hypot(pose["x"][-1] - pose["x"][0], pose["y"][-1] - pose["y"][0]) / pose["t"][-1]
        assert gone == pytest.approx(speed, rel=0.15)


@pytest.mark.parametrize("name", COUNTS)
def test_regimes_can_be_told_on_every_measured_trial(name, trials):
    for trial in list(trials(name).values())[:6]:
        found = regimes.label(trial)
        assert len(found) >= 3 and found.known
