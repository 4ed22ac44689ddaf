"""One fish in MuJoCo: the main loop, its log, and that it swims as the batched engines do."""

import jax
import numpy as np
import pytest

from fishmj import engines, mjcf
from fishmj.engines import planar
from fishmj.errors import ConfigError
from fishmj.flow import Flow, stack
from fishmj.hydro_fit import chain
from fishmj.log import read_trial, stacked, write_trial
from fishmj.sim import WATERS, Sim, bus_command


def gait(t, n=3, f=1.0):
    """Joint commands (n,) of a travelling wave, rad."""
    return np.radians(30) * np.sin(2 * np.pi * f * t - np.radians(60) * np.arange(n))


def odd_fish(robot):
    """One randomised fish as (FishParams of one, Swimmer)."""
    rng = np.random.default_rng(5)
    p = engines.nominal_params(robot, 1)
    scale = lambda a: a * rng.uniform(0.9, 1.1, a.shape)  # noqa: E731
    p = p._replace(mass=scale(p.mass), kp=scale(p.kp), kv=scale(p.kv), kb=scale(p.kb), water=scale(p.water))
    p = p._replace(zero=rng.uniform(-0.08, 0.08, p.zero.shape), delay=np.array([13], np.int32))
    one = lambda a: [float(x) for x in a[0]]  # noqa: E731
    n = len(robot.links)
    w = one(p.water)
    water = chain.terms.Coefficients(w[:n], w[n : 2 * n], *w[2 * n :])
    return p, chain.Swimmer(*(one(a) for a in p[:5]), water)


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
    sim = Sim(robot, flow=flow, swimmer=swimmer, latency=13 * 0.004, pose=(0.1, -0.2, 0.5))
    sim.run(commands, 2.0)
    with jax.enable_x64(True):
        state, trace = planar.Engine(robot).advance(
            engines.at_rest(robot, [[0.1, -0.2, 0.5]]), commands[None], params, stack([flow]), np.array([0])
        )
        expected = np.asarray(trace.pose[0]), np.asarray(trace.joint[0]), np.asarray(trace.power[0])
    truth = sim.trial().table("truth")
    np.testing.assert_allclose(np.stack([truth[k] for k in ("x", "y", "yaw")], -1), expected[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(stacked(truth, "j#"), expected[1], rtol=0, atol=1e-8)
    power = sim.trial().table("power")
    np.testing.assert_allclose(power["V"] * power["I"] - robot.servo.idle_power, expected[2], rtol=1e-6, atol=1e-8)
