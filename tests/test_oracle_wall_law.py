"""Boundary `wall_stress`: the law for the stress of the wall, the force it gives, and the same in every form of the solver."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, DescriptionError
from fishmj.hydro_fit import __main__ as hydro_fit
from fishmj.lbm_oracle.cases import wall_stress
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed import wall_law
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.immersed.markers import EDGES, WALL_STRESS, Markers, fish_markers
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, asked_for, study_slips
from fishmj.mjcf import load_robot
from fishmj.mjcf.identity import robot_sha256

wp.config.quiet = True

WIDE = 4  # cells along the slab, periodic
POND = Domain(name="pond", shape=(56, 32, 20), dx=0.02, dt=0.004, sponge=4)


@wp.kernel
def stresses(
    speed: wp.array(dtype=float), height: float, nu: float, from_nose: float, found: wp.array(dtype=float)
):  # fmt: skip
    i = wp.tid()
    found[i] = wall_law.wall_stress(speed[i], height, nu, from_nose)


def law(speed, height: float, nu: float, from_nose: float = 0.0) -> np.ndarray:
    """The kernel's stress over density."""
    speed = wp.array(np.atleast_1d(speed), dtype=float, device="cpu")
    found = wp.zeros(len(speed), dtype=float, device="cpu")
    wp.launch(stresses, len(speed), [speed, height, nu, from_nose], [found], device="cpu")
    return found.numpy()


def slab(nu: float, height: int, *, sheet: bool, nose: float | None) -> FluidStructure:
    """A wall across a periodic box of `height` cells at rest, on a slide along itself."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=nu)
    water = Fluid(lattice, (WIDE, height, WIDE), "cpu", subgrid="none")
    body = ImmersedBody.on_slides("x", 1.0, [1.0] * 3, 0.0, [0.0] * 3, 1.0)
    x, z = (side.ravel() for side in np.meshgrid(np.arange(WIDE) + 0.3, np.arange(WIDE) + 0.2, indexing="ij"))
    normal = np.broadcast_to([0.0, 1.0, 0.0], (len(x), 3))
    point = np.stack([x, 0 * x + height // 2 + 0.25, z], -1)
    same = {"rest": point, "normal": normal, "area": np.ones(len(x)), "pivot": 0 * point, "share": 0 * x}
    link = np.zeros(len(x), np.int32)
    where = {"before": link, "after": link, "sheet": np.full(len(x), sheet), "from_nose": nose and np.full(len(x), nose)}
    return FluidStructure(water, body, Markers(**same, **where, law_height=WALL_STRESS.law_height))


def test_wall_stress_is_the_law_and_continuous_where_it_turns_viscous():
    height, nu = 3.0, 5e-4
    viscous, turbulent = np.array([1e-4, 1e-3, 1e-2]), np.array([0.03, 0.1, 0.3])
    assert law(viscous, height, nu) == pytest.approx(nu * viscous / height, rel=1e-5)
    friction_velocity = np.sqrt(law(turbulent, height, nu))
    assert turbulent / friction_velocity == pytest.approx(8.3 * (height * friction_velocity / nu) ** (1 / 7), rel=1e-5)
    turn = 11.81**2 * nu / height
    below, above = law([turn * 0.999, turn * 1.001], height, nu)
    assert above == pytest.approx(below, rel=3e-3) and (turn * nu / height) ** 0.5 * height / nu == pytest.approx(11.81)


def test_laminar_hull_has_the_friction_of_blasius_beyond_its_layer():
    nu, speed, x = 1e-4, 0.1, 40.0
    layer = 3.0 * np.sqrt(nu * x / speed)
    assert law(speed, 10 * layer, nu, x)[0] == pytest.approx(0.332 * speed**2 / np.sqrt(speed * x / nu), rel=1e-5)
    assert law(speed, 0.1 * layer, nu, x)[0] == pytest.approx(nu * speed / (0.1 * layer), rel=1e-5)


@pytest.mark.parametrize(
    ("sheet", "nu", "nose"), [(True, 5e-4, None), (False, 5e-4, None), (True, 0.05, None), (False, 5e-4, 30.0)]
)
def test_slab_in_uniform_water_feels_the_law_times_its_area(sheet, nu, nose):
    """The force on the wall, with the water's momentum gained from it, at a prescribed speed through water at rest."""
    speed = 0.05
    wall = slab(nu, 16, sheet=sheet, nose=nose)
    wall.body.place([0.0], [speed])
    wall.step([1.0], [speed])
    raw, _ = wall.take_wrench(1.0)
    area = WIDE**2 * (2 if sheet else 1)
    assert -raw[0, 0] == pytest.approx(area * law(speed, wall_law.STANDOFF, nu, nose or 0.0)[0], rel=1e-3)
    gained = 2 * wall.fluid.velocity()[..., 0].astype(float).sum((0, 2))  # the velocity holds half of the step's force
    assert gained.sum() == pytest.approx(-raw[0, 0], rel=1e-4)
    y = np.arange(16) - wall.body.data.xpos[1, 1] - 8.25
    heights, shares = np.array([0.5, 1.5, 2.5]), np.array([5, 3, 1]) / 9
    centre = (y * gained).sum() / gained.sum()
    assert centre == pytest.approx(0.0 if sheet else heights @ shares, abs=1e-3)
    assert np.abs(gained[(y > 4) | (y < (-4 if sheet else -1))]).max() < 1e-9


