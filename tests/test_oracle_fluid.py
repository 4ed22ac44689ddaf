"""The oracle's fluid: conservation, symmetry, faces, background flow, window, and what a body sees of it."""

from dataclasses import replace

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.domain_faces import FACES, Axis, Boundaries, Slip, channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES, Lattice
from fishmj.lbm_oracle.run.domain import Follower, margin, preset
from fishmj.water.flow import Flow

pytestmark = pytest.mark.oracle
ONE = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.02)
WATER = Lattice(dx=0.02, dt=0.004)


def stirred(shape=(12, 10, 8), seed=1, speed=0.03, **options) -> Fluid:
    """A periodic box with a smooth random velocity."""
    water = Fluid(ONE, shape, **{"subgrid": "none", **options})
    water.impose(smooth(shape, seed, speed))
    return water


def smooth(shape, seed, speed) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.stack(np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in shape), indexing="ij"))
    u = np.zeros((*shape, 3))
    for _ in range(4):
        k, a, phase = rng.integers(-1, 2, 3), rng.standard_normal(3), rng.random() * 6
        u += a * np.sin(np.tensordot(k, x, 1) + phase)[..., None]
    return speed * u / np.abs(u).max()


def totals(water: Fluid) -> np.ndarray:
    """Mass and momentum of the populations, lattice units."""
    f = water.f.numpy().astype(float).reshape(19, -1)
    return np.concatenate([[f.sum()], (VELOCITIES.T @ f).sum(1)])


def test_still_water_is_still():
    water = Fluid(WATER, (10, 8, 6), boundaries=channel(sponge=2))
    water.run(20)
    assert not water.velocity().any() and not water.drho().numpy().any()


@pytest.mark.parametrize("subgrid", ["none", "wale"])
def test_mass_and_momentum_are_conserved(subgrid):
    water = stirred(subgrid=subgrid)
    before = totals(water)
    water.run(400)
    assert totals(water) == pytest.approx(before, abs=1e-6 * water.cells)
    assert np.abs(water.velocity()).max() > 1e-4  # it still moves


def test_a_push_gives_the_water_its_momentum():
    """One step: change of momentum = sum of rho G over the box, to round-off."""
    water, unpushed = stirred(), stirred()
    box = ((6, 3, 1), (12, 7, 5))
    unpushed.step()
    rho = 1.0 + unpushed.drho().numpy()  # a collision moves no mass: the density that the push will meet
    g = np.zeros((*water.shape, 3), np.float32)
    where = np.ix_(np.arange(6, 12), np.arange(3, 7), np.arange(1, 5))
    g[where] = np.random.default_rng(2).uniform(-0.01, 0.01, (6, 4, 4, 3))
    water.force.assign(g)
    before = totals(water)
    water.step(box)
    gained = totals(water)[1:] - before[1:]
    assert gained == pytest.approx(np.einsum("xyz,xyza->a", rho, g), abs=2e-6)


def test_force_outside_the_box_is_not_felt():
    water, still = stirred(), stirred()
    water.force.fill_(wp.vec3(0.01, 0.0, 0.0))
    water.step(), still.step()
    assert np.array_equal(water.f.numpy(), still.f.numpy())


def test_two_slabs_are_one():
    one, two = (stirred((16, 10, 8), subgrid="wale", threads=t) for t in (1, 2))
    one.run(25), two.run(25)
    assert two.threads == 2 and np.array_equal(one.f.numpy(), two.f.numpy())


def test_the_same_start_gives_the_same_bits():
    a, b = stirred(subgrid="wale"), stirred(subgrid="wale")
    a.run(30), b.run(30)
    assert np.array_equal(a.f.numpy(), b.f.numpy())


def test_a_restored_fluid_goes_on_bit_for_bit():
    flow = Flow(speed=0.2, direction=1.0, turbulence="default", seed=4)
    make = lambda: Fluid(WATER, (16, 14, 6), boundaries=channel(sponge=3), flow=flow)
    water, other = make(), make()
    water.run(7)
    water.shift((1, -1, 0))
    state = water.snapshot()
    water.run(9)
    other.restore(state)
    other.run(9)
    assert np.array_equal(water.f.numpy(), other.f.numpy()) and other.steps == 16
    with pytest.raises(ConfigError, match="does not fit"):
        stirred().restore(state)


