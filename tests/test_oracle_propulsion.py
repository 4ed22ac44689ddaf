"""Known answers that swim: what moves, what is measured, and what it is held against, at sizes that take a moment."""

import numpy as np
import pytest

from fishmj.lbm_oracle import cases
from fishmj.lbm_oracle.cases import eel, flapping, heaving_foil, plate, rolling_fin
from fishmj.lbm_oracle.cases.coupled_fish import drift, momentum
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import PLAIN, Markers
from fishmj.lbm_oracle.immersed.shapes import BodyShape, plate_markers
from fishmj.lbm_oracle.scene import Scene
from fishmj.mjcf.geometry import geometry_of

NAMES = ("plate", "plate_grid", "flapping", "flapping_fine", "rolling_fin", "rolling_fin_grid", "eel", "eel_fine", "heaving_foil")


def test_every_swimming_case_is_on_the_ladder_with_a_small_one_before_it():
    table = cases.known()
    for name in NAMES:
        coarse = table[f"{name.removesuffix('_grid').removesuffix('_fine')}_coarse"]
        assert table[name].gpu and not coarse.gpu and int(table[name].rung) == coarse.rung < table[name].rung
        assert not table[name].quick and not coarse.quick


def test_a_plate_is_a_flat_sheet_with_its_leading_edge_up():
    markers = plate_markers(16.0, 32.0, np.radians(30.0), 1.0, PLAIN)
    along, across = markers.rest @ [np.cos(np.pi / 6), -0.5, 0.0], markers.rest[:, 2]
    assert np.abs(np.sum(markers.rest * markers.normal, 1)).max() < 1e-12 and markers.sheet.all()
    assert markers.area.sum() == pytest.approx((16 - 1.4) * (32 - 1.4))  # drawn in by 0.7 cells at each edge
    assert np.abs(along).max() < 8 - 0.7 and np.abs(across).max() < 16 - 0.7
    assert markers.rest[np.argmin(markers.rest[:, 0]), 1] > 0


def test_a_plate_in_a_stream_lifts_and_a_flat_one_does_not():
    lift, drag = plate.hold(6, 40.0, "cpu", box=(5.0, 4.0, 4.0), end=1.0, settled=0.5)
    flat, less = plate.hold(6, 0.0, "cpu", box=(5.0, 4.0, 4.0), end=1.0, settled=0.5)
    assert lift > 0.3 and drag > 1.3 * less > 0 and abs(flat) < 0.1 * lift


def test_the_greatest_lift_is_that_of_a_parabola_round_it():
    angles = np.array([20, 25, 30, 35, 40])
    assert plate.greatest(angles, 0.76 - 0.001 * (angles - 28.0) ** 2) == pytest.approx((28.0, 0.76))


def test_the_records_of_the_hovering_ellipse_have_the_noted_means():
    assert flapping.VORTEX_LIFT.mean() == pytest.approx(flapping.VORTEX["C_L"], abs=2e-3)
    assert flapping.VORTEX_DRAG.mean() == pytest.approx(flapping.VORTEX["C_D"], abs=2e-3)
    for name, room in (("C_L", flapping.LIFT), ("C_D", flapping.DRAG)):
        assert room[0] < flapping.TANK[name] < room[1] and room[0] < flapping.VORTEX[name] < room[1]


def test_the_quasi_steady_forces_are_those_of_the_source():
    """petibm-flapping finds 3.0224 and 3.7354 for U = 2.1991."""
    u = np.pi * 0.25 * 2.8
    assert flapping.denominators() == pytest.approx((3.0224 / u**2, 3.7354 / u**2), rel=1e-4)


@pytest.mark.parametrize("cells", [12, 32, 64])
def test_an_ellipse_of_markers_lies_inside_its_ellipse_and_is_symmetric(cells):
    markers = flapping.ellipse_markers(cells)
    x, y, _ = markers.rest.T
    assert ((2 * x / cells) ** 2 + (2 * y / (0.1 * cells)) ** 2 < 1).all()
    for mirrored in ([-1, 1, 1], [1, -1, 1]):
        there = markers.rest * mirrored
        assert all(np.linalg.norm(markers.rest - p, axis=1).min() < 1e-9 for p in there)
    across = markers.area @ np.abs(markers.normal[:, 1])  # one cell deep: twice the length where there are two rows, once else
    assert across == pytest.approx((cells - 1.4) * (2 - markers.sheet.sum() / len(np.unique(np.round(x, 9)))), rel=1e-6)


