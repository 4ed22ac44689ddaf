"""Boundary `fins`: the added mass of sheets, and their layers of water, the same in every form of the solver."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.cases import coupled_fish, disc
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.immersed.markers import EDGES, FINS, LAYER, PLAIN, Sharpness, fish_markers
from fishmj.lbm_oracle.immersed.snapshot import resume, snapshot
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.lbm_oracle.run.solver_water import boundary_name

POND = Domain(name="pond", shape=(44, 32, 20), dx=0.02, dt=0.004, sponge=4)


def test_a_disc_of_four_cells_a_radius_has_its_added_mass():
    found = {
        name: disc.added_mass_of_sheet(4, "cpu", sharpness=s) for name, s in (("plain", PLAIN), ("edges", EDGES), ("fins", FINS))
    }
    assert found["fins"] == pytest.approx(1.0, abs=0.15)
    assert found["plain"] > 1.8 and found["edges"] > 1.1  # what the layer is for
    assert disc.added_mass_of_sheet(4, "cpu", tilt=20.0, off=(0.0, 0.5, 0.2)) == pytest.approx(found["fins"], abs=0.03)


@pytest.mark.parametrize(("half", "ratio"), [(2, 2), (4, 1)])
def test_a_plate_of_few_cells_has_its_added_mass(half, ratio):
    assert disc.added_mass_of_sheet(half, "cpu", ratio=ratio) == pytest.approx(1.0, abs=0.1)


def test_a_layers_momentum_is_the_sum_over_its_markers():
    """The fish turned and bent: each sheet's water moves along the normal with the speed of its markers."""
    body, dx = ImmersedBody.of("fish", "free", 0.004), 0.01
    markers, rho, random = fish_markers("fish", dx, sharpness=FINS), 1000.0, np.random.default_rng(0)
    body.carry_layers(markers.layer_inertia(body.links, body.water.centre, dx, rho))
    qpos = body.data.qpos.copy()
    qpos[3:7] = random.normal(size=4) / 2
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[7:] = 0.3 * random.normal(size=len(qpos) - 7)
    body.place(qpos, random.normal(size=body.dofs))
    found = body.sheet_momentum.copy()
    assert (body.layer_momentum == found).all()
    expected = np.zeros((body.links, 6))
    for link, rest, share in (
        (markers.before, markers.rest, 1 - markers.share),
        (markers.after, markers.rest - markers.pivot, markers.share),
    ):
        turn = body.turn[link]
        arm = np.einsum("kij,kj->ki", turn, rest - body.water.centre[link])
        normal = np.einsum("kij,kj->ki", turn, markers.normal)
        speed = body.twist[link, :3] + np.cross(body.twist[link, 3:], arm)
        mass = share * rho * markers.area * markers.layer * dx
        push = (mass * np.sum(speed * normal, 1))[:, None] * normal
        np.add.at(expected, link, np.concatenate([push, np.cross(arm, push)], 1))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    assert np.abs(found[-1, :3]).max() > 1e-3


def test_only_sheets_have_a_layer_and_what_they_stand_for_is_taken_off():
    assert (fish_markers("fish", 0.02, sharpness=EDGES).layer == 0).all()
    markers = fish_markers("fish", 0.02, sharpness=FINS)
    assert (markers.layer[~markers.sheet] == 0).all()
    assert 0.8 * LAYER < markers.layer[markers.sheet].max() <= LAYER
    assert FINS.layer_of(np.array([True, True, False]), np.array([0.3, 2.0, 0.0])) == pytest.approx([LAYER - 0.6, 0.0, 0.0])
    assert boundary_name(FINS) == "fins" and boundary_name(Sharpness(layer=1.0)).endswith("layer=1.0)")
    with pytest.raises(ConfigError, match="sharpness: layer = -1"):
        Sharpness(layer=-1.0)


def test_layers_are_refused_with_another_kernel_than_theirs():
    with pytest.raises(ConfigError, match=r"a kernel of 4 points for markers with a layer .* width = 3 \(--kernel 3\)"):
        SwimSetup(domain=POND, sharpness=FINS, width=4).coupled()
    SwimSetup(domain=POND, sharpness=EDGES, width=4).coupled()


