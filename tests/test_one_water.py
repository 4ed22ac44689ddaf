"""One fitted water, strips and learnt residual, is one water on every engine and by every way into MuJoCo.

A gait of 1.6 s in turbulence, in the shipped water and in one member of its ensemble. Pose, joints, rates, servo power and what
the fish remembers are those of the closed form in NumPy.
"""

from typing import NamedTuple

import jax
import mujoco
import numpy as np
import pytest

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.engines import batch, mjx, planar
from fishmj.engines.single import SingleFish
from fishmj.log import stacked
from fishmj.mjcf import load_robot
from fishmj.mjcf.servos import on_the_bus
from fishmj.sim import Sim
from fishmj.tasks.dm_control.physics import Physics
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, sample, stack
from fishmj.water.hydro_model import HydroModel

POSE = (0.1, -0.2, 0.5)
FLOW = Flow(speed=0.2, direction=2.0, turbulence="default", intensity=0.15, seed=4)
TICKS = 80
COMMANDS = np.radians(35) * np.sin(2.4 * np.pi * np.arange(TICKS)[:, None] / 50 - np.radians(60) * np.arange(3))
WATERS = ("swift", "swift#2")


class Swum(NamedTuple):
    """One row a bus tick."""

    pose: np.ndarray  # (T, 3) m, rad
    joint: np.ndarray  # (T, 3) rad
    rate: np.ndarray  # (T, 3) rad/s
    power: np.ndarray  # (T,) W
    memory: np.ndarray  # (18,) at the end
    attached: float  # at the end


def in_water(water):
    return engines.in_water(load_robot("fish"), water)


