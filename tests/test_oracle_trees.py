"""Immersed bodies of any shape: trees, several bodies in one model, free and ball joints; and what is refused by name."""

from dataclasses import replace
from math import pi

import mujoco
import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.lbm_oracle.cases.coupled_fish import momentum
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody, farthest_apart
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.immersed.markers import Markers, sphere_markers
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid

pytestmark = pytest.mark.oracle
wp.config.quiet = True
RADIUS, APART = 3.0, 9.0  # cells
MASS = 4 / 3 * pi * RADIUS**3
WATER = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.02)
BALL, FREE, HINGE, SLIDE = (getattr(mujoco.mjtJoint, f"mjJNT_{name}") for name in ("BALL", "FREE", "HINGE", "SLIDE"))


def spheres(parents, places, joints, *, gravity=0.0, contacts=False) -> mujoco.MjModel:
    """Spheres of water's density: for each its parent (-1: the world), its place in the world and its joints (kind, axis)."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, gravity]
    bodies: list = []
    for i, (parent, place, kinds) in enumerate(zip(parents, places, joints, strict=True)):
        above, origin = (spec.worldbody, np.zeros(3)) if parent < 0 else (bodies[parent], np.asarray(places[parent], float))
        body = above.add_body(name=f"s{i}", pos=np.asarray(place, float) - origin)
        body.mass, body.inertia, body.ipos, body.explicitinertial = MASS, [0.4 * MASS * RADIUS**2] * 3, [0, 0, 0], True
        for n, (kind, axis) in enumerate(kinds):
            body.add_joint(name=f"s{i}j{n}", type=kind, axis=axis)
        if contacts:
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0])
        bodies.append(body)
    return spec.compile()


def immersed(model: mujoco.MjModel, shape, *, slip=0.0, boundaries=None, **options) -> FluidStructure:
    """Those spheres in still water, each with its markers."""
    count = model.nbody - 1
    inertia = np.tile(np.eye(3) * 0.4 * MASS * RADIUS**2, (count, 1, 1))
    body = ImmersedBody(model, DisplacedWater(mass=np.full(count, MASS), centre=np.zeros((count, 3)), inertia=inertia), WATER.dt)
    fluid = Fluid(WATER, shape, "cpu", subgrid="none", boundaries=boundaries or Boundaries(), **options)
    return FluidStructure(fluid, body, joined([sphere_markers(RADIUS, 1.0)] * count), slip=slip)


def joined(parts: list[Markers]) -> Markers:
    """Markers of several links; part i is of link i."""
    column = lambda name: np.concatenate([getattr(part, name) for part in parts])
    link = np.concatenate([np.full(len(part), i) for i, part in enumerate(parts)])
    same = {name: column(name) for name in ("rest", "normal", "area", "pivot", "share", "sheet", "slip_length")}
    return Markers(before=link, after=link, **same)


PLACES = np.array([[11.3, 12.1, 11.8], [11.3 + APART, 12.1, 11.8], [11.3 + 2 * APART, 12.1, 11.8]])
HINGED, FLOATING = [(HINGE, [0, 0, 1])], [(SLIDE, [1, 0, 0]), (SLIDE, [0, 1, 0]), (HINGE, [0, 0, 1])]


def row_of_three(order) -> tuple[FluidStructure, np.ndarray]:
    """The row in a stream of 0.05 cells a step across it, held, its root at place order[0]; forces (3, 6) by place."""
    parents = {(0, 1, 2): (-1, 0, 1), (1, 0, 2): (-1, 0, 0)}[order]
    model = spheres(parents, PLACES[list(order)], [FLOATING, HINGED, HINGED])
    row = immersed(model, (40, 24, 24))
    row.fluid.impose(np.broadcast_to([0.0, 0.05, 0.0], (40, 24, 24, 3)))
    for _ in range(10):
        row.step(np.ones(5), np.zeros(5))
    force = np.zeros((3, 6))
    force[list(order)] = row.take_wrench(10.0)[0]
    return row, force


def test_root_in_the_middle_of_a_tree_feels_the_forces_of_a_chain():
    (_, expected), (tree, found) = row_of_three((0, 1, 2)), row_of_three((1, 0, 2))
    assert np.abs(expected[:, 1]).min() > 1.0
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-4)
    assert min(tree.boundary.box_shape[:2]) >= 2 * APART + 2 * RADIUS > APART + 4 * RADIUS
    swung = np.array([0.0, 0.0, 0.0, 0.7, -0.9])
    tree.body.place(swung, np.array([0.01, -0.01, 0.001, 0.002, 0.001]))
    for _ in range(5):
        assert np.isfinite(tree.step()).all()


def test_two_free_bodies_part_without_a_crash_and_keep_momentum():
    """Pushed apart, they leave the periodic box on both sides and come back into it: further apart than it is long."""
    model = spheres((-1, -1), [[9.2, 6.1, 11.7], [15.4, 18.3, 12.2]], [[(FREE, [0, 0, 1])]] * 2)
    pair = immersed(model, (18, 24, 24))
    pair.body.applied[[0, 6]] = -0.25, 0.25
    history = [momentum(pair)]
    for n in range(140):
        pair.step()
        if n % 10 == 9:
            history.append(momentum(pair))
    assert pair.body.data.qpos[7] - pair.body.data.qpos[0] > 18
    total = np.array([m.total for m in history])
    assert np.abs(total - total[0]).max() < 1e-5 * MASS * np.abs(pair.body.data.qvel).max()


def test_two_bodies_across_the_seam_of_a_periodic_box_feel_the_same():
    """Their markers share cells: what one of them spreads the other must see, on whichever side of the seam it is."""

    def push(one: float, other: float) -> np.ndarray:
        places = np.array([[10.2 + one, 12.1, 11.7], [16.8 + other, 12.3, 12.2]])
        slides = [[(SLIDE, [1, 0, 0]), (SLIDE, [0, 1, 0]), (SLIDE, [0, 0, 1])]] * 2
        pair = immersed(spheres((-1, -1), places, slides), (32, 24, 24))
        for _ in range(3):
            pair.step(np.ones(6), np.array([0.02, 0, 0, -0.02, 0, 0]))
        return pair.take_wrench(3.0)[0]

    inside = push(0.0, 0.0)
    for one, other in ((18.0, 18.0), (-13.0, -13.0), (0.0, 64.0), (18.0, -14.0)):
        np.testing.assert_allclose(push(one, other), inside, rtol=1e-4, atol=1e-4 * np.abs(inside).max())


@pytest.mark.parametrize("kind", ["periodic", "wall"])
def test_box_of_all_the_water_gives_the_forces_of_a_box_round_the_body(kind):
    """Two spheres that cannot part, on hinges, and two that can, on slides, held in the same stream."""

    def hold(joints) -> np.ndarray:
        faces = Boundaries(x=Axis(kind, kind), z=Axis(kind, kind))
        pair = immersed(spheres((-1, -1), PLACES[:2], [joints] * 2), (32, 24, 24), boundaries=faces)
        pair.fluid.impose(np.broadcast_to([0.0, 0.05, 0.0], (32, 24, 24, 3)))
        for _ in range(4):
            pair.step(np.ones(pair.body.dofs), np.zeros(pair.body.dofs))
        assert bool(pair.boundary.spanned_axes) == (joints is not HINGED)
        return pair.take_wrench(4.0)[0]

    np.testing.assert_allclose(hold([(SLIDE, [1, 0, 0]), (SLIDE, [0, 0, 1])]), hold(HINGED), rtol=1e-4, atol=1e-3)


def test_a_body_alone_swims_as_in_a_model_with_another_far_away():
    lone, two = ([[9.3, 12.1, 11.7], [33.3, 12.1, 11.7]][:n] for n in (1, 2))

    def fall(places) -> np.ndarray:
        fish = immersed(spheres((-1,) * len(places), places, [[(FREE, [0, 0, 1])]] * len(places)), (48, 24, 24))
        fish.body.applied[:3] = 0.02, 0.01, 0.0
        for _ in range(12):
            fish.step()
        return fish.body.data.qvel[:6].copy()

    np.testing.assert_allclose(fall(two), fall(lone), rtol=5e-3, atol=1e-7)


def test_ball_joint_turns_the_link_about_its_own_axes():
    """Jacobian and interior momentum beside MuJoCo's own, in a pose in which every axis counts."""
    model = spheres((-1, 0, -1), PLACES, [[(FREE, [0, 0, 1])], [(BALL, [0, 0, 1])], [(FREE, [0, 0, 1])]])
    body = immersed(model, (40, 24, 24)).body
    rng = np.random.default_rng(4)
    qpos, qvel = body.data.qpos + 0.3 * rng.normal(size=model.nq), rng.normal(size=model.nv)
    body.place(qpos, qvel)
    for link in range(3):
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBody(model, body.data, linear, angular, link + 1)
        np.testing.assert_allclose(body.twist[link], [*linear @ qvel, *angular @ qvel], atol=1e-12)
    np.testing.assert_allclose(body.water_momentum(), body.solid_momentum(), atol=1e-9)


