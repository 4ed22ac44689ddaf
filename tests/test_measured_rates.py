"""Measured velocities and rates of turn that contradict the pose, and positions that are too small for the swing of the head."""

from dataclasses import replace

import lab_files
import numpy as np
import pytest

from fishmj import log
from fishmj.base.calib import calib_folder
from fishmj.log import physical_checks
from fishmj.log.trial import Trial, numbered
from fishmj.mjcf.reading import load_robot

LENGTH = load_robot("fish").length
CHECKS = ("velocity", "turning", "sway")


def swim(seed: int = 0, water: bool = False, sway: bool = True, **meta) -> Trial:
    """A fish that beats, weaves and changes its pace in a random current; its velocity is over ground, or through the water."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, rng.uniform(8, 20), 0.02)
    phase = 2 * np.pi * rng.uniform(0.5, 1.2) * t
    current = rng.uniform(0, 0.4) * np.exp(1j * rng.uniform(-np.pi, np.pi))
    course = rng.uniform(-3, 3) + 0.7 * np.sin(2 * np.pi * t / 8)
    yaw = course + 0.2 * np.sin(phase)
    pace = 0.25 * (1 + 0.3 * np.sin(2 * np.pi * t / 7)) * np.exp(1j * course)
    aside = rng.uniform(0.04, 0.14) * LENGTH * 0.2 * np.sin(phase + rng.uniform(-3, 3)) * 1j * np.exp(1j * course)
    place = np.cumsum(pace + current) * 0.02 + aside
    body = (np.gradient(place, 0.02) - current * water) * np.exp(-1j * yaw)
    noise = lambda size: rng.normal(0, size, len(t))
    spin = np.gradient(yaw, 0.02)
    tables = {
        "joint": {"t": t, **numbered("j#", 0.4 * np.sin(phase[:, None] - np.arange(3)))},
        "pose": {"t": t, "x": place.real + noise(0.001), "y": place.imag + noise(0.001), "yaw": yaw + noise(0.01)},
        "velocity": {"t": t + 0.05, "surge": body.real + noise(0.02), "sway": body.imag + noise(0.02), "yaw_rate": spin},
        "imu": {"t": t + 0.05, "ax": 0 * t, "ay": 0 * t, "wz": rng.uniform(0.7, 1) * spin + noise(0.05)},
    }
    if not sway:
        del tables["velocity"]["sway"]
    return Trial({"origin": "measured", **meta}, tables, name="swim")


def changed(trial: Trial, table: str, **columns) -> Trial:
    return replace(trial, tables={**trial.tables, table: {**trial.tables[table], **columns}})


def notes_of(trial: Trial) -> list[str]:
    """Texts of the findings, all of which are notes."""
    found = physical_checks.examine(trial, CHECKS, LENGTH)
    assert all(finding.level == physical_checks.NOTE for finding in found)
    return [finding.text for finding in found]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sway", [True, False])
@pytest.mark.parametrize(
    ("times", "words"), [(100.0, "in cm/s, read as m/s"), (0.01, "in m/s, read as cm/s"), (3.6 / 1.852, "in kn, read as m/s")]
)
def test_a_velocity_of_another_scale_is_told_with_its_unit(seed, sway, times, words):
    trial = swim(seed, water=seed == 1, sway=sway)
    names = [name for name in ("surge", "sway") if name in trial.tables["velocity"]]
    (text,) = notes_of(changed(trial, "velocity", **{name: times * trial.tables["velocity"][name] for name in names}))
    assert words in text and "columns.surge" in text and f'unit = "{words.split()[1].rstrip(",")}"' in text


def test_a_velocity_in_other_axes_is_told_with_the_ones_that_fit():
    trial = swim(2)
    surge, sway, yaw = trial.tables["velocity"]["surge"], trial.tables["velocity"]["sway"], trial.tables["pose"]["yaw"]
    world = (surge + 1j * sway) * np.exp(1j * yaw)
    for one, two, words in (
        (-surge, -sway, "read surge, sway from -surge, -sway"),
        (surge, -sway, "read surge, sway from surge, -sway"),
        (sway, surge, "read surge, sway from sway, surge"),
        (sway, -surge, "read surge, sway from -sway, surge"),
        (world.real, world.imag, "along x and y of the tank"),
    ):
        (text,) = notes_of(changed(trial, "velocity", surge=one, sway=two))
        assert words in text
    assert "from -surge" in notes_of(changed(swim(2, sway=False), "velocity", surge=-surge))[0]


@pytest.mark.parametrize(("table", "name"), [("velocity", "yaw_rate"), ("imu", "wz")])
def test_a_rate_of_turn_in_degrees_or_against_the_heading_is_told(table, name):
    trial = swim(1)
    rate = trial.tables[table][name]
    for values, words in (
        (np.degrees(rate), 'unit = "deg/s"'),
        (np.radians(rate), "in rad/s, read as deg/s"),
        (-rate, "sign = -1"),
    ):
        (text,) = notes_of(changed(trial, table, **{name: values}))
        assert words in text and f"{table}: {name}" in text


def test_a_trial_that_allows_it_is_not_doubted():
    trial = swim(1, plausible={"agree": 200.0})
    for times in (100.0, -1.0):
        surge, sway, rate = (times * trial.tables["velocity"][name] for name in ("surge", "sway", "yaw_rate"))
        wrong = changed(trial, "velocity", surge=surge, sway=sway, yaw_rate=rate)
        assert notes_of(wrong) == [] and len(notes_of(replace(wrong, meta={"origin": "measured"}))) == 2


def scaled(trial: Trial, times: float) -> Trial:
    pose = trial.tables["pose"]
    return changed(trial, "pose", **{name: times * np.asarray(pose[name], float) for name in "xy"})


@pytest.mark.parametrize("times", [0.1, 0.01, 0.001])
def test_positions_that_are_too_small_are_told_by_the_sway_of_the_body(times):
    trials = [trial for trial in log.read_dataset(calib_folder() / "trials") if "pose" in trial.tables]
    found = [notes_of(scaled(trial, times)) for trial in trials]
    assert sum(map(len, found)) == 15  # all that beat before a camera
    assert all("are x and y too small" in text for texts in found for text in texts)
    assert not any(map(notes_of, trials))


def test_a_fish_that_is_held_or_holds_station_is_not_taken_for_a_small_scale():
    trial = log.read_trial(calib_folder() / "trials" / "swim_gait_1")
    pose, rng = trial.tables["pose"], np.random.default_rng(3)
    t, yaw = np.asarray(pose["t"], float), np.asarray(pose["yaw"], float)
    noise = [rng.normal(0, 0.0005, len(t)) for _ in "xy"]
    assert notes_of(changed(trial, "pose", x=noise[0], y=noise[1])) == []  # on a pin about which it turns
    assert notes_of(changed(trial, "pose", x=noise[0], y=noise[1], yaw=0 * yaw)) == []  # on a stand
    x, y = (np.asarray(pose[name], float) for name in "xy")
    line = [np.polyval(np.polyfit(t, v, 1), t) for v in (x, y)]
    assert notes_of(changed(trial, "pose", x=x - line[0], y=y - line[1])) == []  # in an unstated stream


@pytest.mark.parametrize("water", [False, True])
def test_sound_logs_in_random_currents_raise_no_alarm(water):
    assert [text for seed in range(40) for text in notes_of(swim(seed, water=water, sway=seed % 3 > 0))] == []


def steady(times: float, water: bool = False, current: complex = 0.0, beats: float = 0.4, **flow) -> list[str]:
    """Notes on a fish that swims straight at one pace; its velocity is `times` the true one, over ground or through the water."""
    t = np.arange(0, 20, 0.02)
    yaw, aside = 0.5 + 0.1 * np.sin(6 * t), 0.004 * np.sin(6 * t + 1) * np.exp(2.07j)
    place = (0.2 * np.exp(0.5j) + current) * t + aside
    body = times * (np.gradient(place, 0.02) - current * water) * np.exp(-1j * yaw)
    tables = {
        "joint": {"t": t, "j1": beats * np.sin(6 * t), "j2": beats * np.sin(6 * t - 1)},
        "pose": {"t": t, "x": place.real, "y": place.imag, "yaw": yaw},
        "velocity": {"t": t, "surge": body.real, "sway": body.imag},
    }
    return [f.text for f in physical_checks.examine(Trial({"flow": flow} if flow else {}, tables), ["velocity"])]


STILL = {"speed": 0.0, "direction": 0.0, "known": True}
STREAM = {"speed": 0.15, "direction": 1.0, "known": True}


def test_the_velocity_of_a_steady_swim_is_judged_by_its_mean_where_the_water_is_known():
    for times, words in ((0.5, "0.5 times"), (0.01, "in m/s, read as cm/s"), (2.0, "2 times"), (100.0, "in cm/s, read as m/s")):
        (text,) = steady(times, **STILL)
        assert words in text
    assert "read as cm/s" in steady(0.01, current=0.15 * np.exp(1j), **STREAM)[0]
    for water in (False, True):  # over ground, and through the water
        for times in (0.7, 1.0, 1.4):
            assert steady(times, **STILL) == []
        assert steady(1.0, water, 0.15 * np.exp(1j), **STREAM) == []


STREAMS = (0.3 * np.exp(0.5j), -0.19 * np.exp(0.5j), 0.15j)


def test_the_velocity_of_a_steady_swim_in_unstated_water_asks_for_the_water():
    """Half the way may be the stream's; a hundredth of it is no velocity of a fish that beats, but of one that drifts."""
    assert "in m/s, read as cm/s" in steady(0.01)[0]
    for times, off in ((0.5, "0.1"), (2.0, "0.2"), (-1.0, "0.4")):
        *against, text = steady(times)
        assert f"by a steady {off} m/s" in text and "a stream that is not stated, or of another scale or sign" in text
        assert len(against) == (times < 0) and all("sway runs against" in told for told in against)
        assert steady(times, speed=0.0, direction=0.0, known=False) == against  # of a stream that is said to be unknown
    assert "a stream that is not stated" in steady(0.01, beats=0.0)[0]
    for stream in STREAMS:
        assert "a stream that is not stated" in steady(1.0, True, stream)[0]
        size, bearing = abs(stream), float(np.angle(stream))
        assert steady(1.0, True, stream, speed=size, direction=bearing, known=True) == steady(1.0, False, stream) == []
    assert steady(0.7) == steady(1.4) == []
    assert "by a steady 0.4 m/s" in steady(-1.0, **STILL)[-1]


