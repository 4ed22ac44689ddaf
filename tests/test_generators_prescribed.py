"""What a generator's water does in a prescribed motion: the truth that calibrations of water are judged by."""

import numpy as np
import pytest

from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.generators import prescribed
from fishmj.gap.laboratory.generators.family import family_named
from fishmj.gap.laboratory.generators.generator_trials import robot_of
from fishmj.gap.laboratory.generators.mujoco_robot import RobotSimulation


@pytest.mark.parametrize("name", generators.NAMES)
def test_every_figure_of_a_robot_is_there_and_has_its_sign(name):
    found = prescribed.prescribed(name, 7)
    assert set(found) == set(prescribed.UNITS) and all(np.isfinite(value) for value in found.values())
    assert all(found[key] > 0 for key in found if key != "surge_mass") and found["surge_mass"] >= 0
    assert found["side_drag"] > 5 * found["drag"]
    assert prescribed.prescribed(name, 7) == found != prescribed.prescribed(name, 8)


@pytest.mark.parametrize("name", generators.NAMES)
def test_added_mass_is_that_of_the_water(name):
    fish = robot_of(name, {}, 3)
    run, found = RobotSimulation(fish), prescribed.of_fish(fish)
    added, x = run.chain.added, np.concatenate([[0.0], np.cumsum(run.chain.hinge[:-1])])
    assert found["sway_mass"] == pytest.approx(added[:, 1, 1].sum())
    assert found["surge_mass"] == pytest.approx(added[:, 0, 0].sum(), abs=1e-12)
    spin = added[:, 2, 2] + 2 * x * added[:, 1, 2] + x**2 * added[:, 1, 1]  # each link's, moved to the reference point
    assert found["yaw_mass"] == pytest.approx(spin.sum())


def test_drag_of_the_ellipsoid_is_its_law():
    fish = robot_of("ellipsoid", {}, 0, nuisance=0.0)
    law = family_named("ellipsoid").build(fish.robot, fish.coefficients).law
    u = prescribed.SPEED
    fin = law.fin * 0.02 * u**2  # FRICTION_FIN at no angle of attack
    assert prescribed.of_fish(fish)["drag"] == pytest.approx(float((law.laminar + law.form * u).sum() * u + fin))


def test_drag_of_a_hidden_effect_comes_on_top():
    plain = prescribed.prescribed("morison", 5)
    more = prescribed.prescribed("morison", 5, {"linear_surge_drag": {"coefficient": 0.3}})
    assert more["drag"] - plain["drag"] == pytest.approx(0.3 * prescribed.SPEED)
    assert more["thrust"] == pytest.approx(plain["thrust"] - 0.3 * prescribed.SPEED)


def test_a_water_that_remembers_has_forgotten_its_start():
    fish = robot_of("foil", {}, 2)
    run, rate = RobotSimulation(fish), np.array([prescribed.SPEED, 0.1, *[0.0] * 4])
    first = prescribed.water_at(run, np.zeros(6), rate).copy()
    late = prescribed.steady(fish, {0: prescribed.SPEED, 1: 0.1})
    for _ in range(3 * prescribed.SETTLE):
        longer = prescribed.water_at(run, np.zeros(6), rate)
    assert longer[:3] == pytest.approx(late, rel=0.01) and abs(first[1] - late[1]) > 0.001 * abs(late[1])
