"""The MuJoCo model is the described fish, and the closed-form chain is that model to round-off."""

import mujoco
import numpy as np
import pytest

from fishmj import mjcf
from fishmj.errors import ConfigError, InjectionError, UnknownName
from fishmj.hydro_fit import chain, passive
from fishmj.mjcf.model import reference_qpos

ROBOTS = ("fish", "tendon_fish")


def random_state(rng, n):
    """Generalised position and velocity of a fish somewhere in the tank, joints within +-60 deg."""
    q = np.concatenate([rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi, 1), rng.uniform(-1, 1, n - 1)])
    return q, rng.normal(size=n + 2) * [0.4, 0.4, 2.0] [:2] + [2.0] * n if False else rng.normal(size=n + 2)


@pytest.mark.parametrize("name", ROBOTS)
def test_chain_mass_matrix_and_bias_equal_mujoco(name):
    robot = mjcf.load_robot(name)
    model = mjcf.build(robot)
    data = mujoco.MjData(model)
    ch, sw = chain.chain_of(robot), chain.nominal(robot)
    rng = np.random.default_rng(1)
    dense = np.zeros((model.nv, model.nv))
    for _ in range(50):
        q, v = random_state(rng, ch.n)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        k = chain.kinematics(np, ch, q, v, [(0.0, 0.0)] * ch.n)
        mine = passive.world_matrix(ch, q[2], chain.mass_matrix(ch, sw, k, water=False))
        np.testing.assert_allclose(mine, dense, rtol=0, atol=1e-12)
        bias = chain.gather(ch, k, chain.bias_forces(ch, sw, k, water=False))
        np.testing.assert_allclose(chain.generalised(np, ch, q[2], bias), -data.qfrc_bias, rtol=0, atol=1e-12)