def moving(pace, course, times: complex = 1.0, aside: float = 1.0, sway: bool = True) -> list[str]:
    """Notes on a fish that beats at a pace (T,) m/s on a course (T,) rad, in a stream of which nothing is stated.

    Its velocity is through the water, `times` the true one, and its sway is multiplied by `aside`, too.
    """
    t, rng = T, np.random.default_rng(4)
    beat = np.minimum(pace / 0.2, 1)
    yaw, phase = course + 0.1 * beat * np.sin(6 * t), 0.005 * beat * np.sin(6 * t + 1)
    way = np.cumsum(pace * np.exp(1j * course)) * 0.02 + phase * 1j * np.exp(1j * course)
    body = times * np.gradient(way, 0.02) * np.exp(-1j * yaw)
    noise, place = lambda size: rng.normal(0, size, len(t)), way + 0.05 * np.exp(1j) * t
    tables = {
        "joint": {"t": t, "j1": 0.4 * beat * np.sin(6 * t), "j2": 0.4 * beat * np.sin(6 * t - 1)},
        "pose": {"t": t, "x": place.real + noise(0.001), "y": place.imag + noise(0.001), "yaw": yaw + noise(0.01)},
        "velocity": {"t": t + 0.05, "surge": body.real + noise(0.01), "sway": aside * body.imag + noise(0.01)},
    }
    if not sway:
        del tables["velocity"]["sway"]
    return [f.text for f in physical_checks.examine(Trial({}, tables), ["velocity"])]