def test_pendulum_on_a_ball_joint_swings_as_on_a_hinge():
    """A sphere on a ball joint in a plane moves as on a hinge across that plane: wrench about the right axis."""
    places = np.array([[12.2, 12.1, 16.3], [12.2, 12.1, 16.3 - APART]])
    found = []
    for joint in ([(BALL, [0, 0, 1])], [(HINGE, [0, 1, 0])]):
        model = spheres((-1,), places[1:], [joint])
        model.jnt_pos[0] = [0, 0, APART]  # it hangs on a point above it
        swing = immersed(model, (24, 24, 28))
        n = swing.body.dofs
        swing.body.place(swing.body.data.qpos.copy(), np.array([0.0, 0.003, 0.0])[-n:] if n == 3 else [0.003])
        for _ in range(20):
            velocity = swing.step()
        found.append([velocity[1] if n == 3 else velocity[0], *swing.body.twist[0]])
        if n == 3:
            np.testing.assert_allclose(velocity[[0, 2]], 0.0, atol=1e-5)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-3, atol=1e-5)
    assert abs(found[0][0]) < 0.003  # the water slows it


@pytest.mark.parametrize(
    ("parents", "joints", "size"),
    [
        ((-1, 0, 0), [FLOATING, HINGED, HINGED], (2 * APART, 2 * APART, 0)),
        ((-1, 0, 1), [FLOATING, HINGED, HINGED], (2 * APART, 2 * APART, 0)),
        ((-1, 0, 0), [FLOATING, [(HINGE, [1, 0, 0])], HINGED], (2 * APART,) * 3),
        ((-1, 0, 0), [FLOATING, [(BALL, [0, 0, 1])], HINGED], (2 * APART,) * 3),
        ((-1, 0, 0), [FLOATING, [(SLIDE, [0, 0, 1])], HINGED], (np.inf,) * 3),
        ((-1, 0, 0), [FLOATING, [(SLIDE, [1, 0, 0])], HINGED], (np.inf, np.inf, 0)),
        ((-1, 0, -1), [FLOATING, HINGED, FLOATING], (np.inf, np.inf, 0)),
        ((-1, -1, -1), [HINGED, HINGED, HINGED], (2 * APART, 2 * APART, 0)),
    ],
)
def test_box_round_a_tree_is_as_large_as_its_links_reach(parents, joints, size):
    order = [1, 0, 2] if parents[1] == parents[2] == 0 else [0, 1, 2]
    body = immersed(spheres(parents, PLACES[order], joints), (40, 24, 24)).body
    corners = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (40, 24, 24)).boundary.corners
    corners.at = np.tile(corners.at, (3, 1, 1))
    far, high = np.linalg.norm(corners.at[0], axis=1).max(), np.abs(corners.at[..., 2]).max()
    expected = [s + 2 * (far if s else high) for s in size]
    np.testing.assert_allclose(body.largest_extent(corners), expected)


