"""Steps that never wait for the host, beside the host's own."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.cases.coupled_fish import pond
from fishmj.lbm_oracle.cases.sphere import ball
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.immersed.markers import fish_markers, sphere_markers
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import DomainWatch, Gait, SwimSetup
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


@pytest.mark.parametrize(("root", "warps"), [("planar", False), ("planar", True), ("free", True)])
def test_a_tick_on_the_device_is_the_hosts_tick(root, warps):
    """With the markers' kernels of the host's steps, and with those of a warp a marker; MuJoCo's own steps agree."""
    one, other = pond("cpu", root=root), pond("cpu", root=root)
    steps = DeviceSteps(other, COUNT, warps=warps)
    for tick in range(3):
        torque, rate, fastest = by_the_host(one, tick)
        steps.queue(command(tick))
        seen = steps.finish(audit=True)
        assert (other.steps_since_sync, one.steps_since_sync) == (COUNT, 1)
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


def tube(**options) -> SwimSetup:
    """Long enough for water far from the fish, which reaches round the end of the array."""
    domain = Domain(name="tube", shape=(130, 40, 20), dx=0.02, dt=0.004, follows=True, sponge=4)
    return SwimSetup(domain=domain, pose=(1.5, 0.0, 0.0), **options)


def test_an_audit_names_both_numbers_where_mujoco_disagrees():
    coupled = pond("cpu")
    steps, before = DeviceSteps(coupled, COUNT), coupled.body.data.qpos.copy()
    coupled.body.model.body_mass[2] *= 1.01  # of MuJoCo's fish, not of the device's
    steps.queue(command(0))
    with pytest.raises(SimDiverged, match=r"audit by mj_step at t = 0 s: velocity \d is .+ on the device and .+ in MuJoCo"):
        steps.finish(audit=True)
    np.testing.assert_array_equal(coupled.body.data.qpos, before)
    assert coupled.steps == 0 and coupled.time == 0.0


def test_levels_of_water_are_the_hosts_too():
    box, made = Domain(name="pool", shape=(44, 40, 20), dx=0.02, dt=0.004, sponge=4, fine=(0.64, 0.56, 0.28)), []
    for on_device in (False, True):
        run = SwimSetup(domain=box).run(on_device=on_device, latency=0.0)
        for tick in range(2):
            run.tick(0.3 * command(tick)[0])
        made.append(run)
    one, other = made
    assert 1 in other._pipeline.steps and not one._pipeline.steps
    np.testing.assert_allclose(state_of(other.coupled), state_of(one.coupled), atol=1e-11)
    assert other.coupled.fluid.account == one.coupled.fluid.account


# in runs --------------------------------------------------------------------------------------------------------------


def columns(run: Run) -> list[np.ndarray]:
    return [np.array(column) for column in zip(*run.rows, strict=True)]


def test_a_run_on_the_device_is_the_run_of_the_host():
    gait, made = Gait(ramp=0.2), []
    for on_device in (False, True):
        run = Run(pond("cpu"), on_device=on_device)
        for _ in range(12):
            run.tick(gait(run.time))
        made.append(run)
    one, other = made
    assert 1 in other._pipeline.steps and not one._pipeline.steps
    for mine, theirs in zip(columns(other), columns(one), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-11, rtol=1e-9)
    assert (other.watch.looks, other.coupled.steps) == (one.watch.looks, one.coupled.steps)
    assert other.fastest == pytest.approx(one.fastest)


