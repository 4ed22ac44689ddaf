"""Robots built by hand and descriptions changed at random: refused in words, or a fish that MuJoCo builds and that swims."""

import copy
import math
import tomllib
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_descriptions import whole

from fishmj import mjcf
from fishmj.base.errors import ConfigError, DescriptionError
from fishmj.log.toml import dumps
from fishmj.mjcf import Fin, Link, Robot, Servo, Timing, load_robot, reading
from fishmj.mjcf.reading import robot_from_dict
from fishmj.sim import Sim

NAN, INF = math.nan, math.inf


# robots built by hand meet the same checks


BASE = load_robot("fish")
BY_HAND = [
    (replace(BASE, name="a b"), "name: got 'a b'"),
    (replace(BASE, links=BASE.links[:1]), "1 block, expected 2 to"),
    (replace(BASE, links=(replace(BASE.links[0], mass=NAN), *BASE.links[1:])), r"\[\[link\]\] 1 'head' mass: got nan"),
    (replace(BASE, links=(replace(BASE.links[0], com=(0.07, 0.01, 0.0)), *BASE.links[1:])), "y = 0"),
    (replace(BASE, servo=Servo(kd=0.1)), r"\[servo\] kd: got 0.1"),
    (replace(BASE, servo=Servo(range=100.0)), r"\[servo\] range: got 100"),
    (replace(BASE, servo=Servo(speed_no_load=300.0)), r"\[servo\] speed_no_load: got 300.*300 deg/s is 5.236 rad/s"),
    (replace(BASE, timing=Timing(physics_dt=0.0)), r"\[timing\] physics_dt: got 0"),
    (replace(BASE, timing=Timing(bus_dt=0.021)), "nearest valid bus_dt"),
    (replace(BASE, fins=(Fin(name="f", link="none", station=(0.0, 0.1), span=0.1),)), "a link that exists"),
    (replace(BASE, water={**BASE.water, "k": [1.0]}), r"\[water\] k"),
    (replace(BASE, water={**BASE.water, "kk": 1.0}), "kk: got an unknown key"),
    (replace(BASE, density_water=INF), "density_water: got inf"),
    (replace(BASE, links=[{"name": "x"}]), "expected a tuple of Link"),
    (replace(BASE, servo={"kp": 3}), "a Servo"),
]


@pytest.mark.parametrize(("robot", "told"), BY_HAND, ids=[told[:30] for _, told in BY_HAND])
def test_a_bad_robot_built_by_hand_never_reaches_mujoco(robot, told, monkeypatch):
    monkeypatch.setattr(mujoco, "MjSpec", None)
    for enter in (mjcf.build, load_robot, Sim):
        with pytest.raises(DescriptionError, match=told):
            enter(robot)


def test_a_good_robot_built_by_hand_is_checked_once_and_comes_back_itself(monkeypatch):
    robot = Robot(
        name="hand",
        links=(
            Link(name="front", length=0.3, mass=1.0, sections=((0.0, 0.05, 0.03), (0.3, 0.08, 0.05))),
            Link(name="rear", length=0.2, mass=0.2, sections=((0.0, 0.08, 0.02), (0.2, 0.1, 0.002))),
        ),
        water={key: value for key, value in BASE.water.items() if key not in ("k", "cn")} | {"k": [0.9, 0.8], "cn": (1.2, 2.0)},
    )
    assert load_robot(robot) is robot
    monkeypatch.setattr(reading, "_examined", None)  # a second check would fail
    assert load_robot(robot) is robot and load_robot(BASE) is BASE
    with pytest.raises(TypeError):
        load_robot(replace(robot, name="other"))


def test_numbers_of_numpy_are_numbers_in_a_robot_built_by_hand():
    sections = np.array(BASE.links[0].sections)
    head = replace(BASE.links[0], mass=np.float32(0.744), sections=sections)
    assert load_robot(replace(BASE, links=(head, *BASE.links[1:]))).mass == pytest.approx(1.1)


# anything at all


SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-3, 20),
    st.floats(),
    st.floats(-2, 2),
    st.text(max_size=20),
    st.dates(),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=8), inner, max_size=3)),
    max_leaves=6,
)
NUMBERS = st.one_of(st.floats(0.2, 5.0), st.floats(0.0, 1e4), st.sampled_from([0.0, 1e-4, 1e-3, 30.0, 1e5, 50.0, 1.0, 0.5]))


def places(table, path=()) -> list[tuple]:
    """Every key and list entry of a table."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    return [p for key, value in items for p in [(*path, key), *places(value, (*path, key))]]


@st.composite
def mutated(draw) -> dict:
    """fish.toml with keys and entries taken out, replaced, scaled, copied to other keys or repeated."""
    table = copy.deepcopy(whole())
    for _ in range(draw(st.integers(1, 3))):
        spots = places(table)
        spot = draw(st.sampled_from(spots))
        inside = table
        for part in spot[:-1]:
            inside = inside[part]
        how = draw(st.sampled_from(["delete", "replace", "scale", "scale", "scale", "number", "copy", "repeat", "add"]))
        old = inside[spot[-1]]
        if how == "delete":
            del inside[spot[-1]]
        elif how == "scale" and isinstance(old, float):
            inside[spot[-1]] = old * draw(NUMBERS)
        elif how == "number":
            inside[spot[-1]] = draw(NUMBERS)
        elif how == "copy":
            other = draw(st.sampled_from(spots))
            inside[spot[-1]] = copy.deepcopy(_at(whole(), other))
        elif how == "repeat" and isinstance(old, list) and old:
            old.append(copy.deepcopy(draw(st.sampled_from(old))))
        elif how == "add" and isinstance(old, dict):
            old[draw(st.text(max_size=8))] = draw(VALUES)
        else:
            inside[spot[-1]] = draw(VALUES)
    if draw(st.booleans()) and isinstance(table.get("body"), dict):
        table["body"].pop("mass_total", None)
    return table


def _at(table, spot):
    for part in spot:
        try:
            table = table[part]
        except (KeyError, IndexError, TypeError):
            return 1.0
    return table


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(mutated())
def test_whatever_is_done_to_a_description_it_is_refused_or_swims(table):
    try:
        robot = robot_from_dict(tomllib.loads(dumps(table)), "x.toml")
    except ConfigError as error:
        assert all(line.isprintable() for line in str(error).splitlines())
        return
    mujoco_model = mjcf.build(robot)
    data = mujoco.MjData(mujoco_model)
    for _ in range(10):
        data.ctrl[:] = 0.2 * robot.servo.range
        mujoco.mj_step(mujoco_model, data)
        assert (
            np.isfinite(data.qpos).all()
            and np.isfinite(data.qvel).all()
            and not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
        )
    if not robot.effects:
        sim = Sim(robot)
        for _ in range(2):
            sim.step(np.full(robot.n_joints, 0.2 * robot.servo.range))
        assert np.isfinite(sim.pose).all()