def test_no_pose_of_a_random_tree_leaves_its_box():
    rng = np.random.default_rng(2)
    for _ in range(10):
        spec, bodies = mujoco.MjSpec(), []
        for i in range(5):
            above = bodies[rng.integers(i)] if i else spec.worldbody
            body = above.add_body(pos=rng.normal(size=3))
            body.mass, body.inertia, body.explicitinertial = 1.0, [1, 1, 1], True
            kind = FREE if i == 0 else [BALL, HINGE][rng.integers(2)]
            body.add_joint(type=kind, pos=[0, 0, 0] if i == 0 else rng.normal(size=3), axis=rng.normal(size=3))
            bodies.append(body)
        model = spec.compile()
        data, bound = mujoco.MjData(model), farthest_apart(model)
        for _ in range(50):
            data.qpos[:] = rng.normal(size=model.nq)
            mujoco.mj_kinematics(model, data)
            apart = np.linalg.norm(data.xpos[1:, None] - data.xpos[None, 1:], axis=-1)
            assert (apart <= bound + 1e-9).all()


def test_links_that_can_part_are_stepped_by_the_host():
    pair = immersed(spheres((-1, -1), PLACES[:2], [[(FREE, [0, 0, 1])]] * 2), (40, 24, 24))
    with pytest.raises(ConfigError, match="can part without bounds"):
        DeviceSteps(pair, 5)