def swimming(sharpness: Sharpness = FINS):
    """The fish in a periodic pond."""
    made = coupled_fish.pond("cpu")
    return type(made)(made.fluid, made.body, fish_markers("fish", 0.02, slip=1.0, sharpness=sharpness), slip=1.0)


def test_a_fish_with_layers_conserves_momentum_and_goes_on_to_the_bit():
    fish = swimming()
    history = coupled_fish.beat(fish, 0.6)
    assert np.abs(history[-1].displaced).max() > 0
    assert coupled_fish.drift(history) < 0.03
    cells, markers = coupled_fish.exchange(fish)
    assert np.abs(cells - markers).max() < 2e-6 * np.abs(markers).max()
    other = swimming()
    resume(other, snapshot(fish))
    for one in (fish, other):
        for _ in range(3):
            one.step()
    assert (fish.body.data.qvel == other.body.data.qvel).all()
    assert (fish.body.layer_momentum == other.body.layer_momentum).all()


def test_a_light_free_sheet_does_not_vibrate():
    """Without the lag of its layers' momentum a sheet without mass swings from step to step, and more each time."""
    water = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-5), (28, 28, 28), "cpu")
    free = disc.sheet_in_water(disc.disc_markers(6, FINS, angle=0.3), water, slip=1.0)
    free.body.model.body_mass[1] = 1e-3
    free.body.applied[:] = 1e-4 * free.boundary.markers.normal[0]
    speed = np.array([free.step() @ free.boundary.markers.normal[0] for _ in range(100)])
    assert np.abs(np.diff(speed, 2))[70:].max() < 0.1 * np.diff(speed)[70:].mean()


@pytest.mark.parametrize("warps", [False, True])
def test_layers_on_the_device_are_the_hosts(warps):
    command = 0.5 * np.sin(0.3 * np.arange(10)[:, None] - np.arange(3))
    one, other, plain = (SwimSetup(domain=POND, sharpness=s).coupled() for s in (FINS, FINS, EDGES))
    steps = DeviceSteps(other, 5, warps=warps)
    for n, target in enumerate(command):
        for each in (one, plain):
            each.body.data.ctrl[:] = target
            each.step()
        if n % 5 == 0:
            steps.queue(command[n : n + 5])
            steps.finish(audit=True)
    np.testing.assert_allclose(other.body.data.qvel, one.body.data.qvel, atol=1e-7)
    assert np.abs(plain.body.data.qvel - one.body.data.qvel).max() > 1e-3  # the layers count
    for mine, theirs in zip(other.take_wrench(0.04), one.take_wrench(0.04), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-5)


def test_layers_in_finer_cells_on_the_device_are_the_hosts():
    box, made = Domain(name="pool", shape=(44, 40, 20), dx=0.02, dt=0.004, sponge=4, fine=(0.64, 0.56, 0.28)), []
    for on_device in (False, True):
        run = SwimSetup(domain=box, sharpness=FINS).run(on_device=on_device, latency=0.0)
        for tick in range(2):
            run.tick(0.3 * np.sin(tick - np.arange(3)))
        made.append(run.coupled.body)
    one, other = made
    np.testing.assert_allclose(other.data.qvel, one.data.qvel, atol=1e-7)
    tail = fish_markers("fish", 0.01, slip=1.0, sharpness=FINS)
    expected = tail.layer_inertia(one.links, one.water.centre, 0.01, 1000.0)
    np.testing.assert_allclose(one.layers, expected, rtol=0.01)


@pytest.mark.gpu
def test_layers_on_a_gpu_are_those_of_the_cpu():
    made = []
    for device, on_device in (("cpu", False), ("cuda", False), ("cuda", True)):
        run = SwimSetup(domain=POND, sharpness=FINS, device=device).run(on_device=on_device, latency=0.0)
        for tick in range(10):
            run.tick(0.3 * np.sin(0.5 * tick - np.arange(3)))
        made.append(run.coupled.body.data.qvel.copy())
    for other in made[1:]:
        np.testing.assert_allclose(other, made[0], atol=1e-5)
