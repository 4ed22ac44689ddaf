"""The MuJoCo model is the described fish, and the closed-form chain is that model to round-off."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fishmj import mjcf
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.mjcf.model import ROOTS, personalise, reference_pose, reference_qpos
from fishmj.water.dynamics import planar_chain
from fishmj.water.injection import inject
from fishmj.water.planar_water import PlanarWater, world_matrix

ROBOTS = ("fish", "tendon_fish")


def long_fish(links: int) -> mjcf.Robot:
    """The default fish with its middle link repeated."""
    robot = mjcf.load_robot("fish")
    middle = [replace(robot.links[1], name=f"body{i}") for i in range(links - 2)]
    water = dict(robot.water, k=[0.9] * links, cn=[1.2] * links)
    return replace(robot, name=f"{links}_links", links=(robot.links[0], *middle, robot.links[-1]), water=water)


def robots():
    return [mjcf.load_robot(name) for name in ROBOTS] + [long_fish(2), long_fish(6)]


def random_state(rng, n):
    """Generalised position and velocity of a fish somewhere in the tank, joints within +-60 deg."""
    q = np.concatenate([rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi, 1), rng.uniform(-1, 1, n - 1)])
    return q, rng.normal(size=n + 2)


@pytest.mark.parametrize("robot", robots(), ids=lambda r: r.name)
def test_chain_mass_matrix_and_bias_equal_mujoco(robot):
    model = mjcf.build(robot)
    data = mujoco.MjData(model)
    ch, sw = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    rng, dense = np.random.default_rng(1), np.zeros((model.nv, model.nv))
    for _ in range(50):
        q, v = random_state(rng, ch.n)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        k = planar_chain.kinematics(np, ch, q, v, [(0.0, 0.0)] * ch.n)
        np.testing.assert_allclose(
            world_matrix(ch, q[2], planar_chain.mass_matrix(ch, sw, k, water=False)), dense, rtol=0, atol=1e-12
        )
        bias = planar_chain.gather(ch, k, planar_chain.bias_forces(ch, sw, k, water=False))
        np.testing.assert_allclose(planar_chain.generalised(np, ch, q[2], bias), -data.qfrc_bias, rtol=0, atol=1e-12)


@pytest.mark.parametrize("robot", robots(), ids=lambda r: r.name)
def test_in_water_the_mass_matrix_is_the_chains(robot):
    """Inside an inject block MuJoCo's own M is M + M_a, and stays so however often it is recomputed."""
    model, water = mjcf.build(robot), PlanarWater(robot)
    data = mujoco.MjData(model)
    ch, sw = water.chain, water.swimmer
    rng, dense = np.random.default_rng(2), np.zeros((model.nv, model.nv))
    with inject(model, water):
        for _ in range(10):
            q, v = random_state(rng, ch.n)
            data.qpos[:], data.qvel[:] = q, v
            for _ in range(2):
                mujoco.mj_forward(model, data)
                mujoco.mj_fullM(model, data, dense)
                k = planar_chain.kinematics(np, ch, q, v, [(0.0, 0.0)] * ch.n)
                np.testing.assert_allclose(world_matrix(ch, q[2], planar_chain.mass_matrix(ch, sw, k)), dense, rtol=0, atol=1e-12)


@pytest.mark.parametrize("root", ROOTS)
def test_names_sites_and_reference_point(root):
    robot = mjcf.load_robot("fish")
    model, geometry = mjcf.build(robot, root), mjcf.geometry_of(robot)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert [model.body(i + 1).name for i in range(4)] == ["head", "body1", "body2", "tail"]
    assert [model.actuator(i).name for i in range(3)] == ["j1", "j2", "j3"]
    np.testing.assert_allclose(data.site("nose").xpos, [geometry.reference, 0, 0], atol=1e-12)
    np.testing.assert_allclose(data.site("tail_tip").xpos, [geometry.reference - robot.length, 0, 0], atol=1e-12)
    mujoco.mj_comPos(model, data)
    np.testing.assert_allclose(data.subtree_com[1][:2], 0.0, atol=1e-12)  # the straight fish's centre of mass
    assert data.subtree_com[1][2] < -0.005  # ballast
    assert model.body_mass.sum() == pytest.approx(robot.mass, abs=1e-12)
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    assert model.opt.density == model.opt.viscosity == 0 and not model.opt.wind.any()


