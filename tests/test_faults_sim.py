"""Faults 1 to 7 and 12 of tests/FAULTS.md: what goes wrong in a simulation says so, and loses nothing."""

import threading
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError, InjectionError, MissingExtra, SimDiverged, UnknownName
from fishmj.log import read_trial
from fishmj.mjcf.description import Timing
from fishmj.mjcf.reading import check_timing
from fishmj.sim import Sim
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, stack
from fishmj.water.injection import inject
from fishmj.water.planar_water import PlanarWater


def gait(t):
    return np.radians(30) * np.sin(2 * np.pi * t - np.arange(3))


@pytest.mark.parametrize("root", ["planar", "free"])
@pytest.mark.parametrize(
    ("field", "index", "term", "link"),
    [
        ("cn", 3, "resistive", "tail"),
        ("k", 1, "added mass", "body1"),
        ("ca_forward", None, "head_form", "head"),
        ("ke", None, "trailing_edge", "tail"),
    ],
)
def test_fault_01_non_finite_force_is_named_and_last_states_are_saved(tmp_path, root, field, index, term, link):
    sim = Sim("fish", root=root, water="structured", rescue_folder=tmp_path / "rescued")
    sim.run(gait, 0.6)
    strips = sim.water.strips
    water = strips.swimmer.water
    value = getattr(water, field)
    bad = np.nan if index is None else [np.nan if i == index else v for i, v in enumerate(value)]
    strips.swimmer = strips.swimmer._replace(water=water._replace(**{field: bad}))
    before = sim.data.qpos.copy()
    with pytest.raises(SimDiverged) as caught:
        sim.step(gait(0.6))
    error = caught.value
    assert (error.term, error.link) == (term, link) and error.time == pytest.approx(0.6)
    assert "u = " in str(error) and str(tmp_path / "rescued") in str(error)
    assert len(error.states) == 100
    np.testing.assert_array_equal(error.states[-1][1], before)  # the state that the bad force would have moved
    kept = read_trial(tmp_path / "rescued")
    assert len(kept.table("truth")["t"]) == 100 and kept.value("diverged.term") == term
    assert mujoco.get_mjcb_passive() is None


def test_fault_01_one_bad_fish_in_a_batch_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its own log beside the caller
    robot = mjcf.load_robot("fish")
    engine = engines.make("batch", robot, evaluator="jax")
    params = engines.nominal_params(robot, 3)
    params.water[1, :] = np.nan
    with pytest.raises(SimDiverged, match="1 of 3 fish diverged, the first is number 1"):
        engine.advance(
            engines.at_rest(robot, np.zeros((3, 3))), np.full((3, 2, 3), 0.3), params, stack([Flow()] * 3), np.zeros(3, int)
        )


def test_fault_02_mujocos_silent_reset_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sim = Sim("fish", pose=(1.0, 0.5, 0.3), rescue_folder=tmp_path / "rescued")
    sim.run(gait, 0.2)
    sim.data.qvel[4] = 1e12
    with pytest.raises(SimDiverged, match="MuJoCo reset the fish at t = 0.200 s: qvel of joint 'j2'") as caught:
        sim.step(gait(0.2))
    assert caught.value.link == "j2"
    assert np.abs(read_trial(tmp_path / "rescued").table("truth")["x"] - 1.0).max() < 0.2  # before the teleport, not after
    model = mjcf.build("fish")
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[4] = 1.0, 1e12
    mujoco.mj_step(model, data)  # what the check is for: no exception, and the fish is elsewhere
    assert data.qpos[0] == 0.0


class Broken(PlanarWater):
    """A water with a mistake in it."""

    def forces(self, model, data):
        if data.time > 0.1:
            raise ZeroDivisionError("my own mistake")
        return super().forces(model, data)


def test_fault_03_callback_exception_propagates_and_keeps_the_state():
    model, water = mjcf.build("fish"), Broken(mjcf.load_robot("fish"))
    data = mujoco.MjData(model)
    with pytest.raises(ZeroDivisionError, match="^my own mistake$"), inject(model, water) as fish:
        for _ in range(100):
            before = [data.time, *data.qpos, *data.qvel, water.attached]
            data.ctrl[:] = gait(data.time)
            fish.step(data)
    assert [data.time, *data.qpos, *data.qvel, water.attached] == before
    assert mujoco.get_mjcb_passive() is None
    mjcf.build("fish")  # and models can be built again