# refusals -----------------------------------------------------------------------------------------------------------


def test_contact_between_two_bodies_is_refused_by_name_when_it_happens():
    model = spheres((-1, -1), [[9.2, 12.1, 11.7], [16.4, 12.1, 11.7]], [[(FREE, [0, 0, 1])]] * 2, contacts=True)
    pair = immersed(model, (32, 24, 24))
    qpos = pair.body.data.qpos.copy()
    qpos[7] -= 1.5
    with pytest.raises(ConfigError, match="contact between bodies 's0' and 's1'.*mjDSBL_CONSTRAINT"):
        pair.body.place(qpos)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"before": 7, "after": 7}, r"'before'\[0\] = 7; expected a finite number from 0 to 2"),
        ({"before": -1}, r"markers: before\[0\] = -1"),
        ({"before": 0.5}, "before has the type float64; expected whole numbers"),
        ({"share": 1.2}, r"share\[0\] = 1.2; expected a finite number from 0 to 1"),
        ({"share": 0.5, "after": 0, "before": 2}, "marker 0 bends by 0.5 from link 2 to link 0"),
        ({"area": np.nan}, r"area\[0\] = nan"),
        ({"area": -1.0}, r"area\[0\] = -1"),
        ({"normal": 0.2}, r"normal\[0\] has the length"),
        ({"rest": np.inf}, r"rest\[0, 0\] = inf"),
        ({"sheet": 1}, "sheet is int64"),
    ],
)
def test_markers_that_cannot_be_are_refused_with_their_number(change, said):
    good = joined([sphere_markers(RADIUS, 1.0)] * 3)
    model = spheres((-1, 0, 1), PLACES, [FLOATING, HINGED, HINGED])
    with pytest.raises(ConfigError, match=said):
        values = {}
        for name, value in change.items():
            values[name] = np.array(getattr(good, name), type(value) if name in ("before", "sheet") else None)
            values[name][0] = value
        FluidStructure(Fluid(WATER, (40, 24, 24), subgrid="none"), immersed(model, (40, 24, 24)).body, replace(good, **values))
    with pytest.raises(ConfigError, match=r"rest has the shape \(2, 3\)"):
        replace(good, rest=np.zeros((2, 3)))


def test_markers_of_another_grid_are_refused_with_its_cell():
    body, water = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (24, 24, 24)).body, Fluid(WATER, (24, 24, 24), subgrid="none")
    for dx, said in ((2.0, "1.79 dx"), (0.4, "0.44 dx")):
        with pytest.raises(OracleUnstable, match=f"{said}; expected 0.5 to 1.4 dx. Space them by 1 m"):
            FluidStructure(water, body, sphere_markers(4.0, dx))
    for dx in (0.6, 1.4):
        FluidStructure(water, body, sphere_markers(5.0, dx))


def test_model_that_the_coupled_step_leaves_out_is_refused_by_name():
    def with_option(**options):
        model = spheres((-1,), PLACES[:1], [FLOATING])
        for name, value in options.items():
            setattr(model.opt, name, value)
        return model

    with pytest.raises(ConfigError, match="integrator other than Euler"):
        immersed(with_option(integrator=int(mujoco.mjtIntegrator.mjINT_RK4)), (24, 24, 24))
    with pytest.raises(ConfigError, match="no degree of freedom"):
        immersed(spheres((-1,), PLACES[:1], [[]]), (24, 24, 24))
    with pytest.raises(ConfigError, match="2 moving bodies in the model, displaced water for 1"):
        water = DisplacedWater(mass=np.ones(1), centre=np.zeros((1, 3)), inertia=np.eye(3)[None])
        ImmersedBody(spheres((-1, 0), PLACES[:2], [FLOATING, HINGED]), water, 1.0)