def test_a_turned_world_turns_the_flow():
    """A quarter turn about z of the initial field turns the result."""
    u = smooth((12, 12, 6), 7, 0.05)
    turned = np.rot90(u, 1, (0, 1))[..., [1, 0, 2]] * [-1, 1, 1]
    one, two = Fluid(ONE, (12, 12, 6)), Fluid(ONE, (12, 12, 6))
    one.impose(u), two.impose(turned)
    one.run(40), two.run(40)
    expected = np.rot90(one.velocity(), 1, (0, 1))[..., [1, 0, 2]] * [-1, 1, 1]
    assert two.velocity() == pytest.approx(expected, abs=2e-6)


def test_a_moving_frame_moves_the_flow():
    """Galilean shift: a whole number of cells in a whole number of steps."""
    drift = np.array([0.05, 0.0, 0.0])
    rest, moving = Fluid(ONE, (16, 16, 4), subgrid="none"), Fluid(ONE, (16, 16, 4), subgrid="none")
    u = smooth((16, 16, 4), 8, 0.01)
    u -= u.mean((0, 1, 2))
    rest.impose(u), moving.impose(u + drift)
    rest.run(40), moving.run(40)  # 2 cells
    assert moving.velocity() - drift == pytest.approx(np.roll(rest.velocity(), 2, 0), abs=2.5e-4)


@pytest.mark.parametrize("kinds", ["slip", "wall"])
def test_free_slip_does_not_rub_and_a_wall_does(kinds):
    water = Fluid(ONE, (6, 6, 8), boundaries=Boundaries(z=Axis(kinds, kinds)), subgrid="none")
    water.impose(np.broadcast_to([0.05, 0.02, 0.0], (6, 6, 8, 3)))
    water.run(200)
    kept = water.velocity()[..., 0].mean() / 0.05
    assert kept == pytest.approx(1.0, abs=1e-4) if kinds == "slip" else kept < 0.7


def couette(steps: int, water: Fluid | None = None) -> np.ndarray:
    """Velocity along x over y of eight cells between a wall at rest and one that slides at 0.05 m/s."""
    faces = Boundaries(y=Axis("wall", "moving"), wall_velocity_lu=(0.05, 0.0, 0.0))
    water = water or Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.1), (1, 8, 1), boundaries=faces, subgrid="none")
    water.run(steps)
    return water.velocity()[0, :, 0, 0]


def test_a_moving_wall_drags_the_water_into_plane_couette_flow():
    """u = U y / h, walls half a cell outside the nodes: exact for bounce-back off a moving wall."""
    assert couette(4000) == pytest.approx(0.05 * (np.arange(8) + 0.5) / 8, abs=2e-6)


def test_a_finer_step_keeps_walls_and_accelerations_in_si():
    faces = Boundaries(y=Axis("wall", "moving"), wall_velocity_lu=(0.05, 0.0, 0.0))
    options = {"boundaries": faces, "subgrid": "none", "body_acceleration": (1e-4, 0.0, 0.0)}
    coarse = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.1), (1, 8, 1), **options)
    fine = coarse.finer(4)
    assert fine.lattice.dt == 0.25 and couette(200, fine) == pytest.approx(couette(50, coarse), rel=0.02, abs=1e-4)


