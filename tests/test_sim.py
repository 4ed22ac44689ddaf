"""One fish in MuJoCo: the main loop, its log, and that it swims as the batched engines do."""

import jax
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.base.errors import ConfigError
from fishmj.engines import planar
from fishmj.log import read_trial, stacked, write_trial
from fishmj.mjcf.servos import on_the_bus
from fishmj.sim import Sim
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.flow import Flow, stack


def gait(t, n=3, f=1.0):
    """Joint commands (n,) of a travelling wave, rad."""
    return np.radians(30) * np.sin(2 * np.pi * f * t - np.radians(60) * np.arange(n))


def odd_fish(robot):
    """One randomised fish as (FishParams of one, Swimmer)."""
    rng = np.random.default_rng(5)
    p = engines.nominal_params(robot, 1)
    scale = lambda a: a * rng.uniform(0.9, 1.1, a.shape)
    p = p._replace(mass=scale(p.mass), kp=scale(p.kp), kv=scale(p.kv), kb=scale(p.kb), water=scale(p.water))
    p = p._replace(zero=rng.uniform(-0.08, 0.08, p.zero.shape), delay=np.array([13], np.int32))
    one = lambda a: [float(x) for x in a[0]]
    n = len(robot.links)
    w = one(p.water)
    water = strip_forces.Coefficients(w[:n], w[n : 2 * n], *w[2 * n :])
    return p, planar_chain.Swimmer(*(one(a) for a in p[:5]), water)


@pytest.mark.parametrize("turbulence", ["default", "gust"])
@pytest.mark.parametrize("path", ["linear", "move_time"])
def test_sim_equals_the_closed_form_engine_over_100_ticks(turbulence, path):
    """Latency, quantisation, turbulence, randomised fish and all: MuJoCo with injected water takes the same path."""
    from dataclasses import replace

    robot = mjcf.load_robot("fish")
    robot = replace(robot, timing=replace(robot.timing, command_path=path))
    params, swimmer = odd_fish(robot)
    flow = Flow(speed=0.2, direction=2.0, turbulence=turbulence, intensity=0.1, seed=4)
    commands = np.array([gait(i / 50) * 2.5 for i in range(100)])  # over the range at times
    sim = Sim(robot, water="structured", flow=flow, swimmer=swimmer, latency=13 * 0.004, pose=(0.1, -0.2, 0.5))
    sim.run(commands, 2.0)
    with jax.enable_x64(True):
        state, trace = planar.PlanarEngine(robot).advance(
            engines.at_rest(robot, [[0.1, -0.2, 0.5]]), commands[None], params, stack([flow]), np.array([0])
        )
        expected = np.asarray(trace.pose[0]), np.asarray(trace.joint[0]), np.asarray(trace.power[0])
    truth = sim.trial().table("truth")
    np.testing.assert_allclose(np.stack([truth[k] for k in ("x", "y", "yaw")], -1), expected[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(stacked(truth, "j#"), expected[1], rtol=0, atol=1e-8)
    power = sim.trial().table("power")
    np.testing.assert_allclose(power["V"] * power["I"] - robot.servo.idle_power, expected[2], rtol=1e-6, atol=1e-8)


def test_free_root_takes_the_planar_path_in_turbulence():
    ends = [Sim("fish", root=r, flow=Flow(speed=0.1, direction=1.0, turbulence="default", seed=2)) for r in ("planar", "free")]
    for sim in ends:
        sim.run(gait, 3.0)
    np.testing.assert_allclose(ends[1].pose[:3], ends[0].pose[:3], atol=0.01)


@pytest.mark.parametrize("water", ["swift", "structured", "ellipsoid", "none"])
@pytest.mark.parametrize("root", ["planar", "free"])
def test_every_water_swims_and_logs(tmp_path, water, root):
    """A trial in the decided schema, read back equal; without water only "none" goes nowhere."""
    sim = Sim("fish", water=water, root=root)
    trial = sim.run(gait, 1.0)
    assert set(trial.tables) == {"cmd", "joint", "pose", "power", "truth", "flow"}
    assert trial.value("origin") == "synthetic" and trial.value("water") == water
    again = read_trial(write_trial(tmp_path / "trial", trial, precision="float64"))
    for name, table in trial.tables.items():
        for column, values in table.items():
            np.testing.assert_array_equal(again.table(name)[column], values, err_msg=f"{name}.{column}")
    assert len(trial.table("pose")["t"]) == 50
    np.testing.assert_allclose(trial.table("pose")["t"], np.arange(1, 51) / 50, atol=1e-9)
    np.testing.assert_allclose(trial.table("cmd")["t"], np.arange(50) / 50, atol=1e-9)
    com = sim.data.subtree_com[1][:2]
    assert (np.linalg.norm(com) < 1e-3) == (water == "none")


def test_structured_water_swims_and_the_ellipsoids_barely_do():
    """1 Hz, 30 deg, 60 deg lag: 0.2 to 0.4 m/s, and less than half of it in MuJoCo's own fluid, which leaves M_a out."""
    speed = {}
    for water in ("structured", "ellipsoid"):
        sim = Sim("fish", water=water)
        sim.run(gait, 3.0)
        start = sim.pose[:2].copy()
        sim.run(gait, 3.0)
        speed[water] = np.linalg.norm(sim.pose[:2] - start) / 3
    assert 0.2 < speed["structured"] < 0.4
    assert speed["ellipsoid"] < 0.5 * speed["structured"]


def test_a_limp_fish_drifts_with_the_stream():
    for water in ("structured", "ellipsoid"):
        sim = Sim("fish", water=water, flow=Flow(speed=0.2, direction=2.0))
        sim.run(lambda t: np.zeros(3), 10.0)
        ahead = sim.pose[3:5] @ [np.cos(2.0), np.sin(2.0)]
        assert 0.1 < ahead < 0.21, water


def test_commands_arrive_after_the_latency():
    """Not a step earlier, not a step later."""
    sim = Sim("fish", latency=0.06)
    sim.step([0.5, 0.5, 0.5])
    targets = [sim.arrived(step)[0] for step in range(20)]
    assert targets[:15] == [0.0] * 15 and all(t == on_the_bus(sim.robot.servo, [0.5])[0] for t in targets[15:20])


def test_commands_that_run_out_are_refused():
    with pytest.raises(ConfigError, match="10 bus commands last 0.2 s, asked for 1.0 s"):
        Sim("fish").run(np.zeros((10, 3)), 1.0)
