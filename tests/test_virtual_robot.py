"""The second robot: does it move like a fish, and do its parts keep the laws that hold whatever the coefficients."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.gap.laboratory.virtual_robot import ClosedLoopRobot, generate, plant
from fishmj.gap.laboratory.virtual_robot.chain import assemble
from fishmj.gap.laboratory.virtual_robot.servo import stick_slip
from fishmj.gap.laboratory.virtual_robot.simulate import at_rest, run, workspace
from fishmj.gap.laboratory.virtual_robot.water import crossflow, trailing_edge
from fishmj.log import excitation
from studies.steady_gaits import coast, steady

DEG = np.pi / 180
STILL = np.zeros(3)


@pytest.fixture(scope="module")
def made():
    return plant({}, nuisance=0.0)


def swim(made, commands, start=STILL, push=STILL, seconds=None):
    """Recording with commands that arrive at once."""
    t = np.arange(len(commands)) * excitation.PERIOD
    return run(made, at_rest(start, commands[0], made.motor.voltage, push), t, commands, seconds or t[-1])


def test_it_swims_forward_about_as_fast_as_the_first_robot(made):
    assert 0.8 * 0.274 < steady(made, 1.0, 60.0)["speed"] < 1.2 * 0.274  # docs/simulate/water.md
    assert 0.8 * 0.125 < steady(made, 0.5, 60.0)["speed"] < 1.2 * 0.125


def test_a_bias_turns_it_and_the_mirror_bias_turns_it_back(made):
    left, right = (steady(made, 1.0, 60.0, b)["turn"] for b in (-20, 20))
    assert left > 20 * DEG and left == pytest.approx(-right, rel=1e-3)


def test_mirrored_commands_mirror_the_motion(made):
    commands = excitation.get("ramps").commands[:300]
    one, two = swim(made, commands), swim(made, -commands)
    for name, sign in (("x", 1), ("y", -1), ("yaw", -1), ("j2", -1)):
        assert one.at(one.t, name) == pytest.approx(sign * two.at(two.t, name), abs=1e-9)


def test_turning_the_tank_turns_the_result(made):
    commands, angle = excitation.get("ramps").commands[:300], 0.7
    one, two = swim(made, commands), swim(made, commands, start=(0.0, 0.0, angle))
    x, y = one.at(one.t, "x", "y").T
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], 1)
    assert two.at(two.t, "x", "y") == pytest.approx(turned, abs=1e-3)  # a count of the servo may round the other way


def test_swimming_in_a_stream_is_swimming_seen_from_a_boat(made):
    commands = excitation.get("gait").commands[:250]
    stream = made.with_fields({"tank.flow_x": 0.2, "tank.flow_y": -0.1})
    still, moved = swim(made, commands), swim(stream, commands, push=(0.2, -0.1, 0.0))
    drift = still.t[:, None] * np.array([0.2, -0.1])
    assert moved.at(moved.t, "x", "y") - drift == pytest.approx(still.at(still.t, "x", "y"), abs=1e-6)


def test_a_resting_fish_in_still_water_rests(made):
    record = swim(made, np.zeros((100, 3)))
    assert np.all(record.at(record.t, "x", "y", "yaw", "j1", "k3") == 0.0)


def test_a_fish_that_is_let_go_slows_down_and_goes_straight(made):
    record = swim(made, np.zeros((400, 3)), push=(0.4, 0.0, 0.0))
    speed = record.at(record.t, "vx")[:, 0]
    assert np.all(np.diff(speed) < 0) and np.all(record.at(record.t, "y", "yaw") == 0.0)
    assert 1.0 < coast(made) < 4.0  # halving from 0.3 m/s


def mass_matrix(made, state):
    """J^T A J of links and still water (N + 2, N + 2), the loop's own."""
    A, f, *_, stream, _ = workspace(len(made.body.joints))
    assemble(made.body, made.water, made.tank, made.odd, state, stream, A, f, 0.0)
    return np.tril(A) + np.tril(A, -1).T


def kinetic_energy(made, state):
    """Energy of links and still water, J."""
    return 0.5 * state.rate @ mass_matrix(made, state) @ state.rate


def impulse(made, state):
    """Linear (2,) and angular impulse of links and still water about the tank's centre, N s and N m s."""
    momenta = mass_matrix(made, state) @ state.rate
    turning = state.z[0] * momenta[1] - state.z[1] * momenta[0] + momenta[2:].sum()
    return np.array([*momenta[:2], turning])


def ideal(made):
    """The same fish in water without friction, separation or wake."""
    smooth = replace(made, sections={**made.sections, "drag_round": 0.0, "drag_flat": 0.0})
    return smooth.with_fields(
        dict.fromkeys(("water.friction", "water.head_forward", "water.head_backward", "water.edge_mass"), 0.0)
    )


