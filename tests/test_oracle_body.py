"""The immersed fish and its coupling: markers, kernels, the solve, momentum, state."""

import mujoco
import numpy as np
import pytest
import warp as wp

from fishmj import mjcf
from fishmj.base.errors import ConfigError, OracleUnstable, SimDiverged, UnknownName
from fishmj.lbm_oracle.cases import coupled_fish
from fishmj.lbm_oracle.cases.coupled_fish import beat, pond
from fishmj.lbm_oracle.cases.sphere import added_mass, ball, virtual_mass
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.lbm_oracle.immersed.boundary import slip_on_grid
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import HELD, SLIDING, fish_markers, offset_of, sphere_markers
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import Gait
from fishmj.mjcf.skin import posed, skin

wp.config.quiet = True


@wp.kernel
def _weights(x: wp.array(dtype=float), width: int, out: wp.array2d(dtype=float)):
    k = wp.tid()
    start = kernels.first_cell(x[k], width)
    for i in range(width):
        out[k, 2 * i] = kernels.phi(x[k] - float(start + i), width)
        out[k, 2 * i + 1] = float(start + i)


@pytest.mark.parametrize("width", kernels.WIDTHS)
def test_kernels_sum_to_one_and_keep_the_first_moment(width):
    x = np.random.default_rng(1).uniform(-5, 5, 200).astype(np.float32)
    out = wp.zeros((200, 2 * width), dtype=float, device="cpu")
    wp.launch(_weights, dim=200, inputs=[wp.array(x, device="cpu"), width], outputs=[out], device="cpu")
    weight, node = out.numpy()[:, 0::2], out.numpy()[:, 1::2]
    np.testing.assert_allclose(weight.sum(1), 1.0, atol=2e-6)
    np.testing.assert_allclose((weight * node).sum(1), x, atol=1e-5)
    assert weight.min() > -1e-6


def test_an_unknown_kernel_names_the_known_ones():
    with pytest.raises(UnknownName, match="3, 4"):
        kernels.check_width(5)


# markers ------------------------------------------------------------------------------------------------------------


def in_straight_pose(markers, robot):
    """(N, 3) m in the body frame."""
    g = mjcf.geometry_of(robot)
    return markers.rest + np.stack([g.origin[markers.before], 0 * markers.share, 0 * markers.share], -1)


