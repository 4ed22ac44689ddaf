"""The boxes round the links' markers: one product with a matrix against corner by corner."""

import numpy as np
import pytest

from fishmj.base.errors import SimDiverged
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.lbm_oracle.immersed.markers import fish_markers


@pytest.fixture(params=["planar", "free"])
def swimming(request) -> tuple[ImmersedBody, Corners]:
    rng = np.random.default_rng(5)
    body = ImmersedBody.of("fish", request.param)
    qpos = rng.normal(scale=0.4, size=body.model.nq)
    if request.param == "free":
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
    body.place(qpos, rng.normal(size=body.dofs))
    return body, Corners.of(fish_markers("fish", 0.02), body.water.centre)


def one_by_one(body: ImmersedBody, corners: Corners):
    """Positions and velocities of all corners in the world."""
    for link in range(body.links):
        turn, (u, w) = body.turn[link], body.twist[link].reshape(2, 3)
        for corner in corners.at[link]:
            yield body.data.xpos[link + 1] + turn @ corner, u + np.cross(w, turn @ (corner - body.water.centre[link]))


def test_the_bounds_are_those_of_all_corners(swimming):
    body, corners = swimming
    where = np.array([x for x, _ in one_by_one(body, corners)])
    low, high = body.bounds(corners)
    np.testing.assert_allclose([low, high], [where.min(0), where.max(0)], atol=1e-14)
    assert np.ptp(where, 0).min() > 0.05


def test_the_box_of_cells_lies_round_the_middle_of_all(swimming):
    body, corners = swimming
    dx, corner, size = 0.02, np.array([-2.0, -1.5, -0.5]), np.array([41, 42, 15])
    corners.set_grid(dx, corner, size)
    first, (low, high) = body.first_cell(corners), body.bounds(corners)
    middle = corner + dx * (first + size / 2)
    assert (first == np.round(first)).all()
    np.testing.assert_array_less(np.abs(middle - (low + high) / 2), 0.5 * dx + 1e-12)


def test_fastest_corner_is_found_and_updated_when_the_body_moves(swimming):
    body, corners = swimming
    for factor in (0.5, 2.0, 1.0):
        body.place(body.data.qpos.copy(), factor * np.arange(1.0, body.dofs + 1))
        expected = max(np.linalg.norm(v) for _, v in one_by_one(body, corners))
        assert body.fastest(corners) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("at", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1001.0, -1001.0])
def test_non_finite_or_runaway_velocity_is_refused_naming_its_joint(at, value):
    body, velocity = ImmersedBody.of("fish"), np.linspace(-1.0, 1.0, 6)
    body.equation()
    before, velocity[at] = body.data.qpos.copy(), value
    with pytest.raises(SimDiverged, match=body.model.joint(at).name):
        body.advance(velocity)
    np.testing.assert_array_equal(body.data.qpos, before)
