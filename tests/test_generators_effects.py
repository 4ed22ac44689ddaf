"""What the generators hide: effects of the catalogue in formulas of their own, faults outside it, and how well they show."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.cli import main
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.generators import effect_catalogue
from fishmj.gap.laboratory.generators.detectability import SensedChannels, at, channels, shares, spreads, tolerance
from fishmj.gap.laboratory.generators.generator_trials import robot_of, weight
from fishmj.gap.laboratory.generators.lab_sensors import sigmas
from fishmj.gap.laboratory.generators.mujoco_robot import RobotSimulation
from fishmj.log import excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.reading import load_robot

BEAT = Excitation(
    id="beat", start=(0.4, -0.3, 0.2), commands=excitation.get("turn_left").commands[:230], about="4.6 s of a turning beat"
)
NAMES = sorted(effect_catalogue.hidden())
SECOND = (  # planted alike in both robots: mostly the same in the named channel; a correlation, whatever the water
    *(("coulomb_friction", "joint"), ("viscous_friction", "joint"), ("servo_gain", "joint"), ("torque_saturation", "joint")),
    *(("skin_stiffness", "joint"), ("servo_deadband", "joint"), ("command_gain_error", "joint"), ("rate_limit", "joint")),
    *(("move_time_ramp", "joint"), ("command_quantisation", "joint"), ("voltage_sag", "joint"), ("thermal_derating", "joint")),
    *(("command_latency", "joint"), ("joint_sensor_delay", "joint"), ("camera_latency", "pose"), ("clock_offset", "pose")),
    *(("yaw_inertia", "pose"), ("yaw_added_mass", "pose"), ("com_offset", "pose"), ("steady_current", "pose")),
    *(("tether", "pose"), ("camera_scale", "pose"), ("camera_yaw", "pose"), ("heading_marker_offset", "pose")),
    *(("marker_offset", "pose"), ("lens_distortion", "pose"), ("power_offset", "power"), ("linear_surge_drag", "pose")),
    *(("quadratic_drag", "pose"), ("yaw_drag", "pose"), ("joint_zero_offset", "pose"), ("body_lift", "pose")),
)
SET = {
    "tether": {"stiffness": 0.4, "x": 0.5, "y": 0.7},
    "joint_zero_offset": {"offset1": 0.06, "offset2": -0.04, "offset3": 0.05},
}


def values_of(name: str) -> dict[str, float]:
    """Values of typical size."""
    hidden = effect_catalogue.hidden()[name]
    far = lambda p: max(p.typical, key=lambda size: abs(size - p.null))
    return SET.get(name) or {p.name: p.null if p.shape else far(p) for p in hidden.parameters}


def seen(family: str, hidden: dict, runs=(BEAT,), **given) -> list[SensedChannels]:
    """Channels without noise."""
    sigma = sigmas(robot_of(family, {}, 3), 1.0)
    return [s for t in generators.generate(family, hidden, runs, 3, 0.0, 0.0, **given) for s in channels(t, sigma)]


@pytest.fixture(scope="module")
def plain() -> list[SensedChannels]:
    return seen("morison", {})


def test_there_are_enough_of_both_kinds():
    hidden = effect_catalogue.hidden().values()
    assert sum(h.catalogued for h in hidden) >= 12 and sum(not h.catalogued for h in hidden) >= 8
    assert all(set(h.nulls) == {p.name for p in effects.get(h.name).parameters} for h in hidden if h.catalogued)
    assert {h.name for h in hidden if not h.catalogued}.isdisjoint(effects.catalogue())


@pytest.mark.parametrize("name", NAMES)
def test_at_its_null_it_is_not_there_to_the_last_bit(name, plain):
    nulls = effect_catalogue.hidden()[name].nulls
    for a, b in zip(seen("morison", {name: nulls}), plain, strict=True):
        assert np.array_equal(a.values, b.values) and np.array_equal(a.t, b.t)


@pytest.mark.parametrize("name", NAMES)
def test_at_typical_size_it_shows(name, plain):
    found = seen("morison", {name: values_of(name)})
    size = max(
        float(np.sqrt(np.mean(((at(a, b.t) - b.values) / b.sigma) ** 2, axis=0)).max()) for a, b in zip(found, plain, strict=True)
    )
    assert size > (0.3 if name in ("thermal_derating", "packet_loss", "surge_added_mass") else 0.8)  # of one sample's noise


@pytest.mark.slow
def test_the_second_robot_answers_alike():
    """Signs and conventions: two sets of equations from two hands move the same channel the same way."""
    from fishmj.gap.laboratory.virtual_robot import EFFECTS, generate

    whole = map(excitation.get, ("gait", "turn_left", "steps", "tow_oblique", "slow_triangle"))
    runs = [replace(run, commands=run.commands[: len(run.commands) // 2]) for run in whole]
    sigma = sigmas(robot_of("morison", {}, 3), 1.0)
    second = lambda hidden: [s for t in generate(hidden, runs, 3, 0.0, 0.0) for s in channels(t, sigma)]
    mine, theirs = seen("morison", {}, runs), second({})
    for name, channel in SECOND:
        given = {k: v for k, v in values_of(name).items() if k in EFFECTS[name].nulls}
        here, there = seen("morison", {name: given}, runs), second({name: given})
        which = slice(("joint", "pose", "power").index(channel), None, 3)
        a = [(at(x, y.t) - y.values) / y.sigma for x, y in zip(here[which], mine[which], strict=True)]
        b = [(at(x, y.t) - at(z, y.t)) / y.sigma for x, z, y in zip(there[which], theirs[which], mine[which], strict=True)]
        one, two = (np.concatenate([part.ravel() for part in parts]) for parts in (a, b))
        alike = float(one @ two / np.sqrt((one @ one) * (two @ two)))
        assert alike > 0.6, (name, alike)
        assert 0.4 < float(np.sqrt(one @ one / (two @ two))) < 2.5, name


@pytest.mark.parametrize("name", ["loose_tail", "sloshing_ballast"])
def test_faults_that_add_a_joint_leave_the_sensors_theirs(name):
    trial = generators.generate("ellipsoid", {name: values_of(name)}, [BEAT], 3)[0]
    assert set(trial.table("joint")) == {"t", "j1", "j2", "j3"}


def test_a_text_is_understood():
    found = generators.parse(["coulomb_friction=0.1", "steady_current:x=0.02,y=0.01", "random_odd"], 5, "foil")
    assert found["coulomb_friction"] == {"torque": 0.1} and found["steady_current"] == {"x": 0.02, "y": 0.01}
    odd = next(name for name in found if name not in ("coulomb_friction", "steady_current"))
    assert not effect_catalogue.hidden()[odd].catalogued
    assert generators.parse(["random"], 5, "foil") == generators.parse(["random"], 5, "foil")


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("tail_normal_force=0.2", ConfigError, "generator foil cannot hide tail_normal_force"),
        ("coulom_friction", UnknownName, "coulomb_friction"),
        ("coulomb_friction=much", ConfigError, "no finite number"),
        ("coulomb_friction=5", ConfigError, "expected 0 to 0.8 N m"),
        ("coulomb_friction:strength=1", UnknownName, "parameter of coulomb_friction"),
        ("random=3", ConfigError, "give no value"),
    ],
)
def test_a_text_that_means_nothing_is_refused(text, error, says):
    with pytest.raises(error, match=says):
        generators.parse([text], 0, "foil")


def test_the_same_effect_twice_is_refused():
    with pytest.raises(ConfigError, match="given twice"):
        generators.parse(["body_mass=0.1", "body_mass=0.2"], 0, "foil")


def test_drawn_sizes_are_typical_and_of_either_sign():
    rng, hidden = np.random.default_rng(0), effect_catalogue.hidden()
    drawn = [hidden["camera_scale"].draw(rng)["scale"] for _ in range(200)]
    assert min(np.abs(drawn)) >= 0.01 and max(np.abs(drawn)) <= 0.04 and -0.2 < np.mean(np.sign(drawn)) < 0.2
    limits = [hidden["torque_saturation"].draw(rng)["limit"] for _ in range(100)]
    assert 0.8 - 1e-9 < min(limits) < 0.9 and 1.1 < max(limits) < 1.2 + 1e-9
    assert all(h.act is not None and h.draw(rng, 0.3) for h in hidden.values())


def test_what_shows_is_weighed_against_noise_and_against_healthy_robots():
    t = np.arange(4.0)
    plain, hidden = SensedChannels(t, np.zeros((4, 1)), np.array([0.5])), SensedChannels(t, np.full((4, 1), 2.0), np.array([0.5]))
    others = [SensedChannels(t, np.full((4, 1), v), np.array([0.5])) for v in (1.0, -1.0)]
    spread = spreads(others, plain)
    assert spread == pytest.approx(2.0)  # variance of 1 and -1 about their mean
    both, noise = shares([hidden], [plain], [spread])
    assert both == pytest.approx(4 / 2.25) and noise == pytest.approx(16.0)


def test_the_measure_grows_with_the_effect_and_ignores_the_noise_drawn():
    runs = [BEAT]
    measured = [
        generators.detectable("morison", {"command_latency": {"delay": d}}, runs, 3, healthy=3)["all"] for d in (0.01, 0.02, 0.04)
    ]
    assert measured[0] < measured[1] < measured[2] and measured[2] > 8 * measured[0]
    pair = {"command_latency": {"delay": 0.02}, "camera_scale": {"scale": 0.02}}
    both = generators.detectable("morison", pair, runs, 3, healthy=3)
    assert both["each"]["command_latency"] == pytest.approx(measured[1]) and both["noise_only"] > both["all"] > 0
    assert generators.detectable("morison", {}, runs, 3)["all"] == 0.0


def test_what_healthy_robots_differ_by_is_made_once(tmp_path, monkeypatch):
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path))
    first = tolerance("foil", BEAT, load_robot(), 0.1, 3)
    assert len(list((tmp_path / "generators").glob("*.npz"))) == 1 and [d.shape[1] for d in first] == [3, 3, 1]
    monkeypatch.setattr("fishmj.gap.laboratory.generators.generator_trials.generate", None)
    assert all(np.array_equal(a, b) for a, b in zip(first, tolerance("foil", BEAT, load_robot(), 0.1, 3), strict=True))
    late = len(first[1]) // 2
    assert first[1][late:].mean() > 10 * first[1][: late // 4].mean()  # paths of robots that differ drift apart


def test_gap_plant_writes_a_set_and_its_truth(tmp_path, capsys):
    out = tmp_path / "hidden"
    command = ["gap", "plant", "command_latency=0.04", "--generator", "ellipsoid", "--excitations", "tow_ahead", "--logs", "1"]
    assert main([*command, "--seed", "3", "--weigh", "--drop", "0.3", "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    truth = json.loads((tmp_path / "hidden.truth.json").read_text())
    assert told["generator"] == truth["generator"] == "ellipsoid" and truth["origin"] == "synthetic"
    assert truth["effects"] == {"command_latency": {"delay": 0.04}} and truth["detectable"]["bound"] == 5.0
    from fishmj.log import read_trial

    assert "fishmj.generators, ellipsoid" in (out / "measurements.toml").read_text()
    trial = read_trial(out / "01_tow_ahead")
    whole = generators.generate("ellipsoid", truth["effects"], ["tow_ahead"], 3)[0]
    for sensor in ("joint", "pose", "power"):
        kept = np.isin(whole.table(sensor)["t"], trial.table(sensor)["t"])
        assert 0.6 < kept.mean() < 0.8 and kept.sum() == len(trial.table(sensor)["t"])
    assert trial.meta["origin"] == "synthetic" and "latency" not in (out / "01_tow_ahead" / "meta.toml").read_text()


@pytest.mark.parametrize("name", ["sloshing_ballast", "loose_tail", "com_offset", "yaw_inertia", "body_mass"])
def test_a_weighing_says_what_the_robot_is(name):
    """Total, balance point and inertia of the description, and what an effect of mass does to them."""
    fish = load_robot()
    plain, found = (weight(RobotSimulation(robot_of("foil", hidden, 0))) for hidden in ({}, {name: values_of(name)}))
    assert plain.links.sum() == pytest.approx(fish.mass) and plain.balance == pytest.approx(geometry_of(fish).reference)
    more = {"body_mass": 0.3}.get(name, 0.0)
    assert found.links.sum() == pytest.approx(fish.mass + more)
    ahead = {"com_offset": 0.03 * fish.links[0].mass / fish.mass}.get(name, 0.0)
    assert plain.balance - found.balance == pytest.approx(ahead, abs=1e-9)
    turning = {"yaw_inertia": 0.008, "body_mass": plain.inertia * 0.3 / fish.mass}.get(name)
    if turning is not None:
        assert found.inertia - plain.inertia == pytest.approx(turning, rel=1e-6)


def test_instruments_err_by_what_they_state_and_keep_their_seed():
    pages = [generators.page("foil", {}, seed) for seed in range(30)]
    assert pages[3] == generators.page("foil", {}, 3)
    heads = np.array([p["scales"]["head"] for p in pages])
    assert heads.mean() == pytest.approx(0.744, abs=0.0005) and 0.0004 < heads.std() < 0.0015
    swings = np.array([p["pendulum"]["period"] for p in pages])
    true = weight(RobotSimulation(robot_of("foil", {}, 0)))
    inertia = swings.mean() ** 2 * true.links.sum() * 9.81 * 0.25**2 / (16 * np.pi**2 * 1.0)
    assert inertia == pytest.approx(true.inertia, rel=0.003)


def test_gap_plant_refuses_what_a_generator_has_not(tmp_path, capsys):
    out = str(tmp_path / "x")
    assert main(["gap", "plant", "crossflow_drag=0.2", "--generator", "foil", "--out", out]) == 2
    assert "cannot hide crossflow_drag" in capsys.readouterr().err
    assert main(["gap", "plant", "none", "--generator", "wing", "--out", out]) == 2
    assert "morison" in capsys.readouterr().err