def test_markers_are_a_cell_apart_and_lie_inside_the_hull():
    robot = mjcf.load_robot("fish")
    for dx in (0.02, 0.01):
        markers = fish_markers(robot, dx)
        assert 0.5 * dx**2 < markers.area.min() and markers.area.max() < 2 * dx**2
        point, hull = in_straight_pose(markers, robot), skin(robot)
        assert (point.max(0) <= hull.vertices.max(0) + 1e-9).all() and (point.min(0) >= hull.vertices.min(0) - 1e-9).all()
        np.testing.assert_allclose(np.linalg.norm(markers.normal, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize(("robot", "dx"), [("fish", 0.02), ("fish", 0.01), ("tendon_fish", 0.02)])
def test_every_marker_has_a_partner_in_the_mirror(robot, dx):
    markers = fish_markers(robot, dx)
    place = in_straight_pose(markers, mjcf.load_robot(robot))
    for flip in ([1, -1, 1], [1, 1, -1]):
        apart = np.linalg.norm(place[:, None] * flip - place[None], axis=-1)
        partner, hull = apart.argmin(1), ~markers.sheet  # a sheet's normal points to one side
        assert apart.min(1).max() < 1e-9 and np.ptp([markers.area[partner], markers.area], 0).max() < 1e-15
        np.testing.assert_allclose((markers.normal * flip)[hull], markers.normal[partner][hull], atol=1e-9)


def test_the_tail_plate_and_the_side_fins_are_single_sheets():
    robot = mjcf.load_robot("fish")
    markers = fish_markers(robot, 0.005)
    point = in_straight_pose(markers, robot)
    plate = mjcf.geometry_of(robot).origin[3] - robot.links[3].fin_from
    tail, fins = point[:, 0] < plate - 0.005, np.abs(point[:, 1]) > 0.035
    assert markers.sheet[tail].all() and np.abs(point[tail, 1]).max() == 0
    assert markers.sheet[fins].all() and np.abs(point[fins, 2]).max() == 0
    assert not markers.sheet[(point[:, 0] > 0) & (np.abs(point[:, 1]) < 0.03)].any()


def test_a_sliding_wall_is_drawn_in_less_than_a_sticking_one():
    for width in kernels.WIDTHS:
        assert offset_of(width, 0.0) == offset_of(width, 0.95) == HELD[width]
        assert offset_of(width, 1.0) == pytest.approx(SLIDING[width])
        assert offset_of(width, 1.0, 0.2) == 0.2


def test_a_grid_too_coarse_for_a_sphere_says_which_would_do():
    with pytest.raises(ConfigError, match="dx <"):
        sphere_markers(1.0, 1.0)


@pytest.fixture(scope="module")
def bent():
    """A fish in an odd pose with every joint bent, one step done, so that its arrays are filled."""
    coupled = pond("cpu")
    qpos = np.array([0.55, 0.3, 0.7, 0.5, -0.6, 0.4])
    coupled.body.place(qpos, np.array([0.1, -0.05, 0.3, 0.5, -0.4, 0.8]))
    coupled.step()
    return coupled, qpos


def test_markers_follow_the_skin_of_the_replay(bent):
    coupled, qpos = bent
    markers, robot = coupled.boundary.markers, mjcf.load_robot("fish")
    world = coupled.boundary.world.numpy()
    hull = skin(robot, details=False)
    own = hull._replace(vertices=in_straight_pose(markers, robot))
    hinge = np.where(markers.share > 0, markers.before, np.maximum(markers.before - 1, 0))
    share = np.where(markers.share > 0, markers.share, (markers.before > 0).astype(float))
    expected = posed(own._replace(hinge=hinge, share=share), qpos)
    np.testing.assert_allclose(world, expected, atol=1e-9)


def test_marker_velocities_are_those_of_a_finite_step(bent):
    coupled, qpos = bent
    v = np.array([0.1, -0.05, 0.3, 0.5, -0.4, 0.8])
    edge, lattice = coupled.boundary, coupled.fluid.lattice

    def places(q):
        other = pond("cpu")
        other.body.place(q)
        other.step()
        return other.boundary.world.numpy()

    h = 1e-5
    slope = (places(qpos + h * v) - places(qpos - h * v)) / (2 * h)
    np.testing.assert_allclose(edge.jacobian.numpy().transpose(0, 2, 1) @ v * lattice.velocity, slope, atol=2e-6)


# the answer of the water --------------------------------------------------------------------------------------------


def test_without_slip_the_answer_matrix_is_symmetric_and_dissipates():
    coupled = pond("cpu", slip=0.0)
    coupled.body.place([0.55, 0.3, 0.7, 0.5, -0.6, 0.4])
    coupled.step()
    matrix, at_rest = coupled.boundary.response
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * np.abs(matrix).max())
    assert np.linalg.eigvalsh((matrix + matrix.T) / 2).min() > 0
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-12)


def test_water_that_moves_with_the_fish_feels_nothing_of_it():
    """Galilean shift: F(v) = 0 when fluid and body drift together, whatever the slip."""
    for slip in (0.0, 0.97, 1.0):
        coupled = pond("cpu", slip=slip)
        drift = np.array([0.05, 0.03, 0.0])
        coupled.fluid.impose(np.broadcast_to(drift, (*coupled.fluid.shape, 3)))
        coupled.body.place(coupled.body.data.qpos.copy(), [*drift[:2], 0, 0, 0, 0])
        velocity = coupled.step()
        np.testing.assert_allclose(velocity, [*drift[:2], 0, 0, 0, 0], atol=1e-6)


def test_full_slip_leaves_no_pull_along_a_plate_and_stops_water_through_it():
    coupled = pond("cpu", slip=1.0)
    sheet = coupled.boundary.markers.sheet & (np.abs(coupled.boundary.markers.normal[:, 1]) > 0.9)
    fixed = np.ones(6)
    for along, across in ((0.1, 0.0), (0.0, 0.1)):
        coupled.fluid.impose(np.broadcast_to([along, across, 0.0], (*coupled.fluid.shape, 3)))
        coupled.step(fixed, np.zeros(6))
        final = coupled.boundary.final.numpy()[sheet]
        if along:
            assert np.abs(final[:, 0]).max() < 0.1 * along / coupled.fluid.lattice.velocity
        else:
            assert (final[:, 1] < -0.5 * across / coupled.fluid.lattice.velocity).all()