def test_water_at_a_wall_is_moved_as_its_layer_not_as_its_kernel():
    """With all of the force in the kernel at the wall, water there has 0.57 of the wall's speed by then."""
    wall, speed = slab(2e-4, 32, sheet=True, nose=None), 0.05
    wall.body.place([0.0], [speed])
    for _ in range(3500):
        wall.step([1.0], [speed])
    assert 0.3 < wall.fluid.velocity()[..., 0].max() / speed < 0.4


def test_laminar_channel_of_markers_has_the_viscous_profile():
    """tau = nu U / H takes the profile as straight up to H: with tau given, the water is faster by g H^2 / (2 nu) everywhere."""
    offset, bent = wall_stress.laminar(8, "cpu")
    assert offset == pytest.approx((wall_law.STANDOFF / 8) ** 2, abs=0.005) and bent < 0.005


def test_turbulent_channel_keeps_its_bulk_velocity_under_the_laws_stress():
    """Before anything mixes: the momentum of the water gives the velocity of the sheet, and the profile is flat."""
    ratio, profile = wall_stress.turbulent(640.0, 8, "cpu", turnovers=0.05)
    friction = wall_stress.BULK / wall_stress.bulk_of(640.0)
    assert profile.mean() * ratio == pytest.approx(wall_stress.BULK / friction, rel=1e-3)
    plus = 650.0 * (np.arange(16) - wall_stress.BESIDE[1] % 16) / 8
    exact = np.log(np.minimum(plus, 1300 - plus).clip(1)) / wall_stress.KAPPA + wall_stress.CONSTANT
    assert np.allclose(wall_stress.over_law(650.0, 8, 0.9 * exact), 0.9) and len(wall_stress.over_law(650.0, 8, exact)) == 14
    expected = law(wall_stress.BULK, wall_law.STANDOFF, friction * 8 / 640.0)[0]
    assert (ratio * friction) ** 2 == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("warps", [False, True])
def test_wall_stress_on_the_device_is_the_hosts(warps):
    command = 0.5 * np.sin(0.3 * np.arange(10)[:, None] - np.arange(3))
    one, other = (SwimSetup(domain=POND, sharpness=WALL_STRESS).coupled() for _ in range(2))
    steps = DeviceSteps(other, 5, warps=warps)
    for n, target in enumerate(command):
        one.body.data.ctrl[:] = target
        one.step()
        if n % 5 == 0:
            steps.queue(command[n : n + 5])
            steps.finish(audit=True)
    slips = one.boundary.slips.numpy()
    assert slips.std() > 1e-5 and slips.min() > 0.5 and slips.max() <= 1
    np.testing.assert_allclose(other.boundary.slips.numpy(), slips, atol=1e-4)
    np.testing.assert_allclose(other.body.data.qvel, one.body.data.qvel, atol=1e-7)
    for mine, theirs in zip(other.take_wrench(0.04), one.take_wrench(0.04), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-5)


def test_wall_stress_replaces_the_slip_ratio():
    assert asked_for("evaluate", None, None, None, boundary="wall_stress").sharpness == BOUNDARIES["wall_stress"]
    with pytest.raises(ConfigError, match="slip = 0.98 with a law"):
        SwimSetup(domain=POND, sharpness=WALL_STRESS, slip=0.98).coupled()
    height = fish_markers("fish", 0.02, sharpness=WALL_STRESS).law_height
    assert height == 0.015 and fish_markers("fish", 0.02, sharpness=EDGES).law_height is None