@pytest.mark.parametrize("active", [1.0, 0.0])
def test_in_ideal_water_and_in_empty_space_no_servo_can_change_the_impulse(made, active):
    """Kirchhoff's equations on a hinged chain: inner torques leave linear and angular impulse alone, whatever they do."""
    free = replace(ideal(made).with_fields({"water.active": active}), air=np.zeros(4))
    state = at_rest((0.3, -0.2, 0.5), np.zeros(3), 7.4, (0.3, 0.1, 0.8))
    before, commands = impulse(free, state), excitation.get("ramps").commands[30:180]
    record = run(free, state, np.arange(150) * 0.02, commands, 3.0)
    assert np.ptp(record.at(record.t, "j1", "j2", "j3"), axis=0).min() > 0.5  # it did move
    assert impulse(free, state) == pytest.approx(before, abs=0.02 * np.abs(before).max())


def test_the_impulse_of_a_fish_of_three_links_is_left_alone_too():
    free = replace(ideal(plant({}, nuisance=0.0, robot="tendon_fish")), air=np.zeros(4))
    state = at_rest((0.3, -0.2, 0.5), np.zeros(2), 12.0, (0.3, 0.1, 0.8))
    before = impulse(free, state)
    record = run(free, state, np.arange(150) * 0.02, excitation.get("ramps", 2).commands[30:180], 3.0)
    assert np.ptp(record.at(record.t, "j1", "j2"), axis=0).min() > 0.5
    assert impulse(free, state) == pytest.approx(before, abs=0.02 * np.abs(before).max())


def test_in_ideal_water_a_limp_frictionless_chain_keeps_its_energy(made):
    free = ideal(made).with_fields(
        {
            "motor.gain": 0.0,
            "motor.rate_gain": 0.0,
            "motor.constant": 1e-9,
            "motor.dry": 0.0,
            "motor.viscous": 0.0,
            "motor.armature": 0.0,
        }
    )
    state = at_rest(STILL, (0.2, 0.1, -0.3), 7.4, (0.2, 0.1, 0.5))
    state.rate[3:] += [0.3, -0.4, 0.5]
    before = kinetic_energy(free, state)
    run(free, state, [], [], 1.0)
    assert kinetic_energy(free, state) == pytest.approx(before, rel=0.02)


def test_a_limp_fish_only_loses_energy(made):
    limp = made.with_fields({"motor.gain": 0.0, "motor.rate_gain": 0.0})
    for seed in range(3):
        rng = np.random.default_rng(seed)
        state = at_rest(STILL, rng.uniform(-0.6, 0.6, 3), 7.4, (0.3, *rng.uniform(-0.2, 0.2, 2)))
        state.rate[3:] += rng.uniform(-2, 2, 3)
        energy = [kinetic_energy(made, state)]
        for _ in range(40):
            run(limp, state, [], [], 0.02)
            energy.append(kinetic_energy(made, state))
        energy = np.array(energy)
        assert np.all(np.diff(energy) < 1e-3 * energy[0]) and energy[-1] < 0.7 * energy[0]


def test_the_mass_matrix_is_symmetric_positive_and_weighs_the_fish(made):
    air = made.with_fields({"water.active": 0.0})
    state = at_rest((0.0, 0.0, 0.4), (0.3, -0.5, 0.8), 7.4)
    full = mass_matrix(air, state)
    assert np.all(np.linalg.eigvalsh(full) > 0)
    assert full[:2, :2] == pytest.approx(made.robot.mass * np.eye(2), abs=1e-12)


def test_the_trailing_edge_never_feeds_energy(made):
    """Power 1/2 m w_c^2 u s - m u+ w_c w_e <= 0 for any lagged circulation; compiled functions run as plain Python here."""
    rng = np.random.default_rng(0)
    for u, w, z in rng.uniform(-2, 2, (2000, 3)):
        wake = np.array([z, 0, 0, 0, 0, 0.0])
        along, across = trailing_edge.py_func(made.water, made.odd, wake, u, w, 0.0)
        assert along * u + across * w <= 1e-9


def test_crossflow_drag_never_feeds_energy(made):
    rng, body = np.random.default_rng(1), made.body
    for u, v, r in rng.uniform(-2, 2, (200, 3)):
        force, moment = crossflow.py_func(body.station[3], body.drag[3], u, v, r, 0.05)
        assert force * v + moment * r <= 0.0