def test_slip_means_the_same_friction_on_every_grid():
    coarse, fine = Lattice(dx=0.02, dt=0.004), Lattice(dx=0.01, dt=0.001)
    assert slip_on_grid(0.95, coarse) == pytest.approx(0.95)
    assert slip_on_grid(0.95, fine) ** 4 == pytest.approx(slip_on_grid(0.95, Lattice(dx=0.01, dt=0.004)))
    for slip in (0.0, 1.0):
        assert slip_on_grid(slip, fine) == slip
    with pytest.raises(ConfigError, match="slip = 1.2"):
        slip_on_grid(1.2, coarse)


def test_force_on_the_cells_is_the_force_on_the_markers(bent):
    cells, markers = coupled_fish.exchange(bent[0])
    np.testing.assert_allclose(cells, markers, atol=2e-6 * np.abs(markers).max())


# the solve ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("root", ["planar", "free"])
def test_mujoco_takes_exactly_the_velocity_that_was_found(root):
    coupled = pond("cpu", root=root)
    for n in range(20):
        coupled.body.data.ctrl[:] = 0.4 * np.sin(0.3 * n - np.arange(3))
        found = coupled.step()
        assert np.abs(coupled.body.data.qvel - found).max() < 1e-9


def test_the_device_solves_the_equation_that_the_docstring_states(bent):
    coupled, _ = bent
    matrix, at_rest = coupled.boundary.response
    sent = coupled.boundary.view
    right, system = sent["momentum"] - at_rest, sent["system"] + matrix
    np.testing.assert_allclose(coupled.boundary.velocity, np.linalg.solve(system, right), rtol=1e-9, atol=1e-12)


def test_planar_and_free_root_swim_alike():
    flat, free = pond("cpu"), pond("cpu", root="free")
    for coupled in (flat, free):
        beat(coupled, 0.6, every=1000)
    np.testing.assert_allclose(free.body.data.qpos[:2], flat.body.data.qpos[:2], atol=2e-3)
    np.testing.assert_allclose(free.body.data.qpos[-3:], flat.body.data.qpos[-3:], atol=5e-3)


def test_held_joints_follow_their_course_to_the_letter():
    coupled, gait = pond("cpu"), Gait()
    run = Run(coupled, prescribed=gait, tethered=True)
    for _ in range(10):
        run.tick()
    np.testing.assert_allclose(run.angles(), gait(run.time), atol=1e-12)
    np.testing.assert_allclose(run.pose[3:], 0.0, atol=1e-15)


def test_inside_water_is_the_inertia_of_a_twin_with_its_coriolis_part():
    """I over dt -> M_f a + c_f of a model whose links hold water, as dt -> 0 along a smooth motion."""
    robot = mjcf.load_robot("fish")
    spec, water = mjcf.build_spec(robot, "planar", bare=True), DisplacedWater.of(robot)
    for i, link in enumerate(robot.links):
        body = spec.body(link.name)
        body.mass, body.ipos, body.inertia = water.mass[i], water.centre[i], np.diag(water.inertia[i])
    twin = spec.compile()
    data, dt = mujoco.MjData(twin), 1e-5
    q, v, a = (np.array(x) for x in ([0.1, 0.2, 0.5, 0.4, -0.3, 0.6], [0.2, 0.1, 1.0, -2.0, 1.5, 3.0], [1.0, 2, 3, -4, 5, 6]))
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(twin, data)
    full = np.zeros((6, 6))
    mujoco.mj_fullM(twin, data, full)
    body = ImmersedBody.of(robot, "planar", dt)
    body.place(q - dt * v + 0.5 * dt**2 * a, v - dt * a)
    body.data.qpos[:], body.data.qvel[:] = q, v
    body.forward()
    body.equation()
    np.testing.assert_allclose(body.impulse / dt, full @ a + data.qfrc_bias, rtol=2e-3, atol=2e-3)


def test_buoyancy_carries_a_neutral_fish_and_its_ballast_keeps_it_upright():
    coupled = pond("cpu", root="free")
    _, right = coupled.body.equation()
    np.testing.assert_allclose(right[:3], 0.0, atol=1e-12)
    tilt = np.array([0.6, 0.32, 0.0, np.cos(0.1), np.sin(0.1), 0.0, 0.0, 0, 0, 0])  # rolled by 0.2 rad
    coupled.body.place(tilt)
    _, right = coupled.body.equation()
    assert right[3] < 0


