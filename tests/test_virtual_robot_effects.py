"""Every effect that can be hidden: nothing at its null, seen where it says, and nowhere in the other sensors' noise."""

from functools import cache
from math import pi

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory.virtual_robot import EFFECTS, generate, plant
from fishmj.gap.laboratory.virtual_robot.catalogue import CATALOGUE, ODDITIES
from fishmj.log.excitation import Excitation

SEED = 3
CHANNELS = {  # table, columns, noise of one sample
    "joint": ("joint", ("j1", "j2", "j3"), 0.00166),
    "position": ("pose", ("x", "y"), 0.002),
    "heading": ("pose", ("yaw",), 0.012),
    "velocity": ("pose", ("vx", "vy"), 0.02),
    "power": ("power", ("V", "I"), 0.015),
}


@cache
def plain(run, noise):
    return generate({}, [run], SEED, noise=noise)[0].tables


def shift(run, tables, channel):
    """Largest RMS change of a channel's columns over its noise."""
    table, columns, sigma = CHANNELS[channel]
    before, after = plain(run, 0.0)[table], tables[table]
    moved = [np.interp(before["t"], after["t"], after[c]) - before[c] for c in columns]
    return max(float(np.sqrt(np.mean(m**2))) for m in moved) / sigma


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_at_its_null_is_not_there_to_the_last_bit(name):
    effect = EFFECTS[name]
    run = effect.runs[0]
    tables = generate({name: effect.nulls}, [run], SEED)[0].tables
    for table, columns in plain(run, 1.0).items():
        for column, values in columns.items():
            assert np.array_equal(values, tables[table][column]), f"{table}.{column}"


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_typical_size_shows_where_it_says(name):
    effect = EFFECTS[name]
    seen = {run: generate({name: effect.typical}, [run], SEED, noise=0.0)[0].tables for run in effect.runs}
    for channel in effect.shows:
        assert max(shift(run, tables, channel) for run, tables in seen.items()) > 1.0, channel


def test_both_catalogues_say_the_same_of_every_effect():
    """The physics are two; name, stage, units, nulls and the channels are one fact written twice."""
    assert set(CATALOGUE) == {name for name, effect in effects.catalogue().items() if not effect.unplanted}
    for name, mine in CATALOGUE.items():
        theirs = effects.get(name)
        assert (mine.stage, mine.stochastic) == (theirs.stage, theirs.stochastic), name
        channels = {"velocity"} if "velocity" in theirs.delays else set(theirs.shows)
        assert set(mine.shows) <= channels, name  # in which it must show here, it may show there
        apart = []
        for p, q in zip(mine.parameters, theirs.parameters, strict=False):  # those that are planted come first
            assert (p.name, p.unit, p.null, p.default) == (q.name, q.unit, q.null, q.shape), name
            a, b = (sorted(abs(x - p.null) for x in typical) for typical in (p.typical, q.typical))
            apart += [p.name] if a[0] > b[1] or b[0] > a[1] else []
        assert bool(apart) == bool(theirs.planted), (name, apart)


def test_there_is_enough_outside_the_catalogue():
    assert len(ODDITIES) >= 10 and not set(ODDITIES) & set(CATALOGUE)
    fields = [p.field for e in EFFECTS.values() for p in e.parameters]
    assert len(set(fields)) == len(fields)  # no two effects share a constant


def test_every_null_is_the_robots_own_default():
    made = plant({}, nuisance=0.0)
    for effect in EFFECTS.values():
        for p in effect.parameters:
            group, _, key = p.field.partition(".")
            assert getattr(getattr(made, group), key) == p.null, p.field


def test_planting_a_camera_error_leaves_the_other_sensors_alone():
    run = "gait"
    tables = generate({"camera_scale": {"scale": 0.03}}, [run], SEED)[0].tables
    for table in ("cmd", "joint", "power"):
        assert all(np.array_equal(plain(run, 1.0)[table][c], tables[table][c]) for c in tables[table])


def test_drawn_values_are_of_typical_size():
    rng = np.random.default_rng(0)
    for effect in EFFECTS.values():
        for _ in range(20):
            for p, value in zip(effect.parameters, effect.draw(rng).values(), strict=True):
                low, high = sorted(p.typical)
                assert low <= abs(value) <= high and (p.signed or value > 0)


def test_even_strong_draws_are_possible():
    rng = np.random.default_rng(1)
    for effect in EFFECTS.values():
        for _ in range(20):
            effect.fields(effect.draw(rng, 5.0))
        effect.fields(effect.nulls)


def planted(run, noise=0.0, **effects):
    return generate({name: value for name, value in effects.items()}, [run], SEED, noise=noise)[0].tables


def test_latency_holds_joints_back_by_as_much_as_it_says():
    late, plain_ = planted("steps", command_latency={"delay": 0.04})["joint"], plain("steps", 0.0)["joint"]
    shifted = np.interp(plain_["t"] + 0.04, late["t"], late["j1"])
    assert np.sqrt(np.mean((shifted - plain_["j1"])[:-3] ** 2)) < 0.0015
    assert np.sqrt(np.mean((late["j1"] - plain_["j1"]) ** 2)) > 0.02


