"""Sharper hulls and sheets: an option of the markers that leaves the default as it is."""

import numpy as np
import pytest

from fishmj.base.errors import UnknownName
from fishmj.lbm_oracle.cases import eel, paddle, sheet_shear
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.boundary import slips_of
from fishmj.lbm_oracle.immersed.markers import (
    EDGE_RADIUS,
    EDGES,
    FLAT,
    KINK,
    PLAIN,
    SHARP,
    Sharpness,
    _edge_inset,
    _ellipse,
    _facing,
    _outward,
    chain_markers,
    fish_markers,
    offset_of,
    sphere_markers,
)
from fishmj.lbm_oracle.run.solver_water import boundary_name

SHARP_SHEET = Sharpness(sheet_slip=KINK[3])


def kernel(r: np.ndarray, width: int) -> np.ndarray:
    """The one-dimensional weights at distances r cells, from the formulas of `kernels.py`."""
    a = np.abs(r)
    root = lambda x: np.sqrt(np.maximum(x, 0.0))
    if width == 3:
        near, far, edge = (1 + root(1 - 3 * a**2)) / 3, (5 - 3 * a - root(1 - 3 * (1 - a) ** 2)) / 6, (0.5, 1.5)
    else:
        near, far, edge = (3 - 2 * a + root(1 + 4 * a - 4 * a**2)) / 8, (5 - 2 * a - root(-7 + 12 * a - 4 * a**2)) / 8, (1, 2)
    return np.where(a <= edge[0], near, np.where(a <= edge[1], far, 0.0))


@pytest.mark.parametrize("width", kernels.WIDTHS)
def test_sheet_slip_length_is_the_mean_distance_of_two_kernel_draws(width):
    """Along a sheet at an angle the weights of its markers add up, so that only their distances across it count."""
    nodes, found = np.arange(-9, 10), []
    for angle in np.radians([0, 15, 30, 45]):
        along, across = np.array([np.cos(angle), -np.sin(angle)]), np.array([np.sin(angle), np.cos(angle)])
        for place in np.random.default_rng(0).random((12, 2)):
            at = place + np.arange(-4, 5)[:, None] * along
            weight = [kernel(x - nodes, width)[:, None] * kernel(y - nodes, width) for x, y in at]
            y = nodes[:, None] * across[0] + nodes * across[1]
            near = np.concatenate([np.abs(y[weight[4] > 0][:, None] - y[w > 0]).ravel() for w in weight])
            share = np.concatenate([(weight[4][weight[4] > 0][:, None] * w[w > 0]).ravel() for w in weight])
            found.append((near * share).sum() / len(weight))
    assert np.mean(found) == pytest.approx(KINK[width], abs=0.03)


def test_plain_sheet_is_as_thick_as_its_kernel_and_slip_length_thins_it():
    over, thick = sheet_shear.friction(10, 0.25, "cpu")
    assert over > 1.1
    assert thick == pytest.approx(KINK[3], abs=0.06)
    assert sheet_shear.friction(10, 0.25, "cpu", sharpness=SHARP_SHEET)[0] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("slip", [0.0, 0.95, 0.98, 1.0])
def test_by_default_every_marker_has_the_slip_of_the_wall(slip):
    markers = fish_markers("fish", 0.02, slip=slip)
    assert (slips_of(markers, slip, 1e-5, 2) == np.float64(slip)).all()
    assert PLAIN.insets(3, slip) == (offset_of(3, slip),) * 2
    assert (markers.slip_length == 0).all()


def test_a_slip_length_works_where_the_water_sticks_only():
    markers = fish_markers("fish", 0.02, slip=0.98, sharpness=SHARP_SHEET)
    assert (slips_of(markers, 0.98, 1e-3, 2) == 0.98).all()
    sticking = slips_of(markers, 0.0, 1e-3, 2)
    assert (sticking[~markers.sheet] == 0).all()
    resistance = 1.5 * KINK[3] / (2 * 1e-3)  # two passes, two sides
    assert sticking.max() == pytest.approx(resistance / (1 + resistance))


def test_a_sheet_that_stands_for_a_hull_is_as_thick_as_that():
    """The tail of an eel, which narrows to nothing: b + slip length = k, until the kernel alone is thicker."""
    body = eel.chain_markers(eel.eel(), 1 / 64, slip=0.0, sharpness=SHARP_SHEET)
    slip = body.slip_length[body.sheet]
    assert 0.3 < slip.max() < KINK[3]  # of its last row, half a cell before the drawn-in end
    assert (slip == 0).any()  # where it begins
    assert (body.slip_length[~body.sheet] == 0).all()
    fin = fish_markers("fish", 0.02, sharpness=SHARP_SHEET).slip_length
    assert fin.max() == KINK[3]


def test_more_passes_and_a_thinner_fluid_slip_more():
    one = sphere_markers(5.0, 1.0, sharpness=Sharpness(hull_slip=0.3))
    slip = [slips_of(one, 0.0, nu, passes)[0] for nu, passes in ((0.1, 1), (0.1, 2), (0.01, 2))]
    assert 0 < slip[0] < slip[1] < slip[2] < 1


def test_a_rim_is_of_sheets_and_a_hull_offset_of_hulls():
    plain, rim, hull = (fish_markers("fish", 0.01, sharpness=s) for s in (PLAIN, Sharpness(rim=1.5), Sharpness(hull=0.2)))
    height = lambda m: np.abs(m.rest[m.sheet, 2]).max()
    width = lambda m: np.abs(m.rest[~m.sheet, 1]).max()
    assert height(rim) == pytest.approx(height(plain) - 0.0105, abs=0.005)  # of rows about a cell apart
    assert width(rim) == pytest.approx(width(plain), rel=1e-4)  # stations move a little with the end of the tail
    assert width(hull) == pytest.approx(width(plain) + 0.0025, abs=2e-4)