# stability and momentum ---------------------------------------------------------------------------------------------


def test_explicit_coupling_of_a_neutral_fish_diverges_and_names_the_place():
    with pytest.raises(OracleUnstable, match="coupled: a marker at t = 0.0[0-9]+ s: Mach") as stopped:
        beat(pond("cpu", scheme="explicit"), 0.5, every=1000)
    assert stopped.value.limit == "mach"
    unguarded = pond("cpu", scheme="explicit")
    with pytest.raises(SimDiverged, match="velocity of joint") as caught:
        for _ in range(50):  # the parts of a step, as `Run` takes them
            unguarded.place_markers()
            unguarded.assemble_response()
            unguarded.body.data.ctrl[:] = 0.1
            unguarded.solve()
            unguarded.push_water()
            unguarded.advance()
    assert caught.value.term == "coupling" and caught.value.time < 0.2


def test_implicit_coupling_conserves_momentum_and_needs_the_inside_water():
    good = coupled_fish.drift(beat(pond("cpu"), 1.0))
    bad = coupled_fish.drift(beat(pond("cpu", interior=False), 1.0))
    assert good < 0.01
    assert bad > 10 * good


def test_momentum_audit_of_a_pushed_sphere_has_no_lag():
    """What was pushed in is what is there, to round-off; the present interior water would be off by a step's gain."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.01)
    body = ball(3.0, lattice, density=2.0, at=(8.3, 8.1, 7.8))
    sphere = FluidStructure(Fluid(lattice, (16, 16, 16), subgrid="none"), body, sphere_markers(3.0, 1.0), slip=0.0)
    push, lag = 0.002 * body.water.mass[0], []
    body.applied[0] = push
    for n in range(1, 21):
        sphere.step()
        balance = coupled_fish.momentum(sphere)
        assert balance.total[0] == pytest.approx(n * push, rel=1e-4)
        lag.append(balance.total[0] - n * push - body.water_momentum()[0, 0] + balance.displaced[0])
    assert np.abs(lag).min() > 0.2 * push


@pytest.mark.parametrize("density", [10.0, 1.0, 0.1])
def test_a_free_sphere_of_any_density_is_stable(density):
    assert virtual_mass(density, "cpu", steps=80) == pytest.approx(0.885, abs=0.06)


def test_the_inside_water_is_worth_its_own_mass():
    with_it, without = (virtual_mass(1.0, "cpu", interior=choice, steps=80) for choice in (True, False))
    assert without - with_it == pytest.approx(1.0, abs=0.01)


def test_added_mass_of_a_sphere_is_half_of_its_water():
    assert added_mass(5.0, 40, "cpu") == pytest.approx(0.5, abs=0.075)


def test_a_mirrored_gait_swims_the_mirror_image():
    ends = []
    for sign in (1.0, -1.0):
        coupled = pond("cpu")
        coupled.body.place([0.6, 0.31, 0, 0, 0, 0])  # the plane of mirror symmetry of the nodes
        beat(coupled, 0.5, amplitude=sign * np.radians(30.0), every=1000)
        ends.append(coupled.body.data.qpos.copy())
    np.testing.assert_allclose(ends[1][0], ends[0][0], atol=2e-4)
    np.testing.assert_allclose(ends[1][2:], -ends[0][2:], atol=2e-2)


@pytest.mark.parametrize(("at", "fits"), [(5.0, True), (4.5, False), (18.0, True), (18.6, False)])
def test_a_body_whose_kernel_reaches_beyond_a_wall_is_refused(at, fits):
    """Markers lie on the sphere drawn in by 0.7 cells; reading across the face would fetch water of the other side."""
    lattice, wall = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.01), Axis("wall", "wall")
    water = Fluid(lattice, (24, 24, 24), boundaries=Boundaries(x=wall), subgrid="none")
    near = FluidStructure(water, ball(4.0, lattice, at=(at, 12.0, 12.0)), sphere_markers(4.0, 1.0))
    if fits:
        near.step()
    else:
        with pytest.raises(ConfigError, match="cells from the outermost nodes of axis x"):
            near.step()
