"""The flow solver as a generator of logs: servos of the second robot on the immersed fish, effects planted, nothing told."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base.errors import ConfigError
from fishmj.gap.bench import drawn_robots
from fishmj.gap.laboratory.hidden_lbm import hidden
from fishmj.gap.laboratory.hidden_lbm import hidden_lbm_command as hidden_command
from fishmj.gap.laboratory.hidden_lbm.hidden import HiddenRun, carriage
from fishmj.gap.laboratory.hidden_lbm.hidden_body import Electronics, HiddenBody, HiddenDifference, Queue
from fishmj.gap.laboratory.virtual_robot import network
from fishmj.gap.laboratory.virtual_robot.simulate import STILL, at_rest, run
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.log import excitation
from fishmj.log.trial import stacked
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

TINY = Domain(name="tiny", shape=(56, 36, 20), dx=0.02, dt=0.004, follows=True)
FLICK = excitation.Excitation(id="flick", commands=np.repeat([[0.0] * 3, [0.4, 0.3, -0.2]], [10, 45], 0), about="a step")
DT = 0.004


def in_air(effects: dict, name: str, robot: Robot | str = "fish") -> tuple[np.ndarray, np.ndarray, Electronics]:
    """Joint angles (T, J) by the law on the MuJoCo body alone, and by the second robot; no thread."""
    made = replace(plant(effects, 3, medium="air", robot=robot), air=np.zeros(4))
    joints = made.robot.n_joints
    what = excitation.get(name, joints)
    packets = network.deliver(made.network, made.odd, what.t, what.commands, 3, 0, 1.0)
    start = lambda: at_rest((0.0, 0.0, 0.0), made.zero, made.motor.voltage)
    truth = run(made, start(), packets.times, packets.commands, what.seconds)
    body, electronics = HiddenBody(made, DT), Electronics(made, start(), Queue(*packets), STILL)
    for k in range(round(what.seconds / DT)):
        electronics.begin_tick(k)
        electronics.actuate(body, k * DT)
        system, right = body.equation(interior=False)
        for j in 3 + np.flatnonzero(electronics.held):
            system[j], right[j] = np.eye(3 + joints)[j], 0.0
        body.advance(np.linalg.solve(system, right))
        electronics.follow(body)
    return electronics.recording().data[:, 6 : 6 + joints], truth.data[:, 6 : 6 + joints], electronics


@pytest.mark.parametrize("effects", [{}, {"coulomb_friction": {"torque": 0.1}}, {"body_mass": {"mass": 0.2}}])
def test_in_air_the_law_moves_the_joints_as_the_second_robot_does(effects):
    mine, truth, _ = in_air(effects, "steps")
    assert np.degrees(np.sqrt(np.mean((mine - truth) ** 2))) < 0.15


@pytest.fixture(scope="module")
def chains():
    """Fish of two and of five links."""
    found = [drawn_robots.chain(np.random.default_rng(k), f"chain{k}") for k in range(20)]
    return [next(robot for robot in found if len(robot.links) == links) for links in (2, 5)]


def test_a_fish_of_any_chain_moves_as_the_second_robot_does(chains):
    for robot in chains:
        mine, truth, _ = in_air({"servo_deadband": {"deadband": 0.02}}, "steps", robot)
        assert mine.shape[1] == robot.n_joints and np.ptp(truth, 0).min() > 0.3
        assert np.degrees(np.sqrt(np.mean((mine - truth) ** 2))) < 0.15


def test_what_an_effect_adds_is_its_formula_on_any_chain(chains):
    for robot in chains:
        state = at_rest((0.0, 0.0, 0.5), np.zeros(robot.n_joints), 7.4, (0.3, 0.1, 0.0))
        drag = HiddenDifference(plant({"quadratic_drag": {"coefficient": 2.0}}, 5, robot=robot), STILL)
        force, mass = drag(state, DT)
        assert force.shape == (3 + robot.n_joints,) and np.abs(mass).max() < 1e-12
        assert np.allclose(force[:2], -2.0 * 0.3**2 * np.array([np.cos(0.5), np.sin(0.5)]), atol=1e-9)


def test_a_joint_that_friction_holds_does_not_creep():
    angles, _, electronics = in_air({"coulomb_friction": {"torque": 0.1}}, "steps")
    rates = np.concatenate(electronics.rows)[:, 9:12]
    assert np.abs(rates[-100:]).max() < 1e-12, "at rest at the end"
    assert np.ptp(angles, 0).min() > 0.5, "and it did move before"


def test_an_effect_at_its_null_adds_nothing_to_the_water():
    made = plant({}, 5)
    assert not HiddenDifference(made, STILL).acts
    assert not HiddenDifference(plant({"command_latency": {"delay": 0.04}, "servo_gain": {"gain": 0.2}}, 5), STILL).acts
    assert not HiddenDifference(plant({"body_mass": {"mass": 0.2}, "steady_current": {"x": 0.02}}, 5), STILL).acts


def test_what_an_effect_adds_is_its_formula():
    state = at_rest((0.0, 0.0, 0.5), np.zeros(3), 7.4, (0.3, 0.1, 0.0))
    drag = HiddenDifference(plant({"quadratic_drag": {"coefficient": 2.0}}, 5), STILL)
    force, mass = drag(state, DT)
    assert drag.acts and np.abs(mass).max() < 1e-12
    assert np.allclose(force[:2], -2.0 * 0.3**2 * np.array([np.cos(0.5), np.sin(0.5)]), atol=1e-9)
    _, mass = HiddenDifference(plant({"sway_added_mass": {"mass": 0.6}}, 5), STILL)(state, DT)
    across = np.array([-np.sin(0.5), np.cos(0.5)])
    assert np.allclose(mass[:2, :2], 0.6 * np.outer(across, across), atol=1e-9)


def test_masses_are_those_of_the_immersed_body():
    light, heavy = (HiddenBody(plant(effects, 5), DT) for effects in ({}, {"body_mass": {"mass": 0.25}}))
    system = [np.array(body.equation(interior=False)[0]) for body in (light, heavy)]
    assert np.isclose(heavy.model.body_mass.sum() - light.model.body_mass.sum(), 0.25)
    assert np.allclose((system[1] - system[0])[:2, :2], 0.25 * np.eye(2), atol=1e-9)


@pytest.mark.parametrize("push", [(0.4, 0.0, 0.0), (0.3, 0.1, 0.0), (0.2, 0.1, 2.0)])
def test_the_carriage_arrives_at_the_start_with_the_push(push):
    start = np.array([0.3, -0.2, 0.7])
    assert np.allclose(carriage(start, push, 0.0), start)
    h = 1e-6
    rate = (start - carriage(start, push, h)) / h
    c, s = np.cos(start[2]), np.sin(start[2])
    assert np.allclose([c * rate[0] + s * rate[1], c * rate[1] - s * rate[0], rate[2]], push, atol=1e-5)
    middle = carriage(start, push, 0.25)
    assert np.allclose(carriage(middle, push, 0.25), carriage(start, push, 0.5))


@pytest.fixture(scope="module")
def swum():
    """The same robot twice in a small box of water: with nothing hidden, and with commands 40 ms late."""
    late = {"command_latency": {"delay": 0.04}}
    return [hidden.generate_lbm(effects, [FLICK], seed=9, domain=TINY)[0] for effects in ({}, late)]


def test_a_trial_holds_what_a_lab_would_have_and_tells_nothing(swum):
    plain, late = swum
    assert set(plain.tables) == {"cmd", "joint", "power", "pose"}
    assert plain.meta == late.meta | {"refined_ticks": plain.meta["refined_ticks"]}
    assert plain.meta["origin"] == "synthetic" and plain.meta["water"] == "lbm" and plain.meta["grid"]["dx"] == 0.02
    assert "seed" not in plain.meta and "slip" not in str(plain.meta)


def test_a_planted_latency_is_in_the_joints(swum):
    middle = [np.interp(0.2, stacked(t.tables["joint"], "j#")[:, 0], t.tables["joint"]["t"]) for t in swum]
    assert middle[1] - middle[0] == pytest.approx(0.04, abs=0.004)


@pytest.mark.slow
def test_hidden_run_servo_moves_the_joints_as_the_solver_servo_does():
    """Same numbers, two servos: 200 Hz firmware that counts, and MuJoCo's actuator."""
    own = SwimSetup(domain=TINY).run()
    for command in FLICK.commands:
        own.tick(command)
    job = hidden.jobs({}, [FLICK], 9, noise=0.0, nuisance=0.0, domain=TINY)[0]
    mine = HiddenRun(job, "cpu")
    for _ in range(mine.end):
        mine.tick(np.zeros(3))
    angles = np.array([row[4] for row in own.rows])
    off = np.degrees(np.array([row[4] for row in mine.rows]) - angles)
    assert np.sqrt(np.mean(off**2)) < 0.8 and np.degrees(np.ptp(angles)) > 30
    assert np.allclose(mine.pose[:2], own.pose[:2], atol=0.005)