def test_fault_04_building_a_model_inside_inject_is_refused():
    model = mjcf.build("fish")
    with inject(model, PlanarWater(mjcf.load_robot("fish"))), pytest.raises(InjectionError, match="leave the inject block first"):
        mjcf.build("fish")
    mjcf.build("fish")


def test_fault_05_two_fish_in_one_process_each_have_their_own_water():
    """Step by step in turn: each takes the path that it takes alone."""

    def swim(turns):
        fish = [Sim(flow=Flow(speed=0.1 * (i + 1), direction=float(i)), root=r) for i, r in enumerate(("planar", "free"))]
        for i in turns:
            fish[i].step(gait(fish[i].data.time))
        return [f.pose for f in fish]

    together, apart = swim([0, 1] * 20), swim([0] * 20 + [1] * 20)
    np.testing.assert_array_equal(together, apart)


def test_fault_05_a_second_thread_is_sent_to_the_wrenches():
    robot = mjcf.load_robot("fish")
    models, said = [mjcf.build(robot), mjcf.build(robot)], []

    def other():
        try:
            with inject(models[1], PlanarWater(robot)):
                said.append("let in")
        except InjectionError as error:
            said.append(str(error))

    with inject(models[0], PlanarWater(robot)):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert said == ["inject: the callback serves another thread; from threads take LinkWrench, Sim(injection='xfrc')"]


def test_fault_06_steps_that_do_not_nest_name_both_numbers_and_the_nearest():
    with pytest.raises(
        ConfigError, match=r"control_dt = 0.21 s is not a multiple of bus_dt = 0.02 s; nearest valid control_dt: 0.2 s"
    ):
        check_timing(Timing(control_dt=0.21), "fish")
    robot = mjcf.load_robot("fish")
    with pytest.raises(
        ConfigError, match=r"bus_dt: got 0.02 s, expected a multiple of physics_dt = 0.003 s; nearest valid bus_dt: 0.021 s"
    ):
        Sim(replace(robot, timing=replace(robot.timing, physics_dt=0.003)))
    with pytest.raises(ConfigError, match="nearest valid bus_dt: 0.024 s; bus_dt = 0.025 s goes with physics_dt = 0.005 s"):
        check_timing(Timing(bus_dt=0.025), "a bus of 40 Hz")


@pytest.mark.parametrize(
    ("call", "hint"),
    [
        (
            lambda: Sim("fish", water="structurd"),
            "unknown water 'structurd'. Did you mean 'structured'? Known: family, fitted, hybrid, lbm, none, structured",
        ),
        (lambda: Sim("fish", engine="mujco"), "Did you mean 'mujoco'?"),
        (lambda: Sim("fish", root="plane"), "Did you mean 'planar'?"),
        (lambda: Sim("fsh"), "Did you mean 'fish'?"),
        (lambda: engines.make("bach"), "unknown engine 'bach'. Did you mean 'batch'? Known: batch, compiled, mjx, planar."),
        (lambda: Flow(turbulence="gusts"), "Did you mean 'gust'?"),
    ],
    ids=["water", "engine of Sim", "root", "robot", "engine", "turbulence"],
)
def test_fault_07_an_unknown_name_lists_the_known_ones_and_the_closest(call, hint):
    with pytest.raises(UnknownName) as caught:
        call()
    assert hint in str(caught.value) and "Known:" in str(caught.value)


def test_fault_12_without_numba_batch_runs_and_compiled_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "numba", None)
    robot = mjcf.load_robot("fish")
    with pytest.raises(MissingExtra, match=r'pip install "fishmj\[fast\]"'):
        engines.make("batch", robot, evaluator="compiled")
    engine = engines.make("batch", robot)
    case = engines.at_rest(robot, np.zeros((1, 3))), np.full((1, 5, 3), 0.3), engines.nominal_params(robot, 1), stack([Flow()])
    state, _ = engine.advance(*case, np.zeros(1, int))
    assert np.isfinite(state.q).all() and np.any(state.q)


def test_a_command_that_is_not_a_number_moves_nothing():
    sim = Sim("fish")
    with pytest.raises(ConfigError, match="expected finite numbers"):
        sim.step([0.1, np.nan, 0.0])
    assert sim.tick == 0 and not sim.data.qpos.any()


def test_swimmer_constants_are_the_sims_own():
    """The nominal fish is not changed by a personal one."""
    own = planar_chain.nominal(mjcf.load_robot("fish"))._replace(mass=[2.0] * 4)
    heavy, plain = Sim("fish", swimmer=own), Sim("fish")
    np.testing.assert_allclose(heavy.model.body_mass, 2 * plain.model.body_mass)
