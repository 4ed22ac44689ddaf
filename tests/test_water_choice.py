"""One vocabulary of waters in every verb and function: what is chosen, what is said, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj import engines
from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.mjcf.identity import robot_sha256
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.relations import _no_water
from fishmj.sim import Sim
from fishmj.tasks.station_hold import draw_fish, n_fish
from fishmj.water import choice
from fishmj.water.choice import chosen, family_in, fitted_water, in_water, label, residuals_of
from fishmj.water.flow import Flow
from fishmj.water.hydro_model import HydroModel

FISH = load_robot("fish")


def longer(robot):
    """The same fish with a head of another length."""
    head = robot.links[0]
    return replace(robot, links=(replace(head, length=1.02 * head.length), *robot.links[1:]))


def test_fitted_is_the_default_wherever_the_body_has_one():
    assert chosen(FISH).kind == "fitted" and label(chosen(FISH).robot) == "swift"
    assert residuals_of(chosen(FISH).robot)
    assert "fitted (swift: strips and learnt residual, slip 1)" == chosen(FISH).said
    assert chosen(load_robot("tendon_fish")).kind == "fitted"
    other = chosen(longer(FISH))
    assert other.kind == "structured" and "none is fitted for this body" in other.said and "hydro_fit" in other.said


def test_default_water_without_a_fit_is_said_once_in_python(capsys):
    from fishmj import suite
    from fishmj.tasks.gym.fish_env import FishVectorEnv

    makes = (
        Sim,
        lambda robot: FishVectorEnv(1, robot=robot),
        lambda robot: suite.load("fish", "station_hold", task_kwargs={"robot": robot}),
    )
    for i, make in enumerate(makes):
        robot = replace(FISH, name=f"unfitted-{i}", density_water=1025.0)
        make(robot)
        make(robot)
        said = f"fishmj: robot {robot.name!r}, water: structured, own coefficients; none is fitted for this body"
        assert capsys.readouterr().err.count(said) == 1
        make(FISH), make(chosen(robot, "structured").robot)
        assert not capsys.readouterr().err


def test_a_fitted_water_belongs_to_the_body_not_to_its_servos():
    servo = replace(FISH, servo=replace(FISH.servo, kp=1.05 * FISH.servo.kp))
    found = chosen(servo)
    assert found.kind == "fitted" and "other servos, masses or timing" in found.said
    with pytest.raises(ConfigError, match="another body; fit it: fishmj hydro_fit"):
        chosen(longer(FISH), "swift")
    with pytest.raises(ConfigError, match=r"dt = 0.004 s, the robot steps 0.002 s"):
        chosen(replace(FISH, timing=replace(FISH.timing, physics_dt=0.002)), "fitted")


def test_a_body_under_another_name_has_its_waters_too():
    """A copy of the fish with a name of its own was told that nothing was fitted for its body, and swam in another water."""
    renamed = replace(FISH, name="carp")
    for water in (None, "fitted", "family"):
        assert chosen(renamed, water).said == chosen(FISH, water).said
        assert label(chosen(renamed, water).robot) == label(chosen(FISH, water).robot)
    weak = chosen(replace(renamed, servo=replace(FISH.servo, torque=0.8)))
    assert weak.kind == "fitted" and "other servos, masses or timing" in weak.said
    assert chosen(longer(renamed)).kind == "structured"
    with pytest.raises(ConfigError, match="no family comes with fishmj for robot 'carp'"):
        chosen(longer(renamed), "family")


def test_default_water_refuses_another_time_step_and_a_damaged_file(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match=r"dt = 0.004 s, the robot steps 0.002 s; take .*--water structured"):
        chosen(replace(FISH, timing=replace(FISH.timing, physics_dt=0.002)))
    assert chosen(replace(FISH, timing=replace(FISH.timing, physics_dt=0.002)), "structured").kind == "structured"
    model = fitted_water("swift")
    weights = model.save(tmp_path).with_suffix(".safetensors")
    weights.write_bytes(weights.read_bytes()[:-4] + b"0000")
    monkeypatch.setattr(choice, "fitted_water", lambda name: HydroModel.load(tmp_path / "swift.toml"))
    with pytest.raises(StoreError, match="expected sha256 .*; without it: --water structured"):
        chosen(FISH)


def test_stated_coefficients_without_effect_are_told_or_refused(monkeypatch, capsys):
    monkeypatch.setattr(console, "_WARNED", set())
    stated = lambda **values: replace(FISH, water={**FISH.water, **values})
    chosen(stated(residual=0.5)), chosen(load_robot("tendon_fish")), chosen(stated(cf=0.2), "structured")
    assert not capsys.readouterr().err
    assert label(chosen(chosen(stated(cf=0.2, linear_drag=1.0)).robot).robot) == "swift"
    assert capsys.readouterr().err.count("[water] cf, linear_drag: not used in the fitted water 'swift'; --water structured") == 1
    with pytest.raises(
        ConfigError, match="residual = 0.5 of robot 'swift', but every fish of a family draws its share between 0.5 and 1.25"
    ):
        chosen(stated(residual=0.5), "family")


def test_what_a_description_states_is_its_default():
    for stated, kind in (("structured", "structured"), ("swift-base", "fitted"), ("none", "none")):
        described = replace(FISH, water={**FISH.water, "model": stated})
        assert chosen(described).kind == kind and label(chosen(described).robot) == stated
        assert label(chosen(described, "structured").robot) == "structured"
    assert label(chosen(replace(FISH, water={**FISH.water, "model": "swift-noslip"}), "fitted").robot) == "swift-noslip"


def test_a_choice_stays_whatever_is_asked_for_later():
    for water in ("structured", "swift-base", "none", "fitted"):
        robot = in_water(FISH, water)
        assert in_water(robot) == robot == in_water(replace(robot, name=robot.name))
        assert in_water(robot, "structured") == in_water(FISH, "structured") and robot_sha256(robot) == robot_sha256(FISH)


def test_what_cannot_be_is_one_clear_error():
    with pytest.raises(UnknownName, match="Known: family, fitted, hybrid, lbm, none, structured, swift"):
        chosen(FISH, "swfit")
    with pytest.raises(ConfigError, match="none is fitted for robot 'other'; take structured, or fit one"):
        chosen(replace(longer(FISH), name="other"), "fitted")
    for kind, where in (("hybrid", "evaluate"), ("lbm", "suite.load")):
        with pytest.raises(ConfigError, match=f"water '{kind}': the engine supports fitted, structured, none.*{where}"):
            in_water(FISH, kind, who="the engine")


def test_none_is_no_water_in_the_closed_form_and_in_mujoco():
    robot, gusts = in_water(FISH, "none"), Flow(speed=0.3, turbulence="gust", intensity=0.2)
    command, tick = np.zeros((1, 10, 3)), np.zeros(1, int)
    start = engines.at_rest(robot, [[0.0, 0.0, 0.0]])
    after, _ = engines.make("planar", robot).advance(start, command, engines.nominal_params(robot, 1), gusts.current(), tick)
    assert np.abs(np.asarray(after.q)).max() < 1e-9
    sim = Sim("fish", water="none", flow=gusts)
    sim.run(lambda t: np.zeros(3), 0.2)
    assert np.abs(sim.pose).max() < 1e-12 and sim.water_name == "none"


def test_sim_says_its_water():
    assert Sim("fish").water_name == "swift" and Sim("fish", water="structured").water_name == "structured"
    assert Sim("fish").run(lambda t: np.zeros(3), 0.1).meta["water"] == "swift"
    with pytest.raises(ConfigError, match="water 'lbm': Sim supports"):
        Sim("fish", water="lbm")


def test_suite_gymnasium_and_the_jax_environment_take_a_water():
    import gymnasium

    from fishmj import suite
    from fishmj.tasks.env import StationHold

    for water, named in ((None, "swift"), ("structured", "structured"), ("swift-base", "swift-base"), ("none", "none")):
        env = suite.load("fish", "station_hold", task_kwargs={"water": water, "random": 1})
        assert label(env.task.rules.robot) == named
        env = gymnasium.make("fishmj/StationHold-v0", engine="planar", water=water).unwrapped
        assert label(env.rules.robot) == named == label(env.episodes.engine.robot)
        env = StationHold(FISH, "planar", water=water)
        assert label(env.robot) == named == label(env.engine.robot)
    for water in ("hybrid", "lbm"):
        with pytest.raises(ConfigError, match=f"water '{water}': this environment supports"):
            gymnasium.make("fishmj/StationHold-v0", engine="planar", water=water)
        with pytest.raises(ConfigError, match=f"water '{water}': the environment in JAX supports"):
            StationHold(FISH, "planar", water=water)


def test_an_engine_of_another_water_is_refused():
    from fishmj.tasks.gym.fish_env import FishEnv

    with pytest.raises(ConfigError, match="swims in water 'structured', the task's in 'swift'"):
        FishEnv(engine=engines.make("planar", in_water(FISH, "structured")))


def test_training_picks_an_engine_that_supports_the_requested_water():
    from fishmj.train.build import pick_engine, settled, water_for
    from fishmj.train.settings import preset

    settings = preset("quick")
    assert water_for(settings).kind == "fitted" == settled(settings).water
    assert pick_engine(settings) in ("compiled", "planar", "mjx")
    assert settled(replace(settings, water="structured")).water == "structured"
    with pytest.raises(ConfigError, match="water 'lbm': training supports"):
        water_for(replace(settings, water="lbm"))


def test_the_search_refuses_a_learnt_force_that_it_would_leave_out():
    from fishmj.gap.commands.admission import searchable
    from fishmj.water.choice import as_described

    assert as_described(FISH) is FISH
    searchable(as_described(FISH, "swift-base"), "fish")
    with pytest.raises(ConfigError, match="water 'swift' has a learnt force; take its strips:"):
        searchable(as_described(FISH, "fitted"), "fish")


def test_a_file_has_its_strips_alone_as_a_shipped_name_has(tmp_path):
    from fishmj.gap.commands.admission import searchable

    whole = str(fitted_water("swift").save(tmp_path))
    strips = str(tmp_path / "swift-base.toml")
    alone = chosen(FISH, strips)
    assert "swift-base.toml: strips alone, slip 1)" in alone.said and not residuals_of(alone.robot)
    assert alone.robot.water["k"] == chosen(FISH, "swift-base").robot.water["k"]
    assert HydroModel.load(f"{strips}#2").name == "swift-base#2"
    assert _no_water(strips) is None and _no_water(str(tmp_path / "pike-base.toml")) is not None
    with pytest.raises(StoreError, match="pike-base.toml: no such file"):
        chosen(FISH, str(tmp_path / "pike-base.toml"))
    with pytest.raises(ConfigError, match=f"take its strips: --water {strips}, or structured"):
        searchable(chosen(FISH, whole).robot, "fish")
    fitted_water("swift-noslip").base_only.save(tmp_path).rename(strips)
    assert HydroModel.load(strips).name == "swift-noslip"


@pytest.mark.parametrize("water", ["fitted", "swift"])
def test_gap_find_refuses_it_on_the_command_line(water, tmp_path, capsys):
    from fishmj.gap.commands.find import main

    assert console.run(main, [str(tmp_path), "--water", water]) == console.BAD_INPUT
    assert "has a learnt force; take its strips: --water swift-base" in capsys.readouterr().err


def test_a_family_draws_a_water_for_each_fish():
    robot = chosen(FISH, "family").robot
    assert label(robot) == label(chosen(FISH, "swift-family").robot) == "swift-family"
    assert family_in(robot).width > 0 and family_in(chosen(FISH, "fitted").robot) is None
    draws = np.random.default_rng(0).random((5, n_fish(robot)))
    drawn, nominal = (draw_fish(np, robot, draws, strength)[0].water for strength in (1.0, 0.0))
    assert (np.ptp(drawn, 0) > 0).sum() > 10
    np.testing.assert_array_equal(nominal, np.repeat(nominal[:1], 5, 0))