def test_friction_sticks_or_opposes_the_motion():
    """Coulomb's law on impulses: inside the bound the joint rests, at the bound the impulse opposes what motion is left."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        root = rng.normal(size=(3, 3))
        mobility, w, bound = root @ root.T + 0.5 * np.eye(3), rng.normal(size=3), rng.uniform(0, 0.5, 3)
        impulse = np.zeros(3)
        for _ in range(20):
            stick_slip.py_func(w, mobility, bound, impulse, 3)
        left = w + mobility @ impulse
        stuck = np.abs(impulse) < bound - 1e-9
        assert np.abs(left[stuck]) == pytest.approx(0.0, abs=1e-6)
        assert np.all(impulse[~stuck] * left[~stuck] <= 1e-9)


def test_a_strong_stiction_locks_a_joint_to_the_bit():
    rusty = plant({"coulomb_friction": {"torque": 1.0}}, nuisance=0.0)
    record = swim(rusty, np.tile([3 * DEG, 0.0, 0.0], (100, 1)) * (np.arange(100) > 5)[:, None])
    assert np.max(np.abs(record.at(record.t, "j1"))) < 1e-12


def test_joint_step_respects_motor_speed_and_settles_within_friction(made):
    commands = np.tile([40 * DEG, 0.0, 0.0], (100, 1)) * (np.arange(100) > 5)[:, None]
    record = swim(made, commands)
    assert np.max(record.at(record.t, "k1")) < 1.05 * made.robot.servo.speed_no_load
    band = made.motor.dry / made.motor.gain + made.motor.step  # friction, and a count of the potentiometer
    assert record.at(record.t[-1:], "j1")[0, 0] == pytest.approx(40 * DEG, abs=band)


def test_at_rest_the_battery_gives_the_idle_power(made):
    record = swim(made, np.zeros((50, 3)))
    volts, amps = record.at(record.t[-1:], "V", "I")[0]
    assert volts * amps == pytest.approx(made.motor.idle, rel=1e-3)


def test_one_seed_is_one_trial_and_another_seed_another():
    one, again, other = (generate({}, ["steps"], seed)[0].tables for seed in (4, 4, 5))
    for table in one:
        for column in one[table]:
            assert np.array_equal(one[table][column], again[table][column])
    assert not np.array_equal(one["pose"]["x"], other["pose"]["x"])


def test_replicates_share_the_robot_but_not_the_noise():
    first, second = generate({}, ["drift_east"] * 2, 1)
    assert second.meta["replicate_of"] == first.name
    assert not np.array_equal(first.tables["pose"]["x"], second.tables["pose"]["x"])
    assert np.mean(first.tables["pose"]["x"]) == pytest.approx(np.mean(second.tables["pose"]["x"]), abs=0.01)


def test_the_body_is_seen_late_and_the_joints_are_told_late():
    trial = generate({}, ["steps"], 2, noise=0.0, nuisance=0.0)[0]
    command, joint = trial.tables["cmd"], trial.tables["joint"]
    sent = command["t"][np.flatnonzero(command["c1"] != 0)[0]]
    moved = joint["t"][np.flatnonzero(np.abs(joint["j1"]) > 1 * DEG)[0]]
    assert 0.06 <= moved - sent < 0.14
    fish = swim(plant({}, nuisance=0.0), excitation.get("gait").commands, start=(-1.4, 0.0, 0.0))
    seen = generate({}, ["gait"], 2, noise=0.0, nuisance=0.0)[0].tables["pose"]
    late = np.interp(seen["t"] - 0.065 - 0.06, fish.t, fish.at(fish.t, "x")[:, 0])
    assert seen["x"] == pytest.approx(late, abs=0.004)


def test_in_air_there_is_no_water_and_no_camera():
    dry, thick = (generate(e, ["chirp"], 1, medium="air")[0] for e in ({}, {"quadratic_drag": {"coefficient": 5.0}}))
    assert "pose" not in dry.tables and dry.meta["medium"] == "air"
    assert np.array_equal(dry.tables["joint"]["j3"], thick.tables["joint"]["j3"])
    wet = generate({}, ["chirp"], 1)[0]
    used = [np.mean(trial.tables["power"]["I"]) for trial in (dry, wet)]
    assert used[0] < used[1]
    assert np.max(np.abs(dry.tables["joint"]["j1"])) > 12 * DEG


def test_live_and_recorded_are_the_same_robot():
    run_ = excitation.get("ramps")
    fish, seen, joints = ClosedLoopRobot(seed=3, noise=0.0), [], []
    for command in run_.commands[:200]:
        fish.send(command)
        tables = fish.advance(excitation.PERIOD)
        seen.append(tables["pose"]["x"][-1])
        joints.append(tables["joint"]["j2"][-1])
    trial = generate({}, ["ramps"], 3, noise=0.0)[0]
    assert seen == pytest.approx(trial.tables["pose"]["x"][:200], abs=1e-9)
    assert joints == pytest.approx(trial.tables["joint"]["j2"][:200], abs=1e-9)
    with pytest.raises(ConfigError, match="expected 3 finite angles"):
        fish.send([1.0, 2.0])


def test_bad_input_is_one_clear_error(made):
    with pytest.raises(ConfigError, match="medium"):
        plant({}, medium="oil")
    with pytest.raises(ConfigError, match="nuisance"):
        plant({}, nuisance=2.0)
    with pytest.raises(SimDiverged, match="left the finite numbers"):
        swim(made.with_fields({"tank.tether": -1e9, "tank.tether_x": 1.0}), np.zeros((200, 3)))