@pytest.mark.parametrize("name", ROBOTS)
def test_fish_is_neutrally_buoyant_and_trimmed(name):
    robot = mjcf.load_robot(name)
    g = mjcf.geometry_of(robot)
    assert g.displaced.sum() == pytest.approx(robot.mass, rel=1e-12)
    assert abs(np.sum(g.displaced * (g.origin + g.buoyancy))) / robot.mass < 1e-4  # m, centre of buoyancy over the centre of mass


def test_hull_mesh_holds_the_displaced_volume():
    """What is drawn is what floats: lofted links enclose the displaced water within the error of their facets."""
    robot = mjcf.load_robot("fish")
    model, g = mjcf.build(robot), mjcf.geometry_of(robot)
    for i, link in enumerate(robot.links[:3]):
        mesh = model.mesh(f"{link.name}_hull")
        vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]].astype(float)
        faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        volume = np.sum(np.cross(a, b) * c) / 6
        assert volume * robot.density_water == pytest.approx(g.displaced[i], rel=0.03), link.name


def test_mjcf_text_compiles_to_the_same_model():
    model, again = mjcf.build("fish"), mujoco.MjModel.from_xml_string(mjcf.mjcf_xml("fish"))
    for field in ("body_mass", "body_inertia", "body_ipos", "body_pos", "actuator_biasprm", "dof_damping", "jnt_axis"):
        np.testing.assert_allclose(getattr(model, field), getattr(again, field), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("root", ROOTS)
def test_pose_is_read_as_it_was_set(root):
    model = mjcf.build("fish", root)
    data = mujoco.MjData(model)
    data.qpos[:] = reference_qpos(model, (0.3, -0.2, 2.1), [0.1, 0.2, 0.3])
    data.qvel[-4 if root == "free" else 2] = 0.7  # yaw rate
    np.testing.assert_allclose(reference_pose(model, data), [0.3, -0.2, 2.1, 0, 0, 0.7], atol=1e-12)


def test_personal_constants_reach_the_model():
    model = mjcf.build("fish")
    before = model.body_mass.copy()
    personalise(model, mass=[1.1, 1, 1, 0.9], kp=[7, 8, 9], kv=[0.1, 0.2, 0.3], kb=[0.3, 0.3, 0.4], zero=[0.01, 0.0, -0.02])
    np.testing.assert_allclose(model.body_mass[1:] / before[1:], [1.1, 1, 1, 0.9])
    data = mujoco.MjData(model)
    data.qpos[3:] = [0.01, 0.0, -0.02]  # encoders read zero
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.actuator_force, 0, atol=1e-12)


def test_impossible_models_are_refused():
    with pytest.raises(UnknownName, match="Did you mean 'planar'"):
        mjcf.build("fish", "plan")
    robot = mjcf.load_robot("fish")
    lopsided = replace(robot.links[0], com=(0.07, 0.01, 0.0))
    with pytest.raises(ConfigError, match="y = 0"):
        mjcf.build(replace(robot, links=(lopsided, *robot.links[1:])))


def test_tendon_fish_swims_at_about_its_measured_speeds():
    """The second robot, driven with the joint motion seen in its marker tracks; priors only, nothing fitted to speed.

    Measured 0.023, 0.081, 0.130, 0.202 m/s. The band (factor 0.7 to 1.5) is what unfitted priors can claim.
    """
    robot = mjcf.load_robot("tendon_fish")
    seen = read_toml(resolve("tendon_fish"))["measured"]
    ch, sw = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    for i, real in enumerate(seen["speed"]):
        f, lag = seen["beat_hz"][i], np.radians(seen["fin_lag_deg"][i])
        tail, fin = np.radians(seen["tail_amplitude_deg"][i]), np.radians(seen["fin_amplitude_deg"][i])
        q, v, attached, track = [0.0] * 5, [0.0] * 5, 0.5, []
        for step in range(round(8 / ch.dt)):
            phase = 2 * np.pi * f * step * ch.dt
            s = planar_chain.step(
                np, ch, sw, q, v, attached, [tail * np.sin(phase), fin * np.sin(phase - lag)], [(0.0, 0.0)] * 3, (0.0, 0.0)
            )
            q, v, attached = s.q, s.v, s.attached
            track.append(q[:2])
        half = len(track) // 2
        speed = np.linalg.norm(np.subtract(track[-1], track[half])) / (half * ch.dt)
        assert 0.7 * real < speed < 1.5 * real, f"{f} Hz: {speed:.3f} m/s, measured {real} m/s"
