"""The closed-form engine: when a command arrives, where the links are, and that a chunk may be cut anywhere."""

from fractions import Fraction

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.engines import planar
from fishmj.mjcf.model import reference_qpos
from fishmj.mjcf.servos import on_the_bus, targets_of_tick
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, stack

ROBOT = mjcf.load_robot("fish")
STEPS, TICKS = engines.ticks_per(ROBOT)
BUS, PHYSICS = Fraction(1, 50), Fraction(1, 250)  # s
LONGEST = (engines.BUFFER - 2) * STEPS - 1  # physics steps of delay that the buffer and a timed move can serve


# ---- the bus ----


def sent_and_arrived(commands, delay, steps, ramp):
    """Brute force in exact time: what the servo aims at in every physics step, (ticks x steps, J).

    Command k leaves at k x 20 ms and arrives `delay` x 4 ms later; before the first one the command is zero. A timed move
    goes from the previous command to the new one in one tick; a step sees where the move is at the step's end.
    """
    out = []
    for n in range(len(commands) * steps):
        now = n * PHYSICS
        there = [k for k in range(len(commands)) if k * BUS + delay * PHYSICS <= now]
        newest = commands[there[-1]] if there else np.zeros(commands.shape[1])
        before = commands[there[-1] - 1] if there and there[-1] > 0 else np.zeros(commands.shape[1])
        if ramp and there:
            share = float((now + PHYSICS - there[-1] * BUS - delay * PHYSICS) / BUS)
            newest = before + share * (newest - before)
        out.append(newest)
    return np.array(out)


@pytest.mark.parametrize("ramp", [False, True], ids=["linear or hold", "move_time"])
@pytest.mark.parametrize("seed", [0, 1])
def test_commands_arrive_as_on_a_bus_with_a_delay(ramp, seed):
    """Every delay from 0 to 136 ms at once, 20 ticks of random commands, against the brute-force bus."""
    commands = np.random.default_rng(seed).uniform(-1, 1, (20, 2))
    delays = np.arange(LONGEST + 1)
    buffer, rows = np.zeros((len(delays), engines.BUFFER, 2)), []
    for command in commands:
        buffer = np.concatenate([buffer[:, 1:], np.broadcast_to(command, (len(delays), 1, 2))], 1)
        rows += targets_of_tick(np, buffer, delays, STEPS, ramp)
    found = np.stack(rows, 1)
    for delay in delays:
        np.testing.assert_allclose(found[delay], sent_and_arrived(commands, delay, STEPS, ramp), atol=1e-12)


def test_the_buffer_serves_the_longest_randomised_latency():
    from fishmj.base.calib import constant

    assert max(constant("randomisation", "command_latency")) <= float(LONGEST * PHYSICS)


def test_a_timed_move_is_an_even_ramp_over_one_tick():
    buffer = np.zeros((1, engines.BUFFER, 1))
    buffer[:, -1] = 1.0
    ramp = np.concatenate(targets_of_tick(np, buffer, np.array([0]), STEPS, True))[:, 0]
    np.testing.assert_allclose(ramp, [0.2, 0.4, 0.6, 0.8, 1.0])
    late = np.concatenate(targets_of_tick(np, buffer, np.array([3]), STEPS, True))[:, 0]
    np.testing.assert_allclose(late, [0.0, 0.0, 0.0, 0.2, 0.4])


def test_jax_sees_the_same_arrivals():
    rng = np.random.default_rng(0)
    buffer, delays = rng.normal(size=(30, engines.BUFFER, 3)).astype(np.float32), np.arange(30)
    for ramp in (False, True):
        here = targets_of_tick(np, buffer, delays, STEPS, ramp)
        there = targets_of_tick(jnp, jnp.asarray(buffer), jnp.asarray(delays), STEPS, ramp)
        np.testing.assert_allclose(np.array(there), np.array(here), atol=1e-6)


# ---- geometry ----


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_link_centres_are_where_mujoco_has_them(name):
    robot = mjcf.load_robot(name)
    model, ch = mjcf.build(robot), planar_chain.chain_of(robot)
    data, rng = mujoco.MjData(model), np.random.default_rng(2)
    for _ in range(20):
        q = np.concatenate([rng.uniform(-2, 2, 2), rng.uniform(-3, 3, 1), rng.uniform(-1, 1, robot.n_joints)])
        data.qpos[:] = reference_qpos(model, q[:3], q[3:])
        mujoco.mj_kinematics(model, data)
        expected = [data.site(f"{link.name}_centre").xpos[:2] for link in robot.links]
        np.testing.assert_allclose(planar.link_centres(np, ch, q[None])[0], expected, atol=1e-12)