def test_a_second_attempt_at_a_tick_starts_where_the_first_did():
    job = hidden.jobs({"gear_backlash": {"half_gap": 0.02}}, [FLICK], 9, domain=TINY)[0]
    electronics = HiddenRun(job, "cpu").electronics
    body = HiddenBody(job.made, DT)
    found = []
    for attempt in range(2):
        electronics.begin_tick(0)
        for i in range(5):
            electronics.actuate(body, i * DT)
        found.append((np.concatenate([a.ravel() for a in electronics.state]), len(electronics.rows), electronics.law.copy()))
        assert attempt or electronics.state.clock[0] == pytest.approx(5 * DT)
    assert np.array_equal(found[0][0], found[1][0]) and found[0][1] == found[1][1] and np.array_equal(found[0][2], found[1][2])


def test_a_collection_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch, swum):
    plan = {"set_000": hidden.jobs({}, [FLICK, FLICK], 9, domain=TINY)}
    asked = []

    class Done:
        def __init__(self, job):
            self.job = job

    def pretend(waiting, device, tanks):
        asked.append([])
        while waiting:
            asked[-1].append((job := waiting.popleft()).name)
            yield Done(job)

    monkeypatch.setattr(hidden_command, "run_jobs", pretend)
    monkeypatch.setattr(hidden_command, "trial_of", lambda run: swum[0])
    (tmp_path / "set_000").mkdir()
    hidden_command.write_trial(tmp_path / "set_000" / "01_flick", swum[0])
    assert hidden_command.collect(tmp_path, plan, "cpu") == {}
    assert hidden_command.collect(tmp_path, plan, "cpu") == {}
    assert asked == [["02_flick"], []]
    assert (tmp_path / "set_000" / "manifest.json").is_file()