def rings(markers) -> list[np.ndarray]:
    """Numbers of the markers of each station of a hull."""
    hull = np.flatnonzero(~markers.sheet & (np.abs(markers.normal[:, 0]) < 0.9))
    station = np.round(markers.rest[hull, 0], 9) + 100.0 * markers.before[hull]
    return [hull[station == s] for s in np.unique(station)]


@pytest.fixture(scope="module")
def edged_eel():
    return chain_markers(eel.eel(), 1 / 64, slip=0.0, sharpness=EDGES)


def test_no_marker_stands_on_the_edge_of_a_section_that_has_one(edged_eel):
    places = [np.unique(np.round(edged_eel.rest[ring], 9), axis=0) for ring in rings(edged_eel)]
    plain = [len(ring) for ring in rings(chain_markers(eel.eel(), 1 / 64, slip=0.0, sharpness=SHARP))]
    assert all(len(ring) % 4 == 0 for ring in places) and any(count % 4 for count in plain)
    assert all((np.abs(ring[:, 1]) > 0).all() for ring in places)


@pytest.mark.parametrize(("a", "b", "n"), [(5.0, 0.01, 20), (4.0, 1.0, 16), (1.0, 4.0, 16), (3.0, 3.0, 4)])
def test_markers_of_an_arc_face_all_the_ways_that_it_does(a, b, n):
    """Their shares and normals have the mean n n^T of the whole ellipse, by a quadrature of its own, and no left or right."""
    turn, _ = _ellipse(a, b, n)
    which, normal, share = _facing(a, b, n, _outward(a, b, turn))
    t = (np.arange(200_000) + 0.5) / 200_000 * 2 * np.pi
    length = np.hypot(b * np.sin(t), a * np.cos(t))
    n_y, n_z = a * np.cos(t) / length, b * np.sin(t) / length
    exact = [[np.average(u * v, weights=length) for v in (n_y, n_z)] for u in (n_y, n_z)]
    assert (share / n) @ (normal[:, :, None] * normal[:, None, :]).transpose(1, 0, 2) == pytest.approx(np.array(exact), abs=0.01)
    assert np.bincount(which, share, minlength=n) == pytest.approx(1.0, abs=FLAT)
    facing = np.array(sorted(zip(*np.round(np.abs(normal.T), 6), np.round(share, 6), strict=True)))
    assert facing[::4] == pytest.approx(facing[3::4])  # of each, four: left and right, above and below


def test_markers_are_doubled_at_edges_of_thin_sections_and_on_small_ones():
    counts = {b: np.bincount(_facing(20.0, b, 128, _outward(20.0, b, _ellipse(20.0, b, 128)[0]))[0]) for b in (20.0, 0.5)}
    assert (counts[20.0] == 1).all()
    assert (np.bincount(_facing(4.0, 4.0, 24, _outward(4.0, 4.0, _ellipse(4.0, 4.0, 24)[0]))[0]) == 2).all()
    assert np.flatnonzero(counts[0.5] == 2).tolist() == [31, 32, 95, 96]


def test_edged_hull_is_inset_by_full_length_and_a_vanishing_one_is_a_sheet(edged_eel):
    dx = 1 / 64
    sheet = edged_eel.sheet
    assert sheet.any() and edged_eel.slip_length[sheet].min() > KINK[3] - SHARP.hull - 1e-9
    widest = np.abs(edged_eel.rest[~sheet, 1]).max()
    assert widest == pytest.approx(0.04 - SHARP.hull * dx, abs=0.002)
    assert min(np.abs(edged_eel.rest[ring, 1]).max() for ring in rings(edged_eel)) < 0.25 * dx  # by a part of its width: 0.3 dx


def test_edge_inset_follows_the_rim_if_sharp_and_the_hull_if_round(edged_eel):
    dx, hull, rim = 0.01, 0.5, 1.25
    inset = lambda half_width: _edge_inset(0.05, half_width, hull, rim, dx)
    assert inset(1e-4) == pytest.approx(rim, abs=1e-3) and inset(1.0) == pytest.approx(hull, abs=1e-3)
    assert inset(np.sqrt(0.05 * EDGE_RADIUS * dx)) == pytest.approx((hull + rim) / 2)
    plain = chain_markers(eel.eel(), 1 / 64, slip=0.0, sharpness=SHARP)
    assert np.abs(edged_eel.rest[:, 2]).max() < np.abs(plain.rest[:, 2]).max()


def test_a_boundary_without_edges_has_the_name_that_records_know():
    assert boundary_name(Sharpness(rim=1.25)) == "Sharpness(hull=None, rim=1.25, hull_slip=0.0, sheet_slip=0.0)"
    assert boundary_name(Sharpness(rim=1.25, edges=True)).endswith("edges=True)")


def test_an_offset_that_is_given_holds_for_both():
    assert Sharpness(hull=0.2, rim=1.5).insets(3, 1.0, hydro_offset=0.4) == (0.4, 0.4)
    with pytest.raises(UnknownName):
        PLAIN.insets(5)


def test_edged_paddle_on_a_coarse_grid_pushes_as_on_a_finer_one():
    """Six cells a height and a marker too many on an edge or a sheet in its place make it push a quarter less."""
    few, more = (paddle.heave(cells, "cpu", periods=1) for cells in (6, 8))
    plain = paddle.heave(6, "cpu", sharpness=SHARP, periods=1)
    assert few == pytest.approx(more, rel=0.06)
    assert plain[0] < 0.85 * few[0] and plain[1] < 0.8 * few[1]
