"""More mass, spread over the links or as a payload at the head's reference point: the hook and MuJoCo's own attributes agree."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from effect_swim import CHAIN, JOINTS, SWIMMER

from fishmj import effects
from fishmj.effects import EffectStack
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.gap.commands.mjcf_patch import mjcf
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics.hooks import Effects
from fishmj.water.dynamics.planar_chain import chain_of


def heavier(chain, swimmer, mass: float, spread: float):
    """Masses (N,), places of their centres (N,) and inertias (N,) of the links with the effect."""
    active = EffectStack([effects.get("body_mass")], JOINTS)
    row = active.flat({"body_mass": {"mass": mass, "spread": spread}})
    ch, sw = Effects(np, active, row, active.memory).fish(chain, swimmer)
    return np.array(sw.mass) * ch.mass, np.array(ch.com), np.array(sw.mass) * ch.inertia


@pytest.mark.parametrize("spread", [-0.2, 0.0, 0.4, 1.0])
def test_a_payload_sits_at_the_heads_origin_and_leaves_its_other_moments(spread):
    mass, com, inertia = heavier(CHAIN, SWIMMER, 0.2, spread)
    share = 1 + spread * 0.2 / sum(CHAIN.mass)
    assert np.isclose(mass.sum(), sum(CHAIN.mass) + 0.2)
    np.testing.assert_allclose(mass * com, share * np.array(CHAIN.mass) * CHAIN.com)
    second = np.array(CHAIN.inertia) + np.array(CHAIN.mass) * np.array(CHAIN.com) ** 2
    np.testing.assert_allclose(inertia + mass * com**2, share * second)


@pytest.mark.parametrize("spread", [0.0, 0.4, 1.0])
def test_mujoco_holds_the_same_masses(spread):
    parent = load_robot("fish")
    values = {k: Interval(v, v, v) for k, v in {"mass": 0.2, "spread": spread}.items()}
    model = mujoco.MjModel.from_xml_string(mjcf(replace(parent, effects=(FittedEffect("body_mass", values),))))
    mass, com, inertia = heavier(chain_of(parent), SWIMMER._replace(mass=[1.0] * 4), 0.2, spread)
    np.testing.assert_allclose(model.body_mass[1:], mass, rtol=1e-5)
    np.testing.assert_allclose(model.body_ipos[1:, 0], com, rtol=1e-5)
    np.testing.assert_allclose(model.body_inertia[1:, 2], inertia, rtol=1e-5)