def test_numbers_of_a_body_are_checked_where_it_is_built_and_placed():
    body = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (24, 24, 24)).body
    for qpos, said in ((0.0, r"shape \(\)"), ([0.0] * 4, r"shape \(4,\)"), ([0, np.nan, 0], r"qpos\[1\] = nan")):
        with pytest.raises(ConfigError, match=said):
            body.place(qpos)
    with pytest.raises(ConfigError, match=r"qvel\[2\] = inf"):
        body.place(np.zeros(3), [0, 0, np.inf])
    with pytest.raises(ConfigError, match="body: dt = 0"):
        body.set_step(0.0)
    for water, said in (
        ({"mass": -1.0}, r"mass\[0\] = -1"),
        ({"centre": np.zeros(3)}, r"centre has the shape \(3,\)"),
        ({"inertia": -np.eye(3)}, "without negative moments"),
    ):
        given = {"mass": np.ones(1), "centre": np.zeros((1, 3)), "inertia": np.eye(3)[None]}
        given |= {name: value if np.ndim(value) == 1 else np.array([value]) for name, value in water.items()}
        with pytest.raises(ConfigError, match=said):
            DisplacedWater(**given)
    for axes, mass in (("xw", 1.0), ("xx", 1.0), ("", 1.0), ("x", 0.0), ("x", np.nan)):
        with pytest.raises(ConfigError, match="body: (axes|mass)"):
            ImmersedBody.on_slides(axes, mass, [1, 1, 1], 1.0, [1, 1, 1], 1.0)


def test_marker_outside_the_water_is_refused_before_the_step():
    wall = Axis("wall", "wall")
    row = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (24, 24, 24), boundaries=Boundaries(x=wall, y=wall, z=wall))
    row.body.place([15.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match="cells from the outermost nodes of axis x"):
        row.step()
    row.body.data.qpos[0] = np.nan
    with pytest.raises(ConfigError, match=r"qpos = \[nan, 0.0, 0.0\]"):
        row.body.forward()


def test_water_of_mujoco_and_mocap_bodies_are_refused_by_name():
    """A model with its own fluid would be dragged twice; a mocap body would move without a velocity."""
    for name, value in (("density", 1000.0), ("viscosity", 1e-3)):
        model = spheres((-1,), PLACES[:1], [FLOATING])
        setattr(model.opt, name, value)
        with pytest.raises(ConfigError, match="water of MuJoCo's own.*option density, viscosity"):
            immersed(model, (24, 24, 24))
    spec = mujoco.MjSpec()
    for mocap in (False, True):
        body = spec.worldbody.add_body(name=f"b{mocap}", mocap=mocap, pos=PLACES[int(mocap)])
        body.mass, body.inertia, body.explicitinertial = MASS, [0.4 * MASS * RADIUS**2] * 3, True
        if not mocap:
            body.add_joint(type=SLIDE, axis=[1, 0, 0])
    with pytest.raises(ConfigError, match="a mocap body"):
        immersed(spec.compile(), (32, 24, 24))


@pytest.mark.parametrize("mass", [-1.0, np.nan, np.inf])
def test_model_of_impossible_mass_is_refused(mass):
    model = spheres((-1,), PLACES[:1], [FLOATING])
    model.body_mass[1] = mass
    with pytest.raises(ConfigError, match="mass"):
        immersed(model, (24, 24, 24))


def test_push_through_mujocos_own_fields_is_refused_not_lost():
    ball = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (24, 24, 24))
    for name, at in (("qfrc_applied", 0), ("xfrc_applied", (1, 0))):
        getattr(ball.body.data, name)[at] = 0.5
        with pytest.raises(ConfigError, match="a push from outside goes into `body.applied`"):
            ball.step()
        getattr(ball.body.data, name)[at] = 0.0
    ball.body.applied[0] = 0.5
    assert ball.step()[0] > 1e-4 and ball.step()[0] > 2e-4