def test_a_wall_across_from_an_open_face_stops_the_stream():
    faces = Boundaries(x=Axis("open", "wall"), y=Axis("slip", "slip"), z=Axis("slip", "slip"), sponge=4)
    water = Fluid(replace(WATER, nu=2e-5), (24, 4, 4), boundaries=faces, subgrid="none", flow=Flow(speed=0.1))
    water.run(400)
    along = water.velocity()[:, :, :, 0].mean((1, 2))
    assert abs(along[-1]) < 0.02 and np.isfinite(along).all()


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        ({"x": Axis("periodic", "wall")}, "both faces are periodic or none"),
        ({"z": Axis("open", "slip")}, "open face at the top or bottom"),
        ({"y": Axis("wall", "moving"), "wall_velocity_lu": (0.0, 0.1, 0.0)}, "can only slide"),
        ({"y": Axis("wall", "wall"), "wall_velocity_lu": (0.1, 0.0, 0.0)}, "no face is `moving`"),
    ],
)
def test_faces_that_cannot_be_are_refused(faces, words):
    with pytest.raises(ConfigError, match=words):
        Boundaries(**faces)


def test_a_moving_wall_and_an_eddy_viscosity_are_refused():
    faces = Boundaries(y=Axis("wall", "moving"), wall_velocity_lu=(0.05, 0.0, 0.0))
    with pytest.raises(ConfigError, match="moving wall with an eddy viscosity"):
        Fluid(ONE, (8, 8, 8), boundaries=faces)


def test_a_new_face_is_a_class_and_its_entry(monkeypatch):
    """A mirror by another name, on one side only: the field of a slip face to the bit."""

    class Mirror(Slip):
        rank = 4

    monkeypatch.setitem(FACES, "mirror", Mirror)
    found = []
    for kind in ("slip", "mirror"):
        water = Fluid(ONE, (10, 8, 6), boundaries=Boundaries(z=Axis("wall", kind)), subgrid="none")
        water.impose(smooth((10, 8, 6), 3, 0.05))
        water.run(8)
        found.append(water.f.numpy())
    assert np.array_equal(*found)


def test_sound_between_top_and_bottom_dies_out():
    """The trace of the stress relaxes at once: a vertical standing wave loses half in ten periods; without that it rings."""
    left = {}
    for bulk in (1.0, None):
        lattice = Lattice(dx=0.02, dt=0.004, nu=2e-5)
        omega = 1 / lattice.tau if bulk is None else bulk
        water = Fluid(lattice, (1, 1, 16), boundaries=Boundaries(z=Axis("slip", "slip")), subgrid="none", omega_bulk=omega)
        mode = np.cos(np.pi * (np.arange(16) + 0.5) / 16)
        water.impose(np.zeros((1, 1, 16, 3)), mode.reshape(1, 1, 16))
        period = 2 * 16 * 3**0.5
        heights = []
        for _ in range(round(10 * period)):
            water.run(1)
            heights.append(abs(float(water.pressure()[0, 0] @ mode)) / (mode @ mode))
        left[bulk] = max(heights[-round(period) :])
    assert left[1.0] < 0.5 < 0.9 < left[None]


@pytest.mark.parametrize("direction", [0.0, 0.65, 2.4, -np.pi / 2])
def test_a_stream_of_any_direction_passes_unchanged(direction):
    flow = Flow(speed=0.3, direction=direction)
    water = Fluid(WATER, (20, 16, 6), boundaries=channel(sponge=4), flow=flow)
    water.run(300)
    assert np.abs(water.velocity() - flow.mean).max() < 1e-4
    assert np.abs(water.drho().numpy()).max() < 1e-5


@pytest.mark.parametrize("turbulence", ["none", "default", "fine", "gust", "vortex_street", "shear"])
def test_the_background_is_the_flow_that_every_water_sees(turbulence):
    flow = Flow(speed=0.25, direction=0.7, turbulence=turbulence, intensity=0.1, seed=11, box=2)
    lattice = Lattice(dx=0.05, dt=0.02, corner=(-0.4, -0.3, -0.1))
    water = Fluid(lattice, (9, 7, 5), flow=flow)
    water.clock.fill_(150)
    water.steps = 150
    water.settle()
    points = lattice.to_si(np.stack(np.meshgrid(*map(np.arange, water.shape), indexing="ij"), -1))
    assert water.velocity() == pytest.approx(flow.at(points, 3.0), abs=2e-5)


