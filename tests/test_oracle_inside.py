"""The water inside the hull: measured along the links, it is neither lost nor taken for the fish's own."""

import numpy as np
import pytest

from fishmj.lbm_oracle.immersed.kernels import Points
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.mjcf import geometry_of, load_robot
from fishmj.water.flow import Flow

SMALL = preset("laptop").changed(depth=0.4)


def test_points_share_each_link_and_keep_its_volume_in_place():
    g = geometry_of(load_robot("fish"))
    points = Points.of(g)
    for link in range(g.n_links):
        mine = points.link == link
        assert points.share[mine].sum() == pytest.approx(1.0)
        centre = points.share[mine] @ points.place[mine]
        assert centre[0] == pytest.approx(g.buoyancy[link], abs=2e-3)
        assert np.abs(centre[1:]).max() < 1e-12


def test_a_uniform_stream_is_measured_along_every_link():
    yaw, bent = 0.4, (0.5, -0.3, 0.2)
    stream = Flow(speed=0.2, direction=0.0)
    held = SwimSetup(domain=SMALL, flow=stream, pose=(0.0, 0.0, yaw), joints=bent).coupled()
    held.step(np.ones(held.body.dofs), np.zeros(held.body.dofs))  # the stream of t = 0 is still everywhere
    turn = yaw + np.cumsum([0.0, *bent])
    assert held.body.interior_speed == pytest.approx(0.2 * np.cos(turn), abs=1e-4)


@pytest.mark.parametrize("slip, least, most", [(1.0, 1.0, 1.25), (0.0, 1.5, 4.0)])
def test_a_frictionless_fish_weighs_what_it_weighs_along_its_axis(slip, least, most):
    """Pushed ahead from rest: its mass and a tenth of added mass; a hull that holds the water drags a layer along."""
    free = SwimSetup(domain=SMALL, slip=slip).coupled()
    push, mass = 0.2, free.body.model.body_mass.sum()
    free.body.applied[0] = push
    fixed = np.ones(free.body.dofs)
    fixed[0] = 0.0
    for _ in range(10):
        velocity = free.step(fixed, np.zeros(free.body.dofs))
    assert least < push * free.time / velocity[0] / mass < most


def test_a_fish_set_down_in_a_stream_is_not_carried_off():
    """Water that slides along the hull pushes it by friction only: none here."""
    free = SwimSetup(domain=SMALL, flow=Flow(speed=0.2, direction=np.pi)).coupled()
    for _ in range(10):
        velocity = free.step()
    assert abs(velocity[0]) < 0.25 * 0.2