@pytest.mark.parametrize("limit", [0.35, 0.15])
def test_too_fast_device_tick_is_repeated_with_finer_steps_like_the_host(monkeypatch, limit):
    """Twice and four times finer ones: what the host's own steps do, and MuJoCo's agree."""
    gait, made, factors = Gait(ramp=0.2), [], []
    monkeypatch.setattr(Run, "limit", limit)
    monkeypatch.setattr("fishmj.lbm_oracle.run.pipeline.AUDIT", 3)
    for on_device in (False, True):
        run = Run(pond("cpu"), on_device=on_device, latency=0.0)
        for _ in range(12):
            run.tick(gait(run.time))
            factors.append(run.factor)
        made.append(run)
    one, other = made
    assert max(factors) == max(other._pipeline.steps) == (4 if limit == 0.15 else 2) and not one._pipeline.steps
    assert (other.refined, other.watch.looks) == (one.refined, one.watch.looks) and one.refined > 0
    for mine, theirs in zip(columns(other), columns(one), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-11, rtol=1e-9)


def swum(pipelined: bool, ticks: int = 14, root: str = "planar", **options) -> tuple[Run, list[bool]]:
    """A run that MuJoCo audits in ticks 0, 3 and 9, and whether it was ahead after each tick."""
    gait, run = Gait(ramp=0.2), Run(pond("cpu", root=root), on_device=True, **options)
    run._pipeline.steps[1], run.pipelined, run._pipeline.audit_offset = (
        DeviceSteps(run.coupled, run.steps, warps=True),
        pipelined,
        3,
    )
    went = []
    for _ in range(ticks):
        run.tick(gait(run.time))
        went.append(run.coupled.in_flight)
    return run, went


@pytest.mark.parametrize(("root", "off"), [("planar", 0.0), ("free", 1e-13)])
def test_ticks_ahead_are_the_same_ticks(monkeypatch, root, off):
    """To the bit; a free fish to the round-off of its quaternion's length. The watch looks as often.

    Ticks that wait: the first, those that are audited, and one at whose start a survey behind an audited tick is judged.
    """
    monkeypatch.setattr("fishmj.lbm_oracle.run.pipeline.AUDIT", 6)
    (one, paused), (other, went) = swum(False, root=root), swum(True, root=root)
    assert not any(paused) and [k for k in range(14) if not went[k]] == [0, 3, 9, 10]
    for mine, theirs in zip(columns(other), columns(one), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=off, rtol=off)
    assert other.watch.looks == one.watch.looks > 0


def test_water_that_is_ahead_of_its_fish_is_not_shown():
    run, went = swum(True, ticks=2)
    assert went == [False, True] and run.coupled.fluid.steps == run.coupled.steps + run.steps
    with pytest.raises(ConfigError, match=r"the water is ahead of the fish's t = 0\.04 s; take a run with pipelined = False"):
        run.coupled.scope()
    with pytest.raises(ConfigError, match="the water is ahead"):
        run.begin()
    run.tethered = True
    with pytest.raises(ConfigError, match="the host cannot go on there"):
        run.tick(np.zeros(3))


def test_a_command_that_arrives_within_its_tick_is_waited_for():
    assert not any(swum(True, ticks=3, latency=0.016)[1])
    assert swum(True, ticks=3, latency=0.02)[1] == [False, True, True]


def test_a_box_of_water_that_follows_its_fish_is_never_ahead():
    seen: list[int] = []
    assert not any(swum(True, ticks=3, follow=lambda coupled: seen.append(coupled.steps))[1]) and seen == [5, 10, 15]
    stays, moves = (DomainWatch(preset(name)) for name in ("paper", "window"))
    assert (stays.moves_water, moves.moves_water) == (False, True)


def test_too_fast_fish_gets_finer_steps_after_the_prefetched_tick(monkeypatch):
    monkeypatch.setattr(Run, "limit", 0.35)
    run, went = swum(True, ticks=18)
    # tick 13 had begun when 12 was found to be fast: it is taken as it is, and those behind it in finer steps
    assert went[12] and not any(went[13:]) and run.refined == 4


def test_steps_go_behind_one_set_of_steps():
    steps = DeviceSteps(pond("cpu"), COUNT, warps=True)
    for under_way in (0, 2):
        if under_way:
            steps.queue(command(0))
            steps.queue_next(command(1))
        with pytest.raises(ConfigError, match=f"{under_way} sets under way; `queue_next` goes behind one"):
            steps.queue_next(command(2))