def test_an_ellipse_that_hovers_pushes_water_down_and_is_held_back():
    record = flapping.hover(6, "cpu", box=6.0, periods=1, samples=10)
    assert record[:, 0].mean() > 0.2 and record[1:5, 1].mean() > 0.3 and record[6:9, 1].mean() > 0.3


def fin(phase: float, psi: float, place: np.ndarray) -> np.ndarray:
    """Markers `place` (N, 3) of a fin where the source puts them, rollingpitching.cpp."""
    roll, pitch = (-rolling_fin.SWING * np.cos(2 * np.pi * phase + lag) for lag in (0.0, psi))
    x, y, z = place.T
    across = -x * np.sin(pitch) + y * np.cos(pitch)
    ahead = x * np.cos(pitch) + y * np.sin(pitch)
    return np.stack([ahead, np.cos(roll) * across + np.sin(roll) * z, -np.sin(roll) * across + np.cos(roll) * z], -1)


@pytest.mark.parametrize("psi", [90.0, 110.0])
def test_the_fin_rolls_and_pitches_as_in_the_source(psi):
    lag, hinge, steps = np.radians(psi), np.array([7.2, 7.7, 6.6]), 90
    markers = rolling_fin.fin_markers(5)
    shape = BodyShape(name="fin", markers=lambda dx: markers, size=6.0, area=1.0)
    box = Scene((16.0, 16.0, 20.0), 1.0, 0.01, rho=1.0, dt=1.0, sides="periodic")
    path = lambda step: rolling_fin.angles(step / steps, lag)
    driven = box.add(shape, hinge + 0.5, joints=("hinge x", "hinge z"), motion=path)
    driven.run(10.0)
    driven.coupled.place_markers()
    driven.coupled.assemble_response()
    world = driven.coupled.boundary.world.numpy() - 0.5
    assert world == pytest.approx(hinge + fin(10 / steps, lag, markers.rest), abs=1e-9)


def test_the_fastest_part_of_the_fin_sets_the_time_step():
    rim = np.linspace(0, 2 * np.pi, 100)
    place = np.stack([0.5 * np.cos(rim), 0 * rim, rolling_fin.SPAN / 2 * (1 + np.sin(rim))], -1)
    for psi in (90, 120):
        lag, step = np.radians(psi), 1e-4
        moved = [fin(p + step, lag, place) - fin(p, lag, place) for p in np.arange(0, 1, 0.01)]
        fastest = np.linalg.norm(moved, axis=-1).max() / step * 0.6 / (rolling_fin.SWING * rolling_fin.SPAN)
        assert rolling_fin.greatest_rim_speed(0.6, lag) == pytest.approx(fastest, rel=1e-2)


def test_a_fin_gives_power_and_its_lift_alternates():
    """Twelve samples of the first cycle at six cells: forces are not right there, signs and the balance of power are."""
    (cycle,) = rolling_fin.flap(6, 0.8, 90, "cpu", box=(5.0, 5.0, 5.0), cycles=1, samples=12)
    lift = cycle.force[:, 1]
    assert (lift[1:4] < 0).all() and (lift[7:10] > 0).all()  # against the roll: to +y first
    assert cycle.power.mean() > 0 and cycle.whole_efficiency == pytest.approx(cycle.thrust / cycle.power.mean())


def test_the_limit_of_two_grids_takes_an_error_of_the_first_order_away():
    exact = np.array([0.98, 2.8])
    coarse, fine = (exact + np.array([-12.0, 3.0]) / cells for cells in (48, 64))
    assert plate.limit(48, coarse, 64, fine) == pytest.approx(exact)


def test_an_eel_is_as_heavy_as_its_water_and_as_wide_as_stated():
    g = geometry_of(eel.eel())
    assert g.width_scale == pytest.approx(1.0, rel=1e-5) and g.mass == pytest.approx(g.displaced, rel=1e-4)
    assert eel.half_width([0.0, 0.02, 0.04, 0.95, 1.0]) == pytest.approx([0, np.sqrt(0.0012), 0.04, 0.01, 0])
    assert eel.half_height([0.51, 0.0]) == pytest.approx([0.08, 0.0])