def test_body_that_stands_feels_what_a_held_one_feels():
    """A body without joints is an obstacle: it counts as a link."""

    def force(joints) -> np.ndarray:
        slides = [(SLIDE, [1, 0, 0]), (SLIDE, [0, 1, 0]), (SLIDE, [0, 0, 1])]
        pair = immersed(spheres((-1, -1), PLACES[:2], [slides, slides if joints else []]), (32, 24, 24))
        pair.fluid.impose(np.broadcast_to([0.0, 0.05, 0.0], (32, 24, 24, 3)))
        for _ in range(3):
            pair.step(np.ones(pair.body.dofs), np.zeros(pair.body.dofs))
        return pair.take_wrench(3.0)[0]

    np.testing.assert_allclose(force(False), force(True), rtol=1e-5, atol=1e-5)


def test_wrench_of_any_joints_is_the_impulse_that_the_solve_found():
    """sum_l J_l^T W_l = -(K v + b0), with MuJoCo's own Jacobians, for links with several joints off their origins."""
    rng = np.random.default_rng(3)
    spec, bodies = mujoco.MjSpec(), []
    spec.option.gravity = [0, 0, 0]
    for i, kinds in enumerate(((FREE,), (SLIDE, BALL), (HINGE, HINGE), (), (FREE,))):
        above = bodies[i - 1] if i and kinds != (FREE,) else spec.worldbody
        body = above.add_body(pos=PLACES[2 * (i == 4)] if kinds == (FREE,) else 4 * rng.normal(size=3), quat=rng.normal(size=4))
        body.mass, body.inertia, body.explicitinertial = MASS, [0.4 * MASS * RADIUS**2] * 3, True
        for kind in kinds:
            body.add_joint(type=kind, axis=rng.normal(size=3), pos=[0, 0, 0] if kind == FREE else rng.normal(size=3))
        bodies.append(body)
    model = spec.compile()
    tree = immersed(model, (40, 24, 24))
    tree.body.place(tree.body.data.qpos + 0.3 * rng.normal(size=model.nq), 0.003 * rng.normal(size=model.nv))
    jacobian = np.zeros((5, 6, model.nv))
    for link in range(5):
        mujoco.mj_jacBody(model, tree.body.data, jacobian[link, :3], jacobian[link, 3:], link + 1)
    velocity = tree.step()
    response, rest = tree.boundary.response
    found = np.einsum("lij,li->j", jacobian, tree.take_wrench(WATER.dt)[0])
    np.testing.assert_allclose(found, -(response @ velocity + rest), atol=1e-6 * np.abs(found).max())


def test_objects_of_other_classes_are_refused_by_name():
    good = immersed(spheres((-1,), PLACES[:1], [FLOATING]), (24, 24, 24))
    water, body, markers = good.fluid, good.body, good.boundary.markers
    for make, said in (
        (lambda: FluidStructure(body, water, markers), r"coupled: fluid = .*expected fishmj.*Fluid"),
        (lambda: FluidStructure(water, None, markers), "coupled: body = None"),
        (lambda: FluidStructure(water, body, None), "coupled: markers = None"),
        (lambda: FluidStructure(water, body, markers, slip="a"), "slip = 'a'; expected numbers"),
        (lambda: ImmersedBody("<mujoco/>", body.water, 1.0), "body: model = '<mujoco/>'; expected mujoco.*MjModel"),
        (lambda: ImmersedBody(body.model, None, 1.0), "body: water = None"),
        (lambda: replace(body.water, points=3), "displaced water: points = 3"),
        (lambda: ImmersedBody.on_slides("x", 1.0, (1, 1, 9), 1.0, (1, 1, 1), 1.0), "no moment above the sum of the other two"),
        (lambda: ImmersedBody.on_slides(3, 1.0, (1, 1, 1), 1.0, (1, 1, 1), 1.0), "body: axes = 3"),
        (lambda: body.place(body.data.qpos, interior_speed="a"), "body: interior_speed = 'a'"),
        (lambda: good.take_wrench(0.0), "seconds of a wrench = 0"),
        (lambda: RefinedFluid(None, (4, 4, 4), (8, 8, 8)), "refined: outer = None"),
    ):
        with pytest.raises(ConfigError, match=said):
            make()
    fine = RefinedFluid(Fluid(replace(WATER, dx=2.0, dt=2.0), (16, 16, 16), subgrid="none"), (4, 4, 4), (8, 8, 8))
    with pytest.raises(ConfigError, match="take RefinedStructure"):
        FluidStructure(fine, body, markers)