def test_a_window_that_moves_sees_the_same_water():
    """A vortex in a stream: the window that follows and the one that stays agree where both look."""
    flow = Flow(speed=0.2, turbulence="none")
    make = lambda: Fluid(WATER, (48, 40, 4), boundaries=channel(sponge=6), flow=flow)
    stays, moves = make(), make()
    x, y = np.meshgrid(np.arange(48) - 22.0, np.arange(40) - 19.5, indexing="ij")
    u = np.zeros((48, 40, 4, 3))
    core = 0.1 * np.exp(-(x**2 + y**2) / 18)
    u[..., 0], u[..., 1] = (-y * core / 3)[..., None], (x * core / 3)[..., None]
    for water in (stays, moves):
        water.impose(u + flow.mean)
    for _ in range(4):
        stays.run(25), moves.run(25)
        moves.shift((1, 0, 0))
    one, two = stays.velocity()[12:-8, 8:-8], moves.velocity()[8:-12, 8:-8]
    assert np.abs(one - flow.mean).max() > 0.05
    assert two == pytest.approx(one, abs=2e-4)


def test_the_window_follows_a_fish_and_a_tank_does_not():
    domain = preset("laptop")
    water = Fluid(domain.lattice, domain.shape, boundaries=domain.boundaries)
    follower = Follower(domain)
    moved = sum(follower.follow(water, (0.01 * k, 0.0, 0.0), 0.0) for k in range(60))
    middle = water.lattice.to_si(water.origin_lu + (np.array(water.shape) - 1) / 2)
    assert moved > 15 and middle[0] - 0.59 == pytest.approx(0.15 * domain.size[0], abs=domain.dx)
    assert margin(water, (0.49, -0.05, -0.05), (0.69, 0.05, 0.05)) > 5
    assert not Follower(preset("paper")).follow(water, (5.0, 0.0, 0.0), 0.0)


def test_a_velocity_that_is_not_kept_is_derived():
    u = smooth((12, 10, 8), 1, 0.05)
    keeps, derives = Fluid(ONE, (12, 10, 8), subgrid="none"), Fluid(ONE, (12, 10, 8), subgrid="none", keep_velocity=False)
    keeps.impose(u), derives.impose(u)
    keeps.run(11), derives.run(11)
    assert derives.velocity() == pytest.approx(keeps.velocity(), abs=1e-6)
    with pytest.raises(ConfigError, match="keep_velocity"):
        Fluid(ONE, (8, 8, 8), keep_velocity=False)


@pytest.mark.gpu
def test_both_backends_compute_the_same_flow():
    """Two hundred steps of a turbulent stream through open faces, with a push that comes and goes."""
    flow = Flow(speed=0.3, direction=0.5, turbulence="default", intensity=0.1, seed=2)
    found = []
    for device in ("cpu", "cuda"):
        water = Fluid(WATER, (32, 28, 12), device, boundaries=channel(sponge=5), flow=flow)
        push = np.zeros((*water.shape, 3), np.float32)
        push[14:18, 12:16, 4:8] = (0.002, -0.001, 0.0005)
        water.force.assign(push)
        for _ in range(50):
            water.step(((14, 12, 4), (18, 16, 8)))
        water.run(150)
        found.append((water.velocity(), water.pressure()))
    assert found[1][0] == pytest.approx(found[0][0], abs=2e-4)
    assert found[1][1] == pytest.approx(found[0][1], abs=1.0)


def test_half_precision_storage_keeps_the_flow():
    """Populations in sixteen bits: the velocity stays within a hundredth of its scale, mass within round-off of the storage."""
    u = smooth((12, 10, 8), 1, 0.05)
    single, half = Fluid(ONE, (12, 10, 8)), Fluid(ONE, (12, 10, 8), dtype="float16")
    single.impose(u), half.impose(u)
    single.run(50), half.run(50)
    assert half.f.dtype == wp.float16
    assert half.velocity() == pytest.approx(single.velocity(), abs=5e-4)
    assert abs(half.survey().mass) < 1e-5 * half.cells