T = np.arange(0, 20, 0.02)
STEADY, AHEAD = 0 * T + 0.2, 0 * T + 0.5
SWIMS = {
    "start": (0.2 * np.clip((T - 5) / 2, 0, 1), AHEAD),
    "stop": (0.2 * np.clip((15 - T) / 2, 0, 1), AHEAD),
    "turn": (STEADY, 1.5 * np.clip((T - 8) / 4, 0, 1)),
    "circle": (STEADY, 0.3 * T),
}


@pytest.mark.parametrize("sway", [True, False])
@pytest.mark.parametrize("name", SWIMS)
def test_a_change_of_pace_or_heading_tells_the_scale_of_a_velocity_from_a_stream(name, sway):
    """A surge alone is judged, too: the part of a stream along the body changes with the heading."""
    pace, course = SWIMS[name]
    for times, words in (
        (0.5, "times the motion of x and y"),
        (2.0, "times the motion"),
        (-1.0, "in other axes: in the map read"),
    ):
        (text,) = moving(pace, course, times, sway=sway)
        assert words in text
    assert moving(pace, course, sway=sway) == []


@pytest.mark.parametrize("name", ["steady", *SWIMS])
def test_a_sway_of_the_wrong_sign_is_told_by_the_beat(name):
    pace, course = SWIMS.get(name, (STEADY, AHEAD))
    (text,) = moving(pace, course, aside=-1.0)
    assert "sway runs against the pose in each beat" in text and "columns.sway sign = -1" in text


@pytest.mark.parametrize("water", [False, True])
def test_sound_logs_in_known_currents_raise_no_alarm(water):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rng.uniform(size=2)
        size, bearing = rng.uniform(0, 0.4), rng.uniform(-np.pi, np.pi)  # those of the swim
        assert (
            notes_of(swim(seed, water=water, sway=seed % 3 > 0, flow={"speed": size, "direction": bearing, "known": True})) == []
        )


def test_import_notes_a_velocity_in_centimetres(tmp_path, capsys, monkeypatch):
    bring, trial = lab_files.importer(tmp_path, capsys, monkeypatch), swim(0)
    pose, velocity, joint = (trial.tables[name] for name in ("pose", "velocity", "joint"))
    columns = {"time_s": pose["t"], **{f"measured{k}_rad": joint[f"j{k}"] for k in (1, 2, 3)}}
    columns |= {"x_m": pose["x"], "y_m": pose["y"], "yaw_rad": pose["yaw"]}
    for name, times, count in (("sound", 1, 0), ("cm", 50, 1)):
        speeds = {"surge_m_s": times * velocity["surge"], "sway_m_s": times * velocity["sway"]}
        lab_files.write(tmp_path / f"{name}.csv", {**columns, **speeds})
        sets = [word for k in ("surge", "sway") for word in ("--set", f"{k}_m_s=velocity.{k}:m/s")]
        code, text, err = bring(tmp_path / f"{name}.csv", "--yes", *sets, out=tmp_path / f"out_{name}")
        assert code == 0 and text.count("times the motion of x and y") == count, err + text