def test_a_zero_offset_bends_the_fish_and_the_joint_sensor_does_not_know():
    tables = planted("gait", joint_zero_offset={"offset1": 0.08})
    assert shift("gait", tables, "joint") < 2.0 < shift("gait", tables, "heading")


def test_a_current_takes_the_fish_along_and_never_overtakes_itself():
    pose = planted("drift_north", steady_current={"x": 0.03, "y": 0.0})["pose"]
    speeds = [np.polyfit(pose["t"][a], pose["x"][a], 1)[0] for a in (pose["t"] < 4, pose["t"] > 8)]
    assert 0.0 < speeds[0] < speeds[1] < 0.03
    fast = planted("drift_north", steady_current={"x": 0.3, "y": 0.0})["pose"]  # quadratic drag: soon as fast as the stream
    late = fast["t"] > 8
    assert np.polyfit(fast["t"][late], fast["x"][late], 1)[0] == pytest.approx(0.3, rel=0.1)


def test_a_swirl_turns_a_drifting_fish():
    float_ = Excitation(id="float", commands=np.zeros((600, 3)), about="in the middle of the swirl")
    pose = planted(float_, swirl={"rate": 0.5})["pose"]
    early, late = (np.polyfit(pose["t"][a], pose["yaw"][a], 1)[0] for a in (pose["t"] < 4, pose["t"] > 8))
    assert 0.0 < early < late < 0.5


def test_a_sagging_supply_sags():
    volts = planted("gait_fast", voltage_sag={"resistance": 1.0})["power"]
    amps = plain("gait_fast", 0.0)["power"]["I"]
    assert np.min(volts["V"]) < 7.4 - 0.5 * np.max(amps) and np.max(plain("gait_fast", 0.0)["power"]["V"]) < 7.41


def test_a_speed_limit_limits_speed():
    def fastest(tables):
        return np.max(np.abs(np.diff(tables["joint"]["j1"]) / np.diff(tables["joint"]["t"])))

    assert fastest(planted("steps", speed_limit={"slowness": 0.5})) < 1.05 * 2.0 < 0.6 * fastest(plain("steps", 0.0))


def test_lost_packets_leave_plateaus_of_the_joint():
    lossy = generate({"packet_loss": {"probability": 0.3}}, ["chirp"], SEED, noise=0.0)[0].tables["joint"]
    assert shift("chirp", {"joint": lossy}, "joint") > 5.0


def test_stochastic_effects_differ_between_replicates_and_others_do_not():
    for name, effect in CATALOGUE.items():
        if effect.stochastic or name == "steady_current":
            one, two = generate({name: effect.typical}, [effect.runs[0]] * 2, SEED, noise=0.0)
            same = all(np.array_equal(one.tables[t][c], two.tables[t][c]) for t in one.tables for c in one.tables[t])
            assert same != effect.stochastic, name


def test_a_marker_off_the_reference_point_sways_when_the_fish_spins():
    pose, centre = planted("spin", marker_offset={"x": 0.03})["pose"], plain("spin", 0.0)["pose"]
    apart = np.hypot(pose["x"] - centre["x"], pose["y"] - centre["y"])
    assert apart == pytest.approx(0.03, abs=1e-9)
    assert pose["x"] - centre["x"] == pytest.approx(0.03 * np.cos(centre["yaw"]), abs=1e-9)


def test_camera_yaw_turns_track_and_heading_marker_only_the_heading():
    turned, marked = planted("gait", camera_yaw={"angle": 0.05}), planted("gait", heading_marker_offset={"angle": 0.05})
    before = plain("gait", 0.0)["pose"]
    for tables in (turned, marked):
        assert tables["pose"]["yaw"] - before["yaw"] == pytest.approx(0.05, abs=1e-9)
    assert np.array_equal(marked["pose"]["x"], before["x"])
    assert np.arctan2(turned["pose"]["y"][0], -turned["pose"]["x"][0]) == pytest.approx(-0.05, abs=0.01)


def test_unknown_names_and_impossible_values_are_refused():
    with pytest.raises(UnknownName, match="Did you mean 'command_latency'"):
        plant({"command_latenzy": {}})
    with pytest.raises(UnknownName, match="parameter of tether"):
        plant({"tether": {"length": 1.0}})
    with pytest.raises(ConfigError, match="finite number in N/m"):
        plant({"tether": {"stiffness": float("nan")}})
    for name, values, expected in (
        ("crossflow_drag", {"gain": -1.2}, "a number from -0.9, unit 1"),
        ("servo_deadband", {"deadband": -0.1}, "a number from 0"),
        ("packet_loss", {"probability": 2.0}, "a number from 0 to 0.95"),
    ):
        with pytest.raises(ConfigError, match=expected):
            plant({name: values})
    assert plant({}).motor.range == pytest.approx(pi / 3)
