"""Servos from data sheets, water by shape, balanced masses, how links are drawn: against the shipped fish and the formulas."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.base.errors import ConfigError
from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.description import Link
from fishmj.mjcf.drawing import PALETTE, colour_of, drawn_sections, loft
from fishmj.mjcf.new.quantity import quantity
from fishmj.mjcf.new.shape import cut, joints_of, typical
from fishmj.mjcf.priors import balanced, displaced, plate_share, water_prior
from fishmj.mjcf.servos import SHELF, DataSheet, servo_from_sheet
from fishmj.mjcf.skin import skin


def sheet(torque: float, speed: float, voltage: float, current: float | None = None) -> DataSheet:
    return DataSheet(name="any", stall_torque=torque, no_load_speed=speed, voltage=voltage, stall_current=current)


def test_the_default_servo_comes_out_of_its_data_sheet():
    assert servo_from_sheet(SHELF["lx-824"]) == load_robot("fish").servo


@settings(max_examples=50, deadline=None)
@given(torque=st.floats(0.02, 50.0), speed=st.floats(0.5, 30.0), voltage=st.floats(3.0, 48.0))
def test_a_servo_of_any_sheet_is_a_motor(torque, speed, voltage):
    s = servo_from_sheet(sheet(torque, speed, voltage))
    assert s.kv >= 0 and s.kb == pytest.approx(torque / speed, rel=2e-3)
    assert s.constant**2 / s.resistance == pytest.approx(s.kb, rel=0.01)
    assert np.degrees(s.torque / s.kp) == pytest.approx(12.0, rel=0.06)


def test_sheets_whose_figures_contradict_each_other_are_refused():
    for known in SHELF.values():
        if known.stall_current is not None:
            assert 0.3 < known.gear_efficiency < 1.0
    with pytest.raises(ConfigError, match="kg cm or N m"):
        servo_from_sheet(sheet(17.0, 5.236, 7.4, 3.0))  # kg cm taken for N m
    with pytest.raises(ConfigError, match="contradict"):
        servo_from_sheet(sheet(0.017, 5.236, 7.4, 3.0))
    with pytest.raises(ConfigError, match="voltage = nan"):
        servo_from_sheet(sheet(1.7, 5.236, float("nan")))


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("torque", "17kg·cm", 1.6671), ("torque", "1.2 N m", 1.2), ("torque", "100 oz-in", 0.70616), ("rate", "50 rpm", 5.23599),
        ("rate", "0.2 s/60°", 5.23599), ("length", "60 CM", 0.6), ("mass", "1300g", 1.3), ("current", "900 mA", 0.9),
    ],
)  # fmt: skip
def test_units_of_rulers_and_data_sheets_are_read(kind, text, value):
    assert quantity(kind, 0.0, 100.0)(text) == pytest.approx(value, rel=1e-4)


# priors


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_the_prior_by_shape_is_what_the_shipped_descriptions_say(name):
    robot = load_robot(name)
    assert water_prior(robot.links) == robot.water | {"ke": 0.3, "stall_angle_deg": 170.0}  # theirs stand for their results


def test_a_link_is_a_plate_by_its_rear_when_it_turns():
    body = Link(name="b", length=0.1, mass=1.0, sections=((0.0, 0.06, 0.04), (0.1, 0.06, 0.04)))
    assert plate_share(body) == 0.0 and plate_share(replace(body, fin_from=0.0)) == pytest.approx(1.0)
    rear, front = (
        replace(body, fin_from=0.05),
        replace(body, sections=((0.0, 0.06, 0.001), (0.05, 0.06, 0.04), (0.1, 0.06, 0.04))),
    )
    assert plate_share(rear) == pytest.approx(0.875, abs=1e-3)  # 1 - (1/2)^3
    assert plate_share(rear, turns=False) == pytest.approx(0.5, abs=1e-3) and plate_share(front) < 0.1
    flat = [plate_share(replace(body, sections=((0.0, 0.06, w), (0.1, 0.06, w)))) for w in (0.03, 0.015, 0.008, 0.005, 0.001)]
    assert (np.diff(flat) >= 0).all() and flat[0] == 0 and flat[-1] == pytest.approx(1)


def test_balanced_masses_are_those_of_the_default_fish():
    robot = load_robot("fish")
    links = balanced(robot.links, robot.mass)
    assert [link.mass for link in links] == pytest.approx([link.mass for link in robot.links], abs=2e-4)
    assert [link.com[0] for link in links] == pytest.approx([link.com[0] for link in robot.links], abs=1e-5)
    with pytest.raises(ConfigError, match="positive mass"):
        balanced(robot.links, float("nan"))


@settings(max_examples=25, deadline=None)
@given(links=st.integers(2, 10), mass=st.floats(0.01, 300.0), high=st.floats(0.05, 0.5), wide=st.floats(0.05, 0.5))
def test_balanced_masses_add_up_and_sit_where_the_water_was(links, mass, high, wide):
    raw = cut(typical(1.0, high, wide, 0.3), joints_of(1.0, links))
    made = balanced(raw, mass)
    assert sum(link.mass for link in made) == pytest.approx(mass, abs=1e-9)
    assert [link.mass for link in made] == pytest.approx(mass * displaced(raw) / displaced(raw).sum(), abs=1e-5)


# pictures of links


def test_links_without_a_colour_have_one_each():
    robot = load_robot("fish")
    bare = replace(robot, links=tuple(replace(link, colour=None) for link in robot.links))
    assert [colour_of(bare, i) for i in range(4)] == list(PALETTE[:4])
    assert colour_of(robot, 0) == robot.links[0].colour
    assert len(np.unique(skin(bare, details=False).colour.round(1), axis=0)) > 4


def test_a_blunt_nose_is_drawn_round_and_nothing_else_changes():
    robot = load_robot("tendon_fish")
    rows = drawn_sections(robot, 0)
    assert rows[0, 1] < 0.2 * rows[:, 1].max() and rows[-1].tolist() == list(robot.links[0].sections[-1])
    front = rows[rows[:, 0] < 0.029]
    ellipse = np.sqrt(1 - (1 - front[1:, 0] / 0.03) ** 2)
    assert front[1:, 1] == pytest.approx(ellipse * 0.1, rel=1e-6)
    assert np.array_equal(drawn_sections(robot, 1), robot.links[1].sections)
    sharp = load_robot("fish")
    assert np.array_equal(drawn_sections(sharp, 0), sharp.links[0].sections)
    vertices, _ = loft(robot, geometry_of(robot), 0)
    tip = vertices[vertices[:, 0] > geometry_of(robot).span[0, 1] - 1e-9]
    assert np.ptp(tip[:, 2]) < 0.02  # m; the described wall is 0.06 high