def test_what_is_led_is_left_to_the_host():
    run = Run(pond("cpu"), on_device=True, tethered=True)
    start = run.pose[:3].copy()
    run.root = lambda t: start + [0.01 * t, 0.0, 0.0]
    run.tick(np.zeros(3))
    assert not run._pipeline.steps
    run.tethered = False
    run.tick(np.zeros(3))
    assert 1 in run._pipeline.steps
    led = Run(pond("cpu"), on_device=True, prescribed=Gait())
    led.tick()
    assert not led._pipeline.steps
    other = Run(pond("cpu", scheme="explicit"), on_device=True)
    other.tick(np.zeros(3))
    assert not other._pipeline.steps and not other.on_device


@pytest.mark.parametrize("pipelined", [False, True])
def test_a_fish_that_is_held_and_let_go_is_the_hosts(pipelined, monkeypatch):
    """MuJoCo's own steps agree while it is held, too; no tick is ahead of the one after which it is let go."""
    monkeypatch.setattr("fishmj.lbm_oracle.run.pipeline.AUDIT", 2)
    gait, made = Gait(ramp=0.2), []
    for on_device in (False, True):
        run = Run(pond("cpu", slip=0.97), on_device=on_device, tethered=True, latency=0.02)
        run.pipelined = pipelined and on_device
        if on_device and pipelined:
            run._pipeline.steps[1] = DeviceSteps(run.coupled, run.steps, warps=True)
        for tick in range(9):
            run.tethered = tick < 4
            run.tick(gait(run.time))
            if tick == 3:
                assert np.abs(run.coupled.body.data.qvel[:3]).max() < 1e-15 < np.abs(run.rates()).max()
                held = run.pose[:3].copy()
            elif tick < 3:
                assert run.coupled.in_flight is False
        assert np.abs(run.pose[:3] - held).max() > 1e-4
        made.append(run)
    one, other = made
    for mine, theirs in zip(columns(other), columns(one), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-11, rtol=1e-9)


def test_a_tank_alone_keeps_its_steps_on_the_host_on_a_cpu():
    """Shipped data were made so, to the bit."""
    assert not Run(pond("cpu")).on_device


def test_domain_watch_interval_in_steps_is_independent_of_batching():
    looks = []
    for steps in (1, 5, 10):
        watch, coupled = DomainWatch(replace(preset("laptop"), shape=(120, 120, 40))), tube().coupled()
        seen: list[int] = []
        watch.follow = lambda coupled, seen=seen: seen.append(coupled.steps)
        for coupled.steps in range(steps, 61, steps):
            coupled.steps_since_sync = steps
            watch(coupled)
        looks.append(len(seen))
    assert looks == [15, 15, 15]


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


@pytest.mark.gpu
@pytest.mark.parametrize("limit", [0.35, 0.15])
def test_finer_steps_on_an_accelerator_are_the_hosts(monkeypatch, limit):
    """A held fish, let go, in ticks that are done again with twice and four times finer steps."""
    monkeypatch.setattr(Run, "limit", limit)
    gait, made, factors = Gait(ramp=0.2), [], []
    for device in ("cpu", "cuda"):
        run = Run(pond(device, slip=0.97), latency=0.0, tethered=True)
        for tick in range(14):
            run.tethered = tick < 3
            run.tick(gait(run.time))
            factors.append(run.factor)
        made.append(run)
    one, other = made
    assert other.on_device and not one.on_device
    assert factors[:14] == factors[14:] and max(factors) == (4 if limit == 0.15 else 2) == max(other._pipeline.steps)
    np.testing.assert_allclose(np.array([row[3] for row in other.rows]), np.array([row[3] for row in one.rows]), atol=1e-3)