# ---- the engine ----


@pytest.fixture(scope="module")
def engine():
    return engines.make("planar", ROBOT)


def shoal(n=4):
    """Fish that differ in everything, their flow, and two control steps of commands."""
    rng = np.random.default_rng(4)
    params = engines.nominal_params(ROBOT, n)
    params = params._replace(
        mass=params.mass * rng.uniform(0.9, 1.1, params.mass.shape),
        zero=rng.uniform(-0.08, 0.08, params.zero.shape),
        delay=rng.integers(5, 31, n).astype(np.int32),
    )
    state = engines.at_rest(ROBOT, rng.uniform(-1, 1, (n, 3)))
    current = stack([Flow(speed=0.2, direction=s % 6.28, turbulence="default", intensity=0.1, seed=s) for s in range(n)])
    return state, rng.uniform(-1, 1, (n, 2 * TICKS, 3)), params, current, np.array([0, 7, 400, 1500])[:n]


def test_a_chunk_may_be_cut_anywhere(engine):
    """20 ticks at once equal 3 + 17: commands on their way, turbulence and attachment carry over."""
    state, commands, params, current, tick = shoal()
    whole, trace = engine.advance(state, commands, params, current, tick)
    first, early = engine.advance(state, commands[:, :3], params, current, tick)
    second, late = engine.advance(first, commands[:, 3:], params, current, tick + 3)
    for one, two in zip(whole, second, strict=True):
        np.testing.assert_allclose(two, one, atol=2e-6)
    for one, a, b in zip(trace, early, late, strict=True):
        np.testing.assert_allclose(np.concatenate([a, b], 1), one, atol=2e-5)


def test_the_trace_ends_in_the_state(engine):
    """Encoder angles read zero at the hinge's own zero; poses, rates and velocities are those of the last tick."""
    state, commands, params, current, tick = shoal()
    end, trace = engine.advance(state, commands, params, current, tick)
    np.testing.assert_array_equal(trace.pose[:, -1], end.q[:, :3])
    np.testing.assert_array_equal(trace.velocity[:, -1], end.v[:, :3])
    np.testing.assert_array_equal(trace.rate[:, -1], end.v[:, 3:])
    np.testing.assert_allclose(trace.joint[:, -1], end.q[:, 3:] - params.zero, atol=1e-6)
    np.testing.assert_allclose(end.buffer, on_the_bus(ROBOT.servo, commands[:, -engines.BUFFER :]), atol=1e-6)
    assert trace.power.shape == (4, 2 * TICKS) and (np.asarray(trace.power) >= 0).all()


def test_a_command_moves_nothing_before_it_arrives(engine):
    """Straight fish in still water with the longest and the shortest latency: exactly still until then."""
    params = engines.nominal_params(ROBOT, 2)._replace(delay=np.array([5, 30], np.int32))
    state = engines.at_rest(ROBOT, np.zeros((2, 3)))
    current = stack([Flow(), Flow()])
    _, trace = engine.advance(state, np.full((2, 10, 3), 0.5), params, current, np.zeros(2, int))
    moving = np.abs(np.asarray(trace.rate)).max(-1) > 0
    assert [int(np.argmax(row)) for row in moving] == [1, 6]


def test_the_servo_clamps_and_rounds_what_it_is_sent():
    sent = np.array([[-9.0, 0.0, 9.0, 0.1]])
    got = on_the_bus(ROBOT.servo, sent)
    assert np.abs(got).max() <= ROBOT.servo.range + ROBOT.servo.resolution / 2
    np.testing.assert_allclose(got / ROBOT.servo.resolution, np.rint(got / ROBOT.servo.resolution), atol=1e-9)
    assert abs(got[0, 3] - 0.1) <= ROBOT.servo.resolution / 2


def test_commands_of_the_wrong_shape_are_one_clear_error(engine):
    state, commands, params, current, tick = shoal()
    for wrong in (commands[:, :, :2], commands[:, 0]):
        with pytest.raises(ConfigError, match="expected \\(fish, ticks, 3\\)"):
            engine.advance(state, wrong, params, current, tick)
    with pytest.raises(UnknownName, match="Did you mean 'planar'"):
        engines.make("planer", ROBOT)
