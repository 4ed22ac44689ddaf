"""Every way of putting the water into an engine takes the same step as the closed form."""

import mujoco
import numpy as np
import pytest

from fishmj import mjcf
from fishmj.hydro_fit import chain
from fishmj.hydro_fit.inject import inject
from fishmj.hydro_fit.passive import PlanarWater


def gait(t, n, f=1.0, amplitude=np.radians(30), lag=np.radians(60)):
    """Joint commands (n,) of a travelling wave, rad."""
    return amplitude * np.sin(2 * np.pi * f * t - lag * np.arange(n))


def closed_form(robot, q, v, attached, seconds, flow, ambient):
    """The reference: rows of (q, v, attached) after every step of the gait."""
    ch, sw = chain.chain_of(robot), chain.nominal(robot)
    q, v, rows = list(q), list(v), []
    for i in range(round(seconds / ch.dt)):
        s = chain.step(np, ch, sw, q, v, attached, gait(i * ch.dt, ch.n - 1), flow, ambient)
        q, v, attached = s.q, s.v, s.attached
        rows.append([*q, *v, attached])
    return np.array(rows)


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_callback_equals_closed_form(name):
    robot = mjcf.load_robot(name)
    model = mjcf.build(robot)
    data = mujoco.MjData(model)
    water = PlanarWater(robot)
    n = water.chain.n
    rng = np.random.default_rng(3)
    data.qpos[:], data.qvel[:] = rng.normal(size=n + 2) * 0.3, rng.normal(size=n + 2) * 0.2
    flow, ambient = rng.normal(size=(n, 2)) * 0.2, rng.normal(size=2)
    reference = closed_form(robot, data.qpos, data.qvel, 0.5, 2.0, [tuple(r) for r in flow], tuple(ambient))
    water.set_flow(flow, ambient)
    rows = []
    with inject(model, water) as fish:
        for _ in range(len(reference)):
            data.ctrl[:] = gait(data.time, n - 1)
            fish.step(data)
            rows.append([*data.qpos, *data.qvel, water.attached])
    np.testing.assert_allclose(np.array(rows), reference, rtol=0, atol=1e-9)