def closed_form(water):
    """`planar_chain.step` in NumPy, with the bus and the flow of a `Sim` spelt out."""
    robot = in_water(water)
    ch, added = planar_chain.chain_of(robot), engines.Extensions.of(robot)
    fish = SingleFish(ch, planar_chain.nominal(robot), added)
    q, v, rows = [*POSE, 0.0, 0.0, 0.0], [0.0] * 6, []
    sent = [np.zeros(3), *on_the_bus(robot.servo, COMMANDS)]  # number 0 was on the bus before t = 0
    late = round(robot.timing.command_latency / ch.dt)
    for tick in range(TICKS):
        centres = planar.link_centres(np, ch, np.array([q]))
        flow, ambient = sample(np, FLOW.current(), centres, np.array([tick]))
        power = 0.0
        for k in range(5):
            target = sent[max(0, 1 + (5 * tick + k - late) // 5)]
            s = fish.advance(q, v, target.tolist(), flow[0].tolist(), ambient[0].tolist())
            q, v, power = list(s.q), list(s.v), power + s.power / 5
        rows.append((q[:3], q[3:], v[3:], power))
    return Swum(*(np.array(column) for column in zip(*rows, strict=True)), np.array(fish.memory), fish.attached)


def batched(engine, robot):
    state, trace = engine.advance(
        engines.at_rest(robot, [POSE]), COMMANDS[None], engines.nominal_params(robot, 1), stack([FLOW]), np.array([0])
    )
    one = (np.asarray(a)[0] for a in (trace.pose, trace.joint, trace.rate, trace.power, state.memory, state.attached))
    return Swum(*one)


def in_jax(engine, water):
    with jax.enable_x64(True):
        return batched(engine(in_water(water)), in_water(water))


def in_sim(water, **options):
    sim = Sim(in_water(water), flow=FLOW, pose=POSE, **options)
    trial = sim.run(COMMANDS, TICKS / 50)
    truth, power = trial.table("truth"), trial.table("power")
    pose = np.stack([truth[name] for name in ("x", "y", "yaw")], 1)
    drawn = power["V"] * power["I"] - sim.robot.servo.idle_power
    return Swum(pose, stacked(truth, "j#"), stacked(truth, "k#"), drawn, np.array(sim.water.memory), sim.water.attached)


def in_suite(water, root="planar"):
    robot = in_water(water)
    physics, rows = Physics.of(robot, root), []
    with physics.reset_context():
        physics.begin(np.array(POSE), engines.nominal_params(robot, 1), FLOW.current())
    for chunk in np.split(COMMANDS, TICKS // 10):
        physics.send(chunk)
        physics.step(5 * len(chunk))
        rows.append([np.asarray(a)[0] for a in physics.trace()])
    pose, joint, rate, _, power = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Swum(pose, joint, rate, power, np.array(physics.water.memory), physics.water.attached)


def compiled(water):
    pytest.importorskip("numba")
    return batched(engines.make("compiled", in_water(water), threads=1, dtype="float64"), in_water(water))


PATHS = {
    "planar": lambda water: in_jax(planar.PlanarEngine, water),
    "compiled": compiled,
    "batch": lambda water: batched(batch.BatchEngine(in_water(water), threads=1), in_water(water)),
    "mjx": lambda water: in_jax(mjx.MjxEngine, water),
    "callback": in_sim,
    "xfrc": lambda water: in_sim(water, injection="xfrc"),
    "qfrc": lambda water: in_sim(water, injection="qfrc"),
    "suite": in_suite,
}
SLOW = {("mjx", "swift"), ("mjx", "swift#2"), ("planar", "swift#2")}  # each compiles a network of its own


def assert_same(found, expected, atol):
    for name, mine, other in zip(Swum._fields, found, expected, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=atol, err_msg=name)


@pytest.fixture(scope="module")
def reference():
    return {water: closed_form(water) for water in WATERS}


@pytest.mark.parametrize(
    ("name", "water"),
    [pytest.param(name, water, marks=[pytest.mark.slow] * ((name, water) in SLOW)) for name in PATHS for water in WATERS],
)
def test_every_engine_and_every_way_into_mujoco_is_one_water(reference, name, water):
    assert_same(PATHS[name](water), reference[water], 1e-11)
    assert mujoco.get_mjcb_passive() is None


def test_swim_has_learnt_force_and_wake_and_a_member_differs_from_the_mean(reference):
    mean, member = (reference[water] for water in WATERS)
    strips = in_sim("swift-base")
    assert np.abs(mean.pose[-1] - strips.pose[-1]).max() > 0.01
    assert np.abs(mean.memory[:16]).max() > 0.1 and mean.memory[17] == 0.0  # inside the range all the way
    assert 1e-3 < np.abs(mean.pose[-1] - member.pose[-1]).max() < 0.1


def test_the_free_root_swims_alike_by_every_way_and_as_the_planar_one(reference):
    """Nothing vertical: path and heading of the planar root to 1 cm and 1 cm per metre, whatever puts the water in."""
    callback = in_sim("swift", root="free")
    assert_same(in_sim("swift", root="free", injection="xfrc"), callback, 1e-9)
    assert_same(in_suite("swift", "free"), callback, 1e-9)
    np.testing.assert_allclose(callback.pose, reference["swift"].pose, rtol=0, atol=0.01)
    np.testing.assert_allclose(callback.memory[:16], reference["swift"].memory[:16], rtol=0, atol=0.05)


def test_a_member_is_its_strips_and_its_network_alone(tmp_path):
    model, member = HydroModel.load("swift"), HydroModel.load("swift#2")
    assert member.name == "swift#2" and [*member.base.k, *member.base.cn] == model.members[2][:8].tolist()
    for name in ("inner", "outer"):
        for row in getattr(member.learnt.net, name):
            np.testing.assert_array_equal(row, getattr(model.learnt.net, name)[2])
    assert HydroModel.load("swift-base#2").learnt is None
    path = model.save(tmp_path)
    np.testing.assert_array_equal(HydroModel.load(f"{path}#2").members, member.members)
    robot = in_water(f"{path}#2")
    assert robot.water["k"] == in_water("swift#2").water["k"] and robot.water["model"].endswith("swift.toml#2")
    assert Sim("fish", water=f"{path}#2").swimmer == planar_chain.nominal(robot)
    assert engines.in_water(load_robot("fish"), "fitted#2").water == in_water("swift#2").water


@pytest.mark.parametrize("number", ["5", "-1", "two", ""])
def test_a_member_that_is_not_there_is_one_clear_error(number):
    with pytest.raises(ConfigError, match=f"water 'swift#{number}': got member '{number}', expected a number from 0 to 4"):
        in_water(f"swift#{number}")