def test_the_truth_lies_outside_and_belongs_to_one_collection(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(hidden_command, "collect", lambda *given: {})
    base = ["--excitations", "idle", "--domain", "laptop", "--device", "cpu", "--out", str(tmp_path / "d")]
    with pytest.raises(ConfigError, match="inside"):
        hidden_command.main([*base, "--truth", str(tmp_path / "d" / "t.json")])
    assert hidden_command.main([*base, "--truth", str(tmp_path / "t.json")]) == 0
    assert hidden_command.main([*base, "--truth", str(tmp_path / "t.json")]) == 0
    with pytest.raises(ConfigError, match="another collection"):
        hidden_command.main([*base, "--seed", "3", "--truth", str(tmp_path / "t.json")])


def test_another_model_swims_with_its_own_joints():
    given = {"effects": ["none"], "excitations": "gait,steps", "seconds": 2.0, "seed": 0, "noise": 1.0, "nuisance": 0.1}
    args = SimpleNamespace(**given, slip=1.0, domain="laptop", model="tendon_fish")
    plan = hidden_command.plan_of(args, 1)["set_000"]
    joints = load_robot("tendon_fish").n_joints
    assert [job.what.commands.shape for job in plan] == [(100, joints)] * 2 and plan[0].made.robot.name == "tendon_fish"


def test_impossible_slip_is_refused():
    with pytest.raises(ConfigError, match="slip = 1.2"):
        hidden.jobs({}, ["gait"], 1, slip=1.2)
