"""The device's own articulated body beside MuJoCo's, from which it must not be told."""

import mujoco
import numpy as np
import pytest
import warp as wp

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.immersed import articulated_body
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.mjcf import build

wp.config.quiet = True


def chain(links: int, root: str, branch: bool = False) -> mujoco.MjModel:
    """A chain with nothing in its place: hinges about all axes beside their links' origins, turned frames, masses off them."""
    rng, spec = np.random.default_rng(links), mujoco.MjSpec()
    spec.option.gravity, kinds = [0.3, -0.2, -9.81], mujoco.mjtJoint
    body = spec.worldbody
    for i in range(links):
        parent = body if not (branch and i == links // 2) else spec.body("l0")
        body = parent.add_body(name=f"l{i}", pos=rng.normal(size=3), quat=rng.normal(size=4))
        body.mass, body.inertia, body.ipos, body.iquat = (
            rng.uniform(0.1, 2),
            [0.02, 0.025, 0.03],
            rng.normal(size=3),
            rng.normal(size=4),
        )
        body.explicitinertial = True
        if i == 0 and root == "free":
            body.add_freejoint(name="root")
        elif i == 0:
            for name, kind, axis in (("x", kinds.mjJNT_SLIDE, 0), ("y", kinds.mjJNT_SLIDE, 1), ("yaw", kinds.mjJNT_HINGE, 2)):
                body.add_joint(name=name, type=kind, axis=np.eye(3)[axis])
        else:
            kind = kinds.mjJNT_SLIDE if i % 5 == 3 else kinds.mjJNT_HINGE
            own = {"axis": rng.normal(size=3), "pos": rng.normal(size=3), "damping": [0.3, 0, 0], "armature": 0.01}
            body.add_joint(name=f"j{i}", type=kind, ref=0.2, **own)
            if i % 2:
                servo = spec.add_actuator(name=f"j{i}", target=f"j{i}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
                servo.set_to_position(kp=8.0, kv=0.1)
                servo.forcelimited, servo.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-1.5, 1.5]
    return spec.compile()


MODELS = {
    "fish, planar": lambda: build("fish", "planar", bare=True),
    "fish, free": lambda: build("fish", "free", bare=True),
    "one free link": lambda: chain(1, "free"),
    "16 links, planar": lambda: chain(16, "planar"),
    "20 links, free": lambda: chain(20, "free"),
    "two branches, free": lambda: chain(9, "free", branch=True),
}


def somewhere(model: mujoco.MjModel, seed: int = 0) -> mujoco.MjData:
    """Four metres off, bent, turning, under commands of which some saturate."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-1, 1, model.nq)
    data.qpos[:2] += 4.0
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:], data.ctrl[:] = rng.normal(size=model.nv), rng.normal(size=model.nu)
    mujoco.mj_forward(model, data)
    return data


def on_device(model: mujoco.MjModel, data: mujoco.MjData, device: str = "cpu"):
    """The same state in the kernels' arrays, and all that they make of it."""
    tree, motion = articulated_body.tree_of(model, device), articulated_body.motion_of(model, device)
    for array, values in ((motion.qpos, data.qpos), (motion.qvel, data.qvel), (motion.command, data.ctrl)):
        array.assign(np.array(values))
    threads = 1 if device == "cpu" else 256
    wp.launch(articulated_body.state_equation, dim=threads, inputs=[tree, motion], device=device)
    return tree, motion


def same(found: wp.array, expected) -> None:
    expected = np.asarray(expected).ravel()
    np.testing.assert_allclose(found.numpy(), expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max(initial=0.0)))


@pytest.mark.parametrize("name", MODELS)
def test_masses_and_forces_are_mujocos(name):
    model = MODELS[name]()
    data = somewhere(model)
    _, found = on_device(model, data)
    masses = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, masses)
    same(found.mass_matrix, masses)
    same(found.bias, data.qfrc_bias)
    same(found.actuator, data.qfrc_actuator)
    same(found.passive, data.qfrc_passive)


@pytest.mark.parametrize("name", ["fish, planar", "fish, free", "two branches, free"])
def test_the_pose_is_what_the_markers_follow(name):
    model = MODELS[name]()
    data = somewhere(model)
    _, found = on_device(model, data)
    count, pose = model.nbody - 1, found.pose.numpy()
    frames = pose[: 12 * count].reshape(count, 12)
    np.testing.assert_allclose(frames, np.concatenate([data.xpos[1:], data.xmat[1:]], 1), atol=1e-12)
    if name.startswith("fish"):
        body = ImmersedBody.of("fish", name.split()[1])
        body.place(data.qpos, data.qvel)
        np.testing.assert_allclose(pose, body.pose, atol=1e-12)


@pytest.mark.parametrize("name", ["fish, planar", "20 links, free"])
def test_a_step_ends_where_mujocos_own_does(name):
    model = MODELS[name]()
    data, dt = somewhere(model), 0.004
    tree, found = on_device(model, data)
    v = np.random.default_rng(5).normal(size=model.nv)
    wp.launch(articulated_body.advance_state, dim=model.njnt, inputs=[tree, found, wp.array(v, device="cpu"), dt], device="cpu")
    mujoco.mj_integratePos(model, data.qpos, v, dt)
    np.testing.assert_allclose(found.qpos.numpy(), data.qpos, atol=1e-13)
    np.testing.assert_array_equal(found.qvel.numpy(), v)


def test_what_is_left_out_is_refused():
    spec = mujoco.MjSpec()
    link = spec.worldbody.add_body(name="link", mass=1.0, inertia=[1, 1, 1], explicitinertial=True)
    link.add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
    with pytest.raises(ConfigError, match="no slide, hinge or free joint"):
        articulated_body.tree_of(spec.compile(), "cpu")
    model = build("fish", "planar", bare=True)
    model.jnt_stiffness[3], model.opt.density = 1.0, 1000.0
    with pytest.raises(ConfigError, match="a spring, MuJoCo's fluid"):
        articulated_body.tree_of(model, "cpu")


@pytest.mark.gpu
@pytest.mark.parametrize("name", MODELS)
def test_a_block_of_threads_finds_the_same_masses_and_forces(name):
    model = MODELS[name]()
    data = somewhere(model)
    (_, one), (_, block) = (on_device(model, data, device) for device in ("cpu", "cuda"))
    for part in ("pose", "mass_matrix", "bias", "actuator", "passive"):
        same(getattr(block, part), getattr(one, part).numpy())