def test_the_links_of_an_eel_lie_along_its_midline():
    """Chained up from the joints, the wave comes back to 1 % of the length: its amplitude grows to 0.125."""
    for t in (0.0, 0.3, 0.7):
        angle = eel.joints(np.array([t]))[0]
        assert eel.joints(np.array([t + 0.5]))[0] == pytest.approx(-angle)
        s = np.linspace(0, 1, 17)
        across = 0.125 * (s + 0.03125) / 1.03125 * np.sin(2 * np.pi * (s - t))
        heading = np.concatenate([[0.0], np.cumsum(angle)])
        nodes = np.concatenate([[[0.0, 0.0]], -np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1) / 16, 0)])
        turn = np.arctan2(across[-1] - across[0], np.sqrt(1 - 0.1)) - np.arctan2(nodes[-1, 1], -nodes[-1, 0])
        spun = np.cos(turn) * nodes[:, 1] - np.sin(turn) * nodes[:, 0]
        assert np.abs(spun + across[0] - across).max() < 0.015


def test_swimming_eel_follows_its_joint_wave_and_conserves_momentum():
    """Four links, a beat from rest: as many degrees of freedom as the fish. The inside water lags by a step or two."""
    cells, steps = 24, 13 * 24
    robot = eel.eel(4)
    lattice = Lattice(dx=1 / cells, dt=1 / steps, rho=1000.0, nu=eel.VISCOSITY, corner=(0.0, 0.0, -0.3))
    body = eel.chain(robot, lattice.dt)
    water = Fluid(lattice, (36, 24, 15), "cpu", subgrid="none")
    body.place(np.array([0.8, 0.5, 0, 0, 0, 0]))
    free = FluidStructure(water, body, eel.chain_markers(robot, lattice.dx, slip=0.0), slip=0.0)
    wave = eel.growth(np.arange(201) / 200)[:, None] * eel.joints(np.arange(201) / steps, 4)
    history = []
    for n, rate in enumerate(np.diff(wave, axis=0) / lattice.dt):
        free.step([0, 0, 0, 1, 1, 1], [0, 0, 0, *rate])
        if n % 10 == 9:
            history.append(momentum(free))
    assert body.data.qpos[3:] == pytest.approx(wave[-1], abs=1e-9)
    assert np.abs(body.data.qvel[:3]).max() > 1e-3
    assert drift(history) < 0.05


def test_an_eel_begins_gently():
    t = np.linspace(0, 1.5, 301)
    rate = np.gradient(eel.growth(t), t)
    assert eel.growth(t)[0] == 0 and eel.growth(1.0) == pytest.approx(1.0) and (eel.growth(t[t > 1]) == 1).all()
    assert rate.min() >= -1e-9 and rate[:2].max() < 2e-3


def test_the_markers_of_a_chain_do_not_depend_on_how_it_was_described():
    markers = eel.chain_markers(eel.eel(), 1 / 64, slip=0.0)
    assert isinstance(markers, Markers) and markers.before.max() == 15 and len(markers) > 800
    assert markers.area.sum() == pytest.approx(eel.chain_markers(eel.eel(8), 1 / 64, slip=0.0).area.sum(), rel=0.02)


def test_a_foil_is_closed_at_its_nose_and_sharp_behind():
    """Area times normal sums to nothing over a closed section; the last markers are one row."""
    markers = heaving_foil.foil(96).markers(1.0)
    x, y, _ = markers.rest.T
    assert np.abs(markers.area @ markers.normal * ~markers.sheet[-1]).max() < 1.0 + markers.area[markers.sheet].sum()
    assert (np.abs(y) <= 96 * heaving_foil.thickness(x / 96 + 1 / 3) + 1e-9).all()
    assert markers.sheet[np.argsort(x)[-3:]].all() and not markers.sheet[np.argsort(x)[:10]].any()
    nose = markers.normal[:, 0] < -0.999
    assert nose.sum() >= 2 and np.abs(np.diff(np.sort(y[nose]))).max() < 1.5
    assert 2 * heaving_foil.thickness(np.linspace(0, 1, 1001)).max() == pytest.approx(0.12, rel=2e-3)


def test_the_foil_meets_the_water_at_fifteen_degrees():
    for strouhal in (0.2, 0.3, 0.4):
        phase = np.linspace(0, 1, 2001)
        heave, pitch = heaving_foil.motion(phase, strouhal).T
        frequency = strouhal / (2 * heaving_foil.HEAVE)
        attack = np.arctan(-np.gradient(heave, phase) * frequency) - pitch
        assert np.abs(attack).max() == pytest.approx(np.radians(15.0), rel=1e-3)
        assert attack[500] > np.radians(12.0)  # moving to -y