def test_wall_stress_in_finer_cells_on_the_device_is_the_hosts():
    box, made = Domain(name="pool", shape=(44, 40, 20), dx=0.02, dt=0.004, sponge=4, fine=(0.64, 0.56, 0.28)), []
    for on_device in (False, True):
        run = SwimSetup(domain=box, sharpness=WALL_STRESS).run(on_device=on_device, latency=0.0)
        for tick in range(2):
            run.tick(0.3 * np.sin(tick - np.arange(3)))
        made.append(run.coupled)
    one, other = made
    slips = one.boundary.slips.numpy()
    assert one.boundary.law.height == 3.0 and slips.std() > 1e-5
    np.testing.assert_allclose(other.boundary.slips.numpy(), slips, atol=1e-4)
    np.testing.assert_allclose(other.body.data.qvel, one.body.data.qvel, atol=1e-7)


@pytest.mark.parametrize(
    ("fine", "message"), [((0.64, 0.56, 0.28), "its kernel or law reaches 9"), (None, "law of its wall reaches 11")]
)
def test_law_of_the_wall_needs_water_as_far_as_it_looks(fine, message):
    far = replace(WALL_STRESS, law_height=0.08 if fine else 0.2)
    coupled = SwimSetup(domain=replace(POND, shape=(52, 40, 20), fine=fine), sharpness=far).coupled()
    with pytest.raises(ConfigError, match=message):
        coupled.place_markers()


def test_studies_leave_the_slip_ratio_to_the_law():
    assert study_slips("speeds", None, "fins", (0.5, 1.0)) == [0.5, 1.0] and study_slips("speeds", [0.9], "fins", ()) == [0.9]
    assert study_slips("speeds", None, "wall_stress", (0.5, 1.0)) == [1.0]
    with pytest.raises(ConfigError, match="speeds: --slips beside --boundary wall_stress"):
        study_slips("speeds", [0.9], "wall_stress", ())
    with pytest.raises(ConfigError, match="collect: slip ratios beside --boundary wall_stress"):
        hydro_fit.main(["collect", "--boundary", "wall_stress", "--dry-run", "--scale", "0.1"])
    assert hydro_fit.main(["collect", "--boundary", "wall_stress", "--all-at-slip", "1", "--dry-run", "--scale", "0.1"]) == 0


def test_laminar_hull_is_stated_and_refused_without_the_law(tmp_path):
    written = (calib_folder() / "fish.toml").read_text(encoding="utf-8")
    file = tmp_path / "fish.toml"
    file.write_text(written.replace("[body]", '[body]\nhull = "laminar"'), encoding="utf-8")
    fish, usual = load_robot(str(file)), load_robot("fish")
    assert (fish.hull, usual.hull) == ("laminar", "turbulent") and robot_sha256(fish) != robot_sha256(usual)
    assert robot_sha256(replace(fish, hull="turbulent")) == robot_sha256(usual)
    markers = fish_markers(fish, 0.02, sharpness=WALL_STRESS)
    assert markers.from_nose.min() == pytest.approx(0.01, abs=0.005) and markers.from_nose.max() == pytest.approx(0.51, abs=0.02)
    assert fish_markers(usual, 0.02, sharpness=WALL_STRESS).from_nose is None
    with pytest.raises(ConfigError, match="hull = 'laminar' in a boundary of the flow solver with one slip ratio"):
        fish_markers(fish, 0.02)
    file.write_text(written.replace("[body]", '[body]\nhull = "rough"'), encoding="utf-8")
    with pytest.raises(DescriptionError, match="hull: got 'rough', expected 'turbulent' or 'laminar'"):
        load_robot(str(file))


@pytest.mark.gpu
def test_wall_stress_on_a_gpu_is_that_of_the_cpu():
    made = []
    for device, on_device in (("cpu", False), ("cuda", False), ("cuda", True)):
        run = SwimSetup(domain=POND, sharpness=WALL_STRESS, device=device).run(on_device=on_device, latency=0.0)
        for tick in range(10):
            run.tick(0.3 * np.sin(0.5 * tick - np.arange(3)))
        made.append(run.coupled)
    one = made[0].boundary.slips.numpy()
    for other in made[1:]:
        np.testing.assert_allclose(other.boundary.slips.numpy(), one, atol=1e-4)
        np.testing.assert_allclose(other.body.data.qvel, made[0].body.data.qvel, atol=1e-5)
