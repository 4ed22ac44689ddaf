"""Water that effects move: how it turns along a link, and the push of its own acceleration."""

import numpy as np
from effect_swim import CHAIN, JOINTS, SWIMMER, H

from fishmj import effects
from fishmj.effects import EffectStack
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

STILL = [(0.0, 0.0)] * CHAIN.n


def met(name: str, q, flow=STILL, **values):
    """(hooks of one effect, water at the links (N, 3)) of a fish at q."""
    active = EffectStack([effects.get(name)], JOINTS)
    hooks = Effects(np, active, active.flat({name: values}), active.memory)
    return hooks, hooks.flow(CHAIN, q, flow)


def test_a_fish_that_turns_with_the_water_meets_none():
    rate, (x, y) = 0.3, (0.7, -0.4)
    q, v = [x, y, 0.9, 0.0, 0.0, 0.0], [-rate * y, rate * x, rate, 0.0, 0.0, 0.0]
    _, flow = met("swirl", q, rate=rate)
    k = planar_chain.kinematics(np, CHAIN, q, v, flow)
    np.testing.assert_allclose([*k.u, *k.w, *k.omega], 0.0, atol=1e-12)
    assert k.own == [rate] * CHAIN.n


def test_the_pressure_that_turns_the_water_holds_the_fish_on_its_circle():
    """A fish as heavy as its water, carried by a swirl O: a = -O^2 r at its middle, with nothing else to hold it."""
    rate, q = 0.3, [1.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    v = [0.0, rate * q[0], rate, 0.0, 0.0, 0.0]
    hooks, _ = met("swirl", q, rate=rate)
    hooks.stream.clear()  # asked anew in the step
    s = planar_chain.step(np, CHAIN, SWIMMER, q, v, 0.5, [0.0] * JOINTS, STILL, (0.0, 0.0), hooks)
    np.testing.assert_allclose((s.v[0] - v[0]) / H, -(rate**2) * q[0], rtol=0.02)
    assert abs(s.v[2] - rate) / H < 0.02 * rate


def test_a_shear_turns_a_link_by_what_it_differs_along_it():
    ahead = [0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]
    _, across = met("current_shear", ahead, [(0.2, 0.0)] * CHAIN.n, rate=0.1)
    np.testing.assert_allclose(np.array(across)[:, 2], -0.1)  # faster at the nose, which it turns to the right
    np.testing.assert_allclose(across[0][:2], [0.2, 0.0], atol=1e-15)  # at the origin, not at the centre
    _, along = met("current_shear", [0.0, 0.5, 0.0, 0.0, 0.0, 0.0], [(0.2, 0.0)] * CHAIN.n, rate=0.1)
    np.testing.assert_allclose(along, [(0.25, 0.0, 0.0)] * CHAIN.n, atol=1e-15)
