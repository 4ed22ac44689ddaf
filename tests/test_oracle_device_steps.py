"""Steps that never wait for the host, beside the host's own."""

import numpy as np
import pytest
import warp as wp

from fishmj.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.cases.coupled_fish import pond
from fishmj.lbm_oracle.cases.sphere import ball
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.immersed.markers import fish_markers, sphere_markers
from fishmj.mjcf import Link, Robot

wp.config.quiet = True

COUNT = 5


def command(tick: int) -> np.ndarray:
    """(COUNT, 3) rad; some steps saturate the servo."""
    return 0.5 * np.sin(0.3 * (COUNT * tick + np.arange(COUNT))[:, None] - np.arange(3))


def by_the_host(coupled, tick: int) -> tuple[np.ndarray, np.ndarray, float]:
    """The same steps one by one: torques, rates and the fastest corner."""
    torque, rate, fastest = [], [], 0.0
    for target in command(tick):
        coupled.body.data.ctrl[:] = target
        rate.append(coupled.body.data.qvel.copy())
        coupled.step()
        torque.append(coupled.body.data.actuator_force.copy())
        fastest = max(fastest, coupled.body.fastest(coupled.boundary.corners))
    return np.array(torque), np.array(rate), fastest


def state_of(coupled) -> np.ndarray:
    body = coupled.body
    found = [body.data.qpos, body.data.qvel, body.momentum.ravel(), body.interior_speed, [body.data.time, coupled.steps]]
    return np.concatenate(found)


@pytest.mark.parametrize("root", ["planar", "free"])
def test_a_tick_on_the_device_is_the_hosts_tick(root):
    one, other = pond("cpu", root=root), pond("cpu", root=root)
    steps = DeviceSteps(other, COUNT)
    for tick in range(3):
        torque, rate, fastest = by_the_host(one, tick)
        seen = steps.run(command(tick))
        np.testing.assert_allclose(state_of(other), state_of(one), atol=1e-11)
        np.testing.assert_allclose(seen.torque, torque, atol=1e-10)
        np.testing.assert_allclose(seen.rate, rate, atol=1e-11)
        assert seen.fastest == pytest.approx(fastest, rel=1e-10)
        for mine, theirs in zip(other.take_wrench(0.02), one.take_wrench(0.02), strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-9)
    np.testing.assert_allclose(other.fluid.f.numpy(), one.fluid.f.numpy(), atol=1e-6)


def test_the_host_goes_on_where_the_device_ended():
    """Step by step, in ticks, step by step: the interior water's memory and a push from outside included."""
    one, other = pond("cpu", slip=0.97), pond("cpu", slip=0.97)
    for coupled in (one, other):
        coupled.body.applied[0] = 0.1
    steps = DeviceSteps(other, COUNT)
    for tick, device in enumerate((False, True, False, True)):
        by_the_host(one, tick)
        if device:
            steps.run(command(tick))
        else:
            by_the_host(other, tick)
    np.testing.assert_allclose(state_of(other), state_of(one), atol=1e-11)


def test_a_body_without_servos_whose_water_moves_with_it():
    made = []
    for _ in range(2):
        lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)
        body = ball(3.0, lattice, density=0.5, at=(10.3, 10.1, 9.8))
        body.applied[0] = 1e-3
        made.append(FluidStructure(Fluid(lattice, (20,) * 3, "cpu", subgrid="none"), body, sphere_markers(3.0, 1.0), slip=0.0))
    one, other = made
    for _ in range(2 * COUNT):
        one.step()
    steps = DeviceSteps(other, COUNT)
    for _ in range(2):
        assert steps.run(np.zeros((COUNT, 0))).torque.shape == (COUNT, 0)
    np.testing.assert_allclose(state_of(other), state_of(one), atol=1e-13)
    assert one.body.data.qvel[0] > 1e-5


def test_a_chain_of_twelve_links():
    links = tuple(Link(name=f"l{i}", length=0.05, mass=0.1, sections=((0.0, 0.08, 0.05), (0.05, 0.08, 0.05))) for i in range(12))
    robot, made = Robot(name="chain", links=links), []
    for _ in range(2):
        lattice = Lattice(dx=0.02, dt=0.004, corner=(0.0, 0.0, -0.2))
        body = ImmersedBody.of(robot, "planar", 0.004)
        body.place(np.concatenate([[0.6, 0.32], np.zeros(12)]))
        water = Fluid(lattice, (56, 32, 20), "cpu")
        made.append(FluidStructure(water, body, fish_markers(robot, 0.02), slip=1.0))
    one, other = made
    target = 0.2 * np.sin(np.arange(11.0))
    one.body.data.ctrl[:] = target
    for _ in range(COUNT):
        one.step()
    DeviceSteps(other, COUNT).run(np.tile(target, (COUNT, 1)))
    np.testing.assert_allclose(state_of(other), state_of(one), atol=1e-10)


def test_a_body_that_runs_away_stops_and_says_which_joint():
    coupled = pond("cpu")
    steps, before = DeviceSteps(coupled, 1), coupled.body.data.qpos.copy()
    coupled.body.applied[4] = 1e9
    with pytest.raises(SimDiverged, match=r"velocity of joint '.+' is"):
        steps.run(np.zeros((1, 3)))
    np.testing.assert_array_equal(coupled.body.data.qpos, before)


def test_the_explicit_scheme_is_left_to_the_host():
    with pytest.raises(ConfigError, match="'explicit'; expected 'implicit'"):
        DeviceSteps(pond("cpu", scheme="explicit"), COUNT)


def test_commands_are_one_row_a_step():
    with pytest.raises(ConfigError, match=r"commands of shape \(3,\); expected \(5, 3\)"):
        DeviceSteps(pond("cpu"), COUNT).run(np.zeros(3))


@pytest.mark.gpu
@pytest.mark.parametrize("root", ["planar", "free"])
def test_captured_ticks_on_an_accelerator_are_the_hosts(root):
    """Ticks before, in and after capture, at both parities of the water's copies."""
    one, other = pond("cpu", root=root, slip=0.97), pond("cuda", root=root, slip=0.97)
    steps = DeviceSteps(other, COUNT)
    for tick in range(8):
        by_the_host(one, tick)
        steps.run(command(tick))
    np.testing.assert_allclose(state_of(other), state_of(one), atol=1e-3)
